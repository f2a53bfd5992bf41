"""What notebooks and editors show: short reprs, inline pictures; and states that compare."""

import base64
import dataclasses
import io
import json
import re
import sys
import types
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import circles_at
from PIL import Image

import deep_contact as dc
from deep_contact.plot import notebook
from deep_contact.run import trajectory


@pytest.fixture(scope="module")
def run():
    return dc.simulate(dc.column(3), steps=60, solver=dc.PGS(), record=20)


def shown_in(html):
    """The pictures in HTML."""
    found = re.findall(r'src="data:image/\w+;base64,([^"]*)"', html)
    return [Image.open(io.BytesIO(base64.b64decode(data))) for data in found]


def lines_in(html):
    """Pixels of the colour of impulses, in the one picture."""
    (picture,) = shown_in(html)
    red, green, blue = np.asarray(picture.convert("RGB"), int).transpose(2, 0, 1)
    return np.count_nonzero((red > 180) & (green < 120) & (blue < 60))


def test_a_state_shows_its_numbers_and_a_picture(run):
    html = run.state.replace(name="<script>")._repr_html_()
    assert "3 circles" in html
    assert "<script>" not in html
    assert lines_in(html) > 50
    assert lines_in(run.state.replace(contacts=None)._repr_html_()) == 0


def test_what_cannot_be_drawn_is_left_out():
    state = dc.column(2)
    state.bodies.position[0] = np.nan
    assert shown_in(state._repr_html_())
    many = dc.lattice_in_box(notebook.MOST_CIRCLES + 1)._repr_html_()
    assert "5,001 circles" in many
    assert not shown_in(many)


def test_a_run_shows_how_its_solves_ended_and_a_trajectory_plays(run, monkeypatch):
    assert "converged" in run._repr_html_()
    assert dc.simulate(dc.column(1), steps=0)._repr_html_()
    for most, times in ((12, 4), (6, 2)):  # of four states of three circles every one, and every second
        monkeypatch.setattr(trajectory, "MOST_SHOWN", most)
        frame = ElementTree.fromstring(run.trajectory._repr_html_())
        assert (frame.tag, frame.get("sandbox")) == ("iframe", "allow-scripts")
        data = json.loads(re.search(r'application/json">(.*?)</script>', frame.get("srcdoc"))[1])
        assert data["times"] == run.trajectory.times[:: 4 // times].tolist()
    monkeypatch.setattr(trajectory, "MOST_SHOWN", 5)
    assert "iframe" not in run.trajectory._repr_html_()


def test_a_simulator_shows_its_state_and_is_drawn_anew_in_its_place(monkeypatch):
    """As IPython calls it: `display` gives a place, `update` draws there. Another cell gets another place."""
    live, calls, cell = dc.Simulator(dc.column(3), solver=dc.PGS()), [], types.SimpleNamespace(execution_count=1)

    class Place:
        def update(self, shown):
            calls.append(("anew", shown.time))

    def display(shown, display_id):
        calls.append(("here", shown.time))
        return Place()

    with pytest.raises(ValueError, match="show: expected a notebook"):
        live.show()
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: cell))
    monkeypatch.setitem(sys.modules, "IPython.display", types.SimpleNamespace(display=display))
    live.show(5, every=2)
    live.show()
    cell.execution_count = 2
    live.show()
    assert [name for name, _ in calls] == ["here", "anew", "anew", "anew", "anew", "here"]
    np.testing.assert_allclose([time for _, time in calls], [0.0, 0.02, 0.04, 0.05, 0.05, 0.05])
    assert live._repr_html_() == live.state._repr_html_()
    for options in ({"steps": -1}, {"steps": 1, "every": 0}):
        with pytest.raises(ValueError, match="expected an integer"):
            live.show(**options)


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
        for start in ("none", "builtin", "sph", "far field"):
            dc.simulate(state, steps=3, solver=solver, warm_start=start)
            dc.solve_contacts(state, solver=solver, start=start)
    assert state == before
