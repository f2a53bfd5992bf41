"""Properties of whole steps over random scenes (hypothesis): what holds for every input within `LIMITS`."""

import numpy as np
import pytest
from conftest import assert_same_bits
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import deep_contact as dc
from deep_contact.io.state_xml import format_state, parse_state
from deep_contact.solvers import METHODS
from deep_contact.state.arrays import LIMITS, Bodies
from deep_contact.state.checks import check_state
from deep_contact.stepping import metrics
from deep_contact.stepping.interface import entry_of
from deep_contact.stepping.prepare import ready
from deep_contact.stepping.touches import FAST
from deep_contact.studies.hard_scenes import mechanical_energy

pytestmark = pytest.mark.filterwarnings("ignore:.*(nearly coincide|outside of the box)")
SWEEPS = dc.PGS(sweeps=15, tolerance=None)
INELASTIC = dc.PGS(sweeps=20_000, tolerance=1e-12)


def quantity(name):
    """Any number within the limits of a quantity: its ends, ordinary numbers, and all magnitudes between."""
    low, high, _ = LIMITS[name]
    size = st.floats(-30.0, np.log10(high)).map(lambda p: 10.0**p)
    signed = size | size.map(lambda v: -v) if low < 0 else size
    return st.one_of(st.sampled_from([low, high, 1.0]), st.floats(low, high), signed).map(
        lambda v: float(np.clip(v, low, high))
    )


@st.composite
def accepted_states(draw):
    """Anything that the engine accepts, physical or not: circles in, on, around and far outside of a box."""
    n = draw(st.integers(1, 6))

    def column(strategy, count=n):
        return np.array(draw(st.lists(strategy, min_size=count, max_size=count)))

    centre = draw(st.sampled_from([0.0, 15.0, 1e6, -8e8]))
    spread = draw(st.sampled_from([0.0, 0.5, 3.0, 1e4]))
    position = centre + spread * column(st.floats(-1, 1), 2 * n).reshape(n, 2)
    half = draw(st.sampled_from([0.5, 5.0, 1e5]))
    bodies = Bodies(
        position=position,
        velocity=column(quantity("bodies.velocity"), 2 * n).reshape(n, 2),
        angle=np.zeros(n),
        spin=column(quantity("bodies.spin")),
        mass=column(quantity("bodies.mass")),
        radius=column(quantity("bodies.radius") | st.just(1.0)),
    )
    world = dc.World(
        box=(centre - half, centre - half, centre + half, centre + half),
        gravity=(draw(quantity("world.gravity")), draw(quantity("world.gravity"))),
        friction=draw(quantity("world.friction")),
        restitution=draw(st.sampled_from([0.0, 0.5, 1.0])),
        scales=draw(st.sampled_from([None, dc.BOX2D])),
    )
    return check_state(dc.State(name="any", world=world, bodies=bodies, dt=draw(quantity("dt"))))


@settings(max_examples=150, deadline=None)
@given(accepted_states())
def test_an_accepted_state_stays_finite_and_accepted(state):
    for _ in range(5):
        state = dc.step(state, solver=SWEEPS)  # looks at the state anew
    ready(state)
    assert all(np.isfinite(field).all() for field in (*state.bodies, *state.contacts))


