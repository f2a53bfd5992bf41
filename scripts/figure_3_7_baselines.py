"""python scripts/figure_3_7_baselines.py: mean convergence rate θ after each sweep, from three starts.

The starts are the initial impulses of the solver: None is zero, Builtin is the impulses of the step before, and Copy is
the solution itself. θ is the largest change of an impulse in a sweep, N·s.
"""

from deep_contact import figures
from deep_contact.figures import Claim
from deep_contact.studies import starts, verdicts


def claims(data):
    medians = {name: runs["sweeps"]["median"] for name, runs in data["independent"].items()}
    at_most_two = "Copy needs nearly no iteration: one or two sweeps to θ < 6e-5 for most states"
    long = "None takes a long time to reach convergence: over 100 sweeps to θ < 6e-5 for most states"
    alike = "Builtin performs like None: mean θ within a quarter of each other"
    far = "Builtin is far slower than Copy: Copy's θ is at most half of it"
    of_three = "section 3.4.1, Figure 3.7"
    return [
        Claim(at_most_two, of_three, medians["copy"] <= 2, medians),
        Claim(long, of_three, medians["none"] > 100, medians),
        verdicts.judged(data, "builtin", "none", alike, of_three, within=verdicts.ALIKE),
        verdicts.judged(data, "copy", "builtin", far, of_three, within=verdicts.MUCH_FASTER),
    ]


FIGURE = starts.convergence_figure(
    id="3.7",
    title="Does Builtin converge like None, and Copy at once?",
    starts={"none": "none", "builtin": "builtin", "copy": "copy"},
    claims=claims,
    over="none",
    modes=starts.MODES,
)
figures.run_as_script(FIGURE, __name__)
