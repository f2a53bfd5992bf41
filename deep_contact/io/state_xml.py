"""States as XML files, one file a step (thesis, section 5.2.1): `read_state` and `write_state`.

`write_state` writes the canonical form, which data/README.md describes. `read_state` also reads the dialects of the
thesis's authors (`old_dialects`). Every fault of a file raises a `StateFileError`, which names file, line, element and
value. `xml_tree` lists the files that are refused before they are parsed.
"""

from __future__ import annotations

import dataclasses
import gzip
import itertools
import math

import numpy as np

from deep_contact.io import xml_tree
from deep_contact.io.files import path_of, read_bytes, write_bytes
from deep_contact.io.old_dialects import BODY, CONTACT, modernise
from deep_contact.io.xml_tree import StateFileError, XmlRows, expect, fault, read_integer, read_number, read_text
from deep_contact.solvers import METHODS, solver_from
from deep_contact.state.arrays import SIDES, WALL_NORMALS, Bodies, Contacts, corners, no_contacts
from deep_contact.state.checks import check_state
from deep_contact.state.constants import WALL_SKIN
from deep_contact.state.fields import is_unit
from deep_contact.state.materials import MOST_MATERIALS
from deep_contact.state.scales import ContactScales, mean
from deep_contact.state.state import State
from deep_contact.state.validation import integer
from deep_contact.state.world import World

_INERTIA_TOLERANCE = 1e-3
"""Largest relative difference between a stored inertia and m r²/2. Old files store float32."""

_SETTINGS = ("step", "gravity_x", "gravity_y", "friction", "restitution", "solved")
_PARTS = ("solver", "scales", "materials", "bodies", "segments", "contacts")
_OF_PAIRS = ("friction", "restitution", "rolling_friction")
_ENDS = ("x_0", "y_0", "x_1", "y_1")
_VELOCITIES = ("v_x_0", "v_y_0", "v_x_1", "v_y_1")

_CORNERS = '<shape value="box">\n' + 4 * '        <corner x="%r" y="%r"/>\n' + "      </shape>"
_BODY_TEXT = xml_tree.text_of('body index="%d" type="%s"', BODY, '<shape value="circle" radius="%r"/>')
_MATERIAL_TEXT = xml_tree.text_of(
    'body index="%d" type="%s" material="%d"', BODY, '<shape value="circle" radius="%r"/>'
)
_BOX_TEXT = xml_tree.text_of('body index="%d" type="fixed"', BODY, _CORNERS)
_SEGMENT_TEXT = '    <segment index="%d" x_0="%r" y_0="%r" x_1="%r" y_1="%r"%s/>\n'
_CONTACT_TEXT = xml_tree.text_of('contact index="%d" master="%d" slave="%d" separation="%r"', CONTACT)


def read_state(path) -> State:
    """Read the state in a file `….xml` or `….xml.gz`, in canonical form or an older dialect.

    Raises StateFileError, which names file, line, element and value. Raises OSError if the file cannot be opened.
    """
    return parse_state(read_bytes(path, xml_tree.MAX_BYTES, StateFileError), path)


def write_state(path, state: State) -> None:
    """Write a state to a file `….xml`, or compressed to `….xml.gz`. Equal states give equal bytes.

    The folder is made if it is missing. The file is written in one move. Raises StateFileError if the name has another
    ending, or if the state is not valid or cannot be stored. Raises OSError if the file cannot be written.
    """
    path = path_of(path)
    if not path.name.endswith((".xml", ".xml.gz")):
        raise StateFileError(f"{path}: not written: expected a name that ends in .xml or .xml.gz, got {path.name!r}")
    try:
        data = format_state(state)
        xml_tree.refuse_too_large(data)
    except ValueError as error:
        raise StateFileError(f"{path}: not written: {error}") from None
    if path.suffix == ".gz":
        # The gzip header has neither time nor name, so that equal states give equal files.
        data = gzip.compress(data, compresslevel=6, mtime=0)
    write_bytes(path, data)


