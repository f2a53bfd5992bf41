"""Materials: symmetric tables of the properties of pairs of bodies, and the values that the pairs of a scene have.

A material is an integer. Circles, walls and segments have one each (`Bodies.material`, `World.wall_materials`,
`World.segment_materials`). A property of a pair is one number for all pairs, or a table (k, k) whose element [p][q] is
the value of a pair of the materials p and q.

Tests: tests/state/test_materials.py
"""

from __future__ import annotations

from numbers import Real

import numpy as np

from deep_contact.state.validation import array_of, brief, expect, number, real_numbers

MOST_MATERIALS = 64
"""Largest number of materials. An attribute of HDF5 has at most 64 KiB, and a table of 64 materials has 32 KiB."""

Table = tuple[tuple[float, ...], ...]
"""A table (k, k) as a world stores it."""


def checked_table(name: str, value, *, high: float | None = None) -> float | Table:
    """Return a property of pairs as a float, or as a tuple of k rows of k floats. A table (1, 1) becomes a float.

    high: largest value. Raises ValueError, which names the property, the element and its value.
    """
    if isinstance(value, Real):
        return number(name, value, low=0, high=high)
    table = real_numbers(value)
    if table is not None and table.shape == ():  # an array of one number
        return number(name, float(table), low=0, high=high)
    _expect_square(name, table is not None and table.shape, value, "a number, or a symmetric table (k, k) of numbers")
    for p, q in np.ndindex(table.shape):
        number(f"{name}[{p}][{q}]", float(table[p, q]), low=0, high=high)
    _expect_symmetric(name, table)
    return float(table[0, 0]) if table.size == 1 else tuple(map(tuple, table.tolist()))


def checked_touches(value) -> bool | Table:
    """Return `World.touches` as True, or as a tuple of k rows of k bools. Raises ValueError naming the value."""
    if value is True or (isinstance(value, np.bool_) and bool(value)):
        return True
    table = array_of(value)
    shape = table.shape if table.dtype == bool else ()
    _expect_square("touches", shape, value, "True, or a symmetric table (k, k) of True and False")
    _expect_symmetric("touches", table)
    return True if table.all() else tuple(map(tuple, table.tolist()))


def _expect_square(name: str, shape, value, expected: str) -> None:
    fits = bool(shape) and len(shape) == 2 and shape[0] == shape[1] and 1 <= shape[0] <= MOST_MATERIALS
    if not fits:
        raise ValueError(f"{name}: expected {expected} with k up to {MOST_MATERIALS}, got {brief(value)}")


def _expect_symmetric(name: str, table: np.ndarray) -> None:
    for p, q in np.argwhere(table != table.T)[:1].tolist():
        raise ValueError(f"{name}[{q}][{p}]: expected {table[p, q]}, as in [{p}][{q}], got {table[q, p]}")


def checked_materials(name: str, values, count: int, *, of: str) -> tuple[int, ...]:
    """Return the materials of `count` bodies as a tuple of integers. Raises ValueError naming the value.

    of: description of the bodies for the message.
    """
    array = array_of(values) if isinstance(values, (list, tuple, np.ndarray)) else np.zeros(0, object)
    fits = array.shape == (count,) and (np.issubdtype(array.dtype, np.integer) or count == 0)
    fits = fits and (count == 0 or (0 <= array.min() and array.max() < MOST_MATERIALS))
    if not fits:
        expected = f"{count} integers from 0 to {MOST_MATERIALS - 1}, {of}"
        raise ValueError(f"{name}: expected {expected}, got {brief(values)}")
    return tuple(int(value) for value in array)


def table_size(properties: dict) -> int | None:
    """Return the size k of the tables among these properties, name → value, or None if all are numbers.

    Raises ValueError if two tables differ in size.
    """
    sizes = {name: len(value) for name, value in properties.items() if isinstance(value, tuple)}
    for name, size in sizes.items():
        first, expected = next(iter(sizes.items()))
        expect(size == expected, f"{name}: expected a table of {expected} materials, as {first} has, got {size}")
    return next(iter(sizes.values()), None)


def expect_in_tables(name: str, materials, size: int | None) -> None:
    """Raise ValueError if a material is not in tables of `size` materials. materials: integers, (k,)."""
    if size is not None and (most := max(map(int, materials), default=0)) >= size:
        raise ValueError(f"{name}: expected materials from 0 to {size - 1}, as the world's tables have, got {most}")


def materials_of(state) -> np.ndarray:
    """Return the materials of all bodies of a state: n circles, four walls, S segments, (n + 4 + S,)."""
    world = state.world
    of_segments = world.segment_materials or np.zeros(len(world.segments), np.int64)
    return np.concatenate([state.bodies.material, world.wall_materials, of_segments]).astype(np.int64)


def largest(value: float | Table) -> float:
    """Return the largest value of a property of pairs, which is a number or a table."""
    return max(map(max, value)) if isinstance(value, tuple) else value


def in_scene(state, value: float | Table) -> np.ndarray:
    """Return the values of a property for the pairs that the materials of a scene can form, (p, q).

    p: number of materials of circles. q: number of materials of all bodies.
    """
    if not isinstance(value, tuple):
        return np.array([[value]])
    circles, every = np.unique(state.bodies.material), np.unique(materials_of(state))
    return np.array(value)[np.ix_(circles, every)] if circles.size else np.array(value)


def at_contacts(state, value: float | Table) -> float | np.ndarray:
    """Return a property of pairs at the contacts of a state: the number itself, or the value of each contact, (m,)."""
    if not isinstance(value, tuple):
        return value
    material, contacts = materials_of(state), state.contacts
    return np.array(value, np.float64)[material[contacts.body_a], material[contacts.body_b]]
