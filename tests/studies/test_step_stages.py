"""The step that times its stages is the step."""

import platform

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.physics import engine
from deep_contact.physics.solvers import batched
from deep_contact.physics.step import StepWorkspace, make_log
from deep_contact.state import Bodies, Contacts
from deep_contact.studies import step_stages

pytestmark = pytest.mark.skipif(platform.machine() != "x86_64", reason="cycles cannot be read")


@pytest.mark.parametrize(
    ("advance", "solver", "pairs", "rows", "sweeps"),
    [(engine.advance, dc.PGS(sweeps=30, tolerance=None), "write_pairs", "contact_rows", "relax"),
     (batched.advance_together, dc.BatchedPGS(sweeps=30, tolerance=None), "write_near_pairs", "write_blocks",
      "relax_tiles")],
)  # fmt: skip
def test_the_timed_step_computes_the_same_bits_and_its_stages_add_up(advance, solver, pairs, rows, sweeps):
    state = dc.simulate(dc.lattice_in_box(150, seed=2), steps=200, solver=dc.PGS(sweeps=10)).state
    timed = step_stages.timed_step(advance)
    found = []
    for function in (engine.advance_of(solver)[0], timed[0]):
        copied = state.replace(
            bodies=Bodies(*(field.copy() for field in state.bodies)),
            contacts=Contacts(*(field.copy() for field in state.contacts)),
        )
        problem, options = engine.step_problem(copied, solver), engine.advance_of(solver)[1]
        workspace = StepWorkspace(problem.solver_bodies, np.empty(30), np.empty(0))
        function(engine.step_input(copied, options.settings), options, workspace, make_log(20))
        found.append(copied.bodies)
    assert found[0] == found[1]
    assert found[0] != state.bodies

    cost = step_stages.measure(state, solver, timed, steps=20, repeats=3)
    assert cost["ns"] == pytest.approx(sum(stage["ns"] for stage in cost["stages"].values()))
    assert 0.1 * cost["run_ns"] < cost["ns"] <= 1.0001 * cost["run_ns"]
    assert set(cost["stages"]) <= set(step_stages.STAGES)
    assert {pairs, "write_geometry", "carry_impulses", rows, sweeps} <= set(cost["stages"])
    # Thirty sweeps are most of a step.
    assert cost["stages"][sweeps]["ns"] == max(stage["ns"] for stage in cost["stages"].values())
    assert cost["sweeps"] == 30
