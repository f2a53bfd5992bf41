"""`python -m deep_contact view`: frames, films, windows, and the command line."""

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib import animation, pyplot
from PIL import Image

import deep_contact as dc
from deep_contact import viewer
from deep_contact.__main__ import main
from deep_contact.reporting import plotting


@pytest.fixture
def scene():
    return dc.column(3)


def test_frames_are_states_of_the_run_that_simulate_makes(scene):
    kept = []
    dc.simulate(scene, steps=7, on_step=lambda state, record: kept.append(state))
    found = list(viewer.frames(scene, steps=7, every=3))
    assert [frame.state.step for frame in found] == [2, 5, 6]
    for frame in found:
        assert frame.state == kept[frame.state.step]
    found = list(viewer.frames(scene, steps=2, solver=dc.PGS(sweeps=5, tolerance=None), warm_start=None))
    assert [frame.record.theta.size for frame in found] == [5, 5]
    assert not found[1].state.contacts.normal_start.any()


def test_scales_never_shrink_from_frame_to_frame(scene):
    painter, limits = viewer.Painter(), []
    for frame in viewer.frames(scene, steps=30, every=10, solver=dc.PGS(sweeps=50)):
        _, axes = plotting.subplots(1, 2)
        painter(axes, frame)
        (low, high), (_, sweeps) = axes[1].get_ylim(), axes[1].get_xlim()
        limits.append([-low, high, sweeps])
    assert (np.diff(limits, axis=0) >= 0).all()


def test_a_step_without_contacts_can_be_drawn():
    (frame,) = viewer.frames(dc.single_body(height=5.0), steps=1)
    _, axes = plotting.subplots(1, 2)
    viewer.Painter()(axes, frame)
    assert axes[1].get_title(loc="left").endswith("no contacts")


def test_a_film_has_two_panels_and_a_frame_for_each_state(scene, tmp_path):
    written = viewer.record(viewer.frames(scene, steps=6, every=3), tmp_path / "view.gif", fps=10)
    with Image.open(written) as gif:
        assert gif.n_frames == 2
        assert gif.width == pytest.approx(sum(viewer.PANELS) * gif.height, abs=1)


@pytest.mark.parametrize(
    ("name", "message"),
    [("a.mp4", "expected ffmpeg to be installed for .*a.mp4"), ("a.avi", "expected a name that ends in .gif or .mp4")],
)
def test_a_film_that_cannot_be_written_is_refused_before_the_first_frame(tmp_path, monkeypatch, name, message):
    monkeypatch.setattr(animation.writers, "is_available", lambda writer: False)
    never = (pytest.fail("a frame was made") for _ in range(1))
    with pytest.raises(ValueError, match=message):
        viewer.record(never, tmp_path / name)


def test_a_window_plays_all_frames(scene, monkeypatch):
    pyplot.switch_backend("agg")
    monkeypatch.setattr(pyplot, "show", lambda **_: None)
    assert viewer.play(viewer.frames(scene, steps=3)) == 3


@pytest.mark.parametrize("framework", [None, "qt"])
def test_a_window_needs_a_display(monkeypatch, framework):
    canvas = SimpleNamespace(required_interactive_framework=framework)
    monkeypatch.setattr(pyplot, "figure", lambda: SimpleNamespace(canvas=canvas))
    monkeypatch.setattr(pyplot, "close", lambda figure: vars(figure).pop("canvas"))  # as from Matplotlib 3.11 on
    assert viewer.has_display() == (framework is not None)


def test_a_window_needs_a_toolkit(monkeypatch):
    monkeypatch.setattr(pyplot, "figure", lambda: importlib.import_module("a_toolkit_that_is_not_there"))
    assert not viewer.has_display()


# ---- the command line ----


@pytest.mark.parametrize("out", [None, "mine.gif"])
def test_a_state_is_gone_on_from_and_without_a_display_a_film_is_written(scene, tmp_path, monkeypatch, capsys, out):
    dc.write_state(tmp_path / "state.xml", dc.simulate(scene, steps=4).state)
    monkeypatch.chdir(tmp_path)
    pyplot.switch_backend("agg")
    assert main(["view", "state.xml", "--steps", "2", "--every", "1", *(["--out", out] if out else [])]) == 0
    said = capsys.readouterr()
    assert ("no display" in said.err) == (out is None)
    assert said.out.strip() == (out or "view.gif")
    assert (tmp_path / said.out.strip()).read_bytes().startswith(b"GIF89a")
