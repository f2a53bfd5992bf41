"""python scripts/figure_5_2_contacts.py: number of contacts in each step, and time of a solve against it."""

from functools import partial
from time import thread_time
from timeit import repeat

import numpy as np
from scipy.stats import linregress

import deep_contact as dc
from deep_contact import figures, parallel
from deep_contact.figures import Figure
from deep_contact.plot import plotting
from deep_contact.studies import starts, verdicts


def compute(options, seed, jobs, progress):
    """Count the contacts in every step of each scene, and time some solves with a fixed number of sweeps.

    The times are those of one thread, so that they do not include the time of other programs.
    """
    scenes = []
    solve = partial(dc.solve_contacts, solver=dc.PGS(sweeps=options["sweeps"], tolerance=None))
    for scene_seed in progress([seed, *parallel.seeds(seed, options["scenes"] - 1)], text="scenes"):
        scene = starts.scene_of(options, scene_seed)
        states = starts.solved_states(scene, steps=options["steps"], contacts_only=False)
        timed = [state for state in states[:: options["every"]] if state.contacts.count]
        took = (repeat(partial(solve, state), timer=thread_time, repeat=4, number=1) for state in timed)
        scenes.append({
            "contacts": np.array([state.contacts.count for state in states]),
            "timed contacts": np.array([state.contacts.count for state in timed]),
            "time (ms)": np.array([1e3 * min(of_state) for of_state in took]),
        })  # fmt: skip
    return {"scenes": scenes}


def fit(scene):
    """Fit a straight line to the time of a solve, ms, against the number of contacts.

    Returns the result of `linregress`. The fit takes the median time for each number of contacts, because single
    disturbed times do not change a median.
    """
    contacts, time = np.array(scene["timed contacts"]), np.array(scene["time (ms)"])
    counts = np.unique(contacts)
    return linregress(counts, [np.median(time[contacts == count]) for count in counts])


def cost(scene, end):
    """Return the median time of a solve per contact, ms, in states with few or with many contacts.

    end: `min` for few contacts, `max` for many. A state has few contacts if their number is between a quarter and a
    half of the scene's largest number. In such a state the overhead of a call is already negligible. A state has many
    contacts if their number is above three quarters of the largest number.
    """
    contacts, time = np.array(scene["timed contacts"]), np.array(scene["time (ms)"])
    quarter = np.ceil(4 * contacts / contacts.max())
    return np.median((time / contacts)[quarter == end(quarter[quarter > 1])])


def claims(data):
    scenes, here = data["scenes"], "section 5.1.2, Figure 5.2"
    contacts = np.array([scene["contacts"] for scene in scenes])
    sixth, ones = contacts.shape[1] // 6, np.ones(len(scenes))
    first, last = contacts[:, :sixth], contacts[:, -sixth:]
    for text, thesis, values, over, within in (
        ("the number of contacts grows as the pile falls together: at first at most half as many as at the end", here,
         first.mean(axis=1), last.mean(axis=1), verdicts.MUCH_FASTER),
        ("and then it stays: its standard deviation in the last sixth of the steps is under a tenth", here,
         last.std(axis=1), last.mean(axis=1), (0.0, 0.1)),
        ("the time of the contact solution grows with the number of contacts: their correlation is above 0.9", here,
         [fit(scene).rvalue for scene in scenes], ones, (0.9, 1.0 + 1e-9)),
        ("a sweep of PGS costs O(n): as much a contact among many as among few, within a quarter", "section 2.4.1",
         [cost(scene, max) for scene in scenes], [cost(scene, min) for scene in scenes], verdicts.ALIKE),
    ):  # fmt: skip
        yield verdicts.judged_values(values, over, text, thesis, within=within)


def draw(data, options):
    """Draw two panels for the first scene: a) contacts in each step; b) time of a solve against its contacts."""
    figure, (left, right) = plotting.subplots(1, 2, size=(9.0, 3.6))
    scene, line = data["scenes"][0], fit(data["scenes"][0])
    left.plot(scene["contacts"], color=plotting.BLUE)
    left.set(xlabel="step", ylabel="contacts", title="a) contacts in each step")
    right.plot(scene["timed contacts"], scene["time (ms)"], ".", color=plotting.BLUE, markersize=4)
    look = {"color": plotting.VERMILION, "linewidth": 1.0, "label": f"{1e3 * line.slope:.3g} µs a contact"}
    x = np.array([0, max(scene["timed contacts"])])
    right.plot(x, line.slope * x + line.intercept, **look)
    right.set(xlabel="contacts", ylabel="processor time (ms)", ylim=(0, None))
    right.set_title(f"b) contact solution, {options['sweeps']} sweeps")
    right.legend()
    return figure


OPTIONS = starts.THESIS_SETTINGS | {"every": 6}
QUICK = {"sweeps": 1000, "every": 5, "scenes": 1}
FIGURE = Figure("5.2", "Contacts, and the time their solution takes", compute, None, draw, claims, options=OPTIONS,
                quick=QUICK)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
