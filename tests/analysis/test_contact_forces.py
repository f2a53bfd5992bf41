"""Forces against momentum and statics: what contacts do to circles and walls, whatever the scene requires."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.accuracy.presets import PRESETS

SEGMENTS = {"segments": [((0.0, 5.0), (5.0, 1.0)), ((5.0, 1.0), (12.0, 1.5))]}
KINDS = {
    "walls": ({}, {}),
    "segments": (SEGMENTS, {}),
    "belts": (SEGMENTS | {"surface_speeds": [3.0, -2.0]}, {}),
    "rebounds": (SEGMENTS | {"restitution": 0.6}, {}),
    "frictionless": ({"friction": 0.0}, {}),
    "substeps": (SEGMENTS, {"substeps": 2}),
    "divided by motion": ({"restitution": 0.3}, {"substeps": 2, "most_substeps": 16}),
    "islands": (SEGMENTS, {"islands": True}),
}


def scene(kind, seed):
    """Twelve circles of random sizes, masses and velocities above the floor of a box, and a solver."""
    rng, (world, solver) = np.random.default_rng(seed), KINDS[kind]
    position = np.stack(np.meshgrid(np.arange(2.0, 11, 2.2), [2.8, 5.0, 7.2]), axis=-1).reshape(-1, 2)[:12]
    position += rng.uniform([-0.3, 2.7], [0.3, 3.3], position.shape)
    bodies = {"velocity": rng.normal(0, 3, (12, 2)), "spin": rng.normal(0, 2, 12), "mass": rng.uniform(0.5, 2, 12)}
    bodies |= {"radius": rng.uniform(0.5, 1.0, 12)}
    return circles_at(position, box=(0.0, 0.0, 12.0, 14.0), **bodies, **world), dc.PGS(sweeps=12, **solver)


UNDIVIDED = ["walls", "segments", "belts", "rebounds", "frictionless", "substeps"]


@pytest.mark.parametrize("kind", [*UNDIVIDED, pytest.param("islands", marks=pytest.mark.slow)])
def test_net_forces_and_torques_are_changes_of_momentum(kind):
    """F = m Δv / Δt − m g and τ = I Δω / Δt of 29 states of each kind, over whole steps."""
    for seed in range(29):
        state, solver = scene(kind, seed)
        state = dc.simulate(state, steps=10 + 8 * seed, solver=solver).state
        seen: list = []
        after = dc.simulate(state, steps=1, on_step=lambda *solved, seen=seen: seen.append(solved[0])).state.bodies
        found, mass = dc.forces(seen[0]), state.bodies.mass[:, None]
        net = mass * ((after.velocity - state.bodies.velocity) / state.dt - state.world.gravity)
        torque = state.bodies.inertia * (after.spin - state.bodies.spin) / state.dt
        largest = max(9.81, np.abs(net).max(), np.abs(found.contact).max(initial=0.0))
        np.testing.assert_allclose(found.net, net, rtol=0, atol=1e-9 * largest)
        # The arms of a contact change from one substep to the next.
        arms = 1e-9 if solver.substeps == 1 else 0.1
        np.testing.assert_allclose(found.torque, torque, rtol=0, atol=arms * largest)
        static = sum(found.walls.values()) + found.segments.sum(axis=0)
        assert len(seen) == 1
        np.testing.assert_allclose(found.net.sum(axis=0), -static, rtol=0, atol=1e-9 * largest)


def cross(r, p):
    """r × p of vectors in the plane, (k, 2) each."""
    return r[:, 0] * p[:, 1] - r[:, 1] * p[:, 0]


def moved(kind, seed):
    """A `scene` with moving and dragging segments, pegs, rollers, forces and torques: (state, push)."""
    rng, state = np.random.default_rng(seed), scene(kind, seed)[0]
    world = {"segments": SEGMENTS["segments"], "surface_speeds": [3.0, -2.0]}
    world["segment_velocities"] = [((0.0, 0.2), (0.1, 0.3)), ((0.1, 0.3), (0.0, -0.2))]
    is_fixed, is_peg = np.arange(12) % 6 == 0, np.arange(12) == 0
    bodies = state.bodies._replace(
        mass=np.where(is_fixed, np.inf, state.bodies.mass),
        velocity=np.where(is_peg[:, None], 0.0, state.bodies.velocity),
        spin=np.where(is_peg, 0.0, state.bodies.spin),
    )
    push = rng.normal(0, 5, (12, 2)), rng.normal(0, 5, 12)
    return state.replace(world=replace(state.world, **world), bodies=bodies), push


@pytest.mark.parametrize("kind", ["walls", "rebounds", pytest.param("frictionless", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "solver", [dc.PGS, *(pytest.param(of, marks=pytest.mark.slow) for of in (dc.BatchedPGS, dc.PSOR))]
)
def test_contacts_of_a_step_give_momentum_and_angular_momentum_to_rounding(kind, solver):
    """Σ of the positions, normals, λ_n and λ_t of `on_step`'s contacts, in undivided steps.

    m Δv = Σ P + (m g + f) Δt + shifts and x × m Δv + I Δω = Σ c × P + x × ((m g + f) Δt + shifts) + τ Δt. c: contact
    point. x: centre before the step.
    """
    touched = np.zeros(4, int)
    for seed in range(4):
        state, (force, torque) = moved(kind, seed)
        seen, free = [], ~state.bodies.is_fixed
        live = dc.Simulator(
            state, solver=solver(sweeps=12), push=(force, torque), on_step=lambda *step, seen=seen: seen.append(step)
        )
        for _ in range(120):
            live.step()
            (solved, record), after, n = seen[-1], live.state.bodies, 12
            before, c, mass = solved.bodies, solved.contacts, np.where(free, state.bodies.mass, 0.0)
            other = mass[:, None] * state.world.gravity * state.dt + np.where(free[:, None], force, 0.0) * state.dt
            other += 0.0 if record.shifts is None else record.shifts
            tangent = np.column_stack([c.normal[:, 1], -c.normal[:, 0]])
            impulse = c.normal_impulse[:, None] * c.normal + c.tangent_impulse[:, None] * tangent
            given, turned, about = other, torque * state.dt * free, cross(before.position, other)
            for body, sign in ((c.body_a, -1.0), (c.body_b, 1.0)):
                of_circle = (body < n) & free[np.minimum(body, n - 1)]
                on, which = sign * impulse[of_circle], body[of_circle]
                np.add.at(given, which, on)
                np.add.at(about, which, cross(c.position[of_circle], on))
            change = mass[:, None] * (after.velocity - before.velocity)
            spun = 0.5 * mass * before.radius**2 * (after.spin - before.spin)
            largest = max(1.0, np.abs(impulse).max(initial=0.0), np.abs(change).max())
            np.testing.assert_allclose(given, change, rtol=0, atol=1e-13 * 100 * largest)
            expected = cross(before.position, change) + spun
            np.testing.assert_allclose(about + turned, expected, rtol=0, atol=1e-13 * 1000 * largest)
            wall = c.body_b - n
            touched += (c.normal_impulse > 0) @ np.column_stack(
                [wall < 0, (wall >= 0) & (wall < 4), wall >= 4, ~free[np.where(wall < 0, c.body_b, c.body_a)]]
            )
    assert (touched > 20).all()  # circles, walls, segments, fixed circles


@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_torques_of_a_divided_step_are_those_at_the_places_where_its_contacts_began(restitution):
    """I Δω is within |P| times the way that the two bodies of a contact make relative to each other in the step.

    In a divided step a contact point moves from substep to substep, and the record has one point. m Δv is exact.
    """
    solver, largest = dc.PGS(sweeps=12, substeps=4), 0.0
    for seed in range(3):
        state, seen = scene("segments", seed)[0], []
        state = state.replace(world=replace(state.world, restitution=restitution))
        run = dc.simulate(state, steps=300, solver=solver, on_step=lambda solved, _, seen=seen: seen.append(solved))
        for solved, after in zip(seen, [*(one.bodies for one in seen[1:]), run.state.bodies]):
            before, c = solved.bodies, solved.contacts
            turned = before.inertia * (after.spin - before.spin) / state.dt
            error = np.abs(dc.forces(solved).torque - turned)
            size = np.hypot(c.normal_impulse, c.tangent_impulse) / state.dt
            speeds = [np.hypot(*one.velocity.T) + before.radius * np.abs(one.spin) for one in (before, after)]
            way = state.dt * 2.0 * (np.max(speeds) + state.dt * 9.81)
            bound = np.zeros(12)
            for body in (c.body_a, c.body_b):
                np.add.at(bound, body[body < 12], way * size[body < 12])
            assert (error <= bound + 1e-9).all()
            largest = max(largest, error.max())
    assert largest > 1e-6  # it is an error, though a small one


@pytest.mark.parametrize("restitution", [0.0, 0.6])
@pytest.mark.parametrize("method", [*PRESETS, dc.BatchedPGS(sweeps=12, substeps=2, most_substeps=8)], ids=str)
def test_impulses_of_a_step_are_the_change_of_momentum_whatever_divides_it(method, restitution):
    """m Δv = Σ λ over all substeps and rebounds, without gravity; contacts that come during a step are among them."""
    seen, (state, _) = [], scene("segments", 5)
    state = state.replace(world=replace(state.world, gravity=(0.0, 0.0), restitution=restitution))
    options = {"accuracy": method} if isinstance(method, str) else {"solver": method}
    run = dc.simulate(state, steps=60, record=20, forces=True, on_step=lambda solved, _: seen.append(solved), **options)
    later = [*(one.bodies.velocity for one in seen[1:]), run.state.bodies.velocity]
    assert run.substeps.max() > 1 or isinstance(method, str)
    assert max(np.abs(one.contacts.normal_impulse).max(initial=0.0) for one in seen) > 1
    for one, velocity in zip(seen, later):
        gained = state.bodies.mass[:, None] * (velocity - one.bodies.velocity)
        np.testing.assert_allclose(state.dt * dc.forces(one).net, gained, rtol=0, atol=1e-12 * 100)
    assert list(run.solved) == seen[19::20]


@pytest.mark.parametrize("accuracy", PRESETS)
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_the_impulse_of_an_impact_can_be_read_whenever_in_the_step_it_comes(accuracy, restitution):
    """m Δv, of one disc that meets the floor at 8 m/s at any time of a step."""
    for phase in np.linspace(0.0, 0.92, 12):
        height, total = 1.01 + 0.08 * (3 + phase), []
        state = circles_at([[15, height]], velocity=[[0, -8.0]], gravity=(0, 0), restitution=restitution)
        see = lambda seen, _, total=total: total.append(seen.contacts.normal_impulse.sum())  # noqa: E731
        after = dc.simulate(state, steps=12, accuracy=accuracy, on_step=see).state.bodies
        assert sum(total) == pytest.approx(np.pi * (8.0 + after.velocity[0, 1]), rel=1e-12)
        assert after.velocity[0, 1] == pytest.approx(8.0 * restitution, abs=0.5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("solver", [dc.PGS, dc.BatchedPGS])
def test_walls_and_segments_receive_what_circles_give_over_all_steps_substeps_and_rebounds(kind, solver):
    """Newton's third law, for means between recorded states."""
    state, options = scene(kind, 3)
    if solver is dc.BatchedPGS:
        options = dc.BatchedPGS(sweeps=12, substeps=options.substeps, most_substeps=options.most_substeps)
    run = dc.simulate(state, steps=60, solver=options, record=7, forces=True)
    on_circles = run.force_on("circle", range(12))
    static = sum(run.force_on(wall) for wall in ("floor", "right", "ceiling", "left"))
    if state.world.segments:
        static = static + run.force_on("segment", [0, 1])
    assert np.abs(on_circles).max() > 10
    # Where motion divides a step, e > 0, and a circle lands, its velocity is that of half a step's fall later.
    landing = state.bodies.mass.sum() * 9.81 / 14 if kind == "divided by motion" else 0.0
    np.testing.assert_allclose(static, -on_circles, rtol=0, atol=1e-9 * np.abs(on_circles).max() + landing)
    assert dc.simulate(state, steps=60, solver=options).state == run.state


