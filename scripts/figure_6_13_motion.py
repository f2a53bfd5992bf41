"""python scripts/figure_6_13_motion.py: a pile that falls, with one number of substeps and with substeps by motion."""

import numpy as np

from deep_contact import run_errors, trade
from deep_contact.constants import TIME_STEP
from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.simulation import simulate
from deep_contact.studies import runs

SETTINGS = {
    "1 substep": {"method": "PGS", "sweeps": 4, "dt": TIME_STEP},
    "8 substeps": {"method": "PGS", "sweeps": 4, "dt": TIME_STEP / 8},
    "by motion, ¼ of the slop": {"method": "PGS", "sweeps": 4, "dt": TIME_STEP / 2, "most_substeps": 8, "slop": 0.25},
}
"""Name -> setting of the study."""

EACH = round(runs.INTERVAL / TIME_STEP)


def compute(options, seed, jobs, progress):
    """Of each setting: kinetic energy, deepest penetration and substeps of 10 ms, in intervals of a run."""
    courses = {}
    for name in progress(list(SETTINGS), text="settings"):
        setting = SETTINGS[name]
        parts = round(TIME_STEP / setting["dt"])
        state = runs.scene(options["kind"], options["n_bodies"], seed).replace(dt=setting["dt"])
        steps, every = round(options["seconds"] / setting["dt"]), EACH * parts
        run = simulate(state, steps=steps, solver=trade.solver_of(setting), record=every)
        seen = run_errors.observe(run.trajectory[k] for k in range(1, len(run.trajectory)))
        courses[name] = {
            "time": [runs.INTERVAL * (k + 1) for k in range(len(seen.kinetic))],
            "kinetic": seen.kinetic,
            "deepest": 100 * seen.penetration[:, 2],
            "substeps": parts * run.substeps.reshape(-1, every).mean(axis=1),
        }
    return {"courses": courses}


def claims(data):
    """By motion a run is as little deep as with eight substeps, in fewer."""
    courses = (data["courses"][name] for name in ("8 substeps", "by motion, ¼ of the slop"))
    (most, deep), (mean, least) = ((float(np.mean(one["substeps"])), max(one["deepest"])) for one in courses)
    measured = {"substeps": mean, "deepest, %": least, "deepest with 8, %": deep}
    yield Claim("by motion fewer substeps go no deeper", None, mean < most and least <= deep, measured)


def draw(data, options):
    """Three panels over time: kinetic energy, substeps, deepest penetration."""
    figure, panels = plotting.subplots(1, 3, size=(plotting.PAGE, 3.2))
    shown = {"kinetic": "kinetic energy (M g r)", "substeps": "substeps of 10 ms"}
    for ax, (key, text) in zip(panels, (shown | {"deepest": "deepest penetration (% of r)"}).items()):
        for (name, one), colour in zip(data["courses"].items(), (*plotting.shades(2), plotting.VERMILION)):
            ax.plot(one["time"], one[key], color=colour, label=name)
        ax.set(xlabel="time (s)", ylabel=text)
    return plotting.legend_below(figure, panels[0], "What do substeps by motion cost, and what do they keep?")


OPTIONS = {"kind": "mixed radii", "n_bodies": 1000, "seconds": 8.0}
FIGURE = Figure("6.13", "Small steps where something hits", compute, None, draw, claims, options=OPTIONS,
                quick={"n_bodies": 100, "seconds": 4.0})  # fmt: skip
figures.run_as_script(FIGURE, __name__)
