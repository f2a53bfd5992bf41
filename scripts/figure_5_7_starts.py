"""python scripts/figure_5_7_starts.py: None, Builtin, SPH at d = h = 0.5 and Copy."""

from deep_contact.reporting import figures
from deep_contact.studies import comparison

STARTS = {
    "none": "none",
    "builtin": "builtin",
    "sph": {"spacing": 0.5, "transfer": "thesis"},
    "copy": "copy",
}


def compute(options, seed, jobs, progress):
    """The four starts on the thesis's falling pile."""
    return comparison.compare_starts(STARTS, seed=seed, jobs=jobs, progress=progress, **options)


def claims(data):
    """SPH is said to converge much faster than all others; Copy is the bound it cannot pass (L673)."""
    return [
        comparison.near(
            data,
            "sph",
            "none",
            ratio=0.5,
            text="SPH gets convergence much faster than None",
            thesis="L1131",
            mode="independent",
        ),
        comparison.near(
            data,
            "sph",
            "builtin",
            ratio=0.5,
            text="SPH gets convergence much faster than Builtin",
            thesis="L1131",
            mode="independent",
        ),
        comparison.near(
            data,
            "builtin",
            "sph",
            ratio=2.0,
            text="SPH performs not much better than Builtin: Builtin needs at most twice its sweeps",
            thesis="L1396",
            mode="independent",
        ),
        comparison.faster(data, "copy", "sph", text="Copy stays faster than SPH", thesis="L673"),
    ]


FIGURE = comparison.convergence_figure(
    id="5.7", title="Convergence with None, Builtin, SPH and Copy", compute=compute, claims=claims
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
