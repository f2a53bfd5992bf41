"""python scripts/figure_6_9_generalisation.py: the learned start on scenes of a kind that it was not trained on."""

import numpy as np

import deep_contact as dc
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.learned import ratios_to_builtin

STARTS = ("builtin", "far field", "guarded")
FEW = (3, 10, 30)

TRAINED = {"circles": [70, 110], "radius": [1.0, 1.0], "friction": 0.3, "dt": 0.01, "columns": None}
"""The scenes of the training data."""

SHORT = {"circles": "circles", "radius": "radii, m", "friction": "μ", "dt": "Δt, s", "columns": "box, circles across"}


def compute(options, seed, jobs, progress):
    """Every start on the same states of a few scenes of each kind, whose seeds were not in the data."""
    kinds = [{}] + [{name: value} for name, values in options["beyond"].items() for value in values]
    tasks = [
        {**options, "kind": kind, "number": i, "seed": s}
        for i, kind in enumerate(kinds)
        for s in figures.seeds(seed + 30_000 + i, options["scenes"])
    ]
    found = figures.parallel_map(one_scene, tasks, jobs=jobs, progress=progress, text="scenes")
    scenes = [[f for f, task in zip(found, tasks) if task["number"] == i] for i in range(len(kinds))]
    return {"after": options["after"], "kinds": kinds, "scenes": scenes}


def one_scene(task):
    """Errors of all starts on one scene, in a process of its own."""
    from deep_contact.cnn.inference import Guarded, network_start
    from deep_contact.studies.scene_errors import errors_on_scene
    from deep_contact.warm_start import Builtin

    kind = {**TRAINED, **task["kind"]}
    rng = np.random.default_rng(task["seed"])
    count = int(rng.integers(kind["circles"][0], kind["circles"][1] + 1))
    look = {"radius": kind["radius"], "friction": kind["friction"]}
    if count > 120 or kind["radius"][1] > 1.0 or kind["columns"]:
        scene = dc.lattice_in_box(count, columns=kind["columns"], gap=0.3, seed=rng, **look)
    else:
        scene = dc.circles_in_box(count, seed=rng, **look)
    network = network_start(task["model"])
    starts = dict(zip(STARTS, (Builtin(), network, Guarded(network.model))))
    scene = scene.replace(dt=kind["dt"])
    # As much time as the runs of the other kinds have.
    steps = round(task["steps"] * TRAINED["dt"] / kind["dt"])
    every = max(1, steps // task["states"])
    return errors_on_scene(scene, starts, steps=steps, every=every, sweeps=task["after"])


def label(kind):
    """What is beyond training: "μ 0.6"."""
    if not kind:
        return "as trained"
    (name, value), *_ = kind.items()
    text = "–".join(f"{v:g}" for v in dict.fromkeys(value)) if isinstance(value, list) else f"{value:g}"
    return f"{SHORT[name]} {text}"


def claims(data):
    """Whether the guarded start is ever worse than Builtin, and where the network alone is."""
    few = [data["after"].index(k) for k in FEW]
    guarded, alone = {}, {}
    for kind, scenes in zip(data["kinds"], data["scenes"]):
        guarded[label(kind)] = [float(v) for v in ratios_to_builtin(scenes, "guarded", "all")[few, 0]]
        alone[label(kind)] = [float(v) for v in ratios_to_builtin(scenes, "far field", "off")[few, 0]]
    return [
        Claim(
            "guarded, on no kind of scene worse than 1.02 of Builtin after 3, 10 and 30 sweeps",
            None,
            max(map(max, guarded.values())) <= 1.02,
            guarded,
        ),
        Claim(
            "where Builtin is off, the network alone is better than Builtin on every kind of scene",
            None,
            max(map(max, alone.values())) < 1.0,
            alone,
        ),
    ]


def table(data):
    """Rows: errors of the learned starts over Builtin's, by kind of scene."""
    rows = [["scenes", *(f"network, {k} sweeps" for k in FEW), *(f"guarded, {k}" for k in FEW)]]
    few = [data["after"].index(k) for k in FEW]
    for kind, scenes in zip(data["kinds"], data["scenes"]):
        found = [*ratios_to_builtin(scenes, "far field", "off")[few], *ratios_to_builtin(scenes, "guarded", "all")[few]]
        rows.append([label(kind), *(f"{r:.2f} ({low:.2f}–{high:.2f})" for r, low, high in found)])
    return rows


def draw(data, options):
    """The ratios to Builtin, a line a kind of scene: left of the network where Builtin is off, right guarded."""
    figure, axes = plotting.subplots(1, 2, size=(10.0, 0.28 * len(data["kinds"]) + 1.6), sharey=True)
    y = -np.arange(len(data["kinds"]))
    few = [data["after"].index(k) for k in FEW]
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
