"""The command line, `deep-contact` or `python -m deep_contact`: simulate, predict, train, figures and tables.

Tests: tests/test_command_line.py
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import threading
import types
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path

from deep_contact.io import scripts, shipped
from deep_contact.io.argument_parser import Parser
from deep_contact.io.files import FileError, check_writable
from deep_contact.state.constants import VERSION

# Each command imports the slow modules that it needs. So --help and --version print at once.

COMMANDS = {
    "simulate": "run a scene, or go on from a state",
    "trade": "measure what each setting costs on a scene, and what it gets wrong",
    "warm-up": "compile ahead what first runs need, once, on all cores: a minute or two",
    "sample": "print the path of a state of the thesis's scene",
    "figure": "draw a figure by its number in the thesis; without a number, list them",
    "table": "make a table by its number in the thesis; without a number, list them",
    "predict": "predict the impulses of state files",
    "generate-data": "make the simulations that networks learn from; --quick: four short ones, in seconds",
    "train": "train a network; --quick: a small one on its own data, in two minutes",
}

SCENES = ("circles_in_box", "lattice_in_box", "drifting_circles", "hopper", "terrain", "drum")
"""Scenes that `trade --scene` accepts. Each is made by a function of a number of circles and a seed."""

DIVERGED = 1
BAD_ARGUMENTS = 2
BAD_FILE = 3
NO_PACKAGE = 4
INTERRUPTED = 130

STATUS = """all values are in SI units, impulses in N·s; the settings of a figure are in `figure 3.7 --help`.
exit status: 0 done, 1 the solver diverged, 2 bad arguments, 3 a file that cannot be read or written, 4 a package that
is not installed (Keras and TensorFlow in a small environment), 130 Ctrl-C; else that of the script of a figure."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. arguments: its words; by default those of the process. Returns the exit status (`STATUS`)."""
    arguments = [_without_exponent(word) for word in (sys.argv[1:] if arguments is None else arguments)]
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(errors="replace")  # a terminal that cannot show θ must not stop a run
    parser, commands = _parsers()
    name, following = (arguments or [""])[0], arguments[1:]
    try:
        if name in ("predict", "generate-data", "train"):
            script = shipped.ROOT / "scripts" / f"{name.replace('-', '_')}.py"
        elif name in ("figure", "table") and following and not following[0].startswith("-"):
            script = _script(name, following.pop(0))
        else:
            args = parser.parse_args(arguments)
            return args.run(args)
    except BrokenPipeError:  # the program that reads the output has ended, as in `deep-contact figure | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes it again at exit
        return 0
    except (FloatingPointError, OSError, FileError, MemoryError, ModuleNotFoundError) as error:
        print(f"{parser.prog} {name}: {error}", file=sys.stderr)
        return status_of(error)
    except ValueError as error:
        commands[name].error(str(error))
    except KeyboardInterrupt:
        return INTERRUPTED
    # Outside of the try block, because a ValueError of a script is not a wrong argument of the command.
    words = " ".join([parser.prog, *arguments[: len(arguments) - len(following)]])
    try:
        return _run(script, [words, *following])
    except ModuleNotFoundError as error:
        print(f"{words}: {error}", file=sys.stderr)
        return NO_PACKAGE


def _without_exponent(word: str) -> str:
    """Return a negative number with an exponent without the exponent (-1e1 as -10), and any other word unchanged.

    argparse would take -1e1 for an option.
    """
    is_number = re.fullmatch(r"-(\d+\.?\d*|\.\d+)[eE][-+]?\d{1,3}", word)
    return format(Decimal(word), "f") if is_number else word


def status_of(error: Exception) -> int:
    """Return the exit status for an error (`STATUS`)."""
    kinds = {ArithmeticError: DIVERGED, ModuleNotFoundError: NO_PACKAGE, OSError: BAD_FILE, FileError: BAD_FILE}
    return next((status for kind, status in kinds.items() if isinstance(error, kind)), BAD_ARGUMENTS)


def _parsers() -> tuple[Parser, dict[str, Parser]]:
    is_module = Path(sys.argv[0]).parts[-2:] == ("deep_contact", "__main__.py")
    prog = "python -m deep_contact" if is_module else "deep-contact"
    layout = argparse.RawDescriptionHelpFormatter
    text = "Rigid contact of circles."
    parser = Parser(prog=prog, description=text, epilog=STATUS, formatter_class=layout)
    parser.add_argument("--version", action="version", version=f"deep-contact {VERSION}")
    add = parser.add_subparsers(dest="command", required=True, metavar="COMMAND").add_parser
    commands = {name: add(name, help=text, description=f"{text.capitalize()}.") for name, text in COMMANDS.items()}
    _add_run(commands["simulate"])
    commands["sample"].add_argument("name", nargs="?", help="impact_154, settling_349, … (default: all)")
    for name in ("figure", "table"):
        text = "3.7, say, or all; the options after it are in `… 3.7 --help`"
        commands[name].add_argument("number", nargs="?", help=text)
    _add_trade(commands["trade"])
    runs = {"simulate": _simulate, "trade": _trade, "warm-up": _warm_up, "sample": _sample}
    for name, run in (runs | {"figure": _list, "table": _list}).items():
        commands[name].set_defaults(run=run)
    return parser, commands


