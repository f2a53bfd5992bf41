"""States as XML files, one file a step (thesis, section 5.2.1): `read_state`, `write_state`, `state_path`.

Canonical form, written by `write_state` (one element a line, floats by `repr`: the round trip is exact)::

    <configuration name time step dt gravity_x gravity_y friction restitution solved>
      <solver method …options/>
      <bodies>
        <body index type="free">
          <mass value/> <position x y/> <velocity x y/> <orientation theta/> <inertia value/> <spin omega/>
          <shape value="circle" radius/>
        </body> …
        <body index type="fixed"> … <shape value="box"> <corner x y/> four times </shape> </body>
      </bodies>
      <contacts>
        <contact index master slave separation>
          <position x y/> <normal x y/> <impulse n t/> <start n t/>
        </contact> …
      </contacts>
    </configuration>

* `master` and `slave` are `body_a` and `body_b` of `deep_contact.state`. The box is one fixed body, numbered
  after the circles; the axis direction nearest to a contact's normal tells which of its walls is meant.
* `<solver>` is left out where `State.solver` is None, `<contacts>` where nobody has looked for contacts yet.
* The inertia is written for other readers, and checked on reading: only solid discs, m r²/2, are modelled.

Two older dialects are read as well:

* pybox2d exports with `velocity vx vy`, `angle theta`, `angular_velocity omega`, `normal nx ny`,
  `impulse ni ti` and shapes printed as `dcCircleShape(radius=1)`, `dcLoopShape(vertices=[(30, 0), …])`;
* exports with bodies and contacts directly under the root (also spelt `Configuration`), normals printed as
  `b2Vec2(-1,2.9819e-05)` and shapes as `master_shape`, `slave_shape` of the contacts.

What they lack is filled in as follows, and nothing else is: settings by the thesis's values (`constants`);
the step by the number that ends the file name, else 0; starts by zero; impulses, where no contact has them,
by the starts, with `solved=False`; the separation by the geometry; a radius by the shape that a contact
prints, else by sqrt(2 I / m); the box, where the file has none or calls it `ground`, by the thesis's 30 ×
30 box, if all centres are inside. A contact whose master comes after its slave (the box comes after all
circles) is turned round: n, t and the relative velocity flip together, so the impulses keep their signs.

Shapes are parsed, never evaluated. A DOCTYPE is refused, so there are no entities. Files larger than
`MAX_BYTES`, `MAX_TAGS` or `MAX_ATTRIBUTES` (about 35,000 circles) are refused before they are parsed,
compressed ones while they are unpacked. Every fault of a file is a `StateFileError` that names file, line,
element and value. (libxml2 counts lines exactly up to 65,535; beyond, the line may be one off.)
"""

from __future__ import annotations

import dataclasses
import gzip
import math
import os
import re
import secrets
import stat
import zlib
from itertools import chain
from pathlib import Path

import numpy as np
from lxml import etree

from deep_contact import constants
from deep_contact.physics.solvers import METHODS
from deep_contact.state import (
    BOTTOM,
    LEFT,
    RIGHT,
    TOP,
    WALL_NORMALS,
    WALLS,
    Bodies,
    Contacts,
    State,
    World,
    check_state,
    no_contacts,
)

MAX_BYTES = 64 * 2**20
"""Largest file that is read or written, unpacked."""

MAX_TAGS = 750_000
"""Most '<' in a file. With `MAX_ATTRIBUTES` it bounds the memory of the parsed tree to under 1 GB."""

MAX_ATTRIBUTES = 1_500_000
"""Most '=' in a file."""

INERTIA_TOLERANCE = 1e-3
"""Largest relative difference between a stored inertia and m r²/2. Old files hold float32."""

_MAX_SHAPE_TEXT = 1000
_MAX_QUOTED = 80
_UNIT_TOLERANCE = 1e-4

_ROOTS = ("configuration", "Configuration")
_SETTINGS = ("step", "gravity_x", "gravity_y", "friction", "restitution", "solved")
_ROOT_ATTRIBUTES = {"name", "time", "dt", *_SETTINGS, "vel_iter", "pos_iter", "vel_thres", "pos_thres"}
_BODY_TAGS = {"mass", "position", "velocity", "orientation", "inertia", "spin", "shape"}
_BODY_TAGS |= {"angle", "angular_velocity"}
_CONTACT_TAGS = {"position", "normal", "impulse", "start"}
_CONTACT_ATTRIBUTES = {"index", "master", "slave", "separation", "master_shape", "slave_shape"}

# Every number as (element, attribute); where there are several spellings, the canonical one comes first.
_MASS = (("mass", "value"),)
_INERTIA = (("inertia", "value"),)
_POSITION = ((("position", "x"),), (("position", "y"),))
_VELOCITY = ((("velocity", "x"), ("velocity", "vx")), (("velocity", "y"), ("velocity", "vy")))
_ANGLE = (("orientation", "theta"), ("angle", "theta"))
_SPIN = (("spin", "omega"), ("angular_velocity", "omega"))
_NORMAL = ((("normal", "x"), ("normal", "nx")), (("normal", "y"), ("normal", "ny")))
_IMPULSE = ((("impulse", "n"), ("impulse", "ni")), (("impulse", "t"), ("impulse", "ti")))
_START = ((("start", "n"),), (("start", "t"),))

