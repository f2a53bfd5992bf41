"""The same scene in other engines: Box2D 2.3 (`Box2D`), Chipmunk (`pymunk`) and Box2D v3 (`pyb2d3`).

Tests use them as oracles, benchmarks for comparison; nothing else in the package needs them. All three adapters have
`step(dt, sweeps, position_sweeps)`, `bodies()` and `contact_count()`, and are built from a `deep_contact.state.State`:
its circles with equal masses, its box, gravity, friction and restitution. Sleeping and continuous collision are off,
warm starting is on. The contacts of the state are not passed on: a fresh world starts its first step from zero.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Iterator
from types import ModuleType
from typing import NamedTuple

import numpy as np

from deep_contact import constants
from deep_contact.physics.methods import PGS
from deep_contact.state import Bodies, Contacts, State, World, check_bodies, check_state

SPECULATIVE_DISTANCE = 4 * constants.LINEAR_SLOP
"""Gap below which Box2D v3 makes a contact (`B2_SPECULATIVE_DISTANCE`), m."""


class RecordedStep(NamedTuple):
    """A recorded step of Box2D 2.3.

    state: `State` with the bodies before the step (before gravity too), the contacts found there, and the impulses that
    the step started from and solved; `solved` is True. order: (m,) indices into `state.contacts`, which are sorted
    as ours always are; Box2D sweeps contact `order[k]` as its k-th.
    """

    state: State
    order: np.ndarray


class _Peer:
    """What the adapters share. A subclass builds its world and lists its bodies in `_bodies`, in our order.

    name: of the engine. package: of its Python module and distribution. counts_next_step: whether `contact_count` is
    that of the next step rather than of the last one.
    """

    name: str
    package: str
    counts_next_step = False
    _fields: tuple[str, ...]
    """The engine's names of position, velocity, angle, angular velocity and mass of a body."""

    def __init__(self, state: State):
        try:
            self._library = importlib.import_module(self.package)
        except ImportError as error:
            message = f"{self.package} is not installed; it comes with `pip install deep-contact[peers]`"
            raise ImportError(message) from error
        self._state = check_state(state)

    def _circles(self) -> Iterator[tuple]:
        """Body by body: position, velocity, angle, spin, mass, radius as Python floats."""
        bodies = self._state.bodies
        vectors = (map(tuple, values.tolist()) for values in (bodies.position, bodies.velocity))
        return zip(*vectors, *(values.tolist() for values in (bodies.angle, bodies.spin, bodies.mass, bodies.radius)))

    def bodies(self) -> Bodies:
        """The bodies now. The masses are the engine's (float32 in Box2D), the radii ours."""
        columns = [[getattr(body, name) for body in self._bodies] for name in self._fields]
        position, velocity = (np.array([tuple(xy) for xy in column]).reshape(-1, 2) for column in columns[:2])
        angle, spin, mass = map(np.array, columns[2:])
        return self._checked(position, velocity, angle, spin, mass)

    def _checked(self, position, velocity, angle, spin, mass) -> Bodies:
        return check_bodies(Bodies(position, velocity, angle, spin, mass, self._state.bodies.radius))