def format_state(state: State) -> bytes:
    """Return a state in canonical form as UTF-8 bytes.

    Raises ValueError, which names the field that cannot be stored.
    """
    state = check_state(state)
    world, n = state.world, state.bodies.count
    numbers = {"time": float(state.time), "step": integer("step", state.step, most=10**18 - 1), "dt": float(state.dt)}
    numbers |= {"gravity_x": world.gravity[0], "gravity_y": world.gravity[1]}
    numbers |= {name: _first(getattr(world, name)) for name in ("friction", "restitution")}
    if isinstance(world.rolling_friction, float) and world.rolling_friction > 0.0:
        numbers["rolling_friction"] = world.rolling_friction
    parts = (
        '<?xml version="1.0" encoding="UTF-8"?>\n',
        f"<configuration name={xml_tree.quoted_attribute('name', state.name)}{_attributes(numbers)}",
        f' solved="{"true" if state.solved else "false"}">\n',
        _format_solver(state.solver, state.preset),
        f"  <scales{_attributes(world.scales._asdict())}/>\n" if world.scales else "",
        _format_materials(world),
        _format_bodies(state.bodies, world.box),
        _format_segments(world, n),
        "" if state.contacts is None else _format_contacts(state.contacts, n),
        "</configuration>\n",
    )
    return "".join(parts).encode("utf-8")


def parse_state(data: bytes, source) -> State:
    """Return the state in the bytes of an uncompressed XML file. source: path or name of the file, for messages.

    Raises StateFileError, which names source, line, element and value.
    """
    try:
        return _read_tree(xml_tree.parse_tree(data), str(source))
    except StateFileError as error:
        raise StateFileError(f"{source}, {error}") from None


def _read_tree(root, source: str) -> State:
    expect(root.tag in ("configuration", "Configuration"), root, "expected the root <configuration>", root.tag)
    # A file counts as old only if it has none of the canonical settings. A damaged canonical file, which lacks some of
    # them, is not taken for an old one.
    if is_old := not any(name in root.attrib for name in _SETTINGS):
        modernise(root, source)
    parts = xml_tree.children(root, _PARTS)
    settings, world = _read_settings(root, parts)
    circles, box_body, rank = _number_bodies(xml_tree.elements_of(parts.get("bodies"), "body"), is_old)
    world |= _read_segments(xml_tree.elements_of(parts.get("segments"), "segment"), rank)
    world |= _read_materials(parts.get("materials"))
    bodies = _read_bodies(XmlRows(circles, BODY | {"shape": "value radius"}))
    box = _read_box(root, box_body, bodies, is_old)
    contacts = None
    if "contacts" in parts:
        rows = XmlRows(xml_tree.elements_of(parts["contacts"], "contact"), CONTACT)
        contacts = _read_contacts(rows, bodies, box, rank, is_old)
    try:
        return check_state(State(world=World(box=box, **world), bodies=bodies, contacts=contacts, **settings))
    except ValueError as error:
        raise fault(root, str(error)) from None


# ---- reading: settings ----


def _read_settings(root, parts: dict) -> tuple[dict, dict]:
    """Return (fields of the state, fields of its world)."""
    xml_tree.refuse_attributes(root, {"name", "time", "dt", *_SETTINGS, "rolling_friction"})
    solved = read_text(root, "solved")
    expect(solved in ("true", "false"), root, "solved: expected true or false", solved)
    settings = {"name": read_text(root, "name"), "solved": solved == "true", "step": read_integer(root, "step")}
    settings |= {name: read_number(root, name) for name in ("time", "dt")}
    world = {name: read_number(root, name) for name in ("friction", "restitution")}
    if "rolling_friction" in root.attrib:
        world["rolling_friction"] = read_number(root, "rolling_friction")
    world["gravity"] = tuple(read_number(root, name) for name in ("gravity_x", "gravity_y"))
    if "solver" in parts:
        settings["solver"] = _read_solver(parts["solver"])
        settings["preset"] = parts["solver"].get("preset")
    if "scales" in parts:
        xml_tree.refuse_attributes(parts["scales"], ContactScales._fields)
        world["scales"] = ContactScales(*(read_number(parts["scales"], name) for name in ContactScales._fields))
    return settings, world