_NUMBER = r"([0-9.eE+\-]+)"
_NUMBER_CHARACTERS = re.compile(r"[0-9.eE+\-]*")
_INTEGER = re.compile(r"-?[0-9]{1,18}")
_PAIR = re.compile(rf"\({_NUMBER},{_NUMBER}\)")
_VECTOR = re.compile(rf"b2Vec2\({_NUMBER},{_NUMBER}\)")
_PRINTED_CIRCLE = re.compile(rf"(?:dc|b2)CircleShape\((?:.*,)?radius[=:]{_NUMBER},?(?:[a-z].*)?\)")
_PRINTED_LOOP = re.compile(r"(?:dcLoop|b2Loop|b2Chain)Shape\((?:.*,)?vertices[=:]\[([^\]]*)\].*\)")
_PRINTED_CENTRE = re.compile(r"[(,]pos[=:](?!b2Vec2\(-?0,-?0\)|\(-?0(?:\.0)?,-?0(?:\.0)?\))")
_ENCODING = re.compile(rb"\s*<\?xml[^>]*?\sencoding\s*=\s*[\"']([^\"'>]*)")
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_ESCAPES = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\t": "&#9;", "\n": "&#10;", "\r": "&#13;"}
)

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
_BOX_TEXT = """\
    <body index="%d" type="fixed">
      <mass value="0.0"/>
      <position x="0.0" y="0.0"/>
      <velocity x="0.0" y="0.0"/>
      <orientation theta="0.0"/>
      <inertia value="0.0"/>
      <spin omega="0.0"/>
      <shape value="box">
        <corner x="%r" y="%r"/>
        <corner x="%r" y="%r"/>
        <corner x="%r" y="%r"/>
        <corner x="%r" y="%r"/>
      </shape>
    </body>
"""
_CONTACT_TEXT = """\
    <contact index="%d" master="%d" slave="%d" separation="%r">
      <position x="%r" y="%r"/>
      <normal x="%r" y="%r"/>
      <impulse n="%r" t="%r"/>
      <start n="%r" t="%r"/>
    </contact>
"""


class StateFileError(ValueError):
    """A file that cannot be read, or a state that cannot be stored; names file, line, element and value."""


def read_state(path) -> State:
    """The state in a file `….xml` or `….xml.gz`, in canonical form or an older dialect (module docstring).

    Raises StateFileError naming file, line, element and value, and OSError where the file cannot be opened.
    """
    path = Path(path)
    return parse_state(_load(path), path)


def write_state(path, state: State) -> None:
    """Write a state to `….xml`, or compressed to `….xml.gz`; the same state gives the same bytes.

    The folder is made if it is missing. The file appears whole or not at all. Raises StateFileError where the
    state is not valid or cannot be stored, OSError where the file cannot be written.
    """
    path = Path(path)
    try:
        data = format_state(state)
    except ValueError as error:
        raise StateFileError(f"{path}: not written: {error}") from None
    if path.suffix == ".gz":
        # Neither time nor name go into the header, so that the same state gives the same file.
        data = gzip.compress(data, compresslevel=6, mtime=0)
    path.parent.mkdir(parents=True, exist_ok=True)
    _replace_file(path, data)


def state_path(folder, name: str, step: int, *, gz: bool = False) -> Path:
    """Where the files of a simulation lie: `<folder>/<name>/<name>_<step>.xml`, or `.xml.gz`.

    Raises ValueError where the name is no file name or the step no integer >= 0.
    """
    if not isinstance(name, str) or name in ("", ".", "..") or re.search(r"[/\\\x00-\x1f]", name):
        raise ValueError(f"name: expected a file name without separators, got {name!r}")
    if isinstance(step, bool) or not isinstance(step, (int, np.integer)) or step < 0:
        raise ValueError(f"step: expected an integer >= 0, got {step!r}")
    return Path(folder) / name / f"{name}_{int(step)}.xml{'.gz' if gz else ''}"


def format_state(state: State) -> bytes:
    """A state in canonical form, UTF-8. Raises ValueError naming the field that cannot be stored."""
    state = check_state(state)
    if int(state.step) != state.step or not _INTEGER.fullmatch(str(int(state.step))):
        raise ValueError(f"step: expected an integer of at most 18 digits, got {state.step!r}")
    world, bodies = state.world, state.bodies
    text = "".join(
        (
            '<?xml version="1.0" encoding="UTF-8"?>\n',
            f'<configuration name="{_escape("name", state.name)}" time="{float(state.time)!r}"',
            f' step="{int(state.step)}" dt="{float(state.dt)!r}"',
            f' gravity_x="{world.gravity[0]!r}" gravity_y="{world.gravity[1]!r}"',
            f' friction="{world.friction!r}" restitution="{world.restitution!r}"',
            f' solved="{"true" if state.solved else "false"}">\n',
            _format_solver(state.solver),
            "  <bodies>\n",
            _format_bodies(bodies),
            _BOX_TEXT % (bodies.count, *chain.from_iterable(_corners(world.box))),
            "  </bodies>\n",
            "" if state.contacts is None else _format_contacts(state.contacts, bodies.count),
            "</configuration>\n",
        )
    )
    data = text.encode("utf-8")
    too_large = _too_large(data)
    if too_large:
        raise ValueError(f"the state is too large for a file: {too_large}")
    return data


