"""State files (thesis section 5.2.1; DESIGN, "XML"): exact round trip, old dialects, and files that are refused."""

import gzip
import os
import re
import socket
import time
import tracemalloc
import xml.etree.ElementTree as ElementTree
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import TOOLS, run_python
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from deep_contact.io import state_xml, xml_tree
from deep_contact.io.state_xml import format_state, parse_state, read_state, write_state
from deep_contact.io.xml_tree import StateFileError
from deep_contact.solvers import PGS
from deep_contact.state import constants
from deep_contact.state.arrays import BOTTOM, LEFT, WALL_NORMALS, Bodies, Contacts, no_contacts
from deep_contact.state.fields import make_bodies
from deep_contact.state.scales import BOX2D, ContactScales
from deep_contact.state.state import State
from deep_contact.state.world import World

DATA = Path(__file__).parent / "data"
OLD_A = DATA / "old_pybox2d_12.xml"
OLD_B = DATA / "7.xml"
EXTREME = (5e-324, -5e-324, -0.0, 0.0, 1e308, -1.7976931348623157e308, 2.2250738585072014e-308, 0.1, 1 / 3)


def example(**changes) -> State:
    """Two circles in the lower left corner: three contacts, two of them of one circle with the box."""
    contacts = Contacts(
        body_a=np.array([0, 0, 0]),
        body_b=np.array([1, 2 + BOTTOM, 2 + LEFT]),
        position=np.array([[2.0, 1.0], [1.0, 0.005], [0.005, 1.0]]),
        normal=np.array([[1.0, 0.0], WALL_NORMALS[BOTTOM], WALL_NORMALS[LEFT]]),
        separation=np.array([-0.002, -0.01, -0.011]),
        normal_impulse=np.array([0.5, 0.25, 0.125]),
        tangent_impulse=np.array([0.1, -0.0625, 0.03]),
        normal_start=np.array([0.4, 0.2, 0.1]),
        tangent_start=np.array([-0.1, 0.0, 1e-9]),
    )
    bodies = make_bodies([[1.0, 1.0], [2.998, 1.0]], velocity=[0.5, -1.0], spin=0.25, angle=0.125)
    state = State(name="pile", world=World(), bodies=bodies, contacts=contacts, step=3, time=0.03, solved=True)
    return state.replace(**changes)


def bits(state: State):
    """Everything in a state, so that two are equal only if all bits are."""
    arrays = [*state.bodies, *(state.contacts or ())]
    scales = state.world.scales or ()
    world = np.array([*state.world.box, *state.world.gravity, state.world.friction, state.world.restitution, *scales])
    scalars = np.array([state.time, state.dt]).tobytes(), state.name, state.step, state.solver, state.solved
    return [(a.dtype, a.shape, a.tobytes()) for a in (*arrays, world)], scalars, state.contacts is None


FINITE = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from(EXTREME)
POSITIVE = st.floats(min_value=5e-324, allow_infinity=False) | st.sampled_from((5e-324, 1e308, np.pi))
NOT_NEGATIVE = st.floats(min_value=0, allow_infinity=False) | st.sampled_from((0.0, -0.0, 5e-324))


