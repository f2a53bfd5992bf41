"""Starts: their impulses, and the sweeps that they save."""

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import load_script, run_python

import deep_contact as dc
from deep_contact.analysis.lcp import contact_problem
from deep_contact.plot import plotting
from deep_contact.sph.start import Copy, Sph
from deep_contact.starts.classical import Builtin, Scaled
from deep_contact.starts.names import warm_start_of
from deep_contact.studies import starts


def mean_sweeps(states, start):
    solver = dc.PGS(sweeps=3000, tolerance=6e-5)
    return np.mean([dc.solve_contacts(state, solver=solver, start=start).record.sweeps for state in states])


def test_better_starts_need_fewer_sweeps(falling_states):
    sweeps = {name: mean_sweeps(falling_states, name) for name in ("none", "builtin", "copy")}
    assert sweeps["copy"] < 0.5 * sweeps["builtin"] < 0.5 * sweeps["none"]


def test_starts_are_compared_by_their_names(falling_states):
    found = starts.paired(falling_states[:3], ["none", "builtin"], sweeps=20)
    same = starts.paired(falling_states[:3], {"none": None, "builtin": Builtin()}, sweeps=20)
    assert list(found) == ["none", "builtin"]
    for name, one in same.items():
        np.testing.assert_array_equal(found[name]["theta"], one["theta"])


def test_copy_solves_a_state_that_is_not_solved(falling_states):
    solver, solved = dc.PGS(sweeps=200, tolerance=None), falling_states[5]
    np.testing.assert_array_equal(Copy()(solved, solver)[0], solved.contacts.normal_impulse)
    expected = dc.solve_contacts(solved, solver=solver, start="builtin")
    np.testing.assert_array_equal(Copy()(solved.replace(solved=False), solver)[0], expected.normal_impulses)


@pytest.mark.parametrize("index", [1, 3, 5, 9])
def test_scaled_is_the_least_energy_along_builtin(falling_states, index):
    # Energy ½ λ·A λ + b·λ by dense matrices (Eq 2.27); its minimum on the line is at −b·λ / λ·A λ.
    state = falling_states[index]
    state = state.replace(world=replace(state.world, restitution=0.3))
    problem = contact_problem(state)
    builtin = np.column_stack(Builtin()(state, None)).ravel()
    share = np.clip(-(problem.b @ builtin) / (builtin @ (problem.A.toarray() @ builtin)), 0.0, 1.0)
    np.testing.assert_allclose(np.column_stack(Scaled()(state, None)).ravel(), share * builtin, rtol=1e-12)


def test_scaled_is_all_of_builtin_at_rest_and_nothing_of_what_pulls(falling_states):
    column = dc.simulate(dc.column(5), steps=200).state
    np.testing.assert_allclose(Scaled()(column, None)[0], Builtin()(column, None)[0], rtol=1e-4)
    # All circles part quickly: any push adds energy.
    apart = column.bodies._replace(velocity=np.outer(np.arange(5.0), [0.0, 10.0]))
    assert not Scaled()(column.replace(bodies=apart), None)[0].any()


@pytest.mark.parametrize(
    ("name", "label", "lost"),
    [
        ("sph", "SPH, bilinear", (0.2, 0.8)),
        ("sph spline", "SPH, spline", (0.1, 0.7)),
        ("sph consistent", "SPH, consistent", (0.0, 1e-3)),
    ],
)
def test_a_name_means_one_way_through_the_grid(name, label, lost, falling_states):
    """Algorithm 4 reads half of an impulse back, the authors' spline more, the consistent transfer all (Figure 6.3)."""
    start, transfer = warm_start_of(name), {"sph": "thesis"}.get(name, name.removeprefix("sph "))
    assert start == Sph(spacing=0.5, transfer=transfer)
    assert lost[0] <= load_script("figure_6_3").transfer_loss(falling_states, start) <= lost[1]
    assert plotting.style_of(name)["label"] == label
    assert starts.CHOSEN.get(name, {"transfer": "consistent"})["transfer"] == transfer


FROM_ROWS = ("scaled", "support", "far field", "far field, no past")
BUILT = """
import json, sys
import numpy as np
import deep_contact as dc
from deep_contact.cnn.inference import FarFieldModel
from deep_contact.solvers import batches; from deep_contact.stepping import rows

def counted(masses):
    return lambda *given: built.append(1) or masses(*given)

for module, name in (batches, "fill_rows"), (rows, "row_masses"):
    setattr(module, name, counted(getattr(module, name)))
FarFieldModel.run = lambda model, image: np.zeros(model._output_shape(image.shape), np.float32)
found = {}
for kind, solver in ("PGS", dc.PGS), ("BatchedPGS", dc.BatchedPGS):
    for start in sys.argv[1:]:
        built, solver_of = [], lambda: solver(sweeps=2, tolerance=None)
        run = dc.simulate(dc.lattice_in_box(6, gap=0.01), steps=12, solver=solver_of(), warm_start=start)
        found[f"{kind}, {start}: run"] = len(built), int(run.relaxations.sum()) // 2
        built.clear()
        dc.solve_contacts(run.state, solver=solver_of(), start=start)
        found[f"{kind}, {start}: solve"] = len(built), run.state.contacts.count
print(json.dumps(found))
"""


def test_rows_are_built_once_a_step():
    # Without the compiler, whose calls cannot be counted: a row asks for its effective mass, but in tiles,
    # which take those that a start has built.
    found = json.loads(run_python("-c", BUILT, *FROM_ROWS, environment={"NUMBA_DISABLE_JIT": "1"}).stdout)
    assert len(found) == 4 * len(FROM_ROWS)
    for name, (built, contacts) in found.items():
        assert built == contacts > 0, name


def test_all_starts_reach_the_same_velocities_without_friction(frictionless_states):
    # λ need not be unique, velocities are: the problem is a convex one. (With Coulomb friction even they need not be.)
    state = frictionless_states[-1]
    solver = dc.PGS(sweeps=200_000, tolerance=1e-13)
    expected = dc.solve_contacts(state, solver=solver, start="copy").velocities
    any_start = np.random.default_rng(1).uniform(0.0, 100.0, (2, state.contacts.count))
    for start in ("none", "sph", tuple(any_start)):
        np.testing.assert_allclose(dc.solve_contacts(state, solver=solver, start=start).velocities, expected, atol=1e-9)
