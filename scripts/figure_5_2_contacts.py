"""python scripts/figure_5_2_contacts.py: contacts by step, and the time of the contact solution by contacts."""

import numpy as np

import deep_contact as dc
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import comparison


def compute(options, seed, jobs, progress):
    """Count the contacts of every step of a run, and time the solution of some steps with a fixed number of sweeps."""
    scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
    states = comparison.solved_states(scene, steps=options["steps"], contacts_only=False)
    timed = [state for state in states[:: options["every"]] if state.contacts.count]
    times = [comparison.contact_time(s, sweeps=options["sweeps"]) for s in progress(timed, text="timing")]
    return {
        "step": [state.step for state in states],
        "contacts": [state.contacts.count for state in states],
        "timed contacts": [state.contacts.count for state in timed],
        "time (ms)": np.array(times) * 1e3,
    }


def fit(data):
    """Straight line through the median time of each number of contacts: (µs a contact, intercept in µs, correlation).

    Medians, because disturbances of the clock do not move them.
    """
    contacts, time = times(data)
    counts = np.unique(contacts)
    medians = np.array([np.median(time[contacts == count]) for count in counts])
    slope, intercept = np.polyfit(counts, medians, 1)
    return float(slope), float(intercept), float(np.corrcoef(counts, medians)[0, 1])


def times(data):
    """Contacts of the solutions timed, and their times, µs."""
    return np.array(data["timed contacts"]), np.array(data["time (ms)"]) * 1e3


def costs(data):
    """Median time of a contact, µs, in the solutions of a quarter to a half, to three quarters and to all contacts."""
    contacts, time = times(data)
    quarters = [part * contacts.max() / 4 for part in (1, 2, 3, 4)]
    each = {}
    for low, high in zip(quarters, quarters[1:]):
        within = (low < contacts) & (contacts <= high)
        if within.any():
            each[f"up to {high:.0f} contacts"] = float(np.median(time[within] / contacts[within]))
    return each


def claims(data):
    """The thesis shows the contacts and the time; its text says that they grow together."""
    contacts = np.array(data["contacts"])
    sixth = contacts.size // 6
    first, last, spread = contacts[:sixth].mean(), contacts[-sixth:].mean(), contacts[-sixth:].std()
    slope, intercept, correlation = fit(data)
    line = {"correlation": correlation, "µs a contact": slope, "intercept (µs)": intercept}
    each = costs(data)
    measured = {f"µs a contact, {name}": found for name, found in each.items()}
    grows = "the number of contacts grows as the pile falls together, and then stays"
    stays = first < 0.5 * last and spread < 0.1 * last
    equal = "a sweep of PGS costs O(n): as much a contact among many as among few, within a quarter"
    together = "the time of the contact solution grows with the number of contacts"
    return [
        Claim(grows, "L1054", stays, {"first sixth": first, "last sixth": last, "its std": spread}),
        Claim(together, "L1054", correlation > 0.9, line),
        Claim(equal, "L327", max(each.values()) < 1.25 * min(each.values()), measured),
    ]


def table(data):
    slope, intercept, correlation = fit(data)
    return [
        ["steps", "most contacts", "solutions timed", "µs a contact", "intercept (µs)", "correlation"],
        [len(data["step"]), max(data["contacts"]), len(data["timed contacts"]), slope, intercept, correlation],
    ]


def draw(data, options):
    """Panels a and b."""
    figure, (left, right) = plotting.subplots(1, 2, size=(9.0, 3.6))
    left.plot(data["step"], data["contacts"], color=plotting.BLUE)
    plotting.label_axes(left, "step", "contacts", title="a) contacts in each step")
    right.plot(data["timed contacts"], data["time (ms)"], ".", color=plotting.BLUE, markersize=4)
    slope, intercept, _ = fit(data)
    x = np.array([0, max(data["timed contacts"])])
    label = f"{slope:.3g} µs a contact"
    right.plot(x, (slope * x + intercept) / 1e3, color=plotting.VERMILION, linewidth=1.0, label=label)
    right.set_ylim(bottom=0)
    right.legend()
    title = f"b) contact solution, {options['sweeps']} sweeps"
    plotting.label_axes(right, "contacts", "time", y_unit="ms", title=title)
    return figure


OPTIONS = {"n_bodies": 100, "size": 30.0, "steps": 600, "sweeps": 3000, "every": 2}
QUICK = {"sweeps": 1000, "every": 5}
FIGURE = Figure(
    "5.2", "Contacts, and the time their solution takes", compute, table, draw, claims, options=OPTIONS, quick=QUICK
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