@pytest.mark.parametrize("start", ["builtin", "support"])
@pytest.mark.parametrize("options", [{"sleep": True}, {"sleep": False}])
def test_a_pile_at_rest_loads_its_box_with_its_weight_and_so_it_does_asleep(start, options):
    state = dc.simulate(dc.lattice_in_box(30, seed=1), steps=900, solver=dc.PGS()).state
    weight = 9.81 * state.bodies.mass.sum()
    run = dc.simulate(state, steps=100, solver=dc.PGS(), warm_start=start, record=50, forces=True, **options)
    walls = ("floor", "right", "ceiling", "left")
    for load in (sum(run.force_on(wall)[-1] for wall in walls), sum(dc.forces(run.state).walls.values())):
        np.testing.assert_allclose(load, [0.0, -weight], rtol=0, atol=1e-3 * weight)
    assert -run.force_on("floor")[-1, 1] > 0.9 * weight


def test_a_start_that_builds_the_problem_misses_no_rebound():
    state, solver = scene("rebounds", 0)
    run = dc.simulate(state, steps=60, solver=solver, warm_start="support", record=60, forces=True)
    static = sum(run.force_on(wall) for wall in ("floor", "right", "ceiling", "left")) + run.force_on("segment", [0, 1])
    np.testing.assert_allclose(static, -run.force_on("circle", range(12)), rtol=1e-9)