@st.composite
def states(draw):
    """Any state that `check_state` lets pass, physical or not."""

    def column(elements, *shape):
        return draw(arrays(np.float64, shape, elements=elements, fill=st.nothing()))

    (x_min, x_max), (y_min, y_max) = (sorted(draw(st.sets(FINITE, min_size=2, max_size=2))) for _ in range(2))
    world = World(
        box=(x_min, y_min, x_max, y_max),
        gravity=(draw(FINITE), draw(FINITE)),
        friction=draw(NOT_NEGATIVE),
        restitution=draw(st.floats(0, 1)),
        scales=draw(st.none() | st.builds(ContactScales, *[NOT_NEGATIVE] * 3, POSITIVE, *[NOT_NEGATIVE] * 4)),
    )
    n = draw(st.integers(1, 5))
    motion = column(FINITE, n, 2), column(FINITE, n, 2), column(FINITE, n), column(FINITE, n)
    bodies = Bodies(*motion, column(POSITIVE, n), column(POSITIVE, n))
    pairs = sorted(draw(st.sets(st.sampled_from([(a, b) for a in range(n) for b in range(a + 1, n + 4)]))))
    m = len(pairs)
    contacts = None if not m and draw(st.booleans()) else no_contacts()
    if m:
        a, b = np.array(pairs).T
        angle = column(st.floats(-np.pi, np.pi), m)
        # A wall is known from its normal; off by 1e-5 at most, as in old files.
        angle = np.where(b >= n, np.arctan2(*WALL_NORMALS[(b - n) % 4][:, ::-1].T) + 1e-6 * angle, angle)
        normal = np.column_stack([np.cos(angle), np.sin(angle)])
        rest = column(FINITE, m), column(NOT_NEGATIVE, m), *(column(FINITE, m) for _ in range(3))
        contacts = Contacts(a, b, column(FINITE, m, 2), normal, *rest)
    letters = st.characters(codec="utf-8", categories=("L", "N", "P", "S", "Z")) | st.sampled_from("\t\n\r<")
    return State(
        name=draw(st.text(letters)),
        world=world,
        bodies=bodies,
        contacts=contacts,
        time=draw(FINITE),
        step=draw(st.integers(0, 10**9)),
        dt=draw(POSITIVE),
        solver=draw(st.none() | st.builds(PGS, sweeps=st.integers(0, 9999), tolerance=st.none() | NOT_NEGATIVE)),
        solved=draw(st.booleans()),
    )


@settings(max_examples=60, deadline=None)
@given(states())
def test_round_trip_is_exact_for_every_state(state):
    assert bits(parse_state(format_state(state), "state.xml")) == bits(state)


@pytest.mark.parametrize("name", ["pile_3.xml", "pile_3.xml.gz"])
def test_a_file_comes_back_and_has_the_same_bytes_for_the_same_state(tmp_path, name):
    """Also compressed, although gzip files may hold a time (bytes 4 to 7 of RFC 1952) and a name."""
    for path in (tmp_path / name, tmp_path / f"again_{name}"):
        write_state(path, example(solver=PGS()))
        assert bits(read_state(path)) == bits(example(solver=PGS()))
    assert (tmp_path / name).read_bytes() == path.read_bytes()


@dataclass(frozen=True, kw_only=True)
class Other:
    a: object = None
    b: bool = True
    c: int = -7
    d: float = 1e-310
    e: str = 'for"ward'
    f: float = 3.0


def test_options_of_every_kind_are_stored_and_what_would_not_come_back_is_refused(monkeypatch):
    monkeypatch.setitem(state_xml.METHODS, "Other", Other)
    again = parse_state(format_state(example(solver=Other())), "s.xml").solver
    assert again == Other()
    assert [type(v) for v in vars(again).values()] == [type(v) for v in vars(Other()).values()]
    for option in ("none", "5", (1, 2), float("inf"), 10**20):
        with pytest.raises(ValueError, match=r"solver\.a"):
            format_state(example(solver=Other(a=option)))


def test_the_text_has_the_elements_of_the_listing():
    """DESIGN, "XML", read by another parser."""
    root = ElementTree.fromstring(format_state(example()))
    circle, _, box = root.findall("bodies/body")
    listing = ["mass", "position", "velocity", "orientation", "inertia", "spin", "shape"]
    assert [child.tag for child in circle] == listing
    assert (box.attrib, len(box.findall("shape/corner"))) == ({"index": "2", "type": "fixed"}, 4)
    contact = root.findall("contacts/contact")[2]
    assert [child.tag for child in contact] == ["position", "normal", "impulse", "start"]
    assert (contact.get("master"), contact.get("slave"), contact.find("start").get("n")) == ("0", "2", "0.1")


# Old dialects


