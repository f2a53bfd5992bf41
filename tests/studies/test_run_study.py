"""The study of runs: its settings, observations that are stored and read, rows, and resumption."""

import json
import time

import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact import figures
from deep_contact.accuracy.presets import PRESETS
from deep_contact.figures import results
from deep_contact.measure import peers, setting_runs
from deep_contact.measure.errors import SETTLED, observation
from deep_contact.measure.settings import name_of
from deep_contact.state.constants import TIME_STEP
from deep_contact.studies import runs
from deep_contact.studies.runs import done

COARSE = {"method": "PGS", "sweeps": 3, "dt": TIME_STEP}
FINE, PEER = COARSE | {"dt": TIME_STEP / 2}, {"engine": "pymunk", "sweeps": 4, "dt": TIME_STEP}


def observed(kind, n_bodies, seed, setting, seconds):
    """What is read of the stored observation of a run, which is the same every time."""
    stored, again = (
        results.plain(runs.observed(runs.scene_of_kind, kind, n_bodies, seed, setting, seconds=seconds))
        for _ in range(2)
    )
    assert stored == again
    return observation(json.loads(json.dumps(stored)))


@pytest.mark.parametrize("engine", list(peers.ENGINES))
def test_other_engines_fall_as_ours(engine):
    pytest.importorskip(peers.ENGINES[engine].package)
    peer = {"engine": engine, "sweeps": 10, "dt": TIME_STEP}
    ours, theirs = (observed("plain", 30, 2, setting, 1.0) for setting in (COARSE, peer))
    # Until the first contact with the floor the fall is the same in all of them, to float32 and half a step.
    np.testing.assert_allclose(theirs.kinetic[:10], ours.kinetic[:10], rtol=0.05, atol=0.02)
    assert theirs.loads is None


def test_a_row_holds_a_setting_against_the_reference():
    coarse, true = ([observed("plain", 30, k, one, 1.5) for k in (1, 2)] for one in (COARSE, runs.REFERENCE))
    found = setting_runs.row_of(COARSE, TIME_STEP, coarse, true)
    assert (found["name"], found["seeds"]) == ("PGS, 3 sweeps, Δt", 2)
    value, low, high = found["errors"]["penetration_max"]
    assert 0 < low <= value <= high


def row(setting, us, error, kind="plain"):
    errors = {name: (error, error, error) for name in PRESETS["preview"]}
    common = {"kind": kind, "n_bodies": 100, "errors": errors, "seeds": 6}
    return common | {"name": name_of(setting), "setting": setting, "us": us, "times": [us, 1.1 * us, 0.9 * us]}


def test_the_cheapest_setting_that_keeps_a_preset_is_chosen_for_each_kind():
    rows = [row(COARSE, 1.0, 0.0), row(COARSE, 1.0, 1e3, "mixed radii"), row(PEER, 12.0, 0.0)]
    rows += [row(FINE, us, 0.0, kind) for kind, us in (("plain", 2.0), ("mixed radii", 3.0))]
    found = runs.presets(rows)[0]
    assert {kind: best["us"] for kind, best in found["kinds"].items()} == {"plain": 1.0, "mixed radii": 3.0}
    assert found["peers"]["pymunk"]["us"] == 12.0
    assert found["peers"]["Box2D v3"] is None
    assert found["ratio"] == pytest.approx([12.0, 12.0, 12.0])


def test_the_ratio_to_rivals_has_the_ends_of_the_errors():
    # The cheap ones keep the preset but for the upper end of their intervals.
    costs = ((COARSE, 1.0), (FINE, 2.0), (PEER, 12.0), (PEER | {"sweeps": 10}, 36.0))
    rows = [row(setting, us, 0.0) for setting, us in costs]
    for one in (rows[0], rows[2]):
        one["errors"]["energy"] = (0.0, 0.0, 1e3)
    assert runs.presets(rows)[0]["ratio"] == pytest.approx([12.0, 6.0, 36.0])


def test_the_ratio_holds_the_times_of_all_processes_and_ours_leaves_a_margin():
    rows = [row(COARSE, 1.0, 0.0), row(FINE, 2.0, 0.0), row(PEER, 12.0, 0.0)]
    rows[2]["times"] = [10.0, 12.0, 15.0]
    for one in (rows[0], rows[2]):
        one["errors"] = {name: [0.9 * most] * 3 for name, most in PRESETS["preview"].items()}  # within, by no margin
    found = runs.presets(rows)[0]
    assert found["kinds"]["plain"]["us"] == 2.0  # what `simulate(accuracy=…)` takes
    assert found["peers"]["pymunk"]["us"] == 12.0
    assert found["ratio"] == pytest.approx([5.4545, 5.0, 16.667], rel=1e-4)  # 1.0 keeps it at the ends, by no margin


