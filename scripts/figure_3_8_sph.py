"""python scripts/figure_3_8_sph.py: mean θ by sweep with the SPH start, by the thesis's transfer and by ours."""

from deep_contact.reporting import figures
from deep_contact.studies import starts, verdicts

COARSE = "sph, d = h = 0.75 m"
"""The grid of 41 × 41 nodes that section 5.3.3 still names; the thesis does not print d and h of this figure."""


def compared(d):
    """The starts of Figure 3.7; the SPH start at d = h as chosen later, and on the coarser grid."""
    ours = {"transfer": "consistent", "spacing": d}
    sph = {"sph": ours | {"transfer": "thesis"}, COARSE: {"transfer": "thesis", "spacing": 0.75}}
    return {"none": "none", "builtin": "builtin", **sph, "sph consistent": ours, "copy": "copy"}


def claims(data):
    ours = "with the consistent transfer SPH is faster than Builtin"
    copy = "with the consistent transfer SPH's θ is at most 1.1 times Copy's, from the same states"
    unlike = "Figure 5.7 differs from Figure 3.8: SPH is faster at the chosen d = h = 0.5 m than on a grid of 41 nodes"
    return [
        verdicts.judged(data, "sph", "builtin", "SPH converges faster than Builtin", "section 3.4.2"),
        verdicts.judged(data, "sph", "none", "SPH converges faster than None", "section 3.4.1"),
        verdicts.judged(data, "copy", "sph", "SPH is slower than Copy", "section 3.4.1"),
        verdicts.judged(data, "sph", COARSE, unlike, "section 5.1.3"),
        verdicts.judged(data, "sph consistent", "builtin", ours),
        verdicts.judged(data, "sph consistent", "copy", copy, within=(0.0, 1.1), mode="paired"),
    ]


FIGURE = starts.convergence_figure(
    id="3.8", title="Convergence with the SPH start", starts=compared, claims=claims, d=0.5
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
