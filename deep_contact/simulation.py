"""The validated interface of the engine: `Simulator`, `simulate`, `simulate_many`, contacts and their solution."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from deep_contact.parallel import cores, parallel_map, workers
from deep_contact.physics import engine
from deep_contact.physics.convergence import ConvergenceRecord, convergence_record
from deep_contact.physics.engine import ContactSolution, StepProblem, Steps, step_input
from deep_contact.physics.forces import SIDES
from deep_contact.physics.load import (
    has_new_load,
    load_of,
    with_a_past,
    with_new_load,
    with_shifted_flights,
    with_time_step,
)
from deep_contact.physics.ready import find_contacts, ready
from deep_contact.physics.sleeping import wake_pushed
from deep_contact.physics.solvers import PGS
from deep_contact.physics.solvers.registry import entry_of, tolerance_argument
from deep_contact.physics.step import (
    DONE,
    FINITE,
    LAST_SWEEPS,
    PASSED,
    WORK,
    StepLog,
    make_log,
    of_whole_step,
    some_steps,
)
from deep_contact.presets import Accuracy, Decision, MeasuredAccuracy, PresetWarning, decide
from deep_contact.state import State, StateWithContacts, World, changed, frozen, notebook, read_only
from deep_contact.state.arrays import LIMITS, Bodies, Contacts
from deep_contact.state.checks import (
    checked_indices,
    checked_push,
    checked_velocities,
    warn_of_jumps,
)
from deep_contact.state.equality import by_value
from deep_contact.trajectory import Trajectory
from deep_contact.validation import brief, expect, flag, integer, list_of, one_of, suggesting, warn
from deep_contact.warm_start import Builtin, NoStart, Start, WarmStart, starting_impulses, warm_start_of

MOST_WORK = 20_000_000
"""Largest work of one call of compiled code, in relaxations of a contact."""

SECONDS = 0.2
"""Time that one call should take, s: Ctrl-C takes effect between calls."""

MOST_STEPS = 10**12
"""Largest number of steps of a run. Its result has 40 bytes a step, so that memory ends before."""

KEPT = 20_000
"""Most circles of a run whose memory is kept for the next call of `simulate`."""

TASKS = 16
"""Tasks for each worker of `simulate_many(jobs=…)`. Where an executor replaces a lost worker, it repeats one task."""


@by_value
class Simulation(NamedTuple):
    """A finished run.

    | field       | meaning                                                                                   |
    |-------------|-------------------------------------------------------------------------------------------|
    | state       | the `State` after the last step, ready to go on: its contacts have been found, not solved |
    | contacts    | number of contacts solved in each step, (steps,): all but those that are asleep           |
    | sweeps      | number of velocity sweeps in each step, (steps,); with islands, of the slowest island     |
    | theta       | θ after the last sweep of each step, (steps,), N·s; infinite where no sweep was done      |
    | relaxations | contacts times sweeps in each step, (steps,); with islands, summed over the islands       |
    | substeps    | number of substeps of each step, (steps,)                                                 |
    | recorded    | the recorded states as a `Trajectory`, which ends with `state`; None without record=…     |
    | loads       | sum of the impulses on walls and segments until each recorded state, (T, 4 + S, 2), N·s;  |
    |             | None without forces=True                                                                  |
    | solved      | the solved states, as of `on_step`, of the steps that led to recorded states, as a        |
    |             | `Trajectory`; None without forces=True                                                    |
    | on_circles  | sum of the contact impulses on circles until each recorded state, (T, n, 2), N·s; None    |
    |             | without moving segments, fixed circles and pushes                                         |
    | shifts      | momentum of circles from gravity beyond m g t until each recorded state, (T, n, 2), N·s;  |
    |             | None if e = 0, or if there are `on_circles`                                               |

    With substeps, contacts and θ are those of a step's last substep, sweeps and relaxations sums over its substeps.
    """

    state: StateWithContacts
    contacts: np.ndarray
    sweeps: np.ndarray
    theta: np.ndarray
    relaxations: np.ndarray
    substeps: np.ndarray
    recorded: Trajectory | None = None
    loads: np.ndarray | None = None
    solved: Trajectory | None = None
    on_circles: np.ndarray | None = None
    shifts: np.ndarray | None = None

    @property
    def trajectory(self) -> Trajectory:
        """The recorded states. Raises ValueError if none were recorded."""
        if self.recorded is None:
            raise ValueError("trajectory: expected a run of simulate(…, record=…), got one that recorded no states")
        return self.recorded

    def force_on(self, part: str, index: int | Sequence[int] | np.ndarray | None = None) -> np.ndarray:
        """The mean contact force on a part of the scene between each recorded state and the next, (T − 1, 2), N.

        Force k is the mean from times[k] to times[k + 1] of the trajectory, over all steps and substeps, rebounds
        included. The force on a circle is its change of momentum over time, without those by gravity and pushes.

        part: "floor", "right", "ceiling", "left", "segment", "circle", or "wall", which stands for the four sides,
        numbered in this order. index: of the segment, the circle or the wall, or several, whose forces are added up;
        None if `part` names a side. Raises ValueError if no states were recorded, for walls and segments without
        forces=True, and on an unknown part or index.
        """
        recorded, world = self.trajectory, self.state.world
        if part in SIDES:
            expect(index is None, f"index: expected none of the {part}, got {brief(index)}")
            part, index = "wall", SIDES.index(part)
        count = {"wall": 4, "segment": len(world.segments), "circle": self.state.bodies.count}
        chosen = checked_indices("index", index, count[one_of("part", part, (*SIDES, "segment", "circle", "wall"))])
        seconds = np.diff(recorded.times)[:, None]
        if part == "circle" and self.on_circles is not None:
            return np.diff(self.on_circles[:, chosen].sum(axis=1), axis=0) / seconds
        if part == "circle":
            mass = self.state.bodies.mass[chosen]
            change = np.einsum("tik,i->tk", np.diff(recorded.velocities[:, chosen], axis=0), mass)
            if self.shifts is not None:
                change -= np.diff(self.shifts[:, chosen].sum(axis=1), axis=0)
            return change / seconds - mass.sum() * np.array(world.gravity)
        if self.loads is None:
            raise ValueError("forces: expected a run of simulate(…, record=…, forces=True), got one without")
        return np.diff(self.loads[:, (4 if part == "segment" else 0) + chosen].sum(axis=1), axis=0) / seconds

    @property
    def status(self) -> np.ndarray:
        """Why each step's sweeps ended, (steps,): see `ConvergenceRecord`."""
        tolerance = tolerance_argument(self.state.solver)
        cases = [self.contacts == 0, self.theta <= tolerance, (self.sweeps > 0) & ~np.isfinite(self.theta)]
        return np.select(cases, ["no_contacts", "converged", "diverged"], "max_sweeps")

    def __repr__(self) -> str:
        return f"Simulation({', '.join(self._summary().values())}, state={self.state!r})"

    def _repr_html_(self) -> str:
        """HTML for notebooks: a summary of the run, and its last state."""
        return notebook.shown("Simulation", self._summary().items()) + self.state._repr_html_()

    def _summary(self) -> dict[str, str]:
        summary = {"steps": notebook.counted(self.sweeps.size, "step")}
        if self.sweeps.size:
            ends = self.status
            summary["sweeps"] = f"{self.sweeps.mean():.1f} sweeps a step"
            if self.substeps.max() > 1:
                summary["substeps"] = f"{self.substeps.mean():.1f} substeps a step"
            if tolerance_argument(self.state.solver) > 0:  # without a tolerance every step does all sweeps
                summary["solves"] = f"converged in {np.isin(ends, ('converged', 'no_contacts')).sum():,} steps"
            if (ends == "diverged").any():
                summary["diverged"] = f"{(ends == 'diverged').sum():,} diverged"
        return summary | ({} if self.recorded is None else {"record": notebook.counted(len(self.recorded), "state")})


