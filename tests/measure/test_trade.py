"""The trade on a scene of one's own: errors of known answers, budgets, what goes wrong, and what is chosen."""

import json
import math
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import observation

import deep_contact as dc
from deep_contact.__main__ import main
from deep_contact.accuracy import scene_numbers, stiffness
from deep_contact.measure import measurement, setting_runs, settings
from deep_contact.measure import trade as module
from deep_contact.measure.trade import SHOWN
from deep_contact.state.constants import WALL_SKIN
from deep_contact.state.fields import make_bodies

G, SLOPE = 9.81, math.radians(20.0)


def on_slope(friction):
    """A circle that touches a slope of 20°, at rest."""
    down, normal = np.array([math.cos(SLOPE), -math.sin(SLOPE)]), np.array([math.sin(SLOPE), math.cos(SLOPE)])
    top = np.array([5.0, 40.0])
    segment = (tuple(top - 4 * down), tuple(top + 60 * down))
    world = dc.World(box=(0, 0, 80, 60), friction=friction, segments=[segment])
    return dc.State(name="slope", world=world, bodies=make_bodies([top + (1 + WALL_SKIN) * normal], radius=1.0))


def velocity_down(state):
    return float(state.bodies.velocity[0] @ (math.cos(SLOPE), -math.sin(SLOPE)))


ROLLING, SLIDING = 2 / 3 * G * math.sin(SLOPE), G * (math.sin(SLOPE) - 0.05 * math.cos(SLOPE))
KNOWN = {
    "rolling": (lambda: on_slope(0.5), velocity_down, lambda t: ROLLING * t),
    "sliding": (lambda: on_slope(0.05), velocity_down, lambda t: SLIDING * t),
    "two circles": (lambda: dc.two_bodies(speed=4.0, restitution=0.5), lambda s: np.diff(s.bodies.velocity[:, 0])[0],
                    lambda t: 0 * t + 2.0),
}  # fmt: skip
"""Name -> scene, quantity, and what it is at time t: rolling without slip where μ >= tan α / 3, sliding below."""


@pytest.mark.parametrize("name", KNOWN)
def test_the_error_that_it_reports_is_the_true_one(name):
    scene, quantity, answer = KNOWN[name]
    trade = dc.measure_trade(lambda seed: scene(), steps=60, seeds=1, quantities={"q": quantity})
    true = answer(0.01 * np.arange(1, 61))

    def off(runs):
        return np.abs(trade.observed[runs, 0][1].quantities["q"] - true).sum() / np.abs(true).sum()

    assert off("reference") < 5e-3
    for row in trade.rows:
        assert row["errors"]["q"][0] == pytest.approx(off(row["name"]), abs=off("reference") + 1e-9)


def test_the_fall_of_symplectic_euler_is_late_by_half_a_step():
    trade = dc.measure_trade(
        lambda seed: dc.single_body(height=25.0), steps=60, seeds=1, quantities={"y": lambda s: s.bodies.position[0, 1]}
    )
    t = 0.01 * np.arange(1, 61)
    for row in trade.rows:
        later = 0.01 / row["setting"].get("substeps", 1) - 0.01 / 16
        size = (26.01 - 0.5 * G * t * (t + 0.01 / 16)).sum()
        assert row["errors"]["y"][0] == pytest.approx(0.5 * G * abs(later) * t.sum() / size, rel=1e-6, abs=1e-12)
    assert any("nothing touches" in note for note in trade.notes)


@pytest.fixture(scope="module")
def pile():
    scene = dc.simulate(dc.circles_in_box(20, size=12.0, seed=1), steps=40, solver=dc.PGS()).state
    return scene, dc.measure_trade(
        scene, steps=40, seeds=3, quantities={"top": lambda s: s.bodies.position[:, 1].max()}
    )


