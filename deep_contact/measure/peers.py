"""Other engines on the same scene: Box2D 2.3 (`Box2D`), Chipmunk (`pymunk`) and Box2D v3 (`pyb2d3`).

Tests use these engines as oracles. Benchmarks and studies use them for comparison. An adapter is built from a `State`:
its circles with their masses, its box, its segments, gravity, friction and restitution. It has the methods `step(dt,
sweeps, position_sweeps)`, `run` for many steps, `bodies()` and `contact_count()`.

Slop, thresholds and largest speeds are those of the engines, which are absolute lengths and speeds. Only Chipmunk's
slop and the radius of the walls are set by the adapters, and follow the scene (`State.scales`). Sleeping and continuous
collision detection are off, warm starting is on. The contacts of the state are not used, so that the first step starts
from impulses of 0. An adapter raises ImportError if its package is not installed, and ValueError for a bad state, for
segments that move, and for fixed circles.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deep_contact.state import constants
from deep_contact.state.arrays import Bodies, corners
from deep_contact.state.checks import check_state
from deep_contact.state.fields import check_bodies
from deep_contact.state.state import State
from deep_contact.state.validation import brief, expect
from deep_contact.state.world import World
from deep_contact.stepping.problem import contacts_of


class _Peer:
    """Base class of the adapters. A subclass builds the engine's world. Its `_bodies` are the circles, in our order.

    name: name of the engine. package: name of its Python module and distribution. reach: gap up to which the engine
    makes a contact, m.
    """

    name: str
    package: str
    reach = 0.0
    _fields: tuple[str, ...]
    """The engine's names for position, velocity, angle, angular velocity and mass of a body."""

    def __init__(self, state: State):
        try:
            self._library = importlib.import_module(self.package)
        except ImportError as error:
            message = f"{self.package} is not installed; it comes with `pip install deep-contact[peers]`"
            raise ImportError(message) from error
        self._state = check_state(state)
        world, bodies = state.world, state.bodies
        still = not np.any(world.segment_velocities)
        one = world.materials is None
        expect(one, f"materials: expected one friction and one restitution for {self.name}, got a table")
        expect(still, f"segment_velocities: expected none for {self.name}, got {brief(world.segment_velocities)}")
        expect(not bodies.is_fixed.any(), f"mass: expected no fixed circles for {self.name}, got {brief(bodies.mass)}")

    def _circles(self) -> Iterator[tuple]:
        """Return (position, velocity, angle, spin, mass, radius) of each circle, as Python floats."""
        bodies = self._state.bodies
        vectors = (map(tuple, values.tolist()) for values in (bodies.position, bodies.velocity))
        return zip(*vectors, *(values.tolist() for values in (bodies.angle, bodies.spin, bodies.mass, bodies.radius)))

    def run(self, steps: int, *options) -> None:
        """Do `steps` steps. options: the arguments of `step`."""
        for _ in range(steps):
            self.step(*options)

    def bodies(self) -> Bodies:
        """Return the present bodies. The masses are the engine's (float32 in Box2D), the radii those of the state."""
        columns = [[getattr(body, name) for body in self._bodies] for name in self._fields]
        position, velocity = (np.array([tuple(xy) for xy in column]).reshape(-1, 2) for column in columns[:2])
        return check_bodies(Bodies(position, velocity, *map(np.array, columns[2:]), self._state.bodies.radius))

    def positions(self) -> np.ndarray:
        """Return the present centres of the circles, (n, 2), m, without any check."""
        return self._vectors(self._fields[0])

    def velocities(self) -> np.ndarray:
        """Return the present velocities of the circles, (n, 2), m/s, without any check."""
        return self._vectors(self._fields[1])

    def _vectors(self, name: str) -> np.ndarray:
        vectors = [getattr(body, name) for body in self._bodies]
        return np.array([(x, y) for x, y in vectors]).reshape(-1, 2)

    def contact_count(self) -> int:
        """Return the number of contacts at the present positions, with gaps of at most `reach`.

        `reach` is the largest gap at which the engine reports a contact.
        """
        state, bodies, near = self._state, self.bodies(), 0.5 * self.reach
        scales = state.scales._replace(wall_skin=state.scales.wall_skin + near)
        grown = bodies._replace(radius=bodies.radius + near)
        return contacts_of(state.replace(bodies=grown, world=replace(state.world, scales=scales))).count


