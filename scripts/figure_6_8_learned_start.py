"""python scripts/figure_6_8_learned_start.py: what a learned start leaves after few sweeps from given states."""

import numpy as np

from deep_contact.reporting import Claim, Figure, figures, plotting
from deep_contact.studies import learned_starts as study
from deep_contact.studies.learned_starts import CLASSICAL, FEW, LEARNED, OFF
from deep_contact.validation import integer


def compute(options, seed, jobs, progress):
    """Every start with every solver on the same states of held-out scenes."""
    integer("scenes", options["scenes"], least=2)  # one has no interval
    starts = study.starts_with(options["model"])
    scenes = study.errors_on_scenes(starts, options, seed + 10_000, jobs, progress)
    return {"after": options["after"], "scenes": scenes}


def claims(data):
    few, scenes = [data["after"].index(k) for k in FEW], data["scenes"]

    def claim(text, ratios, column, most):
        measured = {f"after {k} sweeps": of for k, of in zip(FEW, ratios[few].tolist())}
        return Claim(text, None, bool(ratios[few, column].max() <= most), measured)

    text = "with PGS, where Builtin is off by more than 5 %, the network leaves at most 0.33 of its error"
    off = (study.mean_errors(scenes, start, "off") for start in (LEARNED, "builtin"))
    yield claim(text, study.ratios_of(*off), 0, 0.33)
    text = "the network, its price left out, leaves less error than the best classical setting (95 %), over all steps"
    yield claim(text, study.ratios_to_best(scenes, LEARNED), 2, np.nextafter(1, 0))


def table(data):
    scenes = data["scenes"]
    rows = [["start", "states", *(f"error({k})" for k in data["after"])]]
    for where, text in (("off", "Builtin off"), ("all", "all")):
        for name in study.settings_with([*CLASSICAL, LEARNED]):
            rows.append([name, text, *study.mean_errors(scenes, name, where).mean(axis=0).tolist()])
        rows.append(["best classical", text, *study.best_settings(scenes, CLASSICAL, where)])
        ratios = study.ratios_to_best(scenes, LEARNED, where)
        rows.append([f"{LEARNED} / best classical", text, *(study.text_of(ratio, 3) for ratio in ratios)])
    return rows


def draw(data, options):
    """Mean error by sweeps over the states where Builtin is off, with its interval over the scenes."""
    figure, ax = plotting.subplots(size=(6.5, 4.2))
    scenes = data["scenes"]
    curves = {name: study.mean_errors(scenes, name, "off") for name in ("none", "builtin")}
    curves |= {
        "best classical": study.best_errors(scenes, CLASSICAL, "off"),
        LEARNED: study.best_errors(scenes, [LEARNED], "off"),
    }
    labels = {"none": "None, PGS", "builtin": "Builtin, PGS", LEARNED: "network, its best solver"}
    x = [max(k, 1) for k in data["after"]]  # 0 sweeps, which have no logarithm, are drawn at 1
    for name, errors in curves.items():
        spread, mean = 1.96 * errors.std(axis=0) / np.sqrt(len(errors)), errors.mean(axis=0)
        look = plotting.style_of(name) | ({"label": labels[name]} if name in labels else {})
        plotting.band(ax, x, mean, mean - spread, mean + spread, marker="o", markersize=3, **look)
    plotting.log_axes(ax)
    ax.set_xticks(x, [f"{k}" for k in data["after"]])
    ax.set(xlabel="sweeps", ylabel="velocity error, share of a step's")
    ax.set_title(f"What is left after so many sweeps, where Builtin is off by over {OFF:.0%}?")
    ax.legend(title="band: 95 % over scenes", loc="lower left")
    return figure


OPTIONS = {"scenes": 20, "steps": 600, "every": 5, "after": [0, 3, 10, 30, 100], "model": "models/model.h5"}
QUICK = {"scenes": 2, "every": 15, "steps": 300}
FIGURE = Figure("6.8", "What a learned start is worth from given states", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, digits=4)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
