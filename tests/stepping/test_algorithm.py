"""Steps and runs: free fall, rest, position correction, determinism, resuming."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT, assert_same_bits, circles_at

import deep_contact as dc
from deep_contact.solvers import METHODS
from deep_contact.state.constants import MAX_ROTATION, WALL_SKIN
from deep_contact.state.fields import is_unit
from deep_contact.stepping.prepare import is_valid


def assert_same_run(first: dc.State, second: dc.State):
    assert (first.time, first.step, first.dt, first.world) == (second.time, second.step, second.dt, second.world)
    assert_same_bits(first, second)


def test_free_fall_is_symplectic_euler():
    k, dt, g = 40, 0.01, 9.81
    state = dc.simulate(dc.single_body(height=20.0), steps=k, dt=dt, solver=dc.PGS()).state
    np.testing.assert_allclose(state.bodies.velocity, [[0, -k * dt * g]], rtol=1e-13)
    np.testing.assert_allclose(state.bodies.position[0, 1], WALL_SKIN + 21 - g * dt**2 * k * (k + 1) / 2, rtol=1e-13)
    assert (state.step, state.time) == (k, k * dt)


def test_unequal_masses_are_pushed_apart_by_inverse_mass():
    state = circles_at([[10.0, 10.0], [11.9, 10.0]], mass=[1.0, 3.0], gravity=(0, 0))
    moved = dc.step(state).bodies.position - state.bodies.position
    np.testing.assert_allclose(moved[0, 0], -3 * moved[1, 0], rtol=1e-9)


def test_a_body_moves_at_most_two_metres_a_step_with_the_scales_of_box2d():
    scene = dc.single_body(height=10.0)
    scene = scene.replace(bodies=scene.bodies._replace(velocity=np.array([[-1e5, 0.0]]), spin=np.array([1e5])))
    scene = scene.replace(world=replace(scene.world, scales=dc.BOX2D))
    bodies = dc.step(scene, solver=dc.PGS()).bodies
    np.testing.assert_allclose(np.hypot(*(bodies.position - scene.bodies.position)[0]), dc.BOX2D.max_translation)
    np.testing.assert_allclose(bodies.angle[0], MAX_ROTATION)


@pytest.mark.parametrize("solver", [dc.PGS(), dc.BatchedPGS()])
def test_a_circle_of_a_centimetre_falls_and_turns_as_fast_as_any(solver):
    """v = g t: rapier's own test; 2 mean radii a step would be 2 m/s."""
    world = dc.World(box=(-10.0, -10.0, 10.0, 10.0), friction=0.0)
    circle = dc.make_bodies([[0.0, 9.0]], radius=0.01, spin=500.0)
    bodies = dc.simulate(dc.State(name="fall", world=world, bodies=circle), steps=100, solver=solver).state.bodies
    np.testing.assert_allclose(bodies.velocity, [[0.0, -9.81]], rtol=1e-12)
    np.testing.assert_allclose(bodies.spin, [500.0], rtol=1e-12)


@pytest.mark.parametrize("accuracy", ["preview", "fast", "balanced", "accurate", "reference"])
@pytest.mark.parametrize("overlap", [0.0, 1e-9])
def test_a_pyramid_that_touches_exactly_stands(accuracy, overlap):
    d, rows = 1.0 - overlap, 5
    places = [[20 + (2 * i + k) * d, 1.01 + k * 3**0.5 * d] for k in range(rows) for i in range(rows - k)]
    scene = dc.State(name="pyramid", world=dc.World(friction=1.0), bodies=dc.make_bodies(places))  # needs μ = 0.4975
    top = dc.simulate(scene, steps=300, accuracy=accuracy).state.bodies.position[-1]
    np.testing.assert_allclose(top, places[-1], atol=0.01)


LOOSE = dc.PGS(sweeps=40, tolerance=1e-3, position_sweeps=4)
RESUMED = [(method(sweeps=25), "builtin", False) for method in METHODS.values() if method is not dc.NesterovPGS]
RESUMED += [pytest.param(dc.NesterovPGS(sweeps=25), "builtin", False, marks=pytest.mark.slow)]
RESUMED += [(LOOSE, start, solved) for start in (None, "builtin") for solved in (True, False)]
RESUMED += [(dc.PGS(sweeps=4, tolerance=None, substeps=8), start, False) for start in ("builtin", "sph")]


@pytest.mark.parametrize(("solver", "warm_start", "solved"), RESUMED, ids=str)
def test_resumed_from_xml_as_if_never_stopped(tmp_path, solver, warm_start, solved):
    scene = dc.circles_in_box(40, radius=(0.5, 1.5), restitution=0.3, seed=10)
    options = {"warm_start": warm_start, "solver": solver, "dt": 0.008}
    through = dc.simulate(scene, steps=150, **options).state
    kept = {}
    stopped = dc.simulate(scene, steps=101, on_step=lambda s, r: kept.update({s.step: s}), **options).state
    dc.write_state(tmp_path / "stop.xml", kept[100] if solved else stopped)
    state = dc.read_state(tmp_path / "stop.xml")
    assert state.solver == stopped.solver
    resumed = dc.simulate(state, steps=150 - state.step, warm_start=warm_start).state
    assert_same_run(resumed, through)


@pytest.mark.parametrize("path", sorted((ROOT / "data" / "sample").glob("*.xml.gz")), ids=lambda path: path.name)
def test_the_shipped_states_are_solved_as_they_were(path):
    state = dc.read_state(path)
    found, size = dc.solve_contacts(state), state.contacts.normal_impulse.max()
    np.testing.assert_allclose(found.normal_impulses, state.contacts.normal_impulse, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(found.tangent_impulses, state.contacts.tangent_impulse, rtol=0, atol=1e-9 * size)


def test_a_state_of_the_engine_passes_the_quick_check():
    """The slow check would accept it, too, but costs more than a step."""
    state = dc.simulate(dc.circles_in_box(30, seed=1), steps=160, solver=dc.PGS(sweeps=20)).state
    assert is_valid(state.bodies, state.contacts)
    bodies, contacts = state.bodies, state.contacts
    for change in ({"velocity": bodies.velocity[:-1]}, {"mass": 0 * bodies.mass}, {"angle": bodies.angle + np.nan}):
        assert not is_valid(bodies._replace(**change), contacts)
    m = contacts.count
    for name, value in (("normal_impulse", -1.0), ("tangent_start", np.inf), ("separation", np.nan), ("body_b", 2**40)):
        spoiled = np.full(m, value, getattr(contacts, name).dtype)
        assert not is_valid(bodies, contacts._replace(**{name: spoiled}))
    for length in (0.9998, 0.99991, 1.00009, 1.0002, 2.0):  # by the same rule as the slow one
        stretched = contacts._replace(normal=length * contacts.normal)
        assert is_valid(bodies, stretched) == is_unit(stretched.normal).all() == (abs(length - 1) < 1e-4)
