"""Properties of pairs of bodies in compiled code: one number for all pairs, or a table by material (`PairTable`).

The functions of this module take both. Numba chooses at compile time by the type of the property, so that a scene with
numbers compiles to the code without tables.

Tests: tests/behaviour/test_pairs.py, tests/behaviour/test_rolling.py
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.extending import overload

from deep_contact.state.materials import in_scene, materials_of
from deep_contact.state.state import State


class PairTable(NamedTuple):
    """A property of pairs that depends on their materials, for n circles, four walls and S segments."""

    value: np.ndarray  # (k, k): value for each pair of materials
    material: np.ndarray  # (n + 4 + S,): material of each body, in the order of `Contacts.body_b`
    most: float  # largest value that a pair of the scene can have


class Rough(NamedTuple):
    """Friction with rolling resistance: `StepInput.friction` of a scene with ρ > 0."""

    friction: float | PairTable  # μ
    rolling: float | PairTable  # ρ, m: a contact resists rolling with a torque of up to ρ λ_n


def pair_property(state: State, value):
    """Return a property of the world for compiled code: a number, or a `PairTable` if pairs of the scene differ in it.

    value: number or table, a field of `World`.
    """
    if not isinstance(value, tuple):
        return value
    found = in_scene(state, value)
    if (found == found[0, 0]).all():
        return found[0, 0].item()
    return PairTable(np.array(value), materials_of(state), float(found.max()))


def barred_pairs(state: State) -> PairTable | None:
    """Return the table of pairs that touch, or None if all pairs of circles, and of circles and segments, do.

    The walls of the box touch all circles (`World.touches`).
    """
    table = state.world.touches
    if table is True:
        return None
    n, material = state.bodies.count, materials_of(state)
    bodies = np.concatenate([material[:n], material[n + 4 :]])
    if np.array(table)[np.ix_(np.unique(material[:n]), np.unique(bodies))].all():
        return None
    return PairTable(np.array(table), material, 1.0)


def kinds(step) -> tuple:
    """Return what the types of the properties of pairs in a `StepInput` depend on, apart from None in place of μ."""

    friction = step.friction
    of_friction = tuple(map(type, friction)) if isinstance(friction, Rough) else isinstance(friction, PairTable)
    return of_friction, isinstance(step.restitution, PairTable), step.touches is None


def is_rough(friction) -> bool:
    """Return whether `StepInput.friction` includes rolling resistance."""
    return isinstance(friction, Rough)


def is_table(value) -> bool:
    """Return whether a property of pairs is a table; for a `Rough`, whether its μ is a table."""
    return isinstance(value.friction if isinstance(value, Rough) else value, PairTable)


def value_of(value, a, b):
    """Return the property of the pair of bodies a and b. value: number, `PairTable`, or a `Rough`, whose μ is meant."""
    value = value.friction if is_rough(value) else value
    return value.value[value.material[a], value.material[b]] if is_table(value) else value


def largest_of(value):
    """Return the largest value of a property in the scene. value: number or `PairTable`."""
    return value.most if is_table(value) else value


def pass_through(touches, a, b) -> bool:
    """Return whether bodies a and b pass through each other. touches: `StepInput.touches`."""
    return touches is not None and not touches.value[touches.material[a], touches.material[b]]


# In compiled callers, Numba replaces the functions above by those below. None of these computes: a function that did
# would have the fast-math flags of its first caller.
def is_rough_type(kind) -> bool:
    """Return whether a type of Numba is that of a `Rough`."""
    return getattr(kind, "instance_class", None) is Rough


def is_table_type(kind) -> bool:
    """Return whether a type of Numba is that of a `PairTable`, or of a `Rough` with a table of μ."""
    kind = kind.types[0] if is_rough_type(kind) else kind
    return getattr(kind, "instance_class", None) is PairTable


@overload(is_rough)
def _overload_is_rough(friction):
    return (lambda friction: True) if is_rough_type(friction) else (lambda friction: False)


@overload(is_table)
def _overload_is_table(value):
    return (lambda value: True) if is_table_type(value) else (lambda value: False)


@overload(value_of)
def _overload_value_of(value, a, b):
    if is_rough_type(value):
        if is_table_type(value):
            return lambda value, a, b: value.friction.value[value.friction.material[a], value.friction.material[b]]
        return lambda value, a, b: value.friction
    if is_table_type(value):
        return lambda value, a, b: value.value[value.material[a], value.material[b]]
    return lambda value, a, b: value


@overload(largest_of)
def _overload_largest_of(value):
    return (lambda value: value.most) if is_table_type(value) else (lambda value: value)


@overload(pass_through)
def _overload_pass_through(touches, a, b):
    if is_table_type(touches):
        return lambda touches, a, b: not touches.value[touches.material[a], touches.material[b]]
    return lambda touches, a, b: False