class Box2D23(_Peer):
    """Box2D 2.3 through `pybox2d` 2.3.10, the engine of the thesis.

    The box is one loop shape, as in the thesis; its edges have a skin of 0.01 m. Raises ImportError where
    Box2D is not installed, ValueError for a bad state.
    """

    name, package = "Box2D 2.3", "Box2D"
    _fields = ("position", "linearVelocity", "angle", "angularVelocity", "mass")

    def __init__(self, state: State):
        super().__init__(state)
        b2, world = self._library, self._state.world
        self._steps, self._last_dt = 0, 0.0
        self.world = b2.b2World(gravity=world.gravity, doSleep=False)
        self.world.continuousPhysics = False
        self.world.warmStarting = True
        material = {"friction": world.friction, "restitution": world.restitution}
        walls = b2.b2FixtureDef(shape=b2.b2LoopShape(vertices=_corners(world)), **material)
        # The child edge of a contact says which wall it is. They count as ours: bottom, right, top, left.
        self.world.CreateStaticBody(fixtures=walls).fixtures[0].userData = -1
        self._bodies = []
        for i, (position, velocity, angle, spin, mass, radius) in enumerate(self._circles()):
            body = self.world.CreateDynamicBody(
                position=position, linearVelocity=velocity, angle=angle, angularVelocity=spin, allowSleep=False
            )
            body.CreateCircleFixture(radius=radius, density=mass / (math.pi * radius**2), **material).userData = i
            self._bodies.append(body)

    def step(self, dt: float, sweeps: int, position_sweeps: int) -> None:
        """One step: `sweeps` velocity iterations, at most `position_sweeps` position iterations."""
        self.world.Step(dt, sweeps, position_sweeps)
        self._steps += 1
        self._last_dt = dt

    def contact_count(self) -> int:
        """Touching contacts in the last step."""
        return sum(contact.touching for contact in self.world.contacts_gen)

    def record_step(self, dt: float, sweeps: int, position_sweeps: int) -> RecordedStep:
        """`step`, recorded by a contact listener: starting impulses, solved impulses and the solver's order.

        Box2D integrates gravity first, then applies the starting impulses, then sweeps, friction row before
        normal row. Raises RuntimeError if the listener misses a contact.
        """
        listener = _recorder(self._library, self._state.bodies.count)
        before, step, last_dt = self.bodies(), self._steps, self._last_dt
        self.world.contactListener = listener
        try:
            self.step(dt, sweeps, position_sweeps)
        finally:
            self.world.contactListener = None
        if listener.found.keys() != listener.solved.keys() or len(listener.order) != len(listener.found):
            raise RuntimeError(f"Box2D found {len(listener.found)} contacts and solved {len(listener.order)}")
        # Box2D scales the impulses of the last step by the ratio of the time steps before it starts from them.
        ratio = dt / last_dt if last_dt else 0.0
        contacts, order = _sorted_contacts(before, self._state.world, listener, ratio)
        state = self._state.replace(
            bodies=before,
            contacts=contacts,
            time=self._state.time + dt * step,
            step=self._state.step + step,
            dt=dt,
            solver=PGS(sweeps=sweeps, tolerance=None, position_sweeps=position_sweeps),
            solved=True,
        )
        return RecordedStep(check_state(state), order)


class Pymunk(_Peer):
    """Chipmunk 2D through `pymunk`.

    One iteration sweeps normal and friction rows once and corrects positions by pseudo-velocities in the
    same pass, so `sweeps` is its `iterations`, and `position_sweeps` is ignored. Slop and walls are set as ours are,
    and the positional bias to 20 % of the penetration a step. Chipmunk multiplies friction and restitution of the two
    shapes (where Box2D takes root and maximum), so each shape is given the root. Two differences remain: restitution
    acts at any approach speed, and positions are integrated before contacts are looked for.

    Raises ImportError where pymunk is not installed, ValueError for a bad state.
    """

    name = package = "pymunk"
    _fields = ("position", "velocity", "angle", "angular_velocity", "mass")

    def __init__(self, state: State):
        super().__init__(state)
        pymunk, world = self._library, self._state.world
        self.space = pymunk.Space()
        self.space.gravity = world.gravity
        self.space.collision_slop = constants.LINEAR_SLOP
        # Bias is the share of the penetration that is left after one second.
        self.space.collision_bias = (1 - constants.BAUMGARTE) ** (1 / self._state.dt)
        self._material = math.sqrt(world.friction), math.sqrt(world.restitution)
        for ends in _edges(world):
            self._add(pymunk.Segment(self.space.static_body, *ends, constants.WALL_SKIN))
        self._bodies = []
        for position, velocity, angle, spin, mass, radius in self._circles():
            body = pymunk.Body(mass, pymunk.moment_for_circle(mass, 0, radius))
            body.position, body.velocity, body.angle, body.angular_velocity = position, velocity, angle, spin
            self._add(pymunk.Circle(body, radius), body)
            self._bodies.append(body)

    def _add(self, shape, *body) -> None:
        shape.friction, shape.elasticity = self._material
        self.space.add(*body, shape)

    def step(self, dt: float, sweeps: int, position_sweeps: int = 0) -> None:
        """One step of `sweeps` iterations."""
        self.space.iterations = sweeps
        self.space.step(dt)

    def contact_count(self) -> int:
        """Arbiters of the last step. (Circles touch anything in one point at most.)"""
        static = self.space.static_body
        ends = [0, 0]

        def count(arbiter):
            # A pair of circles is seen from either body, a wall only from the circle.
            ends[any(body is static for body in arbiter.bodies)] += 1

        for body in self._bodies:
            body.each_arbiter(count)
        return ends[0] // 2 + ends[1]


