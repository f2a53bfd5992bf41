"""python scripts/figure_5_7_starts.py: None, Builtin, SPH at d = h = 0.5 and Copy."""

from deep_contact.reporting import figures
from deep_contact.studies import starts, verdicts

STARTS = {"none": "none", "builtin": "builtin", "sph": {"spacing": 0.5, "transfer": "thesis"}, "copy": "copy"}


def claims(data):
    """The thesis: SPH converges much faster than the others, except for Copy, which it cannot surpass."""
    much, here = "SPH gets convergence much faster than", "section 5.1.3, Figure 5.7"
    builtin = "SPH performs better than warm starting, but not much: θ from half of Builtin's to Builtin's"
    return [
        verdicts.judged(data, "sph", "none", f"{much} None: θ at most half", here, within=verdicts.MUCH_FASTER),
        verdicts.judged(data, "sph", "builtin", f"{much} Builtin: θ at most half", here, within=verdicts.MUCH_FASTER),
        verdicts.judged(data, "sph", "builtin", builtin, "section 6.2.1", within=(0.5, 1.0)),
        verdicts.judged(data, "copy", "sph", "Copy stays faster than SPH", "section 3.4.1"),
    ]


FIGURE = starts.convergence_figure(
    id="5.7", title="Convergence with None, Builtin, SPH and Copy", starts=STARTS, claims=claims, seed=57
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
