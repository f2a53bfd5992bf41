"""python scripts/figure_5_7_starts.py: None, Builtin, SPH at d = h = 0.5 and Copy."""

from deep_contact.reporting import figures
from deep_contact.studies import comparison

STARTS = {"none": "none", "builtin": "builtin", "sph": {"spacing": 0.5, "transfer": "thesis"}, "copy": "copy"}


def claims(data):
    """The thesis: SPH converges much faster than the others, except for Copy, which it cannot surpass (L673)."""
    better = "SPH performs not much better than Builtin: Builtin needs at most twice its sweeps"
    return [
        comparison.near(data, "sph", "none", "SPH gets convergence much faster than None", "L1131", ratio=0.5),
        comparison.near(data, "sph", "builtin", "SPH gets convergence much faster than Builtin", "L1131", ratio=0.5),
        comparison.near(data, "builtin", "sph", better, "L1396", ratio=2.0),
        comparison.faster(data, "copy", "sph", "Copy stays faster than SPH", "L673"),
    ]


FIGURE = comparison.convergence_figure(
    id="5.7", title="Convergence with None, Builtin, SPH and Copy", starts=STARTS, claims=claims
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
