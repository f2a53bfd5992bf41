"""Sleeping: islands at rest are left as they are, by the rule of Box2D 2.3, until something touches them.

A circle is still while its speed and spin are at most `sleep_speed` and `sleep_spin` of the `ContactScales`. An
island falls asleep once all of its circles have been still for `sleep_time`, none of them accelerates, and none of its
contacts is left to be corrected: their velocities become 0, and their impulses are kept to wake up with. It wakes as a
whole when a circle that is awake touches it, or when the push on one of its circles changes. Contacts are looked for
among all circles, unless all are asleep. A new run starts awake.

Box2D does not ask for acceleration, so a ball on a slope of 0.003 falls asleep there. Here each circle's way in half a
sleep time is compared with its way in the half before, twice in a sleep time, and then islands fall asleep.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.constants import POSITION_TOLERANCE
from deep_contact.physics.collision import make_contacts, more_contacts, some_contacts
from deep_contact.physics.contact_solver import INVERSE_MASS
from deep_contact.physics.islands import root_of, unite
from deep_contact.physics.segments import has_moving, moves
from deep_contact.state.arrays import Contacts

STEADY = 0.02
"""Largest difference of two such ways, in `sleep_speed` times `sleep_time`. A ball on a slope of 2.4e-4 reaches it."""


class SleepMemory(NamedTuple):
    """Who sleeps of n circles, and buffers."""

    still: np.ndarray  # (n,): time for which a circle has been still, s; infinite while it sleeps
    place: np.ndarray  # (2, n, 2): where the circles were when it was last looked, and the time before, m
    clock: np.ndarray  # (1,): time since it was last looked, s
    active: Contacts  # buffer for the `Contacts` of circles that are awake
    parent: np.ndarray  # (n,): buffer: islands
    shortest: np.ndarray  # (n,): buffer: the shortest time of an island
    force: np.ndarray  # (n, 2): the push of the last step in which a circle was awake (`wake_pushed`), N
    torque: np.ndarray  # (n,): likewise, N·m

    @property
    def remembered(self) -> tuple[np.ndarray, ...]:
        """The arrays that a step hands on to the next, which are all but the buffers."""
        return self.still, self.place, self.clock, self.force, self.torque


def make_sleep_memory(n: int, capacity: int) -> SleepMemory:
    """A `SleepMemory` of n circles, all awake, with a buffer for so many contacts."""
    place, clock = np.full((2, n, 2), np.nan), np.full(1, np.inf)
    buffers = make_contacts(capacity), np.empty(n, np.int64), np.empty(n)
    return SleepMemory(np.zeros(n), place, clock, *buffers, np.zeros((n, 2)), np.zeros(n))


@njit(inline="always")
def all_asleep(sleep, drive):
    """Whether no circle is awake, and no segment moves. sleep: None where nothing may. drive: of the step."""
    if sleep is None:
        return False
    if has_moving(drive):
        return False
    for time in sleep.still:
        if time < np.inf:
            return False
    return True


@njit(cache=True, error_model="numpy")
def wake_pushed(contacts, sleep, step):
    """Wake, in place, the islands of sleeping circles whose push is another than the one they fell asleep under.

    Where the difference accelerates a free circle by less than `look_at_places` sees, it sleeps on. contacts: those at
    the bodies' positions. step: `StepInput` with the push of the step to come.
    """
    bodies, scales, drive, n = step.bodies, step.scales, step.drive, sleep.still.shape[0]
    most, is_any = 4.0 * STEADY * scales.sleep_speed / scales.sleep_time, False
    sleep.shortest[:] = np.inf
    for i in range(n):
        if sleep.still[i] == np.inf:
            change = math.hypot(drive.force[i, 0] - sleep.force[i, 0], drive.force[i, 1] - sleep.force[i, 1])
            change += abs(drive.torque[i] - sleep.torque[i]) / bodies.radius[i]
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
            sleep.force[i, 0], sleep.force[i, 1] = drive.force[i, 0], drive.force[i, 1]
            sleep.torque[i] = drive.torque[i]


@njit(inline="always")
def awake_contacts(contacts, sleep):
    """The contacts of circles that are awake, with the fields that a step reads, in the buffer; without `sleep` all."""
    if sleep is None:
        return contacts
    still, buffer, m = sleep.still, sleep.active, 0
    if contacts.body_a.shape[0] > buffer.body_a.shape[0]:
        buffer = more_contacts(contacts.body_a.shape[0])
    for i in range(contacts.body_a.shape[0]):
        # Islands sleep as a whole, so the first circle tells.
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
    """Write the solved impulses of the contacts that are awake among all contacts, in place: `awake_contacts` back."""
    if sleep is None:
        return
    j = 0
    for i in range(contacts.body_a.shape[0]):
        if sleep.still[contacts.body_a[i]] < np.inf:
            contacts.normal_impulse[i] = active.normal_impulse[j]
            contacts.tangent_impulse[i] = active.tangent_impulse[j]
            j += 1


@njit(inline="always")
def hold_sleeping(solver_bodies, sleep):
    """Take back, in place, what gravity did to the circles that are asleep."""
    if sleep is None:
        return
    for i in range(sleep.still.shape[0]):
        if sleep.still[i] == np.inf:
            solver_bodies[i, :INVERSE_MASS] = 0.0


@njit(cache=True)
def look_at_places(sleep, position, dt, scales):
    """Let Δt pass, in place. Returns whether half a sleep time is over: islands may fall asleep then.

    A circle that accelerates has not been still for long enough then.
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
def wake_and_put_to_sleep(step, contacts, sleep, drive):
    """Let Δt pass, in place, for the stillness of circles and islands. contacts: those at the bodies' positions.

    A fixed circle is still where it does not move at all. What touches a segment that moves is awake. sleep: None where
    nothing may. drive: of the step.
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
        if drive is not None:
            if s >= 0 and moves(drive.wall, s):
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