def test_dialect_a_bodies_and_settings():
    state = read_state(OLD_A)
    assert (state.name, state.time, state.step, state.dt, state.solved) == ("old_pybox2d", 0.12, 12, 0.01, True)
    assert state.world == World()  # the thesis's
    np.testing.assert_array_equal(state.bodies.velocity, [[-0.0125, -0.09809999912977219], [0.5, -1.25]])
    np.testing.assert_array_equal(state.bodies.angle, [0.25, 0])
    np.testing.assert_array_equal(state.bodies.spin, [-0.5, 0.0625])
    np.testing.assert_array_equal(state.bodies.radius, [1, 1])


def test_dialect_a_contacts_with_the_box_in_a_corner():
    """The box is master there and the normal points at the circle; here the circle comes first.

    Normal, tangent and relative velocity turn round together, so that the impulses stay as they are.
    Separations follow from the geometry: circle at (1.0025, 1.005), r = 1, and walls that reach 0.01 (Box2D's skin).
    """
    contacts = read_state(OLD_A).contacts
    np.testing.assert_array_equal([contacts.body_a, contacts.body_b], [[0, 0, 0], [1, 2 + BOTTOM, 2 + LEFT]])
    np.testing.assert_array_equal(contacts.normal, [[0.6004689, 0.7996481], [0, -1], [-1, 0]])
    np.testing.assert_array_equal(contacts.normal_impulse, [2.5, 1.25, 0.5])
    np.testing.assert_array_equal(contacts.tangent_impulse, [0.75, 0.375, -0.125])
    np.testing.assert_array_equal(contacts.normal_start, 0)
    distance = np.hypot(2.1999998092651367 - 1.0024999380111694, 2.5999999046325684 - 1.0049999952316284)
    # 2e-7: the coordinates are float32.
    np.testing.assert_allclose(contacts.separation, [distance - 2, 0.005 - 0.01, 0.0025 - 0.01], rtol=0, atol=2e-7)


def test_old_files_without_inertia_are_of_solid_discs():
    """Those of 1 to 14 May 2018 have none."""
    text = re.sub(r"<inertia[^>]*/>", "", OLD_A.read_text())
    assert text != OLD_A.read_text()
    assert bits(parse_state(text.encode(), OLD_A.name)) == bits(read_state(OLD_A))


def test_a_body_needs_no_more_than_section_5_2_1_lists():
    """Mass, position, velocity, spin and inertia: the radius is sqrt(2 I / m), the angle 0."""
    body = (
        '<body index="0" type="free"><mass value="2.0"/><position x="5.0" y="6.0"/><velocity x="1.0" y="0.5"/>'
        '<spin omega="0.25"/><inertia value="2.25"/></body>'
    )
    state = parse_state(f'<configuration name="a" time="0"><bodies>{body}</bodies></configuration>'.encode(), "1.xml")
    assert state.bodies.radius == pytest.approx([1.5])
    assert (state.bodies.mass[0], state.bodies.spin[0], state.bodies.angle[0]) == (2.0, 0.25, 0.0)
    assert state.world.box == (0, 0, 30, 30)


def test_dialect_b_prints_normals_and_shapes():
    state = read_state(OLD_B)
    assert (state.step, state.dt, state.solved) == (7, constants.TIME_STEP, True)
    assert state.world.box == (0, 0, 30, 30)
    np.testing.assert_array_equal(state.contacts.normal, [[1, 2.9638e-5], [-1, 1.1e-5]])
    np.testing.assert_array_equal(state.contacts.body_b, [1, 3 + LEFT])
    np.testing.assert_array_equal(state.contacts.normal_impulse, [0.785398185253, 0.5])
    np.testing.assert_array_equal(state.contacts.tangent_impulse, [-0.0625, 0.03125])
    # Circle 2 is printed by no contact: m = 1.44 π and I give r = 1.2; the file has 12 digits of float32.
    np.testing.assert_allclose(state.bodies.radius, [1, 1, 1.2], rtol=1e-6)


def test_old_file_without_a_box_has_the_thesis_box_if_the_circles_are_inside():
    text = OLD_A.read_text()
    start, end = text.index('<body index="0"'), text.index('<body index="1"')
    text = text[:start] + text[end : text.index("<contacts>")] + "</configuration>"
    assert parse_state(text.encode(), "old.xml").world.box == (0, 0, 30, 30)
    with pytest.raises(StateFileError, match=r"no box.*31\.5"):
        parse_state(text.replace('x="2.1999998092651367"', 'x="31.5"').encode(), "old.xml")


