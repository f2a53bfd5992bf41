"""Pairs of materials: their impacts, inclines and filters against closed forms, and what must change no bit."""

import math
from dataclasses import replace
from itertools import product

import numba
import numpy as np
import pytest
from conftest import assert_same_bits, circles_at, load_script

import deep_contact as dc
from deep_contact.analysis.lcp import contact_problem, natural_residual
from deep_contact.solvers import METHODS
from deep_contact.studies.hard_scenes import mechanical_energy

if not numba.config.DISABLE_JIT:
    pytestmark = pytest.mark.slow  # a dozen kinds of steps to compile; test_without_compiler.py runs them interpreted

MU = np.array([[0.05, 0.15, 0.4], [0.15, 0.3, 0.1], [0.4, 0.1, 0.6]])
E = np.array([[0.0, 0.5, 0.9], [0.5, 1.0, 0.3], [0.9, 0.3, 0.7]])
G = 9.81
FEW = {"sweeps": 30, "tolerance": None}


def solvers(**options):
    return [kind(**FEW | options) for kind in METHODS.values()]


@pytest.mark.parametrize("solver", [dc.PGS(**FEW), dc.BatchedPGS(**FEW), dc.PGS(sweeps=5, most_substeps=8)])
def test_each_of_nine_pairs_has_its_own_impact(solver):
    """Oblique impacts of a disc with a disc at rest: p_n = (1 + e) k v_n, p_t = −k v_t / 3, cut to ±μ p_n, k = m / 2.

    All nine happen in one step, in one scene, far from each other.
    """
    pairs, normal, gap = list(product(range(3), repeat=2)), np.array([0.6, 0.8]), 1e-9
    tangent = np.array([normal[1], -normal[0]])
    first = np.array([[20.0 + 10.0 * p, 20.0 + 10.0 * q] for p, q in pairs])
    v_n, v_t = 6.0, 3.0
    velocity = np.concatenate([np.tile(v_n * normal + v_t * tangent, (9, 1)), np.zeros((9, 2))])
    state = circles_at(
        np.concatenate([first, first + (2.0 - gap) * normal]), velocity=velocity, mass=2.0, box=(0.0, 0.0, 60.0, 60.0),
        material=[p for p, _ in pairs] + [q for _, q in pairs], gravity=(0.0, 0.0), friction=MU, restitution=E,
    )  # fmt: skip
    after = dc.simulate(state, steps=1, solver=solver).state.bodies
    for i, (p, q) in enumerate(pairs):
        p_n = (1.0 + E[p, q]) * v_n
        p_t = min(v_t / 3.0, MU[p, q] * p_n)
        push = p_n * normal + p_t * tangent  # k = 1 kg; on the second disc
        np.testing.assert_allclose(after.velocity[9 + i], push / 2.0, rtol=0, atol=1e-7, err_msg=f"{p}, {q}")
        np.testing.assert_allclose(after.velocity[i], velocity[i] - push / 2.0, rtol=0, atol=1e-7)
        np.testing.assert_allclose(after.spin[[i, 9 + i]], [p_t, p_t], rtol=0, atol=1e-7)


@pytest.mark.parametrize("solver", solvers(sweeps=200))
@pytest.mark.parametrize(("p", "q"), [(0, 1), (1, 2)])
def test_a_disc_on_an_incline_rolls_or_slides_by_the_friction_of_its_pair(solver, p, q):
    """It rolls with g sin θ / (1 + 1 / (2 l²)) up to tan θ of about 3 μ, and slides with g (sin θ − μ cos θ) beyond.

    l: arm, 1 m less half of the overlap at which the disc rests.
    """
    for slope in (2.9 * MU[p, q], 3.2 * MU[p, q]):
        theta = math.atan(slope)
        gravity = (G * math.sin(theta), -G * math.cos(theta))
        state = circles_at(
            [[5.0, 1.005]], material=p, friction=MU, restitution=0.0, wall_materials=(q, 0, 0, 0), gravity=gravity,
            box=(0.0, 0.0, 99.0, 99.0),
        )  # fmt: skip
        speed = dc.simulate(state, steps=40, solver=solver).state.bodies.velocity[0, 0]
        rolls = slope < 3.0 * MU[p, q]
        expected = (
            G * math.sin(theta) / (1.0 + 0.5 / 0.9975**2)
            if rolls
            else G * (math.sin(theta) - MU[p, q] * math.cos(theta))
        )
        assert speed == pytest.approx(0.4 * expected, rel=1e-5)


@pytest.mark.parametrize("solver", [dc.PGS(**FEW), dc.BatchedPGS(**FEW)])
def test_a_disc_that_cannot_roll_slides_from_tan_theta_above_the_friction_of_its_pair(solver):
    """Rolling resistance of ρ = 5 r holds its spin. All nine pairs: it rests at 0.99 μ, and slides at 1.05 μ."""
    for (p, q), share in product(product(range(3), repeat=2), (0.99, 1.05)):
        theta = math.atan(share * MU[p, q])
        state = circles_at(
            [[5.0, 1.005]], material=p, friction=MU, wall_materials=(q, 0, 0, 0), rolling_friction=5.0,
            gravity=(G * math.sin(theta), -G * math.cos(theta)), box=(0.0, 0.0, 99.0, 99.0),
        )  # fmt: skip
        speed = dc.simulate(state, steps=40, solver=solver).state.bodies.velocity[0, 0]
        expected = max(0.0, G * (math.sin(theta) - MU[p, q] * math.cos(theta))) * 0.4
        assert speed == pytest.approx(expected, rel=1e-6, abs=1e-9), (p, q, share)


