"""Plans: what a run uses and leaves out, said as `simulate` does it."""

import pytest

import deep_contact as dc

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
        (COLUMN, {"warm_start": "cnn"}, "network", True),
        (COLUMN, {"warm_start": "learned support"}, "network", True),
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
    assert dc.plan(state)[TANGENT].used


def test_a_plan_prints_a_line_a_part():
    found = dc.plan(dc.circles_in_box(20, seed=1, friction=0.0), solver=dc.PGS(sweeps=10))
    title, tangents, *_ = str(found).splitlines()
    assert title == "circles_20: 20 circles, PGS(sweeps=10, tolerance=6e-05) from builtin"
    assert tangents.split() == [*TANGENT.split(), "left", "out", "friction", "is", "0"]
    with pytest.raises(ValueError, match="part: expected one of tangent rows and spin, static segments, islands"):
        found["gravity"]


@pytest.mark.parametrize("options", [{}, {"accuracy": "reference"}, {"solver": dc.NNCG(sweeps=9)}, {"sleep": True}])
@pytest.mark.parametrize("scene", [COLUMN, FREE, dc.column(60), dc.lattice_in_box(100)], ids=str)
def test_a_plan_has_the_solver_of_the_run(scene, options):
    chosen, run = dc.plan(scene, **options), dc.simulate(scene, steps=1, **options)
    assert chosen.solver == run.state.solver
    assert (chosen.us is None) == ("solver" in options)
    assert chosen[SUBSTEPS].used == (run.state.solver.substeps > 1 or run.state.solver.most_substeps is not None)
