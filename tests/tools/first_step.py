"""The way of a new scene into its first step: Python functions of the package that are called, and changes of file.

    python tests/tools/first_step.py [--list]

Counts `dc.simulate(dc.lattice_in_box(100), steps=1, solver=dc.PGS())` after one warm run, and one
`Simulator.step`, with `sys.setprofile`. Imports are not counted. A change of file is a call in another file than
that of the call before it. `--list` prints the calls in their order, indented by their depth.
"""

import argparse
import sys
from pathlib import Path

import deep_contact as dc

PACKAGE = str(Path(dc.__file__).parent)


def calls_of(function) -> list[tuple[int, str, str]]:
    """(depth, file, function) of every call of a Python function of the package while `function` runs."""
    calls, depth = [], 0

    def note(frame, event, _):
        nonlocal depth
        file = frame.f_code.co_filename
        if not file.startswith(PACKAGE) or frame.f_code.co_name == "<module>":
            return
        if event == "call":
            calls.append((depth, str(Path(file).relative_to(PACKAGE)), frame.f_code.co_name))
            depth += 1
        elif event == "return":
            depth -= 1

    sys.setprofile(note)
    try:
        function()
    finally:
        sys.setprofile(None)
    return calls


def changes_of_file(calls) -> int:
    """How often the file of a call is another than that of the call before it."""
    return sum(one[1] != other[1] for one, other in zip(calls, calls[1:]))


def first_step() -> list[tuple[int, str, str]]:
    """The calls of a first step, after one warm run."""
    dc.simulate(dc.lattice_in_box(100), steps=1, solver=dc.PGS())
    scene, results = dc.lattice_in_box(100), []
    # The result is kept, because its release comes after the step.
    return calls_of(lambda: results.append(dc.simulate(scene, steps=1, solver=dc.PGS())))


def step_of_simulator() -> list[tuple[int, str, str]]:
    """The calls of a `Simulator.step`, after two warm steps."""
    live = dc.Simulator(dc.lattice_in_box(100), solver=dc.PGS())
    live.step()
    live.step()
    return calls_of(live.step)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true")
    arguments = parser.parse_args()
    for name, calls in (("first step", first_step()), ("Simulator.step", step_of_simulator())):
        functions = {call[1:] for call in calls}
        files = list(dict.fromkeys(file for _, file, _ in calls))
        print(f"{name}: {len(calls)} calls of {len(functions)} functions, {changes_of_file(calls)} changes of file")
        print(f"  {len(files)} files: {', '.join(files)}")
        if arguments.list:
            for depth, file, function in calls:
                print(f"  {'  ' * depth}{function}  ({file})")


if __name__ == "__main__":
    main()
