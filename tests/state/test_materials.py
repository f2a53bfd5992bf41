"""Materials: which tables and integers a world and its circles take, and where they are stored."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.io.simulation_h5 import pack_simulation, read_simulation, write_simulation
from deep_contact.io.state_xml import format_state, parse_state
from deep_contact.io.xml_tree import StateFileError
from deep_contact.state.checks import check_state
from deep_contact.state.materials import MOST_MATERIALS, at_contacts, in_scene
from deep_contact.stepping.inputs import step_input
from deep_contact.stepping.pairs import PairTable

THREE = {
    "friction": [[0.5, 0.1, 0.2], [0.1, 0.0, 0.3], [0.2, 0.3, 0.9]],
    "restitution": [[0.0, 0.5, 0.25], [0.5, 1.0, 0.75], [0.25, 0.75, 0.1]],
    "touches": [[True, False, True], [False, True, True], [True, True, True]],
    "wall_materials": [2, 1, 0, 1],
    "segments": [[(0.0, 4.0), (9.0, 4.0)], [(0.0, 8.0), (9.0, 8.0)]],
    "segment_materials": [1, 2],
}


def scene(**world):
    """Three circles of the materials 0, 1 and 2 on the floor of a box with two shelves."""
    position = [[3.0, 1.009], [7.0, 1.009], [11.0, 1.009]]
    return circles_at(position, material=[0, 1, 2], box=(0.0, 0.0, 20.0, 20.0), **THREE | world)


@pytest.mark.parametrize(
    ("world", "message"),
    [
        ({"friction": [[0.5, 0.1], [0.2, 0.5]]}, r"friction\[1\]\[0\]: expected 0.1, as in \[0\]\[1\], got 0.2"),
        ({"friction": [[0.5, 0.1]]}, "friction: expected a number, or a symmetric table"),
        ({"friction": [[0.5], [0.1, 0.2]]}, "friction: expected a number, or a symmetric table"),
        ({"friction": [0.5, 0.1]}, "friction: expected a number, or a symmetric table"),
        ({"friction": [[0.5, -0.1], [-0.1, 0.5]]}, r"friction\[0\]\[1\]: expected a finite number >= 0, got -0.1"),
        ({"friction": [[0.5, np.nan], [np.nan, 0.5]]}, r"friction\[0\]\[1\]: expected a finite number"),
        ({"restitution": [[0.5, 1.1], [1.1, 0.5]]}, r"restitution\[0\]\[1\]: expected .* <= 1, got 1.1"),
        ({"touches": 1}, "touches: expected True, or a symmetric table"),
        ({"touches": [[1, 0], [0, 1]]}, "touches: expected True, or a symmetric table"),
        ({"touches": [[True, False], [True, True]]}, r"touches\[1\]\[0\]: expected False"),
        ({"friction": np.eye(2), "restitution": np.eye(3)}, "restitution: expected a table of 2 materials"),
        ({"friction": np.eye(65)}, "friction: expected a number, or a symmetric table .* up to 64"),
        ({"wall_materials": (0, 1, 2)}, "wall_materials: expected 4 integers from 0 to 63"),
        ({"wall_materials": (0, 1, 2, -1)}, "wall_materials: expected 4 integers"),
        ({"wall_materials": (0, 1, 2, 1.0)}, "wall_materials: expected 4 integers"),
        ({"wall_materials": (0, 1, 2, 64)}, "wall_materials: expected 4 integers"),
        ({"wall_materials": (0, 0, 0, 2), "friction": np.eye(2)}, "wall_materials: expected materials from 0 to 1"),
        ({"segment_materials": [1]}, "segment_materials: expected 0 integers"),
    ],
)
def test_a_world_refuses(world, message):
    with pytest.raises(ValueError, match=message):
        dc.World(**world)


@pytest.mark.parametrize("material", [1.0, [0, 1, 2], -1, MOST_MATERIALS, [[0, 1]], "steel"])
def test_circles_refuse(material):
    with pytest.raises(ValueError, match="material"):
        dc.make_bodies([[1.0, 1.0], [4.0, 1.0]], material=material)


def test_circles_of_a_material_without_a_row_are_refused():
    state = scene(touches=True, restitution=0.0, friction=np.eye(3))
    bodies = state.bodies._replace(material=np.array([0, 3, 1]))
    for use in (check_state, dc.find_contacts, lambda state: dc.simulate(state, steps=1), dc.forces):
        with pytest.raises(ValueError, match=r"bodies.material: expected materials from 0 to 2, .* got 3"):
            use(state.replace(bodies=bodies, contacts=None))


def test_without_materials_all_are_0():
    bodies = dc.make_bodies([[1.0, 1.0]])
    bare = dc.Bodies(*bodies[:6])
    assert dc.State(name="", world=dc.World(), bodies=bare) == dc.State(name="", world=dc.World(), bodies=bodies)


def test_values_of_pairs_are_those_of_the_table():
    state = dc.find_contacts(scene(touches=True))
    np.testing.assert_array_equal(state.contacts.body_b, [3, 3, 3])
    np.testing.assert_array_equal(at_contacts(state, state.world.friction), [0.2, 0.3, 0.9])
    assert at_contacts(state, 0.7) == 0.7
    assert in_scene(state, state.world.restitution).max() == 1.0


def test_a_table_that_the_scene_does_not_need_is_a_number_in_steps():
    unused = np.full((3, 3), 0.3)
    unused[2, :] = unused[:, 2] = 0.9
    state = circles_at([[3.0, 1.0], [7.0, 1.0]], material=[0, 1], friction=unused)
    assert step_input(dc.find_contacts(state), dc.PGS()).friction == 0.3
    used = state.replace(world=replace(state.world, wall_materials=(2, 0, 0, 0)))
    assert isinstance(step_input(dc.find_contacts(used), dc.PGS()).friction, PairTable)


def test_worlds_and_bodies_are_compared_with_their_materials():
    assert scene() == scene()
    assert dc.World(friction=np.full((1, 1), 0.3)) == dc.World(friction=0.3)
    for other in ({"wall_materials": (0, 1, 0, 1)}, {"segment_materials": ()}, {"touches": True}, {"friction": 0.1}):
        assert scene(**other) != scene()
    state = scene()
    assert state.replace(bodies=state.bodies._replace(material=np.array([0, 1, 1]))) != state
    hash(state.world)


@pytest.mark.parametrize("world", [{}, {"friction": 0.3, "restitution": 0.5}, {"touches": True}])
def test_files_store_materials(world, tmp_path):
    state = dc.find_contacts(scene(**world))
    assert parse_state(format_state(state), "x") == state
    write_simulation(tmp_path / "run.h5", [state, state.replace(step=1)])
    stored = read_simulation(tmp_path / "run.h5")
    assert stored.state(1) == state.replace(step=1)
    assert stored.digest == pack_simulation([state, state.replace(step=1)]).digest
    assert b"material" not in format_state(dc.column(2))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('count="3"', 'count="2"'),
        ('count="3"', 'count="99"'),
        ('<pair first="0" second="2"', '<pair first="0" second="1"'),
        ('touches="false"', 'touches="no"'),
        ('floor="2"', 'floor="3"'),
        ('material="2">', 'material="3">'),
        ('<pair first="0" second="2" friction="0.2"', '<pair first="0" second="2"'),
    ],
)
def test_a_damaged_file_is_refused(old, new):
    text = format_state(scene()).decode()
    assert old in text
    with pytest.raises(StateFileError, match="line"):
        parse_state(text.replace(old, new, 1).encode(), "x")


@pytest.mark.slow  # a kind of step of its own; test_without_compiler.py runs it interpreted
def test_added_circles_bring_their_materials():
    state = scene().with_bodies(remove=[0], add=dc.make_bodies([[15.0, 5.0]], material=2))
    np.testing.assert_array_equal(state.bodies.material, [1, 2, 2])
    live = dc.Simulator(scene(), solver=dc.PGS(sweeps=5))
    live.add(dc.make_bodies([[15.0, 5.0]], material=1))
    live.set(segments=[[(0.0, 4.0), (9.0, 4.0)]])  # the materials of two segments do not fit one
    assert live.state.world.segment_materials == ()
    np.testing.assert_array_equal(live.state.bodies.material, [0, 1, 2, 1])
