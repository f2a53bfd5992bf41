"""Bounces on moving segments and fixed circles, and under pushes, at e > 0 and in every division of a step.

All tests but the slow ones share one compiled kind of step.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.solvers import METHODS as SOLVERS

WHOLE = dc.PGS(sweeps=20, tolerance=None)
DIVISIONS = {"whole": WHOLE, "substeps": replace(WHOLE, substeps=4), "by motion": replace(WHOLE, most_substeps=16)}
FREE = {"gravity": (0.0, 0.0), "friction": 0.4, "box": (-50.0, -50.0, 50.0, 50.0)}
ANGLES = [0.0, 0.7, *(pytest.param(k * math.pi, marks=pytest.mark.slow) for k in (0.5, 1.0, -0.5))]


def ground_velocity(state, body, place):
    """Velocity, m/s, of a segment or a fixed circle of a state at a place, by its own motion."""
    n = state.bodies.count
    if body < n:
        arm = place - state.bodies.position[body]
        return state.bodies.velocity[body] + state.bodies.spin[body] * np.array([-arm[1], arm[0]])
    world = state.world
    (first, last), (w_0, w_1) = (
        np.reshape(of[body - n - 4], (2, 2)) for of in (world.segments, world.segment_velocities)
    )
    share = np.clip((place - first) @ (last - first) / ((last - first) @ (last - first)), 0.0, 1.0)
    return w_0 + share * (w_1 - w_0)


def turned(angle):
    """A unit vector, and the one to its left."""
    along = np.array([math.cos(angle), math.sin(angle)])
    return along, np.array([-along[1], along[0]])


def bar(at, along, *velocities, half=3.0):
    """A segment around a point, along a unit vector, whose ends have these velocities: options of `World`."""
    at, along = np.array(at), np.array(along)
    return {"segments": [(at - half * along, at + half * along)], "segment_velocities": [velocities]}


# ---- one hit ----

THINGS = "wall that turns", "peg", "peg before the ball", "roller that moves", "roller before the ball"


def hit(thing, angle, e, *, dt=0.005, **changes):
    """A ball that comes from `angle` and meets a thing at the origin, and what the thing is: (scene, index of ball)."""
    out, left = turned(angle)
    world = FREE | {"restitution": e} | changes
    ball = {"position": 1.2 * out + 0.15 * left, "velocity": -4.0 * out + 1.0 * left, "spin": 2.0, "radius": 0.5}
    if thing == "wall that turns":
        moving = bar((0.5 * out), left, 1.5 * out - 0.6 * left, 0.5 * out + 0.2 * left)
        return circles_at([ball.pop("position")], **{k: [v] for k, v in ball.items()}, dt=dt, **world, **moving), 0
    speed, spin = ((1.0 * out - 0.5 * left), -3.0) if thing.startswith("roller") else (np.zeros(2), 0.0)
    fixed = {"position": 0.1 * out, "velocity": speed, "spin": spin, "radius": 0.4}
    order = (fixed, ball) if "before" in thing else (ball, fixed)
    columns = {name: [one[name] for one in order] for name in ball}
    is_fixed = [one is fixed for one in order]
    return circles_at(columns.pop("position"), **columns, fixed=is_fixed, dt=dt, **world), is_fixed.index(False)


def velocity_there(state, ball, place):
    """Velocity, m/s, at a place of what is not the ball: by its own motion."""
    if state.bodies.count == 1:
        (segment,), (ends,) = state.world.segments, state.world.segment_velocities
        first, last = np.reshape(segment, (2, 2))
        share = (place - first) @ (last - first) / ((last - first) @ (last - first))
        return np.array(ends[:2]) + share * (np.array(ends[2:]) - ends[:2])
    arm = place - state.bodies.position[1 - ball]
    return state.bodies.velocity[1 - ball] + state.bodies.spin[1 - ball] * np.array([-arm[1], arm[0]])


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("e", [0.5, 1.0])
@pytest.mark.parametrize("thing", THINGS)
def test_a_hit_under_a_push_obeys_newton_and_coulomb_and_its_work_is_accounted_for(thing, e, angle):
    # At the hit the velocity is that of half a step earlier, so half a step of the push comes before it.
    scene, ball = hit(thing, angle, e)
    n, m, inertia, dt = scene.bodies.count, scene.bodies.mass[ball], scene.bodies.inertia[ball], scene.dt
    force, torque = np.array([3.0, -2.0]), 0.7
    push = np.zeros((n, 2)) + force, np.zeros(n) + torque
    run = dc.simulate(scene, steps=60, solver=WHOLE, push=push, record=1, forces=True)
    path, taken = run.trajectory, []
    for k in range(60):
        before, v, w = path[k], path.velocities[k : k + 2, ball], path.spins[k : k + 2, ball]
        impulse, turn = m * (v[1] - v[0]) - dt * force, inertia * (w[1] - w[0]) - dt * torque
        np.testing.assert_allclose(np.diff(run.on_circles[k : k + 2, ball], axis=0)[0], impulse, atol=1e-12)
        if np.abs(impulse).max() < 1e-9:
            taken.append(0.0)
            assert turn == pytest.approx(0.0, abs=1e-12)
            continue
        place = before.contacts.position[0]
        normal = place - before.bodies.position[ball]
        arm = 0.5 + 0.5 * before.contacts.separation[0]
        normal /= np.linalg.norm(normal)
        tangent = np.array([-normal[1], normal[0]])
        slip = [
            velocity + arm * spin * tangent - velocity_there(before, ball, place)
            for velocity, spin in (
                (v[0] + 0.5 * dt * force / m, w[0]),
                (v[0] + 0.5 * dt * force / m + impulse / m, w[0] + turn / inertia),
            )
        ]
        assert slip[0] @ normal > 1.0
        assert slip[1] @ normal == pytest.approx(-e * (slip[0] @ normal), rel=1e-9)
        p_n, p_t = -impulse @ normal, impulse @ tangent
        assert turn == pytest.approx(arm * p_t, abs=1e-9)
        sticking = abs(slip[0] @ tangent) / (1.0 / m + arm**2 / inertia)
        assert abs(p_t) == pytest.approx(min(0.4 * p_n, sticking), rel=1e-9)
        assert p_t * (slip[0] @ tangent) < 0.0
        taken.append(-impulse @ (slip[0] + slip[1]) / 2.0)
    assert np.count_nonzero(taken) == 1
    np.testing.assert_allclose(path.dissipated, taken, atol=1e-9)


@pytest.mark.parametrize("division", DIVISIONS)
@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("thing", ["wall", "paddle", "paddle before the ball"])
def test_what_comes_gives_its_velocity_times_one_and_e_whatever_divides_the_step(thing, angle, e, division):
    """v⁺ = W + e (W − v), P = m (v⁺ − v); the work is P W, of which contacts take m (1 − e²) (W − v)² / 2."""
    out, left = turned(angle)
    comes, flies = 9.0, -2.0
    world, after = FREE | {"restitution": e}, comes + e * (comes - flies)
    if thing == "wall":
        wall = bar(-0.3 * out, left, comes * out, comes * out)
        scene, ball = circles_at([0.8 * out], radius=0.5, velocity=[flies * out], **wall, **world), 0
    else:
        order = [0, 1] if thing == "paddle" else [1, 0]
        place, speed = np.array([0.8 * out, -0.7 * out])[order], np.array([flies * out, comes * out])[order]
        fixed = (np.array([False, True])[order]).tolist()
        scene, ball = circles_at(place, radius=0.5, velocity=speed, fixed=fixed, **world), order.index(0)
    run = dc.simulate(scene, steps=40, solver=DIVISIONS[division], record=20, forces=True)
    m = scene.bodies.mass[ball]
    p = m * (after - flies)
    np.testing.assert_allclose(run.state.bodies.velocity[ball], after * out, atol=1e-9)
    np.testing.assert_allclose(run.on_circles[-1][ball], p * out, rtol=1e-9, atol=1e-9)
    received = run.loads[-1][4] if thing == "wall" else run.on_circles[-1][1 - ball]
    np.testing.assert_allclose(received, -p * out, rtol=1e-9, atol=1e-9)
    assert run.trajectory.work[-1] == pytest.approx(p * comes, rel=1e-9)
    assert run.trajectory.dissipated.sum() == pytest.approx(0.5 * m * (1.0 - e**2) * (comes - flies) ** 2, abs=1e-8)
    if division == "by motion":
        assert run.substeps.max() > 1


# ---- bounces that go on ----

GROUNDS = {
    "floor": {"box": (-9.0, 0.0, 9.0, 9.0)},
    "segment": {"segments": [((-3.0, 0.0), (3.0, 0.0))]},
    "platform": bar((0.0, 0.0), (1.0, 0.0), (0.0, 0.4), (0.0, 0.4)),
    "peg": {"fixed": 0.0},
    "lift": {"fixed": 0.4},
    "lift that sinks": {"fixed": -0.3},
}
FALLS = {"gravity": (-10.0, 0.0), "push": (0.0, -10.0), "both": (-25.0, 15.0)}


@pytest.mark.parametrize("division", DIVISIONS)
@pytest.mark.parametrize("fall", FALLS)
@pytest.mark.parametrize("ground", GROUNDS)
def test_elastic_bounces_keep_their_height_above_what_rests_and_what_rises(ground, fall, division):
    """In the frame of a ground of constant velocity. The fall is that of gravity, of a push of m a, or of both."""
    (gravity, pushed), above, ground = FALLS[fall], 1.5, dict(GROUNDS[ground])
    world = {"gravity": (0.0, gravity), "restitution": 1.0, "friction": 0.4, "box": (-9.0, -9.0, 9.0, 99.0)}
    rise, speeds, fixed = ground.pop("fixed", None), [[0.0, 0.0]], [False]
    centres = [[0.0, 0.25 + above]]
    if rise is not None:
        centres, speeds, fixed = [*centres, [0.0, -0.25]], [[0.0, rise], [0.0, rise]], [False, True]
    rise = rise or ground.get("segment_velocities", [[(0.0, 0.0)]])[0][0][1]
    speeds[0] = [0.0, rise]
    scene = circles_at(centres, radius=0.25, velocity=speeds, fixed=fixed, **world | ground)
    push = np.array([0.0, pushed]) * scene.bodies.mass.max(where=~scene.bodies.is_fixed, initial=0.0)
    push = np.zeros((len(fixed), 2)) + push
    # From an apex to the ground it takes the ball 0.55 s.
    run = dc.simulate(scene, steps=290, solver=DIVISIONS[division], push=push, record=1)
    heights = run.trajectory.positions[:, 0, 1] - 0.25 - rise * run.trajectory.times
    assert heights.min() == pytest.approx(0.0, abs=0.06)
    apexes = [heights[k : k + 110].max() for k in range(60, 181, 55)]
    np.testing.assert_allclose(apexes, above, rtol=0.01)
    np.testing.assert_array_equal(run.trajectory.positions[:, 0, 0], 0.0)
    if division == "by motion":
        assert run.substeps.max() == 8  # 5.5 m/s for 0.01 s are 7.3 reaches
    if rise == 0.0 and fall == "gravity":
        assert run.trajectory.dissipated.sum() == pytest.approx(0.0, abs=0.02 * 10.0 * above * scene.bodies.mass[0])


@pytest.mark.parametrize("pull", [-20.0, 0.0, 9.81])
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("speed", [8.0, 90.0])
@pytest.mark.parametrize("thing", ["pegs", "segments", "walls that go along"])
def test_an_elastic_ball_between_two_things_keeps_its_energy_slow_or_fast(thing, speed, angle, pull):
    """Under gravity along its line, in the frame of what goes along at 0.5 m/s. It turns round five times."""
    out, left = turned(angle)
    own = 0.5 if "along" in thing else 0.0
    world = FREE | {"restitution": 1.0, "gravity": tuple(pull * out)}
    centres, fixed, radius = [0.3 * out], [False], [0.5]
    if thing == "pegs":
        centres, fixed, radius = [*centres, 4.0 * out, -4.0 * out], [False, True, True], [0.5, 1.0, 1.0]
    else:
        ends = [(at * out - 2.0 * left, at * out + 2.0 * left) for at in (3.0, -3.0)]
        world |= {"segments": ends, "segment_velocities": [(own * out, own * out)] * 2 if own else ()}
    velocity = [(speed + own) * out, *[np.zeros(2)] * (len(fixed) - 1)]
    scene = circles_at(centres, radius=radius, velocity=velocity, fixed=fixed, **world)
    push = np.zeros((len(fixed), 2))
    run = dc.simulate(scene, steps=int(2800 / speed), solver=WHOLE, push=push, record=1).trajectory
    way = run.positions[:, 0] @ out - own * run.times
    late = run.velocities[:, 0] @ out - own + 0.5 * scene.dt * pull
    energy = 0.5 * late**2 - pull * way
    np.testing.assert_allclose(energy, energy[0], rtol=1e-3)
    assert np.count_nonzero(np.diff(np.sign(late))) >= 4
    assert np.abs(way).max() < 2.6


# ---- the division by motion ----


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize(
    ("thing", "comes", "flies", "parts"),
    [
        ("wall", 7.0, 0.0, 8),  # 7 m/s for 0.01 s are 4.7 reaches of 0.03 · 0.5 m
        ("wall", 1.0, -6.0, 8),
        ("wall", 7.0, 6.0, 1),  # they come together at 1 m/s
        ("wall", 7.0, 3.5, 4),
        ("wall", -2.0, -3.0, 1),  # away from the ball, which follows
        ("wall", 0.0, -7.0, 8),
        ("first end", 14.0, 0.0, 8),  # of a wall of 6 m, before whose middle the ball is
        ("second end", 14.0, 0.0, 8),
        ("paddle", 7.0, 0.0, 8),
        ("paddle", 7.0, 6.0, 1),
        ("paddle", 0.0, -7.0, 8),
    ],
)
def test_a_step_is_divided_by_the_speed_at_which_what_moves_comes_near(thing, comes, flies, parts, angle):
    out, left = turned(angle)
    scene = {"radius": 0.5, "restitution": 0.5, **FREE}
    if thing == "paddle":
        places, speeds = [0.52 * out, -0.5 * out], [flies * out, comes * out]
        state = circles_at(places, velocity=speeds, fixed=[False, True], **scene)
    else:
        ends = {"first end": (comes * out, 0.0 * out), "second end": (0.0 * out, comes * out)}
        moving = bar(-0.02 * out, left, *ends.get(thing, (comes * out, comes * out)))
        state = circles_at([0.5 * out], velocity=[flies * out], **scene, **moving)
    run = dc.simulate(state, steps=2, solver=DIVISIONS["by motion"])
    assert run.substeps[0] == parts
    far = state.bodies._replace(position=state.bodies.position + np.outer([9.0, 0.0], out)[: state.bodies.count])
    assert dc.simulate(state.replace(bodies=far), steps=2, solver=DIVISIONS["by motion"]).substeps.tolist() == [1, 1]


# ---- what nothing moves ----


def crowd(seed, e):
    """Balls, two pegs, a roller and a paddle among them, a wall that comes and one that turns; and a push on all."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(-3.0, 4.0, 1.5), np.arange(-2.0, 3.0, 1.5)), -1).reshape(-1, 2)
    n, fixed = len(grid), np.zeros(len(grid), bool)
    fixed[[2, 7, 11, 13]] = True
    velocity, spin = rng.uniform(-3.0, 3.0, (n, 2)), rng.uniform(-3.0, 3.0, n)
    velocity[[2, 7, 11]], spin[[2, 7, 13]] = 0.0, 0.0
    walls = {
        "segments": [((-5.0, -3.0), (-5.0, 3.0)), ((4.5, -3.0), (4.0, 3.0)), ((-6.0, -4.0), (6.0, -4.2))],
        "segment_velocities": [((2.0, 0.0), (2.0, 0.0)), ((-0.2, 0.5), (0.3, 0.0)), ((0.0, 0.0), (0.0, 0.0))],
    }
    scene = circles_at(
        grid, radius=rng.uniform(0.5, 0.68, n), velocity=velocity, spin=spin, mass=rng.uniform(0.5, 5.0, n),
        fixed=fixed, gravity=(1.0, -9.81), friction=0.4, restitution=e, box=(-6.0, -5.0, 6.0, 5.0), dt=0.005, **walls,
    )  # fmt: skip
    return scene, (rng.uniform(-9.0, 9.0, (n, 2)), rng.uniform(-1.0, 1.0, n))


