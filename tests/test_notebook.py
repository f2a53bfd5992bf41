"""What notebooks and editors show: short reprs, inline pictures; and states that compare."""

import base64
import dataclasses
import io
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import circles_at
from PIL import Image

import deep_contact as dc
from deep_contact import trajectory
from deep_contact.state import notebook


@pytest.fixture(scope="module")
def run():
    return dc.simulate(dc.column(3), steps=60, solver=dc.PGS(), record=20)


def picture_in(html):
    """The inline SVG as XML."""
    return ElementTree.fromstring(html[html.index("<svg") : html.index("</svg>") + len("</svg>")])


def test_a_state_shows_each_circle_and_contact_where_it_is(run):
    state = run.state
    svg = picture_in(state._repr_html_())
    circles, lines = svg.findall("g/circle"), svg.findall("g/line")
    assert (len(circles), len(lines)) == (3, 3)
    widths = [float(line.get("stroke-width")) for line in lines]
    assert np.argsort(widths).tolist() == np.argsort(state.contacts.normal_impulse).tolist()
    frame = svg.find("rect")
    x_min, _, x_max, y_max = state.world.box
    scale = float(frame.get("width")) / (x_max - x_min)
    for circle, (x, y), r in zip(circles, state.bodies.position, state.bodies.radius):
        found = [float(circle.get(name)) for name in ("cx", "cy", "r")]
        # Of a tenth of a pixel, and the y axis of a screen points down.
        assert found == pytest.approx([(x - x_min) * scale, (y_max - y) * scale, r * scale], abs=0.6)


def test_what_cannot_be_drawn_is_left_out():
    state = dc.column(2)
    state.bodies.position[0] = np.nan
    assert len(picture_in(state._repr_html_()).findall("g/circle")) == 1
    many = dc.lattice_in_box(notebook.MOST_CIRCLES + 1).replace(name="<script>")
    assert "<svg" not in many._repr_html_()
    assert "5,001 circles" in many._repr_html_()
    assert "<script>" not in many._repr_html_()


def test_a_run_shows_how_its_solves_ended_and_a_trajectory_plays(run, monkeypatch):
    assert "converged" in run._repr_html_()
    assert dc.simulate(dc.column(1), steps=0)._repr_html_()
    for most, count in ((40, 4), (3, 2)):  # of four states every one, and every second
        monkeypatch.setattr(trajectory, "MOST_FRAMES", most)
        film = re.search(r'src="data:image/gif;base64,(.*)"', run.trajectory._repr_html_())[1]
        with Image.open(io.BytesIO(base64.b64decode(film))) as gif:
            assert gif.n_frames == count


def test_a_state_names_the_walls_that_are_touched():
    """Floor: 1.01 m below two centres; the first touches the left wall as well, and one lies on a segment."""
    state = dc.find_contacts(circles_at([[1.01, 1.01], [3.5, 1.01], [20.0, 11.01]], segments=[((18, 10), (22, 10))]))
    assert "floor 2, left 1, segments 1" in repr(state)
    assert "floor 2, left 1, segments 1" in state._repr_html_()
    assert "floor" not in repr(state.replace(contacts=None))


def test_arrays_plans_and_recommendations_are_tables(run):
    def cells(shown):
        rows = ElementTree.fromstring(shown).iter("tr")
        return [[cell.text for cell in row] for row in rows if row.find("td") is not None]

    bodies = dc.make_bodies(np.outer(np.arange(12.0), [3.0, 0.0]) + 1.0)
    rows = cells(bodies._repr_html_())
    assert rows[0] == ["0", "1, 1", "0, 0", "0", "0", "3.142", "1"]
    assert rows[-1] == ["…", "2 more"]
    assert cells(run.state.contacts._repr_html_())[2][:3] == ["2", "1", "2"]
    assert cells(dc.recommend(run.state)._repr_html_())
    assert cells(dc.plan(run.state)._repr_html_())


# ---- states that compare, and that nothing changes by accident ----


def test_states_are_equal_if_all_their_numbers_are_and_cannot_be_set(run):
    state, again = run.state, dc.simulate(dc.column(3), steps=60, solver=dc.PGS()).state
    assert state == again
    assert not state != again
    moved = state.bodies._replace(position=state.bodies.position + 1e-15)
    for change in ({"time": 7.0}, {"contacts": None}, {"bodies": moved}):
        assert state != state.replace(**change)
    assert state.bodies != moved
    assert state.contacts == again.contacts
    assert state != "a state"
    with pytest.raises(TypeError, match="unhashable"):
        hash(state)
    with pytest.raises(dataclasses.FrozenInstanceError):
        state.time = 1.0


def copied(state):
    bodies, contacts = (type(part)(*map(np.copy, part)) for part in (state.bodies, state.contacts))
    return state.replace(bodies=bodies, contacts=contacts)


@pytest.mark.parametrize("locked", [False, True])
def test_nothing_writes_into_a_state(locked):
    """Nor into one whose arrays cannot be written to, which is taken as well."""
    position = np.array([[1.0, 1.0]])
    bodies = dc.make_bodies(position)
    position[:] = 5.0
    assert bodies.position.tolist() == [[1.0, 1.0]]
    state = dc.simulate(dc.column(3), steps=60).state
    before = copied(state)
    for array in (*state.bodies, *state.contacts):
        array.flags.writeable = not locked
    for solver in (dc.PGS(), dc.BatchedPGS()):
        for start in ("none", "builtin", "sph", "cnn"):
            dc.simulate(state, steps=3, solver=solver, warm_start=start)
            dc.solve_contacts(state, solver=solver, start=start)
    assert state == before