class Box2D3(_Peer):
    """Box2D v3 through `pyb2d3`, single-threaded.

    Its Soft Step solver has no velocity sweeps. A step is divided into substeps, and each substep goes over
    all contacts twice: once with soft position bias ("solve") and once without ("relax"), with an
    integration of positions in between. `sweeps` is the number of substeps here, so its "sweep" is such a
    pair; contacts are looked for once a step. `position_sweeps` is ignored. Walls are capsules of the skin's radius,
    because v3's segments have none. It makes contacts ahead of touch, from `SPECULATIVE_DISTANCE` on.

    Raises ImportError where pyb2d3 is not installed, ValueError for a bad state.
    """

    name, package = "Box2D v3", "pyb2d3"
    counts_next_step = True

    def __init__(self, state: State):
        super().__init__(state)
        b3, world = self._library, self._state.world
        self.world = b3.World(gravity=world.gravity)
        self.world.sleeping_enabled = False
        self.world.continuous_enabled = False
        material = b3.surface_material(friction=world.friction, restitution=world.restitution)
        ground = self.world.create_static_body()
        for ends in _edges(world):
            ground.create_shape(b3.shape_def(material=material), b3.capsule(*ends, constants.WALL_SKIN))
        self._bodies, self._batch = [], b3.Bodies()
        for position, velocity, angle, spin, mass, radius in self._circles():
            body = self.world.create_dynamic_body(
                position=position,
                linear_velocity=velocity,
                rotation=b3.make_rot(angle),
                angular_velocity=spin,
                enable_sleep=False,
            )
            shape = b3.shape_def(material=material, density=mass / (math.pi * radius**2))
            body.create_shape(shape, b3.circle(radius=radius))
            self._bodies.append(body)
            self._batch.append(body)

    def step(self, dt: float, sweeps: int, position_sweeps: int = 0) -> None:
        """One step of `sweeps` substeps."""
        self.world.step(dt, sweeps)

    def bodies(self) -> Bodies:
        """The bodies now, masses as Box2D has them (float32 in all but the radius). Angles lie in (-π, π]."""
        batch = self._batch
        cosine, sine = batch.get_rotations().astype(np.float64).T
        velocity, spin = batch.get_linear_velocities(), batch.get_angular_velocities()
        mass = np.array([body.mass for body in self._bodies])
        return self._checked(batch.get_positions(), velocity, np.arctan2(sine, cosine), spin, mass)

    def contact_count(self) -> int:
        """Contacts that the next step will solve, found from the positions.

        pyb2d3 exposes neither manifolds nor counters; Box2D makes a contact where the gap is at most the
        speculative distance.
        """
        return _pairs_within(self._batch.get_positions(), self._state.bodies.radius, self._state.world)


ENGINES = {adapter.name: adapter for adapter in (Box2D23, Pymunk, Box2D3)}
"""Name -> adapter."""


def installed() -> list[str]:
    """Names of the engines whose packages are installed."""
    return [name for name, adapter in ENGINES.items() if importlib.util.find_spec(adapter.package)]


def _corners(world: World) -> list[tuple[float, float]]:
    """The box, counter-clockwise from (x_min, y_min), so that edge k is wall k: bottom, right, top, left."""
    x_min, y_min, x_max, y_max = world.box
    return [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]


def _edges(world: World) -> list[tuple]:
    """The two ends of each wall, in the order of `_corners`."""
    corners = _corners(world)
    return list(zip(corners, corners[1:] + corners[:1]))


