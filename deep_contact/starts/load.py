"""The load of a state, and how far it may change before the carried impulses are tested.

Impulses λ at which circles rest under gravity g and external forces f satisfy Jᵀ λ = −Δt (m g + f). Under another load
(g', f') circle i therefore gains the speed Δt |g' − g + (f'_i − f_i) / m_i| in the next step, until the solver has
corrected the impulses. A torque τ changes the speed of its surface by 2 Δt τ_i / (m_i r_i), and a lower μ' removes
Σ max(0, |λ_t| − μ' λ_n) / m_i. While the sum of these speeds is small, the impulses stay as they are (`kept_anchor`).

The sum is taken from the load of the last test, the anchor, and not from that of the last step. Small changes thus add
up until the impulses are tested (`changed_load.with_new_load`). A state stores its load and its anchor (`State.load`).
"""

from __future__ import annotations

import math
import zlib
from typing import NamedTuple

import numpy as np

from deep_contact.state.equality import by_value
from deep_contact.state.materials import largest
from deep_contact.state.scales import mean
from deep_contact.state.state import State, StateWithContacts
from deep_contact.state.world import World

KICK = 0.001
"""Largest increase of a speed, in √(g r), up to which the carried impulses are used in spite of a changed load."""

NEAR = 0.01
"""Largest change of μ and of e since the last test up to which the carried impulses and a preset's solver stay."""


@by_value
class Anchor(NamedTuple):
    """The load for which the impulses of a run were last tested or solved anew, at the latest at its beginning."""

    world: World
    push: tuple | None  # as `State.push`
    spent: float  # largest speed by which lower friction may have changed a circle since, m/s


@by_value
class Load(NamedTuple):
    """The load for which the impulses of a state were solved."""

    digest: int  # digest of the world, Δt, the push, and the positions, masses and radii of the circles
    motion: int  # digest of velocities and spins, which are no part of the load
    constant: int  # digest of the load without gravity, friction, restitution and the push
    world: World
    anchor: Anchor


def load_of(state: State, anchor: Anchor | None = None) -> Load:
    """Return the `Load` of a state. anchor: its anchor, by default the state itself."""
    position, velocity, _, spin, mass, radius, material = map(np.ascontiguousarray, state.bodies)
    world, motion = state.world, zlib.crc32(velocity, zlib.crc32(spin))
    dragging = world.surface_speeds if world.surface_speeds and largest(world.friction) > 0 else ()
    constant = zlib.crc32(np.array([state.dt, *dragging]), _of_world(world))
    for values in (position, mass, radius) if world.is_uniform else (position, mass, radius, material):
        constant = zlib.crc32(values, constant)
    of_pairs = (world.friction, world.restitution) if world.is_uniform else _of_tables(world)
    digest = zlib.crc32(np.array([*world.gravity, *of_pairs]), constant)
    for values in state.push or ():
        digest = zlib.crc32(values, digest)
    return Load(digest, motion, constant, world, anchor or anchor_of(state))


def _of_world(world: World) -> int:
    """Return the digest of the box, the segments and the scales of a world."""
    if (kept := vars(world).get("_digest")) is None:
        numbers = *world.box, *np.ravel(world.segments), *(world.scales or ())
        vars(world)["_digest"] = kept = zlib.crc32(np.array(numbers, np.float64))  # a world never changes
    return kept


def _of_tables(world: World) -> np.ndarray:
    """Return all numbers of the tables and of the materials of a world as one array."""
    values = world.friction, world.restitution, world.rolling_friction, world.touches
    return np.concatenate([*map(np.ravel, values), world.wall_materials, world.segment_materials]).astype(np.float64)


def anchor_of(state: State) -> Anchor:
    """Return the anchor of a state whose impulses are solved for its own load."""
    return Anchor(state.world, state.push, 0.0)


def is_near(state: StateWithContacts) -> bool:
    """Return whether the load of a state is that of its impulses or near to it, and velocities and spins are as before.

    The state must have a load (`State.load`).
    """
    load, now = state.load, load_of(state)
    if now.motion != load.motion or now.constant != load.constant:
        return False
    return now.digest == load.digest or kept_anchor(load.anchor, load.world, state) is not None