@pytest.mark.parametrize("indices", [(7, 5, 6), (6, 5, 7), (0, 2, 1), (-1, 0, 1)])
def test_indices_may_start_anywhere_and_the_box_may_come_anywhere(indices):
    pattern, new = r'(body index|master|slave)="(\d)"', lambda match: f'{match[1]}="{indices[int(match[2])]}"'
    state = parse_state(re.sub(pattern, new, OLD_A.read_text()).encode(), "old_pybox2d_12.xml")
    if indices[1] < indices[2]:
        assert bits(state) == bits(read_state(OLD_A))
    else:  # the two circles change places, and their contact turns round
        np.testing.assert_array_equal(state.bodies.angle, [0, 0.25])
        np.testing.assert_array_equal(state.contacts.normal[0], [-0.6004689, -0.7996481])


def test_impulses_that_no_contact_has_leave_the_state_unsolved():
    state = parse_state(re.sub(r"<impulse [^>]*>", "", OLD_A.read_text()).encode(), "old.xml")
    assert not state.solved
    np.testing.assert_array_equal(state.contacts.normal_impulse, 0)


def test_old_box_is_placed_by_its_body():
    """Vertices of a Box2D loop are relative to their body; chains repeat the first one."""
    text = OLD_A.read_text().replace('<position x="0.0" y="0.0"/>', '<position x="-15.0" y="2.0"/>')
    loop = "dcLoopShape(vertices=[(30, 0), (30, 30), (0, 30), (0, 0)])"
    chain = "b2ChainShape(vertices: [(0.0, 0.0), (30.0, 0.0), (30.0, 30.0), (0.0, 30.0), (0.0, 0.0)])"
    for shape in (loop, chain):
        assert parse_state(text.replace(loop, shape).encode(), "old.xml").world.box == (-15, 2, 15, 32)


@pytest.mark.parametrize("shift", [(-15.0, 2.0), (3.0, -7.0)])
def test_separations_of_old_files_are_from_the_box_where_it_is(shift):
    """All is moved by the same way, so that no gap changes."""

    def moved(match):
        x, y = (float(match[k]) + by for k, by in zip((1, 2), shift))
        return f'<position x="{x!r}" y="{y!r}"/>'

    text = re.sub(r'<position x="([^"]*)" y="([^"]*)"/>', moved, OLD_A.read_text())
    state, plain = parse_state(text.encode(), "old.xml"), read_state(OLD_A)
    np.testing.assert_allclose(state.contacts.separation, plain.contacts.separation, atol=1e-12)
    np.testing.assert_allclose(state.bodies.position, plain.bodies.position + shift)


def test_separations_of_old_files_are_from_every_wall():
    bodies, box = make_bodies([[1.0, 2.0]], radius=0.25), (0.5, 1.0, 9.0, 12.0)
    found = state_xml._separations(np.zeros(4, int), 1 + np.arange(4), bodies, box)
    np.testing.assert_allclose(found, np.array([1.0, 8.0, 10.0, 0.5]) - 0.25 - constants.WALL_SKIN * 0.25)


@pytest.mark.parametrize("indices", [(0, 1, 3), (1, 0, 3), (0, 2, 4), (0, 3, 2)])
def test_a_gap_in_the_indices_of_circles_is_the_boxs_alone(indices):
    """The first circle, the box and the second circle get these indices."""
    first, box, second = indices
    order = {"0": box, "1": first, "2": second}
    change = lambda match: f'{match[1]}="{order[match[2]]}"'  # noqa: E731
    text = re.sub(r'(body index|master|slave)="(\d)"', change, OLD_A.read_text())
    with pytest.raises(StateFileError, match="index: expected no gap"):
        parse_state(text.encode(), "old.xml")


# Files that are refused. (which file, what to replace, by what, the element and words of the message)

