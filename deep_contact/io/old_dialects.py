"""Conversion of state files of the thesis's authors to the canonical form of `state_xml`, before they are read.

data/README.md describes the two dialects, and how missing values are filled in. `state_xml` fills in two of them: the
separations, and the box if the file has none.

Tests: tests/io/test_state_xml.py
"""

from __future__ import annotations

import math
import re

from lxml import etree

from deep_contact.io.xml_tree import by_index, expect, quote, read_integer, read_text, refuse_attributes, to_float
from deep_contact.state import constants

BODY = dict(mass="value", position="x y", velocity="x y", orientation="theta", inertia="value", spin="omega")
CONTACT = dict(position="x y", normal="x y", impulse="n t", start="n t")
"""BODY and CONTACT: tag of a child of a body, or of a contact, in canonical form -> attributes of this child."""

_TAGS = {"angle": "orientation", "angular_velocity": "spin"}
_ATTRIBUTES = {"vx": "x", "vy": "y", "nx": "x", "ny": "y", "ni": "n", "ti": "t"}
"""Tags and attributes in pybox2d's exports -> their names in canonical form."""

_OF_SOLVER = ("vel_iter", "vel_thres", "pos_iter", "pos_thres")

_NUMBER = r"([0-9.eE+\-]+)"
_PAIR = re.compile(rf"\({_NUMBER},{_NUMBER}\)")
_VECTOR = re.compile(rf"b2Vec2\({_NUMBER},{_NUMBER}\)")
_CIRCLE = re.compile(rf"(?:dc|b2)CircleShape\((?:.*,)?radius[=:]{_NUMBER},?(?:[a-z].*)?\)")
_LOOP = re.compile(r"(?:dcLoop|b2Loop|b2Chain)Shape\((?:.*,)?vertices[=:]\[([^\]]*)\].*\)")
_OFF_CENTRE = re.compile(r"[(,]pos[=:](?!b2Vec2\(-?0,-?0\)|\(-?0(?:\.0)?,-?0(?:\.0)?\))")
_MAX_TEXT = 1000


def modernise(root, source: str) -> None:
    """Convert the tree of an old file to canonical form, in place. `state_xml` fills in separations and a missing box.

    root: root element. source: name of the file, from which the number of the step is read. Raises StateFileError.
    """
    refuse_attributes(root, {"name", "time", "dt", *_OF_SOLVER})
    for child in root:
        known = child.tag in ("solver", "bodies", "contacts", "body", "contact")
        expect(known, child, f"expected no {quote(child.tag)} in an old file")
    for element in root.iter():
        element.tag = _TAGS.get(element.tag, element.tag)
        for old, new in _ATTRIBUTES.items():
            if old in element.attrib and new not in element.attrib:
                element.set(new, element.attrib.pop(old))
    is_flat = root.find("bodies") is None
    for container, tag in (("bodies", "body"), ("contacts", "contact")):
        if root.find(container) is None and (is_flat or root.find(tag) is not None):
            _add(root, container).extend(root.findall(tag))
    contacts = root.findall("contacts/contact")
    by_index(contacts)  # checks indices, so that a file with contacts alone is refused at once
    _complete_settings(root, source)
    _complete_shapes(root.iterfind("bodies/body"), contacts)
    solved = root.find("contacts") is not None and (not contacts or root.find("contacts/contact/impulse") is not None)
    root.set("solved", "true" if solved else "false")
    _complete_contacts(root, contacts)


def _add(parent, tag: str, **attributes):
    """Add a child to `parent`, with the parent's line number for error messages. Returns the child."""
    child = etree.SubElement(parent, tag, attributes)
    child.sourceline = parent.sourceline
    return child


def _complete_settings(root, source: str) -> None:
    sweeps, tolerance, position_sweeps, _ = (root.attrib.pop(name, None) for name in _OF_SOLVER)
    if None not in (sweeps, tolerance, position_sweeps):
        options = {"sweeps": sweeps, "tolerance": repr(to_float(tolerance)), "position_sweeps": position_sweeps}
        _add(root, "solver", method="PGS", **options)
    number = re.search(r"(?:^|[_/\\])([0-9]{1,18})\.xml(?:\.gz)?$", source)
    settings = {"step": int(number[1]) if number else 0, "dt": constants.TIME_STEP, "friction": constants.FRICTION}
    settings |= {"restitution": constants.RESTITUTION} | dict(zip(("gravity_x", "gravity_y"), constants.GRAVITY))
    for name, value in settings.items():
        root.set(name, root.get(name, repr(value)))


