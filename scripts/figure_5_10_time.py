"""python scripts/figure_5_10_time.py: sweeps and time to a threshold from every start, by stage.

The experiment that the thesis announces after Figure 5.9 (section 5.4) and does not print.
"""

import numpy as np

import deep_contact as dc
from deep_contact.cnn.model_file import ModelFileError
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import chapter_5, starts, verdicts

COLOURS = {"splat": plotting.SKY, "network": plotting.PURPLE, "gather": plotting.ORANGE, "solve": plotting.GREY}
TRANSIENT = ("impact", "settling")
TIGHT, *_ = chapter_5.THETAS


def compute(options, seed, jobs, progress):
    """The thesis's scene, and a larger one in a box of another size; one process, since it is the time that counts."""
    about = chapter_5.networks_info(options["networks"])
    networks = {name: chapter_5.network_start(path) for name, path in options["networks"].items()}
    common = {name: starts.start_of(description) for name, description in chapter_5.STARTS.items()}
    chosen = [seed, *figures.seeds(seed, options["scenes"] - 1)]
    piles = {
        f"{options['few']} circles": [dc.circles_in_box(options["few"], seed=s) for s in chosen],
        f"{options['many']} circles": [dc.lattice_in_box(options["many"], seed=s) for s in chosen],
    }
    repeats, found = options["repeats"], {}
    for number, (title, scenes) in enumerate(piles.items()):
        steps, count, most = (options[name][number] for name in ("steps", "states", "most"))
        run = {"steps": steps, "count": count, "sweeps": options["sweeps"]}
        sampled = [chapter_5.sampled_states(scene, **run) for scene in progress(scenes, text="scenes")]
        states = [state for of_scene in sampled for state in of_scene]
        refused = {}
        for name, start in networks.items():
            try:
                start.model.check_scene(states[0])
            except ModelFileError as error:
                refused[name] = str(error)
        fitting = {name: start for name, start in networks.items() if name not in refused}
        tried = common | fitting | {"copy": starts.start_of("copy")}
        x_min, y_min, x_max, y_max = scenes[0].world.box
        found[title] = chapter_5.time_to_thresholds(states, tried, most=most, repeats=repeats, progress=progress) | {
            "box": [x_max - x_min, y_max - y_min],
            "scene": [i for i, of_scene in enumerate(sampled) for _ in of_scene],
            "refused": refused,
            "splat by k-d tree": dict.fromkeys(fitting, chapter_5.time_by_tree(states[-1:], repeats=repeats)),
        }
    return {"scenes": found, "networks": about}


def claims(data):
    for title, scene in data["scenes"].items():
        for name in data["networks"]:
            if name in scene["starts"]:
                yield from claims_of(scene, name, f"{title}, {chapter_5.LABELS.get(name, name)}")


def claims_of(scene, name, where):
    """The claims of one network in one kind of scene; times in ms."""
    pair = (name, "builtin")
    tree = 1e3 * scene["splat by k-d tree"][name]
    splat, network, gather = (
        1e3 * by_scene(scene, scene["starts"][name]["stages"][stage]) for stage in chapter_5.STAGES[:-1]
    )

    def judged(first, second, text, thesis, within, names):
        means = {f"mean {what}": float(np.mean(values)) for what, values in zip(names, (first, second))}
        return verdicts.judged_values(first, second, f"{where}: {text}", thesis, within=within, also=means)

    both, slower = "abstract, section 6.2.1", verdicts.SLOWER
    text = "computing interpolation values takes longer than the network"
    yield judged(splat + gather, network, text, both, slower, ("splat and gather, ms", "network, ms"))
    text = "by a k-d tree, as in the thesis, interpolation takes longer than the network"
    yield judged(tree + gather, network, text, both, slower, ("splat by k-d tree and gather, ms", "network, ms"))
    needed = (by_scene(scene, chapter_5.sweeps_of(scene, start, TIGHT)) for start in pair)
    text, names = f"it reaches {TIGHT} in fewer sweeps than Builtin", [f"sweeps, {start}" for start in pair]
    yield judged(*needed, text, "section 6.2.1", verdicts.FASTER, names)
    whole = (1e3 * by_scene(scene, chapter_5.times_of(scene, start, TIGHT)) for start in pair)
    text, names = f"it is not efficient: to {TIGHT} it takes longer than Builtin", [f"{start}, ms" for start in pair]
    yield judged(*whole, text, "abstract", slower, names)
    transient = np.isin(scene["phases"], TRANSIENT)
    loose = {
        f"{criterion}, transients, ms: {name}, builtin": [
            1e3 * np.mean(chapter_5.times_of(scene, start, criterion), where=transient) for start in pair
        ]
        for criterion in scene["criteria"]
        if criterion != TIGHT
    }
    text = f"{where}: in impacts and settling it is faster than Builtin to at least one of the looser thresholds"
    yield Claim(text, None, any(ours < theirs for ours, theirs in loose.values()), loose)