BAD = [
    ("ours", '<spin omega="0.25"/>', '<spin omega="nan"/>', "<spin>.*'nan'"),
    ("ours", '<velocity x="0.5"', '<velocity x="1_0"', "<velocity>.*'1_0'"),
    ("ours", 'radius="1.0"', 'radius="-1.0"', "<shape>.*'-1.0'"),
    ("ours", '<inertia value="1.5', '<inertia value="2.5', "<inertia>.*'2.57"),
    ("ours", '<body index="1"', '<body index="0"', "<body> '0'.*duplicate"),
    ("ours", '<body index="1"', '<body index="4"', "<body> '4'.*there is no 1"),
    ("ours", 'master="0" slave="1"', 'master="0" slave="9"', "<contact> '0'.*slave: .*'9'"),
    ("ours", 'master="0" slave="1"', f'master="{"9" * 30}" slave="1"', "<contact>.*'9999"),
    ("ours", '<mass value="3.141592653589793"/>', "<mass/>", "<mass>.*value: .*missing"),
    ("ours", '<spin omega="0.25"/>', "", "<body> '0'.*<spin> is missing"),
    ("ours", '<spin omega="0.25"/>', '<spin omega="0"/><spin omega="1"/>', "<spin>.*second"),
    ("ours", "<mass ", '<mass colour="red" ', "<mass> of body '0': colour: no such .*, expected value, got 'red'"),
    ("ours", "<position ", '<position z="0" ', "<position> of body '0': z: no such attribute, expected x, y, got '0'"),
    ("ours", "<impulse ", '<impulse x="0" ', "<impulse> of contact '0': x: no such attribute, expected n, t, got '0'"),
    ("ours", '<shape value="circle"', '<shape radii="2" value="circle"', "<shape> of body '0': radii: no such"),
    ("ours", '<mass value="0.0"', '<mass values="1" value="0.0"', "<mass> of body '.': values: no such attribute"),
    ("ours", "<corner ", '<corner z="0" ', "<corner>: z: no such attribute, expected x, y, got '0'"),
    ("a", "<mass ", '<mass colour="red" ', "<mass> of body '.': colour: no such attribute"),
    ("ours", ' sweeps="', ' sweep="', "<solver>.*option of PGS: expected one of .*, got .*sweep.*; did you mean"),
    ("ours", ' sweeps="3000"', ' sweeps="-3"', "<solver>.*sweeps: .*-3"),
    ("ours", ' slop="0.005"', "", "<scales>.*slop: .*missing"),
    ("ours", 'type="free"', 'type="flying"', "<body> '0'.*type: .*'flying'"),
    ("ours", '<normal x="1.0" y="0.0"/>', '<normal x="2.0" y="0.0"/>', "<normal>.*'2.0, 0.0'"),
    ("ours", '<impulse n="0.5"', '<impulse n="-0.5"', "<impulse>.*'-0.5'"),
    ("ours", '<corner x="30.0" y="0.0"/>', '<corner x="30.0" y="1.0"/>', "<shape>.*corners"),
    ("ours", "<bodies>", '<bodies count="10737418240">', "<bodies>.*count: .*'10737418240'"),
    ("ours", 'normal x="-1.0" y="0.0"', 'normal x="-0.0" y="-1.0"', "<contact> '2': expected no second .* '1'"),
    ("a", "<bodies>", '<scales slop="0.1"/><bodies>', "<scales>: expected no 'scales' in an old file"),
    ("a", '<impulse ni="0.5" ti="-0.125"/>', "", "<contact> '1': element <impulse> is missing"),
    ("a", "dcCircleShape(radius=1)", "dcCircleShape(radius=__import__('os'))", "<shape>.*__import__"),
    ("a", '"dcCircleShape(radius=1)"', '""', "<shape> of body '1'.*expected circle"),
    ("a", "dcLoopShape(vertices=[(30, 0), (30, 30), (0, 30), (0, 0)])", "", "<shape> of body '0'.*expected box"),
    ("a", "(30, 30)", "(31, 30)", "<shape>.*corners"),
    ("a", 'vel_iter="5000"', 'vel_iter="99999999999"', "sweeps: "),
    ("b", "b2Vec2(-1,-2.9638e-05)", "b2Vec2(-1,__import__('os'))", "<normal> of contact '0'.*__import__"),
]


