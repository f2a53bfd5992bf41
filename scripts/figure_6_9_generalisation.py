"""python scripts/figure_6_9_generalisation.py: the learned start on scenes of a kind that it was not trained on."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.held_out import FEW, after_few, errors_beyond, ratio_cells
from deep_contact.studies.learned import ratios_to_builtin

SHORT = {"circles": "circles", "radius": "radii, m", "friction": "μ", "dt": "Δt, s", "columns": "box, circles across"}


def compute(options, seed, jobs, progress):
    """Every start on the same states of a few scenes of each kind, whose seeds were not in the data."""
    kinds = [{}] + [{name: value} for name, values in options["beyond"].items() for value in values]
    model = options["model"]
    starts = {"builtin": "builtin", "far field": {"model": model}, "guarded": {"guarded": model}}
    scenes = errors_beyond(starts, kinds, options, seed=seed + 30_000, jobs=jobs, progress=progress)
    return {"after": options["after"], "kinds": kinds, "scenes": scenes}


def label(kind):
    """What differs from the training data: "μ 0.6"."""
    if not kind:
        return "as trained"
    (name, value), *_ = kind.items()
    text = "–".join(f"{v:g}" for v in dict.fromkeys(value)) if isinstance(value, list) else f"{value:g}"
    return f"{SHORT[name]} {text}"


def claims(data):
    """Whether the guarded start is ever worse than Builtin, and where the network alone is better."""
    few = after_few(data)

    def by_kind(name, where):
        return {
            label(kind): [float(v) for v in ratios_to_builtin(scenes, name, where)[few, 0]]
            for kind, scenes in zip(data["kinds"], data["scenes"])
        }

    guarded, alone = by_kind("guarded", "all"), by_kind("far field", "off")
    text = "guarded, on no kind of scene worse than 1.02 of Builtin after 3, 10 and 30 sweeps"
    found = [Claim(text, None, max(map(max, guarded.values())) <= 1.02, guarded)]
    text = "where Builtin is off, the network alone is better than Builtin on every kind of scene"
    return [*found, Claim(text, None, max(map(max, alone.values())) < 1.0, alone)]


def table(data):
    """Rows: errors of the learned starts over Builtin's, by kind of scene."""
    rows = [["scenes", *(f"network, {k} sweeps" for k in FEW), *(f"guarded, {k}" for k in FEW)]]
    for kind, scenes in zip(data["kinds"], data["scenes"]):
        cells = [ratio_cells(scenes, *start, digits=2) for start in (("far field", "off"), ("guarded", "all"))]
        rows.append([label(kind), *(of_start[i] for of_start in cells for i in after_few(data))])
    return rows


def draw(data, options):
    """The ratios to Builtin, a line per kind of scene. Left: the network where Builtin is off. Right: guarded."""
    figure, axes = plotting.subplots(1, 2, size=(10.0, 0.28 * len(data["kinds"]) + 1.6), sharey=True)
    y = -np.arange(len(data["kinds"]))
    few = after_few(data)
    panels = (
        ("far field", "off", "a) network, where Builtin is off by 5 %"),
        ("guarded", "all", "b) guarded, all steps"),
    )
    for axis, (name, where, title) in zip(axes, panels):
        for i, k in zip(few, FEW):
            found = np.array([ratios_to_builtin(scenes, name, where)[i] for scenes in data["scenes"]])
            off = [found[:, 0] - found[:, 1], found[:, 2] - found[:, 0]]
            place = y + 0.22 * (1 - few.index(i))
            axis.errorbar(found[:, 0], place, xerr=np.maximum(off, 0), fmt="o", markersize=3, label=f"after {k} sweeps")
        axis.axvline(1.0, color=plotting.GREY, linewidth=1.0)
        axis.set_xscale("log")
        axis.set_xticks([0.3, 0.5, 1.0, 2.0], ["0.3", "0.5", "1", "2"])
        axis.minorticks_off()
        plotting.label_axes(axis, "velocity error over Builtin's", None, title=title)
    axes[0].set_yticks(y, [label(kind) for kind in data["kinds"]])
    axes[0].legend()
    return figure


FIGURE = Figure(
    id="6.9",
    title="The learned start beyond what it was trained on",
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
    digits=5,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