def parse_state(data: bytes, source) -> State:
    """The state in the bytes of an (unpacked) XML file; `source`, its path or name, is what messages call it.

    Raises StateFileError naming source, line, element and value.
    """
    file = _File(source)
    root = _parse_tree(file, data)
    # An old file has none of our settings, a canonical one has all: what is damaged must not pass for old.
    canonical = any(name in root.attrib for name in _SETTINGS)
    settings = _read_settings(file, root, canonical)
    containers, bodies, contacts = _sort_elements(file, root)
    if "solver" in containers:
        settings["solver"] = _read_solver(file, containers["solver"])
    circles, box, rank = _number_bodies(file, bodies)
    printed = {} if canonical else _printed_shapes(file, contacts)
    table = _Table(file, circles, _BODY_TAGS)
    bodies = _read_bodies(file, table, printed)
    world = World(box=_read_box(file, root, box, bodies, printed, canonical), **settings.pop("world"))
    if "contacts" not in containers and not contacts and (canonical or "bodies" in containers):
        found, solved = None, False
    else:
        found, solved = _read_contacts(file, contacts, bodies, world.box, rank, box, canonical)
    settings.setdefault("solved", solved)
    try:
        return check_state(State(world=world, bodies=bodies, contacts=found, **settings))
    except ValueError as error:
        file.fail(root, str(error))


# --------------------------------------------------------------------------------
# Files


def _load(path: Path) -> bytes:
    file = _File(path)
    if not stat.S_ISREG(os.stat(path).st_mode):  # opening a pipe would wait for its writer
        raise StateFileError(f"{path}: expected a file, got a folder, pipe or device")
    try:
        with gzip.open(path) if path.suffix == ".gz" else open(path, "rb") as stream:
            # In pieces, because read(n) of a plain file sets aside n bytes at once.
            pieces, size = [], 0
            while size <= MAX_BYTES and (piece := stream.read(2**20)):
                pieces.append(piece)
                size += len(piece)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise StateFileError(f"{path}: expected gzip data, whole and undamaged: {error}") from None
    if size > MAX_BYTES:
        file.fail(None, f"expected at most {MAX_BYTES} bytes (unpacked), got more")
    return b"".join(pieces)


def _replace_file(path: Path, data: bytes) -> None:
    temporary = path.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        with open(temporary, "xb") as stream:
            stream.write(data)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _too_large(data: bytes) -> str:
    for what, count, most in (
        ("bytes", len(data), MAX_BYTES),
        ("'<'", data.count(b"<"), MAX_TAGS),
        ("'='", data.count(b"="), MAX_ATTRIBUTES),
    ):
        if count > most:
            return f"expected at most {most} {what}, got {count}"
    return ""


def _parse_tree(file: _File, data: bytes):
    too_large = _too_large(data)
    if too_large:
        file.fail(None, too_large)
    if not data.strip():
        file.fail(None, "expected an XML file, got an empty one")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        file.fail_at(data, error.start, "expected UTF-8", data[error.start : error.start + 1])
    declared = _ENCODING.match(data[:1024].removeprefix(b"\xef\xbb\xbf"))
    if declared and declared[1].lower() not in (b"utf-8", b"utf8", b"us-ascii", b"ascii"):
        file.fail_at(data, 0, "<?xml?> encoding: expected UTF-8", declared[1])
    for forbidden in (b"\0", b"<!DOCTYPE", b"<!ENTITY"):
        at = data.find(forbidden)
        if at >= 0:
            file.fail_at(data, at, "expected no DOCTYPE, entities or NUL", data[at : at + _MAX_QUOTED])
    # The encoding is fixed: no declaration can make the parser see a DOCTYPE where the search above saw none.
    parser = etree.XMLParser(
        encoding="utf-8",
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        huge_tree=False,
        collect_ids=False,
        remove_comments=True,
        remove_pis=True,
    )
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        line = error.lineno or 1
        lines = data.split(b"\n", line) if line < 100_000 else []  # the pieces cost memory, too
        quoted = lines[line - 1].strip()[:_MAX_QUOTED] if line <= len(lines) else b""
        file.fail(None, f"not well-formed XML, {_shorten(error.msg)}", _decoded(quoted), line=line)
    if root.getroottree().docinfo.internalDTD is not None:
        file.fail(root, "expected no DOCTYPE")
    if root.tag not in _ROOTS:
        file.fail(root, "expected the root <configuration>", root.tag)
    return root


