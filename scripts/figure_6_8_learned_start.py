"""python scripts/figure_6_8_learned_start.py: the velocity error left after few sweeps, on held-out scenes."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.learned import OFF, errors_on_thesis_scene, mean_errors, ratios_to_builtin

TENTHS = 10


def compute(options, seed, jobs, progress):
    """Every start on the same states of scenes whose seeds were not in the data."""
    tasks = [{**options, "seed": s} for s in figures.seeds(seed + 10_000, options["scenes"])]
    scenes = figures.parallel_map(one_scene, tasks, jobs=jobs, progress=progress, text="scenes")
    return {"after": options["after"], "scenes": scenes, "steps": options["steps"]}


def one_scene(task):
    """Errors of all starts on one scene of 70 to 110 circles, in a process of its own."""
    from deep_contact.cnn.inference import Guarded, network_start
    from deep_contact.warm_start import Builtin, NoStart

    network = network_start(task["model"])
    starts = {
        "none": NoStart(),
        "builtin": Builtin(),
        "compact": network_start(task["compact"]),
        "far field": network,
        "guarded": Guarded(network.model),
    }
    return errors_on_thesis_scene(starts, task)


def by_tenth(data, name):
    """Ratio to Builtin of the mean error in each tenth of the run, (10, sweeps); NaN-free: empty tenths are 1."""
    totals = {n: np.zeros((TENTHS, len(data["after"]))) for n in (name, "builtin")}
    for scene in data["scenes"]:
        tenth = np.minimum(np.array(scene["step"]) * TENTHS // data["steps"], TENTHS - 1)
        for n, total in totals.items():
            np.add.at(total, tenth, np.array(scene["errors"][n]))
    builtin = totals["builtin"]
    return np.where(builtin > 0, totals[name] / np.where(builtin > 0, builtin, 1.0), 1.0)


def mean_sweeps(data, name):
    """Mean over all states of the sweeps to the threshold."""
    return float(np.mean(np.concatenate([scene["sweeps"][name] for scene in data["scenes"]])))


def claims(data):
    """Whether the learned start pays, by the measures that were set before it was trained."""
    few = [data["after"].index(k) for k in (3, 10, 30)]
    learned, guarded = (
        ratios_to_builtin(data["scenes"], "far field", "off"),
        ratios_to_builtin(data["scenes"], "guarded", "all"),
    )
    worst = by_tenth(data, "guarded")[:, few].max()
    sweeps = {name: mean_sweeps(data, name) for name in ("builtin", "guarded")}

    def measured(found):
        return {f"after {data['after'][i]} sweeps": [float(v) for v in found[i]] for i in few}

    return [
        Claim(
            "where Builtin is off by more than 5 %, the network leaves at most 0.33 of its error",
            None,
            bool(learned[few, 0].max() <= 0.33),
            measured(learned),
        ),
        Claim(
            "guarded, over all steps, at most 0.6 of Builtin's error",
            None,
            bool(guarded[few, 0].max() <= 0.6),
            measured(guarded),
        ),
        Claim(
            "guarded, in no tenth of the run worse than 1.02 of Builtin", None, bool(worst <= 1.02), {"worst": worst}
        ),
        Claim(
            "guarded mean sweeps to θ < 6e-5 at most 0.7 of Builtin's",
            None,
            sweeps["guarded"] <= 0.7 * sweeps["builtin"],
            {**sweeps, "ratio": sweeps["guarded"] / sweeps["builtin"]},
        ),
    ]


def table(data):
    """Rows: mean errors after some sweeps, their ratio to Builtin with its interval, and sweeps to the threshold."""
    rows = [["start", "states", *(f"error({k})" for k in data["after"]), "mean sweeps to 6e-5"]]
    for where, text in (("off", "Builtin off"), ("all", "all")):
        for name in data["scenes"][0]["errors"]:
            found = mean_errors(data["scenes"], name, where).mean(axis=0)
            rows.append([name, text, *(float(v) for v in found), mean_sweeps(data, name) if where == "all" else None])
    for name in ("compact", "far field", "guarded"):
        cells = [f"{r:.3f} ({low:.3f}–{high:.3f})" for r, low, high in ratios_to_builtin(data["scenes"], name, "off")]
        rows.append([f"{name} / builtin", "Builtin off", *cells, None])
    return rows


def draw(data, options):
    """Left: error by sweeps where Builtin is off, with intervals. Right: ratio to Builtin by tenth of the run."""
    figure, (left, right) = plotting.subplots(1, 2, size=(10.0, 4.0))
    names = list(data["scenes"][0]["errors"])
    styles = plotting.styles_of(names)
    # No logarithm of 0 sweeps: they stand at 1, where nothing else is.
    x = [max(k, 1) for k in data["after"]]
    for name in names:
        found = mean_errors(data["scenes"], name, "off")
        spread = 1.96 * found.std(axis=0) / np.sqrt(len(found))
        mean = found.mean(axis=0)
        left.plot(x, mean, marker="o", markersize=3, **styles[name])
        left.fill_between(x, mean - spread, mean + spread, color=styles[name]["color"], alpha=0.15, linewidth=0)
    left.set_xscale("log")
    left.set_yscale("log")
    left.set_xticks(x, [f"{k}" for k in data["after"]])
    title = f"a) steps where Builtin is off by more than {OFF:.0%}"
    plotting.label_axes(left, "sweeps", "relative velocity error", title=title)
    left.legend()
    for k in (3, 10, 30):
        ratio = by_tenth(data, "guarded")[:, data["after"].index(k)]
        right.plot((np.arange(TENTHS) + 0.5) * 10, ratio, marker="o", markersize=3, label=f"after {k} sweeps")
    right.axhline(1.0, color=plotting.GREY, linewidth=1.0)
    right.set_ylim(0, 1.2)
    plotting.label_axes(right, "part of the run", "guarded / Builtin", x_unit="%", title="b) all steps")
    right.legend()
    return figure


FIGURE = Figure(
    id="6.8",
    title="What the learned start is worth on held-out scenes",
    options={
        "scenes": 20,
        "steps": 600,
        "every": 5,
        "after": [0, 3, 10, 30, 100],
        "compact": "models/compact.h5",
        "model": "models/model.h5",
    },
    quick={"scenes": 2, "every": 15, "steps": 300},
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
    digits=5,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