def _recorder(b2: ModuleType, n: int):
    """A contact listener that keeps the starting and the solved impulses of a step, in our convention.

    found: (body_a, body_b) -> (x, y, n_x, n_y, starting λ_n, starting λ_t). solved: (body_a, body_b) ->
    (λ_n, λ_t). order: the pairs in the solver's order.
    """

    class Recorder(b2.b2ContactListener):
        def __init__(self):
            super().__init__()
            self.found, self.solved, self.order = {}, {}, []

        def PreSolve(self, contact, old_manifold):
            # The normal must be read here: by PostSolve the bodies have moved. Both manifolds are bound to a name
            # first, because pybox2d otherwise frees the object that the fields belong to.
            pair, sign = _pair(contact, n)
            world_manifold = contact.worldManifold
            x, y = world_manifold.points[0]
            normal_x, normal_y = world_manifold.normal
            manifold = contact.manifold
            point = manifold.points[0]
            # λ_t keeps its sign when the bodies change roles: tangent and relative velocity flip together.
            self.found[pair] = (x, y, sign * normal_x, sign * normal_y, point.normalImpulse, point.tangentImpulse)

        def PostSolve(self, contact, impulse):
            pair, _ = _pair(contact, n)
            self.solved[pair] = (impulse.normalImpulses[0], impulse.tangentImpulses[0])
            self.order.append(pair)

    return Recorder()


def _pair(contact, n: int) -> tuple[tuple[int, int], float]:
    """Our (body_a, body_b) of a Box2D contact, and -1 where Box2D's normal points from our b to our a."""
    a, b = contact.fixtureA.userData, contact.fixtureB.userData
    if a < 0:
        return (b, n + contact.childIndexA), -1.0
    if b < 0:
        return (a, n + contact.childIndexB), 1.0
    return ((a, b), 1.0) if a < b else ((b, a), -1.0)


def _sorted_contacts(bodies: Bodies, world: World, listener, ratio: float) -> tuple[Contacts, np.ndarray]:
    pairs = sorted(listener.found)
    body_a, body_b = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    found = np.array([listener.found[pair] for pair in pairs], dtype=np.float64).reshape(-1, 6)
    solved = np.array([listener.solved[pair] for pair in pairs], dtype=np.float64).reshape(-1, 2)
    index = {pair: k for k, pair in enumerate(pairs)}
    contacts = Contacts(
        body_a=body_a,
        body_b=body_b,
        position=found[:, 0:2],
        normal=found[:, 2:4],
        separation=_separations(bodies, world, body_a, body_b),
        normal_impulse=solved[:, 0],
        tangent_impulse=solved[:, 1],
        normal_start=found[:, 4] * ratio,
        tangent_start=found[:, 5] * ratio,
    )
    return contacts, np.array([index[pair] for pair in listener.order], dtype=np.int64)


def _separations(bodies: Bodies, world: World, body_a: np.ndarray, body_b: np.ndarray) -> np.ndarray:
    """Gaps of the pairs, (m,): between surfaces of circles, or from a circle to the skin of a wall."""
    n = bodies.count
    to_walls = _wall_distances(bodies.position, world)
    is_wall = body_b >= n
    other = np.where(is_wall, body_a, body_b)
    between = np.hypot(*(bodies.position[other] - bodies.position[body_a]).T) - bodies.radius[other]
    to_wall = to_walls[body_a, np.where(is_wall, body_b - n, 0)] - constants.WALL_SKIN
    return np.where(is_wall, to_wall, between) - bodies.radius[body_a]


def _wall_distances(position: np.ndarray, world: World) -> np.ndarray:
    """Distance of the centres from the four walls, (n, 4)."""
    x_min, y_min, x_max, y_max = world.box
    x, y = position[:, 0], position[:, 1]
    return np.stack([y - y_min, x_max - x, y_max - y, x - x_min], axis=1)


def _pairs_within(position: np.ndarray, radius: np.ndarray, world: World) -> int:
    """Number of pairs, of two circles or a circle and a wall, whose gap is at most `SPECULATIVE_DISTANCE`."""
    from scipy.spatial import cKDTree

    position = position.astype(np.float64)
    to_walls = _wall_distances(position, world) - radius[:, None] - constants.WALL_SKIN
    near = cKDTree(position).query_pairs(2 * radius.max() + SPECULATIVE_DISTANCE, output_type="ndarray")
    gap = np.hypot(*(position[near[:, 1]] - position[near[:, 0]]).T) - radius[near].sum(axis=1)
    return int((gap <= SPECULATIVE_DISTANCE).sum() + (to_walls <= SPECULATIVE_DISTANCE).sum())