@suggesting
class Simulator:
    """A live scene: it does steps, keeps the engine's memory from step to step, and can be changed between steps.

    The arguments are those of `simulate`. If a preset chose the solver, as by default, it chooses again when the scene
    changes. Steps give the same bits one by one, in several calls and in one call. After Ctrl-C or an error the
    simulator stands at a whole step, and can go on. Pickles hold its state.

    | property   | meaning                                                   | shape  | unit |
    |------------|-----------------------------------------------------------|--------|------|
    | positions  | centres of the circles; a view, which every step changes  | (n, 2) | m    |
    | velocities | velocities of the centres; a view as well                 | (n, 2) | m/s  |
    | time       | time of the scene                                         |        | s    |
    | state      | a `State` with copies of the arrays, made at each access  |        |      |

    The views are read-only; `set`, `add` and `remove` change the scene. To put circles elsewhere, make a new simulator
    of a changed state: `dc.Simulator(live.state.replace(bodies=…, contacts=None))`.

    Raises ValueError on arguments that do not fit each other.
    """

    _has_warned = False  # of a segment that jumps
    _has_warned_of_passing = False

    def __init__(
        self,
        state: State,
        *,
        solver=None,
        accuracy: Accuracy | MeasuredAccuracy | None = None,
        warm_start: Start = "builtin",
        sleep: bool = False,
        push=None,
    ):
        how = {"solver": solver, "accuracy": accuracy, "warm_start": warm_start, "sleep": sleep, "push": push}
        is_anew = solver is None and getattr(state, "solver", None) is None
        self._options, self._steps = RunOptions(**how, is_anew=is_anew), None
        self._go_on(*_prepared(state, self._options))

    def step(self, steps: int = 1) -> None:
        """Do `steps` steps. Raises FloatingPointError if the solver diverges to positions that are not finite."""
        done, steps = 0, integer("steps", steps, hint="; seconds are steps of Δt, which set(dt=…) changes")
        while done < steps:
            count = min(steps - done, self._affordable())
            if count == 1:
                done += self._advance(self._one_step())
            else:
                done += self._advance(self._rows(make_log(count), 0, count))

    def show(self, steps: int = 0, *, every: int = 10) -> None:
        """Draw the state in a notebook, do `steps` steps, and redraw the state in its place after each `every` steps.

        Raises ValueError outside of a notebook, and FloatingPointError as `step` does.
        """
        done, steps, every = 0, integer("steps", steps), integer("every", every, least=1)
        notebook.show(self)
        while done < steps:
            count = min(every, steps - done)
            self.step(count)
            done += count
            notebook.show(self)

    def _repr_html_(self) -> str:
        return self.state._repr_html_()

    @property
    def positions(self) -> np.ndarray:
        return self._views[0]

    @property
    def velocities(self) -> np.ndarray:
        return self._views[1]

    @property
    def time(self) -> float:
        return self._now.time

    @property
    def state(self) -> StateWithContacts:
        return self._state(np.ndarray.copy)

    @suggesting
    def set(
        self, *, gravity=None, friction=None, restitution=None, dt=None, segments=None, segment_velocities=None,
        push=None,
    ) -> None:  # fmt: skip
        """Change the world, the time step or the push from now on. Values of None change nothing. All circles wake.

        Contacts keep their impulses; those with segments are matched by the segments' indices. A segment with a new
        position jumps there, and a warning says so once; segment_velocities move it instead.

        dt: time step, s. push: as of `simulate`; forces of 0 end it. Raises ValueError, and changes nothing, on values
        that `World` refuses.
        """
        fields = {"gravity": gravity, "friction": friction, "restitution": restitution, "segments": segments}
        if dt is None and push is None and not any(value is not None for value in fields.values()):
            if segment_velocities is None or self._set_velocities(segment_velocities):
                return
        fields |= {"segment_velocities": segment_velocities}
        fields, state = {name: value for name, value in fields.items() if value is not None}, self.state
        if segments is not None:  # velocities and surface speeds may be those of another number of segments
            for name in ("segment_velocities", "surface_speeds"):
                kept = getattr(state.world, name)
                fields.setdefault(name, kept if len(kept) == len(segments) else ())
        if fields:
            world, contacts = replace(state.world, **fields), state.contacts
            if segments is not None:
                if not self._has_warned:
                    self._has_warned = warn_of_jumps(state.world, world)
                stays = contacts.body_b < state.bodies.count + 4 + len(world.segments)
                contacts = Contacts(*(values[stays] for values in contacts))
            # A preset decides anew, since the speed of a segment may make it divide the step.
            state = replace(state, world=world, contacts=contacts, preset=None)
        self._change(state if dt is None else with_time_step(state, dt), push)

    def _set_velocities(self, segment_velocities) -> bool:
        """Set the velocities of the segments in place, which takes less time than `_change`, if that is possible.

        It is possible if the same segments move as before. With a preset, no segment may be faster than when the preset
        chose the solver. Returns whether the velocities were set.
        """
        drive, world = self._inputs.drive, self._scene.world
        most = LIMITS["world.segment_velocities"][1]
        if self._options.accuracy is not None or self._options.is_anew:
            most = self._fastest_wall
        velocities = checked_velocities(segment_velocities, len(world.segments))
        wall = np.array(velocities).reshape(-1, 4)
        if drive is None or wall.shape != drive.wall.shape or np.abs(wall).max(initial=0.0) > most:
            return False
        if (wall.any(axis=1) != drive.wall.any(axis=1)).any():
            return False
        self._steps.wake()
        self._scene = changed(self._scene, world=changed(world, segment_velocities=velocities))
        self._origin = self._now
        drive.wall[:] = wall
        return True

    def add(self, bodies: Bodies) -> np.ndarray:
        """Add circles behind the others (`State.with_bodies`). All circles wake. Returns indices of the new circles.

        A constant push has forces of 0 on the new circles.
        """
        first = self._scene.bodies.count
        self._change(self.state.with_bodies(add=bodies))
        return np.arange(first, self._scene.bodies.count)

    def remove(self, which: Sequence | np.ndarray) -> np.ndarray:
        """Remove circles, by their indices or by a flag for each (`State.with_bodies`). All circles wake.

        Returns the new index of each circle of before, (n,); −1 for removed circles.
        """
        n = self._scene.bodies.count
        gone, index = checked_indices("remove", which, n), np.full(n, -1)
        index[np.delete(np.arange(n), gone)] = np.arange(n - len(gone))
        self._change(self.state.with_bodies(remove=gone))
        return index

    def __reduce__(self):
        return _restored, (self.state, self._start, self._options)

    def __repr__(self) -> str:
        return f"Simulator({self.state!r})"

    def _change(self, state: State, push=None) -> None:
        """Go on from another state. push: the new push; None keeps a function, and otherwise takes the state's push."""
        if push is None:
            push = self._options.push if callable(self._options.push) else state.push
        options = self._options._replace(push=push)
        prepared = _prepared(state, options)
        self._options = options
        self._go_on(*prepared)

    def _go_on(self, state: StateWithContacts, start: WarmStart) -> None:
        """Go on from a state that is ready, with its solver."""
        solver, n, sleep = state.solver, state.bodies.count, self._options.sleep
        bodies, contacts = (type(part)(*map(np.copy, part)) for part in (state.bodies, state.contacts))
        if isinstance(start, NoStart):
            contacts.normal_start[:] = contacts.tangent_start[:] = 0.0
        scene = replace(state, bodies=bodies, contacts=contacts, load=None)
        scales = engine.scales_of(state, solver)
        inputs = step_input(scene, solver, scales)
        kind = solver, sleep, isinstance(start, NoStart)
        if self._steps is None or kind != self._kind or not np.array_equal(bodies.radius, self._scene.bodies.radius):
            self._steps = Steps(solver, n, sleep=sleep, carry=not isinstance(start, NoStart))
            # Allocated before the arrays of results, which lie above: its release leaves no gap at the top of the heap,
            # which Linux would take.
            self._steps.memory(inputs, contacts.count)
        self._steps.wake()
        self._kind, self._start, self._scene, self._scales, self._inputs = kind, start, scene, scales, inputs
        # Without friction, tangent rows are left out once no contact starts from a tangent impulse.
        self._may_lose_tangents = scene.world.friction == 0.0 and entry_of(solver).advance is None
        self._is_one_solve = replace(scene, solved=True).holds_solution
        self._asks_between = callable(self._options.push) or not isinstance(start, (Builtin, NoStart))
        self._origin = self._now = _Now(contacts, state.step, state.time, state.solved)
        if callable(self._options.push):
            self._scene = scene = replace(scene, push=(np.zeros((n, 2)), np.zeros(n)))
            self._inputs = step_input(scene, solver, scales)
        self._push = scene.push
        drive = self._inputs.drive
        self._fastest_wall = 0.0 if drive is None else np.abs(drive.wall).max(initial=0.0)
        self._moved = tuple(bodies[:4])  # arrays that a step changes
        self._never_change = tuple(map(frozen, bodies[4:]))
        if scene.world.segment_velocities:
            self._moved += (self._inputs.segments.line,)
        if self._steps.sleep is not None:
            self._moved += self._steps.sleep.remembered
        self._kept, self._log, self._work = tuple(map(np.copy, self._moved)), make_log(1), MOST_WORK // 8
        self._views = tuple(array.view() for array in bodies[:2])
        for view in self._views:
            view.flags.writeable = False
        self._seen: tuple = ()  # arguments of `on_step` for the last watched step

    def _affordable(self) -> int:
        """The number of steps that a call may do: 1 if the start or the push needs Python between two steps."""
        if self._asks_between:
            return 1
        return 1 + self._work // (10 * self._scene.bodies.count + 50)

    def _rows(self, log: StepLog, first: int, count: int, is_watched: bool = False) -> StepLog:
        """`count` rows of a log from `first` on, as the log of a call."""
        return some_steps(log, first, count, self._work, is_watched and not self._is_one_solve)

    def _one_step(self) -> StepLog:
        """A log of one step, whose arrays the next step uses again."""
        log = self._log
        log.sweeps[0] = log.relaxations[0] = log.parts[0] = log.progress[DONE] = 0
        log.progress[WORK] = self._work
        return log

    def _state(self, taken) -> StateWithContacts:
        """The present state. taken: the function that copies or views each array of the bodies for the caller."""
        contacts, step, time, solved = self._now
        bodies, contacts = Bodies(*map(taken, self._scene.bodies)), Contacts(*map(np.ndarray.copy, contacts))
        push = None if callable(self._options.push) else self._scene.push
        fields = {"world": self._world(), "bodies": bodies, "contacts": contacts, "push": push, "solved": solved}
        state = changed(self._scene, **fields, step=step, time=time)
        return changed(state, load=load_of(state))

    def _world(self) -> World:
        """The world with its segments at their present positions."""
        world = self._scene.world
        return replace(world, segments=self._inputs.segments.line[:, :4]) if world.segment_velocities else world

    def _advance(self, log: StepLog, is_watched: bool = False) -> int:
        """Do at most as many steps as the log has rows; after an error no step is done. Returns their number."""
        before = self._now
        for kept, array in zip(self._kept, self._moved):
            kept[...] = array
        impulses = before.contacts.normal_impulse.copy(), before.contacts.tangent_impulse.copy()
        try:
            return self._advance_from(before, log, is_watched)
        except BaseException:
            if self._now is before:
                for kept, array in zip(self._kept, self._moved):
                    np.copyto(array, kept)
                names = "normal_impulse", "tangent_impulse"
                contacts = before.contacts._replace(**dict(zip(names, impulses)))
                # In other arrays than those that the lost steps have written.
                self._now = before._replace(contacts=Contacts(*map(np.copy, contacts)))
            raise

    def _advance_from(self, before: _Now, log: StepLog, is_watched: bool) -> int:
        contacts, problem, scene = before.contacts, None, self._scene
        if self._asks_between:
            contacts, problem = self._start_from_python(contacts)
        inputs = self._inputs
        if self._may_lose_tangents:
            friction = step_input(replace(scene, contacts=contacts), scene.solver, self._scales).friction
            inputs = inputs if friction == inputs.friction else inputs._replace(friction=friction)
        shifts = log.shifts
        if is_watched:
            bodies = Bodies(*map(frozen, scene.bodies[:4]), *self._never_change)
            world, push = self._world(), self._push
            if scene.world.restitution > 0.0:
                log = log._replace(shifts=np.zeros((scene.bodies.count, 2)))
        begun = time.perf_counter()
        following, received = self._steps(inputs, contacts, log, problem)
        if len(log.contacts) > 1:  # how a run is divided changes no bit of it
            seconds = time.perf_counter() - begun
            self._work = min(MOST_WORK, 2 * self._work, 1 + int(self._work * SECONDS / seconds))
        done = int(log.progress[DONE]) // inputs.parts
        step, dt, origin = before.step + done, scene.dt, self._origin
        if not log.progress[FINITE]:
            _raise_diverged(scene.bodies, step)
        if log.progress[PASSED] and not self._has_warned_of_passing:
            self._has_warned_of_passing = True
            warn(
                f"up to step {step}: a moving segment passes over circle {log.progress[PASSED] - 1}, which what rests "
                "holds in its way; more warnings of this kind are left out"
            )
        # From the number of steps, not by adding up, so that time does not depend on how a run was divided.
        is_even = origin.time == origin.step * dt
        now = step * dt if is_even else origin.time + (step - origin.step) * dt
        if is_watched:
            theta = self._steps.memory(inputs).theta[: log.progress[LAST_SWEEPS]]
            is_one_solve = log.parts[0] == 1 and scene.world.restitution == 0.0
            solved = Contacts(*map(frozen, contacts if is_one_solve else of_whole_step(contacts, received)))
            fields = {"world": world, "bodies": bodies, "contacts": solved, "push": push, "solved": True}
            seen = changed(scene, **fields, step=before.step, time=before.time)
            of_step = frozen(log.shifts) if len(log.shifts) else None
            self._seen = seen, convergence_record(theta, scene.solver, int(log.contacts[0]), of_step)
            if len(shifts) and shifts is not log.shifts:
                shifts += log.shifts
        self._now = _Now(following, step, now, False)
        return done

    def _start_from_python(self, contacts: Contacts) -> tuple[Contacts, StepProblem | None]:
        """The contacts with the impulses of a start in Python, and their problem, if built. Also updates the push."""
        push, solver, problem = self._options.push, self._scene.solver, None
        if callable(push):
            self._push = force, torque = checked_push(push(read_only(self.state)), self._scene.bodies.count)
            self._inputs = self._inputs._replace(drive=self._inputs.drive._replace(force=force, torque=torque))
            if self._steps.sleep is not None:
                wake_pushed(contacts, self._steps.sleep, self._inputs)
        if not isinstance(self._start, (Builtin, NoStart)):
            state = replace(self.state, push=self._push)
            normal, tangent, problem = starting_impulses(self._start, state, solver, self._scales)
            contacts = contacts._replace(normal_start=normal, tangent_start=tangent)
        return contacts, problem


