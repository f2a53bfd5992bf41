"""Check and complete states before the engine gets them. No other module of the engine checks a state.

Tests: tests/stepping/test_algorithm.py
"""

from __future__ import annotations

import math

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import LIMITS, Contacts, no_contacts
from deep_contact.state.checks import check_limits, check_types, with_checked_arrays
from deep_contact.state.fields import UNIT, make_bodies
from deep_contact.state.materials import MOST_MATERIALS, expect_in_tables
from deep_contact.state.state import State, StateWithContacts, changed
from deep_contact.state.validation import warn
from deep_contact.stepping.pairs import barred_pairs
from deep_contact.stepping.problem import contacts_of

_POSITION, _VELOCITY, _SPIN, _MASS, _RADIUS = (
    LIMITS[f"bodies.{name}"][:2] for name in ("position", "velocity", "spin", "mass", "radius")
)
_FINITE = (-np.finfo(np.float64).max, np.finfo(np.float64).max)
_SEPARATION, _IMPULSE = LIMITS["contacts.separation"][:2], LIMITS["contacts.normal_start"][:2]

_KINDS = [(array.dtype, array.ndim) for array in (*make_bodies([[0.0, 0.0]]), *no_contacts())]
"""Data type and number of dimensions of each array of `Bodies` and `Contacts`, in their sequence."""

COINCIDENT = 0.1
"""Distance of the centres of two circles below which `simulate` warns, divided by the smaller radius."""


def ready(state: State, *, of_step: bool = False) -> StateWithContacts:
    """Return the state, checked and completed.

    The result is valid and within `state.arrays.LIMITS`. It has contacts, and its arrays have the types that compiled
    code takes. of_step: whether a solved state keeps the contacts that appeared during its step. Raises ValueError,
    which names the quantity, its value, and the limit if the value is beyond it.
    """
    check_types(state)
    segments = len(state.world.segments)
    if state.contacts is None or not (has_engine_arrays(state) and is_valid(state.bodies, state.contacts, segments)):
        state = check_limits(with_checked_arrays(state))
    elif not (state.world.is_within_limits and LIMITS["dt"][0] <= state.dt <= LIMITS["dt"][1]):
        check_limits(state)
    if not state.world.is_uniform:
        expect_in_tables("bodies.material", state.bodies.material, state.world.materials)
    if state.contacts is None:
        state = changed(state, contacts=contacts_of(state))
        _warn_of_coincidence(state)
        _warn_of_outside(state)
    elif state.solved and not (of_step or state.holds_solution):
        state = _at_its_begin(state)
    return state if state.world.touches is True else _without_barred(state)


def find_contacts(state: State) -> StateWithContacts:
    """Return the state with the contacts at its positions, without solving their impulses.

    A pair that was already a contact of the state keeps its impulses. A new pair has impulses of 0. A solved state
    stays solved if no contact appears or disappears. Raises ValueError if the state is not valid.
    """
    old = ready(state)
    if state.contacts is None:
        return old
    contacts = contacts_of(old)
    end = old.bodies.count + 4 + len(old.world.segments)
    keys, before = (one.body_a * end + one.body_b for one in (contacts, old.contacts))
    is_same, starts = np.array_equal(keys, before), old.contacts[7:]
    _, kept, at = np.intersect1d(keys, before, assume_unique=True, return_indices=True)
    impulses = (np.maximum(starts[0], 0.0), starts[1]) if old.solved and not is_same else old.contacts[5:7]
    for values, carried in zip(contacts[5:], (*impulses, *starts)):
        values[kept] = carried[at]
    return old.replace(contacts=contacts, solved=old.solved and is_same)


def _at_its_begin(state: StateWithContacts) -> StateWithContacts:
    """Return the solved state without the contacts that appeared during its step.

    These are contacts whose starting impulses are 0 and whose bodies do not touch at the positions of the state.
    """
    contacts, n = state.contacts, state.bodies.count
    later = (contacts.normal_start == 0.0) & (contacts.tangent_start == 0.0)
    if later.any():
        end = n + 4 + len(state.world.segments)
        pairs, here = (one.body_a * end + one.body_b for one in (contacts, contacts_of(state)))
        contacts = Contacts(*(values[~later | np.isin(pairs, here)] for values in contacts))
    return state.replace(contacts=contacts)


def _without_barred(state: StateWithContacts) -> StateWithContacts:
    """Return the state without contacts of pairs that pass through each other, as after a change of `World.touches`.

    If there are such contacts, the result is not solved.
    """
    (a, b), n, table = state.contacts[:2], state.bodies.count, barred_pairs(state)
    if table is None:
        return state
    stays = table.value[table.material[a], table.material[b]] | ((b >= n) & (b < n + 4))
    if stays.all():
        return state
    return changed(state, contacts=Contacts(*(values[stays] for values in state.contacts)), solved=False)


