"""python scripts/figure_6_8_learned_start.py: the velocity error left after few sweeps, on held-out scenes."""

import numpy as np

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.held_out import FEW, TENTHS, after_few, by_tenth, errors_on_scenes, mean_sweeps, ratio_cells
from deep_contact.studies.learned import OFF, mean_errors, ratios_to_builtin


def compute(options, seed, jobs, progress):
    """Every start on the same states of held-out scenes."""
    starts = {
        "none": "none",
        "builtin": "builtin",
        "compact": {"model": options["compact"]},
        "far field": {"model": options["model"]},
        "guarded": {"guarded": options["model"]},
    }
    scenes = errors_on_scenes(starts, options, seed=seed + 10_000, jobs=jobs, progress=progress)
    return {"after": options["after"], "scenes": scenes, "steps": options["steps"]}


def claims(data):
    """Whether the learned start pays, by the measures that were set before it was trained."""
    few, scenes = after_few(data), data["scenes"]
    learned, guarded = ratios_to_builtin(scenes, "far field", "off"), ratios_to_builtin(scenes, "guarded", "all")
    worst = by_tenth(data, "guarded")[:, few].max()
    sweeps = {name: mean_sweeps(data, name) for name in ("builtin", "guarded")}

    def measured(found):
        return {f"after {data['after'][i]} sweeps": [float(v) for v in found[i]] for i in few}

    text = "where Builtin is off by more than 5 %, the network leaves at most 0.33 of its error"
    found = [Claim(text, None, bool(learned[few, 0].max() <= 0.33), measured(learned))]
    text = "guarded, over all steps, at most 0.6 of Builtin's error"
    found.append(Claim(text, None, bool(guarded[few, 0].max() <= 0.6), measured(guarded)))
    text = "guarded, in no tenth of the run worse than 1.02 of Builtin"
    found.append(Claim(text, None, bool(worst <= 1.02), {"worst": worst}))
    text = "guarded mean sweeps to θ < 6e-5 at most 0.7 of Builtin's"
    ratio = sweeps["guarded"] / sweeps["builtin"]
    return [*found, Claim(text, None, ratio <= 0.7, {**sweeps, "ratio": ratio})]


def table(data):
    """Rows: mean errors after some sweeps, their ratio to Builtin with its interval, and sweeps to the threshold."""
    rows = [["start", "states", *(f"error({k})" for k in data["after"]), "mean sweeps to 6e-5"]]
    for where, text in (("off", "Builtin off"), ("all", "all")):
        for name in data["scenes"][0]["errors"]:
            found = mean_errors(data["scenes"], name, where).mean(axis=0)
            rows.append([name, text, *(float(v) for v in found), mean_sweeps(data, name) if where == "all" else None])
    for name in ("compact", "far field", "guarded"):
        rows.append([f"{name} / builtin", "Builtin off", *ratio_cells(data["scenes"], name, "off"), None])
    return rows


def draw(data, options):
    """Left: error by sweeps where Builtin is off, with intervals. Right: ratio to Builtin by tenth of the run."""
    figure, (left, right) = plotting.subplots(1, 2, size=(10.0, 4.0))
    names = list(data["scenes"][0]["errors"])
    styles = plotting.styles_of(names)
    # 0 sweeps have no logarithm: they are drawn at 1, which is free.
    x = [max(k, 1) for k in data["after"]]
    for name in names:
        found = mean_errors(data["scenes"], name, "off")
        spread = 1.96 * found.std(axis=0) / np.sqrt(len(found))
        mean = found.mean(axis=0)
        left.plot(x, mean, marker="o", markersize=3, **styles[name])
        left.fill_between(x, mean - spread, mean + spread, color=styles[name]["color"], alpha=0.15, linewidth=0)
    left.set(xscale="log", yscale="log")
    left.set_xticks(x, [f"{k}" for k in data["after"]])
    title = f"a) steps where Builtin is off by more than {OFF:.0%}"
    plotting.label_axes(left, "sweeps", "relative velocity error", title=title)
    left.legend()
    for k in FEW:
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
