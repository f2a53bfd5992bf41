"""python scripts/figure_6_8_learned_start.py: what a learned start leaves after few sweeps from given states."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import learned_starts
from deep_contact.studies.learned_starts import CLASSICAL, FEW, OFF, parts_of

LEARNED = ("far field", "guarded")
"""The network, and the same where it is better than Builtin."""


def compute(options, seed, jobs, progress):
    """Every start with every solver on the same states of held-out scenes."""
    model = options["model"]
    starts = {name: name for name in CLASSICAL} | {"far field": {"model": model}, "guarded": {"guarded": model}}
    settings = {"seed": seed + 10_000, "jobs": jobs, "progress": progress, "with_all": list(starts)}
    (scenes,) = learned_starts.errors_on_scenes(starts, options, **settings)
    return {"after": options["after"], "scenes": scenes, "steps": options["steps"]}


def settings_of(data):
    """The settings in the data whose start is one of today's."""
    return [name for name in data["scenes"][0]["errors"] if parts_of(name)[0] in (*CLASSICAL, *LEARNED)]


def mean_sweeps(data, name):
    """Mean over all states of the sweeps to the threshold."""
    return float(np.mean(np.concatenate([scene["sweeps"][name] for scene in data["scenes"]])))


def claims(data):
    few, scenes = [data["after"].index(k) for k in FEW], data["scenes"]

    def claim(text, ratios, column, most):
        measured = {f"after {k} sweeps": of for k, of in zip(FEW, ratios[few].tolist())}
        return Claim(text, None, bool(ratios[few, column].max() <= most), measured)

    text = "with PGS, where Builtin is off by more than 5 %, the network leaves at most 0.33 of its error"
    yield claim(text, learned_starts.ratios_to_builtin(scenes, "far field", "off"), 0, 0.33)
    text = "with PGS, guarded, over all steps, at most 0.6 of Builtin's error"
    yield claim(text, learned_starts.ratios_to_builtin(scenes, "guarded"), 0, 0.6)
    for start in LEARNED:
        text = f"{start}, its price left out, leaves less error than the best classical setting (95 %), over all steps"
        yield claim(text, learned_starts.ratios_to_best(scenes, start), 2, np.nextafter(1, 0))
    best = [
        min((mean_sweeps(data, name), name) for name in settings_of(data) if parts_of(name)[0] in starts)
        for starts in (CLASSICAL, ["guarded"])
    ]
    ratio = best[1][0] / best[0][0]
    text = "guarded mean sweeps to θ < 6e-5 at most 0.7 of the best classical setting's"
    yield Claim(text, None, ratio <= 0.7, {name: count for count, name in best} | {"ratio": ratio})


def table(data):
    scenes = data["scenes"]
    rows = [["start", "states", *(f"error({k})" for k in data["after"]), "mean sweeps to 6e-5"]]
    for where, text in (("off", "Builtin off"), ("all", "all")):
        for name in settings_of(data):
            errors = learned_starts.mean_errors(scenes, name, where).mean(axis=0).tolist()
            rows.append([name, text, *errors, mean_sweeps(data, name) if where == "all" else None])
        rows.append(["best classical", text, *learned_starts.best_settings(scenes, CLASSICAL, where), None])
        for start in LEARNED:
            cells = learned_starts.cells_of(learned_starts.ratios_to_best(scenes, start, where))
            rows.append([f"{start} / best classical", text, *cells, None])
    return rows


def draw(data, options):
    """Left: error by sweeps where Builtin is off. Right: error over the best classical setting's, with intervals."""
    figure, (left, right) = plotting.subplots(1, 2, size=(10.0, 4.2))
    scenes = data["scenes"]
    curves = {name: learned_starts.mean_errors(scenes, name, "off") for name in ("none", "builtin")}
    curves["best classical"] = learned_starts.best_errors(scenes, CLASSICAL, "off")
    curves["guarded"] = learned_starts.best_errors(scenes, ["guarded"], "off")
    styles = plotting.styles_of(list(curves))
    labels = {"none": "none, PGS", "builtin": "builtin, PGS", "guarded": "network, guarded"}
    x = [max(k, 1) for k in data["after"]]  # 0 sweeps, which have no logarithm, are drawn at 1
    looks = {name: {"marker": "o", "markersize": 3, **styles[name], "label": labels.get(name, name)} for name in curves}
    for name, found in curves.items():
        spread, mean = 1.96 * found.std(axis=0) / np.sqrt(len(found)), found.mean(axis=0)
        plotting.band(left, x, mean, mean - spread, mean + spread, **looks[name])
    plotting.band(right, x, *learned_starts.ratios_to_best(scenes, "guarded").T, **looks["guarded"])
    right.axhline(1.0, **styles["best classical"])
    left.set_yscale("log")
    right.set_ylim(0, 1.2)
    title = f"a) steps where Builtin is off by more than {OFF:.0%}"
    plotting.label_axes(left, "sweeps", "relative velocity error", title=title)
    plotting.label_axes(right, "sweeps", "error over the best classical setting's", title="b) all steps")
    for ax in (left, right):
        ax.set_xscale("log")
        ax.set_xticks(x, [f"{k}" for k in data["after"]])
        ax.minorticks_off()
        ax.legend()
    return figure


OPTIONS = {"scenes": 20, "steps": 600, "every": 5, "after": [0, 3, 10, 30, 100], "model": "models/model.h5"}
QUICK = {"scenes": 2, "every": 15, "steps": 300}
FIGURE = Figure("6.8", "What a learned start is worth from given states", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, digits=4)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
