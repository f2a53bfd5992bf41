"""Sub-stepped soft contacts: a step of small steps with two sweeps each (Box2D v3).

A step finds its contacts once and is divided. Normals stay as they were found; the separation follows the bodies.
A contact that penetrates beyond the slop pushes as a damped spring in the first sweep of each small step: an implicit
spring is a row with less effective mass and some of its impulse taken back (E. Catto, Soft Constraints, GDC 2011), so
`contact_solver.sweep` does it all, from targets and masses written anew for each sweep.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact import validation
from deep_contact.constants import MAX_ROTATION
from deep_contact.physics.collision import make_cells, make_contacts, next_contacts, own_contacts
from deep_contact.physics.contact_solver import (
    BODY_A,
    BODY_B,
    INVERSE_MASS,
    N_X,
    N_Y,
    NORMAL,
    NORMAL_MASS,
    TANGENT,
    TARGET,
    V_S,
    V_X,
    V_Y,
    apply_impulses,
    contact_rows,
    integrate_velocities,
    make_rows,
    move_surfaces,
    sweep,
)
from deep_contact.physics.continuous import any_is_fast, stop_fast
from deep_contact.physics.solvers.pgs import MOST_SWEEPS, PRECISIONS
from deep_contact.physics.solvers.registry import register
from deep_contact.physics.step import log_step
from deep_contact.scales import FOLLOWS_SCENE, scene_units
from deep_contact.state import State

HERTZ, PUSH_SPEED = 30.0, 3.0
"""Box2D v3's `contactHertz`, Hz, and `contactPushMaxVelocity`, m/s, for circles of 1 m under 9.81 m/s²."""


@dataclass(frozen=True, kw_only=True)
class SoftSteps:
    """Sub-stepped soft contacts, as Box2D v3 solves them (E. Catto, Solver2D, 2024): many small steps, two sweeps each.

    substeps: parts of a time step, each of which integrates gravity, sweeps once with contacts that push out of
    penetration as a damped spring, moves the bodies, and sweeps once without the spring so that its push leaves no
    velocity behind. hertz: frequency of the spring, Hz, cut to a quarter of the substeps a second; walls are twice as
    stiff. damping_ratio: of the spring, 1 is critical. push_speed: penetration is worked off no faster than this, m/s.
    Where hertz and push_speed are "scene", they are Box2D v3's 30 Hz and 3 m/s in the scene's units (`scales`).
    precision: as in `PGS`. There are no position sweeps and no tolerance: the work is always the same.

    Weakness: contacts are soft. It does not converge to a solution of the rigid contact problem, so it is judged by
    whole runs (penetration, height, energy), not by the velocity error of one step. Information travels one contact a
    sweep, so tall or heavy piles sink before they find support, and mass ratios above about ten show. Contacts are
    found once a step; circles that meet within it are stopped at its end. Reported impulses are those of the last
    substep times `substeps`: the step's impulse in a pile at rest, but not in an impact.
    """

    substeps: int = 4
    hertz: float | str = FOLLOWS_SCENE
    damping_ratio: float = 10.0
    push_speed: float | str = FOLLOWS_SCENE
    precision: str = "double"

    def __post_init__(self):
        validation.integer("substeps", self.substeps, least=1, most=MOST_SWEEPS)
        for name in ("hertz", "damping_ratio", "push_speed"):
            value = getattr(self, name)
            if name == "damping_ratio" or not validation.is_text(value, FOLLOWS_SCENE):
                validation.number(name, value, above=0)
        validation.one_of("precision", self.precision, PRECISIONS)

    def for_state(self, state: State) -> SoftSteps:
        """The options with a frequency and a speed in place of what follows the scene."""
        length, speed, _ = scene_units(state)
        found = {"hertz": HERTZ * speed / length, "push_speed": PUSH_SPEED * speed}
        return replace(self, **{name: value for name, value in found.items() if getattr(self, name) == FOLLOWS_SCENE})

    @property
    def sweeps(self) -> int:
        """Sweeps a step: two in each substep."""
        return 2 * self.substeps

    @property
    def tolerance(self) -> None:
        """None: it never stops early."""
        return None

    @property
    def position_sweeps(self) -> int:
        """0: the springs correct positions."""
        return 0


class SoftSettings(NamedTuple):
    """Settings of `SoftSteps`."""

    substeps: int
    hertz: float
    damping_ratio: float
    push_speed: float