def mixed(seed, materials=3, **world):
    """Circles of random materials that fall on a shelf, a peg and a moving paddle; e up to 1."""
    rng = np.random.default_rng(seed)
    friction, restitution = (
        0.5 * (table + table.T) for table in (rng.uniform(0, 1, (materials,) * 2), rng.uniform(0, 1, (materials,) * 2))
    )
    touches = np.ones((materials,) * 2, bool)
    touches[0, 1] = touches[1, 0] = False
    scene = dc.lattice_in_box(20, gap=0.02, radius=(0.8, 1.0), seed=seed)
    bodies = dc.make_bodies(
        scene.bodies.position + np.array([0.0, 5.0]), radius=scene.bodies.radius, velocity=rng.normal(0, 3, (20, 2)),
        material=rng.integers(0, materials, 20), fixed=np.arange(20) == 7,
    )  # fmt: skip
    right = scene.world.box[2]
    table = {
        "friction": friction, "restitution": restitution, "touches": touches,
        "wall_materials": rng.integers(0, materials, 4), "segment_materials": rng.integers(0, materials, 2),
        "segments": [[(0.0, 3.0), (0.4 * right, 2.0)], [(0.6 * right, 1.0), (right, 1.0)]],
        "segment_velocities": [[[0.0, 0.0]] * 2, [[0.0, 0.5]] * 2],
    }  # fmt: skip
    box = (*scene.world.box[:3], scene.world.box[3] + 10.0)
    return scene.replace(bodies=bodies, world=dc.World(box=box, **table | world), contacts=None)


relabelled = load_script("random_scenes").relabelled


SETTINGS = [
    {"solver": dc.PGS(sweeps=12, tolerance=None)},
    {"solver": dc.BatchedPGS(sweeps=12, tolerance=None, most_substeps=8)},
    {"solver": dc.PGS(sweeps=12, tolerance=None), "sleep": True},
]


@pytest.mark.filterwarnings("ignore:.*passes over circle")
@pytest.mark.parametrize("options", SETTINGS)
@pytest.mark.parametrize("seed", range(3))
def test_bits_do_not_depend_on_labels_parts_files_or_neighbours(seed, options, tmp_path):
    state = mixed(seed, materials=2 + seed)
    whole = dc.simulate(state, steps=60, **options).state
    order = np.random.default_rng(seed).permutation(2 + seed)
    other = dc.simulate(relabelled(state, order), steps=60, **options).state
    for name in ("position", "velocity", "spin"):
        np.testing.assert_array_equal(getattr(other.bodies, name), getattr(whole.bodies, name))
    if "sleep" not in options:  # all islands wake where a run is divided
        live = dc.Simulator(state, **options)
        for _ in range(60):
            live.step()
        assert_same_bits(live.state, whole)
        half = dc.simulate(state, steps=25, **options).state
        dc.write_state(tmp_path / "half.xml", half)
        assert_same_bits(dc.simulate(dc.read_state(tmp_path / "half.xml"), steps=35, **options).state, whole)
    assert_same_bits(dc.simulate_many([state, state], steps=60, threads=2, **options)[1].state, whole)


@pytest.mark.parametrize("kind", METHODS.values())
def test_a_table_with_equal_entries_gives_the_bits_of_a_number(kind):
    """The table is not reduced to a number, because a circle that nothing touches has another material."""
    scene = dc.lattice_in_box(30, gap=0.02, radius=(0.9, 1.0), seed=1)
    far = dc.make_bodies([[0.5 * scene.world.box[2], scene.world.box[3] + 900.0]], material=1)
    scene = scene.replace(world=replace(scene.world, box=(*scene.world.box[:3], scene.world.box[3] + 1000.0)))
    scene = scene.with_bodies(add=far)
    table = scene.replace(world=replace(scene.world, friction=[[0.5, 0.5], [0.5, 0.1]]))
    options = {"steps": 60, "solver": kind(sweeps=12, tolerance=None)}
    assert_same_bits(dc.simulate(scene, **options).state, dc.simulate(table, **options).state)


@pytest.mark.filterwarnings("ignore:.*passes over circle")
@pytest.mark.parametrize("seed", range(3))
def test_no_pair_makes_energy(seed):
    state = mixed(seed, materials=2 + seed, segment_velocities=())
    run = dc.simulate(state, steps=300, record=10, solver=dc.PGS(sweeps=20, tolerance=None, most_substeps=8))
    energy = [mechanical_energy(one, one.bodies._replace(mass=one.bodies.free_mass)) for one in run.trajectory]
    assert max(energy) < 1.005 * energy[0]
    assert energy[-1] < energy[0]