@pytest.mark.parametrize("division", DIVISIONS)
@pytest.mark.parametrize("speed", [1.0, 20.0, 150.0])
@pytest.mark.parametrize("e", [0.0, 0.5])
def test_a_wall_passes_over_what_is_fixed(e, speed, division):
    """And sweeps the ball behind it along: it leaves with (1 + e) times the speed of the wall."""
    centres, own = [[0.3, 0.0], [-0.2, 0.1], [2.5, 0.0]], np.array([[0.0, 0.0], [0.0, 0.7], [0.0, 0.0]])
    wall = bar((-1.0, 0.0), (0.0, 1.0), (speed, 0.0), (speed, 0.0))
    scene = circles_at(centres, radius=0.4, velocity=own, fixed=[True, True, False], restitution=e, **FREE, **wall)
    steps = math.ceil(3.8 / speed / scene.dt) + 2  # it stops in one, and is hit in the next
    run = dc.simulate(scene, steps=steps, solver=DIVISIONS[division], record=1)
    assert run.state.world.segments[0][0] == pytest.approx(-1.0 + speed * steps * scene.dt)
    ways = scene.bodies.position[:2] + run.trajectory.times[:, None, None] * own[:2]
    np.testing.assert_allclose(run.trajectory.positions[:, :2], ways, rtol=1e-12, atol=1e-12)
    assert run.state.bodies.velocity[2, 0] == pytest.approx((1.0 + e) * speed, rel=1e-6)
    assert run.state.bodies.position[2, 0] > run.state.world.segments[0][0]


