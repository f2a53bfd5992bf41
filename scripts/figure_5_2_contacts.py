"""python scripts/figure_5_2_contacts.py: contacts by step, and the time of the contact solution by contacts."""

from functools import partial
from time import thread_time

import numpy as np
from scipy.stats import linregress

import deep_contact as dc
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Figure
from deep_contact.studies import starts, timing, verdicts


def compute(options, seed, jobs, progress):
    """Count the contacts of every step of a run, and time the solution of some steps with a fixed number of sweeps.

    The time is that of one thread of the processor: what else runs is not counted. "scenes" has the same of each scene
    in few numbers; the first scene is drawn.
    """
    drawn, scenes = None, []
    solve = partial(dc.solve_contacts, solver=dc.PGS(sweeps=options["sweeps"], tolerance=None))
    for scene_seed in progress([seed, *figures.seeds(seed, options["scenes"] - 1)], text="scenes"):
        scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=scene_seed)
        states = starts.solved_states(scene, steps=options["steps"], contacts_only=False)
        timed = [state for state in states[:: options["every"]] if state.contacts.count]
        found = {
            "step": [state.step for state in states],
            "contacts": [state.contacts.count for state in states],
            "timed contacts": [state.contacts.count for state in timed],
            "time (ms)": [1e3 * timing.fastest(partial(solve, state), 3, thread_time) for state in timed],
        }
        scenes.append(summary(found))
        drawn = drawn or found
    return drawn | {"scenes": scenes}


def summary(found):
    """Of one scene: contacts early, late, their spread; correlation with time; µs a contact among few and many."""
    contacts, each = np.array(found["contacts"]), costs(found)
    first, last = contacts[: contacts.size // 6], contacts[-(contacts.size // 6) :]
    means = {"first sixth": float(first.mean()), "last sixth": float(last.mean()), "its std": float(last.std())}
    return means | {"correlation": fit(found)[2], "µs a contact": [each[0], each[-1]]}


def fit(data):
    """Straight line through the median time of each number of contacts: (µs a contact, intercept in µs, correlation).

    Medians, because disturbances of the clock do not move them.
    """
    contacts, time = np.array(data["timed contacts"]), np.array(data["time (ms)"]) * 1e3
    counts = np.unique(contacts)
    found = linregress(counts, [np.median(time[contacts == count]) for count in counts])
    return found.slope, found.intercept, found.rvalue


def costs(data):
    """Median time of a contact, µs, in the solutions of a quarter to a half, to three quarters and to all contacts."""
    contacts, time = np.array(data["timed contacts"]), np.array(data["time (ms)"]) * 1e3
    quarter = np.ceil(4 * contacts / contacts.max())
    return [float(np.median((time / contacts)[quarter == k])) for k in (2, 3, 4) if (quarter == k).any()]


def claims(data):
    scenes = data["scenes"]
    first, last, spread, together = (
        [scene[name] for scene in scenes] for name in ("first sixth", "last sixth", "its std", "correlation")
    )
    few, many = zip(*(scene["µs a contact"] for scene in scenes))
    here, ones = "section 5.1.2, Figure 5.2", [1.0] * len(scenes)
    text = "the number of contacts grows as the pile falls together: at first at most half as many as at the end"
    yield verdicts.judged_values(first, last, text, here, within=verdicts.MUCH_FASTER)
    text = "and then it stays: its standard deviation in the last sixth of the steps is under a tenth"
    yield verdicts.judged_values(spread, last, text, here, within=(0.0, 0.1))
    text = "the time of the contact solution grows with the number of contacts: their correlation is above 0.9"
    yield verdicts.judged_values(together, ones, text, here, within=(0.9, 1.0 + 1e-9))
    text = "a sweep of PGS costs O(n): as much a contact among many as among few, within a quarter"
    yield verdicts.judged_values(many, few, text, "section 2.4.1", within=verdicts.ALIKE)


def draw(data, options):
    """Panels a and b."""
    figure, (left, right) = plotting.subplots(1, 2, size=(9.0, 3.6))
    left.plot(data["step"], data["contacts"], color=plotting.BLUE)
    plotting.label_axes(left, "step", "contacts", title="a) contacts in each step")
    right.plot(data["timed contacts"], data["time (ms)"], ".", color=plotting.BLUE, markersize=4)
    slope, intercept, _ = fit(data)
    x = np.array([0, max(data["timed contacts"])])
    look = {"color": plotting.VERMILION, "linewidth": 1.0, "label": f"{slope:.3g} µs a contact"}
    right.plot(x, (slope * x + intercept) / 1e3, **look)
    right.set_ylim(bottom=0)
    right.legend()
    title = f"b) contact solution, {options['sweeps']} sweeps"
    plotting.label_axes(right, "contacts", "processor time", y_unit="ms", title=title)
    return figure


OPTIONS = {"n_bodies": 100, "size": 30.0, "steps": 600, "sweeps": 3000, "every": 6, "scenes": 12}
QUICK = {"sweeps": 1000, "every": 5, "scenes": 1}
FIGURE = Figure("5.2", "Contacts, and the time their solution takes", compute, None, draw, claims, options=OPTIONS,
                quick=QUICK)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
