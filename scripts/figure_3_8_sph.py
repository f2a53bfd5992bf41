"""python scripts/figure_3_8_sph.py: mean θ by sweep with the SPH start, by the thesis's transfer and by ours."""

from deep_contact.reporting import figures
from deep_contact.studies import comparison

STARTS = {
    "none": "none",
    "builtin": "builtin",
    "sph": {"transfer": "thesis"},
    "sph consistent": {"transfer": "consistent"},
    "copy": "copy",
}


def compute(options, seed, jobs, progress):
    """The starts of Figure 3.7 and the SPH start at d = h."""
    d = options.pop("d")
    starts = {n: {**start, "spacing": d} if isinstance(start, dict) else start for n, start in STARTS.items()}
    return comparison.compare_starts(starts, seed=seed, jobs=jobs, progress=progress, **options)


def claims(data):
    """The hypothesis of section 3.4.1, and what the thesis sees in the figure."""
    return [
        comparison.faster(data, "sph", "builtin", text="SPH converges faster than Builtin", thesis="L683"),
        comparison.faster(data, "sph", "none", text="SPH converges faster than None", thesis="L673"),
        comparison.faster(data, "copy", "sph", text="SPH is slower than Copy", thesis="L673"),
        comparison.faster(
            data,
            "sph consistent",
            "builtin",
            text="with the consistent transfer SPH is faster than Builtin",
            thesis=None,
        ),
        comparison.near(
            data,
            "sph consistent",
            "copy",
            ratio=1.1,
            text="with the consistent transfer SPH needs at most 1.1 times Copy's mean sweeps, from the same states",
        ),
    ]


FIGURE = comparison.convergence_figure(
    id="3.8", title="Convergence with the SPH start", compute=compute, claims=claims, d=0.5
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