class Box2D23(_Peer):
    """Box2D 2.3 through `pybox2d` 2.3.10, the engine of the thesis.

    The box is one loop shape, as in the thesis. Its edges have a skin of 0.01 m. Each segment is an edge shape of its
    own, so that circles bump when they roll over the joint of two segments.
    """

    name, package = "Box2D 2.3", "Box2D"
    _fields = ("position", "linearVelocity", "angle", "angularVelocity", "mass")

    def __init__(self, state: State):
        super().__init__(state)
        b2, world = self._library, _at_rest(self._state.world)
        self.world = b2.b2World(gravity=world.gravity, doSleep=False, continuousPhysics=False, warmStarting=True)
        material = {"friction": world.friction, "restitution": world.restitution}
        walls = b2.b2FixtureDef(shape=b2.b2LoopShape(vertices=corners(world.box)), **material)
        # In a contact with the box, the index of the child edge is the number of the wall: bottom, right, top, left.
        self.world.CreateStaticBody(fixtures=walls).fixtures[0].userData = -1
        for s, (x_0, y_0, x_1, y_1) in enumerate(world.segments):
            edge = b2.b2FixtureDef(shape=b2.b2EdgeShape(vertices=[(x_0, y_0), (x_1, y_1)]), **material)
            self.world.CreateStaticBody(fixtures=edge).fixtures[0].userData = -5 - s
        self._bodies = []
        for i, (position, velocity, angle, spin, mass, radius) in enumerate(self._circles()):
            body = self.world.CreateDynamicBody(
                position=position, linearVelocity=velocity, angle=angle, angularVelocity=spin, allowSleep=False
            )
            body.CreateCircleFixture(radius=radius, density=mass / (math.pi * radius**2), **material).userData = i
            self._bodies.append(body)

    def step(self, dt: float, sweeps: int, position_sweeps: int) -> None:
        """Do one step of `dt`, s, with `sweeps` velocity iterations.

        position_sweeps: largest number of position iterations.
        """
        self.world.Step(dt, sweeps, position_sweeps)


class Pymunk(_Peer):
    """Chipmunk 2D through `pymunk`.

    An iteration of Chipmunk sweeps normal and friction rows once, and in the same pass corrects positions by
    pseudo-velocities. `sweeps` is therefore the number of iterations, and `position_sweeps` is ignored. Walls have the
    skin of the scene. The slop is `slop` times that of the scene. In a step the positional bias removes the share
    `bias` of the penetration.

    Chipmunk multiplies the frictions of two shapes, and their restitutions, so that each shape gets the square root of
    the scene's value. (Box2D takes the root of the product of the frictions, and the larger restitution.) Two
    differences remain: restitution acts at any approach speed, and positions are integrated before contacts are
    detected.
    """

    name = package = "pymunk"
    _fields = ("position", "velocity", "angle", "angular_velocity", "mass")
    _ids: np.ndarray | None = None
    """Chipmunk's number of each circle, (n,); None before the first reading."""

    def __init__(self, state: State, *, threads: int = 1, slop: float = 1.0, bias: float = constants.BAUMGARTE):
        super().__init__(state)
        pymunk, world = self._library, self._state.world
        self.space = pymunk.Space(threaded=threads > 1)
        self.space.threads = threads
        self.space.gravity = world.gravity
        self.space.collision_slop = slop * self._state.scales.slop
        # Chipmunk's bias is the share of the penetration that is left after one second.
        self.space.collision_bias = (1 - bias) ** (1 / self._state.dt)
        self._material = math.sqrt(world.friction), math.sqrt(world.restitution)
        speeds = (0.0,) * 4 + (world.surface_speeds or (0.0,) * len(world.segments))
        for ends, speed in zip(_edges(world), speeds):
            segment = pymunk.Segment(self.space.static_body, *ends, self._state.scales.wall_skin)
            segment.surface_velocity = tuple(speed * (segment.b - segment.a).normalized())
            self._add(segment)
        self._bodies = []
        for position, velocity, angle, spin, mass, radius in self._circles():
            body = pymunk.Body(mass, pymunk.moment_for_circle(mass, 0, radius))
            body.position, body.velocity, body.angle, body.angular_velocity = position, velocity, angle, spin
            self._add(pymunk.Circle(body, radius), body)
            self._bodies.append(body)

    def _vectors(self, name: str) -> np.ndarray:
        """Return a vector of every circle, (n, 2), by one call into Chipmunk. name: "position" or "velocity"."""
        batch = importlib.import_module("pymunk.batch")
        if self._ids is None:
            self._numbers, self._ids = batch.Buffer(), np.array([body.id for body in self._bodies], np.uintp)
        self._numbers.clear()
        fields = batch.BodyFields.BODY_ID | batch.BodyFields[name.upper()]
        batch.get_space_bodies(self.space, fields, self._numbers)
        ids = np.frombuffer(self._numbers.int_buf(), np.uintp)
        vectors = np.frombuffer(self._numbers.float_buf(), np.float64).reshape(-1, 2)
        order = np.argsort(ids)  # Chipmunk has the walls' body too
        return vectors[order[np.searchsorted(ids[order], self._ids)]]

    def _add(self, shape, *body) -> None:
        shape.friction, shape.elasticity = self._material
        self.space.add(*body, shape)

    def step(self, dt: float, sweeps: int, position_sweeps: int = 0) -> None:
        """Do one step of `dt`, s, with `sweeps` iterations."""
        self.space.iterations = sweeps
        self.space.step(dt)


