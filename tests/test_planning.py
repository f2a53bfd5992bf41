"""Plans: what a run uses and leaves out, said as `simulate` does it, with the savings read from Figure 6.7's file."""

import pytest
from numba import config

import deep_contact as dc
from deep_contact import planning
from deep_contact.compiled import team

COLUMN, FREE = dc.column(3), dc.column(3, friction=0.0)
TANGENT, SUBSTEPS, ISLANDS = "tangent rows and spin", "substeps", "islands"


@pytest.mark.parametrize(
    ("scene", "options", "part", "used", "why"),
    [
        (COLUMN, {"solver": dc.PGS()}, TANGENT, True, "friction is 0.5"),
        (FREE, {"solver": dc.PGS()}, TANGENT, False, "friction is 0, so nothing"),
        (FREE, {"solver": dc.NNCG()}, TANGENT, False, "friction is 0, so nothing"),
        (FREE, {"solver": dc.BatchedPGS()}, TANGENT, True, "BatchedPGS has no rows without them"),
        (COLUMN, {"solver": dc.PGS()}, SUBSTEPS, False, "1 a step"),
        (COLUMN, {"solver": dc.PGS(substeps=4)}, SUBSTEPS, True, "4 a step"),
        (COLUMN, {"solver": dc.PGS(most_substeps=8)}, SUBSTEPS, True, "1 a step, up to 8 where something is about to"),
        (dc.column(5), {}, ISLANDS, False, "1 of them touch"),
        (dc.single_body(height=5.0), {}, ISLANDS, False, "0 of them touch"),
        (COLUMN, {"warm_start": "cnn"}, "network", True, "the start predicts"),
        (COLUMN, {"warm_start": None}, "network", False, "nothing is predicted"),
    ],
)
def test_parts_are_planned_as_they_are_used(scene, options, part, used, why):
    found = dc.plan(scene, **options)[part]
    assert found.used == used
    assert why in found.why


def test_a_start_with_tangents_keeps_the_rows():
    state = dc.simulate(COLUMN, steps=3).state
    contacts = state.contacts._replace(tangent_start=state.contacts.tangent_start + 1e-3)
    state = state.replace(contacts=contacts, world=dc.World(friction=0.0))
    assert "starts from tangent impulses" in dc.plan(state)[TANGENT].why


def test_options_that_are_asked_for_are_used():
    chosen = dc.plan(
        dc.column(3),
        solver=dc.PGS(islands=True, position_sweeps=0),
        warm_start=lambda state, solver: None,
        sleep=True,
    )
    used = {choice.part for choice in chosen.choices if choice.used}
    assert used == {"tangent rows and spin", "islands", "sleeping", "calls between steps"}
    default = {choice.part for choice in dc.plan(dc.column(3)).choices if choice.used}
    assert default == {"tangent rows and spin", "position correction"}


def test_a_plan_prints_every_choice_its_reason_and_its_saving():
    found = dc.plan(dc.circles_in_box(20, seed=1, friction=0.0), solver=dc.PGS(sweeps=10))
    text, table = str(found), planning.installed_results()
    assert text.startswith("circles_20: 20 circles, PGS(sweeps=10, tolerance=6e-05) from builtin\n")
    for choice in found.choices:
        assert f"{choice.part:21s}  {'used' if choice.used else 'left out'}" in text
        assert choice.why in text
        assert choice.saving in text
    saved = table["data"]["savings"]["frictionless"]
    low, middle, high = (f"{100 / saved[name]:.3g}" for name in ("high", "ratio", "low"))
    assert f"a sweep costs {middle} % ({low} to {high} %)" in text
    assert text.endswith(f"Figure 6.7, {table['provenance']['cpu']}")
    with pytest.raises(KeyError, match="expected one of tangent rows and spin, static segments, islands"):
        found["gravity"]


def test_missing_results_say_how_they_are_made(monkeypatch, tmp_path):
    monkeypatch.setattr(planning, "TABLE", tmp_path / "reference" / "figure_6_7.json")
    with pytest.raises(FileNotFoundError, match=r"reference/figure_6_7.json: expected .* run scripts/figure_6_7"):
        planning.installed_results.__wrapped__()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"solver": "PGS"}, "solver: expected options such as PGS"),
        ({"warm_start": "best"}, "warm_start: expected one of none"),
        ({"sleep": 1}, "sleep: expected True or False, got 1"),
        ({"sleep": True, "solver": dc.BatchedPGS()}, "sleep: expected False with BatchedPGS"),
    ],
)
def test_what_simulate_refuses_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        dc.plan(dc.column(2), **options)


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="one thread without the compiler")
@pytest.mark.parametrize(
    ("n_bodies", "solver", "used", "why"),
    [
        (3600, dc.BatchedPGS(), True, "2 for 3,600 circles, one for every 1,500, and 4 cores"),
        (900, dc.BatchedPGS(), False, "1 for 900 circles, one for every 1,500, and 4 cores"),
        (3600, dc.BatchedPGS(threads=1), False, "threads=1 was asked for"),
        (3600, dc.PGS(), False, "PGS sweeps contact by contact"),
    ],
)
def test_threads_are_planned_as_they_are_taken(n_bodies, solver, used, why, monkeypatch):
    for module in (team, planning):
        monkeypatch.setattr(module, "cores", lambda: 4)
    monkeypatch.setattr(config, "NUMBA_NUM_THREADS", 4)
    found = dc.plan(dc.lattice_in_box(n_bodies), solver=solver)["threads"]
    assert found.used == used
    assert why in found.why
