"""`deep-contact` and `python -m deep_contact`."""

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, run_python
from PIL import Image

import deep_contact as dc
from deep_contact import __main__ as command_line
from deep_contact import parallel
from deep_contact.__main__ import main
from deep_contact.io.xml_tree import StateFileError
from deep_contact.solvers import describe

PROBE = '''"""python scripts/figure_9_1_probe.py: what a script sees."""
import json, sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

def double(x):
    return 2 * x

if __name__ == "__main__":
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        print(json.dumps([sys.argv, list(pool.map(double, [1, 2]))]))
    raise SystemExit(7)
'''


@pytest.fixture
def probe(tmp_path, monkeypatch):
    """A root whose only figure prints what it sees."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts" / "figure_9_1_probe.py").write_text(PROBE, encoding="utf-8")
    monkeypatch.setattr(command_line.shipped, "ROOT", tmp_path)
    monkeypatch.chdir(tmp_path)


# ---- what is there ----


@pytest.mark.parametrize(
    ("program", "named"), [("/usr/bin/deep-contact", "deep-contact"), ("/x/deep_contact/__main__.py", "python -m")]
)
def test_help_names_the_program_as_it_was_called(program, named, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [program])
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    assert capsys.readouterr().out.startswith(f"usage: {named}")
    assert main(["figure", "3.7", "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"usage: {named}")
    assert sys.argv == [program]


@pytest.mark.parametrize(
    "command",
    ["predict", *(pytest.param(name, marks=pytest.mark.slow) for name in ("generate-data", "train", "figure all"))],
)
def test_python_may_leave_docstrings_out(command):
    assert run_python("-OO", "-m", "deep_contact", *command.split(), "--help").stdout.startswith("usage:")


def test_warm_up_compiles_every_kind_and_says_how_long(monkeypatch, capsys):
    done = []
    monkeypatch.setattr(parallel, "cores", lambda: 1)
    monkeypatch.setattr(dc, "simulate", lambda scene, steps, **options: done.append((scene.name, *options)))
    assert main(["warm-up"]) == 0
    assert len({*done}) == 4  # two presets of a pile have the same options
    assert len(done) == len(command_line.KINDS)
    first, *kinds, whole = capsys.readouterr().out.splitlines()
    assert [line.partition(": ")[0] for line in kinds] == list(command_line.KINDS)
    assert first.startswith("compiling in 1 processes")
    assert whole.startswith("5 kinds in ")


def test_warm_up_finds_its_function_in_the_processes_of_python_m():
    said = run_python("-m", "deep_contact", "warm-up").stdout
    assert len(said.splitlines()) == len(command_line.KINDS) + 2


# ---- figures and tables ----


def test_every_figure_and_table_is_listed_and_reached_by_its_name(capsys):
    assert main(["figure"]) == 0
    listed = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    files = [*(ROOT / "scripts").glob("figure_*.py"), *(ROOT / "scripts").glob("table_*.py")]
    assert len(listed) == len(files) > 35
    for path in files:
        kind, chapter, number, _ = path.stem.split("_", 3)
        name = f"{chapter}.{number}"
        assert len(listed[name if kind == "figure" else f"T{name}"]) > 20
        for command, spelt in [(kind, name), ("figure", f"{kind} {name}"), ("figure", f"{kind.title()} {name}")]:
            assert command_line._script(command, spelt) == path
        if kind == "table":
            assert command_line._script("table", f"T {name}") == path
    assert command_line._script("figure", "all").name == "all_figures.py"
    assert main(["table"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [n for n in listed if n[0] == "T"]


@pytest.mark.parametrize("arguments", [["figure", "9.9"], ["figure", "3_7"], ["table", "3.7"], ["figure", ""]])
def test_an_unknown_number_is_refused_with_those_that_there_are(arguments, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    error = capsys.readouterr().err
    assert "expected one of " in error
    assert "T5.1" in error


def test_a_script_runs_as_the_main_program_with_its_arguments_and_status(probe, monkeypatch, capsys):
    """Its processes unpickle its functions by name, which is how the figures compute in parallel."""
    monkeypatch.setattr(sys, "argv", ["deep-contact"])
    before = sys.modules["__main__"]
    assert main(["figure", "9.1", "--set", "a=1"]) == 7
    argv, doubled = json.loads(capsys.readouterr().out)
    assert argv == ["deep-contact figure 9.1", "--set", "a=1"]
    assert doubled == [2, 4]
    assert (sys.argv, sys.modules["__main__"]) == (["deep-contact"], before)


def test_the_error_of_a_script_is_not_taken_for_an_argument(probe, capsys):
    script = Path("scripts/figure_9_1_probe.py")
    script.write_text("raise ValueError('inside')", encoding="utf-8")
    with pytest.raises(ValueError, match="inside"):
        main(["figure", "9.1"])
    script.write_text("import keras_of_old", encoding="utf-8")
    assert main(["figure", "9.1"]) == 4
    assert "figure 9.1: No module named 'keras_of_old'" in capsys.readouterr().err


def test_a_figure_of_a_stored_study_is_drawn_in_any_folder(tmp_path, monkeypatch):
    """Figures 6.1 and 6.2 draw data/reference/run_tradeoff.json, which they find beside or in the package."""
    monkeypatch.chdir(tmp_path)
    assert main(["figure", "6.2", "--jobs", "1"]) == 0
    options = json.loads((tmp_path / "figures" / "figure_6_2.json").read_text(encoding="utf-8"))["options"]
    assert options["results"] == "data/reference/run_tradeoff.json"


def test_a_list_that_is_cut_short_is_no_error():
    code = "import os, sys; from deep_contact.__main__ import main; os.close(0); r, w = os.pipe(); os.dup2(w, 1); "
    code += "os.close(w); os.close(r); sys.exit(main(['figure']))"
    assert run_python("-c", code).stderr == ""


# ---- simulate, predict, sample ----


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.xml"
    dc.write_state(path, dc.simulate(dc.column(3), steps=4).state)
    return path


def test_a_state_is_run_on_as_simulate_does(scene, tmp_path, capsys):
    out = tmp_path / "later.xml.gz"
    arguments = ["--steps", "6", "--solver", "NNCG", "--sweeps", "9", "--tolerance", "1e-3", "--warm-start", "none"]
    assert main(["simulate", str(scene), *arguments, "--dt", "0.005", "--out", str(out)]) == 0
    solver = dc.NNCG(sweeps=9, tolerance=1e-3)
    run = dc.simulate(dc.read_state(scene), steps=6, dt=0.005, solver=solver, warm_start="none")
    assert dc.read_state(out) == run.state
    first, second, third = capsys.readouterr().out.splitlines()
    assert first.endswith(": 3 circles, 6 steps of 0.005 s, NNCG(sweeps=9, tolerance=0.001)")
    assert second.startswith(f"contacts: {run.state.contacts.count}; sweeps a step: {run.sweeps.mean():.1f}; last θ: ")
    assert third == str(out)


def test_the_last_state_is_drawn(scene, tmp_path):
    out = tmp_path / "pile.png"
    assert main(["simulate", str(scene), "--steps", "1", "--out", str(out)]) == 0
    with Image.open(out) as picture:
        assert len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)) > 10


@pytest.mark.parametrize(
    ("flags", "why"),
    [
        (["--accuracy", "preview"], "a fixed number of sweeps"),
        (["--solver", "PGS", "--sweeps", "1", "--tolerance", "1e-12"], "max sweeps"),
        (["--solver", "PGS", "--tolerance", "1e3"], "converged"),
    ],
)
def test_why_the_sweeps_ended_is_said(flags, why, capsys):
    state = command_line.shipped.sample_file("impact_154")
    assert main(["simulate", str(state), "--steps", "1", *flags]) == 0
    assert capsys.readouterr().out.rstrip().endswith(f"({why})")


def test_options_left_out_are_those_of_the_state(tmp_path):
    scene, out = tmp_path / "scene.xml", tmp_path / "later.xml"
    dc.write_state(scene, dc.column(2).replace(solver=dc.PGS(position_sweeps=7)))
    assert main(["simulate", str(scene), "--steps", "1", "--sweeps", "7", "--out", str(out)]) == 0
    assert dc.read_state(out).solver == dc.PGS(position_sweeps=7, sweeps=7, tolerance=6e-5)  # of the thesis's circles


def test_flags_change_the_world_of_a_scene_and_of_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    world = ["--friction", "0.2", "--restitution", "0.4", "--dt", "0.004"]
    scene = ["--bodies", "3", "--radius", "0.5", "0.7", "--gravity", "1.62"]
    assert main(["simulate", *world, *scene, "--steps", "0", "--out", "moon.xml"]) == 0
    moon = {"friction": 0.2, "restitution": 0.4, "gravity": (0.0, -1.62)}
    state = dc.read_state("moon.xml")
    assert state.bodies == dc.circles_in_box(3, radius=(0.5, 0.7), **moon).bodies
    assert (state.world, state.dt) == (dc.World(**moon), 0.004)
    other = ["--friction", "1", "--gravity", "2", "-3e0"]
    assert main(["simulate", "moon.xml", *other, "--steps", "0", "--out", "x.xml"]) == 0
    assert dc.read_state("x.xml").world == dc.World(friction=1.0, restitution=0.4, gravity=(2.0, -3.0))


def test_a_file_may_come_after_options_of_one_number_or_two(scene, capsys):
    for words in (["--gravity", "1.62"], ["--gravity=1.62"], ["--gravity", "2", "-10"]):
        assert main(["simulate", "--steps", "0", *words, str(scene)]) == 0
        assert capsys.readouterr().out.startswith(f"{dc.read_state(scene).name}: 3 circles")
        with pytest.raises(SystemExit, match="2"):
            main(["simulate", "--steps", "0", *words, "--radius", "1", str(scene)])
        assert "--radius: expected none beside STATE.xml" in capsys.readouterr().err


@pytest.mark.parametrize("word", ["-1e1", "-1E+1", "-.5e-3", "-1.25e2", "-1e300", "-3e-12"])
def test_a_negative_number_with_an_exponent_is_no_option(word):
    args = command_line._parsers()[0].parse_args(["simulate", "--gravity", "0", command_line._without_exponent(word)])
    assert args.gravity == [0.0, float(word)]


@pytest.mark.parametrize(
    "words",
    [
        ["trade", "--scene", "lattice_in_box", "--bodies", "2", "--steps", "20", "--seeds", "1"],
        ["figure", "3.3", "--quick"],
    ],
)
def test_commands_run_in_any_thread(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(dc, "measure_trade", lambda scene, **options: "measured")
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(main, words).result() == 0


def test_a_pile_of_a_file_whose_gravity_is_taken_away_stays(scene, tmp_path):
    # Its impulses held it up: kept, they would throw it up (`starts.changed_load`).
    assert main(["simulate", str(scene), "--gravity", "0", "--steps", "2", "--out", str(tmp_path / "x.xml")]) == 0
    assert np.abs(dc.read_state(tmp_path / "x.xml").bodies.velocity).max() < 1e-3


def test_a_run_of_a_scene_is_stored_with_one_state_in_so_many_steps(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["--bodies", "5", "--size", "12", "--seed", "3", "--steps", "9", "--every", "4", "--out", "run.h5"]
    assert main(["simulate", *arguments]) == 0
    run = dc.load_trajectory("run.h5")
    assert [state.step for state in run] == [0, 4, 8, 9]
    expected = dc.simulate(dc.circles_in_box(5, size=12.0, seed=3), steps=9).state
    np.testing.assert_array_equal(run[3].bodies.position, expected.bodies.position)


def test_a_run_is_filmed_at_the_pace_of_the_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "--bodies", "3", "--steps", "8", "--every", "4", "--out", "run.gif"]) == 0
    with Image.open("run.gif") as film:
        assert (film.n_frames, film.info["duration"]) == (3, 40)
    assert main(["simulate", "--bodies", "3", "--steps", "9", "--every", "1", "--out", "fast.gif"]) == 0
    with Image.open("fast.gif") as film:  # 10 states of 1/100 s, of which players show every second
        assert (film.n_frames, film.info["duration"]) == (5, 20)


def test_a_run_is_a_page_and_its_last_step_a_picture_of_forces(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    drawn = []
    monkeypatch.setattr(dc.plotting, "draw_contact_forces", lambda ax, state: drawn.append(state))
    arguments = ["simulate", "--bodies", "5", "--size", "12", "--seed", "3", "--steps", "9", "--every", "4", "--out"]
    assert main([*arguments, "run.html"]) == 0
    assert '"times":[0.0,0.04,0.08,0.09]' in Path("run.html").read_text()
    assert main([*arguments, "pile_forces.png"]) == 0
    (state,) = drawn
    assert (state.step, state.solved) == (8, True)


def test_an_accuracy_picks_the_solver(capsys):
    assert main(["simulate", "--bodies", "3", "--no-gravity", "--steps", "0", "--accuracy", "fast"]) == 0
    solver = dc.recommend(dc.drifting_circles(3), accuracy="fast").solver
    assert capsys.readouterr().out.strip().endswith(describe(solver))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["simulat"], "; did you mean simulate?"),
        (["simulate", "--stps", "3"], "simulate: error: unrecognized arguments: --stps; did you mean --steps?"),
        (["simulate", "--acuracy=fast"], "unrecognized arguments: --acuracy=fast; did you mean --accuracy?"),
        (["simulate", "a.xml", "b.xml"], "unrecognized arguments: b.xml\n"),
        (["trade", "--sceen", "drum"], "trade: error: unrecognized arguments: --sceen; did you mean --scene?"),
        (["trade", "--scene", "hoper"], "--scene: expected one of circles_in_box, "),
        (["sample", "rest"], "sample: expected one of impact_154, "),
        (["simulate", "--every", "0"], "--every: expected an integer >= 1, got 0"),
        (["simulate", "--out", "run.txt"], "--out: expected"),
        (["simulate", "--out", "no/run.h5"], "--out: expected"),
        (["simulate", "--solver", "pgs"], "--solver: expected"),
        (["simulate", "--accuracy", "fast", "--sweeps", "3"], "--accuracy: expected"),
        (["simulate", "--accuracy", "best"], "accuracy: expected"),
        (["simulate", "--warm-start", "magic"], "expected one of none, builtin"),
        (["simulate", "--steps", "-1"], "steps: expected"),
        (["simulate", "scene.xml", "--bodies", "3"], "expected none beside STATE.xml"),
        (["simulate", "--every", "0", "--out", "film.gif"], "expected"),
        (["simulate", "scene.xml", "--radius", "2"], "--radius: expected none beside STATE.xml"),
        (["simulate", "scene.xml", "--no-gravity"], "a scene already, got True; `--gravity 0` switches gravity off"),
        (["simulate", "--gravity", "1", "--no-gravity"], "--gravity: expected none beside --no-gravity, got [1.0]"),
        (["simulate", "--gravity", "1", "2", "3"], "--gravity: expected one number or two, got [1.0, 2.0, 3.0]"),
        (["simulate", "--gravity", "a.xml"], "--gravity: expected one number or two, got ['a.xml']"),
        (["simulate", "a.xml", "--gravity", "1", "b.xml"], "--gravity: expected one number or two, got [1.0, 'b.xml']"),
        (["simulate", "--radius", "2", "1"], "radius: expected finite 0 < smallest <= largest"),
        (["simulate", "--friction", "-1"], "friction: expected a finite number >= 0, got -1.0"),
        (["simulate", "--restitution", "2"], "restitution: expected a finite number >= 0 and <= 1, got 2.0"),
    ],
)
def test_bad_arguments_exit_with_2_and_name_the_fault(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


ENDS = [
    (FloatingPointError("up to step 3"), 1, "simulate: up to step 3"),
    (FileNotFoundError(2, "No such file", "none.xml"), 3, "none.xml"),
    (StateFileError("bad.xml, line 3: <mass>"), 3, "simulate: bad.xml, line 3: <mass>"),
    (KeyboardInterrupt(), 130, ""),
]


@pytest.mark.parametrize(("error", "status", "message"), ENDS)
def test_what_ends_a_run_is_its_exit_status(error, status, message, monkeypatch, capsys):
    def fail(state, **options):
        raise error

    monkeypatch.setattr("deep_contact.simulate", fail)
    assert main(["simulate"]) == status
    assert message in capsys.readouterr().err
    assert main(["simulate", "none.xml"]) == 3
    assert f"{status} " in command_line.STATUS


def test_the_samples_are_named_by_their_paths(capsys):
    assert main(["sample", "rest_530"]) == 0
    assert capsys.readouterr().out == f"{dc.sample_file('rest_530')}\n"
    assert main(["sample"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 6


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["simulate", "--steps", "100000000000"], 2, "simulate: "),
        (["predict", "missing.xml"], 3, "missing.xml"),
        (["predict", "spoilt.xml"], 3, "spoilt.xml, line 1"),
        (["predict", "spoilt.xml", "--out", "spoilt.xml"], 3, "spoilt.xml"),
        (["predict", "spoilt.xml", "--model", "spoilt.xml"], 3, "spoilt.xml"),
        (["generate-data", "--quick", "--out", "spoilt.xml/data"], 3, "spoilt.xml"),
        (["generate-data", "--quick", "--steps", "1", "--simulations", "1", "--out", "data"], 2, "steps: expected"),
        (["train", "--data", "missing"], 3, "missing: expected files"),
        (["train", "--data", "missing", "--epochs", "0"], 2, "epochs: expected"),
    ],
)
def test_the_exit_status_of_a_script_is_the_guide_s(words, status, said, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    # Other tests of this process may have TensorFlow at work.
    monkeypatch.setattr("deep_contact.cnn.backend._apply_limit", lambda: None)
    Path("spoilt.xml").write_text("spoilt", encoding="utf-8")
    assert main(words) == status
    error = capfd.readouterr().err
    assert said in error
    assert "Traceback" not in error