def _add_run(parser: Parser) -> None:
    add = parser.add_argument
    text = "go on from this state, or the last of a run.h5 (default: a scene of falling circles)"
    add("state", nargs="?", metavar="STATE.xml", help=text)
    add("--bodies", type=int, metavar="N", help="circles of the scene (default: 100)")
    add("--size", type=float, metavar="M", help="side of its box, m (default: 30)")
    text = "of its circles, or the smallest and the largest, m (default: 1)"
    add("--radius", type=_number_or_word, nargs="+", metavar="R", help=text)
    add("--seed", type=int, metavar="N", help="of the scene, an integer >= 0 (default: 0)")
    add("--no-gravity", action="store_true", help="circles that drift and collide, instead of 9.81 m/s²")
    text = "downwards, or its x and y, m/s² (default: the state's, 9.81 in a scene)"
    add("--gravity", type=_number_or_word, nargs="+", metavar="G", help=text)
    add("--friction", type=float, metavar="MU", help="coefficient μ (default: the state's, 0.5 in a scene)")
    add("--restitution", type=float, metavar="E", help="coefficient e, 0 to 1 (default: the state's, 0 in a scene)")
    add("--steps", type=int, default=600, metavar="N", help="time steps to run (default: %(default)s)")
    add("--sweeps", type=int, metavar="N", help="most sweeps of the solver in a step (default: the state's own)")
    text = "steps between two states of an .h5, of a page or of a film (default: %(default)s)"
    add("--every", type=int, default=10, metavar="N", help=text)
    add("--warm-start", metavar="NAME", help="none, builtin, scaled, support, far field, … (default: builtin)")
    add("--dt", type=float, metavar="S", help="time step, s (default: the state's, 0.01 s in a scene)")
    add("--solver", metavar="NAME", help="PGS, PSOR, NNCG, … (default: the state's own, or that of --accuracy fast)")
    add("--tolerance", type=float, metavar="N·s", help="θ, the largest change of an impulse, that ends a step's sweeps")
    add("--accuracy", metavar="NAME", help="preview, fast, balanced, accurate or reference, in place of both")
    text = "the last state, .xml or .xml.gz; a picture of it, .png, or of its forces, forces.png; the run, .h5; "
    text += "a page that plays it, .html; a film of it, .gif or .mp4"
    add("--out", metavar="FILE", help=text)


def _number_or_word(text: str) -> float | str:
    """Return the number in a text, or the text itself if it is no number.

    argparse assigns a state file that follows an option to this option, as in `--gravity 0 -9.81 state.xml`. `_scene`
    then moves the file name to the argument STATE.
    """
    try:
        return float(text)
    except ValueError:
        return text


def _add_trade(parser: Parser) -> None:
    add = parser.add_argument
    add("state", nargs="?", metavar="STATE.xml", help="the scene, or a state to go on from (default: --scene)")
    add("--scene", default="circles_in_box", metavar="NAME", help="hopper, drum, terrain, … (default: %(default)s)")
    add("--bodies", type=int, metavar="N", help="circles of the scene (default: its own)")
    add("--steps", type=int, default=600, metavar="N", help="time steps of a run (default: %(default)s)")
    add("--seeds", type=int, default=6, metavar="N", help="runs of each setting (default: %(default)s)")
    add("--minutes", type=float, metavar="M", help="after so many no run begins (default: none)")
    add("--engines", action="store_true", help="other engines too")
    add("--jobs", type=int, default=1, metavar="N", help="processes (default: %(default)s)")
    add("--out", metavar="FILE", help="a picture (.png), or all of it (.json)")


# ---- commands that this module runs ----