def test_the_stress_of_a_disc_between_two_walls_is_that_of_the_load():
    """σ_yy = 2 F / (π r) of a disc that carries F, and 0 across; the mean over cells keeps Σ A σ."""
    state = dc.simulate(dc.column(3, friction=0.5), steps=400, solver=dc.PGS()).state
    bodies = state.bodies
    load = 9.81 * np.array([2.5, 1.5, 0.5]) * bodies.mass  # the mean of what is above and below
    order = np.argsort(bodies.position[:, 1])
    sigma = dc.stress(state)[order]
    np.testing.assert_allclose(sigma[:, 1, 1], 2 * load / (np.pi * bodies.radius), rtol=2e-3)
    np.testing.assert_allclose(sigma[:, [0, 0, 1], [0, 1, 0]], 0.0, atol=1e-2)
    area = np.pi * bodies.radius**2
    for spacing in (1.0, 7.3):
        total = dc.mean_stress(state, spacing).sum(axis=(0, 1)) * spacing**2
        np.testing.assert_allclose(total, np.einsum("i,ijk->jk", area, dc.stress(state)), rtol=1e-12)


def test_rows_of_the_stress_are_arms_and_columns_forces():
    """σ = −l ⊗ f / (π r²) at one contact below a circle: l = (0, −r), so that its first row is 0."""
    state = dc.find_contacts(circles_at([[7.0, 1.01 - 1e-9]], box=(0.0, 0.0, 10.0, 4.0)))
    contacts = state.contacts._replace(normal_impulse=np.array([0.03]), tangent_impulse=np.array([0.01]))
    state = state.replace(contacts=contacts)
    np.testing.assert_allclose(dc.forces(state).net, [[1.0, 3.0]])
    np.testing.assert_allclose(dc.stress(state), np.array([[[0.0, 0.0], [1.0, 3.0]]]) / np.pi, atol=1e-8)
    mean = dc.mean_stress(state, 2.0)  # 5 columns and 2 rows from the bottom, of 4 m²
    assert mean.shape == (2, 5, 2, 2)
    np.testing.assert_allclose(mean[0, 3], [[0.0, 0.0], [0.25, 0.75]], atol=1e-8)
    assert np.count_nonzero(mean.any(axis=(2, 3))) == 1