def test_what_is_chosen_keeps_what_was_asked_at_the_least_cost(pile, tmp_path):
    scene, trade = pile
    chosen = trade.chosen(penetration_max=5.0)
    keep = [row for row in trade.rows if row["errors"]["penetration_max"][2] <= 5.0]
    assert chosen in keep
    assert chosen["us"] == min(row["us"] for row in keep)
    solver = trade.choose("fast")
    run = dc.simulate(scene, steps=3, accuracy=trade)
    assert run.state.solver == solver
    again = dc.load_trade(trade.save(tmp_path / "trade.json"))
    assert str(again) == str(trade)
    np.testing.assert_array_equal(again.values("top")["reference"], trade.values("top")["reference"])
    assert again.choose("fast") == solver
    assert "copies of the state stay" in str(trade)
    assert len(trade.plot().axes) == 3
    with pytest.raises(ValueError, match=r"tolerances: expected one of .*top spread, got 'bottom'"):
        trade.choose(bottom=0.1)
    with pytest.raises(ValueError, match="choose: expected a preset or tolerances, got both"):
        trade.choose("reference", energy=1.0)
    with pytest.raises(ValueError, match=r"Δt = 0\.01 s, as measured, got 0\.02"):
        dc.simulate(scene.replace(dt=0.02, contacts=None), steps=1, accuracy=trade)


def test_values_are_in_the_order_of_the_seeds_however_the_runs_ended(pile):
    _, trade = pile
    other = replace(trade, observed=dict(reversed(trade.observed.items())))
    for name, values in trade.values("top").items():
        np.testing.assert_array_equal(other.values("top")[name], values)


def test_a_plan_under_a_trade_names_a_stiff_scene(pile):
    _, trade = pile
    choice = dc.plan(dc.column(200), accuracy=trade)["solving stiff piles"]
    assert not choice.used
    assert "200" in choice.why


def test_it_goes_on_where_it_was_interrupted(pile, monkeypatch):
    scene, whole = pile
    real, calls = measurement._task, []

    def interrupted(task):
        calls.append(task)
        if len(calls) == 20:
            raise KeyboardInterrupt
        return real(task)

    options = {"steps": 40, "seeds": 3, "quantities": {"top": lambda s: s.bodies.position[:, 1].max()}}
    monkeypatch.setattr(measurement, "_task", interrupted)
    part = dc.measure_trade(scene, **options)
    assert part.seeds == 2
    assert "interrupted: this is what was known then" in part.notes
    rest = dc.measure_trade(scene, **options, before=part)
    assert len(calls) == 20 + len(whole.observed) - len(part.observed)
    assert [row["errors"] for row in rest.rows] == [row["errors"] for row in whole.rows]


def raises(state):
    raise RuntimeError("boom")


def test_a_trade_is_printed_with_its_numbers_first(pile):
    """Of the widest line before, 185 columns, the setting took the first 70, and the numbers were cut."""
    title, header, *lines = str(pile[1]).splitlines()
    assert header.split() == ["ms", "a", "step", *SHOWN, "top", "keeps", "setting"]
    assert title.endswith("; errors in %")
    assert header.index("setting") < 90
    assert {line[header.index("setting") :].split(" (")[0] for line in lines} >= pile[1].settings.keys()


OTHER = {
    "restitution": lambda scene: scene.replace(world=replace(scene.world, restitution=0.3)),
    "friction": lambda scene: scene.replace(world=replace(scene.world, friction=0.1)),
    "gravity": lambda scene: scene.replace(world=replace(scene.world, gravity=(0.0, -5.0))),
    "a segment": lambda scene: scene.replace(world=replace(scene.world, segments=[((1, 1), (2, 1))])),
    "a box": lambda scene: scene.replace(world=replace(scene.world, box=(0, 0, 12, 13))),
    "scales": lambda scene: scene.replace(world=replace(scene.world, scales=dc.BOX2D)),
    "impulses": lambda scene: scene.replace(
        contacts=scene.contacts._replace(normal_start=2.0 * scene.contacts.normal_start)
    ),
    "no contacts": lambda scene: scene.replace(contacts=None),
    "time": lambda scene: scene.replace(time=scene.time + 1.0),
}
"""What may differ from a scene while its circles are the same -> the other scene."""


