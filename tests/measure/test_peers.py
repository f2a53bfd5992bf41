"""The adapters to Box2D 2.3, pymunk and Box2D v3: same scene, honest recordings.

The engine is judged by the recordings (test_box2d_oracle.py), and judges them in turn: its sweeps solve the recorded
problems.
"""

import sys
from dataclasses import replace

import numpy as np
import pytest
from box2d_recorder import RecordingBox2D

from deep_contact.measure import peers
from deep_contact.state.arrays import BOTTOM, LEFT, RIGHT, TOP, WALL_NORMALS
from deep_contact.state.constants import WALL_SKIN
from deep_contact.state.fields import make_bodies
from deep_contact.state.state import State
from deep_contact.state.world import World

FLOAT32 = 1e-6
"""A few roundings of float32 (6e-8) at values of up to ten."""

pytestmark = pytest.mark.peers


@pytest.fixture(params=peers.ENGINES.values(), ids=peers.ENGINES)
def engine(request):
    pytest.importorskip(request.param.package)
    return request.param


@pytest.fixture
def box2d():
    pytest.importorskip("Box2D")
    return RecordingBox2D


def scene(position, *, box=(0, 0, 20, 30), gravity=(0, -9.81), friction=0.5, restitution=0.0, **bodies) -> State:
    world = World(box=box, gravity=gravity, friction=friction, restitution=restitution)
    return State(name="test", world=world, bodies=make_bodies(position, **bodies))


def falling_pile(seed: int, columns: int = 8, rows: int = 10, **options) -> State:
    """A loose, jittered lattice of circles of unequal size with random velocities; it falls and settles."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(1.4 + 2.4 * np.arange(columns), 1.5 + 2.4 * np.arange(rows))
    position = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-0.1, 0.1, (columns * rows, 2))
    n = position.shape[0]
    return scene(
        position,
        radius=rng.uniform(0.8, 1.05, n),
        density=rng.uniform(0.5, 2.0, n),
        velocity=rng.normal(0, 1, (n, 2)),
        spin=rng.normal(0, 1, n),
        **options,
    )


def test_world_holds_the_bodies_of_the_state(engine):
    ours = falling_pile(0, columns=3, rows=3).bodies
    theirs = engine(falling_pile(0, columns=3, rows=3)).bodies()
    for field, value in ours._asdict().items():
        np.testing.assert_allclose(getattr(theirs, field), value, rtol=FLOAT32, atol=FLOAT32, err_msg=field)


MOTIONS = {
    # v = -k g Δt exactly, and a height between the explicit and the symplectic sum of v Δt (v3 substeps).
    "free fall": (
        {"position": [[10, 20]]}, 10, {"velocity": ([0, -0.981], 1e-5), "position": ([10, 20 - 0.04905], 5e-3)},
    ),
    # Height r + skin within twice the slop of 0.005 m, which all three leave uncorrected.
    "rest": ({"position": [[10, 1 + WALL_SKIN]]}, 100, {"position": ([10, 1 + WALL_SKIN], 0.01)}),
    # Coulomb: v = v0 - μ g t while it slides; mixed as μ² (Chipmunk's product) it is off by half.
    "sliding": ({"position": [[3, 1 + WALL_SKIN]], "velocity": (8, 0)}, 30, {"velocity": ([6.5285, 0], 0.065)}),
    # Newton's e: equal masses leave with e times the speed they met with (v3 is soft: 1 %).
    "bounce": ({"position": [[8, 5], [12, 5]], "velocity": [[4, 0], [-4, 0]], "gravity": (0, 0), "restitution": 0.5,
                "friction": 0.0}, 60, {"velocity": ([[-2, 0], [2, 0]], 0.02)}),
}  # fmt: skip


@pytest.mark.parametrize("case", MOTIONS)
def test_a_motion_that_is_known(engine, case):
    given, steps, expected = MOTIONS[case]
    world = engine(scene(**given))
    world.run(steps, 0.01, 10, 3)
    for name, (value, tolerance) in expected.items():
        np.testing.assert_allclose(getattr(world.bodies(), name), np.atleast_2d(value), rtol=0, atol=tolerance)


def reported(world) -> int:
    """Touching contacts, or arbiters, of the engine's last step; a pair of circles has an arbiter at either."""
    if isinstance(world, peers.Box2D23):
        return sum(contact.touching for contact in world.world.contacts_gen)
    static, at_walls = world.space.static_body, []
    for body in world.space.bodies:
        body.each_arbiter(lambda arbiter: at_walls.append(any(one is static for one in arbiter.bodies)))
    return (len(at_walls) + sum(at_walls)) // 2


@pytest.mark.parametrize("steps", [60, 300], ids=["falling", "settled"])
@pytest.mark.parametrize("kind", [peers.Box2D23, peers.Pymunk])
def test_contacts_by_geometry_are_those_that_the_engine_reports(kind, steps):
    """Box2D finds contacts at a step's start, Chipmunk after it has moved the bodies: at a step's end."""
    pytest.importorskip(kind.package)
    world = kind(falling_pile(1))
    for _ in range(steps):
        before = world.contact_count()
        world.step(0.01, 20, 3)
    counted = before if kind is peers.Box2D23 else world.contact_count()
    # Ours are counted up to a gap (`constants.NEARLY`).
    assert counted == pytest.approx(reported(world), abs=3)
    assert counted > 25


def test_wall_contacts_are_numbered_and_point_from_circle_to_wall(box2d):
    """One circle against every wall at 1 m/s, each contact with its own wall's number and outward normal."""
    toward = {BOTTOM: [5, 1.005], RIGHT: [8.995, 5], TOP: [5, 8.995], LEFT: [1.005, 5]}
    state = scene(list(toward.values()), box=(0, 0, 10, 10), gravity=(0, 0), velocity=WALL_NORMALS)
    contacts = box2d(state).record_step(0.01, 10, 0).state.contacts
    np.testing.assert_array_equal(contacts.body_b - 4, list(toward))
    np.testing.assert_allclose(contacts.normal, WALL_NORMALS, atol=FLOAT32)
    np.testing.assert_allclose(contacts.separation, -0.005, atol=FLOAT32)
    np.testing.assert_allclose(contacts.normal_impulse, np.pi, rtol=1e-5)  # m v


def test_a_missing_engine_and_a_bad_state_are_refused_by_name(engine, monkeypatch):
    state = scene([[5, 5]])
    bad = state.bodies._replace(mass=np.array([np.nan]))
    with pytest.raises(ValueError, match=r"bodies\.mass"):
        engine(state.replace(bodies=bad))
    walls = replace(state.world, segments=[(2, 1, 8, 1)], segment_velocities=[((0, 1), (0, 1))])
    with pytest.raises(ValueError, match=f"segment_velocities: expected none for {engine.name}"):
        engine(state.replace(world=walls))
    with pytest.raises(ValueError, match=f"mass: expected no fixed circles for {engine.name}"):
        engine(scene([[5, 5], [9, 9]], fixed=[True, False]))
    monkeypatch.setitem(sys.modules, engine.package, None)
    with pytest.raises(ImportError, match=rf"{engine.package}.*deep-contact\[peers\]"):
        engine(state)
