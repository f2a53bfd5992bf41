"""States as XML files, one file a step (thesis, section 5.2.1): `read_state`, `write_state`, `state_path`.

Canonical form, written by `write_state` (one element a line, floats by `repr`: the round trip is exact)::

    <configuration name time step dt gravity_x gravity_y friction restitution solved>
      <solver method …options/>
      <scales slop wall_skin …/>
      <bodies>
        <body index type="free">
          <mass value/> <position x y/> <velocity x y/> <orientation theta/> <inertia value/> <spin omega/>
          <shape value="circle" radius/>
        </body> …
        <body index type="fixed"> … <shape value="box"> <corner x y/> four times </shape> </body>
      </bodies>
      <segments> <segment index x_0 y_0 x_1 y_1 speed/> … </segments>
      <contacts>
        <contact index master slave separation>
          <position x y/> <normal x y/> <impulse n t/> <start n t/>
        </contact> …
      </contacts>
    </configuration>

* `master` and `slave` are `body_a` and `body_b` of `deep_contact.state`. The box is one fixed body, numbered after the
  circles. A contact's normal tells which wall is meant: the one whose normal is nearest in direction. Static segments
  are numbered after the box; `speed` is left out where their surface rests.
* `<solver>` is left out where `State.solver` is None, `<scales>` where `World.scales` is (they follow the scene),
  `<segments>` where there are none, and `<contacts>` where no contacts have been searched for yet.
* The inertia is written for other readers, and checked on reading: only solid discs, m r²/2, are modelled.

Two older dialects are read as well, and the first is written by `write_state(…, dialect="pybox2d")`, for the readers of
the thesis's authors:

* pybox2d exports with `velocity vx vy`, `angle theta`, `angular_velocity omega`, `normal nx ny`, `impulse ni ti` and
  shapes printed as `dcCircleShape(radius=1)`, `dcLoopShape(vertices=[(30, 0), …])`, the box as body 0 and the master of
  its contacts; `vel_iter`, `vel_thres` and `pos_iter` of the root are `State.solver`, a PGS;
* exports with bodies and contacts directly under the root (also spelt `Configuration`), normals printed as
  `b2Vec2(-1,2.9819e-05)` and shapes as `master_shape`, `slave_shape` of the contacts.

Only these gaps of an old file are filled: settings by the thesis's values (`constants`); the step by the number that
ends the file name, else 0; starts by zero; impulses, if no contact has them, by the starts, with `solved=False`; the
separation by the geometry; a radius by the shape that a contact prints, else by sqrt(2 I / m); the box, if the file
has none or calls it `ground`, by the thesis's 30 × 30 box, if all centres are inside. A contact whose master comes
after its slave (the box comes after all circles) is turned round: n, t and the relative velocity flip together, so the
impulses keep their signs.

Shapes are parsed, never evaluated. Every fault of a file is a `StateFileError` that names file, line, element and
value. `xml_tree` says which files are refused before they are parsed.
"""

from __future__ import annotations

import dataclasses
import gzip
import itertools
import math
import re
from pathlib import Path

import numpy as np

from deep_contact.constants import WALL_SKIN
from deep_contact.io.files import read_bytes, replacing
from deep_contact.io.xml_tree import (
    INTEGER,
    MAX_BYTES,
    Rows,
    StateFileError,
    children,
    expect,
    fault,
    parse_tree,
    read_integer,
    read_number,
    read_text,
    refuse_attributes,
    refuse_too_large,
    to_float,
)
from deep_contact.physics.solvers import METHODS, PGS, solver_from
from deep_contact.scales import ContactScales, mean
from deep_contact.state import WALL_NORMALS, WALLS, Bodies, Contacts, State, World, check_state, no_contacts
from deep_contact.validation import integer, one_of

INERTIA_TOLERANCE = 1e-3
"""Largest relative difference between a stored inertia and m r²/2. Old files hold float32."""

_UNIT_TOLERANCE = 1e-4
_MAX_TEXT = 1000

_SETTINGS = ("step", "gravity_x", "gravity_y", "friction", "restitution", "solved")
_ROOT_ATTRIBUTES = {"name", "time", "dt", *_SETTINGS, "vel_iter", "pos_iter", "vel_thres", "pos_thres"}
_MOTION_TAGS = {"velocity", "orientation", "angle", "spin", "angular_velocity"}
_MOTION_ATTRIBUTES = ("x", "y", "vx", "vy", "theta", "omega")
_BODY_TAGS = {"mass", "position", "inertia", "shape", *_MOTION_TAGS}
_ENDS = ("x_0", "y_0", "x_1", "y_1")
_CONTACT_TAGS = {"position", "normal", "impulse", "start"}
_CONTACT_ATTRIBUTES = {"index", "master", "slave", "separation", "master_shape", "slave_shape"}