class _Now(NamedTuple):
    """Moment of a `Simulator`, in one value, so that an interrupt finds it before a step or after it."""

    contacts: Contacts
    step: int
    time: float
    solved: bool


def _restored(state: StateWithContacts, start: WarmStart, options: RunOptions) -> Simulator:
    """A `Simulator` that goes on from the state of another."""
    simulator = Simulator.__new__(Simulator)
    simulator._options, simulator._steps = options, None
    simulator._go_on(state, start)
    return simulator


def _raise_diverged(bodies: Bodies, step: int) -> None:
    circle = int(np.flatnonzero(~np.isfinite(bodies.position).all(axis=1))[0])
    raise FloatingPointError(
        f"up to step {step}: circle {circle} (mass {bodies.mass[circle]:g} kg, radius {bodies.radius[circle]:g} m) has "
        "come to a position that is not finite: the solver diverged; try PGS, a smaller dt"
    )


def _prepared(state: State, options: RunOptions) -> tuple[StateWithContacts, WarmStart]:
    """(State, start) at the start of a run: the state is validated, with its solver and the impulses it starts from."""
    first, state = state, ready(state)
    accuracy, push = options.accuracy, options.push
    constant = None if push is None or callable(push) else checked_push(push, state.bodies.count)
    state = replace(state, push=constant)
    without_past = first.contacts is None or state.step == 0
    chosen_for = changed(state, solver=None) if options.is_anew and accuracy is None else state
    how = options.solver, options.warm_start, accuracy
    solver, start, _, decision = method_of(chosen_for, *how, sleep=options.sleep)
    for sentence in decision.warnings if decision else ():
        warn(sentence, PresetWarning)
    # Not for a run that goes on, so that a run has the same result in one call and in several.
    if decision and without_past and isinstance(start, Builtin) and not state.contacts.normal_start.any():
        state = with_a_past(state)
    elif has_new_load(state):
        state = find_contacts(state)
        state = state if isinstance(start, NoStart) else with_new_load(state, solver)
    if state.solver is not None:
        state = with_shifted_flights(state, state.dt / state.solver.substeps - state.dt / solver.substeps)
    # A solved state is solved again from where it started, so that a resumed run repeats the steps of the first.
    preset = accuracy if isinstance(accuracy, str) else state.preset if solver == state.solver else None
    return state.replace(solver=solver, preset=preset), start