@njit(cache=True, error_model="numpy", nogil=True)
def advance_softly(given, options, workspace, log):
    """`engine.advance` for `SoftSteps`: same arguments, same results; there are no position sweeps.

    Impulses of the contacts are those of a substep times the number of substeps, so that a start fits any division of
    Δt. Rows are built before gravity.
    """
    bodies, contacts, friction, settings = given.bodies, given.contacts, given.friction, options.settings
    solver_bodies, theta, scales = workspace.solver_bodies, workspace.theta, given.scales
    segments = given.segments
    n, substeps = bodies.mass.shape[0], settings.substeps
    h = given.dt / substeps
    cells = make_cells(n)
    front_buffer, back_buffer = make_contacts(4 * n + 64), make_contacts(4 * n + 64)
    row_buffer = make_rows(4 * n + 64, solver_bodies.dtype)
    origin = np.empty_like(bodies.position)
    solved = contacts
    for k in range(log.contacts.shape[0]):
        integrate_velocities(bodies, given.gravity, 0.0, solver_bodies)
        rows, row_buffer = contact_rows(
            bodies, contacts, solver_bodies, given.restitution, scales.restitution_threshold, row_buffer
        )
        if segments.shape[0] > 0:
            move_surfaces(contacts, segments, solver_bodies, rows)
        mass, bounce = rows.data[:, NORMAL_MASS].copy(), rows.data[:, TARGET].copy()
        pressed, gap = np.zeros_like(mass), np.empty(mass.shape[0])
        origin[:] = bodies.position
        divide_impulses(rows, substeps)
        for j in range(substeps):
            add_gravity(n, given.gravity, h, solver_bodies)
            apply_impulses(rows, solver_bodies)
            find_gaps(contacts, bodies.position, origin, scales.slop, gap)
            soften(rows, gap, mass, settings, h, n)
            theta[2 * j] = sweep(rows, friction, solver_bodies)
            move(bodies, solver_bodies, h, substeps, scales.max_translation)
            find_gaps(contacts, bodies.position, origin, scales.slop, gap)
            harden(rows, gap, mass, h)
            theta[2 * j + 1] = sweep(rows, friction, solver_bodies)
            for i in range(pressed.shape[0]):
                pressed[i] = max(pressed[i], rows.impulse[i, NORMAL])
        if given.restitution > 0.0:
            bounce_back(rows, bounce, pressed, solver_bodies)
        store_velocities(bodies, solver_bodies, given.dt, scales.max_translation)
        if any_is_fast(bodies, origin):
            stop_fast(bodies, origin, given.gravity, given.dt, given.box, segments, scales)
        store_whole_impulses(rows, contacts, substeps)

        solved = contacts
        contacts, back_buffer = next_contacts(
            bodies, origin, given.box, segments, scales.wall_skin, cells, solved, options.carry, back_buffer
        )
        front_buffer, back_buffer = back_buffer, front_buffer
        count = solved.body_a.shape[0]
        log_step(log, k, count, 2 * substeps, theta, 2 * substeps * count)
    return solved, own_contacts(contacts)


@njit(cache=True)
def add_gravity(n, gravity, h, solver_bodies):
    """v ← v + h g for the n circles, in place."""
    for i in range(n):
        solver_bodies[i, V_X] += h * gravity[0]
        solver_bodies[i, V_Y] += h * gravity[1]


@njit(cache=True)
def find_gaps(contacts, position, origin, slop, gap):
    """Separation of each contact now, beyond the slop, m: what it was, and how far its bodies have moved since.

    origin: positions where the contacts were found, (n, 2). slop: m. Fills gap, (m,).
    """
    n = position.shape[0]
    body_a, body_b, normal, separation = contacts.body_a, contacts.body_b, contacts.normal, contacts.separation
    for i in range(gap.shape[0]):
        a, b = body_a[i], body_b[i]
        x, y = origin[a, 0] - position[a, 0], origin[a, 1] - position[a, 1]
        if b < n:
            x += position[b, 0] - origin[b, 0]
            y += position[b, 1] - origin[b, 1]
        gap[i] = separation[i] + slop + x * normal[i, 0] + y * normal[i, 1]


@njit(cache=True, error_model="numpy")
def soften(rows, gap, mass, settings, h, n):
    """Targets and masses for the sweep that pushes: springs where contacts penetrate, in place.

    The impulse −k s (v_n + bias) − c λ of Box2D v3 (s, c: `softness`) is a plain row's of mass k s and target
    −bias − c λ / (k s), with the λ that the row has when its turn comes, and it has but one turn.
    """
    data, impulse = rows.data, rows.impulse
    hertz = min(settings.hertz, 0.25 / h)
    circles, walls = softness(hertz, settings.damping_ratio, h), softness(2.0 * hertz, settings.damping_ratio, h)
    for i in range(mass.shape[0]):
        if gap[i] > 0.0:
            data[i, NORMAL_MASS], data[i, TARGET] = mass[i], -gap[i] / h
        else:
            rate, share, taken_back = circles if rows.body[i, BODY_B] < n else walls
            data[i, NORMAL_MASS] = mass[i] * share
            data[i, TARGET] = (
                min(-rate * gap[i], settings.push_speed) - taken_back * impulse[i, NORMAL] / data[i, NORMAL_MASS]
            )


