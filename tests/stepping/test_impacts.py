"""Impacts: a rebound by hand, and many impacts in which no setting makes or loses energy."""

import math
from itertools import product

import numpy as np
import pytest
from conftest import circles_at, momentum

import deep_contact as dc
from deep_contact.accuracy.presets import PRESETS
from deep_contact.stepping.problem import after_impacts
from deep_contact.studies.hard_scenes import mechanical_energy

pytestmark = pytest.mark.filterwarnings("ignore:.*solved to a tolerance")


def energies(state, steps, every=50, **options):
    """Mechanical energy along a run over that at its start, the floor as zero, (steps // every,)."""
    found = [mechanical_energy(state, state.bodies)]
    for _ in range(steps // every):
        state = dc.simulate(state, steps=every, **options).state
        found.append(mechanical_energy(state, state.bodies))
    return np.array(found[1:]) / found[0]


def with_masses(scene, ratio, seed=1):
    factor = ratio ** np.random.default_rng(seed).uniform(0, 1, scene.bodies.count)
    return scene.replace(bodies=scene.bodies._replace(mass=scene.bodies.mass * factor))


# "preview" takes PSOR, whose step without friction is a kind of its own.
@pytest.mark.parametrize(
    "accuracy", [pytest.param(name, marks=[pytest.mark.slow] * (name == "preview")) for name in PRESETS]
)
def test_three_elastic_circles_keep_their_energy_with_every_preset(accuracy):
    scene = dc.circles_in_box(3, friction=0.0, restitution=1.0, seed=0)
    assert np.abs(energies(scene, 1000, every=100, accuracy=accuracy) - 1).max() < 0.02


@pytest.mark.parametrize("solver", [None, dc.PGS(), dc.PSOR(sweeps=2, omega=1.9, tolerance=None), dc.NNCG(sweeps=3)])
def test_unlike_masses_with_friction_gain_no_energy(solver):
    scene = with_masses(dc.circles_in_box(30, restitution=1.0, seed=2), 1e4)
    options = {"accuracy": "fast"} if solver is None else {"solver": solver}
    assert energies(scene, 300, **options).max() < 1.01


@pytest.mark.parametrize("ratio", [1.0, 1e4])
def test_elastic_frictionless_circles_keep_their_energy_whatever_the_masses(ratio):
    # Light ones come to 400 m/s: nothing cuts a speed, and what stops early keeps the energy of its height.
    scene = with_masses(dc.circles_in_box(30, friction=0.0, restitution=1.0, seed=3), ratio)
    assert np.abs(energies(scene, 1000, solver=dc.PGS(sweeps=2, tolerance=None)) - 1).max() < 0.02


def test_a_circle_that_slides_along_the_floor_rebounds_by_coulomb():
    # p_n = (1 + e) m v_n, p_t = μ p_n against the slip, v_n with half a step of gravity; then the step's gravity.
    scene = circles_at([[15.0, 1.01]], velocity=[[6.0, -4.0]], friction=0.1, restitution=0.5)
    solution = dc.solve_contacts(scene, solver=dc.PGS())
    v_n, half = 4.0 + 0.5 * 0.01 * 9.81, 0.5 * 0.01 * 9.81
    np.testing.assert_allclose(solution.velocities[0], [6.0 - 0.1 * 1.5 * v_n, 0.5 * v_n - half], rtol=1e-12)
    np.testing.assert_allclose(solution.angular_velocities, -2.0 * 0.1 * 1.5 * v_n, rtol=1e-12)


def test_a_surface_that_moves_drags_what_rebounds_from_it():
    belt = {"segments": (((25.0, 5.0), (5.0, 5.0)),), "surface_speeds": (2.0,)}
    scene = circles_at([[15.0, 6.0]], velocity=[[0.0, -4.0]], gravity=(0, 0), restitution=1.0, friction=9.0, **belt)
    state = dc.simulate(scene, steps=1, solver=dc.PGS()).state
    # A disc that sticks takes a third of the surface's speed, and turns with the rest.
    assert abs(state.bodies.velocity[0, 0]) == pytest.approx(2.0 / 3.0, rel=0.02)
    assert state.bodies.velocity[0, 1] == pytest.approx(4.0, rel=1e-9)


def test_what_rests_does_not_rebound():
    # At e = 1, too: a column stays, and a light circle between heavy ones. Solved tightly: the speed that a loose
    # tolerance leaves opens a contact, and what falls back at e = 1 bounces.
    for scene in (dc.column(4, restitution=1.0), with_masses(dc.column(4, restitution=1.0), 50.0)):
        state = dc.simulate(scene, steps=200, solver=dc.PGS(sweeps=500, tolerance=1e-10)).state
        assert np.abs(state.bodies.velocity).max() < 1e-3


def test_angular_momentum_changes_by_position_correction_alone():
    # Both circles get their impulses at one point. Correction moves centres along the normal, which changes Σ m x × v.
    # Two blocks of 16 circles run into each other, without gravity.
    block = np.stack(np.meshgrid(np.arange(4), np.arange(4)), -1).reshape(-1, 2) * 2.02
    position = np.concatenate([block + np.array([3.0, 11.0]), block + np.array([18.0, 11.5])])
    state = circles_at(position, velocity=np.repeat([[5.0, 0.0], [-5.0, 0.0]], 16, axis=0), gravity=(0, 0))

    def angular(bodies):
        x, v = bodies.position - 15.0, bodies.velocity
        return bodies.inertia @ bodies.spin + bodies.mass @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])

    solvers = [dc.PGS(sweeps=20, position_sweeps=sweeps) for sweeps in (0, 10)]
    ends = [angular(dc.simulate(state, steps=80, solver=solver).state.bodies) for solver in solvers]
    without, corrected = np.abs(np.array(ends) - angular(state.bodies)) / (state.bodies.mass.sum() * 5.0 * 10.0)
    assert without < 1e-13
    assert 1e-6 < corrected < 1e-2