@suggesting
def solve_contacts(state: State, *, solver=None, start: Start | Sequence[np.ndarray] = "builtin") -> ContactSolution:
    """Solve the contact problem of a state: gravity for Δt, then the impulses. The state stays as it is.

    solver: options such as `PGS(sweeps=…)`; by default the state's own. start: as `warm_start` of `simulate`, or
    two arrays (normal, tangent), (m,) each, N·s.
    Raises ValueError on a state, solver or start that is not valid.
    """
    state = ready(state)
    solver = checked_solver(solver, state)
    return engine.solve(state, solver, *starting_impulses(start, state, solver))


@suggesting
def step(state: State, *, solver=None, warm_start: Start = "builtin") -> StateWithContacts:
    """One step: the state Δt later, with its contacts found and the solved impulses carried over to them.

    For the impulses that the step solved, see `simulate`'s `on_step`. Arguments and errors as in `simulate`. A
    `Simulator` does many steps in less time than a loop over this function.
    """
    return simulate(state, steps=1, solver=solver, warm_start=warm_start).state


@suggesting
def simulate(
    state: State,
    *,
    steps: int = 600,
    dt: float | None = None,
    solver=None,
    warm_start: Start = "builtin",
    accuracy: Accuracy | MeasuredAccuracy | None = None,
    sleep: bool = False,
    push=None,
    record: int | None = None,
    forces: bool = False,
    until: Callable[[StateWithContacts], object] | None = None,
    on_step: Callable[[StateWithContacts, ConvergenceRecord], None] | None = None,
) -> Simulation:
    """Run a scene for a number of steps, or go on from a state.

    dt: time step, s, by default the state's; carried impulses are scaled by the ratio of the two.
    solver: options such as `PGS(sweeps=…)`; by default the state's solver, or the one of accuracy="fast".
    warm_start: None, the name of a start, a callable as in `deep_contact.warm_start`, which is called once a step, or a
    network: one that `dc.load_model` returns, or the path of its file, "….h5".
    accuracy: "preview", "fast", "balanced", "accurate" or "reference", in place of solver and start: the cheapest
    setting that was measured to keep the tolerances of this preset (`presets.PRESETS`) on the errors of a run; or a
    `Trade` that `measure_trade` measured on your scene. If the scene's circles are too small or too fast for its Δt,
    the step is divided into substeps. At step 0, contacts without impulses, as of positions from another source, get
    impulses at which they rest, if there are any (`physics.relaxation`), or accurately solved ones.
    sleep: whether an island falls asleep once it has been still for `State.scales.sleep_time` (0.5 s for circles of
    r = 1 m), as in Box2D 2.3. It wakes when something touches it or the push on it changes (`physics.sleeping`). States
    do not store which circles sleep: a run that goes on from a state starts with all circles awake.
    push: forces on the circles beside gravity, (n, 2), N, or a tuple of forces and torques, (n,), N·m; or a function of
    the state that returns them, which is called before each step. They do not act on fixed circles.
    record: number of steps between two recorded states; the first and the last state are recorded too, and
    `Simulation.trajectory` has them all.
    forces: whether to add up the impulses on walls and segments between recorded states, for `Simulation.force_on`, and
    to keep the solved state of the step that led to each recorded state, as `Simulation.solved`.
    until: function that is called after each step with the state after it; the run ends when it returns a true value.
    on_step: function that is called after each step with the solved state and the `ConvergenceRecord` of its sweeps,
    which for a divided step is that of the last substep. The solved state has the bodies before the step, and the
    contacts of the step: `normal_start` and `tangent_start` are the impulses from which they started, `normal_impulse`
    and `tangent_impulse` their impulses in the step, summed over substeps and rebounds. Contacts that came during the
    step are among them, at the places where they came, and with starts of 0. The change of a circle's momentum is the
    sum of these impulses, of those of gravity and pushes, and if e > 0 of the record's `shifts`. A run that goes on
    from such a state, with the same push, repeats the step. The arrays that `until` and `on_step` get are read-only;
    use a `Simulator` to change a run between steps.
    Raises ValueError on arguments that do not fit each other, and FloatingPointError if the solver diverges to
    positions that are not finite. The run can be interrupted.
    """
    options = RunOptions(
        steps=steps, dt=dt, solver=solver, warm_start=warm_start, accuracy=accuracy, sleep=sleep, push=push,
        record=record, forces=forces, until=until, on_step=on_step,
    )  # fmt: skip
    return _simulate(state, options)


