"""Integration of velocities and positions of circles over a substep: semi-implicit Euler, with limits of motion.

Tests: tests/stepping/test_algorithm.py
"""

from __future__ import annotations

import math

from deep_contact.compiled import njit
from deep_contact.state.constants import MAX_ROTATION
from deep_contact.state.scales import FASTEST
from deep_contact.stepping.continuous import any_fast, collide_fast
from deep_contact.stepping.paths import displaced
from deep_contact.stepping.rows import INVERSE_MASS, V_S, V_X, V_Y
from deep_contact.stepping.segments import has_moving


@njit(cache=True, error_model="numpy")
def integrate_velocities(bodies, gravity, dt, solver_bodies, actuation):
    """Fill the solver bodies, (n + 4, 4), with the velocities after Δt of gravity and external forces.

    These are v + Δt M⁻¹ F (Eq 2.27). gravity: (g_x, g_y), m/s². dt: Δt, s. actuation: `Actuation` of the step, or None.
    """
    n = bodies.mass.shape[0]
    for i in range(n):
        solver_bodies[i, V_X] = bodies.velocity[i, 0] + dt * gravity[0]
        solver_bodies[i, V_Y] = bodies.velocity[i, 1] + dt * gravity[1]
        solver_bodies[i, V_S] = bodies.spin[i] * bodies.radius[i]
        solver_bodies[i, INVERSE_MASS] = 1.0 / bodies.mass[i]
    solver_bodies[n:] = 0.0
    if actuation is not None:
        for i in range(n):
            w = solver_bodies[i, INVERSE_MASS]
            if w == 0.0:
                solver_bodies[i, V_X], solver_bodies[i, V_Y] = bodies.velocity[i, 0], bodies.velocity[i, 1]
            solver_bodies[i, V_X] += dt * (w * actuation.force[i, 0])
            solver_bodies[i, V_Y] += dt * (w * actuation.force[i, 1])
            solver_bodies[i, V_S] += dt * (2.0 * w * actuation.torque[i] / bodies.radius[i])


@njit(cache=True, error_model="numpy")
def integrate_positions(bodies, solver_bodies, step, segments, actuation, shifts):
    """Copy the solved velocities to the bodies and move the bodies for Δt, in place (symplectic Euler).

    Displacements and rotations are limited (`cut_motion`). Fast circles push on the bodies that they meet
    (`continuous`). step: `StepInput`. segments: `Segments` at the end of the step, or None. actuation: `Actuation` of
    the step, or None. shifts: `StepLog.shifts`. Returns whether the bodies have moved. They have not if `segments` is
    None and a circle is fast, because the code for continuous collision is then not compiled.
    """
    if segments is None:
        if any_fast(solver_bodies, bodies.radius, step.dt):
            return False
        move(bodies, solver_bodies, step.dt, step.scales.max_translation)
    else:
        if move(bodies, solver_bodies, step.dt, step.scales.max_translation) or has_moving(actuation):
            start = displaced(bodies.position, bodies.velocity, -step.dt)
            collide_fast(step, start, segments, actuation, shifts)
    return True


@njit(cache=True, error_model="numpy")
def move(bodies, solver_bodies, dt, max_translation):
    """Do `integrate_positions` without continuous collision. Returns whether a circle is fast."""
    position, velocity, angle, spin = bodies.position, bodies.velocity, bodies.angle, bodies.spin
    farthest = widest = 0.0
    # Loops without branches, so that they vectorise.
    for i in range(angle.shape[0]):
        v_x, v_y, turn = solver_bodies[i, V_X], solver_bodies[i, V_Y], solver_bodies[i, V_S] / bodies.radius[i]
        velocity[i, 0], velocity[i, 1], spin[i] = v_x, v_y, turn
        farthest, widest = max(farthest, v_x * v_x + v_y * v_y), max(widest, abs(turn))
    if dt * math.sqrt(farthest) > max_translation or dt * widest > min(MAX_ROTATION, dt * FASTEST):
        cut_motion(velocity, spin, dt, max_translation)
    for i in range(angle.shape[0]):
        position[i, 0] += dt * velocity[i, 0]
        position[i, 1] += dt * velocity[i, 1]
        angle[i] += dt * spin[i]
    return any_fast(solver_bodies, bodies.radius, dt)


@njit(cache=True, error_model="numpy")
def cut_motion(velocity, spin, dt, max_translation):
    """Limit velocities and spins, in place, so that no circle translates or rotates too far within Δt.

    max_translation: largest translation, m. The largest rotation is `MAX_ROTATION` if the scene has the fixed scales of
    Box2D. Otherwise only `FASTEST` limits the spin. velocity: (n, 2), m/s. spin: (n,), rad/s. dt: Δt, s.
    """
    max_rotation = MAX_ROTATION if max_translation < dt * FASTEST else dt * FASTEST
    for i in range(spin.shape[0]):
        distance, angle = dt * math.sqrt(velocity[i, 0] ** 2 + velocity[i, 1] ** 2), abs(dt * spin[i])
        if distance > max_translation:
            velocity[i, 0] *= max_translation / distance
            velocity[i, 1] *= max_translation / distance
        if angle > max_rotation:
            spin[i] *= max_rotation / angle
