"""The pages of the public names: one a task, with a table of the arguments in place of their paragraph.

`docs/hooks.py` makes the pages of `TASKS`; mkdocstrings lets `Arguments` change each docstring (mkdocs.yml).
"""

import re

import griffe

from deep_contact.state import constants, scales

TASKS = {
    "Make a scene": (
        "World State make_bodies Bodies Contacts circles_in_box lattice_in_box column hopper drum terrain barrel "
        "drifting_circles single_body two_bodies find_contacts ContactScales BOX2D"
    ),
    "Run it": (
        "simulate simulate_many step Simulation Trajectory plan recommend PGS BatchedPGS PSOR NNCG NesterovPGS"
    ),
    "Run it live": "Simulator",
    "Measure": (
        "forces stress mean_stress coordination neighbours contact_table measure_trade load_trade experiments peers"
    ),
    "Solve one step": "solve_contacts solve_exactly force_bounds warm_start analysis solvers sph",
    "Networks": "load_model cnn",
    "Files": "read_state write_state load_trajectory sample_file",
    "Pictures": "film plotting figures results",
}
"""Task -> the public names that serve it, each once. Modules among them have pages of their own."""

SYNONYMS = {
    "materials.md": (
        "two materials, per-body friction, friction matrix, contact properties, collision filter, collision group, layer, "
        "mask, category, trigger, sensor, rolling resistance, rolling friction, angle of repose"
    ),
    "moving.md": "moving wall, piston, conveyor, belt, kinematic, paddle, roller, shear cell, moving boundary, motor",
    "recipes.md": "callback, hook, video, movie, animation, player, csv, observer, checkpoint, stop condition",
    "forces.md": "force, energy, pressure, load cell, contact force, dissipation, momentum",
    "api/make_a_scene.md": "gravity, friction, density, mass, coefficient of restitution, radius, polydisperse",
    "absent.md": (
        "GPU, CUDA, periodic, 3d, sphere, polygon, capsule, spring, joint, hinge, distance constraint, cohesion, fluid, "
        "differentiable, gradient, soft body, rope"
    ),
    "gallery/other_programs.md": "vtk, ParaView, OVITO, xyz, pandas, polars, dataframe, export, LAMMPS, ASE, vtu, pvd",
}
"""Page -> words by which people look for it, and which its text may not have. The search ranks them above all texts."""

COMMON = {
    "state": "the scene, or the state of a run: a `State`",
    "scene": "a scene, or the state of a run: a `State`",
    "states": "scenes, or states of runs",
    "solver": "options such as `PGS(sweeps=…)`",
    "path": "of the file",
    "steps": "number of time steps",
    "n_bodies": "number of circles",
    "radius": "of the circles, m; (smallest, largest) where they differ",
    "seed": "of the random numbers, an integer >= 0, or a `numpy.random.Generator`",
    "density": "kg/m²",
    "size": "width and height of the box, m",
    "world": "fields of `World`, such as friction",
    "options": "as of the function that it calls, and fields of `World`",
    "name": "what it is called",
    "friction": "Coulomb's μ",
    "spacing": "of the cells or nodes, m",
    "bodies": "of `make_bodies`",
    "dt": "time step, s; by default the state's",
    "accuracy": "a preset by its name, or a measured trade, as of `simulate`",
    "warm_start": "name of a start, a function, or a network, as of `simulate`",
    "sleep": "whether still islands are left as they are, as of `simulate`",
    "record": "keep one state in so many steps, as of `simulate`",
    "forces": "whether to add up what walls and segments receive, as of `simulate`",
    "push": "forces on the circles beside gravity, N, as of `simulate`",
    "gravity": "(g_x, g_y), m/s²",
    "restitution": "Newton's e, 0 to 1",
    "segments": "pairs of points, ((x, y), (x, y)), m, as of `World`",
    "segment_velocities": "of both ends of each segment, m/s, as of `World`",
    "which": "indices of circles, or a flag for each",
    "fps": "frames a second",
    "circle": "number of a circle",
    "spin": "angular velocity, counter-clockwise, rad/s",
    "mass": "kg; by default of the density",
    "rows": "of circles, one above the other",
    "columns": "of circles, side by side",
    "height": "of the lowest point above the floor, m",
    "speed": "m/s",
    "changes": "fields by name",
    "residual": "largest one that is accepted, m/s",
    "contacts": "of `find_contacts`; None before a search for contacts",
    "time": "of the scene, s",
    "step": "number of steps so far",
    "solved": "whether the contacts have the impulses of the step that begins here",
    "load": "for which the impulses were solved (`starts.load.Load`); None if it is unknown",
    "preset": "name of the preset that chose the solver",
    "stored": "content of the run's file",
    "rolling_friction": "ρ, m, as of `World`",
    "every": "1 for each of them, 2 for every second one, and so on",
    "threads": "number of threads",
    "slop": "as a multiple of that of the scene",
    "bias": "share of the penetration that a step removes",
    "ax": "axes to draw in",
    "figure": "of `plotting.subplots`",
    "title": "text above the picture",
    "names": "of what the picture shows",
    "data": "result of `compare_starts`",
    "over": "name of the start by whose θ the others are divided",
    "count": "number of colours",
    "x": "quantity, or numbers, of the horizontal axis",
    "y": "quantity of the vertical axis",
    "x_unit": "unit of the horizontal axis",
    "y_unit": "unit of the vertical axis",
    "middle": "numbers of the curve",
    "low": "lower end of the interval",
    "high": "upper end of the interval",
    "value": "a number > 0",
    "colours": "RGBA, 0 to 1, (…, 4)",
    "results": "of a script, as in its results file",
    "id": 'number of a figure or table, such as "3.7" or "T 5.1"',
    "claim": "of a results file",
}
"""Argument -> its meaning where a docstring leaves it to the reader."""


