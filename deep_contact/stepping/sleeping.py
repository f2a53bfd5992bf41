"""Sleeping: islands at rest are left as they are until something touches them. The rule is that of Box2D 2.3.

An island is a group of circles that touch each other, directly or through other circles. A circle is still while its
speed and spin are at most `sleep_speed` and `sleep_spin` of the `ContactScales`. An island falls asleep once all of its
circles have been still for `sleep_time` and do not accelerate. An island stays awake if one of its contacts needs
position correction, or if it touches a moving segment or a segment whose surface moves. When an island falls asleep,
the velocities of its circles become 0. Its contacts keep their impulses until it wakes.

An island wakes as a whole when a circle that is awake or a moving segment touches it, or when the external force on one
of its circles changes. Contacts are searched among all circles, unless all circles sleep. A new run starts with all
circles awake.

Box2D does not test the acceleration, so that a ball on a slope of 0.003 falls asleep there. Here each circle's
displacement in half a sleep time is compared with its displacement in the half before. This comparison takes place
twice in a sleep time. Islands fall asleep only at such a time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.arrays import Contacts
from deep_contact.state.constants import POSITION_TOLERANCE
from deep_contact.stepping.contacts import make_contacts, more_contacts, some_contacts
from deep_contact.stepping.islands import root_of, unite
from deep_contact.stepping.rows import INVERSE_MASS
from deep_contact.stepping.segments import has_moving, is_moving

STEADY = 0.02
"""Largest difference of two displacements at which a circle does not count as accelerating.