class RunOptions(NamedTuple):
    """The options of `simulate`, which says what they mean; `Simulator` and `simulate_many` have some of them."""

    steps: int = 600
    dt: float | None = None
    solver: object = None
    warm_start: Start = "builtin"
    accuracy: Accuracy | MeasuredAccuracy | None = None
    sleep: bool = False
    push: object = None
    record: int | None = None
    forces: bool = False
    until: Callable | None = None
    on_step: Callable | None = None
    is_anew: bool = False  # whether a `Simulator`, which got no solver, chooses again when its scene changes

    @property
    def how(self) -> tuple:
        """The options that have to be the same for a call to go on with the run of the call before (`_LastRun`)."""
        return self.solver, self.accuracy, self.warm_start, self.sleep


def _simulate(state: State, options: RunOptions, stopped: threading.Event | None = None) -> Simulation:
    """`simulate`, which ends with a KeyboardInterrupt once the event `stopped` is set."""
    record, forces, until, on_step = options.record, options.forces, options.until, options.on_step
    steps = integer("steps", options.steps, most=MOST_STEPS, hint="; Δt is dt=…")
    if record is not None:
        integer("record", record, least=1)
    expect(not flag("forces", forces) or record is not None, "forces: expected False without record=…, got True")
    if options.dt is not None:
        state = with_time_step(state, options.dt)
    run = _last_run.take(state, options.how) if options.push is None else None
    if run is None:
        solver, accuracy, warm_start, sleep = options.how
        how = {"solver": solver, "accuracy": accuracy, "warm_start": warm_start, "sleep": sleep}
        run = Simulator(state, **how, push=options.push)
    is_driven, every, done = record is not None and run._inputs.drive is not None, record or steps + 1, 0
    n, is_shifted = state.bodies.count, record is not None and not is_driven and state.world.restitution > 0.0
    loads_of = 4 + len(state.world.segments) if forces else 0
    log = make_log(steps, loads_of, n if is_driven else 0, n if is_shifted else 0)
    frames, loads = [] if record is None else [run.state], [log.loads.copy()]
    on_circles, shifts, work = [log.on_circles.copy()], [log.shifts.copy()], [0.0]
    solved, is_over = [], False
    while done < steps and not is_over:
        if stopped is not None and stopped.is_set():
            raise KeyboardInterrupt
        left = min(steps - done, every - done % every)
        most = 1 if on_step is not None or until is not None else run._affordable()
        if forces and left > 1:
            most = min(most, left - 1)  # the step that leads to a recorded state has to be a call of its own
        is_watched = on_step is not None or (forces and (left == 1 or until is not None))
        done += run._advance(run._rows(log, done, min(left, most), is_watched), is_watched)
        if on_step is not None:
            on_step(*run._seen)
        if until is not None:
            is_over = bool(until(read_only(run.state)))
        if record is not None and (done % every == 0 or done == steps or is_over):
            frames.append(run.state)
            loads.append(log.loads.copy())
            on_circles.append(log.on_circles.copy())
            shifts.append(log.shifts.copy())
            work.append(float(log.work[0]))
            solved += run._seen[:1]
    recorded = Trajectory.from_states(frames, work=work if is_driven else None) if frames else None
    of_steps = Trajectory.from_states(solved) if solved else None
    columns = (column[:done] for column in log[:5])
    sums = np.array(loads) if forces else None, of_steps, np.array(on_circles) if is_driven else None
    sums += (np.array(shifts) if is_shifted else None,)
    last = _last_run.keep(run, options.how) if done else run._state(np.asarray)
    return Simulation(last, *columns, recorded, *sums)