class _File:
    """What messages are built from: the name of the file."""

    def __init__(self, source):
        self.source = source

    def fail(self, element, message: str, value=None, line: int = 0):
        """Raise StateFileError; `element` is where it happened (None: nowhere in particular)."""
        where = [str(self.source)]
        line = line or (1 if element is None else element.sourceline or 1)
        where.append(f"line {line}")
        if element is not None:
            parent = element.getparent()
            owner = ""
            if element.tag in ("body", "contact") and "index" in element.attrib:
                owner = f" {_quote(element.get('index'))}"
            elif parent is not None and parent.tag in ("body", "contact") and "index" in parent.attrib:
                owner = f" of {parent.tag} {_quote(parent.get('index'))}"
            where.append(f"<{_shorten(element.tag)}>{owner}")
        got = "" if value is None else f", got {_quote(value)}"
        raise StateFileError(f"{', '.join(where)}: {message}{got}")

    def fail_at(self, data: bytes, at: int, message: str, value: bytes):
        """Raise StateFileError for the byte `at`."""
        self.fail(None, message, _decoded(value), line=data.count(b"\n", 0, at) + 1)


def _decoded(value: bytes) -> str:
    return value.decode("utf-8", "backslashreplace")


def _shorten(text: str) -> str:
    return text if len(text) <= _MAX_QUOTED else text[:_MAX_QUOTED] + "…"


def _quote(value) -> str:
    return repr(_shorten(value)) if isinstance(value, str) else str(value)


# --------------------------------------------------------------------------------
# Reading: structure


def _sort_elements(file: _File, root):
    """Containers by tag, and all bodies and contacts, whether in containers or directly under the root."""
    containers, found = {}, {"body": [], "contact": []}
    for child in root:
        if child.tag in found:
            found[child.tag].append(child)
        elif child.tag not in ("bodies", "contacts", "solver"):
            file.fail(child, "expected <solver>, <bodies>, <contacts>, <body> or <contact>", child.tag)
        elif child.tag in containers:
            file.fail(child, f"expected one <{child.tag}>, got a second")
        else:
            containers[child.tag] = child
    for container, tag in (("bodies", "body"), ("contacts", "contact")):
        element = containers.get(container)
        if element is None:
            continue
        if found[tag]:
            file.fail(found[tag][0], f"expected all of them inside <{container}>")
        for child in element:
            if child.tag != tag:
                file.fail(child, f"expected a <{tag}> here", child.tag)
        found[tag] = list(element)
        if "count" in element.attrib:  # a claim to be checked, never to be believed
            if element.get("count") != str(len(element)):
                file.fail(element, f"count: expected {len(element)}, as there are", element.get("count"))
        _refuse_attributes(file, element, {"count"})
    return containers, found["body"], found["contact"]


def _refuse_attributes(file: _File, element, known) -> None:
    for name, value in element.items():
        if name not in known:
            expected = ", ".join(sorted(known))
            file.fail(element, f"{_shorten(name)}: no such attribute, expected {expected}", value)


class _Table:
    """Elements of one kind with their children by tag, out of which come columns of numbers."""

    def __init__(self, file: _File, elements, tags):
        self.file, self.elements, self.parts = file, elements, []
        for element in elements:
            parts = {child.tag: child for child in element}
            if len(parts) != len(element) or not tags.issuperset(parts):
                self._refuse_children(element, tags)
            self.parts.append(parts)

    def _refuse_children(self, element, tags):
        seen = set()
        for child in element:
            if child.tag not in tags:
                self.file.fail(child, f"expected one of {', '.join(sorted(tags))}", child.tag)
            if child.tag in seen:
                self.file.fail(child, f"expected one <{child.tag}>, got a second")
            seen.add(child.tag)

    def spelling(self, i: int, spellings):
        """(element, attribute) that row i has. Raises where it has none of them."""
        parts = self.parts[i]
        for tag, attribute in spellings:
            if tag in parts and attribute in parts[tag].attrib:
                return parts[tag], attribute
        for tag, attribute in spellings:
            if tag in parts:
                self.file.fail(parts[tag], f"{attribute}: attribute is missing")
        self.file.fail(self.elements[i], f"element <{spellings[0][0]}> is missing")

    def texts(self, spellings) -> list[str]:
        """One text per row. All are tried in the spelling of the first; those that differ are looked up."""
        if not self.parts:
            return []
        first, attribute = self.spelling(0, spellings)
        tag = first.tag
        texts = [parts[tag].get(attribute) if tag in parts else None for parts in self.parts]
        for i, text in enumerate(texts):
            if text is None:
                element, other = self.spelling(i, spellings)
                texts[i] = element.get(other)
        return texts

    def numbers(self, spellings) -> np.ndarray:
        """One finite float64 per row."""
        texts = self.texts(spellings)
        try:
            if _NUMBER_CHARACTERS.fullmatch("".join(texts)):
                numbers = np.array(list(map(float, texts)), dtype=np.float64)
                if np.isfinite(numbers).all():
                    return numbers
        except ValueError:
            pass  # found again, and named, below
        for i, text in enumerate(texts):
            if _finite(text) is None:
                element, attribute = self.spelling(i, spellings)
                self.file.fail(element, f"{attribute}: expected a finite number", text)
        raise AssertionError("a column of numbers is bad and none of its entries is")

    def vectors(self, spellings) -> np.ndarray:
        """(rows, 2) finite float64."""
        return np.column_stack([self.numbers(spelling) for spelling in spellings])

    def refuse_where(self, bad: np.ndarray, spellings, expected: str) -> None:
        """Raise for the first row that is bad, quoting its text."""
        if bad.any():
            element, attribute = self.spelling(int(np.argmax(bad)), spellings)
            self.file.fail(element, f"{attribute}: expected {expected}", element.get(attribute))

    def with_tag(self, tag: str, required: bool) -> bool:
        """Whether the rows have the child: all or none (all, if required)."""
        have = sum(tag in parts for parts in self.parts)
        if have != len(self.parts) and (have or required):
            i = next(i for i, parts in enumerate(self.parts) if tag not in parts)
            others = "" if required else ", though other contacts have it"
            self.file.fail(self.elements[i], f"element <{tag}> is missing{others}")
        return have == len(self.parts)


