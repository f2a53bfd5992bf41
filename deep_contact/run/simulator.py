"""`Simulator`: a live run, which can be changed between steps."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deep_contact.accuracy.presets import Accuracy, MeasuredAccuracy, PresetWarning
from deep_contact.plot import notebook
from deep_contact.run.method import RunOptions, method_of
from deep_contact.starts.changed_load import (
    fitted,
    scaled_impulses,
    with_a_past,
    with_shifted_flights,
    with_time_step,
)
from deep_contact.starts.classical import Builtin, NoStart, starting_impulses
from deep_contact.starts.load import Anchor, anchor_of, kept_anchor, load_of, share_of_gravity
from deep_contact.starts.names import Start, WarmStart
from deep_contact.state.arrays import LIMITS, Bodies, Contacts
from deep_contact.state.fields import checked_indices, checked_push, checked_velocities, warn_of_jumps
from deep_contact.state.state import State, StateWithContacts, changed, frozen, read_only
from deep_contact.state.validation import integer, suggesting, warn
from deep_contact.state.world import World
from deep_contact.stepping.convergence import convergence_record
from deep_contact.stepping.inputs import scales_of, step_input
from deep_contact.stepping.interface import entry_of
from deep_contact.stepping.log import (
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
from deep_contact.stepping.memory import Steps
from deep_contact.stepping.prepare import ready
from deep_contact.stepping.problem import StepProblem
from deep_contact.stepping.sleeping import wake_pushed

MOST_WORK = 20_000_000
"""Largest work of one call of compiled code, in relaxations of a contact."""

SECONDS = 0.2
"""Time that one call of compiled code should take, s. Ctrl-C takes effect between two calls."""


@suggesting
class Simulator:
    """A live run: it does steps when it is called, and its scene can be changed between steps.

    The arguments are those of `simulate`. If a preset chose the solver, as by default, the preset chooses again when
    the scene changes. The bits of the result do not depend on how steps are divided into calls. After Ctrl-C or an
    error the simulator is at the end of a complete step, and can continue. A pickle contains its state.

    | property   | meaning                                                  | shape  | unit |
    |------------|----------------------------------------------------------|--------|------|
    | positions  | centres of the circles; a view, which every step changes | (n, 2) | m    |
    | velocities | velocities of the centres; also a view                   | (n, 2) | m/s  |
    | time       | time of the scene                                        |        | s    |
    | state      | a `State` with copies of the arrays, made at each access |        |      |

    The views are read-only. `set`, `add` and `remove` change the scene. To move circles to other positions, make a new
    simulator from a changed state: `dc.Simulator(live.state.replace(bodies=…, contacts=None))`.

    Raises ValueError on arguments that do not fit each other.
    """

    _has_warned = False  # whether there was a warning of a segment that jumps
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
            count = 1 if steps - done == 1 else min(steps - done, self._affordable())
            if count == 1:
                done += self._advance(self._one_step())
            else:
                done += self._advance(self._rows(make_log(count), 0, count))

    def show(self, steps: int = 0, *, every: int = 10) -> None:
        """Draw the state in a notebook, then do `steps` steps. Every `every` steps a new picture replaces the last one.

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
        """Change the world, the time step or the push for the following steps. All circles wake.

        Arguments of None change nothing. Contacts keep their impulses. A contact with a segment stays with the segment
        of the same index. A segment with a new position jumps there without pushing circles, and the first jump causes
        a warning. `segment_velocities` move segments without jumps.

        dt: time step, s. push: as in `simulate`; forces of 0 end a push. Raises ValueError, and changes nothing, on
        values that `World` refuses.
        """
        fields = {"gravity": gravity, "friction": friction, "restitution": restitution}
        fields = {name: value for name, value in fields.items() if value is not None}
        if dt is None and segments is None:
            if segment_velocities is None:
                is_set = not callable(push) and self._set_load(fields, push)
            else:
                is_set = not fields and push is None and self._set_velocities(segment_velocities)
            if is_set:
                return
        others, state = {"segments": segments, "segment_velocities": segment_velocities}, self.state
        others = {name: value for name, value in others.items() if value is not None}
        fields |= others
        if segments is not None:  # old velocities and surface speeds may not fit the number of segments
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
            # A preset chooses the solver again for other segments, since a faster segment may need more substeps.
            state = replace(state, world=world, contacts=contacts, preset=None if others else state.preset)
        self._change(state if dt is None else with_time_step(state, dt), push)

    def _set_load(self, changes: dict, push) -> bool:
        """Set gravity, friction, restitution and the push in place, if possible. This is faster than `_change`.

        It is possible if the change is so small that the carried impulses stay (`load.kept_anchor`), and if the step
        needs no other code. A preset then keeps its solver. changes: the new fields of the world. push: array of
        forces, or a tuple with torques; None leaves the push as it is. Returns whether all was set.
        """
        if not changes and push is None:
            return True
        scene, inputs, contacts = self._scene, self._inputs, self._now.contacts
        constants = World(**changes)
        strongest, roughest = LIMITS["world.gravity"][1], LIMITS["world.friction"][1]
        if max(map(abs, constants.gravity)) > strongest or constants.friction > roughest:
            return False  # `_change` raises
        world = changed(scene.world, **{name: getattr(constants, name) for name in changes})
        state = changed(scene, world=world, contacts=contacts)
        if push is not None:
            state = changed(state, push=checked_push(push, scene.bodies.count))
            if inputs.actuation is None or callable(self._options.push):
                return False
        solver, options = scene.solver, self._options
        if options.solver is not None and options.accuracy is None:
            solver = options.solver.for_state(state)
        anchor = kept_anchor(self._anchor, scene.world, state)
        if anchor is None or not self._steps.takes(solver):
            return False
        self._steps.wake()
        if (share := share_of_gravity(scene.world, self._anchor, state)) != 1.0:
            contacts = scaled_impulses(contacts, share, is_solved=self._now.solved)
        self._now = self._origin = self._now._replace(contacts=contacts)
        self._scene, self._anchor = changed(scene, world=world, push=state.push, solver=solver), anchor
        self._kind = solver, *self._kind[1:]
        if "gravity" in changes:
            self._scales = scales_of(state, solver)
        if push is not None:
            self._options, self._push = options._replace(push=state.push), state.push
            force, torque = state.push
            inputs = inputs._replace(actuation=inputs.actuation._replace(force=force, torque=torque))
        constants = {"friction": world.friction, "restitution": world.restitution}
        constants = {name: value for name, value in constants.items() if getattr(inputs, name) is not None}
        self._inputs = inputs._replace(gravity=world.gravity, scales=self._scales, **constants)
        return True

    def _set_velocities(self, segment_velocities) -> bool:
        """Set the velocities of the segments in place, if possible. This is faster than `_change`.

        It is possible if the same segments move as before. If a preset chose the solver, there is a second condition:
        no segment may be faster than at the time of this choice. Returns whether the velocities were set.
        """
        actuation, world = self._inputs.actuation, self._scene.world
        most = LIMITS["world.segment_velocities"][1]
        if self._options.accuracy is not None or self._options.is_anew:
            most = self._fastest_wall
        velocities = checked_velocities(segment_velocities, len(world.segments))
        wall = np.array(velocities).reshape(-1, 4)
        if actuation is None or wall.shape != actuation.wall.shape or np.abs(wall).max(initial=0.0) > most:
            return False
        if (wall.any(axis=1) != actuation.wall.any(axis=1)).any():
            return False
        self._steps.wake()
        self._scene = changed(self._scene, world=changed(world, segment_velocities=velocities))
        self._origin = self._now
        actuation.wall[:] = wall
        return True

    def add(self, bodies: Bodies) -> np.ndarray:
        """Append circles to the bodies (`State.with_bodies`). All circles wake. Returns the indices of the new circles.

        A constant push has forces of 0 on the new circles.
        """
        first = self._scene.bodies.count
        self._change(self.state.with_bodies(add=bodies))
        return np.arange(first, self._scene.bodies.count)

    def remove(self, which: Sequence | np.ndarray) -> np.ndarray:
        """Remove circles (`State.with_bodies`). All other circles wake.

        which: indices of circles, or a flag for each circle. Returns the new index of each old circle, (n,), or −1 if
        it was removed.
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
        """Continue from another state.

        push: the new push. If it is None, a push that is a function stays, and any other push becomes that of `state`.
        """
        if push is None:
            push = self._options.push if callable(self._options.push) else state.push
        options = self._options._replace(push=push)
        prepared = _prepared(state, options)
        self._options = options
        self._go_on(*prepared)

    def _go_on(self, state: StateWithContacts, start: WarmStart, anchor: Anchor) -> None:
        """Continue from a validated state that has a solver and starting impulses, with their anchor (`_prepared`)."""
        solver, n, sleep = state.solver, state.bodies.count, self._options.sleep
        block, moved = in_one_block(state.bodies[:4])
        bodies = Bodies(*moved, *map(np.copy, state.bodies[4:]))
        contacts = Contacts(*map(np.copy, state.contacts))
        if isinstance(start, NoStart):
            contacts.normal_start[:] = contacts.tangent_start[:] = 0.0
        scene = changed(state, bodies=bodies, contacts=contacts, load=None)
        scales = scales_of(state, solver)
        inputs = step_input(scene, solver, scales)
        kind = solver, sleep, isinstance(start, NoStart)
        if self._steps is None or kind != self._kind or not np.array_equal(bodies.radius, self._scene.bodies.radius):
            self._steps = Steps(solver, n, sleep=sleep, carry=not isinstance(start, NoStart))
            # The memory is allocated before the arrays of results, which then lie above it on the heap. Its release
            # thus leaves no free space at the top of the heap, which Linux would take back.
            self._steps.memory(inputs, contacts.count)
        self._steps.wake()
        self._kind, self._start, self._scene, self._scales, self._inputs = kind, start, scene, scales, inputs
        self._anchor = anchor
        # Without friction, tangent rows are left out once no contact starts from a tangent impulse.
        self._may_lose_tangents = scene.world.friction == 0.0 and entry_of(solver).advance is None
        self._is_one_solve = changed(scene, solved=True).holds_solution
        self._asks_between = callable(self._options.push) or not isinstance(start, (Builtin, NoStart))
        self._origin = self._now = _Now(contacts, state.step, state.time, state.solved)
        if callable(self._options.push):
            self._scene = scene = changed(scene, push=(np.zeros((n, 2)), np.zeros(n)))
            self._inputs = step_input(scene, solver, scales)
        self._push = scene.push
        actuation = self._inputs.actuation
        self._fastest_wall = 0.0 if actuation is None else np.abs(actuation.wall).max(initial=0.0)
        self._moved = tuple(bodies[:4])  # arrays that a step changes
        self._never_change = tuple(map(frozen, bodies[4:]))
        if scene.world.segment_velocities:
            self._moved += (self._inputs.segments.line,)
        if self._steps.sleep is not None:
            self._moved += self._steps.sleep.remembered
        self._kept, self._log, self._work = tuple(map(np.copy, self._moved)), make_log(1), MOST_WORK // 8
        kept_block, kept = in_one_block(self._kept[:4])
        self._kept = kept + self._kept[4:]
        self._saved = (kept_block, block), *zip(self._kept[4:], self._moved[4:])
        # Steps start the next step from the impulses of the last one. So the impulses before a step need no copy,
        # unless they come from elsewhere (`_origin`) or belong to circles that sleep.
        self._starts_are_impulses = not isinstance(start, NoStart) and self._steps.sleep is None
        self._views = bodies.position.view(), bodies.velocity.view()
        for view in self._views:
            view.flags.writeable = False
        self._seen: tuple = ()  # arguments of `on_step` for the last watched step

    def _affordable(self) -> int:
        """Return the number of steps that one call of compiled code may do.

        It is 1 if the start or the push is a Python function, which is called between two steps.
        """
        if self._asks_between:
            return 1
        return 1 + self._work // (10 * len(self._views[0]) + 50)

    def _rows(self, log: StepLog, first: int, count: int, is_watched: bool = False) -> StepLog:
        """Return `count` rows of a log, from row `first` on, as the log of one call.

        is_watched: whether the call is a single step whose impulses are logged.
        """
        return some_steps(log, first, count, self._work, is_watched and not self._is_one_solve)

    def _one_step(self) -> StepLog:
        """Return a log for one step. The next call of this function returns the same arrays."""
        log = self._log
        log.sweeps[0] = log.relaxations[0] = log.substeps[0] = log.progress[DONE] = 0
        log.progress[WORK] = self._work
        return log

    def _state(self, taken) -> StateWithContacts:
        """Return the present state. taken: function that copies or views each array of the bodies for the caller."""
        contacts, step, time, solved = self._now
        bodies, contacts = Bodies(*map(taken, self._scene.bodies)), Contacts(*map(np.ndarray.copy, contacts))
        push = None if callable(self._options.push) else self._scene.push
        fields = {"world": self._world(), "bodies": bodies, "contacts": contacts, "push": push, "solved": solved}
        state = changed(self._scene, **fields, step=step, time=time)
        return changed(state, load=load_of(state, self._anchor))

    def _world(self) -> World:
        """Return the world with its segments at their present positions."""
        world = self._scene.world
        return replace(world, segments=self._inputs.segments.line[:, :4]) if world.segment_velocities else world

    def _advance(self, log: StepLog, is_watched: bool = False) -> int:
        """Do at most as many steps as the log has rows. Returns the number of steps.

        An error undoes all steps of the call.
        """
        before = self._now
        for kept, array in self._saved:
            kept[...] = array
        impulses = before.contacts[7:]
        if before is self._origin or not self._starts_are_impulses:
            impulses = before.contacts.normal_impulse.copy(), before.contacts.tangent_impulse.copy()
        try:
            return self._advance_from(before, log, is_watched)
        except BaseException:
            if self._now is before:
                for kept, array in self._saved:
                    np.copyto(array, kept)
                names = "normal_impulse", "tangent_impulse"
                contacts = before.contacts._replace(**dict(zip(names, impulses)))
                # New arrays, since the undone steps have written into the old arrays.
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
        following, pair_impulses = self._steps(inputs, contacts, log, problem)
        if len(log.contacts) > 1:  # the number of steps in a call changes no bit of the result
            seconds = time.perf_counter() - begun
            self._work = min(MOST_WORK, 2 * self._work, 1 + int(self._work * SECONDS / seconds))
        progress = log.progress.tolist()  # to read an element of a list takes a third of the time
        done = progress[DONE] // inputs.substeps
        step, dt, origin = before.step + done, scene.dt, self._origin
        if not progress[FINITE]:
            _raise_diverged(scene.bodies, step)
        if progress[PASSED] and not self._has_warned_of_passing:
            self._has_warned_of_passing = True
            warn(
                f"up to step {step}: a moving segment passes over circle {progress[PASSED] - 1}, which what rests "
                "holds in its way; more warnings of this kind are left out"
            )
        # Time is computed from the number of steps. A sum of Δt would depend on the division of a run into calls.
        is_even = origin.time == origin.step * dt
        now = step * dt if is_even else origin.time + (step - origin.step) * dt
        if is_watched:
            theta = self._steps.memory(inputs).theta[: log.progress[LAST_SWEEPS]]
            is_one_solve = log.substeps[0] == 1 and scene.world.restitution == 0.0
            solved = Contacts(*map(frozen, contacts if is_one_solve else of_whole_step(contacts, pair_impulses)))
            fields = {"world": world, "bodies": bodies, "contacts": solved, "push": push, "solved": True}
            seen = changed(scene, **fields, step=before.step, time=before.time)
            of_step = frozen(log.shifts) if len(log.shifts) else None
            self._seen = seen, convergence_record(theta, scene.solver, int(log.contacts[0]), of_step)
            if len(shifts) and shifts is not log.shifts:
                shifts += log.shifts
        self._now = _Now(following, step, now, False)
        return done

    def _start_from_python(self, contacts: Contacts) -> tuple[Contacts, StepProblem | None]:
        """Call the start and the push before a step, if they are functions in Python. Returns (contacts, problem).

        The contacts have the starting impulses. The problem is the contact problem, if the start has built it, or None.
        The forces of the push replace those of the last step.
        """
        push, solver, problem = self._options.push, self._scene.solver, None
        if callable(push):
            self._push = force, torque = checked_push(push(read_only(self.state)), self._scene.bodies.count)
            self._inputs = self._inputs._replace(actuation=self._inputs.actuation._replace(force=force, torque=torque))
            if self._steps.sleep is not None:
                wake_pushed(contacts, self._steps.sleep, self._inputs)
        if not isinstance(self._start, (Builtin, NoStart)):
            state = replace(self.state, push=self._push)
            normal, tangent, problem = starting_impulses(self._start, state, solver, self._scales)
            contacts = contacts._replace(normal_start=normal, tangent_start=tangent)
        return contacts, problem


def in_one_block(arrays: Sequence[np.ndarray]) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Return (block, copies): copies of arrays of float64, which lie one after the other in a flat array, the block.

    To copy the block takes a fraction of the time of copying each small array.
    """
    block = np.concatenate([array.ravel() for array in arrays])
    ends = np.cumsum([array.size for array in arrays])
    parts = (block[end - array.size : end] for end, array in zip(ends, arrays))
    return block, tuple(part.reshape(array.shape) for part, array in zip(parts, arrays))