def _read_solver(element):
    method = read_text(element, "method")
    options = {name: _option_value(text) for name, text in element.items() if name not in ("method", "preset")}
    try:
        return solver_from(method, options)
    except (TypeError, ValueError) as error:
        raise fault(element, f"expected a method and its options: {str(error)[:200]}", str(options)) from None


def _option_value(text: str):
    """Return the value of a solver's option, None, bool, int, float or str, from its text.

    `_option_text` writes the text, and checks that this function returns the original value.
    """
    if text in ("none", "true", "false"):
        return {"none": None, "true": True, "false": False}[text]
    if xml_tree.INTEGER.fullmatch(text):
        return int(text)
    number = xml_tree.to_float(text)
    return number if math.isfinite(number) else text


def _read_segments(elements, rank: dict) -> dict:
    """Return segments, their materials, surface speeds and velocities, in the order of their indices.

    rank: index of a body in the file -> index in memory. The segments are added to it, after circles and box.
    """
    segments, speeds, velocities, materials, start = [], [], [], [], len(rank)
    for index, segment in sorted(xml_tree.by_index(elements).items()):
        xml_tree.refuse_attributes(segment, {"index", *_ENDS, "speed", *_VELOCITIES, "material"})
        expect(index not in rank, segment, "index: expected each once, got that of a body,", str(index))
        rank[index] = start + len(segments)
        segments.append([read_number(segment, name) for name in _ENDS])
        speeds.append(read_number(segment, "speed") if "speed" in segment.attrib else 0.0)
        is_moving = any(name in segment.attrib for name in _VELOCITIES)
        velocities.append([read_number(segment, name) if is_moving else 0.0 for name in _VELOCITIES])
        materials.append(_material_of(segment))
    motion = {"surface_speeds": speeds, "segment_velocities": velocities}
    return {"segments": segments, "segment_materials": materials, **motion}


def _material_of(element) -> int:
    return read_integer(element, "material") if "material" in element.attrib else 0


def _read_materials(element) -> dict:
    """Return the tables of the world and the materials of its walls. element: that of the materials, or None."""
    if element is None:
        return {}
    xml_tree.refuse_attributes(element, {"count", *SIDES})
    size = read_integer(element, "count")
    expect(1 <= size <= MOST_MATERIALS, element, f"count: expected 1 to {MOST_MATERIALS}", str(size))
    pairs = {}
    for pair in element:
        expect(pair.tag == "pair", pair, "expected a <pair> here", pair.tag)
        xml_tree.refuse_attributes(pair, {"first", "second", *_OF_PAIRS, "touches"})
        p, q = (read_integer(pair, name) for name in ("first", "second"))
        expect(
            0 <= p <= q < size and (p, q) not in pairs, pair, "expected first <= second, each pair once", f"{p}, {q}"
        )
        pairs[p, q] = pairs[q, p] = pair
    world = {"wall_materials": [read_integer(element, side) for side in SIDES]}
    for name in (*_OF_PAIRS, "touches"):
        if any(name in pair.attrib for pair in pairs.values()):
            expect(len(pairs) == size**2, element, f"expected a <pair> for each pair of {size} materials")
            read = _read_flag if name == "touches" else read_number
            world[name] = [[read(pairs[p, q], name) for q in range(size)] for p in range(size)]
    return world


def _read_flag(element, name: str) -> bool:
    text = read_text(element, name)
    expect(text in ("true", "false"), element, f"{name}: expected true or false", text)
    return text == "true"


# ---- reading: bodies ----


