"""Plans: they say what a run uses and leaves out, as `simulate` then does."""

from dataclasses import replace

import pytest

import deep_contact as dc
from deep_contact.accuracy.stiffness import Stiffness
from deep_contact.run import planning

COLUMN, FREE = dc.column(3), dc.column(3, friction=0.0)
pytestmark = pytest.mark.filterwarnings("ignore:.*solved to a tolerance")
TANGENT, SUBSTEPS, ISLANDS = "tangent rows and spin", "substeps", "islands"


@pytest.mark.parametrize(
    ("scene", "options", "part", "used"),
    [
        (FREE, {"solver": dc.NNCG()}, TANGENT, False),
        (FREE, {"solver": dc.BatchedPGS()}, TANGENT, True),
        (COLUMN, {"solver": dc.PGS(substeps=4)}, SUBSTEPS, True),
        (COLUMN, {"solver": dc.PGS(most_substeps=8)}, SUBSTEPS, True),
        (dc.column(5), {}, ISLANDS, False),
        (COLUMN, {"solver": dc.PGS(islands=True)}, ISLANDS, True),
        (COLUMN, {"sleep": True}, "sleeping", True),
        (COLUMN, {"warm_start": lambda state, solver: None}, "calls between steps", True),
        (COLUMN, {}, "calls between steps", False),
        (COLUMN, {}, "position correction", True),
        (COLUMN, {"solver": dc.PGS(position_sweeps=0)}, "position correction", False),
        (COLUMN, {"warm_start": "far field"}, "network", True),
        (COLUMN, {"warm_start": "far field, no past"}, "network", True),
        (COLUMN, {"warm_start": dc.warm_start.Cnn()}, "network", True),
        (COLUMN, {"warm_start": "support"}, "network", False),
    ],
)
def test_parts_are_planned_as_they_are_used(scene, options, part, used):
    assert dc.plan(scene, **options)[part].used == used


def test_a_start_with_tangents_keeps_the_rows():
    state = dc.simulate(COLUMN, steps=3).state
    contacts = state.contacts._replace(tangent_start=state.contacts.tangent_start + 1e-3)
    state = state.replace(contacts=contacts, world=dc.World(friction=0.0))
    assert dc.plan(state)[TANGENT] == (True, "friction is 0, but the state starts from tangent impulses")
    assert dc.plan(FREE, solver=dc.BatchedPGS(sweeps=3))[TANGENT].why.startswith(
        "friction is 0, but BatchedPGS(sweeps=3"
    )
    assert dc.plan(FREE, solver=dc.PGS())[TANGENT] == (False, "friction is 0")
    assert dc.plan(dc.column(3, friction=0.25), solver=dc.PGS())[TANGENT] == (True, "friction is 0.25")
    table = dc.column(3, friction=[[0.0, 0.4], [0.4, 0.0]], wall_materials=[1] * 4)
    assert dc.plan(table, solver=dc.PGS())[TANGENT] == (True, "friction is 0 to 0.4")
    absent = dc.column(3, friction=[[0.0, 0.4], [0.4, 0.0]])
    assert dc.plan(absent, solver=dc.PGS())[TANGENT] == (False, "friction is 0")


def test_reasons_are_those_of_the_options():
    touching = dc.find_contacts(dc.column(3))
    plan = dc.plan(touching, solver=dc.PGS(islands=True, position_sweeps=7), sleep=True, warm_start="support")
    assert plan[ISLANDS] == (True, "asked for; 1 of them touch something now")
    assert plan["sleeping"] == (True, "asked for")
    assert plan["position correction"] == (True, "at most 7 sweeps, none where nothing is deep")
    assert plan["calls between steps"] == (True, "every step calls the start")
    assert plan["network"] == (False, "the start is Support")
    other = dc.plan(dc.single_body(height=9.0), solver=dc.NNCG(), warm_start=None)
    assert other[ISLANDS] == (False, "not asked for; 0 of them touch something now")
    assert other["sleeping"] == (False, "not asked for")
    assert other["calls between steps"] == (False, "no step calls the start")
    assert not other["batches of contacts"].used
    assert other.warm_start == "none"
    assert (plan.scene, plan.n_bodies, plan.us) == ("column_3", 3, None)
    assert dc.plan(touching, accuracy="fast").us > 0


