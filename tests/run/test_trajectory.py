"""`deep_contact.run.trajectory`: a run as arrays, as a file, and as a film."""

import os
import re
import signal
import sys
import types

import numpy as np
import pytest
from conftest import circles_at, run_python, solved_states
from matplotlib import colormaps
from PIL import Image

import deep_contact as dc
from deep_contact.__main__ import main
from deep_contact.plot import film_file as film_module
from deep_contact.plot.film_file import LINE, Canvas, gif_timing, write_film
from deep_contact.run.trajectory import Trajectory, load_trajectory
from deep_contact.stepping.metrics import kinetic_energy


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
    assert picture.shape == (208 + 3 * LINE, 208, 3)
    state, scale = run[0], 192 / 10
    fastest = max(np.hypot(*run.velocities.reshape(-1, 2).T).max(), np.sqrt(9.81 * state.bodies.radius.mean()))
    for (x, y), radius, speed in zip(state.bodies.position, state.bodies.radius, np.hypot(*state.bodies.velocity.T)):
        column, row = (int(8 + scale * value) for value in (x, 10 - y))
        colour = 255 * np.array(colormaps["viridis"](speed / fastest)[:3])
        assert np.abs(picture[row, column] - colour).max() < 24
        assert np.abs(picture[int(8 + scale * (10 - y - radius)) - 2, column] - colour).max() > 24


@pytest.mark.parametrize("fps", [24, 25, 30, 50, 60, 75, 120])
def test_a_gif_takes_as_long_as_its_pictures_at_their_rate(tmp_path, fps):
    """121 pictures: to the rounding of one 1/100 s, and without delays below 2/100 s, which browsers do not keep."""
    shown, delays = gif_timing(121, fps)
    assert sum(delays) == pytest.approx(1000 * 121 / fps, abs=5.1)
    assert min(delays) >= 20
    assert (len(shown) == 121) is (fps <= 50)

    def picture(number):
        pixels = np.zeros((11, 11, 3), np.uint8)
        pixels[divmod(number, 11)] = 255
        return pixels

    durations = []
    with Image.open(write_film(tmp_path / "fall.gif", range(121), picture, fps)) as gif:
        for number in range(gif.n_frames):
            gif.seek(number)
            durations.append(gif.info["duration"])
    assert durations == delays


def with_ffmpeg(folder, monkeypatch, script):
    """Put a program of this name, a shell script, before all others; None: there is none at all."""
    monkeypatch.setenv("PATH", str(folder), prepend=os.pathsep if script else None)
    if script:
        (folder / "ffmpeg").write_text(f"#!/bin/sh\n{script}\n")
        (folder / "ffmpeg").chmod(0o755)


posix = pytest.mark.skipif(os.name != "posix", reason="a program by a shell script")