@pytest.mark.parametrize("name", OTHER)
def test_an_earlier_trade_of_another_world_is_refused(name, pile):
    """A trade with e = 0 was taken for one with e = 0.9: 90.7 % for an error of 8.2 %."""
    scene, before = pile
    trade = replace(
        before, digests=[measurement._digest_of_state(state) for state in measurement.copies(scene, range(3))]
    )
    assert measurement._known(trade, before).keys() == before.observed.keys()
    trade.digests = [measurement._digest_of_state(state) for state in measurement.copies(OTHER[name](scene), range(3))]
    with pytest.raises(ValueError, match="before: expected a trade of the same scene, got another"):
        measurement._known(trade, before)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"quantities": {"top": lambda s: s.bodies.position[:, 1].min()}}, "before: expected looks"),
        ({"quantities": {"top": raises}}, "before: expected looks"),
        ({"quantities": {}}, "before: expected quantities"),
        ({"steps": 50}, "before: expected steps 50, got 40"),
        ({"before": 3}, "before: expected a Trade, got 3"),
    ],
)
def test_an_earlier_trade_of_other_quantities_is_refused(changes, sentence, pile):
    scene, before = pile
    options = {"steps": 40, "seeds": 3, "quantities": {"top": lambda s: s.bodies.position[:, 1].max()}}
    with pytest.raises(ValueError, match=sentence):
        dc.measure_trade(scene, **options | {"before": before} | changes)


def test_an_earlier_trade_of_another_processor_is_refused(pile):
    with pytest.raises(ValueError, match="before: expected cpu"):
        measurement._known(pile[1], replace(pile[1], cpu="another"))


def forces_between(run):
    """A stored run of an earlier version, with forces between two times: one force less than times."""
    *start, seen = run
    return [*start, seen | {"force": seen["force"][1:]}]


SPOILT = {
    "no JSON": lambda stored: "{",
    "nested": lambda stored: "[" * 100_000,
    "a list": lambda stored: "[]",
    "a number": lambda stored: "3",
    "binary": lambda stored: "\x00",
    "text for steps": lambda stored: json.dumps(stored | {"steps": "40"}),
    "text for rows": lambda stored: json.dumps(stored | {"rows": "40"}),
    "numbers for rows": lambda stored: json.dumps(stored | {"rows": [1, 2]}),
    "text for times": lambda stored: json.dumps(stored | {"rows": [one | {"us": "1"} for one in stored["rows"]]}),
    "a setting that is none": lambda stored: json.dumps(stored | {"settings": {"a": {"method": "PGSS"}}}),
    "an observation that is none": lambda stored: json.dumps(stored | {"observed": [["a", 0, 1.0, {}]]}),
    "no number for times": lambda stored: json.dumps(
        stored | {"rows": [one | {"us": math.nan} for one in stored["rows"]]}
    ),
    "times below 0": lambda stored: json.dumps(stored | {"rows": [one | {"us": -1.0} for one in stored["rows"]]}),
    "a number beyond floats": lambda stored: json.dumps(stored | {"dt": 7.5}).replace("7.5", "1e999"),
    "no time step": lambda stored: json.dumps(stored | {"dt": math.nan}),
    "fewer circles than none": lambda stored: json.dumps(stored | {"n_bodies": -5}),
    "an unknown option": lambda stored: json.dumps(
        stored | {"rows": [one | {"setting": one["setting"] | {"omga": 1.0}} for one in stored["rows"]]}
    ),
    "observed once": lambda stored: json.dumps(stored | {"observed": [3]}),
    "forces between times": lambda stored: json.dumps(stored | {"observed": [forces_between(stored["observed"][0])]}),
}
"""What a file may be in place of a trade -> its text, of what `Trade.save` writes."""


@pytest.mark.parametrize("name", SPOILT)
def test_a_file_that_is_no_trade_is_refused_in_a_sentence(name, pile, tmp_path):
    path = pile[1].save(tmp_path / "trade.json")
    path.write_text(SPOILT[name](json.loads(path.read_text(encoding="utf-8"))), encoding="utf-8")
    with pytest.raises(ValueError, match=r"trade\.json: expected a file of Trade\.save, got .{1,200}$"):
        dc.load_trade(path)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["pipe", "/dev/zero", "folder"])
def test_a_trade_is_read_of_files_alone(name, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ValueError, match="expected a file, got a folder, pipe or device"):
        dc.load_trade(tmp_path / name)


