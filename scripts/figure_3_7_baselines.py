"""python scripts/figure_3_7_baselines.py: mean θ by sweep from None, Builtin and Copy."""

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim
from deep_contact.studies import comparison


def claims(data):
    """The conclusions under Figure 3.7."""
    sweeps = comparison.mean_sweeps(data)
    medians = {name: found["sweeps"]["median"] for name, found in data["independent"].items()}
    ratio = sweeps["builtin"] / sweeps["none"]
    at_most_two = "Copy needs nearly no iteration: one or two sweeps for most states"
    most = "None takes a long time: it needs the most sweeps of the three"
    alike = "Builtin performs like None: mean sweeps within a quarter of each other"
    return [
        Claim(at_most_two, "L654", medians["copy"] <= 2, medians),
        Claim(most, "L668", max(sweeps, key=sweeps.get) == "none", sweeps),
        Claim(alike, "L669", 0.8 < ratio < 1.25, {"builtin / none": ratio}),
        comparison.faster(data, "copy", "builtin", "Builtin is far slower than Copy", "L669"),
    ]


FIGURE = comparison.convergence_figure(
    id="3.7",
    title="Convergence from None, Builtin and Copy",
    starts={"none": "none", "builtin": "builtin", "copy": "copy"},
    claims=claims,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
