"""python scripts/figure_5_10_time.py: time to θ < 6e-5 N·s from every start, by stage, in settling piles.

The thesis announces this experiment after Figure 5.9 (section 5.4), and does not print it.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from time import process_time

import numpy as np

from deep_contact import figures, parallel
from deep_contact.cnn.backend import one_thread
from deep_contact.cnn.images import ImageSpec
from deep_contact.cnn.model_file import ModelFileError
from deep_contact.cnn.start import Cnn
from deep_contact.figures import Figure
from deep_contact.plot import plotting
from deep_contact.solvers import PGS
from deep_contact.sph.start import Copy, Sph, solved_impulses
from deep_contact.starts.classical import Builtin, NoStart
from deep_contact.starts.names import WarmStart
from deep_contact.state.state import State
from deep_contact.stepping.problem import solve, step_problem
from deep_contact.stepping.rows import projected
from deep_contact.studies import chapter_5, piles, starts, timing, verdicts
from deep_contact.studies.starts import THRESHOLD, sweeps_to

TITLE = "Does a network's start save time to θ < 6e-5 N·s?"
COLOURS = {"splat": plotting.SKY, "network": plotting.PURPLE, "gather": plotting.ORANGE, "solve": plotting.GREY}
"""Stage of a step's contact solution -> its colour.

The stages are: particles to input image, input image to output image, output image to contacts, and sweeps.
"""

CLOCK = {"reduce": np.median, "clock": process_time}
"""Options of `timing.interleaved`: the median of processor times, which do not include the time of other programs.