@posix
def test_an_mp4_gets_the_pictures_or_says_that_ffmpeg_is_missing(run, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="path: expected"):
        run.film(tmp_path / "fall.avi")
    with monkeypatch.context() as patch:
        with_ffmpeg(tmp_path, patch, 'for last; do :; done\ncat > "$last"')  # keeps the raw pictures
        film = run.film(tmp_path / "fall.mp4", size=32)  # the least
        assert film.stat().st_size == len(run) * 32 * 32 * 3
    (tmp_path / "ffmpeg").unlink()
    with_ffmpeg(tmp_path, monkeypatch, None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # cannot be imported
    with pytest.raises(ValueError, match=r"path: expected ffmpeg .*pip install imageio-ffmpeg"):
        run.film(tmp_path / "fall.mp4")
    brought = types.SimpleNamespace(get_ffmpeg_exe=lambda: "/of/the/package")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", brought)
    assert film_module._ffmpeg() == "/of/the/package"


@posix
@pytest.mark.parametrize(
    ("script", "why"),
    [
        ("exit 1", "ffmpeg ended with status 1: it said nothing"),
        ("echo 'Unknown encoder' >&2; exit 8", "ffmpeg ended with status 8: Unknown encoder"),
        ("cat > /dev/null; echo full >&2; exit 2", "ffmpeg ended with status 2: full"),
        ("exit 0", "ffmpeg ended with status 0"),
        ("kill -TERM $$", f"ffmpeg ended with signal 15 .{signal.strsignal(signal.SIGTERM)}"),
    ],
)
def test_a_film_that_ffmpeg_does_not_write_is_an_error_with_its_words(run, tmp_path, monkeypatch, capsys, script, why):
    """In the command line as well: exit 3, and no file."""
    with_ffmpeg(tmp_path, monkeypatch, script)
    with pytest.raises(OSError, match=why) as refused:
        run.film(tmp_path / "fall.mp4", size=500)  # more than a pipe holds
    assert str(tmp_path / "fall.mp4") in str(refused.value)
    run.save(tmp_path / "run.h5")
    arguments = ["simulate", str(tmp_path / "run.h5"), "--steps", "4", "--every", "1"]
    assert main([*arguments, "--out", str(tmp_path / "fall.mp4")]) == 3
    assert re.search(why, capsys.readouterr().err)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ffmpeg", "run.h5"]


@posix
@pytest.mark.parametrize(
    "name", ["fall.html", *(pytest.param(name, marks=pytest.mark.slow) for name in ("fall.gif", "forces.png"))]
)
def test_a_full_disk_is_an_error_that_names_the_file(tmp_path, name):
    """A limit of 1 KiB stands for it: the file is refused and nothing is left."""
    program = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024)); "
    program += f"from deep_contact.__main__ import main; raise SystemExit(main([*{ARGUMENTS}, {name!r}]))"
    # Code that is compiled in the process could not be stored: without the compiler nothing is.
    done = run_python("-c", program, cwd=tmp_path, environment={"NUMBA_DISABLE_JIT": "1"}, status=3)
    assert f"File too large: {name!r}" in done.stderr
    assert not [*tmp_path.iterdir()]


ARGUMENTS = ["simulate", "--bodies", "3", "--steps", "4", "--every", "1", "--out"]


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
    assert picture.shape == (96 + 3 * LINE, 216, 3)
    np.testing.assert_allclose(widths, [9, 9, 5], atol=1)
    speed = 255 * np.array(colormaps["viridis"](0.5)[:3])
    assert np.abs(picture[8 + 20 * 2 - 10, 8 + 20 * 6] - speed).max() < 3
    grey = picture.mean(axis=2)
    assert max(grey[8, 50], grey[88, 50], grey[50, 8], grey[50, 208]) < 100  # the four walls
    assert grey[4, 50] == grey[92, 50] == grey[50, 212] == 255


def test_a_film_has_a_clock_a_scale_and_the_colours_of_its_speeds():
    """In a box of 40 m a fifth of 500 pixels is 8.3 m: the bar has 5 m, 60.5 pixels, and letters of its length."""
    state = circles_at([[20.0, 20.0]], box=(0.0, 0.0, 40.0, 20.0))
    canvas = Canvas(state.world, size=500, fastest=6.0, strongest=2.0)
    first, later = canvas(state), canvas(state.replace(time=1.5))
    assert canvas._clock.get_text() == "t = 1.50 s"
    strip = slice(-LINE, None)
    assert (first[:-LINE] == later[:-LINE]).all()
    assert (first[strip, :155] != later[strip, :155]).any()
    assert (first[strip, 155:] == later[strip, 155:]).all()
    row = first[-LINE // 2, 155:227].mean(axis=1)
    assert np.count_nonzero(row < 128) == pytest.approx(5.0 * 484 / 40, abs=3)
    texts = [text.get_text() for ax in canvas._ax.figure.axes for text in ax.texts]
    assert texts == ["t = 1.50 s", "5 m", "0", "6 m/s"]
    colours = first[-LINE // 2, 310:].reshape(-1, 3)
    for share in (0.0, 1.0):
        assert (np.abs(colours - 255 * np.array(colormaps["viridis"](share)[:3])).max(axis=1) < 12).any()
