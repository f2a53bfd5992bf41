"""python scripts/figure_3_8_sph.py: mean convergence rate θ after each sweep, from the SPH start.

The SPH start is the solved impulses after a splat to an image. The image is read back as the thesis prints it, as its
authors programmed it, and by our consistent transfer. The thesis does not print the spacing d and the support radius h
of this figure. Its authors' code had d = 0.75 m, h = 0.5 m and a spline.
"""

from deep_contact import figures
from deep_contact.studies import starts, verdicts

AUTHORS = "SPH, spline, d = 0.75 m, h = 0.5 m"
STARTS = {
    **{"none": "none", "builtin": "builtin", **starts.CHOSEN},
    AUTHORS: {"transfer": "spline", "spacing": 0.75, "support": 0.5},
    **{"sph consistent": {"transfer": "consistent", "spacing": 0.5}, "copy": "copy"},
}


def claims(data):
    for name, way in starts.READ.items():
        text = f"SPH, {way}, converges faster than"
        yield verdicts.judged(data, name, "builtin", f"{text} Builtin", "section 3.4.2, Figure 3.8")
        yield verdicts.judged(data, name, "none", f"{text} None", "section 3.4.1, Figure 3.8")
        yield verdicts.judged(data, "copy", name, f"SPH, {way}, is slower than Copy", "section 3.4.1, Figure 3.8")
    theirs = "the authors' setting, d = 0.75 m with h = 0.5 m, converges faster than d = h = 0.5 m, both read by spline"
    ours = "with the consistent transfer SPH is faster than Builtin"
    copy = "with the consistent transfer SPH's θ is at most 1.1 times Copy's, from the same states"
    yield verdicts.judged(data, AUTHORS, "sph spline", theirs)
    yield verdicts.judged(data, "sph consistent", "builtin", ours)
    yield verdicts.judged(data, "sph consistent", "copy", copy, within=(0.0, 1.1), mode="paired")


FIGURE = starts.convergence_figure(
    id="3.8", title="Does the SPH start converge faster than Builtin?", starts=STARTS, claims=claims, hidden=[AUTHORS],
    modes=starts.MODES,
)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