FREE = {"gravity": (0.0, 0.0), "friction": 0.0, "box": (0.0, 0.0, 100.0, 100.0)}


def impact(position, velocity, **options):
    """Bodies before and after the impacts of a step."""
    state = dc.find_contacts(circles_at(np.array(position), velocity=np.array(velocity), **(FREE | options)))
    return state.bodies, after_impacts(state)[0].bodies


def rack(rows, e, mu=0.0):
    """A cue of 5 m/s that meets the tip of a triangle of touching circles, at x = 50, and the mirror image of each."""
    place = np.array([[j - k / 2, k * math.sqrt(0.75)] for k in range(rows) for j in range(k + 1)] + [[0.0, -1.0]])
    velocity = np.zeros_like(place)
    velocity[-1, 1] = 5.0
    mirror = [np.abs(place - place[i] * [-1, 1]).sum(axis=1).argmin() for i in range(len(place))]
    position = np.array([50.0, 50.0]) + 2.0 * place * (1.0 - 1e-12)
    world = FREE | {"restitution": e, "friction": mu}
    return circles_at(position, velocity=velocity, **world), np.array(mirror)


def crowd(seed, **world):
    """Three to eight circles of random sizes, masses and velocities, apart."""
    rng = np.random.default_rng(seed)
    n = rng.integers(3, 9)
    cells = rng.permutation(36)[:n]
    position = 3.2 * np.stack([cells % 6, cells // 6], axis=1) + rng.uniform(1.5, 2.5, (n, 2))
    bodies = {"radius": rng.uniform(0.6, 1.0, n), "mass": 10 ** rng.uniform(0, 1, n)}
    bodies |= {"velocity": rng.normal(0, 5, (n, 2)), "spin": rng.normal(0, 3, n)}
    return circles_at(position, box=(0.0, 0.0, 20.0, 20.0), **bodies, **world)


def test_a_ball_between_two_parts_them_alike_and_by_the_closed_form():
    # By symmetry both get P, with P (1 + 2 cos² 30°) / m = (1 + e) v cos 30°.
    for order in ([0, 1, 2], [1, 0, 2], [2, 1, 0]):
        for e in (0.3, 0.6, 1.0):
            place = np.array([[49.0, 50.0], [51.0, 50.0], [50.0, 50.0 - math.sqrt(3.0) + 1e-9]])[order]
            velocity = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 5.0]])[order]
            _, after = impact(place, velocity, restitution=e)
            p = (1 + e) * 5.0 * math.sqrt(0.75) / 2.5
            right = np.array(
                [[-p / 2, p * math.sqrt(0.75)], [p / 2, p * math.sqrt(0.75)], [0.0, 5.0 - 2 * p * math.sqrt(0.75)]]
            )
            np.testing.assert_allclose(after.velocity, right[order], rtol=0, atol=1e-8)