def _finite(text: str | None) -> float | None:
    """The number in a text, None if it is none or not finite."""
    if text is None or len(text) > _MAX_SHAPE_TEXT or not _NUMBER_CHARACTERS.fullmatch(text):
        return None
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _required(file: _File, element, name: str) -> str:
    text = element.get(name)
    if text is None:
        file.fail(element, f"{name}: attribute is missing")
    return text


def _number(file: _File, element, name: str) -> float:
    text = _required(file, element, name)
    number = _finite(text)
    if number is None:
        file.fail(element, f"{name}: expected a finite number", text)
    return number


def _integer(file: _File, element, name: str) -> int:
    text = _required(file, element, name)
    if not _INTEGER.fullmatch(text):
        file.fail(element, f"{name}: expected an integer of at most 18 digits", text)
    return int(text)


# --------------------------------------------------------------------------------
# Reading: settings


def _read_settings(file: _File, root, canonical: bool) -> dict:
    _refuse_attributes(file, root, _ROOT_ATTRIBUTES)
    settings = {"name": _required(file, root, "name"), "time": _number(file, root, "time")}
    settings["dt"] = _number(file, root, "dt") if canonical or "dt" in root.attrib else constants.TIME_STEP
    if settings["dt"] <= 0:
        file.fail(root, "dt: expected a number > 0", root.get("dt"))
    if not canonical:
        number = re.search(r"(?:^|[_/\\])([0-9]{1,18})\.xml(?:\.gz)?$", str(file.source))
        settings["step"] = int(number[1]) if number else 0
        settings["world"] = {}
        return settings
    settings["step"] = _integer(file, root, "step")
    if settings["step"] < 0:
        file.fail(root, "step: expected an integer >= 0", root.get("step"))
    friction, restitution = _number(file, root, "friction"), _number(file, root, "restitution")
    if friction < 0:
        file.fail(root, "friction: expected a number >= 0", root.get("friction"))
    if not 0 <= restitution <= 1:
        file.fail(root, "restitution: expected a number from 0 to 1", root.get("restitution"))
    solved = _required(file, root, "solved")
    if solved not in ("true", "false"):
        file.fail(root, "solved: expected true or false", solved)
    gravity = (_number(file, root, "gravity_x"), _number(file, root, "gravity_y"))
    settings["world"] = {"gravity": gravity, "friction": friction, "restitution": restitution}
    settings["solved"] = solved == "true"
    return settings


def _read_solver(file: _File, element):
    options = dict(element.items())
    method = options.pop("method", None)
    if method is None:
        file.fail(element, "method: attribute is missing")
    if method not in METHODS:
        file.fail(element, f"method: expected one of {', '.join(sorted(METHODS))}", method)
    known = {field.name for field in dataclasses.fields(METHODS[method])}
    for name, text in options.items():
        if name not in known:
            expected = ", ".join(sorted(known))
            file.fail(element, f"{_shorten(name)}: no option of {method}, expected {expected}", text)
    try:
        return METHODS[method](**{name: _option_value(text) for name, text in options.items()})
    except (TypeError, ValueError) as error:
        file.fail(element, f"expected options of {method}: {_shorten(str(error))}", str(options))


def _option_value(text: str):
    """None, a bool, an int, a float or a str, by how it looks; `_option_text` makes sure of the inverse."""
    if text in ("none", "true", "false"):
        return {"none": None, "true": True, "false": False}[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    number = _finite(text)
    return text if number is None else number


def _option_text(name: str, value) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool):
        text = {None: "none", True: "true", False: "false"}[value]
    else:
        text = repr(value) if isinstance(value, (int, float)) else value
    back = _option_value(text) if isinstance(text, str) else None
    if type(back) is not type(value) or back != value:
        expected = "None, a bool, an integer of at most 18 digits, a finite number or a word"
        raise ValueError(f"solver.{name}: expected {expected}, got {value!r}")
    return _escape(f"solver.{name}", text)


# --------------------------------------------------------------------------------
# Reading: bodies


