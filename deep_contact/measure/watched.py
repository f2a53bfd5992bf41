"""Runs that are watched in every step, for their errors. They are not timed.

A run of this package logs the deepest penetration at the start of each of its substeps. Another engine is read after
each of its steps. Its positions go through the contact detection of this package, so that all engines are measured by
the same gaps. Box2D v3 moves bodies in substeps of its own, which cannot be read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from deep_contact.measure.errors import Reading
from deep_contact.measure.setting_runs import POSITION_SWEEPS, world_of
from deep_contact.measure.settings import solver_of
from deep_contact.run.simulator import Simulator
from deep_contact.state.state import State, StateWithContacts
from deep_contact.state.validation import expect
from deep_contact.stepping.broad_phase import make_cells
from deep_contact.stepping.contacts import Exclusions, Walls, detect_contacts, make_contacts
from deep_contact.stepping.inputs import reach_of
from deep_contact.stepping.problem import contacts_of
from deep_contact.stepping.segment_grid import segments_in_grid


class OursWatched:
    """A run of this package. `deepest` is the deepest penetration since the run was made or `forget` was called, m."""

    def __init__(self, start: State, setting: Mapping):
        begin = setting.get("start", "builtin")
        self._live = Simulator(start.replace(dt=setting["dt"]), solver=solver_of(setting), warm_start=begin)
        self.deepest = self._last = 0.0

    def advance(self, steps: int) -> None:
        """Do `steps` steps of the setting's Δt."""
        live, least, done = self._live, np.zeros(1), 0
        while done < steps:
            count = min(steps - done, live._affordable())
            log = live._rows(live._new_log(count), 0, count)
            done += live._advance(log._replace(deepest=least))
        self._last = -float(live._now.contacts.separation.min(initial=0.0))
        self.deepest = max(self.deepest, -float(least[0]), self._last)

    def forget(self) -> None:
        """Let `deepest` be the present penetration."""
        self.deepest = self._last

    def velocity(self) -> np.ndarray:
        """Return the velocities of the circles, (n, 2), m/s."""
        return self._live.velocities

    def state(self) -> StateWithContacts:
        """Return the present state."""
        return self._live.state


class PeerWatched:
    """A run of another engine. `deepest` is the deepest penetration since it was made or `forget` was called, m."""

    def __init__(self, start: State, setting: Mapping):
        self._state, self._setting, self._world = start, setting, world_of(start.replace(dt=setting["dt"]), setting)
        world, scales, n = start.world, start.scales, start.bodies.count
        segments = segments_in_grid(world, reach_of(start, scales)) if world.segments else None
        walls, exclusions = Walls(world.box, scales.wall_skin), Exclusions(mass=None, touches=None)
        self._detection = walls, segments, exclusions, make_cells(n), make_contacts(4 * n + 64)
        self.deepest = self._last = 0.0
        self._steps = 0

    def advance(self, steps: int) -> None:
        """Do `steps` steps of the setting's Δt."""
        setting, radius = self._setting, self._state.bodies.radius
        most = setting.get("position_sweeps", POSITION_SWEEPS)
        for _ in range(steps):
            self._world.step(setting["dt"], setting["sweeps"], most)
            position = self._world.positions()
            expect(
                np.isfinite(position).all(), f"position: expected finite numbers from {setting['engine']}, got others"
            )
            found = detect_contacts(position, radius, *self._detection)
            self._last = -float(found.separation.min(initial=0.0))
            self.deepest = max(self.deepest, self._last)
        self._steps += steps

    def forget(self) -> None:
        """Let `deepest` be the present penetration."""
        self.deepest = self._last

    def velocity(self) -> np.ndarray:
        """Return the velocities of the circles, (n, 2), m/s."""
        return self._world.velocities()

    def state(self) -> StateWithContacts:
        """Return the present state, with contacts that have no impulses."""
        time = self._state.time + self._steps * self._setting["dt"]
        state = self._state.replace(bodies=self._world.bodies(), time=time, dt=self._setting["dt"])
        return state.replace(contacts=contacts_of(state))


def readings_of(start: State, setting: Mapping, frames: int, interval: float) -> Iterator[Reading]:
    """Yield `frames` readings of a run, one every `interval`, s. They have the velocities after each `start.dt`.

    Raises ValueError if the setting's Δt does not divide that of the scene, or that does not divide `interval`.
    """
    run = (PeerWatched if "engine" in setting else OursWatched)(start, setting)
    steps, each = round(interval / start.dt), round(start.dt / setting["dt"])
    for name, whole, count, part in (("dt", start.dt, each, setting["dt"]), ("scene.dt", interval, steps, start.dt)):
        text = f"{name}: expected a step that divides {whole:g} s, got {part}"
        expect(math.isclose(count * part, whole, rel_tol=1e-5), text)
    mass = start.bodies.free_mass
    share = mass / mass.sum() if mass.any() else mass
    last = share @ run.velocity()
    for _ in range(frames):
        velocity = [last]
        for _ in range(steps):
            run.advance(each)
            velocity.append(share @ run.velocity())
        state, last = run.state(), velocity[-1]
        yield Reading(state, run.deepest, np.array(velocity), start.dt)
        run.forget()