def test_circles_that_fly_dissipate_nothing_and_a_fall_dissipates_its_height():
    fall = circles_at([[15.0, 20.0], [5.0, 8.0]], velocity=[1.0, 0.0])
    flight = dc.simulate(fall, steps=60, solver=dc.PGS(substeps=2), record=10).trajectory
    np.testing.assert_allclose(flight.dissipated, 0.0, atol=1e-9)
    run = dc.simulate(circles_at([[15.0, 8.0]]), steps=300, solver=dc.PGS(), record=100).trajectory
    np.testing.assert_allclose(run.dissipated.sum(), np.pi * 9.81 * 7.0, rtol=0.02)


def test_neighbours_coordination_and_table_name_what_touches(tmp_path):
    world = {"box": (0.0, 0.0, 10.0, 10.0), "segments": [((0.0, 9.0), (9.0, 9.0)), ((2.9, 0.0), (10.0, 0.01))]}
    state = dc.find_contacts(circles_at([[1.0, 1.0], [2.99, 1.0], [2.0, 2.7], [6.0, 6.0]], **world))
    assert [dc.neighbours(state, i) for i in range(4)] == [
        [1, 2, "floor", "left"],
        [0, 2, "floor", "segment 1"],
        [0, 1],
        [],
    ]
    assert dc.coordination(state).tolist() == [0, 0, 0, 0]
    state = dc.simulate(state, steps=2, solver=dc.PGS()).state
    assert dc.coordination(state).tolist() == [4, 4, 2, 0]
    table = dc.contact_table(state, tmp_path / "contacts.csv")
    np.testing.assert_array_equal(table["force_y"], dc.forces(state).contact[:, 1])
    with open(tmp_path / "contacts.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["a"]), row["b"]) for row in rows] == list(zip(table["a"], table["b"]))
    assert [float(row["force_x"]) for row in rows] == table["force_x"].tolist()
    wrong = state.replace(contacts=state.contacts._replace(body_b=state.contacts.body_b + 9))
    with pytest.raises(ValueError, match=r"contacts.body_b\[0\]: expected"):
        dc.forces(wrong)
    with pytest.raises(ValueError, match="circle: expected"):
        dc.neighbours(state, 4)


@pytest.mark.parametrize("columns", [0, 1, 3])
def test_normals_of_other_dimensions_are_refused(columns):
    """With one column what lay behind the array was read."""
    state = dc.simulate(dc.column(3), steps=5).state
    wrong = state.contacts._replace(normal=np.ones((state.contacts.count, columns)))
    with pytest.raises(ValueError, match=r"contacts\.normal: expected"):
        dc.forces(state.replace(contacts=wrong))
