"""python scripts/figure_5_10_time.py: sweeps and time to a threshold from every start, by stage.

The experiment that the thesis announces after Figure 5.9 (L1343) and does not print.
"""

import deep_contact as dc
from deep_contact.cnn.model_file import ModelFileError
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import comparison
from deep_contact.studies import learned as learned

STARTS = {
    "none": "none",
    "builtin": "builtin",
    "sph": {"spacing": 0.5, "transfer": "thesis"},
    "sph consistent": {"spacing": 0.5, "transfer": "consistent"},
}
"""All but the networks, which the options name, and Copy, which comes last."""

LABELS = {"cnn": "CNN (ours)", "cnn thesis": "CNN (thesis network)"}
COLOURS = {"splat": plotting.SKY, "network": plotting.PURPLE, "gather": plotting.ORANGE, "solve": plotting.GREY}
TRANSIENT = ("impact", "settling")
TIGHT, *_ = learned.THETAS


def compute(options, seed, jobs, progress):
    """The thesis's scene, and a larger one in a box of another size; one process, since it is the time that counts."""
    about = learned.networks_info(options["networks"])
    networks = {name: learned.network_start(path) for name, path in options["networks"].items()}
    starts = {name: comparison.start_of(description) for name, description in STARTS.items()}
    scenes = {
        f"{options['few']} circles": dc.circles_in_box(options["few"], seed=seed),
        f"{options['many']} circles": dc.lattice_in_box(options["many"], seed=seed),
    }
    found = {}
    for number, (title, scene) in enumerate(scenes.items()):
        states = learned.sampled_states(
            scene, steps=options["steps"][number], count=options["states"][number], sweeps=options["sweeps"]
        )
        fitting, refused = {}, {}
        for name, start in networks.items():
            try:
                start.model.check_scene(states[0])
                fitting[name] = start
            except ModelFileError as error:
                refused[name] = str(error)
        chosen = starts | fitting | {"copy": comparison.start_of("copy")}
        found[title] = learned.time_to_thresholds(
            states, chosen, most=options["most"][number], repeats=options["repeats"], progress=progress
        )
        x_min, y_min, x_max, y_max = scene.world.box
        found[title] |= {
            "box": [x_max - x_min, y_max - y_min],
            "refused": refused,
            "splat by k-d tree": {
                name: learned.time_by_tree(states[-1:], start.model.spec, repeats=options["repeats"])
                for name, start in fitting.items()
            },
        }
    return {"scenes": found, "networks": about}


def networks_of(data, title):
    """Names of the networks that a scene was solved with."""
    return [name for name in data["networks"] if name in data["scenes"][title]["starts"]]


def claims(data):
    """Is it the interpolation that takes the time, and is the CNN start not efficient?"""
    found = []
    for title, scene in data["scenes"].items():
        for name in networks_of(data, title):
            found += claims_of(scene, name, f"{title}, {LABELS.get(name, name)}")
    return found


def claims_of(scene, name, where):
    """The claims of one network in one scene; times in ms."""
    ms = {stage: 1e3 * seconds for stage, seconds in learned.mean_stages(scene, name, TIGHT).items()}
    tree = 1e3 * scene["splat by k-d tree"][name]
    builtin, cnn = (1e3 * learned.total_time(scene, start, TIGHT) for start in ("builtin", name))
    sweeps = {start: learned.mean_sweeps_to(scene, start, TIGHT) for start in (name, "builtin")}
    quick = {}
    for criterion in scene["criteria"]:
        if criterion != TIGHT:
            pair = [1e3 * learned.total_time(scene, start, criterion, TRANSIENT) for start in (name, "builtin")]
            quick[f"{criterion}, transients, ms: {name}, builtin"] = pair
    loose = [pair[0] < pair[1] for pair in quick.values()]
    return [
        Claim(
            f"{where}: computing interpolation values takes longer than the network",
            "L15, L1399",
            ms["splat"] + ms["gather"] > ms["network"],
            {f"{stage}, ms": ms[stage] for stage in ("splat", "network", "gather")},
        ),
        Claim(
            f"{where}: by a k-d tree, as in the thesis, interpolation takes longer than the network",
            "L15, L1399",
            tree + ms["gather"] > ms["network"],
            {"splat by k-d tree, ms": tree, "network, ms": ms["network"]},
        ),
        Claim(
            f"{where}: it reaches {TIGHT} in fewer sweeps than Builtin",
            "L1399",
            sweeps[name] < sweeps["builtin"],
            sweeps,
        ),
        Claim(
            f"{where}: it is not efficient: to {TIGHT} it takes longer than Builtin",
            "L15",
            cnn > builtin,
            {f"{name}, ms": cnn, "builtin, ms": builtin, "of it solve, ms": ms["solve"]},
        ),
        Claim(
            f"{where}: in impacts and settling it is faster than Builtin to at least one of the looser thresholds",
            None,
            any(loose),
            quick,
        ),
    ]