def work():
    """A tenth of a second of this thread."""
    begun = time.thread_time()
    while time.thread_time() < begun + 0.1:
        pass


class Slow:
    """A stand-in for another engine whose first step and destruction take a tenth of a second."""

    name = "slow"

    def __init__(self, state):
        self.steps = 0

    def run(self, steps, *options):
        if self.steps == 0:
            work()
        self.steps += steps

    def __del__(self):
        work()


def test_neither_the_first_step_nor_the_destruction_of_a_world_is_timed(monkeypatch):
    monkeypatch.setitem(peers.ENGINES, "slow", Slow)
    slow = {"engine": "slow", "sweeps": 4, "dt": TIME_STEP}
    assert setting_runs.timed(runs.scene_of_kind("plain", 10, 1), slow, 0.1) < 0.05


def test_loading_code_is_not_timed(monkeypatch):
    real, calls = setting_runs.simulate, []
    monkeypatch.setattr(
        setting_runs, "simulate", lambda *args, **options: (calls or work(), calls.append(1)) and real(*args, **options)
    )
    assert setting_runs.timed(runs.scene_of_kind("plain", 10, 1), COARSE, 0.1) < 0.05


@pytest.mark.parametrize("kind", ["mixed radii", "gas", "drum"])
def test_scenes_are_observed(kind):
    seen = observed(kind, 40, 3, COARSE, 1.0)
    assert (seen.force is None) == (kind == "gas")
    assert seen.speed[-1] > SETTLED  # it still falls, or never rests
    assert 0 < seen.kinetic.max()
    assert seen.penetration.max() < 1


def test_a_step_that_misses_the_observations_is_refused():
    with pytest.raises(ValueError, match="dt: expected"):
        runs.observed(runs.scene_of_kind, "plain", 30, 1, COARSE | {"dt": 0.02}, seconds=1.0)


@pytest.mark.parametrize("damage", [b"", b'{"k": ', b"\xff\x00", b"\0" * 8])
def test_a_damaged_part_of_a_study_is_computed_again(tmp_path, damage):
    parts, calls = [{"n_bodies": 1, "k": k} for k in range(3)], []
    compute = lambda n_bodies, k: calls.append(k) or {"k": k}  # noqa: E731
    first = done("part", compute, parts, work=tmp_path, jobs=1)
    sorted(tmp_path.iterdir())[1].write_bytes(damage)
    assert done("part", compute, parts, work=tmp_path, jobs=1) == first
    assert len(calls) == 4


def stand_in(make, kind, n_bodies, seed, setting, **_):
    """In place of `runs.observed`: a run whose numbers are those of its seed and its sweeps."""
    seen = {name: np.full(30, 1.0 + seed % 1000) for name in ("kinetic", "height", "speed", "contacts")}
    seen["kinetic"] = seen["kinetic"] * (1.0 + 0.01 * (setting["sweeps"] != 20))
    seen |= {"penetration": np.zeros((30, 3)), "force": np.ones(30), "loads": None, "interval": 0.1}
    return results.plain(seen | {"quantities": {}})


@pytest.fixture
def without_runs(monkeypatch):
    """Studies whose runs cost nothing."""
    monkeypatch.setattr(runs, "observed", stand_in)
    monkeypatch.setattr(runs, "time_run", lambda make, **_: 7.0)


def test_fewer_seeds_than_the_reference_meet_its_runs_of_the_same_scenes(tmp_path, without_runs):
    cases = {("plain", 20, "reference"): (runs.REFERENCE, 9), ("plain", 20, "coarse"): (COARSE, 3)}
    common = {"seed": 0, "seconds": 1.0, "work": tmp_path}
    rows = runs.observed_rows(runs.scene_of_kind, cases, **common, jobs=1)
    reference, row = runs.timed_rows(runs.scene_of_kind, rows, {("plain", 20, "coarse"): 1}, **common)
    assert (reference["errors"], reference["us"]) == (None, None)
    assert (row["seeds"], row["us"], row["times"]) == (3, 7.0, [7.0])
    assert row["errors"]["energy"] == pytest.approx((1.0, 1.0, 1.0))