def test_no_run_begins_after_its_minutes_and_what_is_known_is_returned(pile, monkeypatch):
    """The clock goes on by a minute a run: three minutes have room for three runs, of the first seed."""
    scene, _ = pile
    real, minutes = measurement._task, []

    def counted(task):
        minutes.append(60.0)
        return real(task)

    monkeypatch.setattr(measurement, "_task", counted)
    monkeypatch.setattr(setting_runs.time, "monotonic", lambda: 1.001 * sum(minutes))
    trade = dc.measure_trade(scene, steps=40, seeds=12, minutes=3.0)
    assert trade.seeds == 1
    assert len(minutes) == len(trade.observed) == 3
    assert f"after 3 min 3 of {12 * (len(trade.settings) + 2)} runs were done" in trade.notes
    assert [row["name"] for row in trade.rows] == list(trade.settings)[:2]


@pytest.mark.parametrize(
    ("quantity", "sentence"),
    [
        (raises, "a number or an array, got RuntimeError: boom"),
        (lambda state: math.nan, "finite numbers up to 1e+100, got nan"),
        (lambda state: 1e300, "finite numbers up to 1e+100, got 1e+300"),
        (lambda state: state.bodies.position[5:], "finite numbers up to 1e+100, got []"),
        (lambda state: np.zeros(state.step), "the shape that it had before, (1,), got (2,)"),
    ],
)
def test_a_quantity_that_fails_is_a_sentence_and_nothing_is_lost(quantity, sentence):
    trade = dc.measure_trade(lambda seed: dc.single_body(), steps=20, seeds=1, quantities={"q": quantity})
    assert sentence in str(trade)
    assert trade.rows[0]["errors"]["q"] is None
    assert trade.rows[0]["errors"]["penetration"]


def test_a_setting_that_diverges_is_a_sentence_and_nothing_is_lost(monkeypatch):
    real = setting_runs.simulate

    def simulate(state, *, solver, **options):
        if isinstance(solver, dc.NNCG):
            raise FloatingPointError("up to step 1: the solver diverged")
        return real(state, solver=solver, **options)

    monkeypatch.setattr(setting_runs, "simulate", simulate)
    trade = dc.measure_trade(dc.column(3), steps=20, seeds=2)
    assert "comes to no end: up to step 1" in str(trade)
    assert len(trade.rows) == len(trade.settings) - 1