def page_of(task: str) -> str:
    """The file of a task's page, without its ending."""
    return task.lower().replace(" ", "_")


def split(text: str, names: list[str]) -> tuple[str, dict[str, str]]:
    """The text of a docstring without its sentences on arguments, a line of dashes in their place; name -> meaning."""
    item = re.compile(rf"(?:^|(?<=[.;)] ))((?:{'|'.join(map(re.escape, names))})(?:, \w+)*): ")
    paragraphs, about = [], {}
    for paragraph in text.split("\n\n"):
        line = paragraph if paragraph.lstrip().startswith(("|", "*", "-")) else " ".join(paragraph.split())
        found = list(item.finditer(line))
        if not found:
            paragraphs.append(paragraph)
            continue
        tail = re.search(r"(?<=\. )(?:Raises|Returns|Return) [A-Z]?\w.*", line[found[-1].start() :])
        end = found[-1].start() + tail.start() if tail else len(line)
        for one, following in zip(found, [match.start() for match in found[1:]] + [end]):
            for name in one[1].split(", "):
                about.setdefault(name, line[one.end() : following].strip().rstrip("."))
        paragraphs += [line[: found[0].start()].strip(), "---", line[end:].strip()]
    return "\n\n".join(filter(None, paragraphs)), about


def documented(text: str, parameters, bases=()) -> str:
    """A docstring with a table of the arguments.

    bases: docstrings of the classes from which a class inherits arguments, the nearest first. They say what an argument
    means that the docstring leaves out, or of which it says "see `Base`".
    """
    shown = [one for one in parameters if one.name not in ("self", "cls")]
    names = [one.name for one in shown]
    rest, about = split(text, names) if shown else (text, {})
    about = {name: meaning for name, meaning in about.items() if not re.search(r"\bsee `\w+`$", meaning)}
    for base in bases:
        about = split(base, names)[1] | about
    rows = []
    for one in shown:
        stars = {"variadic positional": "*", "variadic keyword": "**"}.get(str(one.kind and one.kind.value), "")
        meaning = (about.get(one.name) or COMMON.get(one.name, "")).replace("|", "\\|")
        default = "" if one.default is None or stars else f"`{_value(str(one.default))}`"
        kind = f"`{str(one.annotation).replace(' | ', ' or ')}`" if one.annotation is not None else ""
        rows.append(f"| `{stars}{one.name}` | {meaning} | {kind} | {default} |\n")
    table = f"| Argument | Meaning | Type | Default |\n| --- | --- | --- | --- |\n{''.join(rows)}" if rows else ""
    first, _, others = rest.partition("\n\n---")
    return "\n\n".join(filter(None, (first.strip(), table, others.replace("\n\n---", "").strip())))


def _value(text: str) -> str:
    text = repr(scales.FOLLOWS_SCENE) if text == "FOLLOWS_SCENE" else text
    return re.sub(r"constants\.(\w+)", lambda name: repr(getattr(constants, name[1])), text)


class Arguments(griffe.Extension):
    """Puts a table of the arguments into the docstrings of public functions and classes."""

    def __init__(self):
        super().__init__()
        self._made = []

    def on_package(self, *, pkg, **kwargs) -> None:
        self._change(pkg)
        for member, text in self._made:
            member.docstring.value = text

    def _change(self, module) -> None:
        """Make the docstrings of a module. They are kept until all are made: a class reads those of its bases."""
        for name, member in module.members.items():
            if member.is_alias or name.startswith("_"):
                continue
            if member.is_module or member.is_class:
                self._change(member)
            has_table = member.docstring and "| field" in member.docstring.value
            if member.docstring and (member.is_function or (member.is_class and not has_table)):
                bases = [one.docstring.value for one in member.mro() if one.docstring] if member.is_class else ()
                made = documented(member.docstring.value, list(member.parameters), bases)
                self._made.append((member, made))