@pytest.mark.parametrize(("source", "old", "new", "words"), BAD)
def test_bad_value_is_named_with_file_line_and_element(tmp_path, source, old, new, words):
    ours = format_state(example(solver=PGS(), world=World(scales=BOX2D))).decode()
    text = {"ours": ours, "a": OLD_A.read_text(), "b": OLD_B.read_text()}[source]
    assert old in text, "the case does not change the file"
    path = tmp_path / "pile_3.xml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(StateFileError, match=rf"^{path}, line \d+, .*{words}") as error:
        read_state(path)
    line = text[: text.index(old)].count("\n") + 1
    of_parent = new == "" or any(part in words for part in ("corners", "second", "<configuration>"))
    assert f", line {line}, " in str(error.value) or of_parent


BOMB = '<?xml version="1.0"?>\n<!DOCTYPE b [<!ENTITY a0 "ha">'
BOMB += "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))
OURS = format_state(example())


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "empty"),
        *((OURS[: int(share * len(OURS)) or 1], "") for share in (0.0005, 0.1, 0.5, 0.9, 0.999)),
        (b"index,mass\n0,1\n", "not well-formed"),
        (b"<configuration>" + b"<a>" * 100_000, "not well-formed"),
        (b"\x89PNG\r\n\x1a\n", "UTF-8"),
        ("<configuration/>".encode("utf-16-le"), "NUL"),
        (b'<?xml version="1.0" encoding="UTF-7"?>\n<configuration/>', "encoding: .*'UTF-7'"),
        (b"<scene/>", "root <configuration>, got 'scene'"),
        (b'<configuration xmlns="urn:x"/>', "root <configuration>"),
        (b"<configuration/>", "name: attribute is missing"),
        (b'<configuration name="a" time="0">&bomb;</configuration>', "bomb"),
        (f'{BOMB}]>\n<configuration name="&a11;" time="0"/>'.encode(), "DOCTYPE"),
        # libxml2 needs some 120 bytes for an element of 4, so the limit on bytes alone would not bound the memory.
        (b"<configuration>" + b"<a/>" * 760_000 + b"</configuration>", r"expected at most \d+ '<'"),
        (b"<configuration>" + b'<a b="" c="" d=""/>' * 510_000 + b"</configuration>", r"expected at most \d+ '='"),
    ],
    ids=lambda value: "" if isinstance(value, bytes) else value,
)
def test_what_is_no_state_file(data, words):
    with pytest.raises(StateFileError, match=rf"^x\.xml, line \d+.*: .*{words}"):
        parse_state(data, "x.xml")


SCHEMA = ' xmlns:i="http://www.w3.org/2001/XMLSchema-instance" i:noNamespaceSchemaLocation="{}"'


@pytest.mark.parametrize(
    ("before", "within", "inside"),
    [
        ('<!DOCTYPE c SYSTEM "{}">', "", ""),
        *((f"<!DOCTYPE c [<!ENTITY s {kind}>]>", "", "&s;") for kind in ('SYSTEM "{}"', 'PUBLIC "x" "{}"')),
        *((f"<!DOCTYPE c [<!ENTITY % s {kind}> %s;]>", "", "&s;") for kind in ('SYSTEM "{}"', 'PUBLIC "x" "{}"')),
        ('<?xml-stylesheet type="text/xsl" href="{}"?>', "", ""),
        ("", "", '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" parse="text" href="{}"/>'),
        ("", SCHEMA, ""),
    ],
)
def test_nothing_that_a_file_points_to_is_opened(tmp_path, before, within, inside):
    """A pipe without a writer, which would hang, and a port of this machine."""
    os.mkfifo(tmp_path / "secret")
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        for place in ((tmp_path / "secret").as_uri(), f"http://127.0.0.1:{server.getsockname()[1]}/secret"):
            text = f'{before}\n<configuration name="n" time="0"{within}>{inside}</configuration>'.replace("{}", place)
            with suppress(StateFileError):
                parse_state(text.encode(), "x.xml")
        with pytest.raises(BlockingIOError):
            server.accept()


