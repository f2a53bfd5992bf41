"""Rolling resistance, a torque of up to ρ λ_n against the difference of two spins: closed forms and invariants.

A disc that rolls on a floor: m a = f and I a / r = ρ N − f r, so that a = ρ g / (1.5 r) (I = m r² / 2), and it stops
after v² / (2 a) = 3 v² r / (4 ρ g).
"""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from conftest import assert_same_bits, circles_at

import deep_contact as dc
from deep_contact.accuracy.presets import PRESETS, recommend
from deep_contact.solvers import METHODS
from deep_contact.starts.names import STARTS
from deep_contact.stepping.interface import entry_of
from deep_contact.studies.hard_scenes import mechanical_energy

if not numba.config.DISABLE_JIT:
    pytestmark = pytest.mark.slow  # a dozen kinds of steps to compile; test_without_compiler.py runs them interpreted

G = 9.81
FEW = {"sweeps": 25, "tolerance": None}
SOLVERS = [dc.PGS(**FEW), dc.PGS(islands=True), dc.PSOR(**FEW), dc.BatchedPGS(**FEW), dc.PGS(**FEW, substeps=2)]
TWO = [dc.PGS(**FEW), dc.BatchedPGS(**FEW)]
ROLLS = {"PGS", "PSOR", "BatchedPGS"}
SKIN = 0.01
"""Distance of a wall at which a circle of 1 m touches it, m; a circle at rest overlaps it by half a slop."""


def rolling_disc(speed, radius=1.0, slope=0.0, **world):
    """A disc that rolls without slip on the floor, which `slope` inclines. It moves with v = ω l, l its arm."""
    arm = radius - 0.5 * 0.0025 * radius
    gravity = (G * math.sin(slope), -G * math.cos(slope))
    box, place = (0.0, 0.0, 400.0 * radius, 20.0 * radius), [9.0 * radius, (1.0 + SKIN - 0.0025) * radius]
    return circles_at(
        [place], radius=radius, velocity=[[speed, 0.0]], spin=-speed / arm, gravity=gravity, box=box,
        **{"friction": 0.8} | world, dt=0.01 * math.sqrt(radius),
    )  # fmt: skip


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("radius", "rho"), [(1.0, 0.1), (0.25, 0.02)])
def test_a_rolling_disc_stops_where_the_torque_has_taken_its_energy(solver, radius, rho):
    speed = 1.5 * math.sqrt(radius)
    state = rolling_disc(speed, radius, rolling_friction=rho)
    time = speed * 1.5 * radius / (rho * G)
    end = dc.simulate(state, steps=math.ceil(1.2 * time / state.dt), solver=solver).state.bodies
    way = end.position[0, 0] - state.bodies.position[0, 0]
    assert way == pytest.approx(3.0 * speed**2 * radius / (4.0 * rho * G), rel=0.01)
    assert np.abs(end.velocity).max() < 1e-6 * speed
    assert np.abs(end.spin).max() < 1e-6 * speed / radius


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_disc_sticks_on_an_incline_below_rho_over_r_and_rolls_above(solver):
    rho, radius = 0.05, 0.5
    for share in (0.95, 1.05):
        slope = math.atan(share * rho / radius)
        state = rolling_disc(0.0, radius, slope, rolling_friction=rho)
        end = dc.simulate(state, steps=200, solver=solver).state
        arm = 0.99875 * radius  # a (1 + r² / (2 l²)) = g (sin θ − ρ cos θ / l)
        downhill = G * (math.sin(slope) - rho / arm * math.cos(slope)) / (1.0 + 0.5 * (radius / arm) ** 2)
        assert end.bodies.velocity[0, 0] == pytest.approx(max(0.0, downhill) * end.time, rel=1e-3, abs=1e-8)


