"""`python -m deep_contact view`: frames, films, windows, and the command line."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import run_python

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
    from PIL import Image

    written = viewer.record(viewer.frames(scene, steps=6, every=3), tmp_path / "view.gif", fps=10)
    with Image.open(written) as gif:
        assert gif.n_frames == 2
        assert gif.width == pytest.approx(sum(viewer.PANELS) * gif.height, abs=1)


@pytest.mark.parametrize(
    ("name", "message"),
    [("a.mp4", "expected ffmpeg to be installed for .*a.mp4"), ("a.avi", "expected a name that ends in .gif or .mp4")],
)
def test_a_film_that_cannot_be_written_is_refused_before_the_first_frame(tmp_path, monkeypatch, name, message):
    from matplotlib import animation

    monkeypatch.setattr(animation.writers, "is_available", lambda writer: False)
    never = (pytest.fail("a frame was made") for _ in range(1))
    with pytest.raises(ValueError, match=message):
        viewer.record(never, tmp_path / name)


def test_a_window_plays_all_frames(scene, monkeypatch):
    from matplotlib import pyplot

    pyplot.switch_backend("agg")
    monkeypatch.setattr(pyplot, "show", lambda **_: None)
    assert viewer.play(viewer.frames(scene, steps=3)) == 3


def test_without_a_display_or_a_toolkit_there_is_no_window(monkeypatch):
    from matplotlib import pyplot

    pyplot.switch_backend("agg")
    assert not viewer.has_display()
    canvas = SimpleNamespace(required_interactive_framework="qt")
    with monkeypatch.context() as patch:
        patch.setattr(pyplot, "figure", lambda: SimpleNamespace(canvas=canvas))
        # As from Matplotlib 3.11 on.
        patch.setattr(pyplot, "close", lambda figure: vars(figure).pop("canvas"))
        assert viewer.has_display()

    def no_toolkit():
        raise ImportError("cannot load backend 'TkAgg'")

    monkeypatch.setattr(pyplot, "figure", no_toolkit)
    assert not viewer.has_display()


# ---- the command line ----


def test_a_state_file_is_gone_on_from(scene, tmp_path, capsys):
    state = dc.simulate(scene, steps=4).state
    dc.write_state(tmp_path / "state.xml", state)
    out = tmp_path / "view.gif"
    assert main(["view", str(tmp_path / "state.xml"), "--steps", "2", "--every", "1", "--out", str(out)]) == 0
    assert out.exists()
    assert str(out) in capsys.readouterr().out


def test_without_a_display_a_film_is_written(tmp_path):
    arguments = ["--bodies", 3, "--steps", 2, "--every", 1]
    environment = {"MPLBACKEND": "agg", "PATH": "", "PYTHONPATH": str(dc.__path__[0] + "/..")}
    done = run_python("-m", "deep_contact", "view", *arguments, cwd=tmp_path, environment=environment)
    assert "no display" in done.stderr
    assert (tmp_path / "view.gif").read_bytes().startswith(b"GIF89a")