def _simulate(args) -> int:
    import deep_contact as dc
    from deep_contact.solvers import describe
    from deep_contact.state.html import counted
    from deep_contact.state.validation import expect, integer

    integer("--every", args.every, least=1)
    out = Path(args.out or "")
    if args.out is not None:  # checked before the run, which may take long
        endings = (".xml", ".xml.gz", ".png", ".h5", ".html", ".gif", ".mp4")
        fits = out.name.endswith(endings)
        expect(fits, f"--out: expected a file that ends in {', '.join(endings)}, got {args.out!r}")
        expect(out.parent.is_dir(), f"--out: expected a folder that exists, got {str(out.parent)!r}")
        check_writable(out)
    scene = _scene(args)
    of_forces = out.name.endswith("forces.png")
    record = args.every if out.suffix in (".h5", ".html", ".gif", ".mp4") else max(args.steps, 1) if of_forces else None
    how = _method(args, scene)
    run = dc.simulate(scene, steps=args.steps, dt=args.dt, record=record, forces=of_forces, **how)
    state = run.state
    run_of = f"{counted(state.bodies.count, 'circle')}, {counted(args.steps, 'step')} of {state.dt:g} s"
    print(f"{state.name}: {run_of}, {describe(state.solver)}")
    if args.steps:
        is_fixed = state.solver.tolerance is None  # without a tolerance, a solve always does all sweeps
        why = "a fixed number of sweeps" if is_fixed else run.status[-1].replace("_", " ")
        ended = f"last θ: {run.theta[-1]:.3g} N·s ({why})"
        print(f"contacts: {state.contacts.count}; sweeps a step: {run.sweeps.mean():.1f}; {ended}")
    if args.out is not None:
        if out.suffix == ".png":
            figure, ax = dc.plotting.subplots()
            if of_forces:  # the forces are means over the last step
                dc.plotting.draw_contact_forces(ax, run.solved[-1] if run.solved else state)
            else:
                dc.plotting.draw_state(ax, state)
            dc.plotting.save(figure, out)
        elif record is None:
            dc.write_state(out, state)
        elif out.suffix == ".h5":
            run.trajectory.save(out)
        elif out.suffix == ".html":
            run.trajectory.film(out)
        else:  # in real time, with at most 120 pictures a second
            run.trajectory.film(out, fps=min(120.0, 1.0 / (args.every * state.dt)))
        print(out)
    return 0


def _method(args, scene) -> dict:
    """Return arguments of `simulate`: the solver and the start, or the accuracy in place of both.

    scene: the state whose solver the options change.
    """
    from dataclasses import replace

    import deep_contact as dc
    from deep_contact.solvers import METHODS
    from deep_contact.state.validation import expect, one_of

    names = ("solver", "sweeps", "tolerance", "warm_start")
    options = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if args.accuracy is not None:
        expect(not options, "--accuracy: expected no --solver, --sweeps, --tolerance or --warm-start beside it")
        return {"accuracy": args.accuracy}
    start = {"warm_start": options.pop("warm_start", "builtin")}
    if "solver" in options:
        return start | {"solver": METHODS[one_of("--solver", options.pop("solver"), METHODS)](**options)}
    return start | ({"solver": replace(scene.solver or dc.PGS(), **options)} if options else {})


def _trade(args) -> int:
    from functools import partial

    import deep_contact as dc
    from deep_contact.state.validation import expect, one_of

    suffix = Path(args.out or "x.json").suffix
    expect(suffix in (".png", ".json"), f"--out: expected a file that ends in .png, .json, got {args.out!r}")
    if args.out is not None:
        check_writable(args.out)
    scene = args.state and dc.read_state(args.state)
    if scene is None:
        make = getattr(dc, one_of("--scene", args.scene, SCENES))
        make = make if args.bodies is None else partial(make, args.bodies)
        scene = lambda seed: make(seed=seed)  # noqa: E731
    names = ("steps", "seeds", "minutes", "engines", "jobs")
    if threading.current_thread() is threading.main_thread():  # only the main thread may set a handler of signals
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C, after which results are kept
    trade = dc.measure_trade(scene, **{name: getattr(args, name) for name in names})
    print(trade)
    if args.out is not None:
        trade.save(args.out) if suffix == ".json" else dc.plotting.save(trade.plot(), args.out)
        print(args.out)
    return 0


def _scene(args):
    from dataclasses import replace

    import deep_contact as dc
    from deep_contact.starts.load import load_of
    from deep_contact.state.validation import expect, integer

    if args.sweeps is not None:
        integer("--sweeps", args.sweeps, least=1)
    radius, gravity = args.radius, args.gravity
    for flag, values in (("--radius", radius), ("--gravity", gravity)):
        if values and len(values) > 1 and isinstance(values[-1], str) and args.state is None:
            args.state = values.pop()
        fits = not values or (len(values) < 3 and all(isinstance(value, float) for value in values))
        expect(fits, f"{flag}: expected one number or two, got {values}")
    expect(not (gravity and args.no_gravity), f"--gravity: expected none beside --no-gravity, got {gravity}")
    if gravity and len(gravity) == 1:
        gravity = (0.0, 0.0 - gravity[0])
    world = {"gravity": gravity, "friction": args.friction, "restitution": args.restitution}
    world = {name: value for name, value in world.items() if value is not None}
    if args.state is None:
        radius = radius and (radius * 2)[:2]
        options = {"n_bodies": args.bodies, "size": args.size, "radius": radius, "seed": args.seed}
        options = {name: value for name, value in options.items() if value is not None}
        return (dc.drifting_circles if args.no_gravity else dc.circles_in_box)(**options, **world)
    for name in ("bodies", "size", "radius", "seed", "no_gravity"):
        value, flag = getattr(args, name), f"--{name.replace('_', '-')}"
        is_left_out = value is None or value is False
        way = "; `--gravity 0` switches gravity off" if name == "no_gravity" else ""
        expect(is_left_out, f"{flag}: expected none beside STATE.xml, which is a scene already, got {value}{way}")
    state = dc.load_trajectory(args.state)[-1] if args.state.endswith(".h5") else dc.read_state(args.state)
    # The file's impulses were solved for the world in the file. `load` records that world, so that the run notices the
    # new one and solves the impulses anew.
    return state.replace(load=load_of(state), world=replace(state.world, **world)) if world else state


