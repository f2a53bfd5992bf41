"""Worlds with static segments in files and pictures: round trips, and what damaged files say."""

import re
from dataclasses import replace

import h5py
import numpy as np
import pytest

import deep_contact as dc
from deep_contact.figures import results
from deep_contact.io.simulation_h5 import DataFileError, write_simulation
from deep_contact.io.state_xml import format_state, parse_state
from deep_contact.io.xml_tree import StateFileError
from deep_contact.plot import plotting


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


def test_a_file_is_packed_quickly_and_has_no_more_than_its_states(run, tmp_path):
    run.trajectory.save(tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5") as file:
        for name, array in run.trajectory.stored.arrays.items():
            assert (file[name].shape, file[name].compression, file[name].compression_opts) == (array.shape, "gzip", 1)
            assert file[name].shuffle
            assert file[name].chunks[1:] == array.shape[1:]
    for compression in ("lzf", None):
        write_simulation(tmp_path / "other.h5", list(run.trajectory), compression=compression)
        with h5py.File(tmp_path / "other.h5") as file:
            assert file["position"].compression == compression
        assert list(dc.load_trajectory(tmp_path / "other.h5")) == list(run.trajectory)


def test_comments_and_line_breaks_say_nothing(run):
    text = format_state(run.state).decode()
    spread = text.replace("<contact ", "<!-- a comment --><contact\n").replace("<body ", "<?pi any?><!-- 1 --><body\n")
    assert spread.count("<!--") > 60
    assert parse_state(spread.encode(), "comments.xml") == run.state


def test_what_moves_turns_and_is_fixed_survives_both_kinds_of_files(tmp_path):
    """Also what else a world may have, and what only some segments have."""
    segments = [((0.0, 5.0), (9.0, 5.0)), ((0.0, 7.0), (9.0, 7.0)), ((0.0, 9.0), (9.0, 9.5))]
    world = dc.World(
        box=(-3.0, -1.0, 12.0, 14.0), gravity=(0.5, -3.0), friction=0.3, restitution=0.4, scales=dc.BOX2D,
        segments=segments, surface_speeds=(0.0, -2.0, 0.0),
        segment_velocities=[((0.0, 0.0), (0.0, 0.0)), ((1.0, 0.0), (0.0, -0.25)), ((0.0, 0.0), (0.0, 1e-3))],
    )  # fmt: skip
    bodies = dc.make_bodies(
        [[2.0, 5.4], [5.0, 7.4], [7.0, 3.0]], radius=[0.4, 0.5, 0.3], fixed=[False, False, True], spin=[0.0, 0.0, 2.0]
    )
    scene = dc.State(name="all of it", world=world, bodies=bodies, dt=0.004, time=1.0, step=3)
    moved = dc.simulate(scene, steps=8, solver=dc.PGS(sweeps=9, substeps=2), record=2)
    dc.write_state(tmp_path / "all.xml", moved.state)
    again = dc.read_state(tmp_path / "all.xml")
    assert again == moved.state
    assert again.world == moved.state.world
    assert again.world.segments != world.segments
    assert (again.bodies.is_fixed == [False, False, True]).all()
    moved.trajectory.save(tmp_path / "all.h5")
    stored = dc.load_trajectory(tmp_path / "all.h5")
    assert list(stored) == list(moved.trajectory)
    np.testing.assert_array_equal(stored.work, moved.trajectory.work)
    np.testing.assert_array_equal(stored.dissipated, moved.trajectory.dissipated)
    assert stored[2].world.segments == moved.trajectory[2].world.segments != world.segments