def _compact(element, text: str) -> str:
    expect(len(text) <= _MAX_TEXT, element, f"expected at most {_MAX_TEXT} characters", text)
    return "".join(text.split())


def _complete_shapes(bodies, contacts: list) -> None:
    """Add the radius of circles and the corners of the box to bodies without them, in place.

    They are taken from the text of the body's shape, or from the first contact that prints this shape. If no radius is
    printed, a circle gets that of a solid disc with its mass and inertia. If no corners are printed, the box stays
    without them. A file with only what section 5.2.1 of the thesis lists has no shapes and no orientations.
    """
    printed = {}
    for contact in contacts:
        for role in ("master", "slave"):
            if f"{role}_shape" in contact.attrib:
                text = contact.attrib.pop(f"{role}_shape")
                printed.setdefault(read_integer(contact, role), (contact, text))
    for body in bodies:
        shape, is_box = body.find("shape"), body.get("type") == "fixed"
        if shape is None:
            shape = _add(body, "shape", value="box" if is_box else "circle")
        if not is_box and body.find("orientation") is None:
            _add(body, "orientation", theta="0.0")
        if not (len(shape) or "radius" in shape.attrib):
            _complete_shape(body, shape, is_box, printed)
        if not is_box and body.find("inertia") is None:  # files of 1 to 14 May 2018: a solid disc's
            mass, radius = to_float(read_text(_part(body, "mass"), "value")), to_float(read_text(shape, "radius"))
            _add(body, "inertia", value=repr(0.5 * mass * radius * radius))


def _complete_shape(body, shape, is_box: bool, printed: dict) -> None:
    element, text = shape, shape.get("value", shape.text or "").strip()
    if text in (("ground", "box") if is_box else ("circle",)):
        element, text = printed.get(read_integer(body, "index"), (shape, None))
    shape.set("value", "box" if is_box else "circle")
    compact = _compact(element, text or "")
    if is_box:
        match = _LOOP.fullmatch(compact)
        fits = element is not shape or text is None or (match and not _PAIR.sub("", match[1]).strip(","))
        expect(fits, element, "shape: expected box with four corners, or LoopShape(vertices=[(x, y), …])", text)
        for x, y in _PAIR.findall(match[1]) if match else ():
            _add(shape, "corner", x=x, y=y)
    elif text is not None:
        match = _CIRCLE.fullmatch(compact)
        fits = match and not _OFF_CENTRE.search(compact)
        expect(fits, element, "shape: expected circle, or CircleShape(radius=…) around the centre", text)
        shape.set("radius", match[1])
    else:
        mass, inertia = (to_float(read_text(_part(body, tag), "value")) for tag in ("mass", "inertia"))
        fits = mass > 0 and inertia > 0 and math.isfinite(inertia / mass)
        expect(fits, body, "expected mass and inertia > 0, as the shape has no radius", f"{mass}, {inertia}")
        shape.set("radius", repr(math.sqrt(2 * inertia / mass)))


def _part(body, tag: str):
    part = body.find(tag)
    expect(part is not None, body, f"element <{tag}> is missing")
    return part


def _complete_contacts(root, contacts: list) -> None:
    """Complete the contacts, in place: their normals become two numbers, and missing starts and impulses are added.

    If no contact of the file has a start, all starts are 0. If no contact has an impulse, its start is used.
    """
    for contact in contacts:
        normal = contact.find("normal")
        if normal is not None and "normal" in normal.attrib:
            match = _VECTOR.fullmatch(_compact(normal, normal.get("normal")))
            expect(match, normal, "normal: expected b2Vec2(x, y)", normal.get("normal"))
            del normal.attrib["normal"]
            normal.attrib.update({"x": match[1], "y": match[2]})
    for tag in ("start", "impulse"):
        for contact in contacts if root.find(f"contacts/contact/{tag}") is None else ():
            start = contact.find("start")
            _add(contact, tag, **{name: "0.0" if start is None else start.get(name, "") for name in "nt"})