@st.composite
def crowds(draw):
    """Ordinary circles of unlike sizes and masses, overlapping at will, in a box; Δt and gravity as in the thesis."""
    n = draw(st.integers(2, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    radius = rng.uniform(0.2, 1.5, n)
    bodies = dc.make_bodies(
        rng.uniform(1.6, 6.4, (n, 2)),
        radius=radius,
        velocity=rng.normal(0, draw(st.sampled_from([0.0, 1.0, 20.0])), (n, 2)),
        spin=rng.normal(0, 3, n),
        mass=10 ** rng.uniform(-draw(st.sampled_from([0.0, 1.0])), 0, n),
    )
    friction = draw(st.sampled_from([0.0, 0.5, 2.0]))
    return dc.State(name="crowd", world=dc.World(box=(0, 0, 8, 8), friction=friction), bodies=bodies)


@settings(max_examples=60, deadline=None)
@given(crowds())
def test_without_restitution_a_step_gains_no_energy_but_by_position_correction(state):
    # By v⁺ᵀJᵀλ <= 0 at a solution: E of a step falls by ½‖v⁺ − v‖² at least, apart from what correction lifts. What a
    # solve that has not converged leaves is left out: this is about the solution; so is a step in which something fast
    # is held early, and has not fallen as far as its speed says (`continuous`).
    state = ready(state)
    for _ in range(5):
        solution = dc.solve_contacts(state, solver=INELASTIC)
        assume(solution.record.status != "max_sweeps")
        if (np.hypot(*solution.velocities.T) * state.dt > FAST * state.bodies.radius).any():
            return
        after = dc.step(state, solver=INELASTIC)
        dt, gravity = state.dt, np.array(state.world.gravity)
        lifted = after.bodies.position - state.bodies.position - dt * after.bodies.velocity
        correction = -float(np.einsum("i,ij,j->", state.bodies.mass, lifted, gravity))
        before = mechanical_energy(state, state.bodies)
        assert mechanical_energy(state, after.bodies) - correction <= before + 1e-9 * max(1.0, abs(before))
        state = after


@settings(max_examples=60, deadline=None)
@given(crowds(), st.sampled_from([0.0, 0.3, 1.0]))
def test_no_restitution_gains_energy_in_a_crowd(state, restitution):
    # A rebound changes it by −½ k (1 − e²) v_n² (`impacts`), what is solved after it by ½ Σ λ_n v_n: 0 for e = 1.
    world = dc.World(box=state.world.box, gravity=(0, 0), friction=0.0, restitution=restitution)
    state = ready(state.replace(world=world))
    solution = dc.solve_contacts(state, solver=INELASTIC, start=None)
    assume(solution.record.status != "max_sweeps")
    after = state.bodies._replace(velocity=solution.velocities)
    change = mechanical_energy(state, after) - mechanical_energy(state, state.bodies)
    most = 1e-9 * (1 + mechanical_energy(state, state.bodies))
    assert change <= most
    if restitution == 1.0 and not solution.normal_impulses.any():
        assert change >= -most
    assert metrics.residual(state, solution) < 1e-7


@settings(max_examples=60, deadline=None)
@given(crowds(), st.integers(-20, 20))
def test_the_solution_scales_with_all_masses_and_with_all_velocities(state, power):
    # Powers of two round nothing, so it holds to the last bit. (The tolerance has a unit, so none is set.) Without
    # gravity, which is a velocity too.
    factor, bodies = 2.0**power, state.bodies
    state = state.replace(world=dc.World(box=state.world.box, gravity=(0, 0), friction=state.world.friction))
    heavy = state.replace(bodies=bodies._replace(mass=bodies.mass * factor))
    fast = state.replace(bodies=bodies._replace(velocity=bodies.velocity * factor, spin=bodies.spin * factor))
    one, *others = (dc.solve_contacts(s, solver=SWEEPS, start=None) for s in (state, heavy, fast))
    for other, speeds in zip(others, (1.0, factor)):
        np.testing.assert_array_equal(other.velocities, one.velocities * speeds)
        np.testing.assert_array_equal(other.normal_impulses, one.normal_impulses * factor)
        np.testing.assert_array_equal(other.tangent_impulses, one.tangent_impulses * factor)


@settings(max_examples=60, deadline=None)
@given(crowds(), st.integers(0, 30))
def test_impulses_stay_in_the_cone_after_any_number_of_sweeps(state, sweeps):
    # Friction is clamped by the normal impulse that the row has in its turn, which the normal row may still lower: so
    # the cone holds to the change of the last sweep, which is θ, and exactly for the normal impulses.
    solution = dc.solve_contacts(state, solver=dc.PGS(sweeps=sweeps, tolerance=None), start=None)
    theta = solution.record.theta[-1] if sweeps else 0.0
    assert (solution.normal_impulses >= 0).all()
    slack = state.world.friction * (solution.normal_impulses + theta) - np.abs(solution.tangent_impulses)
    assert slack.min(initial=0.0) >= -1e-12 * (1 + solution.normal_impulses.max(initial=0.0))


@settings(max_examples=60, deadline=None)
@given(crowds(), st.sampled_from([(64.0, 0.0), (-1024.0, 4096.0)]))
def test_where_the_scene_lies_does_not_matter(state, by):
    # To the rounding of coordinates of 4096 m, 5e-13 m, which five steps and their sweeps amplify.
    x_min, y_min, x_max, y_max = state.world.box
    box = (x_min + by[0], y_min + by[1], x_max + by[0], y_max + by[1])
    world = dc.World(box=box, friction=state.world.friction)
    moved = state.replace(world=world, bodies=state.bodies._replace(position=state.bodies.position + by))
    one, other = (dc.step(s, solver=SWEEPS) for s in (state, moved))
    np.testing.assert_allclose(other.bodies.velocity, one.bodies.velocity, atol=1e-6)
    np.testing.assert_allclose(other.bodies.position - by, one.bodies.position, atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(
    n=st.integers(1, 40),
    low=st.floats(1e-3, 2.0),
    ratio=st.floats(1.0, 100.0),
    size=st.floats(0.5, 60.0),
    sigma=st.floats(0.1, 3.0),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_random_scene_fits_or_says_how_many_did(n, low, ratio, size, sigma, seed):
    try:
        scene = dc.circles_in_box(n, size=size, radius=(low, low * ratio), sigma_coef=sigma, seed=seed)
    except ValueError as error:
        assert "fitted in a box" in str(error)  # noqa: PT017
    else:
        assert ready(scene).contacts.separation.min(initial=0.0) >= 0
        assert scene.bodies.count == n


@settings(max_examples=30, deadline=None)
@given(
    n=st.integers(1, 60),
    columns=st.none() | st.integers(1, 20),
    low=st.floats(1e-3, 2.0),
    ratio=st.floats(1.0, 10.0),
    gap=st.floats(1e-3, 2.0),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_lattice_fills_its_box_and_nothing_overlaps(n, columns, low, ratio, gap, seed):
    scene = dc.lattice_in_box(n, columns=columns, radius=(low, low * ratio), gap=gap, seed=seed)
    position, radius = scene.bodies.position, scene.bodies.radius[:, None]
    box = np.array(scene.world.box)
    assert (position - radius >= box[:2]).all()
    assert (position + radius <= box[2:]).all()
    # Circle i in the cell of column i mod columns and row i // columns, and no more cells than that takes.
    pitch, skin = 2 * low * ratio * (1 + gap), scene.scales.wall_skin
    cells = np.floor((position - skin) / pitch)
    columns = columns or int(np.ceil(np.sqrt(n)))
    np.testing.assert_array_equal(cells, np.column_stack([np.arange(n) % columns, np.arange(n) // columns]))
    np.testing.assert_allclose((box[2:] - 2 * skin) / pitch, [columns, cells[-1, 1] + 1], rtol=1e-9)
    assert ready(scene).contacts.separation.min(initial=0.0) >= -2 * skin


@st.composite
def solvers(draw):
    """Any method, with the options that it admits."""
    name = draw(st.sampled_from(list(METHODS)))
    known = {
        "sweeps": st.integers(1, 30), "tolerance": st.sampled_from([None, 1e-6, "scene"]),
        "position_sweeps": st.integers(0, 10), "substeps": st.sampled_from([1, 2]),
    }  # fmt: skip
    own = {"PGS": {"islands": st.booleans()}}
    return METHODS[name](**draw(st.fixed_dictionaries(known | own.get(name, {}))))


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(crowds(), solvers(), st.sampled_from(["none", "builtin", "scaled", "copy", "sph"]), st.data())
def test_every_combination_keeps_the_first_principles_and_its_bits(state, solver, start, data):
    sleep = entry_of(solver).can_sleep and data.draw(st.booleans())
    options = {"solver": solver, "warm_start": start, "sleep": sleep}
    solved = []
    after = dc.simulate(state, steps=6, on_step=lambda s, record: solved.append(s), **options).state
    n, mass = state.bodies.count, state.bodies.mass
    assert all((one.contacts.normal_impulse >= 0).all() for one in solved)
    # Newton: between two circles nothing changes their common momentum, which the walls and gravity alone do.
    if solver.substeps == 1 and not sleep:
        ready_state = ready(state)
        found = dc.solve_contacts(ready_state, solver=solver, start=None)
        c = ready_state.contacts
        normal, wall = c.normal, c.body_b >= n
        tangent = np.column_stack([normal[:, 1], -normal[:, 0]])
        pushed = found.normal_impulses[:, None] * normal + found.tangent_impulses[:, None] * tangent
        change = mass @ (found.velocities - state.bodies.velocity - state.dt * np.array(state.world.gravity))
        scale = 1.0 + np.abs(pushed).sum() + mass @ np.abs(state.bodies.velocity).sum(axis=1)
        np.testing.assert_allclose(change, -pushed[wall].sum(axis=0), atol=1e-12 * scale)
    # The same bits again, and from a file.
    for same in (state, parse_state(format_state(state), "memory")):
        assert_same_bits(dc.simulate(same, steps=6, **options).state, after)