def _warn_of_coincidence(state: StateWithContacts) -> None:
    """Warn if two circles nearly coincide, so that chance decides the direction in which they separate."""
    bodies, (a, b), n = state.bodies, state.contacts[:2], state.bodies.count
    a, b = a[b < n], b[b < n]
    apart = np.hypot(*(bodies.position[b] - bodies.position[a]).T)
    near = apart < COINCIDENT * np.minimum(bodies.radius[a], bodies.radius[b])
    for i in np.flatnonzero(near)[:1]:
        which = f"circles {a[i]} and {b[i]} nearly coincide, their centres are {apart[i]:.3g} m apart"
        more = f" ({near.sum():,} pairs do)" if near.sum() > 1 else ""
        warn(f"bodies.position: {which}{more}; the solver pushes them apart at once")


def _warn_of_outside(state: StateWithContacts) -> None:
    """Warn if free circles have their centres outside of the box. The walls pull them in, through other circles."""
    position, box = state.bodies.position, state.world.box
    is_outside = ((position < box[:2]) | (position > box[2:])).any(axis=1)
    outside = np.flatnonzero(is_outside & ~state.bodies.is_fixed) if is_outside.any() else ()
    for i in outside[:1]:
        where = f"circle {i} lies outside of the box {box}, at ({position[i, 0]:g}, {position[i, 1]:g}) m"
        more = f" ({outside.size:,} circles do)" if outside.size > 1 else ""
        warn(f"bodies.position: {where}{more}; the walls pull it in step by step")


def has_engine_arrays(state: State) -> bool:
    """Return whether all arrays of a state have the types that compiled functions take.

    `check_state` gives the arrays these types.
    """
    return state.contacts is not None and all(
        type(array) is np.ndarray and array.dtype == dtype and array.ndim == ndim and array.flags.carray
        for array, (dtype, ndim) in zip((*state.bodies, *state.contacts), _KINDS)
    )


@njit(cache=True)
def is_valid(bodies, contacts, segments=0):
    """Return whether arrays of the right types pass `check_state` and `check_limits`. segments: number of segments."""
    n, m = bodies.mass.shape[0], contacts.body_a.shape[0]
    end = n + 4 + segments
    for values, count, limits in (
        (bodies.position, n, _POSITION), (bodies.velocity, n, _VELOCITY),
        (contacts.position, m, _FINITE), (contacts.normal, m, _FINITE),
    ):  # fmt: skip
        if values.shape[0] != count or values.shape[1] != 2 or not _within(values.reshape(-1), limits):
            return False
    for values, count, limits in (
        (bodies.angle, n, _FINITE), (bodies.spin, n, _SPIN), (bodies.radius, n, _RADIUS),
        (contacts.separation, m, _SEPARATION), (contacts.normal_impulse, m, (0.0, _IMPULSE[1])),
        (contacts.tangent_impulse, m, _IMPULSE), (contacts.normal_start, m, _IMPULSE),
        (contacts.tangent_start, m, _IMPULSE),
    ):  # fmt: skip
        if values.shape[0] != count or not _within(values, limits):
            return False
    if contacts.body_b.shape[0] != m:
        return False
    if bodies.material.shape[0] != n:
        return False
    # Loops without branches are vectorised. To leave them early would save nothing, since nearly all states are valid.
    valid, (lightest, heaviest) = True, _MASS
    for i in range(n):
        valid &= (bodies.material[i] >= 0) & (bodies.material[i] < MOST_MATERIALS)
    for i in range(n):
        valid &= (lightest <= bodies.mass[i]) & ((bodies.mass[i] <= heaviest) | (bodies.mass[i] == np.inf))
    for i in range(m):
        n_x, n_y = contacts.normal[i, 0], contacts.normal[i, 1]
        valid &= abs(math.sqrt(n_x * n_x + n_y * n_y) - 1) <= UNIT
    a, b = contacts.body_a, contacts.body_b
    for i in range(m):
        valid &= (a[i] >= 0) & (a[i] < n) & (b[i] > a[i]) & (b[i] < end)
    for i in range(1, m):
        valid &= (a[i] - a[i - 1]) * end + b[i] - b[i - 1] > 0
    return valid


@njit(cache=True)
def _within(values, limits):
    """Return whether all values, (k,), lie within the limits (low, high). NaN does not."""
    low, high = limits
    inside = True
    for i in range(values.shape[0]):
        inside &= (low <= values[i]) & (values[i] <= high)
    return inside
