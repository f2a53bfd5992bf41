"""python scripts/figure_3_8_sph.py: mean θ by sweep with the SPH start, by the thesis's transfer and by ours."""

from deep_contact.reporting import figures
from deep_contact.studies import comparison

TRANSFERS = {"sph": "thesis", "sph consistent": "consistent"}


def starts(d):
    """The starts of Figure 3.7 and the SPH start at d = h."""
    sph = {name: {"transfer": transfer, "spacing": d} for name, transfer in TRANSFERS.items()}
    return {"none": "none", "builtin": "builtin", **sph, "copy": "copy"}


def claims(data):
    """The hypothesis of section 3.4.1, and what the thesis sees in the figure."""
    ours = "with the consistent transfer SPH is faster than Builtin"
    copy = "with the consistent transfer SPH needs at most 1.1 times Copy's mean sweeps, from the same states"
    return [
        comparison.faster(data, "sph", "builtin", "SPH converges faster than Builtin", "L683"),
        comparison.faster(data, "sph", "none", "SPH converges faster than None", "L673"),
        comparison.faster(data, "copy", "sph", "SPH is slower than Copy", "L673"),
        comparison.faster(data, "sph consistent", "builtin", ours),
        comparison.near(data, "sph consistent", "copy", copy, ratio=1.1, mode="paired"),
    ]


FIGURE = comparison.convergence_figure(
    id="3.8", title="Convergence with the SPH start", starts=starts, claims=claims, d=0.5
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
