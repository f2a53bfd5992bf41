"""python scripts/quickstart.py [--out figures] [--verbose]: a pile, and how fast the solver converges from each start.

Writes quickstart.png and its numbers, quickstart.json. One scene is few: a claim of the thesis on which it does
not agree with the reference runs under data/reference is left open.
"""

import argparse
import sys
from pathlib import Path

import figure_3_7_baselines
import figure_5_7_starts

from deep_contact.compiled import announced
from deep_contact.io.files import write_json
from deep_contact.reporting import figures, plotting, results
from deep_contact.studies import starts

STARTS = figure_5_7_starts.STARTS | {"guarded": "guarded", "far field": "cnn"}
SCENE = {"n_bodies": 80, "size": 30.0}
SETTINGS = SCENE | {"steps": 500, "sweeps": 1000, "scenes": 1, "velocity_sweeps": [3, 10, 30]}
SEED = 59
"""That of Figure 5.9, whose scenes are not those that the network was trained on."""

FIGURES = (figure_3_7_baselines.FIGURE, figure_5_7_starts.FIGURE)
"""Whose claims are judged."""


def compute(progress):
    """The first scene before and after its fall, and θ by sweep from every start, from the same states."""
    scene = starts.scene_of(**SCENE, seed=figures.seeds(SEED, 1)[0])
    before, *_, after = starts.solved_states(scene, steps=SETTINGS["steps"], contacts_only=False)
    data = starts.compare_starts(STARTS, seed=SEED, progress=progress, **SETTINGS)
    return data | {"snapshots": [plotting.state_data(state) for state in (before, after)]}


def draw(data):
    """The pile before and after, and the mean θ by sweep."""
    figure, (first, last, rates) = plotting.subplots(1, 3, size=(13.0, 4.2), width_ratios=(1, 1, 1.3))
    for ax, state in zip((first, last), map(plotting.state_of, data["snapshots"])):
        plotting.draw_state(ax, state, colour_by=None)
        ax.set_title(f"t = {state.time:.2f} s, {state.contacts.count} contacts")
    starts.draw_convergence(rates, data, "paired", floor=1e-9, title="how far the solver still is, by start")
    return figure


def numbers(data):
    """Three lines: the pile, the error after few sweeps, and the sweeps to the end."""
    after = data["snapshots"][1]
    errors, tenth = data["velocity"]["mean"], data["velocity"]["sweeps"].index(10)
    error, sweeps = {k: v[tenth] for k, v in errors.items()}, starts.mean_sweeps(data, "paired")
    parts = [
        (
            "a pile",
            f"{SCENE['n_bodies']} circles, {len(after['contacts']['body_a'])} contacts after {after['time']:.1f} s",
        ),
        (
            "error of the velocities after 10 sweeps",
            "{:.0%} from zero, {:.0%} from the step before, {:.0%} from the network",
        ),
        ("sweeps until solved", "{:.0f} from zero, {:.0f} from the step before, {:.0f} from the network"),
    ]
    names = ("none", "builtin", "far field")
    filled = [(), [error[name] for name in names], [sweeps[name] for name in names]]
    return [f"{name}: {text.format(*values)}" for (name, text), values in zip(parts, filled)]


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", default="figures", metavar="FOLDER", help="where the files go (default: figures)")
    parser.add_argument("--verbose", action="store_true", help="print all numbers and claims")
    given = parser.parse_args(arguments)
    try:
        with announced(lambda line: print(line, flush=True)):
            data = results.plain(compute(figures.progress_bar), digits=6)
    except KeyboardInterrupt:
        print("quickstart.py: interrupted", file=sys.stderr)
        return figures.INTERRUPTED
    out = Path(given.out)
    write_json(out / "quickstart.json", data)
    with plotting.style():
        picture = plotting.save(draw(data), out / "quickstart.png")
    for line in numbers(data):
        print(line)
    print("what the thesis says of the starts, on this scene alone:")
    for figure in FIGURES if given.verbose else FIGURES[:1]:
        beside = results.reference(figure.stem) or {"claims": []}
        for claim in figure.claims(data):
            said = claim if given.verbose else claim._replace(thesis=None)  # a line of the screen, without its place
            print(f"  {figures.claim_line(said._asdict(), beside, measured=given.verbose)}")
    if given.verbose:
        for line in figures.aligned([[figures.cell(v) for v in row] for row in starts.table_of_starts(data)]):
            print(line)
    print(f"picture: {picture}" + ("" if given.verbose else "  (--verbose prints the rest)"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