def _number_bodies(file: _File, bodies):
    """Circles in the order of their indices, the fixed body or None, {index in the file: in memory}."""
    circles, box, seen = [], None, set()
    for body in bodies:
        _refuse_attributes(file, body, {"index", "type"})
        index = _integer(file, body, "index")
        if index in seen:
            file.fail(body, "index: expected each once, got a duplicate of", body.get("index"))
        seen.add(index)
        kind = body.get("type")
        if kind == "free":
            circles.append((index, body))
        elif kind != "fixed":
            file.fail(body, "type: expected free or fixed" if kind else "type: attribute is missing", kind)
        elif box is not None:
            file.fail(body, "expected one fixed body, the box, got a second")
        else:
            box = body
    circles.sort(key=lambda pair: pair[0])
    rank = {index: i for i, (index, _) in enumerate(circles)}
    box_index = None if box is None else int(box.get("index"))
    for (index, _), (following, body) in zip(circles, circles[1:]):
        if following != index + 1 and not (following == index + 2 and box_index == index + 1):
            file.fail(body, f"index: expected no gap, there is no {index + 1}", body.get("index"))
    if box is not None:
        rank[box_index] = len(circles)
    return [body for _, body in circles], box, rank


def _read_bodies(file: _File, table: _Table, printed: dict) -> Bodies:
    mass, inertia = table.numbers(_MASS), _read_inertia(table)
    table.refuse_where(mass <= 0, _MASS, "a mass > 0")
    radius = np.array([_radius(file, table, i, printed) for i in range(len(table.parts))], dtype=np.float64)
    if np.isnan(radius).any():
        # Nothing in the file says how large these circles are, but a solid disc's inertia does.
        with np.errstate(all="ignore"):
            guess = np.sqrt(2 * inertia / mass)
        radius = np.where(np.isnan(radius), guess, radius)
        bad = ~(np.isfinite(radius) & (radius > 0))
        table.refuse_where(bad, _INERTIA, "m r²/2 > 0, as the shape has no radius")
    bodies = Bodies(
        position=table.vectors(_POSITION),
        velocity=table.vectors(_VELOCITY),
        angle=table.numbers(_ANGLE),
        spin=table.numbers(_SPIN),
        mass=mass,
        radius=radius,
    )
    with np.errstate(all="ignore"):
        disc = _inertia(bodies)
        right = (inertia == disc) | (np.abs(inertia - disc) <= INERTIA_TOLERANCE * disc)
    if not right.all():
        i = int(np.argmin(right))
        table.refuse_where(~right, _INERTIA, f"m r²/2 = {float(disc[i])!r} (only solid discs are modelled)")
    return bodies


def _inertia(bodies: Bodies) -> np.ndarray:
    """m r²/2. In this order an extreme mass and radius give 0 or inf, never the nan of 0 times inf."""
    return 0.5 * (bodies.mass * bodies.radius) * bodies.radius


def _read_inertia(table: _Table) -> np.ndarray:
    # m r²/2 of a disc may overflow where m and r do not; `inf` is then what was written.
    texts = table.texts(_INERTIA)
    if "inf" not in texts:
        return table.numbers(_INERTIA)
    inertia = np.array([np.inf if text == "inf" else _finite(text) for text in texts], dtype=np.float64)
    table.refuse_where(np.isnan(inertia), _INERTIA, "a finite number")
    return inertia


def _radius(file: _File, table: _Table, i: int, printed: dict) -> float:
    """Radius of circle i, NaN where neither its shape nor a contact tells."""
    shape = table.parts[i].get("shape")
    if shape is None:
        file.fail(table.elements[i], "element <shape> is missing")
    text = _shape_text(shape)
    if text == "circle":
        if "radius" in shape.attrib:
            radius = _number(file, shape, "radius")
            element, value = shape, shape.get("radius")
        elif (index := int(table.elements[i].get("index"))) in printed:
            element, value = printed[index]
            radius = _printed_radius(file, element, value)
        else:
            return np.nan
    else:
        element, value = shape, text
        radius = _printed_radius(file, shape, text)
    if radius <= 0:
        file.fail(element, "radius: expected a number > 0", value)
    return radius


def _shape_text(shape) -> str:
    text = shape.get("value")
    return ((shape.text or "") if text is None else text).strip()


def _compact(file: _File, element, text: str) -> str:
    if len(text) > _MAX_SHAPE_TEXT:
        file.fail(element, f"expected at most {_MAX_SHAPE_TEXT} characters", text)
    return "".join(text.split())


def _printed_radius(file: _File, element, text: str) -> float:
    compact = _compact(file, element, text)
    match = _PRINTED_CIRCLE.fullmatch(compact)
    radius = _finite(match[1]) if match else None
    if radius is None or _PRINTED_CENTRE.search(compact):
        file.fail(element, "shape: expected circle, or CircleShape(radius=…) around the centre", text)
    return radius


def _printed_shapes(file: _File, contacts) -> dict:
    """{index in the file: (contact, text)} of the shapes that contacts print, the first of each body."""
    printed = {}
    for contact in contacts:
        for role in ("master", "slave"):
            text = contact.get(f"{role}_shape")
            if text is not None:
                printed.setdefault(_integer(file, contact, role), (contact, text))
    return printed