def test_a_plan_prints_a_line_a_part():
    found = dc.plan(dc.circles_in_box(20, seed=1, friction=0.0), solver=dc.PGS(sweeps=10))
    title, tangents, *_ = str(found).splitlines()
    assert title == "circles_20: 20 circles, PGS(sweeps=10, tolerance=6e-05) from builtin"
    assert tangents.split() == [*TANGENT.split(), "left", "out", "friction", "is", "0"]
    with pytest.raises(ValueError, match="part: expected one of tangent rows and spin, segments, islands"):
        found["gravity"]


@pytest.mark.parametrize(
    ("scene", "options"),
    [
        (COLUMN, {}),
        (COLUMN, {"solver": dc.NNCG(sweeps=9)}),
        (FREE, {}),
        (dc.column(60), {}),
        (dc.lattice_in_box(100), {"accuracy": "reference"}),
        (dc.lattice_in_box(100), {"sleep": True}),
    ],
    ids=str,
)
def test_a_plan_has_the_solver_of_the_run(scene, options):
    chosen, run = dc.plan(scene, **options), dc.simulate(scene, steps=1, **options)
    assert chosen.solver == run.state.solver
    assert (chosen.us is None) == ("solver" in options)
    assert chosen[SUBSTEPS].used == (run.state.solver.substeps > 1 or run.state.solver.most_substeps is not None)


HEAP = Stiffness("a heap", None, 8)
COLUMN_OF_200 = Stiffness("a column", 1e-3)


@pytest.mark.parametrize(
    ("stiff", "solver", "used", "why"),
    [
        (None, dc.PGS(), False, "nothing is too stiff for a few sweeps"),
        (None, dc.NNCG(sweeps=5000, tolerance=1e-9), True, "nothing is too stiff for a few sweeps"),
        (COLUMN_OF_200, dc.NNCG(sweeps=5000, tolerance=1e-9), True, "a column"),
        (COLUMN_OF_200, dc.NNCG(sweeps=4999, tolerance=1e-9), False, "a column, but NNCG"),
        (COLUMN_OF_200, dc.NNCG(sweeps=5000, tolerance=None), False, "a column, but NNCG"),
        (HEAP, dc.PGS(sweeps=8, tolerance=None, substeps=8), True, "a heap"),
        (HEAP, dc.PGS(sweeps=8, tolerance=None, substeps=7), False, "a heap, but PGS"),
    ],
)
def test_stiff_piles_are_solved_by_many_sweeps_to_a_tolerance_and_heaps_in_substeps(stiff, solver, used, why):
    choice = planning._stiffness(stiff, solver)
    assert choice.used == used
    assert choice.why.startswith(why)
    assert ("was asked for" in choice.why) == ("but" in why)


@pytest.mark.parametrize(("least", "most", "text"), [(1, None, "1 a step"), (2, 2, "2 a step"), (2, 8, "up to 8")])
def test_substeps_are_planned_by_their_least_and_most_number(least, most, text):
    choice = dc.plan(COLUMN, solver=dc.PGS(substeps=least, most_substeps=most))[SUBSTEPS]
    assert choice.used == (least > 1)
    assert text in choice.why
    assert ("up to" in choice.why) == (most == 8)


def test_segments_and_belts_are_counted():
    segments = [((1.0, 5.0), (4.0, 5.0)), ((5.0, 5.0), (8.0, 5.0))]
    world = replace(COLUMN.world, segments=segments, surface_speeds=[0.0, 2.0])
    choice = dc.plan(COLUMN.replace(world=world))["segments"]
    assert choice == (True, "the world has 2, 1 have a surface that moves")
    assert dc.plan(COLUMN)["segments"] == (False, "the world has none")
    moving = replace(world, segment_velocities=[((0.0, 0.0), (3.0, 0.0)), ((0.0, 0.0), (0.0, 0.0))])
    choice = dc.plan(COLUMN.replace(world=moving), solver=dc.PGS())["segments"]
    assert choice == (True, "the world has 2, 1 of them move, 1 have a surface that moves")
    both = replace(moving, surface_speeds=(), segment_velocities=[((1.0, 1.0), (3.0, 2.0)), ((0.0, 0.0), (0.0, -1.0))])
    assert dc.plan(COLUMN.replace(world=both), solver=dc.PGS())["segments"] == (True, "the world has 2, 2 of them move")
