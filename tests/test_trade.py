"""The trade on a scene of one's own: errors of known answers, budgets, what goes wrong, and what is chosen."""

import math

import numpy as np
import pytest

import deep_contact as dc
from deep_contact import trade as module
from deep_contact.__main__ import main
from deep_contact.constants import WALL_SKIN
from deep_contact.state.checks import make_bodies

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
    assert again.choose("fast") == solver
    assert "copies of the state stay" in str(trade)
    assert len(trade.plot().axes) == 3
    with pytest.raises(ValueError, match=r"tolerances: expected one of .*top spread, got 'bottom'"):
        trade.choose(bottom=0.1)
    with pytest.raises(ValueError, match=r"Δt = 0\.01 s, as measured, got 0\.02"):
        dc.simulate(scene.replace(dt=0.02, contacts=None), steps=1, accuracy=trade)


def test_it_goes_on_where_it_was_interrupted(pile, monkeypatch):
    scene, whole = pile
    real, calls = module._task, []

    def interrupted(task):
        calls.append(task)
        if len(calls) == 20:
            raise KeyboardInterrupt
        return real(task)

    options = {"steps": 40, "seeds": 3, "quantities": {"top": lambda s: s.bodies.position[:, 1].max()}}
    monkeypatch.setattr(module, "_task", interrupted)
    part = dc.measure_trade(scene, **options)
    assert part.seeds == 2
    assert "interrupted: this is what was known then" in part.notes
    rest = dc.measure_trade(scene, **options, before=part)
    assert len(calls) == 20 + len(whole.observed) - len(part.observed)
    assert [row["errors"] for row in rest.rows] == [row["errors"] for row in whole.rows]
    with pytest.raises(ValueError, match="before: expected steps 50, got 40"):
        dc.measure_trade(scene, **options | {"steps": 50}, before=part)


@pytest.mark.filterwarnings("ignore:minutes. the least")  # of a busy machine
def test_a_budget_leaves_seeds_and_settings_out(pile):
    scene, whole = pile
    seconds = 0.5 * whole.predicted_s
    trade = dc.measure_trade(scene, steps=40, seeds=12, minutes=seconds / 60)
    assert trade.seeds < 12
    assert any("within" in note for note in trade.notes)


def raises(state):
    raise RuntimeError("boom")


@pytest.mark.parametrize(
    ("quantity", "sentence"),
    [
        (raises, "a number or an array, got RuntimeError: boom"),
        (lambda state: math.nan, "finite numbers, got nan"),
        (lambda state: np.zeros(state.step), "the shape that it had before, (1,), got (2,)"),
    ],
)
def test_a_quantity_that_fails_is_a_sentence_and_nothing_is_lost(quantity, sentence):
    trade = dc.measure_trade(lambda seed: dc.single_body(), steps=20, seeds=1, quantities={"q": quantity})
    assert sentence in str(trade)
    assert trade.rows[0]["errors"]["q"] is None
    assert trade.rows[0]["errors"]["penetration"]


def test_a_setting_that_diverges_is_a_sentence_and_nothing_is_lost(monkeypatch):
    real = module.simulate

    def simulate(state, *, solver, **options):
        if isinstance(solver, dc.NNCG):
            raise FloatingPointError("up to step 1: the solver diverged")
        return real(state, solver=solver, **options)

    monkeypatch.setattr(module, "simulate", simulate)
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
    words = ["--scene", "hopper", "--bodies", "20", "--steps", "20", "--seeds", "1", "--out", str(out)]
    assert main(["trade", *words]) == 0
    assert capsys.readouterr().out.startswith("hopper_20: 20 circles, 20 steps of 0.01 s, 1 seed")
    assert dc.load_trade(out).n_bodies == 20
    assert "dc.measure_trade(scene) measures it on this scene" in str(dc.recommend(dc.lattice_in_box(40, friction=0.9)))