class _Now(NamedTuple):
    """Contacts, number of steps, time (s) and `State.solved` of a `Simulator` at one time.

    A step replaces all four in one assignment. An interrupt therefore finds all from before the step or all from after.
    """

    contacts: Contacts
    step: int
    time: float
    solved: bool


def _restored(state: StateWithContacts, start: WarmStart, options: RunOptions) -> Simulator:
    """Return a `Simulator` that continues from the state of a pickled simulator."""
    simulator = Simulator.__new__(Simulator)
    simulator._options, simulator._steps = options, None
    simulator._go_on(state, start, state.load.anchor)
    return simulator


def _raise_diverged(bodies: Bodies, step: int) -> None:
    circle = int(np.flatnonzero(~np.isfinite(bodies.position).all(axis=1))[0])
    raise FloatingPointError(
        f"up to step {step}: circle {circle} (mass {bodies.mass[circle]:g} kg, radius {bodies.radius[circle]:g} m) has "
        "come to a position that is not finite: the solver diverged; try PGS, a smaller dt"
    )


def _prepared(state: State, options: RunOptions) -> tuple[StateWithContacts, WarmStart, Anchor]:
    """Return (state, start, anchor) for the beginning of a run.

    The state is validated, and has the solver of the run and its starting impulses, to which the anchor belongs.
    """
    first, state = state, ready(state)
    accuracy, push = options.accuracy, options.push
    constant = None if push is None or callable(push) else checked_push(push, state.bodies.count)
    state = changed(state, push=constant)
    without_past = first.contacts is None or state.step == 0
    chosen_for = changed(state, solver=None) if options.is_anew and accuracy is None else state
    how = options.solver, options.warm_start, accuracy
    solver, start, _, decision = method_of(chosen_for, *how, sleep=options.sleep)
    for sentence in decision.warnings if decision else ():
        warn(sentence, PresetWarning)
    # Only at the beginning of a run, so that a run has the same result in one call and in several calls.
    if decision and without_past and isinstance(start, Builtin) and not state.contacts.normal_start.any():
        state, anchor = with_a_past(state), anchor_of(state)
    else:
        carries = first.contacts is not None and not isinstance(start, NoStart)
        state, anchor = fitted(state, solver, carries=carries)
    if state.solver is not None:
        state = with_shifted_flights(state, state.dt / state.solver.substeps - state.dt / solver.substeps)
    # A solved state is solved again from its starting impulses. A resumed run thus repeats the steps of the first run.
    preset = accuracy if isinstance(accuracy, str) else state.preset if solver == state.solver else None
    return changed(state, solver=solver, preset=preset), start, anchor