def _number_bodies(bodies, is_old: bool):
    """Return (elements of the circles in the order of their indices, element of the box or None, rank).

    rank: index of a body in the file -> index in memory. A fixed body is the box, unless its shape is a circle. is_old:
    whether the file has an old dialect, in which the fixed body always is the box.
    """
    free, fixed = {}, {}
    for index, body in sorted(xml_tree.by_index(bodies).items()):
        xml_tree.refuse_attributes(body, {"index", "type", "material"})
        kind = read_text(body, "type")
        expect(kind in ("free", "fixed"), body, "type: expected free or fixed", kind)
        shape = None if is_old else body.find("shape")
        is_circle = kind == "free" or (shape is not None and shape.get("value") == "circle")
        expect(is_circle or not fixed, body, "expected one fixed body, the box, got a second")
        (free if is_circle else fixed)[index] = body
    for index, following in itertools.pairwise(free):
        near = following == index + 1 or (following == index + 2 and index + 1 in fixed)
        expect(near, free[following], f"index: expected no gap, there is no {index + 1}", str(following))
    rank = {index: i for i, index in enumerate([*free, *fixed])}
    return list(free.values()), next(iter(fixed.values()), None), rank


def _read_bodies(rows: XmlRows) -> Bodies:
    mass, radius = rows.numbers("mass", "value"), rows.numbers("shape", "radius")
    is_fixed = np.array([element.get("type") == "fixed" for element in rows.elements], bool)
    rows.refuse((mass <= 0) & ~is_fixed, "mass", "value", "a mass > 0")
    mass[is_fixed] = math.inf  # in files, fixed circles and the box have mass 0
    rows.refuse(np.array([text != "circle" for text in rows.texts("shape", "value")]), "shape", "value", "circle")
    rows.refuse(radius <= 0, "shape", "radius", "a number > 0")
    motion = [rows.numbers(tag, BODY[tag]) for tag in ("position", "velocity", "orientation", "spin")]
    material = np.array([_material_of(element) for element in rows.elements], np.int64)
    bodies = Bodies(*motion, mass, radius, material)
    # m r²/2 may overflow although m and r do not. The file then has "inf".
    texts = rows.texts("inertia", "value")
    inertia = np.array([math.inf if text == "inf" else xml_tree.to_float(text) for text in texts])
    with np.errstate(all="ignore"):
        disc = bodies.inertia
        wrong = ~np.isclose(inertia, disc, rtol=_INERTIA_TOLERANCE, atol=0.0) & ~is_fixed
    for expected in disc[wrong][:1].tolist():
        rows.refuse(wrong, "inertia", "value", f"m r²/2 = {expected!r} (only solid discs are modelled)")
    return bodies


def _read_box(root, body, bodies: Bodies, is_old: bool) -> tuple:
    """Return the box, (x_min, y_min, x_max, y_max), m, from its element. body: the element, or None."""
    tags = BODY | {"shape": "value"}
    parts = {} if body is None else xml_tree.children(body, tags)
    xml_tree.refuse_attributes_of(parts, tags)
    for tag in ("velocity", "orientation", "spin"):
        for name in (name for name in BODY[tag].split() if tag in parts and name in parts[tag].attrib):
            still = read_number(parts[tag], name) == 0
            expect(still, parts[tag], f"{name}: expected 0, the box neither moves nor turns", parts[tag].get(name))
    shape = parts.get("shape")
    if is_old and (shape is None or len(shape) == 0):
        box = World().box
        outside = ((bodies.position < box[:2]) | (bodies.position > box[2:])).any(axis=1)
        for centre in bodies.position[outside][:1].tolist():
            raise fault(root, f"the file has no box, and a circle is outside the thesis's {box}", str(centre))
        return box
    expect(shape is not None, root, "expected a fixed body, the box, with a shape")
    expect(shape.get("value") == "box", shape, "shape: expected box, with four corners", shape.get("value", ""))
    elements = xml_tree.elements_of(shape, "corner", {"value"})
    for corner in elements:
        xml_tree.refuse_attributes(corner, ("x", "y"))
    found = [(read_number(corner, "x"), read_number(corner, "y")) for corner in elements]
    if "position" in parts:
        x, y = (read_number(parts["position"], name) for name in ("x", "y"))
        # Adding 0.0 would turn -0.0 into 0.0.
        found = [(a + x if x else a, b + y if y else b) for a, b in found]
    box = tuple(pick(corner[axis] for corner in found) for pick in (min, max) for axis in (0, 1)) if found else ()
    upright = len(set(found)) == 4 and set(found) == set(corners(box))
    expect(upright, shape, "expected the four corners of an upright box", str(found))
    return box