class _LastRun(threading.local):
    """The last run of `simulate` in this thread: a call that goes on from the state that it led to takes it over.

    A loop of calls then pays for the checks, the preset and the engine's memory once. It is let go with its state.
    """

    kept: tuple | None = None

    def keep(self, run: Simulator, how: tuple) -> StateWithContacts:
        """The state that a run has led to, from which the same arguments (`how`) go on."""
        plain = isinstance(run._start, Builtin) and run._options.push is None and isinstance(how[1], (str, type(None)))
        if not plain or run._scene.bodies.count > KEPT:
            return run._state(np.asarray)
        state = run.state
        self.kept = weakref.ref(state, self._drop), how, run
        return state

    def _drop(self, reference: weakref.ref) -> None:
        if self.kept and self.kept[0] is reference:
            self.kept = None

    def take(self, state: State, how: tuple) -> Simulator | None:
        """The run that has led to this state, if it was asked in the same way, and nobody has written to the state."""
        kept, self.kept = self.kept, None
        if kept is None or kept[0]() is not state or kept[1] != how:
            return None
        run = kept[2]
        mine, theirs = (*run._scene.bodies, *run._now.contacts), (*state.bodies, *state.contacts)
        if not all(map(_same_bits, mine, theirs)):
            return None
        run._steps.wake()
        run._origin = run._now
        return run


