"""Steps of Box2D 2.3 recorded by a contact listener: the oracle that the engine is tested against."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.measure import peers
from deep_contact.solvers import PGS
from deep_contact.state import constants
from deep_contact.state.arrays import Bodies, Contacts
from deep_contact.state.checks import check_state
from deep_contact.state.state import State
from deep_contact.state.world import World
from deep_contact.stepping.contacts import Walls, make_contacts, write_geometry
from deep_contact.stepping.problem import ContactSolution, solve
from deep_contact.stepping.segment_grid import segments_in_grid


class RecordedStep(NamedTuple):
    """A step of Box2D 2.3: the solved state with the bodies before it (before gravity too), and (m,) indices into its
    contacts, which are sorted as ours always are; Box2D sweeps contact `order[k]` as its k-th."""

    state: State
    order: np.ndarray


def solved_in_order(recorded: RecordedStep, sweeps: int) -> tuple[Contacts, ContactSolution]:
    """The contacts in Box2D's order, and what as many sweeps of ours make of its start in that order."""
    state, order = recorded
    contacts = Contacts(*(np.ascontiguousarray(field[order]) for field in state.contacts))
    solver = PGS(sweeps=sweeps, tolerance=None)
    return contacts, solve(state.replace(contacts=contacts), solver, contacts.normal_start, contacts.tangent_start)


class RecordingBox2D(peers.Box2D23):
    """`peers.Box2D23` that can record a step."""

    def __init__(self, state: State):
        super().__init__(state)
        self._steps, self._last_dt = 0, 0.0

    def step(self, dt: float, sweeps: int, position_sweeps: int) -> None:
        super().step(dt, sweeps, position_sweeps)
        self._steps += 1
        self._last_dt = dt

    def record_step(self, dt: float, sweeps: int, position_sweeps: int) -> RecordedStep:
        """`step`, recorded by a contact listener: starting impulses, solved impulses and the solver's order.

        Box2D integrates gravity first, then applies the starting impulses, then sweeps, friction row before
        normal row. Raises RuntimeError if the listener misses a contact.
        """
        listener = _listener(self._library, self._state.bodies.count)
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


def _listener(b2, n: int):
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
    # User data are -1 for the box, whose child says which wall, and -1 less the number behind the circles for segments.
    if a < 0:
        return (b, n - 1 - a + contact.childIndexA), -1.0
    if b < 0:
        return (a, n - 1 - b + contact.childIndexB), 1.0
    return ((a, b), 1.0) if a < b else ((b, a), -1.0)


def _sorted_contacts(bodies: Bodies, world: World, listener, ratio: float) -> tuple[Contacts, np.ndarray]:
    pairs = sorted(listener.found)
    found = np.array([listener.found[pair] for pair in pairs], dtype=np.float64).reshape(-1, 6)
    solved = np.array([listener.solved[pair] for pair in pairs], dtype=np.float64).reshape(-1, 2)
    contacts = make_contacts(len(pairs))
    contacts.body_a[:], contacts.body_b[:] = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    # Of Box2D's geometry all but the separations is known.
    walls = Walls(world.box, constants.WALL_SKIN)
    write_geometry(bodies.position, bodies.radius, walls, segments_in_grid(world, 2.0), contacts, 0)
    contacts = contacts._replace(
        position=found[:, 0:2],
        normal=found[:, 2:4],
        normal_impulse=solved[:, 0],
        tangent_impulse=solved[:, 1],
        normal_start=found[:, 4] * ratio,
        tangent_start=found[:, 5] * ratio,
    )
    return contacts, np.array([pairs.index(pair) for pair in listener.order], dtype=np.int64)
