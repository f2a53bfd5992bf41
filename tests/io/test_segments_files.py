"""Worlds with static segments in files and pictures: round trips, and what damaged files say."""

import re
from dataclasses import replace

import h5py
import numpy as np
import pytest

import deep_contact as dc
from deep_contact.io.simulation_h5 import DataFileError, write_simulation
from deep_contact.io.state_xml import format_state, parse_state
from deep_contact.io.xml_tree import StateFileError
from deep_contact.reporting import plotting, results


@pytest.fixture(scope="module")
def run():
    """A funnel in use, one side of which moves: contacts with circles, walls and segments."""
    scene = dc.hopper(60, opening=5.0, seed=1)
    belts = replace(scene.world, surface_speeds=[-0.5, *[0.0] * (len(scene.world.segments) - 1)])
    found = dc.simulate(scene.replace(world=belts), steps=300, solver=dc.PGS(sweeps=20), record=50)
    contacts = found.state.contacts
    assert {0, 1} <= set(contacts.body_b[contacts.body_b >= 64] - 64)
    assert ((contacts.body_b >= 60) & (contacts.body_b < 64)).any()
    return found


def test_a_state_survives_xml(run, tmp_path):
    path = tmp_path / "funnel.xml"
    dc.write_state(path, run.state)
    again = dc.read_state(path)
    assert again == run.state
    assert format_state(again) == path.read_bytes()
    assert b"segment" not in format_state(dc.column(2))
    assert b' speed="-0.5"' in format_state(run.state)
    on = [dc.simulate(state, steps=20).state for state in (run.state, again)]
    assert on[0].bodies == on[1].bodies


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<segment index="62"', '<segment index="61"', "segment.*index: expected"),
        ('slave="62"', 'slave="63"', "slave: expected"),
        ("<segment index", "<segment colour='red' index", "colour"),
        ('speed="-0.5"', 'speed="nan"', "speed.*nan"),
        (r'(<segment index="61") .*/>', r'\1 x_0="1.0" y_0="1.0" x_1="1.0" y_1="1.0"/>', "two different points"),
        (r'(<segment index="61") x_0="[^"]*"', r"\1", "x_0"),
        (r"(?s)<segments>.*</segments>", "", "expected the index of a body"),
        (r'master="\d+" slave="\d+"', 'master="60" slave="61"', "<contact> '0': master, slave: expected a circle"),
    ],
)
def test_a_damaged_file_is_refused(run, old, new, message):
    text = format_state(run.state).decode()
    damaged = re.sub(old, new, text, count=1)
    assert damaged != text
    with pytest.raises(StateFileError, match=f"(?s){message}"):
        parse_state(damaged.encode(), "damaged.xml")


def test_a_trajectory_survives_hdf5(run, tmp_path):
    run.trajectory.save(tmp_path / "funnel.h5")
    again = dc.load_trajectory(tmp_path / "funnel.h5")
    assert list(again) == list(run.trajectory)
    many = [((x, 0.0), (x, 1.0)) for x in range(2001)]
    state = run.state.replace(world=replace(run.state.world, segments=many, surface_speeds=()), contacts=None)
    state = dc.find_contacts(state)
    with pytest.raises(ValueError, match="segments: expected"):
        write_simulation(tmp_path / "many.h5", [state])
    write_simulation(tmp_path / "some.h5", [state.replace(world=replace(state.world, segments=many[:2000]))])
    assert len(dc.load_trajectory(tmp_path / "some.h5").world.segments) == 2000


@pytest.mark.parametrize(
    ("name", "value"),
    [*(("segments", bad) for bad in (np.zeros(4), np.zeros(6), np.zeros((1, 4)), np.arange(8.0) * np.nan)),
     ("surface_speeds", np.ones(59))],
)  # fmt: skip
def test_damaged_segments_of_a_trajectory_are_refused(run, tmp_path, name, value):
    run.trajectory.save(tmp_path / "bad.h5")
    with h5py.File(tmp_path / "bad.h5", "r+") as file:
        file.attrs.create(name, value)
    with pytest.raises(DataFileError, match=name):
        dc.load_trajectory(tmp_path / "bad.h5")


def test_pictures_show_segments(run):
    _, ax = plotting.subplots()
    plotting.draw_state(ax, run.state)
    drawn = [c for c in ax.collections if hasattr(c, "get_segments")]
    wanted = np.reshape(run.state.world.segments, (-1, 2, 2))
    assert any(np.array_equal(c.get_segments(), wanted) for c in drawn)
    again = plotting.state_of(results.plain(plotting.state_data(run.state)))
    assert again.world.segments == run.state.world.segments
    plotting.body_values(run.state, "impulse")


@pytest.mark.parametrize("start", ["copy", "scaled", "sph", "far field"])
def test_starts_take_contacts_with_segments_as_with_walls(run, start):
    solution = dc.solve_contacts(run.state, solver=dc.PGS(sweeps=30_000, tolerance=1e-10), start=start)
    plain = dc.solve_contacts(run.state, solver=dc.PGS(sweeps=30_000, tolerance=1e-10))
    np.testing.assert_allclose(solution.velocities, plain.velocities, atol=1e-4)