# ---- reading: contacts ----


def _read_contacts(rows: XmlRows, bodies: Bodies, box, rank: dict, is_old: bool) -> Contacts:
    if not rows.elements:
        return no_contacts()
    n = bodies.count
    first, second = _read_pairs(rows.elements, rank)
    # In old files the box is the master, as in Box2D, and its normal points to the circle.
    a, b = np.minimum(first, second), np.maximum(first, second)
    for i in np.flatnonzero(a >= n)[:1]:
        raise fault(rows.elements[i], "master, slave: expected a circle among them, got none")
    normal = rows.numbers("normal", "x y")
    rows.refuse(~is_unit(normal), "normal", "x y", "a unit vector")
    normal = np.where((first > second)[:, None], -normal, normal)
    wall = b == n
    b[b > n] += len(SIDES) - 1
    b[wall] += _nearest_wall(normal[wall])
    pairs = {}
    for element, pair in zip(rows.elements, zip(a.tolist(), b.tolist())):
        first = pairs.setdefault(pair, element)
        expect(first is element, element, "expected no second contact of a pair, the first is", first.get("index"))
    position, impulse, start = (rows.numbers(tag, CONTACT[tag]) for tag in ("position", "impulse", "start"))
    rows.refuse(impulse[:, 0] < 0, "impulse", "n", "a normal impulse >= 0")
    separation = _separations(a, b, bodies, box)
    for i, element in enumerate(rows.elements):
        if not is_old or "separation" in element.attrib:
            separation[i] = read_number(element, "separation")
    return Contacts(a, b, position, normal, separation, *impulse.T, *start.T)


def _read_pairs(elements, rank: dict) -> np.ndarray:
    """Return the indices in memory of master and slave of each contact, (2, m). The index of the box is n."""
    pairs = []
    for element in xml_tree.by_index(elements).values():
        xml_tree.refuse_attributes(element, {"index", "master", "slave", "separation"})
        pairs.append([rank.get(read_integer(element, role)) for role in ("master", "slave")])
        for role, body in zip(("master", "slave"), pairs[-1]):
            expect(body is not None, element, f"{role}: expected the index of a body in the file", element.get(role))
        expect(len(set(pairs[-1])) == 2, element, "slave: expected another body than master", element.get("slave"))
    return np.array(pairs, dtype=np.int64).T


def _nearest_wall(normal: np.ndarray) -> np.ndarray:
    """Return the wall, BOTTOM … LEFT, whose normal is closest in direction to each of these normals.

    normal: from circle to wall, (m, 2).
    """
    return np.argmax(normal @ WALL_NORMALS.T, axis=1)


def _separations(a, b, bodies: Bodies, box) -> np.ndarray:
    """Return the gap between the surfaces of each pair, (m,), m. The surface of a wall lies one skin inside the box.

    Only old files need this function: they store no separations, and have neither scales nor segments.
    """
    position, radius, n = bodies.position, bodies.radius, bodies.count
    other, x, y = np.minimum(b, n - 1), *position[a].T
    with np.errstate(all="ignore"):
        to_walls = y - box[1], box[2] - x, box[3] - y, x - box[0]  # in the order BOTTOM … LEFT
        to_wall = np.choose(np.clip(b - n, 0, 3), to_walls) - radius[a] - WALL_SKIN * mean(radius)
        to_circle = np.hypot(*(position[other] - position[a]).T) - radius[a] - radius[other]
    return np.where(b < n, to_circle, to_wall)


# ---- writing ----


def _option_text(name: str, value) -> str:
    value = value.item() if isinstance(value, np.generic) else value
    text = value if isinstance(value, str) else repr(value).lower()
    back, kinds = _option_value(text), "None, a bool, an integer of at most 18 digits, a finite number or a word"
    if type(back) is not type(value) or back != value:
        raise ValueError(f"solver.{name}: expected {kinds}, got {value!r}")
    return xml_tree.quoted_attribute(f"solver.{name}", text)