@pytest.mark.parametrize(
    ("scene", "options", "sentence"),
    [
        (raises, {}, r"scene\(0\): expected a State, got RuntimeError: boom"),
        (lambda seed: None, {}, "State"),
        (3, {}, "scene: expected a State or a function of a seed, got 3"),
        (dc.column(2), {"steps": 5}, "steps: expected an integer >= 20, got 5"),
        (dc.column(2), {"minutes": 0}, "minutes: expected"),
        (dc.column(2), {"seeds": [1, 1, 1]}, r"seeds: expected different numbers, got \[1, 1, 1\]"),
        (dc.column(2), {"seeds": []}, r"seeds: expected different numbers, got \[\]"),
        (dc.column(2), {"quantities": {"q": 3}}, r"quantities\['q'\]: expected a function of a state, got 3"),
        (dc.column(2), {"quantities": {"q": raises}, "settings": [3]}, "solver: expected options"),
        (dc.two_bodies(speed=0.0), {}, "expected gravity or motion"),
        (lambda seed: dc.column(2 + seed), {}, "expected as many circles"),
    ],
)
def test_bad_input_is_a_sentence(scene, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        dc.measure_trade(scene, **{"steps": 20, "seeds": 2} | options)


def test_a_barrel_is_measured():
    """Its resamplings lack what the ensemble has: this once ended in "x must have real dtype"."""
    trade = dc.measure_trade(lambda seed: dc.barrel(4, columns=3, seed=seed), steps=40, seeds=3)
    assert all(row["errors"]["energy"] for row in trade.rows)


def test_the_command_line_and_recommend_lead_to_it(tmp_path, capsys):
    out = tmp_path / "trade.json"
    words = ["--scene", "lattice_in_box", "--bodies", "20", "--steps", "20", "--seeds", "1", "--out", str(out)]
    assert main(["trade", *words]) == 0
    assert capsys.readouterr().out.startswith("lattice_20: 20 circles, 20 steps of 0.01 s, 1 seed")
    assert dc.load_trade(out).n_bodies == 20
    assert "dc.measure_trade(scene) measures it on this scene" in str(dc.recommend(dc.lattice_in_box(40, friction=0.9)))


# ---- by hand, without a run ----

SETTINGS = {f"PGS, {k} sweeps, Δt": {"method": "PGS", "sweeps": k, "dt": 0.01} for k in (2, 4)}
CHEAP, DEAR = SETTINGS


def by_hand(**changes):
    """A trade of two settings on two circles, of which nothing is known yet."""
    of_scene = {"scene": "two", "n_bodies": 2, "dt": 0.01, "steps": 40, "digests": ["a", "b"], "quantities": ["q"]}
    return module.Trade(
        **of_scene
        | {"settings": SETTINGS, "by_preset": {}, "reference": SETTINGS[DEAR], "half": SETTINGS[DEAR], "seeds": 2}
        | changes
    )


def rows(**errors):
    """Of both settings, which take 1 and 2 μs. errors: name -> (value, low, high) of each."""
    return [
        {"name": name, "setting": setting, "group": "PGS", "seeds": 2, "us": us, "errors": dict(zip(errors, three))}
        for (name, setting), us, three in zip(SETTINGS.items(), (1.0, 2.0), zip(*errors.values()))
    ]


def test_noise_is_the_mean_error_of_pairs_that_are_swapped_half_of_the_time():
    """Of two pairs (1.1 and 1), none, one, the other or both are swapped, a quarter of the time each."""
    half, reference = [observation(kinetic=1.1, penetration=0.1)] * 2, [observation()] * 2
    noise = setting_runs.noise_of(half, reference, swaps=400)
    assert noise["energy"] == pytest.approx(0.25 * (10.0 + 0.0 + 0.0 + 10.0 / 1.1), abs=0.7)  # three standard errors
    assert not noise.keys() & set(setting_runs.ABSOLUTE)
    assert setting_runs.noise_of(half[:1], reference[:1]) == {}


def test_seeds_are_enough_once_chance_makes_half_of_a_difference():
    """Chance falls with the root of the seeds: of 6 it makes half of 6 %; half of 1.5 % takes 16 times as many."""
    trade = by_hand(noise={"energy": 3.0}, seeds=6)
    assert [trade.enough("energy", differ) for differ in (6.0, 1.5)] == [6, 96]
    assert trade.enough("height", 1.0) == 0


@pytest.mark.parametrize(
    ("cheap", "dear", "chosen"),
    [
        ((1.0, 0.5, 2.1), (1.0, 0.5, 1.9), DEAR),  # the upper end decides
        ((1.0, 0.5, 1.9), (0.1, 0.0, 0.2), CHEAP),  # without a margin
        ((1.8, 1.0, 2.1), (1.6, 1.0, 2.1), DEAR),  # neither end keeps it: the value does, with a margin
        ((1.8, 1.0, 2.1), (1.9, 1.0, 2.1), CHEAP),  # or without
        (None, (1.9, 1.0, 2.1), DEAR),
    ],
)
def test_what_is_chosen_keeps_a_tolerance_at_the_upper_end_or_with_a_margin(cheap, dear, chosen):
    trade = by_hand(rows=rows(energy=(cheap, dear)))
    assert trade.chosen(energy=2.0)["name"] == chosen


def test_the_nearest_is_taken_where_nothing_keeps_a_tolerance_and_a_budget_of_seeds_is_said():
    trade = by_hand(rows=rows(energy=((9.0, 1.0, 9.5), (8.0, 7.0, 9.9))), noise={"energy": 2.0})
    with pytest.warns(module.presets.PresetWarning, match="no setting keeps it"):
        assert trade.chosen(energy=5.0)["name"] == DEAR
    with pytest.warns(module.presets.PresetWarning) as said:
        trade.chosen(energy=2.0)
    assert str(said[0].message) == "energy: seeds alone make an error of 2, asked for was 2; 8 seeds would do"


@pytest.mark.parametrize(("count", "is_said"), [(49, True), (50, False), (200, False), (201, True)])
def test_a_scene_of_twice_or_half_the_circles_is_another(count, is_said):
    trade = by_hand(rows=rows(energy=((1.0, 1.0, 1.0),) * 2), n_bodies=100)
    assert bool(trade.decide(dc.lattice_in_box(count)).warnings) == is_said


def test_a_trade_decides_solver_and_start_of_the_row_that_it_chooses():
    found = rows(energy=((1.0, 1.0, 1.0), (1.0, 1.0, 1.0)))
    found[0]["setting"] = SETTINGS[CHEAP] | {"start": "support"}
    scene = dc.lattice_in_box(2)
    for us, start, sweeps in (((1.0, 2.0), "support", 2), ((3.0, 2.0), "builtin", 4)):
        trade = by_hand(rows=[row | {"us": each} for row, each in zip(found, us)])
        decision = trade.decide(scene)
        assert (decision.start, decision.us, decision.warnings) == (start, min(us), ())
        assert decision.solver == dc.PGS(sweeps=sweeps, tolerance=None)
        assert dc.plan(scene, accuracy=trade).warm_start == start


@pytest.mark.parametrize("radius", [1.0, 0.01])
def test_a_reference_has_small_steps_and_half_of_it_has_half_of_them(radius):
    """A sixteenth of a preset's longest step; of what is solved to a tolerance, too."""
    scene = dc.lattice_in_box(20, radius=(radius, radius))
    numbers = scene_numbers.scene_numbers(scene)
    parts = module.presets.parts_for(numbers, 0.01 / 16)
    assert parts == {1.0: 16, 0.01: 256}[radius]
    once, twice = (settings.reference_of(numbers, None, finer) for finer in (1, 2))
    assert once == {"method": "PGS", "sweeps": 20, "dt": scene.dt, "substeps": parts}
    assert twice == once | {"substeps": 2 * parts}
    column = stiffness.Stiffness("a column", 1e-3)
    for finer in (1, 2):
        setting = settings.reference_of(numbers, column, finer)
        assert settings.solver_of(setting) == column.solver(finer * parts)


HEAPS = [stiffness.Stiffness("a heap", None, k) for k in (2, 100)]


@pytest.mark.parametrize("heap", HEAPS, ids=lambda heap: heap.heap)
def test_the_reference_of_a_heap_has_substeps_of_20_sweeps_in_place_of_8_and_four_times_as_many(heap):
    numbers = scene_numbers.scene_numbers(dc.lattice_in_box(20))
    setting = settings.reference_of(numbers, heap)
    assert (setting["method"], setting["sweeps"]) == ("PGS", 20)
    assert setting["substeps"] == 4 * heap.solver(16).substeps
    assert settings.reference_of(numbers, heap, 2)["substeps"] > setting["substeps"]


@pytest.mark.parametrize("heap", HEAPS, ids=lambda heap: heap.heap)
def test_half_the_step_of_a_heaps_reference_is_half_of_it(heap):
    numbers = scene_numbers.scene_numbers(dc.lattice_in_box(20))
    once, twice = (settings.reference_of(numbers, heap, finer) for finer in (1, 2))
    assert twice == once | {"substeps": 2 * once["substeps"]}


@pytest.mark.parametrize(
    ("setting", "name"),
    [
        ({"method": "PGS", "sweeps": 1, "dt": 0.01}, "PGS, 1 sweep, Δt"),
        ({"method": "PGS", "sweeps": 2, "dt": 0.005, "substeps": 4}, "PGS, 2 sweeps, substeps=4, Δt / 2"),
        ({"method": "PSOR", "omega": 1.2, "sweeps": 3, "dt": 0.04}, "PSOR, 3 sweeps, omega=1.2, 4 Δt"),
        ({"engine": "Box2D v3", "sweeps": 4, "dt": 0.01 / 3}, "Box2D v3, 4 iterations, Δt / 3"),
        ({"engine": "pymunk", "sweeps": 1, "dt": 0.01}, "pymunk, 1 iteration, Δt"),
    ],
)
def test_a_setting_has_a_name_that_tells_all_of_it(setting, name):
    assert settings.name_of(setting, 0.01) == name
    if "method" in setting:
        assert settings.setting_of(settings.solver_of(setting), setting["dt"]) == setting
        assert settings.setting_of(settings.solver_of(setting), 0.01, "support")["start"] == "support"


def test_a_picture_has_our_settings_with_their_front_and_other_engines_beside_it():
    """The front goes from the cheapest to ever smaller errors."""
    found = [
        {"us": us, "group": group, "errors": {"energy": (error, 0.5 * error, 1.5 * error)}}
        for us, group, error in [(3.0, "PGS", 6.0), (1.0, "PGS", 9.0), (2.0, "NNCG", 9.5), (4.0, "PGS", 7.0),
                                 (0.5, "Box2D v3", 1.0)]
    ]  # fmt: skip
    _, ax = module.plotting.subplots()
    module.draw_plane(ax, found, "energy")
    fronts = [line for line in ax.lines if line.get_drawstyle() == "steps-post"]
    assert [line.get_xydata().tolist() for line in fronts] == [[[1.0, 9.0], [3.0, 6.0]]]
    grey = [bars[0].get_color() == module.plotting.GREY for bars in ax.containers]
    assert grey == [False, False, False, False, True]
    dotted = sorted(line.get_ydata()[0] for line in ax.lines if line.get_linestyle() == ":")
    assert dotted == sorted(most["energy"] for most in module.presets.PRESETS.values())
    assert [text.get_text() for text in ax.texts] == list(module.presets.PRESETS)


def test_errors_of_quantities_are_shares_that_are_shown_in_percent():
    trade = by_hand(rows=rows(energy=((3.0, 2.0, 4.0),) * 2, q=((0.05, 0.04, 0.06),) * 2))
    header, line, _ = trade.table()
    assert dict(zip(header, line)) == {
        "ms a step": "0.001",
        "energy": "3",
        "q": "5",
        "keeps": line[-2],
        "setting": CHEAP,
    }
    assert [module._text(name, 0.05) for name in ("q", "energy", "contacts")] == ["5 %", "0.05 %", "0.05"]


def test_the_runs_of_two_seeds_are_timed_but_for_the_references():
    assert [measurement._is_timed(by_hand(), CHEAP, i) for i in range(4)] == [True, True, False, False]
    assert not measurement._is_timed(by_hand(), module.REFERENCE, 0)


def test_copies_of_a_state_are_shifted_by_a_thousandth_of_the_slop():
    scene = dc.lattice_in_box(100, radius=(3.0, 3.0))
    one, other = (copy.bodies.position - scene.bodies.position for copy in measurement.copies(scene, [1, 2]))
    for shift in (one, other):
        assert 0.9e-3 * scene.scales.slop < np.abs(shift).max() <= 1e-3 * scene.scales.slop
    assert np.abs(one - other).max() > 1e-3 * scene.scales.slop


def test_an_earlier_trade_gives_the_runs_of_the_seeds_and_settings_that_it_shares():
    seen = {
        (name, i): (1.0, observation()) for name in (CHEAP, DEAR, module.REFERENCE, measurement.HALF) for i in range(2)
    }
    before = by_hand(observed=seen, digests=["a", "other"], settings=SETTINGS | {DEAR: SETTINGS[CHEAP]})
    assert measurement._known(by_hand(), before).keys() == {
        (name, 0) for name in (CHEAP, module.REFERENCE, measurement.HALF)
    }


def judged(**observed):
    """A trade that has judged these runs: "reference", "half" or "cheap" -> kinetic energy of each seed."""
    names = {"reference": module.REFERENCE, "half": measurement.HALF, "cheap": CHEAP}
    trade = by_hand(
        steps=241,  # in 120 intervals of two
        observed={
            (names[name], i): (2.0 * (i + 1) if name == "cheap" and i < 2 else None, observation(kinetic=energy))
            for name, runs in observed.items()
            for i, energy in enumerate(runs)
        },
    )
    measurement._judge(trade)
    return trade


def test_noise_of_fewer_runs_is_scaled_to_all_seeds():
    """The reference's half step is run for two of eight seeds: chance of eight is half as large."""
    trade = judged(reference=[1.0] * 8, half=[1.1, 1.2])
    pairs = [observation(kinetic=energy) for energy in (1.1, 1.2)], [observation()] * 2
    assert trade.seeds == 8
    assert trade.noise["energy"] == pytest.approx(0.5 * setting_runs.noise_of(*pairs)["energy"])
    assert trade.converged["energy"] == pytest.approx(15.0)


def test_a_row_has_the_mean_time_of_a_step_and_the_seeds_that_the_reference_has():
    (row,) = judged(reference=[1.0] * 2, cheap=[1.1, 1.1, 9.0]).rows
    assert (row["us"], row["seeds"]) == (pytest.approx(1e6 * 3.0 / 240), 2)
    assert row["errors"]["energy"] == pytest.approx((10.0, 10.0, 10.0))


@pytest.mark.parametrize(
    ("name", "noise", "change", "is_said"),
    [
        ("energy", 1.0, 3.9, False),  # one of four seeds is checked: chance makes twice the noise, 2 %
        ("energy", 1.0, 4.1, True),
        ("energy", 0.0, 0.9, False),  # 1 % at least
        ("energy", 0.0, 1.1, True),
        ("q", 0.0, 0.009, False),  # of a share, too
        ("q", 0.0, 0.011, True),
    ],
)
def test_a_reference_is_not_converged_where_half_its_step_changes_more_than_chance_and_1_percent(
    name, noise, change, is_said
):
    trade = by_hand(noise={name: noise}, converged={name: change}, seeds=4)
    notes = list(measurement._sentences(trade, [observation()], 1))
    assert any(note.startswith(f"the reference is not converged in {name}") for note in notes) == is_said


@pytest.mark.parametrize(("differ", "is_said"), [(0.0, False), (1e-4, False), (0.1, True), (1.9, True), (2.1, False)])
def test_an_error_is_undecided_where_chance_makes_more_than_settings_differ(differ, is_said):
    errors = (3.0, 2.0, 4.0), (3.0 + differ, 2.0, 4.0)
    trade = by_hand(noise={"energy": 2.0}, rows=rows(energy=errors))
    notes = list(measurement._sentences(trade, [observation()], 1))
    assert any("energy is undecided: seeds alone make 2 %" in note for note in notes) == is_said


@pytest.mark.parametrize(("parted_at", "text"), [(3, "one another for 0.3 s"), (0, "for 0 s"), (9, "stay together:")])
def test_copies_are_together_until_the_last_time_before_a_hundredth_of_a_radius_lies_between_them(
    parted_at, text, monkeypatch
):
    """Of two circles of 2 m one is 0.03 m off: root mean square 0.021 m."""
    states = [dc.State(name="two", world=dc.World(), bodies=make_bodies([[5, 5], [15, 5]], radius=2.0))] * 2
    shifts = iter([[0.0] * 9, [0.0] * parted_at + [0.03] * (9 - parted_at)])
    near = lambda state, shift: state.replace(bodies=make_bodies([[5, 5], [15, 5 + shift]], radius=2.0))  # noqa: E731
    monkeypatch.setattr(measurement, "states_of", lambda state, *_: [near(state, shift) for shift in next(shifts)])
    assert text in measurement._together(states, by_hand(by_preset={"fast": CHEAP}, dt=0.1, steps=9))


def test_a_run_is_timed_after_its_first_steps_until_that_took_long_enough(monkeypatch):
    """The first five steps of a run take 100 s, those that count 9, 8, 4, … ms: 21 ms are enough, the least is kept."""
    clock, took, done = [0.0], iter([0.009, 0.008, 0.004, 0.001]), []

    class Slow:
        def __init__(self, *_):
            self.steps = 0

        def advance(self, steps):
            clock[0] += next(took) if self.steps == setting_runs.WARM else 100.0
            self.steps += steps
            done.append(steps)

    monkeypatch.setattr(setting_runs, "Run", Slow)
    monkeypatch.setattr(setting_runs, "time", SimpleNamespace(thread_time=lambda: clock[0], perf_counter=None))
    scene = SimpleNamespace(bodies=SimpleNamespace(count=2))
    assert setting_runs.timed(scene, SETTINGS[CHEAP], 0.4) == pytest.approx(0.004)
    assert done == [setting_runs.WARM, 40] * 3


@pytest.mark.parametrize(("factor", "is_kept"), [(1.0, True), (1.01, False)])
def test_a_table_names_the_best_preset_that_a_setting_keeps(factor, is_kept):
    errors = {name: ((factor * most,) * 3,) * 2 for name, most in module.presets.PRESETS["accurate"].items()}
    header, *lines = by_hand(rows=rows(**errors)).table()
    assert [line[header.index("keeps")] == "accurate" for line in lines] == [is_kept] * 2