@pytest.mark.parametrize("mu", [0.0, 0.5])
@pytest.mark.parametrize("rows", range(3, 8))
def test_racks_break_symmetrically(rows, mu):
    for e in (0.3, 0.6, 0.9, 1.0):
        state, mirror = rack(rows, e, mu)
        velocity = dc.simulate(state, steps=40, solver=dc.PGS()).state.bodies.velocity
        assert np.abs(velocity - velocity[mirror] * [-1, 1]).max() < 0.01 * 5.0
        velocity = after_impacts(dc.find_contacts(state))[0].bodies.velocity
        assert np.abs(velocity - velocity[mirror] * [-1, 1]).max() < 1e-9


def test_contacts_that_hardly_approach_change_an_impact_by_little():
    for rows in (3, 4, 5):
        state, _ = rack(rows, 1.0)
        noise = 1e-9 * np.random.default_rng(0).normal(size=state.bodies.velocity.shape)
        shaken = state.replace(bodies=state.bodies._replace(velocity=state.bodies.velocity + noise))
        one, other = (after_impacts(dc.find_contacts(s))[0].bodies.velocity for s in (state, shaken))
        assert np.abs(one - other).max() < 1e-7


@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_a_run_does_not_depend_on_left_and_right_nor_on_the_order_of_the_bodies(gravity):
    # Sweeps go through the contacts in their order. So what impacts leave to them is solved tightly, and position
    # correction is left out: with it one scene of 200 without gravity differs by 2e-5 m.
    solver = dc.PGS(tolerance=1e-13, position_sweeps=0)
    for seed in range(40):
        state = crowd(
            seed, gravity=(0.0, -gravity), friction=(0.0, 0.5)[seed % 2], restitution=(0.3, 0.6, 1.0)[seed % 3]
        )
        b, flip = state.bodies, np.array([-1.0, 1.0])
        mirrored = b._replace(position=b.position * flip + [20.0, 0.0], velocity=b.velocity * flip, spin=-b.spin)
        turned = type(b)(*(np.ascontiguousarray(values[::-1]) for values in b))
        ends = [
            dc.simulate(state.replace(bodies=x), steps=150, solver=solver).state.bodies for x in (b, mirrored, turned)
        ]
        np.testing.assert_allclose(ends[1].position * flip + [20.0, 0.0], ends[0].position, rtol=0, atol=1e-9)
        np.testing.assert_allclose(ends[2].position[::-1], ends[0].position, rtol=0, atol=1e-9)


def test_k_balls_into_a_cradle_are_k_balls_out_of_it():
    rng = np.random.default_rng(0)
    for n, k, noise in product((3, 5, 10), (1, 2), (0.0, 1e-9)):
        order = rng.permutation(n)
        place = np.stack([20.0 + 2.0 * np.arange(n), np.full(n, 50.0)], axis=1)[order]
        velocity = np.where(np.arange(n) < k, 1.0, 0.0)[order, None] * [1.0, 0.0] + noise * rng.normal(size=(n, 2))
        _, after = impact(place, velocity, restitution=1.0)
        right = np.where(np.arange(n) >= n - k, 1.0, 0.0)[order]
        np.testing.assert_allclose(after.velocity[:, 0], right, rtol=0, atol=1e-6 if noise else 1e-14)