def test_a_study_takes_over_the_runs_of_an_earlier_commit_and_tries_some_of_them_again(tmp_path, monkeypatch):
    calls, factor = [], 1.0

    def run(make, *, seed, **arguments):
        calls.append(seed)
        seen = stand_in(make, seed=seed, **arguments)
        return seen | {"kinetic": [factor * one for one in seen["kinetic"]]}

    monkeypatch.setattr(runs, "observed", run)
    monkeypatch.setattr(runs, "time_run", lambda make, **_: float(len(calls)))
    cases = {("plain", 20, "reference"): (runs.REFERENCE, 9), ("plain", 20, "coarse"): (COARSE, 3)}
    common = {"seed": 0, "seconds": 1.0, "work": tmp_path}

    def study(commit, count, **options):
        monkeypatch.setattr(runs, "commit", lambda: commit)
        calls.clear()
        rows = runs.observed_rows(runs.scene_of_kind, cases, **common, **options, jobs=1)
        return rows, runs.timed_rows(runs.scene_of_kind, rows, dict.fromkeys(cases, count), **common, **options)

    first, timed = study("a", 1)
    assert (len(calls), timed[1]["times"]) == (12, [12.0])
    taken, timed = study("b", 1, earlier="a")
    assert (len(calls), taken, timed[1]["times"]) == (1, first, [12.0])
    assert study("c", 1)[0] == first
    assert len(calls) == 12
    factor = 1.5
    with pytest.raises(ValueError, match=r"earlier: .*got another run of \('plain', 20, 'coarse'\)"):
        study("d", 1, earlier="a")
    asked = []
    monkeypatch.setattr(runs, "done", lambda *_, parts=(), **__: asked.extend(parts) or [1.0] * len(parts))
    runs.timed_rows(runs.scene_of_kind, first, {key: 2 for key in cases}, **common, earlier="a")
    assert {part["earlier"] for part in asked} == {""}  # several times are compared with others: none is taken over


@pytest.fixture
def study(tmp_path, monkeypatch, without_runs):
    """A function: the results of a small study of these settings, and the script."""
    script = load_script("run_tradeoff")
    monkeypatch.setattr(script, "error", lambda setting: 0.5)
    seeds = {"seeds": {"20": {"plain": 2}}, "ladder_seeds": {"20": 2}, "peer_seeds": {"20": 2}}

    def run(settings):
        lists = {name: {"20": settings if name == "settings" else []} for name in script.LISTS}
        monkeypatch.setattr(script, "LISTS", lists)
        options = seeds | {"seconds": 1.0, "work": str(tmp_path / "work")}
        return figures.produce(script.FIGURE, options=options, quick=True, out=tmp_path)

    return run, script


def test_the_script_installs_what_recommend_reads(study, tmp_path, monkeypatch):
    run, script = study
    found = run([COARSE, {"method": "NNCG", "sweeps": 2, "dt": TIME_STEP}])
    names = {row["name"] for row in found["data"]["rows"]}
    assert names == {"PGS, 20 sweeps, Δt / 16", "PGS, 3 sweeps, Δt", "NNCG, 2 sweeps, Δt"}
    monkeypatch.setattr(script, "TABLE", tmp_path / "runs.json")
    monkeypatch.setattr(results, "REFERENCE", tmp_path)
    script.install()
    table = json.loads((tmp_path / "runs.json").read_text())
    monkeypatch.setattr("deep_contact.accuracy.presets.installed", lambda: table)
    assert dc.recommend(dc.circles_in_box(20), accuracy="preview").us > 0
    assert {setting["name"] for setting in table["settings"]} == {"PGS, 3 sweeps, Δt", "NNCG, 2 sweeps, Δt"}


def test_what_presets_and_trades_choose_is_held_against_scenes_outside_the_study(tmp_path, monkeypatch, without_runs):
    """A row a preset, of the setting that it takes; a tolerance is kept by the value, or within by the lower end."""
    script = load_script("run_tradeoff_verify")
    monkeypatch.setattr(script, "chosen_by_trade", lambda *_: dict.fromkeys(PRESETS, (FINE, 3.5)))
    options = {"scenes": {"20": ["loose"]}, "seeds": {"20": 2}, "timed": {"20": ["loose"]}, "trades": {"20": ["loose"]},
               "work": str(tmp_path / "work")}  # fmt: skip
    data = figures.produce(script.FIGURE, options=options, quick=True, out=tmp_path)["data"]
    taken = script.chosen_by_presets(script.scene("loose", 20, script.FIGURE.seed))
    assert [(row["preset"], row["setting"]) for row in data["rows"]] == [(name, one[0]) for name, one in taken.items()]
    assert [(row["preset"], row["setting"]) for row in data["trades"]] == [(name, FINE) for name in PRESETS]
    assert [(row["preset"], row["setting"]["sweeps"]) for row in data["again"]] == [(name, 21) for name in PRESETS]
    assert [row["us"] for row in data["times"]] == [7.0] * len(PRESETS)
    errors = {"energy": (26, 24, 28), "height": (6, 5.5, 7), "impact": (35, 30, 40), "creep": None}
    judged = script.judged(errors, "preview")
    assert judged["kept"] == {"energy": False, "height": False, "impact": True}
    assert judged["within"] == {"energy": True, "height": False, "impact": True}
