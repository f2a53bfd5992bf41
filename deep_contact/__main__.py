"""python -m deep_contact view [STATE.xml] [options]: a simulation in a window, or a film where there is no display."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; its exit status: 0, 2 for bad arguments, 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(prog="python -m deep_contact", description="Rigid contact of circles.")
    commands = parser.add_subparsers(dest="command", required=True)
    view = commands.add_parser(
        "view", help="play a simulation", description="Play a simulation: contacts, impulses and θ as it runs."
    )
    add = view.add_argument
    add("state", nargs="?", metavar="STATE.xml", help="continue from this state (default: a scene of falling circles)")
    add("--bodies", type=int, help="circles of the scene (default: 100)")
    add("--size", type=float, help="side of its box, m (default: 30)")
    add("--seed", type=int, help="of the scene (default: 0)")
    add("--no-gravity", action="store_true", help="circles that drift and collide")
    add("--steps", type=int, default=400, help="default: %(default)s")
    add("--every", type=int, default=4, help="steps a frame (default: %(default)s)")
    add("--sweeps", type=int, help="most sweeps a step (default: the state's own solver)")
    add("--warm-start", default="builtin", help="where the solver starts, or 'cnn' (default: %(default)s)")
    add("--out", metavar="FILE.gif", help="write a film instead of opening a window")
    given = parser.parse_args(arguments)
    try:
        return _view(given)
    except (ValueError, OSError) as error:
        view.error(str(error))
    except KeyboardInterrupt:
        return 130


def _view(given) -> int:
    import deep_contact as dc
    from deep_contact import viewer
    from deep_contact.reporting.figures import progress_bar

    scene = _scene(given)
    solver = None if given.sweeps is None else dc.PGS(sweeps=given.sweeps)
    found = viewer.frames(scene, steps=given.steps, every=given.every, solver=solver, warm_start=given.warm_start)
    if given.out is None and viewer.has_display():
        viewer.play(found)
        return 0
    if given.out is None:
        print("no display: writing a film instead", file=sys.stderr)
    fps = min(50, max(1, round(1 / (given.every * scene.dt))))
    total = -(-given.steps // given.every)
    for path in viewer.record(progress_bar(found, total=total, text="frames"), given.out or "view.gif", fps=fps):
        print(path)
    return 0


def _scene(given):
    import deep_contact as dc

    options = {"n_bodies": given.bodies, "size": given.size, "seed": given.seed}
    options = {name: value for name, value in options.items() if value is not None}
    if given.state is None:
        return (dc.drifting_circles if given.no_gravity else dc.circles_in_box)(**options)
    if options or given.no_gravity:
        raise ValueError("options of a scene: expected none beside STATE.xml, which is a scene already")
    return dc.read_state(given.state)


if __name__ == "__main__":
    raise SystemExit(main())
