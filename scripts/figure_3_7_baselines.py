"""python scripts/figure_3_7_baselines.py: mean θ by sweep from None, Builtin and Copy."""

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim
from deep_contact.studies import comparison

STARTS = {"none": "none", "builtin": "builtin", "copy": "copy"}


def compute(options, seed, jobs, progress):
    """The three starts on the thesis's falling pile."""
    return comparison.compare_starts(STARTS, seed=seed, jobs=jobs, progress=progress, **options)


def claims(data):
    """The conclusions under Figure 3.7."""
    sweeps = {name: comparison.mean_sweeps(data, name, "independent") for name in STARTS}
    like = 0.8 < sweeps["builtin"] / sweeps["none"] < 1.25
    return [
        Claim(
            "Copy needs nearly no iteration: one or two sweeps for most states",
            "L654",
            data["independent"]["copy"]["sweeps"]["median"] <= 2,
            {name: found["sweeps"]["median"] for name, found in data["independent"].items()},
        ),
        Claim(
            "None takes a long time: it needs the most sweeps of the three",
            "L668",
            max(sweeps, key=sweeps.get) == "none",
            sweeps,
        ),
        Claim(
            "Builtin performs like None: mean sweeps within a quarter of each other",
            "L669",
            bool(like),
            {"builtin / none": sweeps["builtin"] / sweeps["none"]},
        ),
        comparison.faster(data, "copy", "builtin", text="Builtin is far slower than Copy", thesis="L669"),
    ]


FIGURE = comparison.convergence_figure(
    id="3.7", title="Convergence from None, Builtin and Copy", compute=compute, claims=claims
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
