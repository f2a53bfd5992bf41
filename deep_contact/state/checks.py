"""Validation of a whole state: `check_state` applies the rules of any state, `check_limits` the limits of the engine.

Readers of files and data sets share the rules for contacts (`fields.contact_faults`). `stepping.prepare` has the rules
as compiled code.
"""

from __future__ import annotations

from deep_contact.state.arrays import Bodies, Contacts
from deep_contact.state.fields import beyond_limits, check_bodies, check_contacts
from deep_contact.state.materials import expect_in_tables
from deep_contact.state.state import State, changed
from deep_contact.state.validation import brief, flag, integer, number
from deep_contact.state.world import World


def check_state(state: State) -> State:
    """Return the state with validated copies of all arrays, if all its fields have the right types.

    Raises ValueError naming the field and the value.
    """
    return with_checked_arrays(check_types(state))


def with_checked_arrays(state: State) -> State:
    """Return the state with validated copies of all arrays. Raises ValueError naming the field and the value."""
    bodies, contacts = check_bodies(state.bodies), state.contacts
    if not state.world.is_uniform:
        expect_in_tables("bodies.material", bodies.material, state.world.materials)
    if contacts is not None:
        contacts = check_contacts(contacts, bodies, len(state.world.segments))
    return changed(state, bodies=bodies, contacts=contacts)


def check_types(state) -> State:
    """Return the state unchanged if its fields have the right types. Raises ValueError naming the field."""
    if not isinstance(state, State):
        raise ValueError(f"state: expected a State, as of dc.circles_in_box or dc.read_state, got {brief(state)}")
    for name, kind in (("world", World), ("bodies", Bodies), ("contacts", Contacts)):
        value = getattr(state, name)
        if not (isinstance(value, kind) or (value is None and kind is Contacts)):
            raise ValueError(f"{name}: expected {kind.__name__}, got {type(value).__name__}")
    if not isinstance(state.name, str):
        raise ValueError(f"name: expected a text, got {brief(state.name)}")
    number("time", state.time)
    number("dt", state.dt, above=0)
    integer("step", state.step)
    flag("solved", state.solved)
    return state


def check_solution(state: State) -> None:
    """Raise ValueError if the contacts of a state do not hold the solution of one contact problem.

    The condition is that of `State.holds_solution`.
    """
    if state.contacts is None or not state.holds_solution:
        raise ValueError(f"state.solved: expected a state of one solve, without substeps and rebounds, got {state!r}")


def check_limits(state: State) -> State:
    """Return the state unchanged if all its numbers are within `LIMITS`.

    Raises ValueError naming the quantity, its limits and its value.
    """
    world = state.world
    # Scales that follow the scene are within the limits if its radii are.
    parts = {"bodies": state.bodies, "contacts": state.contacts, "world": world, "dt": state.dt, "scales": world.scales}
    for message in beyond_limits(**parts):
        raise ValueError(message)
    return state