def test_each_pair_has_its_own_rolling_resistance():
    table = [[0.0, 0.0, 0.02], [0.0, 0.0, 0.08], [0.02, 0.08, 0.0]]
    state = rolling_disc(2.0, rolling_friction=table, friction=np.full((3, 3), 0.8) - 0.1 * np.eye(3))
    position = state.bodies.position + np.array([[0.0, 0.0], [150.0, 0.0]])
    bodies = dc.make_bodies(
        position, velocity=[2.0, 0.0], spin=state.bodies.spin[0], material=[0, 1],
    )  # fmt: skip
    world = replace(state.world, wall_materials=(2, 0, 0, 0))
    end = dc.simulate(state.replace(bodies=bodies, world=world), steps=100, solver=dc.PGS(**FEW)).state.bodies
    np.testing.assert_allclose(2.0 - end.velocity[:, 0], np.array([0.02, 0.08]) * G / 1.5, rtol=0.02)


@pytest.mark.parametrize("solver", SOLVERS)
def test_two_discs_that_meet_keep_their_angular_momentum(solver):
    """The torque on one is minus the torque on the other. Without walls and gravity nothing else acts."""
    state = circles_at(
        [[10.0, 10.0], [11.2, 11.1]], radius=[1.0, 0.7], velocity=[[3.0, 1.0], [-1.0, -2.0]], spin=[4.0, -9.0],
        gravity=(0.0, 0.0), box=(0.0, 0.0, 40.0, 40.0), friction=0.3, rolling_friction=0.2,
    )  # fmt: skip

    def angular(bodies):
        (x, y), (v_x, v_y) = bodies.position.T, bodies.velocity.T
        return bodies.mass @ (x * v_y - y * v_x) + bodies.inertia @ bodies.spin

    solution = dc.solve_contacts(state, solver=solver)
    turned = state.bodies._replace(velocity=solution.velocities, spin=solution.angular_velocities)
    smooth = replace(state.world, rolling_friction=0.0)
    other = dc.solve_contacts(state.replace(world=smooth), solver=solver).angular_velocities
    assert np.abs(solution.angular_velocities - other).max() > 0.1
    arm = 1e-2 * abs(angular(state.bodies))  # contact point and arms differ by half of the overlap
    assert angular(turned) == pytest.approx(angular(state.bodies), abs=arm)


@pytest.mark.parametrize("solver", [*TWO, dc.PGS(**FEW, substeps=2)])
@pytest.mark.parametrize("roller_first", [True, False])
def test_a_roller_that_turns_a_smooth_disc_works_by_its_torque(solver, roller_first):
    """The disc gets the torque ρ N from the roller, and the roller works at ρ N Ω. Contacts take ρ N (Ω − ω)."""
    rho, force, turns, steps = 0.1, 50.0, 20.0, 40
    order = [0, 1] if roller_first else [1, 0]
    columns = [np.array(values)[order] for values in ([[20.0, 20.0], [20.0, 21.9975]], [turns, 0.0], [True, False])]
    state = circles_at(
        columns[0], spin=columns[1], fixed=columns[2], mass=np.where(columns[2], 1.0, 2.0), friction=0.0,
        rolling_friction=rho, gravity=(0.0, 0.0), box=(0.0, 0.0, 40.0, 40.0),
    )  # fmt: skip
    push = np.where(columns[2][:, None], 0.0, [[0.0, -force]])
    run = dc.simulate(state, steps=steps, solver=solver, push=push, record=1)
    time, disc = run.trajectory.times, order.index(1)
    spin = rho * force * time / 1.0  # I = m r² / 2 = 1 kg·m²
    assert spin[-1] < 0.5 * turns
    np.testing.assert_allclose(run.trajectory.spins[:, disc], spin, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.trajectory.work, rho * force * turns * time, rtol=0, atol=1e-9)
    taken = np.diff(rho * force * turns * time - 0.5 * spin**2)
    np.testing.assert_allclose(run.trajectory.dissipated, taken, rtol=0, atol=1e-9)


@pytest.mark.parametrize("solver", TWO)
@pytest.mark.parametrize("seed", range(2))
def test_rolling_resistance_makes_no_energy(solver, seed):
    rng = np.random.default_rng(seed)
    scene = dc.lattice_in_box(30, gap=0.05, radius=(0.6, 1.0), seed=seed, restitution=0.8 * seed)
    bodies = scene.bodies._replace(spin=rng.normal(0, 5, 30), velocity=rng.normal(0, 3, (30, 2)))
    scene = scene.replace(bodies=bodies, world=replace(scene.world, rolling_friction=0.1))
    run = dc.simulate(scene, steps=200, record=5, solver=solver)
    energy = [mechanical_energy(state, state.bodies) for state in run.trajectory]
    assert max(energy) < 1.002 * energy[0]


