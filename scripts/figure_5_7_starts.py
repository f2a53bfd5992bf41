"""python scripts/figure_5_7_starts.py: convergence from the starts None, Builtin, SPH and Copy.

None is zero impulses, Builtin is the impulses of the step before, and Copy is the solution itself. SPH is the solution
after a transfer to a grid image and back, with grid spacing and support radius d = h = 0.5 m.
"""

from deep_contact import figures
from deep_contact.studies import starts, verdicts


def claims(data):
    """Yield the thesis's claims: SPH converges much faster than None and Builtin, and not faster than Copy."""
    here = "section 5.1.3, Figure 5.7"
    for name, way in starts.READ.items():
        for other in ("None", "Builtin"):
            text = f"SPH, {way}, gets convergence much faster than {other}: θ at most half"
            yield verdicts.judged(data, name, other.lower(), text, here, within=verdicts.MUCH_FASTER)
        text = f"SPH, {way}, performs better than warm starting, but not much: θ from half of Builtin's to Builtin's"
        yield verdicts.judged(data, name, "builtin", text, "section 6.2.1", within=(0.5, 1.0))
        yield verdicts.judged(data, "copy", name, f"Copy stays faster than SPH, {way}", "section 3.4.1")


FIGURE = starts.convergence_figure(
    id="5.7",
    title="Does SPH converge much faster than None and Builtin?",
    starts={"none": "none", "builtin": "builtin", **starts.CHOSEN, "copy": "copy"},
    claims=claims,
    seed=57,
)
figures.run_as_script(FIGURE, __name__)
