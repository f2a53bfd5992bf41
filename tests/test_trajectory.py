"""`deep_contact.trajectory`: a run as arrays, as a file, and as a film."""

import os

import numpy as np
import pytest
from conftest import circles_at, solved_states
from matplotlib import animation, colormaps
from PIL import Image

import deep_contact as dc
from deep_contact.physics.metrics import kinetic_energy
from deep_contact.reporting.film import Canvas
from deep_contact.trajectory import Trajectory, load_trajectory


@pytest.fixture(scope="module")
def states():
    """Circles that fall, touch and turn."""
    return solved_states(dc.circles_in_box(12, size=10, radius=(0.5, 0.9), seed=0), steps=120, every=10)


@pytest.fixture(scope="module")
def run(states):
    return Trajectory.from_states(states)


def test_arrays_and_states_are_those_it_was_made_of(run, states):
    assert len(run) == len(states) > 5
    assert list(run) == states
    assert run[-1] == states[-1]
    with pytest.raises(IndexError):
        run[len(states)]
    columns = zip(run.times, run.positions, run.velocities, run.angles, run.spins, strict=True)
    for i, (state, (time, *motion)) in enumerate(zip(states, columns, strict=True)):
        assert time == state.time
        assert all(map(np.array_equal, motion, state.bodies))
        mine, c = slice(*run.offsets[i : i + 2]), state.contacts
        np.testing.assert_array_equal(run.pairs[mine], np.column_stack([c.body_a, c.body_b]))
        np.testing.assert_array_equal(run.impulses[mine], np.column_stack([c.normal_impulse, c.tangent_impulse]))


def test_energies_are_those_of_mechanics(run, states):
    """m v²/2 + I ω²/2, and m g y."""
    kinetic = [kinetic_energy(state.bodies) for state in states]
    potential = [9.81 * state.bodies.mass @ state.bodies.position[:, 1] for state in states]
    np.testing.assert_allclose(run.energies, np.column_stack([kinetic, potential]), rtol=1e-12)


def test_a_file_gives_the_same_run(run, tmp_path):
    run.save(tmp_path / "runs" / "fall.h5")
    again = load_trajectory(tmp_path / "runs" / "fall.h5")
    assert again.stored.digest == run.stored.digest
    assert repr(again) == repr(run)


def test_a_film_shows_circles_where_they_are_in_the_colour_of_their_speed(tmp_path):
    scene = dc.circles_in_box(12, size=10, radius=(0.5, 0.9), seed=0)
    run = dc.simulate(scene, steps=8, record=2).trajectory  # before anything touches
    assert not run.impulses.any()
    with Image.open(run.film(tmp_path / "films" / "fall.gif", fps=10, size=208, every=3)) as gif:
        assert (gif.n_frames, gif.info["duration"]) == (-(-len(run) // 3), 100)
        picture = np.asarray(gif.convert("RGB"), float)
    assert max(picture.shape) == 208
    state, scale = run[0], 192 / 10
    fastest = np.hypot(*run.velocities.reshape(-1, 2).T).max()
    for (x, y), radius, speed in zip(state.bodies.position, state.bodies.radius, np.hypot(*state.bodies.velocity.T)):
        column, row = (int(8 + scale * value) for value in (x, 10 - y))
        colour = 255 * np.array(colormaps["viridis"](speed / fastest)[:3])
        assert np.abs(picture[row, column] - colour).max() < 24
        assert np.abs(picture[int(8 + scale * (10 - y - radius)) - 2, column] - colour).max() > 24


@pytest.mark.skipif(os.name != "posix", reason="a program by a shell script")
def test_an_mp4_gets_the_pictures_or_says_that_ffmpeg_is_missing(run, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="path: expected"):
        run.film(tmp_path / "fall.avi")
    (tmp_path / "ffmpeg").write_text('#!/bin/sh\nfor last; do :; done\ncat > "$last"\n')  # keeps the raw pictures
    (tmp_path / "ffmpeg").chmod(0o755)
    with monkeypatch.context() as patch:
        patch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
        film = run.film(tmp_path / "fall.mp4", size=32)  # the least
    assert film.stat().st_size == len(run) * 32 * 32 * 3
    monkeypatch.setattr(animation.writers, "is_available", lambda writer: False)
    with pytest.raises(ValueError, match="path: expected"):
        run.film(tmp_path / "fall.mp4")


def test_lines_of_a_film_are_as_wide_as_their_impulses_and_walls_lie_at_the_edge_of_the_box():
    """A box of 10 m × 4 m in 216 pixels: 20 a metre, 8 around. The widest line has 4.3 points, 9 pixels."""
    state = dc.find_contacts(
        circles_at([[4.0, 2.0], [6.0, 2.0]], box=(0.0, 0.0, 10.0, 4.0), velocity=[[0, 0], [3.0, 0]])
    )
    canvas, widths = Canvas(state.world, size=216, fastest=6.0, strongest=2.0), []
    for impulse in (2.0, 5.0, 1.0):
        contacts = state.contacts._replace(normal_impulse=np.full(state.contacts.count, impulse))
        picture = canvas(state.replace(contacts=contacts)).astype(float)
        column = picture[:, 8 + 20 * 5]
        widths.append(np.sum(np.abs(column - column[8 + 20 * 2]).max(axis=1) < 60))
    assert picture.shape == (96, 216, 3)
    np.testing.assert_allclose(widths, [9, 9, 5], atol=1)
    speed = 255 * np.array(colormaps["viridis"](0.5)[:3])
    assert np.abs(picture[8 + 20 * 2 - 10, 8 + 20 * 6] - speed).max() < 3
    grey = picture.mean(axis=2)
    assert max(grey[8, 50], grey[88, 50], grey[50, 8], grey[50, 208]) < 100  # the four walls
    assert grey[4, 50] == grey[92, 50] == grey[50, 212] == 255