def _format_solver(solver, preset: str | None) -> str:
    if solver is None:
        return ""
    if type(solver) not in METHODS.values():
        raise ValueError(f"solver: expected None or one of {', '.join(sorted(METHODS))}, got {solver!r}")
    text = "".join(f" {name}={_option_text(name, value)}" for name, value in dataclasses.asdict(solver).items())
    text += "" if preset is None else f" preset={xml_tree.quoted_attribute('preset', preset)}"
    return f'  <solver method="{type(solver).__name__}"{text}/>\n'


def _attributes(numbers: dict) -> str:
    return "".join(f' {name}="{value!r}"' for name, value in numbers.items())


def _first(value) -> float:
    """Return a property of pairs, or that of the materials 0 and 0 if it is a table."""
    return value[0][0] if isinstance(value, tuple) else value


def _format_materials(world: World) -> str:
    """Return the element with the tables and the materials of the walls, or "" if there are none of both."""
    size = world.materials or 1 + max(world.wall_materials)
    if size == 1 and world.touches is True:
        return ""
    tables = {name: getattr(world, name) for name in _OF_PAIRS if isinstance(getattr(world, name), tuple)}
    tables |= {} if world.touches is True else {"touches": world.touches}
    walls = _attributes(dict(zip(SIDES, world.wall_materials))).replace("'", "")
    lines = ""
    for p, q in itertools.combinations_with_replacement(range(size), 2):
        values = {name: repr(table[p][q]).lower() for name, table in tables.items()}
        lines += f'    <pair first="{p}" second="{q}"' + "".join(f' {n}="{v}"' for n, v in values.items()) + "/>\n"
    return f'  <materials count="{size}"{walls}>\n{lines if tables else ""}  </materials>\n'


def _format_bodies(bodies: Bodies, box) -> str:
    bodies = bodies._replace(mass=bodies.free_mass)
    with np.errstate(over="ignore", under="ignore"):
        inertia = bodies.inertia
    position, velocity, angle, spin, mass, radius, material = bodies
    kinds, text, materials = np.where(mass > 0, "free", "fixed"), _BODY_TEXT, ()
    if material.any():
        text, materials = _MATERIAL_TEXT, (material,)
    columns = range(bodies.count), kinds, *materials, mass, *position.T, *velocity.T, angle, inertia, spin, radius
    box_body = _BOX_TEXT % (bodies.count, *(0.0,) * 8, *itertools.chain(*corners(box)))
    return f"  <bodies>\n{xml_tree.fill(text, bodies.count, columns)}{box_body}  </bodies>\n"


def _format_segments(world: World, n: int) -> str:
    speeds = [f' speed="{v!r}"' if v else "" for v in world.surface_speeds] or [""] * len(world.segments)
    moves = [_attributes(dict(zip(_VELOCITIES, v))) if any(v) else "" for v in world.segment_velocities]
    speeds = [a + b for a, b in zip(speeds, moves)] if moves else speeds
    materials = [f' material="{one}"' if one else "" for one in world.segment_materials]
    speeds = [a + b for a, b in zip(speeds, materials)] if materials else speeds
    both = enumerate(zip(world.segments, speeds), n + 1)
    lines = "".join(_SEGMENT_TEXT % (index, *segment, speed) for index, (segment, speed) in both)
    return f"  <segments>\n{lines}  </segments>\n" if lines else ""


def _format_contacts(contacts: Contacts, n: int) -> str:
    behind = contacts.body_b - n
    wall = (behind >= 0) & (behind < len(SIDES))
    wrong = np.flatnonzero(wall)[_nearest_wall(contacts.normal[wall]) != behind[wall]]
    for i in wrong[:1]:
        expected = f"expected one towards the wall {SIDES[behind[i]]!r}"
        raise ValueError(f"contacts.normal[{i}]: {expected}, got {contacts.normal[i]}")
    a, b, position, normal, separation, *impulses = contacts
    slave = np.where(behind < len(SIDES), np.minimum(b, n), b - len(SIDES) + 1)
    columns = (range(contacts.count), a, slave, separation, *position.T, *normal.T, *impulses)
    return f"  <contacts>\n{xml_tree.fill(_CONTACT_TEXT, contacts.count, columns)}  </contacts>\n"