KINDS = {
    "a pile": ("lattice_in_box", {"accuracy": "fast"}),
    "terrain, fast circles and bounces": ("terrain", {"accuracy": "fast"}),
    "segments that move": ("drum", {"accuracy": "fast"}),
    "a pile, accurately": ("lattice_in_box", {"accuracy": "reference"}),
    "many circles": ("lattice_in_box", {"method": "BatchedPGS"}),
}
"""Name -> function of a scene, and options of `simulate`. Each pair needs machine code of its own, which `warm-up`
compiles, in the order in which people need it."""

MINUTES = 2.5
"""Processor time that `warm-up` takes on a common machine with nothing compiled, min."""


def _warm_up(args) -> int:
    """Compile the code for all `KINDS`, in parallel processes, at most one per processor core."""
    import time

    # Imported by its full name, so that other processes find it. Under `python -m` this module is called __main__.
    from deep_contact.__main__ import _compile
    from deep_contact.parallel import cores, finished, progress_bar

    begun, jobs = time.perf_counter(), min(cores(), len(KINDS))
    print(f"compiling in {jobs} processes, in the order of need; about {MINUTES / jobs:.1f} min", flush=True)
    for number, seconds in progress_bar(finished(_compile, KINDS, jobs=jobs), total=len(KINDS), text="compiling"):
        print(f"{list(KINDS)[number]}: {seconds:.1f} s", flush=True)
    print(f"{len(KINDS)} kinds in {time.perf_counter() - begun:.1f} s, in {jobs} processes")
    return 0


def _compile(kind: str) -> float:
    """Simulate one step of one of the `KINDS`, which compiles its code. Returns the wall time, s."""
    import time

    import deep_contact as dc
    from deep_contact.solvers import METHODS

    begun, (scene, options) = time.perf_counter(), KINDS[kind]
    if "method" in options:
        options = {"solver": METHODS[options["method"]]()}
    dc.simulate(getattr(dc, scene)(20), steps=1, **options)
    return time.perf_counter() - begun


def _sample(args) -> int:
    names = [args.name] if args.name else shipped.sample_names()
    print(*map(shipped.sample_file, names), sep="\n")
    return 0


# ---- commands that run a script ----


def _list(args) -> int:
    for number, path in _known(args.command).items():
        print(f"{number:6s}{scripts.summary(path)}", flush=True)
    return 0


def _known(command: str) -> dict[str, Path]:
    """Return number -> script, for all scripts that a command can run.

    command: "figure" runs the scripts of figures and tables, "table" those of tables alone.
    """
    paths = scripts.find(shipped.ROOT / "scripts")
    return {number: path for number, path in paths.items() if command == "figure" or number.startswith("T")}


def _script(command: str, number: str) -> Path:
    """Return the script that makes a figure or table, or the script that makes all of them for the number "all".

    Raises ValueError, which lists the known numbers, for an unknown number.
    """
    if number == "all":
        return shipped.ROOT / "scripts" / "all_figures.py"
    number = scripts.normalized(number)
    if command == "table" and not number.startswith("T"):
        number = f"T{number}"
    (path,) = scripts.choose(_known(command), [number]).values()
    return path


def _run(script: Path, argv: list[str]) -> int:
    """Run a script as the module `__main__`. Returns its exit status.

    Processes that the script starts then find its functions. `runpy.run_path` would do the same, but it would make the
    help of the script show the name of the file in place of the command.
    """
    module = types.ModuleType("__main__")
    module.__file__ = str(script)
    before = sys.argv, sys.modules["__main__"]
    sys.argv, sys.modules["__main__"] = argv, module
    try:
        exec(compile(script.read_bytes(), script, "exec", dont_inherit=True), module.__dict__)
    except SystemExit as end:
        return end.code or 0
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        sys.argv, sys.modules["__main__"] = before
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