@pytest.mark.parametrize("ratio", [1e2, 1e6, 1e8])
def test_a_light_circle_between_a_wall_and_a_heavy_one_hands_its_energy_back(ratio):
    before, after = impact([[1.0, 50.0], [3.0, 50.0]], [[0.0, 0.0], [-1.0, 0.0]], mass=[1.0, ratio], restitution=1.0)
    assert after.velocity[1, 0] > 0.995
    assert after.mass @ (after.velocity**2).sum(1) == pytest.approx(
        before.mass @ (before.velocity**2).sum(1), rel=1e-12
    )


@pytest.mark.parametrize("e", [0.0001, 0.5, 1.0])
def test_clusters_keep_momentum_gain_no_energy_and_come_to_an_end(e):
    # Packed circles of unlike masses and spins that run into each other; and a row between two walls, which at e = 1
    # would rebound for ever.
    for seed, mu in product(range(4), (0.0, 0.5)):
        rng = np.random.default_rng(seed)
        place = 30.0 + np.stack(
            [2.0 * np.arange(25) % 10 + np.arange(25) // 5 % 2, math.sqrt(3.0) * (np.arange(25) // 5)], 1
        )
        bodies = {"mass": 10 ** rng.uniform(0, 3, 25), "spin": rng.normal(0, 3, 25)}
        before, after = impact(place, rng.normal(0, 3, (25, 2)), restitution=e, friction=mu, **bodies)
        np.testing.assert_allclose(momentum(after), momentum(before), rtol=0, atol=1e-12 * before.mass.sum() * 3.0)
        one, other = (b.mass @ (b.velocity**2).sum(1) + b.inertia @ b.spin**2 for b in (before, after))
        assert other <= one * (1 + 1e-12)
        assert e < 1.0 or mu > 0.0 or other == pytest.approx(one, rel=1e-12)
    row = np.stack([np.arange(1.0, 20.0, 2.0), np.full(10, 50.0)], axis=1)
    before, after = impact(
        row, np.random.default_rng(0).normal(0, 1, (10, 2)), restitution=e, box=(0.0, 0.0, 20.0, 100.0)
    )
    assert (after.velocity**2).sum() <= (before.velocity**2).sum() * (1 + 1e-12)


def test_a_fast_circle_elsewhere_changes_no_slow_impact():
    for e in (0.5, 1.0):
        place, velocity = [[5.0, 5.0], [7.0, 5.0], [50.0, 50.0], [52.0, 50.0]], np.zeros((4, 2))
        velocity[[0, 2, 3], 0] = 2e4, 0.025, -0.025
        _, after = impact(place, velocity, restitution=e)
        assert after.velocity[3, 0] - after.velocity[2, 0] == pytest.approx(0.05 * e, rel=1e-9)


@pytest.mark.parametrize("speed", [0.02, 0.3])
def test_slow_hits_across_gravity_rebound(speed):
    # A side wall carries nothing, however heavy what rests on the floor is.
    for e in (0.5, 1.0):
        place = [[15.0, 1.01], [28.995, 20.0]]
        state = circles_at(place, velocity=[[0.0, 0.0], [speed, 0.0]], restitution=e, friction=0.0)
        after = after_impacts(dc.find_contacts(state))[0].bodies
        assert after.velocity[1, 0] == pytest.approx(-e * speed, rel=1e-9)


def test_a_circle_of_infinite_mass_is_a_wall_to_others():
    # It moves on at its own velocity, and joins no impacts on its two sides.
    bodies = {"mass": [1.0, np.inf, 1.0], "velocity": [[4.0, 0.0], [1.0, 0.0], [-2.0, 0.0]], "restitution": 0.5}
    state = circles_at([[48.0, 50.0], [50.0, 50.0], [52.0, 50.0]], **(FREE | bodies | {"mass": [1.0, 1.0, 1.0]}))
    state = dc.find_contacts(state)
    state = state.replace(bodies=state.bodies._replace(mass=np.array(bodies["mass"])))
    np.testing.assert_allclose(after_impacts(state)[0].bodies.velocity[:, 0], [1.0 - 1.5, 1.0, 1.0 + 1.5], rtol=1e-14)


@pytest.mark.parametrize("mu", [0.0, 0.1, 2.0])
@pytest.mark.parametrize("e", [0.3, 1.0])
def test_two_discs_of_any_size_and_spin_rebound_by_newton_and_coulomb(e, mu):
    """Along n: −e of the approach. Along t: what sticks, or μ P. The moment of P turns both the same way."""
    slides = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        radius, mass, spin = rng.uniform(0.2, 2.0, 2), rng.uniform(0.1, 9.0, 2), rng.uniform(-6.0, 6.0, 2)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        n, t = np.array([math.cos(angle), math.sin(angle)]), np.array([math.sin(angle), -math.cos(angle)])
        overlap = 0.02 * radius.min()
        place = np.array([[50.0, 50.0], [50.0, 50.0] + (radius.sum() - overlap) * n])
        velocity = rng.normal(0.0, 2.0, (2, 2)) + np.outer([3.0, -3.0], n) + np.outer([0.0, 4.0], t)
        state = circles_at(
            place, radius=radius, mass=mass, spin=spin, velocity=velocity, gravity=(0, 0), box=(0, 0, 100, 100),
            restitution=e, friction=mu,
        )  # fmt: skip
        after, received = after_impacts(dc.find_contacts(state))
        after, arm = after.bodies, radius - 0.5 * overlap
        (impulse,) = received
        np.testing.assert_allclose(mass[1] * (after.velocity[1] - velocity[1]), impulse, atol=1e-9)
        np.testing.assert_allclose(mass[0] * (after.velocity[0] - velocity[0]), -impulse, atol=1e-9)
        relative, later = velocity[1] - velocity[0], after.velocity[1] - after.velocity[0]
        assert later @ n == pytest.approx(-e * (relative @ n), rel=1e-9)
        slip = relative @ t + arm @ spin
        effective = 1.0 / (1.0 / mass + arm**2 / state.bodies.inertia).sum()
        p_t = np.clip(-slip * effective, -mu * (impulse @ n), mu * (impulse @ n))
        slides += abs(p_t) < 0.999 * abs(slip) * effective
        assert impulse @ t == pytest.approx(p_t, abs=1e-9)
        np.testing.assert_allclose(state.bodies.inertia * (after.spin - spin), arm * p_t, atol=1e-9)
    assert slides == {0.0: 12, 0.1: slides, 2.0: 0}[mu]
    assert slides > 3 or mu == 2.0


@pytest.mark.parametrize("along", [(1000.0, 0.0), (0.0, 1000.0), (600.0, -800.0), (1000.0, 1e-3)])
def test_an_approach_that_rounding_makes_is_no_impact(along):
    """Two that fly together at 1 km/s and come nearer at 1e-10 m/s keep their velocities, at e = 1 too."""
    along = np.array(along)
    way = along / np.hypot(*along)
    place = np.array([50.0, 50.0]) + np.outer([0.0, 2.0 - 1e-9], way)
    before, after = impact(place, [along, along - 1e-10 * way], restitution=1.0)
    np.testing.assert_array_equal(after.velocity, before.velocity)


@pytest.mark.parametrize(("speed", "rebounds"), [(0.7, False), (0.8, True)])
def test_box2ds_threshold_holds_without_gravity(speed, rebounds):
    """1 m/s, times 1 − e² = 0.75."""
    scales = {"scales": dc.BOX2D, "restitution": 0.5}
    _, after = impact([[50.0, 50.0], [52.0 - 1e-9, 50.0]], [[speed, 0.0], [0.0, 0.0]], **scales)
    right = [0.25 * speed, 0.75 * speed] if rebounds else [speed, 0.0]
    np.testing.assert_allclose(after.velocity[:, 0], right, rtol=1e-9)
