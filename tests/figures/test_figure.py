"""The contract of the figure scripts: options, files, replot, interrupts; and the pictures' style."""

import argparse
import dataclasses
import functools
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import circles_at, load_script

import deep_contact as dc
from deep_contact import figures, parallel
from deep_contact.figures import results
from deep_contact.figures.figure import Figure
from deep_contact.figures.results import Claim
from deep_contact.plot import plotting
from deep_contact.state.arrays import no_contacts

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
OPTIONS = {"n": 4, "scale": 1.5, "name": "poly6", "flag": False, "d": [0.25, 0.5], "limit": None}


def walk(options, seed, jobs, progress):
    """Random walks, one seed each: the same for any number of jobs."""
    task = functools.partial(random_walk, options["n"], options["scale"])
    return {"walks": np.array(parallel.parallel_map(task, parallel.seeds(seed, 3), jobs=jobs, progress=progress))}


def random_walk(n, scale, seed):
    return np.random.default_rng(seed).normal(scale=scale, size=n).cumsum()


def sleep(seconds):
    time.sleep(seconds)


def claims(data):
    nearest = np.min(np.abs(data["walks"]))
    return [Claim("a walk comes back", "section 1.2", nearest == 0.0, {"walks": len(data["walks"])})]


def table(data):
    return [["walk", "end"], *([i, walk[-1]] for i, walk in enumerate(data["walks"]))]


def draw(data, options):
    figure, ax = plotting.subplots()
    ax.plot(np.transpose(data["walks"]))
    plotting.label_axes(ax, "step", "place", y_unit="m")
    return figure


FIGURE = Figure(
    id="9.1", title="Walks", options=OPTIONS, quick={"n": 2}, compute=walk, claims=claims, table=table, draw=draw
)
TABLE = Figure(id="T 9.2", title="Ends", options=OPTIONS, compute=walk, claims=claims, table=table)


def run(tmp_path, *arguments, figure=FIGURE):
    """Run a figure's command line here, in one process."""
    return figures.main(figure, ["--out", str(tmp_path), "--jobs", "1", *arguments])


def stored(tmp_path, name="figure_9_1"):
    return results.read_results(tmp_path / f"{name}.json")


# ---- the flow ----


