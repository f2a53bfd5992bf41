"""Makes the input of a run's steps from a state: `step_input`.

Tests: tests/behaviour/test_scene_requirements.py, tests/stepping/test_substeps_by_motion.py
"""

from __future__ import annotations

import numpy as np

from deep_contact.state.arrays import Bodies
from deep_contact.state.materials import in_scene
from deep_contact.state.scales import ContactScales, mean
from deep_contact.state.state import State
from deep_contact.state.validation import brief
from deep_contact.stepping.context import Actuation, Motion, StepInput
from deep_contact.stepping.interface import METHODS, SolverOptions, entry_of
from deep_contact.stepping.pairs import Rough, barred_pairs, largest_of, pair_property
from deep_contact.stepping.segment_grid import segments_in_grid


def leaves_tangents_out(state: State, solver) -> bool:
    """Return whether a step has no tangent rows.

    It has none if μ = 0 and ρ = 0, no contact starts from a tangent impulse, and the solver takes the step that solvers
    share (`interface.register`).
    """
    world = state.world
    is_smooth = world.friction == 0.0
    if not world.is_uniform:
        is_smooth = not (in_scene(state, world.friction).any() or in_scene(state, world.rolling_friction).any())
    return is_smooth and entry_of(solver).advance is None and not state.contacts.tangent_start.any()


def friction_with_rolling(state: State, solver):
    """Return `StepInput.friction` of the steps of a solver, with tangent rows.

    Without rolling resistance between the materials of the scene it is a number or a table, and otherwise a `Rough`.
    solver: options of the solver; None leaves rolling resistance out. Raises ValueError if the solver has none.
    """
    friction, rolling = pair_property(state, state.world.friction), pair_property(state, state.world.rolling_friction)
    if solver is None or largest_of(rolling) == 0.0:
        return friction
    if not entry_of(solver).rolls:
        known = ", ".join(name for name, kind in METHODS.items() if entry_of(kind()).rolls)
        why = f"since only {known} have rolling resistance"
        got = brief(state.world.rolling_friction)
        raise ValueError(f"rolling_friction: expected 0 for {type(solver).__name__}, {why}, got {got}")
    return Rough(friction, rolling)


UNDIVIDED = SolverOptions()
"""Options for a step without substeps."""


def step_input(state: State, solver, scales: ContactScales | None = None) -> StepInput:
    """Return the `StepInput` of the next steps of a state. It shares the state's arrays.

    A table of the world becomes a number if all pairs of the scene have one value.

    solver: options of the solver; None stands for rows with tangents, a step without substeps, and the state's own
    scales. scales: `ContactScales`; by default those of the state with the solver's slop.
    """
    world, options = state.world, UNDIVIDED if solver is None else solver
    friction, restitution, touches = world.friction, world.restitution, None
    if not world.is_uniform:
        friction, touches = friction_with_rolling(state, solver), barred_pairs(state)
        restitution = pair_property(state, world.restitution)
    if solver is not None and leaves_tangents_out(state, solver):
        friction = None
    scales, most = scales_of(state, options) if scales is None else scales, options.motion_parts
    substeps = options.substeps
    bodies = Bodies(*state.bodies[:6])
    step = StepInput(
        bodies, world.box, None, world.gravity, friction, None, state.dt / substeps, substeps, scales, touches=touches,
    )  # fmt: skip
    actuation = actuation_of(state)
    if most == 1 and not world.segments and restitution == 0.0 and actuation is None:
        return step
    motion = Motion(most, options.approach * mean(state.bodies.radius)) if most > 1 else Motion(1, 0.0)
    segments = segments_in_grid(world, reach_of(state, scales))
    if world.segment_velocities:
        segments = segments._replace(line=segments.line.copy())
    return step._replace(segments=segments, restitution=restitution, motion=motion, actuation=actuation)


def actuation_of(state: State) -> Actuation | None:
    """Return the kinematics and external forces of a state's next step.

    Returns None if there are no moving segments, no fixed circles and no external forces.
    """
    (force, torque), world = state.push or (None, None), state.world
    if force is None and not world.segment_velocities and not state.bodies.is_fixed.any():
        return None
    if force is None:
        n = state.bodies.count
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