def _read_box(file: _File, root, body, bodies: Bodies, printed: dict, canonical: bool) -> tuple:
    """(x_min, y_min, x_max, y_max)"""
    if body is None:
        if canonical:
            file.fail(root, "expected a fixed body, the box")
        return _thesis_box(file, root, bodies)
    parts = _Table(file, [body], _BODY_TAGS).parts[0]
    for tag, attributes in (
        ("velocity", ("x", "y", "vx", "vy")),
        ("orientation", ("theta",)),
        ("angle", ("theta",)),
        ("spin", ("omega",)),
        ("angular_velocity", ("omega",)),
    ):
        for name in attributes:
            part = parts.get(tag)
            if part is not None and name in part.attrib and _number(file, part, name) != 0:
                file.fail(part, f"{name}: expected 0, the box neither moves nor turns", part.get(name))
    shape = parts.get("shape")
    if shape is None:
        file.fail(body, "element <shape> is missing")
    text, element = _shape_text(shape), shape
    index = int(body.get("index"))
    if text in ("ground", "box") and len(shape) == 0 and not canonical:
        if index not in printed or not _PRINTED_LOOP.fullmatch(_compact(file, *printed[index])):
            return _thesis_box(file, body, bodies)
        element, text = printed[index]
    if text == "box":
        corners = []
        for corner in shape:
            if corner.tag != "corner":
                file.fail(corner, "expected a <corner> here", corner.tag)
            corners.append((_number(file, corner, "x"), _number(file, corner, "y")))
    else:
        corners = _printed_vertices(file, element, text)
    if "position" in parts:
        x, y = (_number(file, parts["position"], name) for name in ("x", "y"))
        # Adding 0.0 would turn -0.0 into 0.0.
        corners = [(a + x if x else a, b + y if y else b) for a, b in corners]
    if len(corners) == 5 and corners[0] == corners[4]:
        corners = corners[:4]
    box = tuple(pick(corner[axis] for corner in corners) for pick in (min, max) for axis in (0, 1)) if corners else ()
    if len(corners) != 4 or len(set(corners)) != 4 or set(corners) != set(_corners(box)):
        file.fail(element, "expected the four corners of an upright box", str(corners))
    if not np.isfinite(box).all():
        file.fail(element, "expected finite corners", str(corners))
    return box


def _printed_vertices(file: _File, element, text: str) -> list:
    match = _PRINTED_LOOP.fullmatch(_compact(file, element, text))
    corners = [(_finite(x), _finite(y)) for x, y in _PAIR.findall(match[1])] if match else []
    if not match or _PAIR.sub("", match[1]).strip(",") or any(None in corner for corner in corners):
        file.fail(element, "shape: expected box with four corners, or LoopShape(vertices=[(x, y), …])", text)
    return corners


def _corners(box) -> list:
    x_min, y_min, x_max, y_max = box
    return [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]


def _thesis_box(file: _File, element, bodies: Bodies) -> tuple:
    box = World().box
    outside = ((bodies.position < box[:2]) | (bodies.position > box[2:])).any(axis=1)
    if outside.any():
        centre = tuple(bodies.position[np.argmax(outside)].tolist())
        file.fail(element, f"the file has no box, and a circle is outside the thesis's {box}", str(centre))
    return box


# --------------------------------------------------------------------------------
# Reading: contacts


def _read_contacts(file: _File, elements, bodies: Bodies, box, rank: dict, box_body, canonical: bool):
    """(contacts, whether they hold solved impulses)"""
    table = _Table(file, elements, _CONTACT_TAGS)
    if not elements:
        return no_contacts(), True
    n = bodies.count
    first, second = _read_pairs(file, elements, rank)
    turned = first > second
    normal = _read_normals(file, table)
    # Box2D puts edges first, so old files have the box as master, its normal pointing at the circle.
    normal = np.where(turned[:, None], -normal, normal)
    a, b = np.minimum(first, second), np.maximum(first, second)
    wall = b == n
    b[wall] += _nearest_wall(normal[wall])
    _refuse_twins(file, elements, a, b, n)

    position = table.vectors(_POSITION)
    separation = _read_separations(file, elements, a, b, bodies, box, canonical)
    if table.with_tag("start", required=canonical):
        start = table.vectors(_START)
    else:
        start = np.zeros((len(elements), 2))
    solved = table.with_tag("impulse", required=canonical)
    impulse = table.vectors(_IMPULSE) if solved else start
    table.refuse_where(impulse[:, 0] < 0, _IMPULSE[0] if solved else _START[0], "a normal impulse >= 0")
    return Contacts(a, b, position, normal, separation, *impulse.T, *start.T), solved


def _read_pairs(file: _File, elements, rank: dict):
    """Memory indices of master and slave, the box as n."""
    pairs, seen = [], set()
    for element in elements:
        _refuse_attributes(file, element, _CONTACT_ATTRIBUTES)
        index = _integer(file, element, "index")
        if index in seen:
            file.fail(element, "index: expected each once, got a duplicate of", element.get("index"))
        seen.add(index)
        pair = []
        for role in ("master", "slave"):
            body = rank.get(_integer(file, element, role))
            if body is None:
                file.fail(element, f"{role}: expected the index of a body in the file", element.get(role))
            pair.append(body)
        if pair[0] == pair[1]:
            file.fail(element, "slave: expected another body than master", element.get("slave"))
        pairs.append(pair)
    return np.array(pairs, dtype=np.int64).T