def test_pipes_and_folders_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.xml")
    for path in (tmp_path / "pipe.xml", tmp_path):
        with pytest.raises(StateFileError, match="expected a file"):
            read_state(path)


BOMBS = [gzip.compress(bytes(2**26 + 1), 1), 300 * gzip.compress(b" " * 2**20), 2_000_000 * gzip.compress(b"")]


@pytest.mark.parametrize("data", BOMBS)
def test_gzip_bomb_is_refused_while_it_is_unpacked(tmp_path, data):
    """In one member, and in many, of which two million took 6 s."""
    path = tmp_path / "bomb.xml.gz"
    path.write_bytes(data)
    tracemalloc.start()
    start = time.process_time()
    with pytest.raises(StateFileError, match=r"bomb\.xml\.gz.*67108864 bytes"):
        read_state(path)
    assert time.process_time() - start < 1
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 150 * 2**20


def test_many_attributes_of_one_element_are_refused_in_linear_time():
    """To look up each of 80,000 values from the first attribute on took 8 s and more."""
    names = b" ".join(b'a%d="1"' % i for i in range(80_000))
    start = time.process_time()
    with pytest.raises(StateFileError, match="a0: no such attribute"):
        parse_state(b"<configuration " + names + b"/>", "x.xml")
    with pytest.raises(StateFileError, match="a0: no such attribute"):
        parse_state(OLD_A.read_bytes().replace(b'<position x="0.0" y="0.0"', b"<position " + names), "x.xml")
    assert time.process_time() - start < 2


@pytest.mark.parametrize("place", [slice(-9, None), slice(-6, -5), slice(20, 21), slice(0, None)])
def test_damaged_gzip(tmp_path, place):
    """Cut off, another checksum, other data, none."""
    path = tmp_path / "s.xml.gz"
    write_state(path, example())
    data = bytearray(path.read_bytes())
    data[place] = b"" if place.start == -9 else b"\xff"
    path.write_bytes(data)
    with pytest.raises(StateFileError, match=r"s\.xml\.gz"):
        read_state(path)


# Writing


BODIES, CONTACTS = example().bodies, example().contacts


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("s.xml", {"bodies": BODIES._replace(mass=np.array([1.0, np.nan]))}, r"s\.xml: not written: bodies\.mass\[1\]"),
        ("s.xml", {"name": "bell\a"}, "name"),
        ("s.xml", {"name": "\ud800"}, "name"),
        ("s.xml", {"solver": object()}, "solver"),
        ("s.xml", {"step": 1.5}, "step"),
        ("s.xml", {"step": 10**20}, "step"),
        ("s.xml", {"contacts": CONTACTS._replace(normal=-CONTACTS.normal)}, "wall 'floor'"),
        *(
            (name, {}, rf"expected a name that ends in \.xml or \.xml\.gz, got '{name}'")
            for name in ("a.h5", "a.gz", "xml")
        ),
    ],
)
def test_what_would_not_come_back_is_not_written(tmp_path, name, change, words):
    with pytest.raises(StateFileError, match=words):
        write_state(tmp_path / name, example(**change))
    assert list(tmp_path.iterdir()) == []


def test_state_larger_than_can_be_read_is_not_written(monkeypatch, tmp_path):
    monkeypatch.setattr(xml_tree, "MAX_TAGS", 30)
    with pytest.raises(StateFileError, match="too large"):
        write_state(tmp_path / "s.xml", example())


def test_two_thousand_damaged_files_only_raise_state_file_errors():
    """The whole run is `fuzz.py xml --inputs 1000000`."""
    pytest.importorskip("atheris")
    printed = run_python(TOOLS / "fuzz.py", "xml", "--inputs", 2000, "--seed", 1).stdout
    assert "'read'" in printed
    assert "'refused'" in printed