def test_forces_of_a_resting_pile_satisfy_coulomb_pair_by_pair():
    scene = dc.lattice_in_box(40, gap=0.02, seed=3)
    bodies = scene.bodies._replace(material=np.arange(40) % 3)
    world = replace(scene.world, friction=MU, wall_materials=(2, 1, 0, 0))
    state = dc.simulate(scene.replace(bodies=bodies, world=world, contacts=None), steps=300).state
    exact = dc.solve_exactly(dc.find_contacts(state))
    assert exact.converged
    problem, solution = contact_problem(state), exact.solution
    stacked = np.column_stack([solution.normal_impulses, solution.tangent_impulses]).ravel()
    assert natural_residual(problem, stacked) < 1e-7
    assert len(set(problem.friction)) > 3
    swept = dc.solve_contacts(state, solver=dc.NNCG(sweeps=20_000, tolerance=1e-12))
    np.testing.assert_allclose(swept.velocities, solution.velocities, rtol=0, atol=1e-6)


# ---- pairs that pass through each other ----


APART = [[True, False], [False, True]]


@pytest.mark.parametrize("speed", [2.0, 500.0])
@pytest.mark.parametrize("solver", [dc.PGS(**FEW), dc.BatchedPGS(**FEW)])
def test_a_circle_passes_through_what_it_does_not_touch(speed, solver):
    """Slow or fast, through a circle, a peg, a shelf at rest and one that moves. Another circle stops at the shelf."""
    position = [[2.0, 5.0], [10.0, 5.0], [14.0, 5.0], [2.0, 12.0]]
    state = circles_at(
        position, velocity=[[speed, 0.0], [0.0, 0.0], [0.0, 0.0], [speed, 0.0]], material=[1, 0, 0, 0],
        fixed=[False, False, True, False], touches=APART, gravity=(0.0, 0.0), box=(0.0, 0.0, 1e4, 20.0),
        segments=[[(18.0, 0.0), (18.0, 20.0)], [(22.0, 0.0), (22.0, 20.0)]], segment_materials=[0, 0],
        segment_velocities=[[[0.0, 0.0]] * 2, [[-0.1, 0.0]] * 2], friction=0.5,
    )  # fmt: skip
    steps = math.ceil(40.0 / (0.01 * speed))
    run = dc.simulate(state, steps=steps, solver=solver)
    after = run.state.bodies
    np.testing.assert_allclose(after.position[0], [2.0 + steps * 0.01 * speed, 5.0], rtol=1e-12)
    np.testing.assert_array_equal(after.position[1], position[1])
    assert after.position[3, 0] < 18.0  # of the material of the shelf


def test_an_end_is_not_hidden_by_a_segment_through_which_the_circle_passes():
    """Two segments meet at a point. A circle that touches only the first falls on its end."""
    segments = [[(0.0, 5.0), (10.0, 5.0)], [(10.0, 5.0), (20.0, 5.0)]]
    state = circles_at(
        [[10.5, 5.85]], material=1, touches=[[True, True, True], [True, True, False], [True, False, True]],
        segments=segments, segment_materials=[0, 2], box=(0.0, 0.0, 20.0, 20.0),
    )  # fmt: skip
    np.testing.assert_array_equal(dc.find_contacts(state).contacts.body_b, [1 + 4])


def test_the_box_holds_every_circle():
    state = circles_at([[5.0, 3.0]], touches=[[False]], box=(0.0, 0.0, 10.0, 10.0))
    assert dc.simulate(state, steps=300).state.bodies.position[0, 1] == pytest.approx(1.005, abs=0.01)


def test_contacts_of_a_pair_that_passes_from_now_on_are_dropped():
    state = dc.simulate(dc.column(3), steps=30, solver=dc.PGS(**FEW)).state
    bodies = state.bodies._replace(material=np.array([0, 1, 0]))
    falls = state.replace(world=replace(state.world, touches=APART), bodies=bodies, load=None)  # as from a file
    after = dc.simulate(falls, steps=1, solver=dc.PGS(**FEW)).state.bodies
    np.testing.assert_allclose(after.velocity[1:, 1], state.bodies.velocity[1:, 1] - 0.01 * G, rtol=1e-12)
    assert abs(after.velocity[0, 1]) < 0.1 * 0.01 * G


def test_a_live_run_takes_tables_between_steps():
    """Gravity changes in place. Tables and rolling resistance set up the steps anew, as a new run from the state."""
    options = {"solver": dc.PGS(**FEW)}
    scene = dc.lattice_in_box(20, gap=0.02, seed=1, friction=MU, wall_materials=(2, 1, 0, 1))
    live = dc.Simulator(scene, **options)
    live.step(60)
    inputs = live._inputs
    live.set(gravity=(1e-6, -9.81))
    assert live._inputs.friction is inputs.friction
    live.step()
    for change in ({"friction": MU[::-1, ::-1]}, {"friction": 0.4}, {"rolling_friction": 0.1}):
        state = live.state
        live.set(**change)
        changed = state.replace(world=replace(state.world, **change))
        live.step(3)
        assert live.state.world == changed.world
        assert_same_bits(live.state, dc.simulate(changed, steps=3, **options).state)