The networks run on one thread of this process.
"""


def stages_of(start: WarmStart, state: State) -> dict[str, Callable[[], object]]:
    """Return the stages of a start, "splat", "network" and "gather", as functions that can be timed one by one.

    "gather" returns the start's impulses. SPH has no stage "network", and a start without an image has no stages. No
    stage includes the solution that SPH transfers, or the setup of the contact problem's rows.
    """
    if isinstance(start, Sph):
        impulses = np.column_stack(solved_impulses(state, PGS()))
        image = start.splat(state, impulses)
        return {"splat": lambda: start.splat(state, impulses), "gather": lambda: start.gather(state, image)}
    if not hasattr(start, "model"):
        return {}
    model, splat = start.model, partial(start.model.seen, state, step_problem(state))
    image, read = splat()
    out = model.run(image)
    gather = lambda: projected(*read(out), state.world.friction)  # noqa: E731
    return {"splat": splat, "network": partial(model.run, image), "gather": gather}


def time_to_threshold(
    states: Sequence[State], starts: Mapping[str, WarmStart], *, most: int, repeats: int, progress: Callable
) -> dict[str, dict]:
    """Measure the sweeps and the processor time from each start to θ < `THRESHOLD`, on the same states.

    states: solved states. starts: name -> start. most: largest number of sweeps; a solve that does not reach the
    threshold by then counts as missed. repeats: number of interleaved runs of every timing, of which the median is
    taken. progress: function that shows the progress. Returns name of the start -> {"sweeps": number of
    sweeps for each state, `most` if missed, "missed": number of states for which the solve is missed, "seconds":
    {stage: time for each state, s}}. Each start has only the stages that it needs.
    """
    solver = PGS(sweeps=most, tolerance=THRESHOLD)
    times = {name: {"sweeps": [], "missed": 0, "seconds": {}} for name in starts}
    for state in progress(states, total=len(states), text="states"):
        calls = {}
        for name, start in starts.items():
            impulses = start(state, solver)
            theta = solve(state, solver, *impulses).record.theta
            times[name]["sweeps"].append(sweeps_to(theta))
            times[name]["missed"] += int(theta[-1] > THRESHOLD)
            counted = partial(solve, state, PGS(sweeps=sweeps_to(theta), tolerance=None), *impulses)
            calls |= {(name, stage): call for stage, call in (stages_of(start, state) | {"solve": counted}).items()}
        for (name, stage), seconds in timing.interleaved(calls, repeats=repeats, **CLOCK).items():
            times[name]["seconds"].setdefault(stage, []).append(float(seconds))
    return times


def time_by_tree(state: State, *, repeats: int) -> float:
    """Return the median processor time of a splat of the bodies by k-d tree, s.

    This is the thesis's Algorithm 2, with d = h = 0.5 m.
    """
    from deep_contact.sph.thesis import splat_by_tree

    spec, bodies = ImageSpec(), state.bodies
    values = np.column_stack([bodies.mass, bodies.velocity, bodies.spin])
    splat = partial(splat_by_tree, spec.grid(state.world), bodies.position, values, h=spec.support)
    return timing.interleaved({"": splat}, repeats=repeats, **CLOCK)[""]


def compute(options, seed, jobs, progress):
    """Measure sweeps and times in settling piles of several sizes. Piles of up to 100 circles are in the thesis's box.

    Everything runs in one process, because its processor time is measured.
    """
    one_thread()
    networks, by_size = options["networks"], {}
    sph = {name: Sph(**of | {"spacing": options["spacing"]}) for name, of in starts.CHOSEN.items()}
    learned = {name: Cnn(path) for name, path in networks.items()}
    every = {"none": NoStart(), "builtin": Builtin()} | sph | learned | {"copy": Copy()}

    def scene(n_bodies, seed):
        world = {name: options[name] for name in ("friction", "restitution")}
        return piles.pile_scene(n_bodies, seed, **world).replace(dt=options["dt"])

    for size, count, after, most in zip(*(options[name] for name in ("sizes", "states", "every", "most"))):
        fallen = [piles.pile("settling", size, one, make=scene) for one in parallel.seeds(seed, options["scenes"])]
        states = [piles.pile_states(pile, count=count, every=after) for pile in fallen]
        flat, refused = [state for of_scene in states for state in of_scene], {}
        for name in networks:
            try:
                every[name].model.input(flat[0])
            except ModelFileError as error:
                refused[name] = str(error)
        fitting = {name: start for name, start in every.items() if name not in refused}
        timed = {"most": most, "repeats": options["repeats"], "progress": progress}
        by_size[str(size)] = {
            "scene": [i for i, of_scene in enumerate(states) for _ in of_scene],
            "contacts": [state.contacts.count for state in flat],
            "starts": time_to_threshold(flat, fitting, **timed),
            "refused": refused,
            "splat by k-d tree": time_by_tree(flat[-1], repeats=options["repeats"]),
        }
    return {"piles": by_size, "networks": chapter_5.networks_info(networks)}


def by_scene(pile, values):
    """Return the mean over the states of each scene, (scenes,). values: a number for each state, (states,)."""
    return np.bincount(pile["scene"], values) / np.bincount(pile["scene"])


def missed(pile, name):
    """Return the number of states that do not reach the threshold from a start, or 0 if there is no start `name`."""
    return pile["starts"].get(name, {"missed": 0})["missed"]


def is_given_up(pile, name):
    """Return whether no state reached the threshold from a start."""
    return missed(pile, name) == len(pile["scene"])


def reached(pile, name):
    """Return the number of states that reach the threshold from a start, as a text: "38 of 40"."""
    return f"{len(pile['scene']) - missed(pile, name)} of {len(pile['scene'])}"


def times(pile, name):
    """Return the mean time of each stage of a start: stage -> times, ms, (scenes,).

    The time of a stage that the start does not need is 0.
    """
    seconds = pile["starts"][name]["seconds"]
    none = np.zeros(len(pile["scene"]))
    return {stage: 1e3 * by_scene(pile, seconds.get(stage, none)) for stage in COLOURS}


def claims(data):
    for size, pile in data["piles"].items():
        for name in (name for name in data["networks"] if name in pile["starts"]):
            yield from claims_of(pile, name, f"{size} circles", data["networks"][name])


def claims_of(pile, name, size, network):
    """Yield the thesis's claims on one network in piles of one size. For the thesis's network, one is on interpolation.

    pile: data of the piles of this size. name: start of the network. size: text for the claims. network: entry of
    `chapter_5.networks_info`.
    """
    where = f"{size}, {chapter_5.label_of(network)}"
    ours, builtin = times(pile, name), times(pile, "builtin")
    sweeps = [by_scene(pile, pile["starts"][start]["sweeps"]) for start in (name, "builtin")]
    compared = [
        ("it reaches θ < 6e-5 in fewer sweeps than Builtin", "section 6.2.1", verdicts.FASTER,
         {f"{name}, sweeps": sweeps[0], "builtin, sweeps": sweeps[1]}),
        ("it is not efficient: to θ < 6e-5 it takes longer than Builtin", "abstract", verdicts.SLOWER,
         {f"{name}, ms": sum(ours.values()), "builtin, ms": sum(builtin.values())}),
    ]  # fmt: skip
    if network["architecture"] == "thesis":
        ways = {"k-d tree and gather, ms": 1e3 * pile["splat by k-d tree"] + ours["gather"]}
        ways |= {"builtin, ms": sum(builtin.values()), "compiled here, ms": ours["splat"] + ours["gather"]}
        text = "interpolation alone, by a k-d tree as in the thesis, takes longer than Builtin to θ < 6e-5"
        compared.append((text, "abstract, section 6.2.1", verdicts.SLOWER, ways))
    for text, thesis, within, numbers in compared:
        means, text = {f"mean {what}": float(np.mean(values)) for what, values in numbers.items()}, f"{where}: {text}"
        first, second, *_ = numbers.values()
        for start in (of.partition(",")[0] for of in [*numbers][:2]):
            means[f"solves at the cap, {start}"] = missed(pile, start)
        judged = verdicts.judged_values(first, second, text, thesis, within=within, also=means)
        yield open_where_capped(judged, len(pile["scene"]))


def open_where_capped(claim, states):
    """Return the claim. It is left open if capped solves could have changed its verdict.

    A solve is capped if it ended at the largest number of sweeps, above the threshold. It counts with fewer sweeps and
    less time than it needs. So the ratio of the first start's cost to the second's is certainly above 1 only if no
    solve from the second start is capped, and certainly below 1 only if no solve from the first start is.
    states: number of states.
    """
    first, second = (value for name, value in claim.measured.items() if name.startswith("solves at the cap"))
    _, low, high = claim.measured[verdicts.RATIO]
    if first == second == 0 or (low > 1 and not second) or (high < 1 and not first):
        return claim
    counts = f"{first} and {second} of {states} solves ended at the cap"
    return claim._replace(holds=None, verdict=f"open: {counts}")


def table(data):
    rows = [["circles", "start", *(f"{stage}, ms" for stage in COLOURS), "all, ms", "sweeps", "not reached"]]
    for size, pile in data["piles"].items():
        for name, start in pile["starts"].items():
            stages = [values.mean() for values in times(pile, name).values()]
            sweeps, given_up = np.mean(start["sweeps"]), f"{start['missed']} of {len(pile['scene'])}"
            label = plotting.style_of(name)["label"]
            rows.append([size, label, *(ms or None for ms in stages), sum(stages), sweeps, given_up])
        for name, why in pile["refused"].items():
            nothing = [None] * (len(COLOURS) + 2)
            rows.append([size, plotting.style_of(name)["label"], *nothing, f"refused: its {why.partition(':')[0]}"])
    return rows


def draw(data, options):
    """Draw bars of the stages' mean times, and the confidence interval of their sum.

    There is a panel for each number of circles with which the threshold of θ is reached from Builtin.
    """
    solved = {size: pile for size, pile in data["piles"].items() if not is_given_up(pile, "builtin")} or data["piles"]
    figure, panels = plotting.subplots(1, len(solved), size=(8.0 + 2 * len(solved), 3.8), squeeze=False)
    for ax, (size, pile) in zip(panels[0], solved.items()):
        names = list(pile["starts"])
        stages, left = [times(pile, name) for name in names], np.zeros(len(names))
        for stage in COLOURS:
            widths = np.array([of_start[stage].mean() for of_start in stages])
            ax.barh(range(len(names)), widths, left=left, color=COLOURS[stage], label=stage, height=0.7)
            left += widths
        for place, (name, of_start) in enumerate(zip(names, stages)):
            whole = sum(of_start.values())
            _, *ends = verdicts.interval(lambda drawn, whole=whole: whole[drawn].mean(axis=1), whole.size)
            ax.plot(ends, [place] * 2, color=plotting.BLACK, linewidth=1.2)
            text = f"  {np.mean(pile['starts'][name]['sweeps']):,.0f}, {reached(pile, name)}"
            ax.text(max(ends), place, text, va="center", fontsize=8)
        plotting.name_bars(ax, [plotting.style_of(name)["label"] for name in names])
        ax.set(xlim=(0, 1.25 * left.max()), xlabel="mean processor time of a step (ms)")
        ax.set_title(f"{int(size):,} circles, {min(pile['contacts']):,} to {max(pile['contacts']):,} contacts")
    plotting.legend_below(figure, panels[0, 0])
    notes = [TITLE, "SPH and Copy know the solution. Lines: 95 % intervals; numbers: mean sweeps, states that reach θ."]
    for size, pile in ((size, pile) for size, pile in data["piles"].items() if size not in solved):
        most = max(pile["starts"]["builtin"]["sweeps"])
        few = f"{reached(pile, 'builtin')} reach θ from Builtin, {reached(pile, 'copy')} from Copy"
        notes.append(f"{int(size):,} circles (not drawn): in {most:,} sweeps {few}.")
    figure.suptitle("\n".join(notes))
    return figure


OPTIONS = starts.THESIS_WORLD | {
    "sizes": [100, 1000], "scenes": 10, "states": [4, 1], "every": [25, 100], "most": [10000, 20000], "repeats": 3,
    "spacing": starts.SPACING, "networks": chapter_5.NETWORKS,
}  # fmt: skip
QUICK = {"sizes": [100, 300], "scenes": 1, "most": [5000, 5000]}
FIGURE = Figure("5.10", TITLE, compute, table, draw, claims, options=OPTIONS, quick=QUICK, seed=510)
figures.run_as_script(FIGURE, __name__)