@njit(cache=True)
def softness(hertz, damping_ratio, h):
    """(1/s of the gap that is closed, share of the effective mass, share of λ taken back) of an implicit spring."""
    omega = 2.0 * math.pi * hertz
    a_1 = 2.0 * damping_ratio + h * omega
    a_2 = h * omega * a_1
    return omega / a_1, a_2 / (1.0 + a_2), 1.0 / (1.0 + a_2)


@njit(cache=True, error_model="numpy")
def harden(rows, gap, mass, h):
    """Targets and masses for the sweep that relaxes: rigid contacts, which leave a gap its time to close, in place."""
    data = rows.data
    for i in range(mass.shape[0]):
        data[i, NORMAL_MASS], data[i, TARGET] = mass[i], -max(gap[i], 0.0) / h


@njit(cache=True, error_model="numpy")
def move(bodies, solver_bodies, h, substeps, max_translation):
    """Move the bodies by the velocities in the sweeps for h, in place; in a whole step no further than the engine's."""
    cut_velocities(bodies, solver_bodies, h * substeps, max_translation)
    position, angle, radius = bodies.position, bodies.angle, bodies.radius
    for i in range(radius.shape[0]):
        position[i, 0] += h * solver_bodies[i, V_X]
        position[i, 1] += h * solver_bodies[i, V_Y]
        angle[i] += h * solver_bodies[i, V_S] / radius[i]


@njit(cache=True, error_model="numpy")
def cut_velocities(bodies, solver_bodies, dt, max_translation):
    """Cut the velocities in the sweeps, in place, to the largest translation, m, and `MAX_ROTATION` in Δt."""
    v = solver_bodies
    for i in range(bodies.mass.shape[0]):
        distance = dt * math.sqrt(v[i, V_X] * v[i, V_X] + v[i, V_Y] * v[i, V_Y])
        if distance > max_translation:
            v[i, V_X] *= max_translation / distance
            v[i, V_Y] *= max_translation / distance
        turn = abs(dt * v[i, V_S]) / bodies.radius[i]
        if turn > MAX_ROTATION:
            v[i, V_S] *= MAX_ROTATION / turn


@njit(cache=True)
def bounce_back(rows, bounce, pressed, solver_bodies):
    """Give the contacts that met fast, and pressed, the speed at which they part, in place: one pass at the end."""
    v = solver_bodies
    for i in range(bounce.shape[0]):
        if bounce[i] <= 0.0 or pressed[i] <= 0.0:
            continue
        a, b = rows.body[i, BODY_A], rows.body[i, BODY_B]
        n_x, n_y = rows.data[i, N_X], rows.data[i, N_Y]
        v_n = (v[b, V_X] - v[a, V_X]) * n_x + (v[b, V_Y] - v[a, V_Y]) * n_y
        p_n = max(rows.data[i, NORMAL_MASS] * (bounce[i] - v_n), -rows.impulse[i, NORMAL])
        rows.impulse[i, NORMAL] += p_n
        v[a, V_X] -= v[a, INVERSE_MASS] * p_n * n_x
        v[a, V_Y] -= v[a, INVERSE_MASS] * p_n * n_y
        v[b, V_X] += v[b, INVERSE_MASS] * p_n * n_x
        v[b, V_Y] += v[b, INVERSE_MASS] * p_n * n_y


@njit(cache=True, error_model="numpy")
def store_velocities(bodies, solver_bodies, dt, max_translation):
    """Give the bodies, in place, the solved velocities, cut as `move` cuts them: what came after it may be faster."""
    cut_velocities(bodies, solver_bodies, dt, max_translation)
    for i in range(bodies.mass.shape[0]):
        bodies.velocity[i, 0] = solver_bodies[i, V_X]
        bodies.velocity[i, 1] = solver_bodies[i, V_Y]
        bodies.spin[i] = solver_bodies[i, V_S] / bodies.radius[i]


@njit(cache=True)
def divide_impulses(rows, substeps):
    """Starting impulses of a small step from those of a whole one, in place."""
    share = rows.impulse.dtype.type(1.0 / substeps)
    for i in range(rows.impulse.shape[0]):
        rows.impulse[i, NORMAL] *= share
        rows.impulse[i, TANGENT] *= share


@njit(cache=True)
def store_whole_impulses(rows, contacts, substeps):
    """Write the last small step's impulses times the number of them into the contacts, in place."""
    for i in range(rows.body.shape[0]):
        contacts.normal_impulse[i] = rows.impulse[i, NORMAL] * substeps
        contacts.tangent_impulse[i] = rows.impulse[i, TANGENT] * substeps


def _settings(solver: SoftSteps) -> SoftSettings:
    return SoftSettings(
        int(solver.substeps), float(solver.hertz), float(solver.damping_ratio), float(solver.push_speed)
    )


register(SoftSteps, _settings, (), advance=lambda solver: advance_softly)