@pytest.mark.parametrize("solver", [dc.PGS(**FEW), dc.BatchedPGS(**FEW), dc.PSOR(**FEW, substeps=2)])
def test_bits_do_not_depend_on_parts_files_and_neighbours(solver, tmp_path):
    scene = dc.lattice_in_box(30, gap=0.02, radius=(0.8, 1.0), seed=2)
    scene = scene.replace(world=replace(scene.world, rolling_friction=0.07))
    whole = dc.simulate(scene, steps=60, solver=solver).state
    live = dc.Simulator(scene, solver=solver)
    for _ in range(60):
        live.step()
    assert_same_bits(live.state, whole)
    dc.write_state(tmp_path / "half.xml", dc.simulate(scene, steps=25, solver=solver).state)
    half = dc.read_state(tmp_path / "half.xml")
    assert half.world.rolling_friction == 0.07
    assert_same_bits(dc.simulate(half, steps=35, solver=solver).state, whole)
    assert_same_bits(dc.simulate_many([scene] * 2, steps=60, threads=2, solver=solver)[0].state, whole)


@pytest.mark.parametrize("solver", TWO)
def test_a_column_that_collapses_runs_out_less_far(solver):
    """Spread of the circles and height of the heap, without and with ρ = 0.2 r."""
    spreads, heights = [], []
    for rho in (0.0, 0.1):
        x, y = np.meshgrid(0.5 + np.arange(8), 0.51 + np.arange(12))
        places = np.column_stack([20.0 + (x + 0.5 * (np.arange(12) % 2)[:, None]).ravel(), 0.87 * y.ravel() + 0.1])
        scene = circles_at(places, radius=0.49, box=(0.0, 0.0, 48.0, 20.0), rolling_friction=rho, dt=0.007)
        state = dc.simulate(scene, steps=600, solver=solver).state
        spreads.append(np.std(state.bodies.position[:, 0]))
        heights.append(np.sort(state.bodies.position[:, 1])[-3])
    assert spreads[1] < 0.9 * spreads[0]
    assert heights[1] > 1.1 * heights[0]


@pytest.mark.parametrize("name", METHODS)
def test_solvers_without_it_say_so(name):
    state = dc.find_contacts(rolling_disc(1.0, rolling_friction=0.1))
    assert entry_of(METHODS[name]()).rolls == (name in ROLLS)
    if name not in ROLLS:
        message = f"rolling_friction: expected 0 for {name}, since only PGS, BatchedPGS, PSOR have rolling resistance"
        for use in (dc.solve_contacts, lambda state, solver: dc.simulate(state, steps=1, solver=solver)):
            with pytest.raises(ValueError, match=message):
                use(state, solver=METHODS[name]())


def test_exact_solutions_refuse_it():
    with pytest.raises(ValueError, match="rolling_friction: expected 0 for exact solutions"):
        dc.solve_exactly(dc.find_contacts(rolling_disc(1.0, rolling_friction=0.1)))


@pytest.mark.parametrize("accuracy", PRESETS)
def test_presets_choose_solvers_that_have_it(accuracy):
    for scene in (dc.lattice_in_box(300, seed=1), dc.column(60)):
        found = recommend(scene.replace(world=replace(scene.world, rolling_friction=0.1)), accuracy=accuracy)
        assert entry_of(found.solver).rolls
        assert any("rolling resistance of up to 0.1 m; it has none" in sentence for sentence in found.outside)


@pytest.mark.parametrize("start", [name for name in STARTS if not name.startswith(("cnn", "far"))])
def test_every_start_goes_with_it(start):
    pile = dc.simulate(dc.lattice_in_box(20, gap=0.02, seed=1), steps=60, solver=dc.PGS(**FEW)).state
    pile = pile.replace(world=replace(pile.world, rolling_friction=0.1))
    state = dc.simulate(pile, steps=20, solver=dc.PGS(**FEW), warm_start=start).state
    assert np.hypot(*state.bodies.velocity.T).max() < 1.0