The displacements are those of the circle in two successive halves of a sleep time. The unit is `sleep_speed` times
`sleep_time`. A ball on a slope of 2.4e-4 reaches this difference."""


class SleepMemory(NamedTuple):
    """Memory of the sleep of n circles, and work arrays."""

    still: np.ndarray  # (n,): time for which each circle has been still, s; infinite while the circle sleeps
    place: np.ndarray  # (2, n, 2): positions at the last comparison and at the comparison before it, m
    clock: np.ndarray  # (1,): time since the last comparison, s
    active: Contacts  # work array: contacts of circles that are awake
    parent: np.ndarray  # (n,): work array: union-find forest of the islands (`islands`)
    shortest: np.ndarray  # (n,): work array: least `still` of each island, s
    force: np.ndarray  # (n, 2): external force in the last step in which the circle was awake (`wake_pushed`), N
    torque: np.ndarray  # (n,): external torque in the same step, N·m

    @property
    def remembered(self) -> tuple[np.ndarray, ...]:
        """The arrays whose content a step passes on to the next step: all except the work arrays."""
        return self.still, self.place, self.clock, self.force, self.torque


def make_sleep_memory(n: int, capacity: int) -> SleepMemory:
    """Return a `SleepMemory` of n circles, all awake, with a work array for `capacity` contacts."""
    place, clock = np.full((2, n, 2), np.nan), np.full(1, np.inf)
    buffers = make_contacts(capacity), np.empty(n, np.int64), np.empty(n)
    return SleepMemory(np.zeros(n), place, clock, *buffers, np.zeros((n, 2)), np.zeros(n))


@njit(inline="always")
def all_asleep(sleep, actuation):
    """Return whether all circles sleep and no segment moves. sleep: `SleepMemory`, or None if no circle may sleep."""
    if sleep is None:
        return False
    if has_moving(actuation):
        return False
    for time in sleep.still:
        if time < np.inf:
            return False
    return True


@njit(cache=True, error_model="numpy")
def wake_pushed(contacts, sleep, step):
    """Wake the islands of sleeping circles whose external force has changed since they fell asleep, in place.

    A free circle sleeps on if the change accelerates it by less than `look_at_places` can detect. contacts: contacts at
    the positions of the bodies. step: `StepInput` with the external forces of the next step.
    """
    bodies, scales, actuation, n = step.bodies, step.scales, step.actuation, sleep.still.shape[0]
    most, is_any = 4.0 * STEADY * scales.sleep_speed / scales.sleep_time, False
    sleep.shortest[:] = np.inf
    for i in range(n):
        if sleep.still[i] == np.inf:
            change = math.hypot(actuation.force[i, 0] - sleep.force[i, 0], actuation.force[i, 1] - sleep.force[i, 1])
            change += abs(actuation.torque[i] - sleep.torque[i]) / bodies.radius[i]
            if change > most * bodies.mass[i]:
                sleep.shortest[i], is_any = 0.0, True
    if is_any:
        unite(contacts.body_a, contacts.body_b, sleep.parent)
        for i in range(n):
            root = root_of(sleep.parent, i)
            sleep.shortest[root] = min(sleep.shortest[root], sleep.shortest[i])
        for i in range(n):
            if sleep.shortest[root_of(sleep.parent, i)] == 0.0:
                sleep.still[i] = 0.0
    for i in range(n):
        if sleep.still[i] < np.inf:
            sleep.force[i, 0], sleep.force[i, 1] = actuation.force[i, 0], actuation.force[i, 1]
            sleep.torque[i] = actuation.torque[i]


@njit(inline="always")
def awake_contacts(contacts, sleep):
    """Return the contacts of circles that are awake, with those fields that a step reads.

    The result lies in `SleepMemory.active`, or in a larger buffer. If `sleep` is None, the contacts themselves are
    returned.
    """
    if sleep is None:
        return contacts
    still, buffer, m = sleep.still, sleep.active, 0
    if contacts.body_a.shape[0] > buffer.body_a.shape[0]:
        buffer = more_contacts(contacts.body_a.shape[0])
    for i in range(contacts.body_a.shape[0]):
        # Islands sleep as a whole, so that one circle tells whether the contact sleeps.
        if still[contacts.body_a[i]] < np.inf:
            buffer.body_a[m], buffer.body_b[m] = contacts.body_a[i], contacts.body_b[i]
            buffer.normal[m, 0], buffer.normal[m, 1] = contacts.normal[i, 0], contacts.normal[i, 1]
            buffer.position[m, 0], buffer.position[m, 1] = contacts.position[i, 0], contacts.position[i, 1]
            buffer.separation[m] = contacts.separation[i]
            buffer.normal_start[m], buffer.tangent_start[m] = contacts.normal_start[i], contacts.tangent_start[i]
            m += 1
    return some_contacts(buffer, 0, m)


@njit(inline="always")
def store_awake_impulses(active, contacts, sleep):
    """Write the solved impulses of the contacts of awake circles into the list of all contacts, in place.

    active: result of `awake_contacts`. contacts: all contacts. sleep: `SleepMemory`, or None if no circle may sleep.
    """
    if sleep is None:
        return
    j = 0
    for i in range(contacts.body_a.shape[0]):
        if sleep.still[contacts.body_a[i]] < np.inf:
            contacts.normal_impulse[i] = active.normal_impulse[j]
            contacts.tangent_impulse[i] = active.tangent_impulse[j]
            j += 1


@njit(inline="always")
def stop_sleeping(solver_bodies, sleep):
    """Set the velocities of sleeping circles in `solver_bodies`, to which gravity was added, back to 0, in place."""
    if sleep is None:
        return
    for i in range(sleep.still.shape[0]):
        if sleep.still[i] == np.inf:
            solver_bodies[i, :INVERSE_MASS] = 0.0


@njit(cache=True)
def look_at_places(sleep, position, dt, scales):
    """Advance the clock by Δt, in place, and compare displacements if half a sleep time is over.

    Returns whether displacements were compared: only then may islands fall asleep. For a circle that accelerates, the
    time for which it has been still is reduced to at most half a sleep time. sleep: `SleepMemory`. position: (n, 2), m.
    dt: Δt, s. scales: `ContactScales`.
    """
    sleep.clock[0] += dt
    if sleep.clock[0] < 0.5 * scales.sleep_time:
        return False
    sleep.clock[0], most = 0.0, STEADY * scales.sleep_speed * scales.sleep_time
    for i in range(position.shape[0]):
        bend = 0.0
        for axis in range(2):
            x, x_1, x_2 = position[i, axis], sleep.place[0, i, axis], sleep.place[1, i, axis]
            bend += abs(x - 2.0 * x_1 + x_2)
            sleep.place[0, i, axis], sleep.place[1, i, axis] = x, x_1
        if sleep.still[i] < np.inf and not bend <= most:
            sleep.still[i] = min(sleep.still[i], 0.5 * scales.sleep_time)
    return True


@njit(cache=True)
def wake_and_put_to_sleep(step, contacts, sleep, actuation):
    """Wake islands and put islands to sleep at the end of a substep, in place.

    The times for which circles have been still are updated first. A fixed circle is still only if it does not move at
    all. An island that touches a moving segment is awake. step: `StepInput`. contacts: contacts at the positions of the
    bodies. sleep: `SleepMemory`, or None if no circle may sleep. actuation: `Actuation` of the step, or None.
    """
    if sleep is None:
        return
    bodies, segments, scales = step.bodies, step.segments, step.scales
    still, parent, shortest = sleep.still, sleep.parent, sleep.shortest
    n = still.shape[0]
    for i in range(n):
        if still[i] < np.inf:
            speed = math.hypot(bodies.velocity[i, 0], bodies.velocity[i, 1])
            is_still = speed <= scales.sleep_speed and abs(bodies.spin[i]) <= scales.sleep_spin
            if bodies.mass[i] == np.inf:
                is_still = speed == 0.0 and bodies.spin[i] == 0.0
            still[i] = still[i] + step.dt if is_still else 0.0
    is_time = look_at_places(sleep, bodies.position, step.dt, scales)
    unite(contacts.body_a, contacts.body_b, parent)
    shortest[:] = np.inf
    for i in range(n):
        root = root_of(parent, i)
        shortest[root] = min(shortest[root], still[i])
    for k in range(contacts.body_a.shape[0]):
        root = root_of(parent, contacts.body_a[k])
        s = contacts.body_b[k] - n - 4
        is_restless = contacts.separation[k] < -POSITION_TOLERANCE * scales.slop or (
            s >= 0 and segments.line[s, 4] != 0.0
        )
        if actuation is not None:
            if s >= 0 and is_moving(actuation.wall, s):
                shortest[root] = 0.0
        if is_restless and shortest[root] < np.inf:
            shortest[root] = 0.0
    for i in range(n):
        time = shortest[root_of(parent, i)]
        if time == np.inf:
            continue
        if is_time and time >= scales.sleep_time:
            still[i] = np.inf
            bodies.velocity[i, 0] = bodies.velocity[i, 1] = bodies.spin[i] = 0.0
        elif still[i] == np.inf:
            still[i] = 0.0