_last_run = _LastRun()


def _same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two arrays of one shape are equal. For small arrays, comparing bytes takes a tenth of the time."""
    return one.tobytes() == other.tobytes() if one.size < 4096 else np.array_equal(one, other)


@suggesting
def simulate_many(
    states: Iterable[State],
    *,
    steps: int = 600,
    dt: float | None = None,
    solver=None,
    warm_start: Literal["builtin", "none"] | Builtin | NoStart | None = "builtin",
    accuracy: Accuracy | MeasuredAccuracy | None = None,
    sleep: bool = False,
    record: int | None = None,
    forces: bool = False,
    threads: int | None = None,
    jobs: int | Executor | None = None,
) -> list[Simulation]:
    """Run many scenes, each on its own, on all cores. Returns what `simulate` returns for each, in order, bit for bit.

    Compiled steps release the interpreter's lock, so that threads run side by side.

    threads: largest number of threads, by default one for each core. jobs: number of processes in place of threads, or
    an executor, such as that of a cluster. warm_start: "builtin", None or "none", which need no Python between steps.

    The other arguments are those of `simulate`. Raises ValueError and FloatingPointError as `simulate` does, with the
    number of the state.
    """
    expect(threads is None or jobs is None, f"threads: expected none beside jobs, got {threads!r}")
    threads = cores() if threads is None else integer("threads", threads, least=1)
    start = warm_start_of(warm_start)
    fits, states = isinstance(start, (Builtin, NoStart)), list_of("states", State, states)
    expect(fits, f"warm_start: expected 'builtin', 'none' or None for many scenes, got {warm_start!r}")
    options = RunOptions(
        steps=steps, dt=dt, solver=solver, warm_start=start, accuracy=accuracy, sleep=sleep, record=record,
        forces=forces,
    )  # fmt: skip
    if jobs is not None:
        # Several scenes a task: a scheduler takes as long for a task as a small scene takes.
        numbered, size = list(enumerate(states)), max(1, len(states) // (TASKS * max(1, workers(jobs))))
        tasks = [numbered[first : first + size] for first in range(0, len(states), size)]
        return [run for runs in parallel_map(partial(_some_of_many, options), tasks, jobs=jobs) for run in runs]
    stopped = threading.Event()

    def one(number: int) -> Simulation:
        return _one_of_many(options, (number, states[number]), stopped)

    with ThreadPoolExecutor(min(threads, max(1, len(states)))) as pool:
        runs = [pool.submit(one, number) for number in range(len(states))]
        try:
            return [future.result() for future in runs]
        except BaseException:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _some_of_many(options: RunOptions, numbered: list[tuple[int, State]]) -> list[Simulation]:
    """`_one_of_many` for several states."""
    return [_one_of_many(options, one) for one in numbered]


def _one_of_many(
    options: RunOptions, numbered: tuple[int, State], stopped: threading.Event | None = None
) -> Simulation:
    """`_simulate` of one of many states. Errors name the state."""
    number, state = numbered
    try:
        return _simulate(state, options, stopped)
    except (ValueError, FloatingPointError) as error:
        raise type(error)(f"states[{number}]: {error}") from error


class Method(NamedTuple):
    """Solver and start of a run, which `simulate` uses and `plan` prints."""

    solver: object  # with numbers in place of values that follow the scene
    start: WarmStart
    start_name: str
    decision: Decision | None  # of the preset that chose the solver; None where the caller did


def method_of(state: State, solver=None, start="builtin", accuracy=None, *, sleep=False) -> Method:
    """The method of a run from this state: that of `accuracy`, of `solver`, or of the state's solver.

    Without any of these the solver is that of the preset "fast". Raises ValueError if the arguments do not fit each
    other.
    """
    if accuracy is not None and solver is not None:
        raise ValueError(f"accuracy: expected no solver beside it, got {solver!r}")
    decision = None
    if accuracy is not None or (solver is None and state.solver is None):
        decision = decide(state, accuracy, sleep=sleep)
        keeps = _keeps_solver(state, accuracy) and (entry_of(state.solver).can_sleep or not sleep)
        solver, start = state.solver if keeps else decision.solver, start if accuracy is None else decision.start
    solver = checked_solver(solver, state)
    if flag("sleep", sleep) and not entry_of(solver).can_sleep:
        raise ValueError(f"sleep: expected False with {type(solver).__name__}, got True")
    named = str(start) if isinstance(start, (str, Path)) else getattr(start, "__name__", type(start).__name__)
    return Method(solver, warm_start_of(start), "none" if start is None else named, decision)


def _keeps_solver(state: State, accuracy) -> bool:
    """Whether the state comes from a run under this preset. The run then keeps its solver.

    Without this rule a preset could choose another solver at a later moment, when the fastest circle is slower, or a
    dam has broken.
    """
    came = state.step > 0 and state.solver is not None and state.load in (None, load_of(state))
    return came and isinstance(accuracy, str) and accuracy == state.preset


def checked_solver(solver, state: State):
    """`solver`, or the state's solver, or PGS, with numbers for this state. Raises ValueError on an unknown solver."""
    solver = next(one for one in (solver, state.solver, PGS()) if one is not None)
    entry_of(solver)
    return solver.for_state(state)