@pytest.mark.parametrize("division", DIVISIONS)
@pytest.mark.parametrize("e", [0.5, 1.0])
def test_fixed_circles_go_their_way_whatever_hits_pushes_and_crosses_them(e, division):
    scene, push = crowd(1, e)
    run = dc.simulate(scene, steps=60, solver=DIVISIONS[division], push=push, record=10)
    path, fixed = run.trajectory, scene.bodies.is_fixed
    assert (np.abs(run.on_circles[-1][fixed]).max(axis=1) > 1.0).sum() > 1
    start, times = scene.bodies, path.times[:, None]
    ways = start.position[fixed] + times[:, :, None] * start.velocity[fixed]
    np.testing.assert_allclose(path.positions[:, fixed], ways, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(path.positions[:, [2, 7, 11]], np.stack([start.position[[2, 7, 11]]] * len(path)))
    np.testing.assert_allclose(path.angles[:, fixed], times * start.spin[fixed], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(path.velocities[:, fixed], np.stack([start.velocity[fixed]] * len(path)))
    np.testing.assert_array_equal(path.spins[:, fixed], np.stack([start.spin[fixed]] * len(path)))


@pytest.mark.parametrize(
    "seed", [1, 2]
)  # where no ball is pressed between a wall and a peg: it is hit 50,000 times a step
@pytest.mark.parametrize("division", ["whole", "substeps"])
@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_what_all_give_each_other_adds_up_to_nothing_and_changes_momentum(e, division, seed):
    """m Δv = P + (F + m g) Δt of each ball, and Σ P = 0 with what walls, segments and fixed circles receive."""
    scene, push = crowd(seed, e)
    run = dc.simulate(scene, steps=80, solver=DIVISIONS[division], push=push, record=8, forces=True)
    free, mass = ~scene.bodies.is_fixed, scene.bodies.free_mass[:, None]
    times = run.trajectory.times[:, None, None]
    gained = mass * (run.trajectory.velocities - scene.bodies.velocity)
    given = run.on_circles + times * (push[0] + mass * scene.world.gravity)
    largest = np.abs(run.on_circles).max()
    assert largest > 5.0
    np.testing.assert_allclose(given[:, free], gained[:, free], atol=1e-9 * largest)
    np.testing.assert_allclose(run.on_circles.sum(axis=1) + run.loads.sum(axis=1), 0.0, atol=1e-9 * largest)
    for index in (0, 2, 13):  # a ball, a peg and a paddle
        force = np.diff(run.on_circles[:, index], axis=0) / np.diff(run.trajectory.times)[:, None]
        np.testing.assert_allclose(run.force_on("circle", index), force, rtol=1e-12)
    loads = np.diff(run.loads[:, 4:6].sum(axis=1), axis=0)
    np.testing.assert_allclose(8 * scene.dt * run.force_on("segment", [0, 1]), loads, atol=1e-9 * largest)


@pytest.mark.parametrize("division", DIVISIONS)
@pytest.mark.parametrize("e", [0.0, 0.7])
@pytest.mark.parametrize("frame", [(64.0, -32.0), (1024.0, 0.0)])
def test_in_a_container_that_moves_evenly_all_happens_as_at_rest(frame, e, division):
    """Four walls, six balls and a peg among them, under gravity. Paths relative to the walls are the same."""
    rng, (w, h) = np.random.default_rng(9), (3.5, 2.5)
    corners = np.array([(-w, -h), (w, -h), (w, h), (-w, h)])
    walls = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    place = np.array([(-2.4, -1.5), (-1.0, 0.4), (0.6, -1.6), (2.2, -0.8), (0.9, 1.2), (-2.2, 1.5), (2.4, 1.6)])
    speeds, fixed, ways = rng.uniform(-3.0, 3.0, (7, 2)), np.arange(7) == 3, []
    speeds[3] = 0.0
    for v in (np.zeros(2), np.array(frame)):
        world = FREE | {"box": (-1e5, -1e5, 1e5, 1e5), "gravity": (2.0, -9.81), "restitution": e}
        scene = circles_at(
            place, velocity=speeds + v, radius=0.6, fixed=fixed, dt=1.0 / 128.0,
            segments=walls, segment_velocities=np.tile(v, (4, 2, 1)), **world,
        )  # fmt: skip
        run = dc.simulate(scene, steps=60, solver=DIVISIONS[division], record=1).trajectory
        ways.append(run.positions - run.times[:, None, None] * v)
    assert np.abs(ways[0][-1] - place).max() > 0.5
    np.testing.assert_allclose(ways[1], ways[0], rtol=0.0, atol=1e-9)


METHODS = {**{name: {"solver": solver} for name, solver in DIVISIONS.items()}, "preset": {"accuracy": "fast"}}
METHODS["resolved"] = {"solver": replace(WHOLE, sweeps=3000, tolerance=1e-8)}
OTHERS = {name: {"solver": of(sweeps=20, tolerance=None)} for name, of in SOLVERS.items() if name != "PGS"}
OF_ALL = METHODS | OTHERS
# Each of the others is a kind of step to compile; test_without_compiler.py runs them interpreted.
SOLVERS_TOO = [*METHODS, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)]


@pytest.mark.parametrize("method", SOLVERS_TOO)
@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("speed", [5.0, 25.0])
def test_what_moves_does_the_work_of_its_force_along_its_way_however_a_step_is_divided(speed, e, method):
    """Without a push, and if nothing fixed turns: W = −Σ P · V, with P what a wall or a fixed circle receives."""
    scene, _ = crowd(5, e)
    fixed, own = scene.bodies.is_fixed, np.array([[2.0, 0.0], [-0.2, 0.5], [0.0, 0.0]])
    bodies = scene.bodies._replace(
        velocity=np.where(fixed, 1.0, speed)[:, None] * scene.bodies.velocity,
        spin=np.where(fixed, 0.0, scene.bodies.spin),
    )
    world = replace(scene.world, segment_velocities=np.stack([own, own], axis=1))
    scene = scene.replace(world=world, bodies=bodies)
    run = dc.simulate(scene, steps=30, record=1, forces=True, **OF_ALL[method])
    walls, rollers = np.diff(run.loads[:, 4:], axis=0), np.diff(run.on_circles[:, fixed], axis=0)
    work = -(walls * own).sum(axis=(1, 2)) - (rollers * bodies.velocity[fixed]).sum(axis=(1, 2))
    energy = 0.5 * bodies.free_mass @ (bodies.velocity**2).sum(axis=1)
    assert np.abs(work).max() > 1.0
    np.testing.assert_allclose(np.diff(run.trajectory.work), work, atol=1e-12 * energy)


@pytest.mark.parametrize("method", SOLVERS_TOO)
@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(("seed", "speed"), [(1, 5.0), (5, 25.0), (6, 25.0)])
def test_the_energy_of_each_step_changes_by_the_work_that_its_record_gives(seed, speed, e, method):
    """With v̄ the mean of the velocities before and after a step: ΔE = Σ P · v̄ + L ω̄ of gravity, pushes and contacts.

    Of divided steps the part of the translations holds. `work` and `dissipated` are told by undivided steps: the power
    of a push ends before what stops a fast circle, and moving things work by the impulses that they receive. At e = 0
    contacts that are solved take energy; those of a few sweeps may give some. There is a torque at e = 0 alone, since
    rebounds come before it.
    """
    (scene, (force, torque)), seen = crowd(seed, e), []
    torque = torque * (e == 0.0)
    bodies, dt, g = scene.bodies, scene.dt, np.array(scene.world.gravity)
    free, n = ~bodies.is_fixed, bodies.count
    bodies = bodies._replace(velocity=np.where(free[:, None], speed, 1.0) * bodies.velocity)
    mass, inertia = bodies.free_mass[:, None], np.where(free, bodies.inertia, 1.0)
    run = dc.simulate(
        scene.replace(bodies=bodies), steps=30, record=1, push=(force, torque),
        on_step=lambda *solved: seen.append(solved), **OF_ALL[method],
    )  # fmt: skip
    path, parts, contacts_met = run.trajectory, run.substeps, 0
    energy = 0.5 * (mass[:, 0] * (bodies.velocity**2).sum(axis=1)).sum()
    for k, (before, record) in enumerate(seen):
        c = before.contacts
        contacts_met += np.count_nonzero(c.normal_impulse)
        tangent = np.column_stack([c.normal[:, 1], -c.normal[:, 0]])
        given = c.normal_impulse[:, None] * c.normal + c.tangent_impulse[:, None] * tangent
        of_circles, turns, pair = np.zeros((n + 1, 2)), np.zeros(n + 1), np.minimum(c.body_b, n)
        np.add.at(of_circles, c.body_a, -given)
        np.add.at(of_circles, pair, given)
        for body, radius in ((c.body_a, bodies.radius[c.body_a]), (pair, np.append(bodies.radius, 0.0)[pair])):
            np.add.at(turns, body, (radius + 0.5 * c.separation) * c.tangent_impulse)
        shifts = np.zeros((n, 2)) if record.shifts is None else record.shifts
        (v_0, v_1), (w_0, w_1) = path.velocities[k : k + 2], path.spins[k : k + 2]
        v, w = 0.5 * (v_0 + v_1), 0.5 * (w_0 + w_1)
        changed = (mass * v * (v_1 - v_0))[free].sum()
        told = (of_circles[:n] + shifts + dt * (mass * g + force))[free]
        assert changed == pytest.approx((told * v[free]).sum(), abs=1e-12 * energy)
        np.testing.assert_allclose((mass * (v_1 - v_0))[free], told, atol=1e-12 * np.abs(mass * v_0).max())
        if parts[k] > 1 or OF_ALL[method].get("solver", WHOLE).substeps > 1:
            continue
        turned = (dt * torque + turns[:n])[free]
        np.testing.assert_allclose((inertia * (w_1 - w_0))[free], turned, atol=1e-9)
        early = (v - 0.5 * shifts / np.where(mass > 0.0, mass, 1.0))[free]
        work = dt * ((force[free] * early).sum() + (torque * w)[free].sum())
        grounds = np.zeros((len(given), 2)), np.zeros((len(given), 2))
        for ground, body in zip(grounds, (c.body_a, c.body_b)):
            for i in np.flatnonzero((body >= n + 4) | np.append(bodies.is_fixed, False)[np.minimum(body, n)]):
                ground[i] = ground_velocity(before, body[i], c.position[i])
        of_grounds = (given * (grounds[0] - grounds[1])).sum()
        assert path.work[k + 1] - path.work[k] == pytest.approx(work + of_grounds, abs=1e-12 * energy)
        corrected = path.positions[k + 1] - path.positions[k] - dt * v_1
        taken = work + of_grounds + (mass * corrected @ g)[free].sum() - turned @ w[free]
        taken -= ((of_circles[:n] + shifts + dt * force)[free] * v[free]).sum()
        assert path.dissipated[k] == pytest.approx(taken, abs=1e-12 * energy)
        if e == 0.0 and method == "resolved":
            middle = (v + 0.5 * (dt * (g + force / np.where(mass > 0.0, mass, 1.0))))[free] - (v[free] - early)
            spun = (w + 0.5 * dt * torque / inertia)[free]
            lost = of_grounds - (of_circles[:n][free] * middle).sum() - turns[:n][free] @ spun
            assert lost > -1e-6 * energy
    assert contacts_met > 10