def test_a_run_writes_both_files_and_reports_numbers_and_claims(tmp_path, capsys):
    assert run(tmp_path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figure_9_1.json", "figure_9_1.png"]
    first, *rows, claim, last = capsys.readouterr().out.splitlines()
    assert (first, last) == ("Figure 9.1: Walks", f"picture: {tmp_path / 'figure_9_1.png'}")
    assert len(rows) == 4
    assert claim == "does not hold: a walk comes back (section 1.2): walks = 3"


def test_a_quick_run_says_so_and_where_it_agrees_with_the_reference(tmp_path, capsys, monkeypatch):
    claim = "a walk comes back (section 1.2)"
    run(tmp_path, "--quick")  # there is no reference run of it
    assert capsys.readouterr().out.splitlines()[5] == f"too few states to tell: {claim}"
    run(tmp_path)
    monkeypatch.setattr(results, "REFERENCE", tmp_path)
    path = tmp_path / "quick"
    for arguments in (["--quick"], ["--replot"]):
        capsys.readouterr()
        assert run(path, *arguments) == 0
        assert capsys.readouterr().out.splitlines()[5] == f"as in the reference run, does not hold: {claim}"


def test_claims_that_a_quick_run_is_too_small_for_are_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(results, "verdict", lambda claim, beside: f"{results.OPEN} (reference run: holds)")
    run(tmp_path, "--quick")
    assert capsys.readouterr().out.splitlines()[5].startswith("claims that need more states than a quick run has: 1 (")


def test_the_picture_of_another_run_than_the_figure_s_own_says_so(tmp_path, monkeypatch):
    """`--quick --set` lost the "quick", and no picture named a setting that was changed."""
    drawn = []
    monkeypatch.setattr(plotting, "save", lambda picture, path: drawn.append([t.get_text() for t in picture.texts]))
    figure = dataclasses.replace(FIGURE, claims=lambda data: [])
    for quick, changes in ((True, {}), (False, {}), (True, {"scale": 2.0}), (False, {"scale": 2.0}), (True, {"n": 3})):
        figures.produce(figure, options=changes, quick=quick, out=tmp_path)
    assert drawn == [["quick"], [], ["quick, scale=2.0"], ["scale=2.0"], ["n=3"]]


def test_settings_and_seed_are_stored_and_decide_the_numbers_and_jobs_do_not(tmp_path):
    """`--quick` comes before `--set`."""
    run(tmp_path, "--quick")
    assert stored(tmp_path)["options"] == OPTIONS | {"n": 2}
    found = []
    for more in (["--seed", "1"], ["--seed", "1", "--jobs", "2"], ["--seed", "2"]):
        run(tmp_path, "--quick", "--set", "n=3", "--set", "scale=2", *more)
        found.append(stored(tmp_path))
    assert found[0]["options"] == OPTIONS | {"n": 3, "scale": 2.0}
    assert found[0]["provenance"]["seed"] == 1
    assert np.shape(found[0]["data"]["walks"]) == (3, 3)
    assert found[0]["data"] == found[1]["data"] != found[2]["data"]


def test_replot_draws_the_same_picture_from_the_file_alone_and_judges_anew(tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit, match="2"):
        run(tmp_path, "--replot")
    assert "figure_9_1.json" in capsys.readouterr().err
    run(tmp_path)
    picture, made = tmp_path / "figure_9_1.png", stored(tmp_path)
    before = picture.read_bytes()
    picture.unlink()
    monkeypatch.setitem(globals(), "random_walk", None)  # computing anew would fail
    assert run(tmp_path, "--replot") == 0
    assert (picture.read_bytes(), stored(tmp_path)) == (before, made)
    later = dataclasses.replace(FIGURE, claims=lambda data: [Claim("always", None, None, {"n": 1}, "within the noise")])
    assert run(tmp_path, "--replot", figure=later) == 0
    found = stored(tmp_path)
    assert [claim["verdict"] for claim in found["claims"]] == ["within the noise"]
    assert {**found, "claims": None} == {**made, "claims": None}


def test_results_survive_a_mistake_in_the_drawing(tmp_path):
    broken = dataclasses.replace(FIGURE, draw=lambda data, options: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run(tmp_path, figure=broken)
    assert run(tmp_path, "--replot") == 0


def test_a_table_without_a_drawing_gets_a_picture_of_its_rows(tmp_path):
    assert run(tmp_path, figure=TABLE) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["table_9_2.json", "table_9_2.png"]


@pytest.mark.parametrize(("field", "value"), [("quick", {"m": 1}), ("options", {"x": float("nan")})])
def test_a_figure_that_makes_no_sense_is_refused_by_the_field_s_name(field, value):
    with pytest.raises(ValueError, match=field):
        Figure(**{"id": "9.1", "title": "", "compute": walk, "table": table, "draw": draw, field: value})


# ---- options ----


GIVEN = {
    "n=50": 50,
    "scale=2": 2.0,
    "name=spiky=3": "spiky=3",
    "flag=true": True,
    "d=1": [1.0],
    "d=0.5,1": [0.5, 1.0],
    "d=[1, 2]": [1.0, 2.0],
    "limit=0.5": 0.5,
    "limit=null": None,
    "limit=some text": "some text",
}


@pytest.mark.parametrize("text", GIVEN)
def test_a_setting_takes_the_type_of_its_default(text):
    name, found = figures.assigned(OPTIONS, text)
    assert (name, found, type(found)) == (text.partition("=")[0], GIVEN[text], type(GIVEN[text]))


@pytest.mark.parametrize(
    "text", ["n=1.5", "n=0", "n=-3", "n=many", "n=true", "scale=nan", "scale=x", "flag=maybe", "d=1,x", "n", "m=3"]
)
def test_a_setting_of_the_wrong_type_is_refused_by_its_name(text):
    with pytest.raises(argparse.ArgumentTypeError, match="expected") as error:
        figures.assigned(OPTIONS, text)
    assert text.partition("=")[0] in str(error.value)


@pytest.mark.parametrize("script", sorted(SCRIPTS.glob("*_[0-9]*_[0-9]*.py")), ids=lambda path: path.stem)
def test_help_says_what_every_setting_means(script, capsys):
    figure = load_script(script.stem).FIGURE
    with pytest.raises(SystemExit, match="0"):
        figures.main(figure, ["--help"])
    shown = capsys.readouterr().out
    for name in figure.options:
        meaning = figures.meaning(figure.id, name)
        assert meaning, f"settings.json: expected a meaning of {name!r} of {figure.id}"
        assert meaning in shown


def test_a_setting_that_the_figure_refuses_is_reported_without_a_traceback(tmp_path, capsys):
    figure = load_script("figure_3_3_kernels").FIGURE
    with pytest.raises(SystemExit, match="2"):
        run(tmp_path, "--set", "h=-1", figure=figure)
    assert "--set: h: expected a finite number >= 1e-50" in capsys.readouterr().err


@pytest.mark.parametrize("bad", [["--seed", "-1"], ["--jobs", "0"], ["--seed", "x"], ["--fast"]])
def test_bad_arguments_exit_with_2(tmp_path, bad):
    with pytest.raises(SystemExit, match="2"):
        run(tmp_path, *bad)
    assert not list(tmp_path.iterdir())


# ---- parallel map and interrupts ----


def test_the_error_of_an_item_does_not_wait_for_the_others():
    start = time.monotonic()
    with pytest.raises(TypeError, match="NoneType"):
        parallel.parallel_map(sleep, [None, 60, 60], jobs=2)
    assert time.monotonic() - start < 30  # not a timing: the items take two minutes


def test_seeds_differ_and_the_first_ones_stay_when_more_are_asked_for():
    few, many = parallel.seeds(3, 10), parallel.seeds(3, 1000)
    assert many[:10] == few
    assert len(set(many)) == 1000
    assert not set(many) & set(parallel.seeds(4, 1000))


INTERRUPTED_SCRIPT = """
import sys, time
from deep_contact import figures

def compute(options, seed, jobs, progress):
    print("started", flush=True)
    return {"x": figures.parallel_map(time.sleep, [60] * 4, jobs=jobs)}

FIGURE = figures.Figure(id="9.3", title="Slow", compute=compute, table=lambda data: [], draw=lambda data, options: None)
figures.run_as_script(FIGURE, __name__)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize(
    ("jobs", "sent", "status"),
    [
        pytest.param("1", signal.SIGINT, 130, marks=pytest.mark.slow),
        ("2", signal.SIGINT, 130),
        pytest.param("2", signal.SIGTERM, 143, marks=pytest.mark.slow),
    ],
)
def test_an_interrupt_leaves_no_traceback_no_files_and_no_processes(tmp_path, jobs, sent, status):
    script = tmp_path / "figure_9_3.py"
    script.write_text(INTERRUPTED_SCRIPT)
    command = [sys.executable, str(script), "--jobs", jobs, "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "started\n"
    time.sleep(0.5)  # so that worker processes are on their way
    process.send_signal(sent)
    _, errors = process.communicate(timeout=30)  # ends only once no child holds the pipe any more
    assert process.returncode == status
    assert "Traceback" not in errors
    assert not list(tmp_path.glob("out/*"))


def test_jobs_of_a_program_without_a_guard_say_what_it_needs(tmp_path):
    script = tmp_path / "mine.py"
    script.write_text("from deep_contact.parallel import parallel_map\nparallel_map(abs, [1, 2], jobs=2)\n")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert done.stderr.splitlines()[-1].startswith("RuntimeError: jobs: a process ended before its task was done;")
    assert "bootstrapping" not in done.stderr


# ---- all_figures.py ----

TOY_SCRIPT = """
import sys
from pathlib import Path
from deep_contact import figures

def compute(options, seed, jobs, progress):
    return {{"x": [1.0 / {divisor}]}}

def draw(data, options):
    from deep_contact.plot import plotting
    return plotting.subplots()[0]

claims = lambda data: [figures.Claim("one", None, data["x"] == [1.0], {{"x": data["x"]}})]
FIGURE = figures.Figure(id="{id}", title="Toy", compute=compute, claims=claims, table=lambda data: [["x"]], draw=draw)
raise SystemExit(figures.main(FIGURE))
"""


@pytest.fixture
def toys(tmp_path):
    """A folder with three scripts, the second of which fails."""
    folder = tmp_path / "scripts"
    folder.mkdir()
    for name, number, divisor in (("figure_9_10_c", "9.10", 2), ("figure_9_2_b", "9.2", 0), ("table_9_2", "T 9.2", 1)):
        (folder / f"{name}.py").write_text(TOY_SCRIPT.format(id=number, divisor=divisor))
    (folder / "train.py").write_text("raise SystemExit(9)")
    return folder


def test_all_figures_goes_on_after_a_failure_and_reports_it(toys, tmp_path, capfd):
    assert load_script("all_figures").main(["--out", str(tmp_path / "out")], toys) == 1
    printed = capfd.readouterr().out
    assert re.findall(r"\[\d/\d\] (\w+)", printed) == ["figure_9_2_b", "table_9_2", "figure_9_10_c"]
    summary = [line.split() for line in printed.splitlines()[-3:]]
    assert [row[:2] for row in summary] == [["9.2", "failed"], ["T9.2", "done"], ["9.10", "done"]]
    assert [row[3:] for row in summary[1:]] == [["1", "of", "1"], ["0", "of", "1"]]


@pytest.mark.slow
def test_all_figures_runs_only_those_that_are_asked_for(toys, tmp_path, capfd):
    main = load_script("all_figures").main
    assert main(["--only", "9.10,T9.2", "--out", str(tmp_path / "out"), "--quick", "--seed", "4"], toys) == 0
    assert stored(tmp_path / "out", "table_9_2")["provenance"]["seed"] == 4
    assert not (tmp_path / "out" / "figure_9_2.json").exists()
    assert main(["--only", "3.99"], toys) == 2
    assert "expected one of 9.2, T9.2, 9.10, got '3.99'" in capfd.readouterr().err
    (toys / "figure_9_10_d.py").write_text("")
    assert main([], toys) == 2
    assert "expected one script for 9.10, got figure_9_10_c.py and figure_9_10_d.py" in capfd.readouterr().err


def test_a_script_ended_by_ctrl_c_is_called_interrupted(toys, tmp_path, capfd):
    (toys / "figure_9_2_b.py").write_text("import os, signal, sys; print('up', flush=True); os.kill(os.getpid(), 2)")
    assert load_script("all_figures").main(["--out", str(tmp_path / "out")], toys) == 130
    assert [line.split()[:2] for line in capfd.readouterr().out.splitlines()][-1] == ["9.2", "interrupted"]


# ---- plotting ----


def three_circles(contacts=True):
    """Two circles on the floor, touching, the first of which carries 3 + 4 N·s; and one in the air."""
    velocity = [[3.0, 4.0], [0, 0], [0, -1.0]]
    state = dc.find_contacts(circles_at([[1.0, 1.0], [3.0, 1.0], [5.0, 4.0]], velocity=velocity, box=(0, 0, 8, 8)))
    if not contacts:
        return state.replace(contacts=no_contacts(), time=0.5)
    assert list(zip(*state.contacts[:2])) == [(0, 1), (0, 3), (0, 6), (1, 3)]
    return state.replace(contacts=state.contacts._replace(normal_impulse=np.array([4.0, 3.0, 0.0, 0.0])), time=0.5)


def test_no_two_curves_share_colour_and_line():
    for names in (plotting.START_STYLE, [*(f"h = {h}" for h in range(10)), "copy"]):
        looks = plotting.styles_of(names).values()
        assert len({(look["color"], look["linestyle"]) for look in looks}) == len({look["label"] for look in looks})
    with pytest.raises(ValueError, match=r"expected one of none, builtin, .*, got 'sphh'"):
        plotting.style_of("sphh")


def test_a_table_fits_a_page_and_keeps_its_words():
    """Long texts are wrapped; of many columns the letters are smaller."""
    long = [["name", "what it says", "number"], ["one", "words and more words " * 12, "0.123 (0.1–0.2)"]]
    many = [[f"incompressible{i}" for i in range(14)]] * 2
    for rows, breaks, least, most in ((long, 2, 8, 8), (many, 0, 0, 7)):
        figure = plotting.draw_table(rows, "Table 9.1: a long text")
        assert figure.get_figwidth() <= plotting.PAGE
        cells = figure.axes[0].tables[0].get_celld()
        text = cells[1, 1].get_text()
        assert text.get_text().split() == rows[1][1].split()
        assert text.get_text().count("\n") >= breaks
        assert least <= text.get_fontsize() <= most
    assert figure.get_figwidth() == plotting.PAGE


def test_a_saved_figure_has_the_same_bytes_whatever_users_set(tmp_path):
    import matplotlib

    pictures = []
    for own in ({}, {"lines.linewidth": 9, "axes.facecolor": "red", "font.size": 20}):
        with matplotlib.rc_context(own):
            figure, ax = plotting.subplots()
            plotting.draw_state(ax, three_circles())
            pictures.append(plotting.save(figure, tmp_path / "new" / "a.png").read_bytes())
    assert pictures[0] == pictures[1]
    assert b"matplotlib" not in pictures[0].lower()
    assert b"tEXt" not in pictures[0]


def test_a_state_is_coloured_by_speed_or_by_the_impulses_on_a_body():
    np.testing.assert_allclose(plotting.body_values(three_circles(), "speed")[0], [5, 0, 1])
    np.testing.assert_allclose(plotting.body_values(three_circles(), "impulse")[0], [7, 4, 0])
    np.testing.assert_allclose(plotting.body_values(three_circles(contacts=False), "impulse")[0], 0)
    with pytest.raises(ValueError, match="colour_by: expected"):
        plotting.body_values(three_circles(), "mass")


def test_contact_lines_are_as_wide_as_impulses_and_end_at_circles_or_walls():
    figure, ax = plotting.subplots()
    plotting.draw_state(ax, three_circles(), largest_impulse=4.0)
    lines = ax.collections[-1]
    np.testing.assert_allclose(lines.get_linewidths(), [4.3, 3.3, 0.3, 0.3])
    np.testing.assert_allclose(lines.get_segments()[0], [[1, 1], [3, 1]])
    np.testing.assert_allclose(lines.get_segments()[1], [[1, 1], [1, 0.005]])
    plotting.impulse_key(figure, 4.0)
    *keys, _ = figure.legends[0].get_lines()
    assert [line.get_linewidth() for line in keys] == pytest.approx([0.7, 2.3, 4.3])
    assert "4 N·s" in figure.legends[0].get_texts()[2].get_text()


@pytest.mark.parametrize("contacts", [True, False])
def test_a_stored_state_draws_the_same_picture(tmp_path, contacts):
    state = three_circles(contacts)
    again = plotting.state_of(json.loads(json.dumps(results.plain(plotting.state_data(state)))))
    pictures = []
    for name, drawn in (("a.png", state), ("b.png", again)):
        figure, ax = plotting.subplots()
        plotting.draw_state(ax, drawn, colour_by="impulse")
        pictures.append(plotting.save(figure, tmp_path / name).read_bytes())
    assert pictures[0] == pictures[1]


def test_stress_is_in_its_cells_and_a_belt_has_its_way():
    belt = {"segments": [((1.0, 1.0), (7.0, 1.0))], "surface_speeds": [-2.0]}
    scene = circles_at([[3.0, 2.0], [5.5, 2.0]], box=(0.0, 0.0, 8.0, 6.0), **belt)
    state = dc.simulate(scene, steps=5, solver=dc.PGS()).state
    _, (ax, image) = plotting.subplots(1, 2)
    plotting.draw_state(ax, state)
    (belt,) = ax.texts
    assert belt.xyann[0] > belt.xy[0]  # from its tail to its head
    shown = plotting.draw_stress(image, state, spacing=2.0).get_array()
    assert shown.shape == (3, 4)
    assert (np.flatnonzero(shown[1]) == [1, 2]).all()
    assert shown.sum() == shown[1].sum() > 0


def test_contact_forces_are_lines_in_newtons_with_the_totals_of_the_walls():
    """A pile of 80 at rest: as many lines as contacts that push; the floor's total is what `force_on` has."""
    scene = dc.circles_in_box(n_bodies=80, seed=1)
    run = dc.simulate(scene, steps=600, record=600, solver=dc.PGS(sweeps=50))
    run = dc.simulate(run.state, steps=1, record=1, forces=True)
    state = run.solved[-1]
    force = state.contacts.normal_impulse / state.dt
    _, ax = plotting.subplots()
    plotting.draw_contact_forces(ax, state, friction=True)
    lines, across = ax.collections[-2:]
    acts = force > 1e-6 * force.max()
    np.testing.assert_allclose(lines.get_linewidths(), 4.0 * force[acts] / force.max())
    assert 80 < len(lines.get_segments()) == acts.sum()
    share = np.abs(state.contacts.tangent_impulse / state.dt) / force.max()
    np.testing.assert_allclose(across.get_linewidths(), 4.0 * share[share > 1e-6])
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts[:3] == [f"{part * force.max():.3g} N" for part in (1.0, 0.5, 0.1)]
    for side in ("floor", "left", "right"):
        (total,) = [text for text in texts if text.startswith(side)]
        shown = float(total.split(": ")[1].removesuffix(" N").replace(",", ""))
        assert shown == pytest.approx(np.hypot(*run.force_on(side)[-1]), rel=1e-3)
    # What a wall gives points into the box, and ends where it acts.
    arrows = [(text.xy, text.xyann) for text in ax.texts]
    assert any(tip[1] > tail[1] and abs(tip[1]) < 0.05 for tip, tail in arrows)
    assert any(tip[0] > tail[0] and abs(tip[0]) < 0.05 for tip, tail in arrows)
    assert any(tip[0] < tail[0] and abs(tip[0] - 30) < 0.05 for tip, tail in arrows)


def test_a_pile_at_rest_is_dark_and_the_bar_goes_with_its_axes():
    """√(g r̄) = 4.43 m/s for circles of 2 m: half of it is the middle of the colours."""
    state = circles_at([[3.0, 3.0], [8.0, 3.0]], radius=2.0, velocity=[[0.01, 0.0], [0.0, 0.0]])
    _, ax = plotting.subplots()
    circles = plotting.draw_state(ax, state)
    assert circles.get_clim() == (0.0, pytest.approx(np.sqrt(9.81 * 2.0)))
    (bar,) = ax.child_axes
    assert bar.get_ylabel() == "speed (m/s)"
    ax.clear()
    assert not ax.child_axes
    fast = state.replace(bodies=state.bodies._replace(velocity=np.array([[30.0, 40.0], [0.0, 0.0]])))
    assert plotting.draw_state(ax, fast, bar=False).get_clim() == (0.0, 50.0)
    assert not ax.child_axes
