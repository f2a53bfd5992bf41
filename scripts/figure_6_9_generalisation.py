"""python scripts/figure_6_9_generalisation.py: the learned start on scenes of a kind that it was not trained on."""

import numpy as np

from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.studies import learned_starts as study
from deep_contact.studies.learned_starts import FEW, LEARNED

SHORT = {"circles": "circles", "radius": "radii, m", "friction": "μ", "dt": "Δt, s", "columns": "box, circles across"}


def compute(options, seed, jobs, progress):
    """Every start on the same states of a few scenes of each kind, whose seeds were not in the data."""
    kinds = [{}] + [{name: value} for name, values in options["beyond"].items() for value in values]
    starts = study.starts_with(options["model"])
    more = {"several": list(starts), "kinds": kinds}
    scenes = study.errors_on_scenes(starts, options, seed + 30_000, jobs, progress, **more)
    return {"after": options["after"], "kinds": kinds, "scenes": scenes}


def label(kind):
    """What differs from the training data: "μ 0.6"."""
    for name, value in kind.items():
        return f"{SHORT[name]} {'–'.join(f'{v:g}' for v in dict.fromkeys(np.atleast_1d(value)))}"
    return "as trained"


def ratios_of(data):
    """Kind of scene -> error of the network over the best classical setting's, (FEW, 3)."""
    few = [data["after"].index(k) for k in FEW]
    by_kind = zip(data["kinds"], data["scenes"])
    return {label(kind): study.ratios_to_best(scenes, LEARNED)[few] for kind, scenes in by_kind}


def claims(data):
    by_kind = {kind: ratios[:, 0].tolist() for kind, ratios in ratios_of(data).items()}
    text = "as many sweeps, 3, 10 or 30: on no kind of scene worse than 1.02 of the best classical setting"
    return [Claim(text, None, max(map(max, by_kind.values())) <= 1.02, by_kind)]


def table(data):
    rows = [["scenes", *(f"{k} sweeps" for k in FEW)]]
    return rows + [[kind, *map(study.text_of, ratios)] for kind, ratios in ratios_of(data).items()]


def draw(data, options):
    """Error over the best classical setting's for each kind of scene, with intervals."""
    by_kind = ratios_of(data)
    figure, ax = plotting.subplots(size=(7.0, 0.28 * len(by_kind) + 1.6))
    plotting.name_bars(ax, list(by_kind))
    for i, (k, colour) in enumerate(zip(FEW, plotting.shades(len(FEW)))):
        ratio, low, high = np.array([ratios[i] for ratios in by_kind.values()]).T
        off = np.maximum([ratio - low, high - ratio], 0)
        look = {"fmt": "o", "markersize": 3, "color": colour, "label": f"after {k} sweeps"}
        ax.errorbar(ratio, np.arange(len(by_kind)) + 0.22 * (i - 1), xerr=off, **look)
    ax.axvline(1.0, color=plotting.GREY, linewidth=1.0)
    text = "velocity error over the best classical setting's\nafter as many sweeps, its price left out (Figure 6.10)"
    ax.set_xlabel(text)
    return plotting.legend_below(figure, ax, "Does the network's start carry over to other scenes?")


OPTIONS = {
    "scenes": 3, "steps": 600, "states": 40, "after": [0, 3, 10, 30],
    "beyond": {"circles": [[20, 40], [150, 150], [300, 300]], "radius": [[0.5, 0.5], [0.75, 1.25], [0.5, 2.0]],
        "friction": [0.0, 0.1, 0.6, 1.0], "dt": [0.002, 0.005, 0.02, 0.03], "columns": [5, 25]},
    "model": "models/model.h5",
}  # fmt: skip
QUICK = {"scenes": 2, "steps": 300, "states": 10, "beyond": {"friction": [0.0, 1.0], "radius": [[0.5, 2.0]]}}
FIGURE = Figure("6.9", "Learned starts beyond what they were trained on", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
