"""python scripts/figure_6_9_generalisation.py: the learned start on scenes of a kind that it was not trained on."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.held_out import CLASSICAL, FEW, after_few, cells_of, errors_beyond, ratios_to_best

SHORT = {"circles": "circles", "radius": "radii, m", "friction": "μ", "dt": "Δt, s", "columns": "box, circles across"}


def compute(options, seed, jobs, progress):
    """Every start on the same states of a few scenes of each kind, whose seeds were not in the data."""
    kinds = [{}] + [{name: value} for name, values in options["beyond"].items() for value in values]
    model = options["model"]
    starts = {name: name for name in CLASSICAL} | {"guarded": {"guarded": model}}
    settings = {"seed": seed + 30_000, "jobs": jobs, "progress": progress, "with_all": list(starts)}
    scenes = errors_beyond(starts, kinds, options, **settings)
    return {"after": options["after"], "kinds": kinds, "scenes": scenes}


def label(kind):
    """What differs from the training data: "μ 0.6"."""
    if not kind:
        return "as trained"
    (name, value), *_ = kind.items()
    text = "–".join(f"{v:g}" for v in dict.fromkeys(value)) if isinstance(value, list) else f"{value:g}"
    return f"{SHORT[name]} {text}"


LEARNED = {"guarded": "guarded network on images"}


def claims(data):
    """Whether a learned start is ever worse than the best classical setting, and where it is better."""
    few, found = after_few(data), []
    for start in LEARNED:
        by_kind = {
            label(kind): [float(v) for v in ratios_to_best(scenes, start, "all")[few, 0]]
            for kind, scenes in zip(data["kinds"], data["scenes"])
        }
        text = f"{start}, on no kind of scene worse than 1.02 of the best classical setting after 3, 10 and 30 sweeps"
        found.append(Claim(text, None, max(map(max, by_kind.values())) <= 1.02, by_kind))
    return found


def table(data):
    """Rows: errors of the learned starts with their best solver over the best classical setting's, by kind of scene."""
    rows = [["scenes", *(f"{start}, {k} sweeps" for start in LEARNED for k in FEW)]]
    for kind, scenes in zip(data["kinds"], data["scenes"]):
        cells = [cells_of(ratios_to_best(scenes, start, "all"), digits=2) for start in LEARNED]
        rows.append([label(kind), *(of_start[i] for of_start in cells for i in after_few(data))])
    return rows


def draw(data, options):
    """The ratios to the best classical setting, a line per kind of scene, a panel per learned start."""
    figure, axes = plotting.subplots(1, len(LEARNED), size=(6.0, 0.28 * len(data["kinds"]) + 1.6), sharey=True)
    y = -np.arange(len(data["kinds"]))
    few = after_few(data)
    for axis, (name, title) in zip(np.atleast_1d(axes), LEARNED.items()):
        for i, k in zip(few, FEW):
            found = np.array([ratios_to_best(scenes, name, "all")[i] for scenes in data["scenes"]])
            off = [found[:, 0] - found[:, 1], found[:, 2] - found[:, 0]]
            place = y + 0.22 * (1 - few.index(i))
            axis.errorbar(found[:, 0], place, xerr=np.maximum(off, 0), fmt="o", markersize=3, label=f"after {k} sweeps")
        axis.axvline(1.0, color=plotting.GREY, linewidth=1.0)
        axis.set_xscale("log")
        axis.set_xticks([0.2, 0.5, 1.0, 2.0], ["0.2", "0.5", "1", "2"])
        axis.minorticks_off()
        plotting.label_axes(axis, "velocity error over the best classical setting's", None, title=title)
    first = np.atleast_1d(axes)[0]
    first.set_yticks(y, [label(kind) for kind in data["kinds"]])
    first.legend()
    return figure


FIGURE = Figure(
    id="6.9",
    title="Learned starts beyond what they were trained on",
    options={
        "scenes": 3,
        "steps": 600,
        "states": 40,
        "after": [0, 3, 10, 30],
        "beyond": {
            "circles": [[20, 40], [150, 150], [300, 300]],
            "radius": [[0.5, 0.5], [0.75, 1.25], [0.5, 2.0]],
            "friction": [0.0, 0.1, 0.6, 1.0],
            "dt": [0.002, 0.005, 0.02, 0.03],
            "columns": [5, 25],
        },
        "model": "models/model.h5",
    },
    quick={"scenes": 2, "steps": 300, "states": 10, "beyond": {"friction": [0.0, 1.0], "radius": [[0.5, 2.0]]}},
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
    digits=4,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