def _read_normals(file: _File, table: _Table) -> np.ndarray:
    if "normal" in table.parts[0] and "normal" in table.parts[0]["normal"].attrib:
        spellings = (("normal", "normal"),)
        rows = []
        for i, text in enumerate(table.texts(spellings)):
            element = table.parts[i]["normal"]
            match = _VECTOR.fullmatch(_compact(file, element, text))
            rows.append([_finite(number) for number in match.groups()] if match else [None])
            if None in rows[-1]:
                file.fail(element, "normal: expected b2Vec2(x, y)", text)
        normal = np.array(rows, dtype=np.float64)
    else:
        spellings, normal = _NORMAL[0], table.vectors(_NORMAL)
    with np.errstate(over="ignore"):
        bad = np.abs(np.hypot(*normal.T) - 1) > _UNIT_TOLERANCE
    if bad.any():
        i = int(np.argmax(bad))
        element, _ = table.spelling(i, spellings)
        file.fail(element, "expected a unit vector", str(tuple(normal[i].tolist())))
    return normal


def _nearest_wall(normal: np.ndarray) -> np.ndarray:
    """Walls (BOTTOM … LEFT) nearest in direction to normals (m, 2) from circle to wall."""
    return np.argmax(normal @ WALL_NORMALS.T, axis=1)


def _refuse_twins(file: _File, elements, a, b, n: int) -> None:
    seen = {}
    for i, pair in enumerate(zip(a.tolist(), b.tolist())):
        if seen.setdefault(pair, i) != i:
            wall = f" ({WALLS[pair[1] - n]} wall)" if pair[1] >= n else ""
            names = f"{elements[i].get('master')}, {elements[i].get('slave')}"
            first = elements[seen[pair]].get("index")
            file.fail(elements[i], f"expected no second contact of a pair, the first is {first}", names + wall)


def _read_separations(file: _File, elements, a, b, bodies: Bodies, box, canonical: bool) -> np.ndarray:
    separation = np.empty(len(elements))
    computed = None
    for i, element in enumerate(elements):
        if canonical or "separation" in element.attrib:
            separation[i] = _number(file, element, "separation")
        else:
            if computed is None:
                computed = _separations(a, b, bodies, box)
            separation[i] = computed[i]
    return separation


def _separations(a, b, bodies: Bodies, box) -> np.ndarray:
    """Gap between the surfaces of the pairs, m. As in the engine, walls begin `WALL_SKIN` before the box."""
    n = bodies.count
    x_min, y_min, x_max, y_max = box
    gap = np.empty(len(a))
    for i, (p, q) in enumerate(zip(a.tolist(), b.tolist())):
        (x, y), radius = bodies.position[p].tolist(), bodies.radius[p]
        if q < n:
            gap[i] = np.hypot(*(bodies.position[q] - bodies.position[p])) - radius - bodies.radius[q]
        else:
            distance = {BOTTOM: y - y_min, RIGHT: x_max - x, TOP: y_max - y, LEFT: x - x_min}[q - n]
            gap[i] = distance - radius - constants.WALL_SKIN
    return gap


# --------------------------------------------------------------------------------
# Writing


def _escape(name: str, text: str) -> str:
    if not isinstance(text, str) or _NOT_XML.search(text):
        raise ValueError(f"{name}: expected text without control characters, got {text!r}")
    return text.translate(_ESCAPES)


def _format_solver(solver) -> str:
    if solver is None:
        return ""
    method = next((name for name, cls in METHODS.items() if cls is type(solver)), None)
    if method is None:
        raise ValueError(f"solver: expected None or one of {', '.join(sorted(METHODS))}, got {solver!r}")
    options = {field.name: getattr(solver, field.name) for field in dataclasses.fields(solver)}
    text = "".join(f' {name}="{_option_text(name, value)}"' for name, value in options.items())
    return f'  <solver method="{method}"{text}/>\n'


def _format_bodies(bodies: Bodies) -> str:
    with np.errstate(over="ignore", under="ignore"):
        inertia = _inertia(bodies)
    columns = (range(bodies.count), bodies.mass, *bodies.position.T, *bodies.velocity.T, bodies.angle)
    return _fill(_BODY_TEXT, bodies.count, (*columns, inertia, bodies.spin, bodies.radius))


def _format_contacts(contacts: Contacts, n: int) -> str:
    wall = contacts.body_b >= n
    told = _nearest_wall(contacts.normal[wall]) == contacts.body_b[wall] - n
    if not told.all():
        i = int(np.flatnonzero(wall)[np.argmin(told)])
        side = WALLS[contacts.body_b[i] - n]
        raise ValueError(f"contacts.normal[{i}]: expected one towards the {side} wall, got {contacts.normal[i]}")
    text = _fill(
        _CONTACT_TEXT,
        contacts.count,
        (
            range(contacts.count),
            contacts.body_a,
            np.minimum(contacts.body_b, n),
            contacts.separation,
            *contacts.position.T,
            *contacts.normal.T,
            contacts.normal_impulse,
            contacts.tangent_impulse,
            contacts.normal_start,
            contacts.tangent_start,
        ),
    )
    return f"  <contacts>\n{text}  </contacts>\n"


def _fill(template: str, rows: int, columns) -> str:
    """The template once per row. One call for all rows, on Python numbers, is what makes writing fast."""
    lists = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns]
    return template * rows % tuple(chain.from_iterable(zip(*lists)))