def kept_anchor(anchor: Anchor, before: World, state: StateWithContacts) -> Anchor | None:
    """Return the anchor with which a state keeps its carried impulses, or None if they have to be tested.

    anchor: anchor of the impulses. before: world of the last step. state: state with the new world and the new push,
    and everything else as before.
    """
    new, old, bodies = state.world, anchor.world, state.bodies
    if not (new.is_uniform and old.is_uniform and before.is_uniform):
        # With tables only gravity and the push may have changed.
        if any(not np.array_equal(_of_tables(new), _of_tables(other)) for other in (old, before)):
            return None
        limit = KICK * math.sqrt(max(math.hypot(*new.gravity), math.hypot(*old.gravity)) * mean(bodies.radius))
        return anchor if np.max(_gained(anchor, state), initial=0.0) + anchor.spent <= limit else None
    for one, other in ((new.friction, old.friction), (new.restitution, old.restitution)):
        if abs(one - other) > NEAR or (one > 0.0) != (other > 0.0):
            return None
    most = max(math.hypot(*new.gravity), math.hypot(*old.gravity))
    limit = KICK * math.sqrt(most * mean(bodies.radius))
    lost = _lost_friction(state, before)
    gained, spent = _gained(anchor, state), anchor.spent + lost.max(initial=0.0)
    is_kept = np.max(gained + lost, initial=0.0) + anchor.spent <= limit
    return anchor._replace(spent=float(spent)) if is_kept else None


def _gained(anchor: Anchor, state: State) -> np.ndarray | float:
    """Return the speed that each circle gains in a step by the change of gravity and push since the anchor, m/s, (n,).

    It is one number if the push has not changed.
    """
    (x, y), (old_x, old_y) = state.world.gravity, anchor.world.gravity
    if state.push is anchor.push:
        return state.dt * math.hypot(x - old_x, y - old_y)
    mass, radius, nothing = state.bodies.mass, state.bodies.radius, (0.0, 0.0)
    (force, torque), (old_force, old_torque) = state.push or nothing, anchor.push or nothing
    change = np.subtract(force, old_force) / mass[:, None] + np.array([x - old_x, y - old_y])
    turn = 2.0 * np.abs(np.subtract(torque, old_torque)) / (mass * radius)
    return state.dt * (np.hypot(*change.T) + turn)


def _lost_friction(state: StateWithContacts, before: World) -> np.ndarray:
    """Return the largest speed by which each circle may change as a lower μ' removes friction, m/s, (n,) or (1,).

    It is the sum of (|λ_t| − μ' λ_n) / m over the contacts of the circle, where each contact counts at least 0 and at
    most (μ − μ') λ_n / m. before: world of the last step, with μ.
    """
    friction, lower = before.friction, state.world.friction
    if lower >= friction:
        return np.zeros(1)
    contacts, n = state.contacts, state.bodies.count
    normal = np.maximum(contacts.normal_start, 0.0)
    excess = np.clip(np.abs(contacts.tangent_start) - lower * normal, 0.0, (friction - lower) * normal)
    ends = (np.bincount(body, excess, minlength=n)[:n] for body in contacts[:2])
    return sum(ends) / state.bodies.mass


def share_of_gravity(before: World, anchor: Anchor, state: State) -> float:
    """Return g'·g / |g|², at least 0: the factor on impulses that carry the weight of circles if gravity changes.

    The contact problem of circles at rest is homogeneous: its impulses are proportional to gravity. With a push, and
    without gravity before, the factor is 1. before: world of the last step. anchor: anchor of the impulses.
    """
    (x, y), (old_x, old_y) = state.world.gravity, before.gravity
    square = old_x * old_x + old_y * old_y
    is_pushed = any(values.any() for push in (state.push, anchor.push) for values in push or ())
    if square == 0.0 or (x, y) == (old_x, old_y) or is_pushed:
        return 1.0
    return max(0.0, (x * old_x + y * old_y) / square)