def table(data):
    """Stages, and sweeps and time to each threshold, ms; and by what a network refuses a scene."""
    criteria = next(iter(data["scenes"].values()))["criteria"]
    rows = [["scene", "start", "splat", "network", "gather", *(f"{c}: sweeps, ms" for c in criteria), "not reached"]]
    for title, scene in data["scenes"].items():
        for name, found in scene["starts"].items():
            stages = learned.mean_stages(scene, name, TIGHT)
            own = [1e3 * stages[stage] if stage in found["stages"] else None for stage in learned.STAGES[:-1]]
            ends = [
                f"{learned.mean_sweeps_to(scene, name, c):.4g}, {1e3 * learned.total_time(scene, name, c):.3g}"
                for c in criteria
            ]
            missed = max(sum(n is None for n in found["sweeps"][c]) for c in criteria)
            rows.append([title, name, *own, *ends, f"{missed} of {len(scene['phases'])}"])
        for name, why in scene["refused"].items():
            rows.append([title, name, *[None] * (3 + len(criteria)), f"refused: its {why.partition(':')[0]}"])
    return rows


def draw(data, options):
    """A row a scene, a panel a threshold: bars of the stages' mean times, with the mean sweeps at their ends."""
    scenes = data["scenes"]
    criteria = next(iter(scenes.values()))["criteria"]
    figure, panels = plotting.subplots(
        len(scenes), len(criteria), size=(3.3 * len(criteria), 2.9 * len(scenes)), squeeze=False
    )
    for row, (title, scene) in zip(panels, scenes.items()):
        names = list(scene["starts"])
        for ax, criterion in zip(row, criteria):
            draw_bars(ax, scene, names, criterion)
            ax.set_title(criterion)
        row[0].set_yticks(range(len(names)), [plotting.style_of(name)["label"] for name in names])
        width, height = scene["box"]
        row[0].set_ylabel(f"{title}, {width:.3g} m × {height:.3g} m,\n{scene['contacts']:.0f} contacts")
    for ax in panels[-1]:
        ax.set_xlabel("mean time of a step's contacts (ms)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def draw_bars(ax, scene, names, criterion):
    """Stacked bars from the top down, ms."""
    left = [0.0] * len(names)
    stages = [learned.mean_stages(scene, name, criterion) for name in names]
    for stage in learned.STAGES:
        widths = [1e3 * found[stage] for found in stages]
        ax.barh(range(len(names)), widths, left=left, color=COLOURS[stage], label=stage, height=0.7)
        left = [start + width for start, width in zip(left, widths)]
    for place, (name, end) in enumerate(zip(names, left)):
        sweeps = learned.mean_sweeps_to(scene, name, criterion)
        ax.text(end, place, f" {sweeps:.3g} sweeps, {end:.2g} ms", va="center", fontsize=7)
    ax.invert_yaxis()
    ax.set_yticks(range(len(names)), [])
    ax.grid(axis="y", visible=False)
    ax.set_xlim(0, 1.8 * max(left))


OPTIONS = {
    "few": 100,
    "many": 1000,
    "steps": [600, 400],
    "states": [48, 12],
    "sweeps": 5000,
    "most": [10000, 20000],
    "repeats": 5,
    "networks": {"cnn": "models/compact.h5", "cnn thesis": "models/thesis_factored.h5"},
}
QUICK = {
    "many": 300,
    "steps": [250, 120],
    "states": [12, 5],
    "sweeps": 1000,
    "most": [5000, 5000],
    "repeats": 3,
    "networks": {"cnn": "models/compact.h5"},
}
FIGURE = Figure(
    "5.10",
    "Sweeps and time to a threshold, by stage",
    compute,
    table,
    draw,
    claims,
    options=OPTIONS,
    quick=QUICK,
    seed=510,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