def by_scene(scene, values):
    """Mean over each scene of one number a state."""
    of = np.array(scene["scene"])
    return np.array([np.mean(values, where=of == number) for number in np.unique(of)])


def table(data):
    criteria = next(iter(data["scenes"].values()))["criteria"]
    rows = [["scene", "start", "splat", "network", "gather", *(f"{c}: sweeps, ms" for c in criteria), "not reached"]]
    for title, scene in data["scenes"].items():
        for name, found in scene["starts"].items():
            stages = chapter_5.seconds_of(scene, name, TIGHT)
            own = [1e3 * stages[stage].mean() if stage in found["stages"] else None for stage in chapter_5.STAGES[:-1]]
            ends = []
            for c in criteria:
                sweeps, times = chapter_5.sweeps_of(scene, name, c), chapter_5.times_of(scene, name, c)
                ends.append(f"{sweeps.mean():.4g}, {1e3 * times.mean():.3g}")
            missed = max(sum(n is None for n in found["sweeps"][c]) for c in criteria)
            rows.append([title, name, *own, *ends, f"{missed} of {len(scene['phases'])}"])
        for name, why in scene["refused"].items():
            rows.append([title, name, *[None] * (3 + len(criteria)), f"refused: its {why.partition(':')[0]}"])
    return rows


def draw(data, options):
    """A row a scene, a panel a threshold: bars of the stages' mean times, with the mean sweeps at their ends."""
    scenes = data["scenes"]
    criteria = next(iter(scenes.values()))["criteria"]
    size = (3.4 * len(criteria), 3.1 * len(scenes))
    figure, panels = plotting.subplots(len(scenes), len(criteria), size=size, squeeze=False)
    for row, (title, scene) in zip(panels, scenes.items()):
        names = list(scene["starts"])
        for ax, criterion in zip(row, criteria):
            draw_bars(ax, scene, names, criterion)
        row[0].set_yticks(range(len(names)), [plotting.style_of(name)["label"] for name in names])
        width, height = scene["box"]
        row[0].set_ylabel(f"{title}, {width:.3g} m × {height:.3g} m,\n{scene['contacts']:.0f} contacts")
    for ax in panels[-1]:
        ax.set_xlabel("mean time of a step's contacts (ms);\nat the bars' ends, mean sweeps")
    plotting.legend_below(figure, panels[0, 0])
    return figure


def draw_bars(ax, scene, names, criterion):
    """Stacked bars from the top down, ms."""
    left = np.zeros(len(names))
    stages = [chapter_5.seconds_of(scene, name, criterion) for name in names]
    for stage in chapter_5.STAGES:
        widths = np.array([1e3 * found[stage].mean() for found in stages])
        ax.barh(range(len(names)), widths, left=left, color=COLOURS[stage], label=stage, height=0.7)
        left = left + widths
    for place, (name, end) in enumerate(zip(names, left)):
        ax.text(end, place, f" {chapter_5.sweeps_of(scene, name, criterion).mean():,.0f}", va="center", fontsize=8)
    ax.invert_yaxis()
    ax.set_yticks(range(len(names)), [])
    ax.grid(axis="y", visible=False)
    ax.set(title=criterion, xlim=(0, 1.3 * max(left)))


OPTIONS = {
    "few": 100, "many": 1000, "steps": [600, 400], "scenes": 12, "states": [4, 1], "sweeps": 5000,
    "most": [10000, 20000], "repeats": 5, "networks": chapter_5.NETWORKS,
}  # fmt: skip
QUICK = {
    "many": 300, "steps": [250, 120], "scenes": 1, "states": [12, 5], "sweeps": 1000, "most": [5000, 5000],
    "repeats": 3, "networks": {"cnn": chapter_5.NETWORKS["cnn"]},
}  # fmt: skip
FIGURE = Figure("5.10", "Sweeps and time to a threshold, by stage", compute, table, draw, claims, options=OPTIONS,
                quick=QUICK, seed=510)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
