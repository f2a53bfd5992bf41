"""Makes the input of a run's steps from a state: `step_input`.

Tests: tests/behaviour/test_scene_requirements.py, tests/stepping/test_substeps_by_motion.py
"""

from __future__ import annotations

import numpy as np

from deep_contact.state.scales import ContactScales, mean
from deep_contact.state.state import State
from deep_contact.stepping.context import Actuation, Motion, StepInput
from deep_contact.stepping.interface import SolverOptions, entry_of
from deep_contact.stepping.segment_grid import segments_in_grid


def leaves_tangents_out(state: State, solver) -> bool:
    """Return whether a step has no tangent rows.

    It has none if μ = 0, no contact starts from a tangent impulse, and the solver takes the step that solvers share
    (`interface.register`).
    """
    return state.world.friction == 0 and entry_of(solver).advance is None and not state.contacts.tangent_start.any()


UNDIVIDED = SolverOptions()
"""Options for a step without substeps."""


def step_input(state: State, solver, scales: ContactScales | None = None) -> StepInput:
    """Return the `StepInput` of the next steps of a state. It shares the state's arrays.

    solver: options of the solver; None stands for rows with tangents, a step without substeps, and the state's own
    scales. scales: `ContactScales`; by default those of the state with the solver's slop.
    """
    world, options = state.world, UNDIVIDED if solver is None else solver
    friction = None if solver is not None and leaves_tangents_out(state, solver) else world.friction
    scales, most = scales_of(state, options) if scales is None else scales, options.motion_parts
    substeps = options.substeps
    step = StepInput(
        state.bodies, world.box, None, world.gravity, friction, None, state.dt / substeps, substeps, scales
    )
    actuation = actuation_of(state)
    if most == 1 and not world.segments and world.restitution == 0.0 and actuation is None:
        return step
    motion = Motion(most, options.approach * mean(state.bodies.radius)) if most > 1 else Motion(1, 0.0)
    segments = segments_in_grid(world, reach_of(state, scales))
    if world.segment_velocities:
        segments = segments._replace(line=segments.line.copy())
    return step._replace(segments=segments, restitution=world.restitution, motion=motion, actuation=actuation)


def actuation_of(state: State) -> Actuation | None:
    """Return the kinematics and external forces of a state's next step.

    Returns None if there are no moving segments, no fixed circles and no external forces.
    """
    (force, torque), world, n = state.push or (None, None), state.world, state.bodies.count
    if force is None and not world.segment_velocities and not state.bodies.is_fixed.any():
        return None
    if force is None:
        force, torque = np.zeros((n, 2)), np.zeros(n)
    wall = np.array(world.segment_velocities or np.zeros((len(world.segments), 4))).reshape(-1, 4)
    return Actuation(wall, np.flatnonzero(wall.any(axis=1)), force, torque)


def reach_of(state: State, scales: ContactScales) -> float:
    """Return the largest distance between a segment and the centre of a circle that has a contact with it, m."""
    return float(state.bodies.radius.max(initial=0.0)) + scales.wall_skin


def scales_of(state: State, solver) -> ContactScales:
    """Return the scales of a state, with the slop multiplied by the solver's option `slop`."""
    slop, scales = solver.slop, state.scales
    return scales if slop == 1.0 else scales._replace(slop=slop * scales.slop)