class Box2D3(_Peer):
    """Box2D v3 through `pyb2d3`, on `threads` threads.

    Its Soft Step solver has no velocity sweeps. A step is divided into substeps, and each substep goes over all
    contacts twice: once with soft position bias ("solve") and once without ("relax"), with an integration of positions
    in between. `sweeps` is the number of substeps, so that a "sweep" is such a pair of passes. `position_sweeps` is
    ignored. Contacts are detected once a step, and before bodies touch (`B2_SPECULATIVE_DISTANCE`). Walls are capsules
    with the radius of the skin, because segments of v3 have no radius. hertz: stiffness of the soft contacts, Hz; the
    engine limits it to a quarter of the rate of substeps.
    """

    name, package = "Box2D v3", "pyb2d3"
    reach = 4 * constants.LINEAR_SLOP

    def __init__(self, state: State, *, threads: int = 1, hertz: float = 30.0):
        super().__init__(state)
        b3, world = self._library, _at_rest(self._state.world)
        self.world = b3.World(thread_pool=b3.ThreadPool(threads) if threads > 1 else None, gravity=world.gravity)
        self.world.sleeping_enabled = False
        self.world.continuous_enabled = False
        self.world.set_contact_tuning(hertz, 10.0, 3.0)  # damping ratio and push speed, m/s, are the defaults
        material = b3.surface_material(friction=world.friction, restitution=world.restitution)
        ground = self.world.create_static_body()
        for ends in _edges(world):
            ground.create_shape(b3.shape_def(material=material), b3.capsule(*ends, self._state.scales.wall_skin))
        self._bodies, self._batch = [], b3.Bodies()
        for position, velocity, angle, spin, mass, radius in self._circles():
            motion = {"linear_velocity": velocity, "angular_velocity": spin, "enable_sleep": False}
            body = self.world.create_dynamic_body(position=position, rotation=b3.make_rot(angle), **motion)
            shape = b3.shape_def(material=material, density=mass / (math.pi * radius**2))
            body.create_shape(shape, b3.circle(radius=radius))
            self._bodies.append(body)
            self._batch.append(body)

    def step(self, dt: float, sweeps: int, position_sweeps: int = 0) -> None:
        """Do one step of `dt`, s, with `sweeps` substeps."""
        self.world.step(dt, sweeps)

    def positions(self) -> np.ndarray:
        """Return the present centres of the circles, (n, 2), m, without any check."""
        return self._batch.get_positions().astype(np.float64)

    def velocities(self) -> np.ndarray:
        """Return the present velocities of the circles, (n, 2), m/s, without any check."""
        return self._batch.get_linear_velocities().astype(np.float64)

    def bodies(self) -> Bodies:
        """Return the present bodies. The engine has all numbers but the radii in float32. Angles lie in (-π, π]."""
        batch = self._batch
        angle = np.arctan2(*batch.get_rotations().astype(np.float64).T[::-1])
        mass = np.array([body.mass for body in self._bodies])
        motion = batch.get_linear_velocities(), angle, batch.get_angular_velocities()
        return check_bodies(Bodies(batch.get_positions(), *motion, mass, self._state.bodies.radius))


ENGINES = {adapter.name: adapter for adapter in (Box2D23, Pymunk, Box2D3)}
"""Name of an engine -> its adapter."""


def _at_rest(world: World) -> World:
    if world.surface_speeds:
        raise ValueError(f"surface_speeds: expected none for Box2D, got {world.surface_speeds}")
    return world


def _edges(world: World) -> list[tuple]:
    """Return the two ends of each wall, in the order of `corners`, and of each segment."""
    a, b, c, d = corners(world.box)
    return [(a, b), (b, c), (c, d), (d, a), *((ends[:2], ends[2:]) for ends in world.segments)]