_NUMBER = r"([0-9.eE+\-]+)"
_PAIR = re.compile(rf"\({_NUMBER},{_NUMBER}\)")
_VECTOR = re.compile(rf"b2Vec2\({_NUMBER},{_NUMBER}\)")
_PRINTED_CIRCLE = re.compile(rf"(?:dc|b2)CircleShape\((?:.*,)?radius[=:]{_NUMBER},?(?:[a-z].*)?\)")
_PRINTED_LOOP = re.compile(r"(?:dcLoop|b2Loop|b2Chain)Shape\((?:.*,)?vertices[=:]\[([^\]]*)\].*\)")
_PRINTED_CENTRE = re.compile(r"[(,]pos[=:](?!b2Vec2\(-?0,-?0\)|\(-?0(?:\.0)?,-?0(?:\.0)?\))")
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_ESCAPES = {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\t": "&#9;", "\n": "&#10;", "\r": "&#13;"}

_BODY_TEXT = """\
    <body index="%d" type="free">
      <mass value="%r"/>
      <position x="%r" y="%r"/>
      <velocity x="%r" y="%r"/>
      <orientation theta="%r"/>
      <inertia value="%r"/>
      <spin omega="%r"/>
      <shape value="circle" radius="%r"/>
    </body>
"""
_CORNERS = '<shape value="box">\n' + 4 * '        <corner x="%r" y="%r"/>\n' + "      </shape>"
_BOX_TEXT = _BODY_TEXT.replace("free", "fixed").replace('<shape value="circle" radius="%r"/>', _CORNERS)
_SEGMENT_TEXT = '    <segment index="%d" x_0="%r" y_0="%r" x_1="%r" y_1="%r"%s/>\n'
_CONTACT_TEXT = """\
    <contact index="%d" master="%d" slave="%d" separation="%r">
      <position x="%r" y="%r"/>
      <normal x="%r" y="%r"/>
      <impulse n="%r" t="%r"/>
      <start n="%r" t="%r"/>
    </contact>
"""


_PYBOX2D_BODY = """\
    <body index="%d" type="free">
      <mass value="%r"/>
      <inertia value="%r"/>
      <position x="%r" y="%r"/>
      <velocity vx="%r" vy="%r"/>
      <angle theta="%r"/>
      <angular_velocity omega="%r"/>
      <shape value="dcCircleShape(radius=%r)"/>
    </body>
"""
_PYBOX2D_BOX = _PYBOX2D_BODY.replace("free", "fixed").replace("dcCircleShape(radius=%r)", "dcLoopShape(vertices=%s)")
_PYBOX2D_CONTACT = """\
    <contact index="%d" master="%d" slave="%d">
      <position x="%r" y="%r"/>
      <normal nx="%r" ny="%r"/>
      <impulse ni="%r" ti="%r"/>
    </contact>
"""
_POSITION_THRESHOLD = 2e-5
"""`pos_thres` of the authors' generator, m; the engine has none, and so writes theirs."""


def read_state(path) -> State:
    """The state in a file `….xml` or `….xml.gz`, in canonical form or an older dialect (module docstring).

    Raises StateFileError naming file, line, element and value, and OSError where the file cannot be opened.
    """
    path = Path(path)
    try:
        data = read_bytes(path, MAX_BYTES)
    except ValueError as error:
        raise StateFileError(str(error)) from None
    return parse_state(data, path)


def write_state(path, state: State, *, dialect: str = "canonical") -> None:
    """Write a state to `….xml`, or compressed to `….xml.gz`; the same state gives the same bytes.

    dialect: "canonical", or "pybox2d" (`format_pybox2d`). The folder is made if it is missing. The file appears
    whole or not at all. Raises StateFileError where the name ends in something else, or the state is not valid or
    cannot be stored; OSError where the file cannot be written.
    """
    path = Path(path)
    if not path.name.endswith((".xml", ".xml.gz")):
        raise StateFileError(f"{path}: not written: expected a name that ends in .xml or .xml.gz, got {path.name!r}")
    try:
        data = DIALECTS[one_of("dialect", dialect, DIALECTS)](state)
    except ValueError as error:
        raise StateFileError(f"{path}: not written: {error}") from None
    if path.suffix == ".gz":
        # Neither time nor name go into the header, so that the same state gives the same file.
        data = gzip.compress(data, compresslevel=6, mtime=0)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def state_path(folder, name: str, step: int, *, gz: bool = False) -> Path:
    """Where the files of a simulation lie: `<folder>/<name>/<name>_<step>.xml`, or `.xml.gz`.

    Raises ValueError unless the name is a file name and the step an integer >= 0.
    """
    if not isinstance(name, str) or name in ("", ".", "..") or re.search(r"[/\\\x00-\x1f]", name):
        raise ValueError(f"name: expected a file name without separators, got {name!r}")
    return Path(folder) / name / f"{name}_{integer('step', step)}.xml{'.gz' if gz else ''}"


def format_state(state: State) -> bytes:
    """A state in canonical form, UTF-8. Raises ValueError naming the field that cannot be stored."""
    state = check_state(state)
    step = integer("step", state.step, most=10**18 - 1)
    world, bodies = state.world, state.bodies
    text = "".join(
        (
            '<?xml version="1.0" encoding="UTF-8"?>\n',
            f'<configuration name="{_escape("name", state.name)}" time="{float(state.time)!r}"',
            f' step="{step}" dt="{float(state.dt)!r}"',
            f' gravity_x="{world.gravity[0]!r}" gravity_y="{world.gravity[1]!r}"',
            f' friction="{world.friction!r}" restitution="{world.restitution!r}"',
            f' solved="{"true" if state.solved else "false"}">\n',
            _format_solver(state.solver),
            _format_scales(world.scales),
            "  <bodies>\n",
            _format_bodies(bodies, world.box),
            "  </bodies>\n",
            _format_segments(world, bodies.count),
            "" if state.contacts is None else _format_contacts(state.contacts, bodies.count),
            "</configuration>\n",
        )
    )
    data = text.encode("utf-8")
    refuse_too_large(data)
    return data


def format_pybox2d(state: State) -> bytes:
    """A solved state as the thesis's authors exported it (module docstring), UTF-8.

    That dialect has no gravity, friction, restitution, separations or starts, and reads the step off the file's name:
    they are lost. Raises ValueError naming the field that cannot be stored: `solved`, where contacts have no solution;
    `segments`, where there are any.
    """
    state = check_state(state)
    contacts, solver, segments = state.contacts, state.solver, state.world.segments
    if segments:
        raise ValueError(f"segments: expected none, since the dialect has no place for them, got {len(segments)}")
    if contacts is not None and contacts.count and not state.solved:
        raise ValueError("solved: expected True, since the dialect has no place for starts, got False")
    settings = ""
    if type(solver) is PGS and isinstance(solver.tolerance, float):
        settings = f' vel_iter="{solver.sweeps}" vel_thres="{solver.tolerance!r}"'
        settings += f' pos_iter="{solver.position_sweeps}" pos_thres="{_POSITION_THRESHOLD!r}"'
    bodies, n = state.bodies, state.bodies.count
    zeros = (0.0,) * 8
    columns = (bodies.mass, _inertia(bodies), *bodies.position.T, *bodies.velocity.T, bodies.angle, bodies.spin)
    text = '<?xml version="1.0" encoding="UTF-8"?>\n'
    text += f'<configuration dt="{float(state.dt)!r}" name="{_escape("name", state.name)}"{settings}'
    text += f' time="{float(state.time)!r}">\n  <bodies>\n'
    text += _PYBOX2D_BOX % (0, *zeros, _corners(state.world.box))
    text += _fill(_PYBOX2D_BODY, n, (range(1, n + 1), *columns, bodies.radius)) + "  </bodies>\n"
    if contacts is not None:
        wall = contacts.body_b >= n
        master, slave = np.where(wall, 0, contacts.body_a + 1), np.where(wall, contacts.body_a, contacts.body_b) + 1
        normal = np.where(wall[:, None], -contacts.normal, contacts.normal)
        impulses = contacts.normal_impulse, contacts.tangent_impulse
        rows = (range(contacts.count), master, slave, *contacts.position.T, *normal.T, *impulses)
        text += f"  <contacts>\n{_fill(_PYBOX2D_CONTACT, contacts.count, rows)}  </contacts>\n"
    data = (text + "</configuration>\n").encode("utf-8")
    refuse_too_large(data)
    return data


DIALECTS = {"canonical": format_state, "pybox2d": format_pybox2d}


def parse_state(data: bytes, source) -> State:
    """The state in the bytes of an (unpacked) XML file; `source`, its path or name, is what messages call it.

    Raises StateFileError naming source, line, element and value.
    """
    try:
        return _read_tree(parse_tree(data), str(source))
    except StateFileError as error:
        raise StateFileError(f"{source}, {error}") from None


def _read_tree(root, source: str) -> State:
    expect(root.tag in ("configuration", "Configuration"), root, "expected the root <configuration>", root.tag)
    # An old file has none of our settings, a canonical one has all: a damaged canonical file must not pass for old.
    canonical = any(name in root.attrib for name in _SETTINGS)
    settings, world = _read_settings(root, source, canonical)
    containers, bodies, contacts = _sort_elements(root)
    if "solver" in containers:
        settings["solver"] = _read_solver(containers["solver"])
    if "scales" in containers:
        expect(canonical, containers["scales"], "expected no scales in an old file")
        world["scales"] = _read_scales(containers["scales"])
    circles, box_body, rank = _number_bodies(bodies)
    if "segments" in containers:
        expect(canonical, containers["segments"], "expected no segments in an old file")
        world |= _read_segments(containers["segments"], rank)
    printed = {} if canonical else _printed_shapes(contacts)
    bodies = _read_bodies(Rows(circles, _BODY_TAGS), printed)
    box = _read_box(root, box_body, bodies, printed, canonical)
    found, solved = None, False
    if "contacts" in containers or contacts or not (canonical or "bodies" in containers):
        found, solved = _read_contacts(Rows(contacts, _CONTACT_TAGS), bodies, box, rank, canonical)
    try:
        state = State(world=World(box=box, **world), bodies=bodies, contacts=found, **{"solved": solved} | settings)
        return check_state(state)
    except ValueError as error:
        raise fault(root, str(error)) from None


def _sort_elements(root):
    """Containers by tag, and all bodies and contacts, whether in containers or directly under the root."""
    others = (child for child in root if child.tag not in ("body", "contact"))
    containers, sorted_elements = children(others, {"solver", "scales", "bodies", "segments", "contacts"}), []
    for container, tag in (("bodies", "body"), ("contacts", "contact")):
        elements = root.findall(tag)
        if container in containers:
            element = containers[container]
            expect(not elements, root, f"expected every <{tag}> inside <{container}>")
            refuse_attributes(element, {"count"})
            count = element.get("count", str(len(element)))  # a claim to be checked, never to be believed
            expect(count == str(len(element)), element, f"count: expected {len(element)}, as there are", count)
            elements = list(element)
            for child in elements:
                expect(child.tag == tag, child, f"expected a <{tag}> here", child.tag)
        sorted_elements.append(elements)
    return containers, *sorted_elements


# ---- reading: settings ----


def _read_settings(root, source: str, canonical: bool) -> tuple[dict, dict]:
    """Fields of the state, and of its world."""
    refuse_attributes(root, _ROOT_ATTRIBUTES)
    settings = {"name": read_text(root, "name"), "time": read_number(root, "time")}
    if canonical or "dt" in root.attrib:
        settings["dt"] = read_number(root, "dt")
    if not canonical:
        if all(name in root.attrib for name in ("vel_iter", "vel_thres", "pos_iter")):
            settings["solver"] = _printed_solver(root)
        number = re.search(r"(?:^|[_/\\])([0-9]{1,18})\.xml(?:\.gz)?$", source)
        return settings | {"step": int(number[1]) if number else 0}, {}
    solved = read_text(root, "solved")
    expect(solved in ("true", "false"), root, "solved: expected true or false", solved)
    world = {name: read_number(root, name) for name in ("friction", "restitution")}
    world["gravity"] = read_number(root, "gravity_x"), read_number(root, "gravity_y")
    return settings | {"step": read_integer(root, "step"), "solved": solved == "true"}, world


def _read_solver(element):
    method = read_text(element, "method")
    options = {name: _option_value(text) for name, text in element.items() if name != "method"}
    try:
        return solver_from(method, options)
    except (TypeError, ValueError) as error:
        raise fault(element, f"expected a method and its options: {str(error)[:200]}", str(options)) from None


def _printed_solver(root) -> PGS:
    """The settings of the authors' solver: sweeps and threshold of velocities, sweeps of positions."""
    counts = {"sweeps": read_integer(root, "vel_iter"), "position_sweeps": read_integer(root, "pos_iter")}
    try:
        return PGS(tolerance=read_number(root, "vel_thres"), **counts)
    except ValueError as error:
        raise fault(root, f"expected options of PGS: {error}", str(counts)) from None


def _read_scales(element) -> ContactScales:
    refuse_attributes(element, set(ContactScales._fields))
    return ContactScales(*(read_number(element, name) for name in ContactScales._fields))


def _read_segments(element, rank: dict) -> dict:
    """Segments and speeds of a world, by index; the indices are added to `rank`, behind circles and box."""
    found, speeds = {}, {}
    for segment in element:
        expect(segment.tag == "segment", segment, "expected a <segment> here", segment.tag)
        refuse_attributes(segment, {"index", *_ENDS, "speed"})
        index = read_integer(segment, "index")
        expect(index not in rank and index not in found, segment, "index: expected each once, got", str(index))
        found[index] = tuple(read_number(segment, name) for name in _ENDS)
        speeds[index] = read_number(segment, "speed") if "speed" in segment.attrib else 0.0
    rank.update({index: len(rank) + k for k, index in enumerate(sorted(found))})
    return {"segments": [found[i] for i in sorted(found)], "surface_speeds": [speeds[i] for i in sorted(found)]}


def _option_value(text: str):
    """None, a bool, an int, a float or a str, by how it looks; `_option_text` makes sure of the inverse."""
    if text in ("none", "true", "false"):
        return {"none": None, "true": True, "false": False}[text]
    if INTEGER.fullmatch(text):
        return int(text)
    number = to_float(text)
    return number if math.isfinite(number) else text


def _option_text(name: str, value) -> str:
    value = value.item() if isinstance(value, np.generic) else value
    text = value if isinstance(value, str) else repr(value).lower()
    back = _option_value(text)
    if type(back) is not type(value) or back != value:
        expected = "None, a bool, an integer of at most 18 digits, a finite number or a word"
        raise ValueError(f"solver.{name}: expected {expected}, got {value!r}")
    return _escape(f"solver.{name}", text)


# ---- reading: bodies ----


def _number_bodies(bodies):
    """Circles in the order of their indices, the fixed body or None, {index in the file: index in memory}."""
    free, fixed = {}, {}
    for body in bodies:
        refuse_attributes(body, {"index", "type"})
        index, kind = read_integer(body, "index"), read_text(body, "type")
        duplicate = index in free or index in fixed
        expect(not duplicate, body, "index: expected each once, got a duplicate of", str(index))
        expect(kind in ("free", "fixed"), body, "type: expected free or fixed", kind)
        expect(kind == "free" or not fixed, body, "expected one fixed body, the box, got a second")
        (free if kind == "free" else fixed)[index] = body
    order = sorted(free)
    for index, following in zip(order, order[1:]):
        near = following == index + 1 or (following == index + 2 and index + 1 in fixed)
        expect(near, free[following], f"index: expected no gap, there is no {index + 1}", str(following))
    rank = {index: i for i, index in enumerate([*order, *fixed])}
    return [free[index] for index in order], next(iter(fixed.values()), None), rank


def _read_bodies(rows: Rows, printed: dict) -> Bodies:
    mass = rows.numbers("mass value")
    rows.refuse(mass <= 0, "mass value", "a mass > 0")
    # m r²/2 of a disc may overflow where m and r do not; "inf" is then what was written.
    inertia = np.array([math.inf if text == "inf" else to_float(text) for _, _, text in rows.column("inertia value")])
    rows.refuse(np.isnan(inertia), "inertia value", "a finite number")
    radius = np.array([_radius(*row, printed) for row in zip(rows.elements, rows.parts)], dtype=np.float64)
    # Nothing in the file says how large the other circles are, but a solid disc's inertia does.
    with np.errstate(all="ignore"):
        radius = np.where(np.isnan(radius), np.sqrt(2 * inertia / mass), radius)
    bad = ~(np.isfinite(radius) & (radius > 0))
    rows.refuse(bad, "inertia value", "m r²/2 > 0, as the shape has no radius")
    bodies = Bodies(
        position=rows.vectors("position x", "position y"),
        velocity=rows.vectors("velocity x|velocity vx", "velocity y|velocity vy"),
        angle=rows.numbers("orientation theta|angle theta"),
        spin=rows.numbers("spin omega|angular_velocity omega"),
        mass=mass,
        radius=radius,
    )
    disc = _inertia(bodies)
    with np.errstate(all="ignore"):
        wrong = ~((inertia == disc) | (np.abs(inertia - disc) <= INERTIA_TOLERANCE * disc))
    expected = float(disc[np.argmax(wrong)]) if wrong.any() else 0.0
    rows.refuse(wrong, "inertia value", f"m r²/2 = {expected!r} (only solid discs are modelled)")
    return bodies


def _inertia(bodies: Bodies) -> np.ndarray:
    """m r²/2. In this order an extreme mass and radius give 0 or inf, never the nan of 0 times inf."""
    with np.errstate(over="ignore", under="ignore"):
        return 0.5 * (bodies.mass * bodies.radius) * bodies.radius


def _radius(body, parts: dict, printed: dict) -> float:
    """Radius of a circle, NaN where neither its shape nor a contact tells."""
    element, text = _shape(body, parts)
    if text == "circle" and "radius" in element.attrib:
        text, radius = element.get("radius"), read_number(element, "radius")
    else:
        if text == "circle":
            if read_integer(body, "index") not in printed:
                return math.nan
            element, text = printed[read_integer(body, "index")]
        compact = _compact(element, text)
        match = _PRINTED_CIRCLE.fullmatch(compact)
        radius = to_float(match[1]) if match else math.nan
        fits = math.isfinite(radius) and not _PRINTED_CENTRE.search(compact)
        expect(fits, element, "shape: expected circle, or CircleShape(radius=…) around the centre", text)
    expect(radius > 0, element, "radius: expected a number > 0", text)
    return radius


def _shape(body, parts: dict):
    """The shape of a body, and what it says."""
    expect("shape" in parts, body, "element <shape> is missing")
    shape = parts["shape"]
    return shape, shape.get("value", shape.text or "").strip()


def _compact(element, text: str) -> str:
    expect(len(text) <= _MAX_TEXT, element, f"expected at most {_MAX_TEXT} characters", text)
    return "".join(text.split())


def _printed_shapes(contacts) -> dict:
    """{index in the file: (contact, text)} of the shapes that contacts print, the first of each body."""
    printed = {}
    for contact in contacts:
        for role in ("master", "slave"):
            text = contact.get(f"{role}_shape")
            if text is not None:
                printed.setdefault(read_integer(contact, role), (contact, text))
    return printed


def _read_box(root, body, bodies: Bodies, printed: dict, canonical: bool) -> tuple:
    """(x_min, y_min, x_max, y_max)"""
    if body is None:
        expect(not canonical, root, "expected a fixed body, the box")
        return _thesis_box(root, bodies)
    parts = children(body, _BODY_TAGS)
    for tag in _MOTION_TAGS & parts.keys():
        for name in _MOTION_ATTRIBUTES:
            still = name not in parts[tag].attrib or read_number(parts[tag], name) == 0
            expect(still, parts[tag], f"{name}: expected 0, the box neither moves nor turns", parts[tag].get(name))
    element, text = _shape(body, parts)
    if text in ("ground", "box") and len(element) == 0 and not canonical:
        element, text = printed.get(read_integer(body, "index"), (element, ""))
        if not _PRINTED_LOOP.fullmatch(_compact(element, text)):
            return _thesis_box(body, bodies)
    if text == "box":
        for corner in element:
            expect(corner.tag == "corner", corner, "expected a <corner> here", corner.tag)
        corners = [(read_number(corner, "x"), read_number(corner, "y")) for corner in element]
    else:
        corners = _printed_vertices(element, text)
    if "position" in parts:
        x, y = (read_number(parts["position"], name) for name in ("x", "y"))
        # Adding 0.0 would turn -0.0 into 0.0.
        corners = [(a + x if x else a, b + y if y else b) for a, b in corners]
    box = tuple(pick(corner[axis] for corner in corners) for pick in (min, max) for axis in (0, 1)) if corners else ()
    upright = len(set(corners)) == 4 and set(corners) == set(_corners(box))
    expect(upright, element, "expected the four corners of an upright box", str(corners))
    return box


def _printed_vertices(element, text: str) -> list:
    match = _PRINTED_LOOP.fullmatch(_compact(element, text))
    corners = [(to_float(x), to_float(y)) for x, y in _PAIR.findall(match[1])] if match else []
    fits = match and not _PAIR.sub("", match[1]).strip(",") and np.isfinite(corners).all()
    expect(fits, element, "shape: expected box with four corners, or LoopShape(vertices=[(x, y), …])", text)
    return corners


def _corners(box) -> list:
    x_min, y_min, x_max, y_max = box
    return [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]


def _thesis_box(element, bodies: Bodies) -> tuple:
    box = World().box
    outside = ((bodies.position < box[:2]) | (bodies.position > box[2:])).any(axis=1)
    if outside.any():
        centre = tuple(bodies.position[np.argmax(outside)].tolist())
        raise fault(element, f"the file has no box, and a circle is outside the thesis's {box}", str(centre))
    return box


# ---- reading: contacts ----


def _read_contacts(rows: Rows, bodies: Bodies, box, rank: dict, canonical: bool):
    """(contacts, whether they hold solved impulses)"""
    if not rows.elements:
        return no_contacts(), True
    n = bodies.count
    first, second = _read_pairs(rows.elements, rank)
    # Box2D puts edges first, so old files have the box as master, its normal pointing at the circle.
    a, b = np.minimum(first, second), np.maximum(first, second)
    normal = _read_normals(rows)
    normal = np.where((first > second)[:, None], -normal, normal)
    wall = b == n
    b[b > n] += len(WALLS) - 1
    b[wall] += _nearest_wall(normal[wall])
    _refuse_twins(rows.elements, a, b, n)
    separation = _separations(a, b, bodies, box)
    for i, element in enumerate(rows.elements):
        if canonical or "separation" in element.attrib:
            separation[i] = read_number(element, "separation")
    position = rows.vectors("position x", "position y")
    start = np.zeros((a.size, 2))
    if rows.have("start", required=canonical):
        start = rows.vectors("start n", "start t")
    impulse, solved, spelling = start, rows.have("impulse", required=canonical), "start n"
    if solved:
        spelling = "impulse n|impulse ni"
        impulse = rows.vectors(spelling, "impulse t|impulse ti")
    rows.refuse(impulse[:, 0] < 0, spelling, "a normal impulse >= 0")
    return Contacts(a, b, position, normal, separation, *impulse.T, *start.T), solved


def _read_pairs(elements, rank: dict):
    """Memory indices of master and slave, the box as n."""
    pairs, seen = [], set()
    for element in elements:
        refuse_attributes(element, _CONTACT_ATTRIBUTES)
        index = read_integer(element, "index")
        expect(index not in seen, element, "index: expected each once, got a duplicate of", element.get("index"))
        seen.add(index)
        for role in ("master", "slave"):
            known = read_integer(element, role) in rank
            expect(known, element, f"{role}: expected the index of a body in the file", element.get(role))
        pairs.append([rank[int(element.get(role))] for role in ("master", "slave")])
        distinct = pairs[-1][0] != pairs[-1][1]
        expect(distinct, element, "slave: expected another body than master", element.get("slave"))
    return np.array(pairs, dtype=np.int64).T


def _read_normals(rows: Rows) -> np.ndarray:
    if "normal" in rows.parts[0] and "normal" in rows.parts[0]["normal"].attrib:
        texts = [_compact(element, text) for element, _, text in rows.column("normal normal")]
        matches = [_VECTOR.fullmatch(text) for text in texts]
        normal = np.array([[to_float(x) for x in match.groups()] if match else [math.nan] * 2 for match in matches])
        rows.refuse(~np.isfinite(normal).all(axis=1), "normal normal", "b2Vec2(x, y)")
    else:
        normal = rows.vectors("normal x|normal nx", "normal y|normal ny")
    with np.errstate(over="ignore"):
        bad = np.abs(np.hypot(*normal.T) - 1) > _UNIT_TOLERANCE
    i = int(np.argmax(bad))
    expect(not bad[i], rows.parts[i]["normal"], "expected a unit vector", str(tuple(normal[i].tolist())))
    return normal


def _nearest_wall(normal: np.ndarray) -> np.ndarray:
    """Walls (BOTTOM … LEFT) nearest in direction to normals (m, 2) from circle to wall."""
    return np.argmax(normal @ WALL_NORMALS.T, axis=1)


def _refuse_twins(elements, a, b, n: int) -> None:
    seen = {}
    for i, pair in enumerate(zip(a.tolist(), b.tolist())):
        if seen.setdefault(pair, i) != i:
            wall = f" ({WALLS[pair[1] - n]} wall)" if n <= pair[1] < n + len(WALLS) else ""
            names = f"{elements[i].get('master')}, {elements[i].get('slave')}"
            first = elements[seen[pair]].get("index")
            raise fault(elements[i], f"expected no second contact of a pair, the first is {first}", names + wall)


def _separations(a, b, bodies: Bodies, box) -> np.ndarray:
    """Gap between the surfaces of the pairs, m. As in the engine, walls begin a skin before the box.

    For old files, which set no scales and have no segments; the canonical form has separations.
    """
    position, radius, n = bodies.position, bodies.radius, bodies.count
    x, y = position[a].T
    other = np.minimum(b, n - 1)
    with np.errstate(all="ignore"):
        skin = WALL_SKIN * mean(radius)
        to_walls = np.stack([y - box[1], box[2] - x, box[3] - y, x - box[0]])  # in the order BOTTOM … LEFT
        to_wall = to_walls[np.clip(b - n, 0, 3), np.arange(a.size)] - radius[a] - skin
        to_circle = np.hypot(*(position[other] - position[a]).T) - radius[a] - radius[other]
    return np.where(b < n, to_circle, to_wall)


# ---- writing ----


def _escape(name: str, text: str) -> str:
    if not isinstance(text, str) or _NOT_XML.search(text):
        raise ValueError(f"{name}: expected text without control characters, got {text!r}")
    return text.translate(str.maketrans(_ESCAPES))


def _format_solver(solver) -> str:
    if solver is None:
        return ""
    method = next((name for name, cls in METHODS.items() if cls is type(solver)), None)
    if method is None:
        raise ValueError(f"solver: expected None or one of {', '.join(sorted(METHODS))}, got {solver!r}")
    options = [(field.name, getattr(solver, field.name)) for field in dataclasses.fields(solver)]
    text = "".join(f' {name}="{_option_text(name, value)}"' for name, value in options)
    return f'  <solver method="{method}"{text}/>\n'


def _format_scales(scales: ContactScales | None) -> str:
    if scales is None:
        return ""
    text = "".join(f' {name}="{value!r}"' for name, value in scales._asdict().items())
    return f"  <scales{text}/>\n"


def _format_bodies(bodies: Bodies, box) -> str:
    columns = (bodies.mass, *bodies.position.T, *bodies.velocity.T, bodies.angle, _inertia(bodies), bodies.spin)
    circles = _fill(_BODY_TEXT, bodies.count, (range(bodies.count), *columns, bodies.radius))
    return circles + _BOX_TEXT % (bodies.count, *(0.0,) * len(columns), *itertools.chain(*_corners(box)))


def _format_segments(world: World, n: int) -> str:
    if not world.segments:
        return ""
    speeds = [f' speed="{v!r}"' if v else "" for v in world.surface_speeds] or [""] * len(world.segments)
    both = enumerate(zip(world.segments, speeds))
    lines = "".join(_SEGMENT_TEXT % (n + 1 + s, *segment, speed) for s, (segment, speed) in both)
    return f"  <segments>\n{lines}  </segments>\n"


def _format_contacts(contacts: Contacts, n: int) -> str:
    behind = contacts.body_b - n
    wall = (behind >= 0) & (behind < len(WALLS))
    told = _nearest_wall(contacts.normal[wall]) == contacts.body_b[wall] - n
    if not told.all():
        i = int(np.flatnonzero(wall)[np.argmin(told)])
        side = WALLS[contacts.body_b[i] - n]
        raise ValueError(f"contacts.normal[{i}]: expected one towards the {side} wall, got {contacts.normal[i]}")
    a, b, position, normal, separation, *impulses = contacts
    slave = np.where(behind < len(WALLS), np.minimum(b, n), b - len(WALLS) + 1)
    columns = (range(contacts.count), a, slave, separation, *position.T, *normal.T, *impulses)
    return f"  <contacts>\n{_fill(_CONTACT_TEXT, contacts.count, columns)}  </contacts>\n"


def _fill(template: str, rows: int, columns) -> str:
    """The template once per row. One call for all rows, on Python numbers, is what makes writing fast."""
    lists = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns]
    return template * rows % tuple(itertools.chain.from_iterable(zip(*lists)))
