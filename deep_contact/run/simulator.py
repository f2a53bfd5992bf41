"""`Simulator`: a live run, which can be changed between steps."""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deep_contact.accuracy.presets import Accuracy, MeasuredAccuracy, PresetWarning
from deep_contact.plot import notebook
from deep_contact.run.live_forces import LiveForces
from deep_contact.run.method import RunOptions, method_of
from deep_contact.run.solved_memory import SolvedMemory, moving_arrays
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
from deep_contact.state.fields import (
    checked_fixed,
    checked_indices,
    checked_part,
    checked_push,
    checked_velocities,
    warn_of_jumps,
)
from deep_contact.state.materials import largest
from deep_contact.state.state import State, StateWithContacts, changed, frozen, read_only
from deep_contact.state.validation import brief, expect, flag, function, integer, suggesting, warn
from deep_contact.state.world import World
from deep_contact.stepping.convergence import ConvergenceRecord, convergence_record
from deep_contact.stepping.inputs import scales_of, step_input
from deep_contact.stepping.interface import entry_of
from deep_contact.stepping.log import (
    DONE,
    FINITE,
    LAST_SWEEPS,
    PASSED,
    WATCHED,
    WORK,
    StepLog,
    make_log,
    some_steps,
)
from deep_contact.stepping.memory import Steps
from deep_contact.stepping.pairs import is_rough, kinds
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

    If a preset chose the solver, as by default, the preset chooses again when the scene changes. The bits of the result
    do not depend on how steps are divided into calls. After Ctrl-C or an error the simulator is at the end of a
    complete step, and can continue. A pickle contains its state, and the sums of its forces.

    | property   | meaning                                                  | shape  | unit |
    |------------|----------------------------------------------------------|--------|------|
    | positions  | centres of the circles; a view, which every step changes | (n, 2) | m    |
    | velocities | velocities of the centres; also a view                   | (n, 2) | m/s  |
    | time       | time of the scene                                        |        | s    |
    | state      | a `State` with copies of the arrays, made at each access |        |      |
    | solved     | the solved state of the last step, as `on_step` gets it  |        |      |

    The views and `solved` are read-only. `set`, `add` and `remove` change the scene. To move circles to other
    positions, make a new simulator from a changed state: `dc.Simulator(live.state.replace(bodies=…, contacts=None))`.

    The other arguments are those of `simulate`. forces: whether the contact impulses are summed, for `force_on`, and
    the last step of each call of `step` is stored, as `solved`. on_step: function that is called after each step, with
    the arguments that `simulate` describes. It may change the scene. With `on_step`, every step sets `solved`. Without
    these two options they take no time in a step.
    Raises ValueError on arguments that do not fit each other.
    """

    _has_warned = False  # whether there was a warning of a segment that jumps
    _has_warned_of_passing = False
    _forces: LiveForces | None = None

    def __init__(
        self,
        state: State,
        *,
        solver=None,
        accuracy: Accuracy | MeasuredAccuracy | None = None,
        warm_start: Start = "builtin",
        sleep: bool = False,
        push=None,
        forces: bool = False,
        on_step: Callable[[StateWithContacts, ConvergenceRecord], object] | None = None,
    ):
        how = {"solver": solver, "accuracy": accuracy, "warm_start": warm_start, "sleep": sleep, "push": push}
        is_anew = solver is None and getattr(state, "solver", None) is None
        watch = {"forces": flag("forces", forces), "on_step": on_step}
        if on_step is not None:
            function("on_step", on_step)
        self._options, self._steps = RunOptions(**how, **watch, is_anew=is_anew), None
        prepared = _prepared(state, self._options)
        if forces:
            self._forces = LiveForces(state.bodies.count, len(state.world.segments))
        self._go_on(*prepared)

    def step(self, steps: int = 1) -> None:
        """Do `steps` steps. Raises FloatingPointError if the solver diverges to positions that are not finite."""
        done, steps = 0, integer("steps", steps, hint="; seconds are steps of Δt, which set(dt=…) changes")
        if self._is_watched:
            self._step_watched(steps)
            return
        while done < steps:
            count = 1 if steps - done == 1 else min(steps - done, self._affordable())
            if count == 1:
                done += self._advance(self._one_step())
            else:
                done += self._advance(self._rows(make_log(count), 0, count))

    def _step_watched(self, steps: int) -> None:
        """Do `step`, with sums of forces and calls of `on_step`. Without `on_step`, only the last step is watched."""
        done, on_step = 0, self._options.on_step
        while done < steps:
            left = steps - done
            is_watched = on_step is not None or left == 1
            count = 1 if is_watched else min(left - 1, self._affordable())
            log = self._one_step() if count == 1 else self._rows(self._new_log(count), 0, count)
            log.progress[WATCHED] = is_watched and not self._watching().is_one_solve
            done += self._advance(log, is_watched)
            if on_step is not None:
                on_step(*self._now.seen)

    def force_on(self, part: str, index: int | Sequence[int] | np.ndarray | None = None) -> np.ndarray:
        """Return the mean contact force on a part of the scene since this force was last read, (2,), N.

        It is the mean over all steps and substeps since then, rebounds included: the sum of the contact impulses over
        the time. Each body has an interval of its own, which begins with the simulator, or when the body is added.
        Without a step since then, the result is that of the last call, and 0 before the first step.

        part, index: as in `Simulation.force_on`. Raises ValueError without forces=True, and on an unknown part or
        index.
        """
        if self._forces is None:
            raise ValueError("forces: expected a Simulator(…, forces=True), got one without")
        chosen = checked_part(part, index, self._scene.bodies.count, len(self._scene.world.segments))
        self._count_time()
        return self._forces.read(*chosen)

    def _count_time(self) -> None:
        """Add the time of the steps since the last call to the sums of forces, if there are any."""
        if self._forces is not None:
            self._forces.add_time((self._now.step - self._counted) * self._scene.dt)
            self._counted = self._now.step

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

    @property
    def solved(self) -> StateWithContacts:
        """The solved state of the last step. Raises ValueError without forces=True or on_step=…, and before a step."""
        expect(self._is_watched, "solved: expected a Simulator(…, forces=True), or with on_step=…, got one without")
        expect(self._now.seen, "solved: expected a call of step that was completed before, got none")
        return self._now.seen[0]

    @suggesting
    def set(
        self, *, gravity=None, friction=None, restitution=None, dt=None, segments=None, segment_velocities=None,
        fixed_velocities=None, fixed_spins=None, push=None, rolling_friction=None,
    ) -> None:  # fmt: skip
        """Change the world, the time step, the motion of fixed circles or the push for the following steps.

        All circles wake.

        Arguments of None change nothing. Contacts keep their impulses. A contact with a segment stays with the segment
        of the same index. A segment with a new position jumps there without pushing circles, and the first jump causes
        a warning. `segment_velocities` move segments without jumps.

        fixed_velocities, fixed_spins: velocities, (k, 2), m/s, and spins, (k,), rad/s, of the k fixed circles in the
        order of their indices, or one for all of them. dt: time step, s. push: as in `simulate`; forces of 0 end a
        push. Raises ValueError, and changes nothing, on values that `World` or `make_bodies` refuses.
        """
        fixed = None
        if fixed_velocities is not None or fixed_spins is not None:
            fixed = checked_fixed(self._scene.bodies, fixed_velocities, fixed_spins)
        fields = {"gravity": gravity, "friction": friction, "restitution": restitution}
        fields = {name: value for name, value in fields.items() if value is not None}
        if dt is None and segments is None and rolling_friction is None:
            if segment_velocities is None and fixed is None:
                is_set = not callable(push) and self._set_load(fields, push)
            else:
                is_set = not fields and push is None and self._set_velocities(segment_velocities, fixed)
            if is_set:
                return
        others, state = {"segments": segments, "segment_velocities": segment_velocities}, self.state
        others |= {"rolling_friction": rolling_friction}
        others = {name: value for name, value in others.items() if value is not None}
        fields |= others
        if segments is not None:  # old velocities and surface speeds may not fit the number of segments
            for name in ("segment_velocities", "surface_speeds", "segment_materials"):
                kept = getattr(state.world, name)
                fields.setdefault(name, kept if len(kept) == len(segments) else ())
        if fixed is not None:
            is_fixed = state.bodies.is_fixed
            state.bodies.velocity[is_fixed], state.bodies.spin[is_fixed] = fixed
        if fields or fixed is not None:
            world, contacts = replace(state.world, **fields), state.contacts
            if segments is not None:
                if not self._has_warned:
                    self._has_warned = warn_of_jumps(state.world, world)
                stays = contacts.body_b < state.bodies.count + 4 + len(world.segments)
                contacts = Contacts(*(values[stays] for values in contacts))
            # A preset chooses the solver again, since a faster segment or circle may need more substeps.
            preset = None if others or fixed is not None else state.preset
            state = replace(state, world=world, contacts=contacts, preset=preset)
        self._change(state if dt is None else with_time_step(state, dt), push)

    def _set_load(self, changes: dict, push) -> bool:
        """Set gravity, friction, restitution and the push in place, if possible. This is faster than `_change`.

        It is possible if the change is so small that the carried impulses stay (`load.kept_anchor`), and if the step
        needs no other code. The solver of a preset then stays. changes: the new fields of the world. push: array of
        forces, or a tuple with torques; None leaves the push as it is. Returns whether the changes were made.
        """
        if not changes and push is None:
            return True
        scene, inputs, contacts = self._scene, self._inputs, self._now.contacts
        constants = World(**changes)
        strongest, roughest = LIMITS["world.gravity"][1], LIMITS["world.friction"][1]
        is_uniform = scene.world.is_uniform and constants.is_uniform
        if not (is_uniform or changes.keys() <= {"gravity"}):
            return False  # tables need other code, or another table in the input of steps
        if max(map(abs, constants.gravity)) > strongest or largest(constants.friction) > roughest:
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
        constants = {"friction": world.friction, "restitution": world.restitution} if is_uniform else {}
        constants = {name: value for name, value in constants.items() if getattr(inputs, name) is not None}
        self._inputs = inputs._replace(gravity=world.gravity, scales=self._scales, **constants)
        return True

    def _set_velocities(self, segment_velocities, fixed: tuple[np.ndarray, np.ndarray] | None) -> bool:
        """Set the velocities of the segments and of the fixed circles in place. This is faster than `_change`.

        It is possible if the same segments move as before. If a preset chose the solver, there is a second condition:
        no segment and no fixed circle may be faster than at the time of this choice. segment_velocities: argument of
        `set`. fixed: velocities and spins of the fixed circles; None changes nothing. Returns whether the velocities
        were set. If not, nothing has changed.
        """
        actuation, world, bodies = self._inputs.actuation, self._scene.world, self._scene.bodies
        most = LIMITS["world.segment_velocities"][1], LIMITS["bodies.velocity"][1]
        if self._options.accuracy is not None or self._options.is_anew:
            most = self._fastest_wall, self._fastest_fixed
        if segment_velocities is not None:
            velocities = checked_velocities(segment_velocities, len(world.segments))
            wall = np.array(velocities).reshape(-1, 4)
            if actuation is None or wall.shape != actuation.wall.shape or np.abs(wall).max(initial=0.0) > most[0]:
                return False
            if (wall.any(axis=1) != actuation.wall.any(axis=1)).any():
                return False
        if fixed is not None and (_fastest(fixed[0]) > most[1] or np.abs(fixed[1]).max() > LIMITS["bodies.spin"][1]):
            return False
        self._steps.wake()
        self._origin = self._now
        if segment_velocities is not None:
            self._scene = changed(self._scene, world=changed(world, segment_velocities=velocities))
            actuation.wall[:] = wall
        if fixed is not None:
            is_fixed = bodies.is_fixed
            bodies.velocity[is_fixed], bodies.spin[is_fixed] = fixed
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
        stays = np.delete(np.arange(n), gone)
        index[stays] = np.arange(len(stays))
        self._change(self.state.with_bodies(remove=gone), stays=stays)
        return index

    def __reduce__(self):
        self._count_time()
        return _restored, (self.state, self._start, self._options, self._forces, self._now.seen)

    def __repr__(self) -> str:
        return f"Simulator({self.state!r})"

    def _change(self, state: State, push=None, stays: np.ndarray | None = None) -> None:
        """Continue from another state.

        push: the new push. If it is None, a push that is a function stays, and any other push becomes that of `state`.
        stays: old indices of the circles that are left; None if all are.
        """
        if push is None:
            push = self._options.push if callable(self._options.push) else state.push
        options = self._options._replace(push=push)
        prepared = _prepared(state, options)
        self._options = options
        if self._forces is not None:
            self._count_time()
            self._forces = self._forces.of_scene(state.bodies.count, len(state.world.segments), stays)
        self._go_on(*prepared, self._now.seen)

    def _go_on(self, state: StateWithContacts, start: WarmStart, anchor: Anchor, seen: tuple = ()) -> None:
        """Continue from a validated state that has a solver and starting impulses, with their anchor (`_prepared`).

        seen: `_Now.seen` of the last step.
        """
        solver, n, sleep = state.solver, state.bodies.count, self._options.sleep
        block = np.empty(6 * n)
        bodies = Bodies(*moving_arrays(block), *map(np.copy, state.bodies[4:]))
        for array, values in zip(bodies[:4], state.bodies):
            array[...] = values
        contacts = Contacts(*map(np.copy, state.contacts))
        if isinstance(start, NoStart):
            contacts.normal_start[:] = contacts.tangent_start[:] = 0.0
        scene = changed(state, bodies=bodies, contacts=contacts, load=None)
        scales = scales_of(state, solver)
        inputs = step_input(scene, solver, scales)
        kind = solver, sleep, isinstance(start, NoStart), kinds(inputs)
        if self._steps is None or kind != self._kind or not np.array_equal(bodies.radius, self._scene.bodies.radius):
            self._steps = Steps(solver, n, sleep=sleep, carry=not isinstance(start, NoStart))
            # The memory is allocated before the arrays of results, which then lie above it on the heap. Its release
            # thus leaves no free space at the top of the heap, which Linux would take back.
            self._steps.memories(inputs, contacts)
        else:
            self._steps.wake()
        self._kind, self._start, self._scene, self._scales, self._inputs = kind, start, scene, scales, inputs
        self._anchor = anchor
        # Without friction, tangent rows are left out once no contact starts from a tangent impulse.
        is_smooth = largest(scene.world.friction) == 0.0 and not is_rough(inputs.friction)
        self._may_lose_tangents = is_smooth and entry_of(solver).advance is None
        self._asks_between = callable(self._options.push) or not isinstance(start, (Builtin, NoStart))
        self._origin = self._now = _Now(contacts, state.step, state.time, state.solved, seen)
        if callable(self._options.push):
            self._scene = scene = changed(scene, push=(np.zeros((n, 2)), np.zeros(n)))
            self._inputs = step_input(scene, solver, scales)
        self._push = scene.push
        actuation, self._fastest_wall, self._fastest_fixed = self._inputs.actuation, 0.0, 0.0
        if actuation is not None:
            self._fastest_wall = np.abs(actuation.wall).max(initial=0.0)
            self._fastest_fixed = _fastest(bodies.velocity[bodies.is_fixed])
        self._moved = tuple(bodies[:4])  # arrays that a step changes
        if scene.world.segment_velocities:
            self._moved += (self._inputs.segments.line,)
        if self._steps.sleep is not None:
            self._moved += self._steps.sleep.remembered
        self._is_watched, self._counted = self._forces is not None or self._options.on_step is not None, state.step
        if self._forces is not None:
            self._moved += (self._forces.block,)
        kept_block = block.copy()
        self._kept = *moving_arrays(kept_block), *map(np.copy, self._moved[4:])
        self._saved = (kept_block, block), *zip(self._kept[4:], self._moved[4:])
        self._work, self._log, self._watched = MOST_WORK // 8, None, None  # both are made when they are needed
        # Steps start the next step from the impulses of the last one. So the impulses before a step need no copy,
        # unless they come from elsewhere (`_origin`) or belong to circles that sleep.
        self._starts_are_impulses = not isinstance(start, NoStart) and self._steps.sleep is None
        self._views = bodies.position.view(), bodies.velocity.view()
        for view in self._views:
            view.flags.writeable = False

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
        return some_steps(log, first, count, self._work, is_watched and not self._watching().is_one_solve)

    def _new_log(self, steps: int) -> StepLog:
        """Return a log for `steps` steps, which adds impulses to the sums of forces, if there are any."""
        log, forces = make_log(steps), self._forces
        return log if forces is None else log._replace(loads=forces.loads, on_circles=forces.on_circles)

    def _one_step(self) -> StepLog:
        """Return a log for one step. The next call of this function returns the same arrays."""
        if self._log is None:
            self._log = self._new_log(1)
        log = self._log
        log.sweeps[0] = log.relaxations[0] = log.substeps[0] = log.progress[DONE] = 0
        log.progress[WORK] = self._work
        return log

    def _watching(self) -> _Watched:
        """Return the memory and the values that only watched steps need.

        They are made in the first watched step, and serve until the scene changes.
        """
        if self._watched is None:
            is_one_solve = changed(self._scene, solved=True).holds_solution
            self._watched = _Watched(is_one_solve, tuple(map(frozen, self._scene.bodies[4:])), SolvedMemory())
        return self._watched

    def _state(self, taken) -> StateWithContacts:
        """Return the present state. taken: function that copies or views each array of the bodies for the caller."""
        contacts, step, time, solved, _ = self._now
        bodies, contacts = Bodies(*map(taken, self._scene.bodies)), Contacts(*map(np.ndarray.copy, contacts))
        push, world = None if callable(self._options.push) else self._scene.push, self._scene.world
        world = self._moved_world() if world.segment_velocities else world
        fields = {"world": world, "bodies": bodies, "contacts": contacts, "push": push, "solved": solved}
        state = changed(self._scene, **fields, step=step, time=time)
        return changed(state, load=load_of(state, self._anchor))

    def _moved_world(self) -> World:
        """Return the world with its moving segments at their present positions."""
        return replace(self._scene.world, segments=self._inputs.segments.line[:, :4])

    def _world_in_step(self) -> World:
        """Return the present world without validation, which would take longer than a step of a hundred circles.

        Segments that no world may have, of length 0, are left to the validation.
        """
        world = self._scene.world
        if not world.segment_velocities:
            return world
        segments = tuple(map(tuple, self._inputs.segments.line[:, :4].tolist()))
        if any((x_1 - x_0) ** 2 + (y_1 - y_0) ** 2 == 0.0 for x_0, y_0, x_1, y_1 in segments):
            return self._moved_world()
        moved = changed(world, segments=segments)
        for name in ("_digest", "is_within_limits"):  # values that the world has computed from its segments
            vars(moved).pop(name, None)
        return moved

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
        shifts, shown = log.shifts, ()
        if is_watched:
            world, push, watched = self._world_in_step(), self._push, self._watching()
            if not watched.is_one_solve:
                log = log._replace(pair_impulses=watched.memory.rows(contacts))
            if largest(scene.world.restitution) > 0.0:
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
            is_one_solve = log.substeps[0] == 1 and largest(scene.world.restitution) == 0.0
            rows = pair_impulses[:0] if is_one_solve else pair_impulses
            moved, solved = watched.memory.copy(self._kept[:4], contacts, rows)
            bodies = Bodies(*moved, *watched.never_change)
            fields = {"world": world, "bodies": bodies, "contacts": solved, "push": push, "solved": True}
            seen = changed(scene, **fields, step=before.step, time=before.time)
            of_step = frozen(log.shifts) if len(log.shifts) else None
            shown = seen, convergence_record(theta, scene.solver, int(log.contacts[0]), of_step)
            if len(shifts) and shifts is not log.shifts:
                shifts += log.shifts
        self._now = _Now(following, step, now, False, shown)
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


class _NotAssigned:
    """A name that users take for an attribute of a `Simulator`. Access and assignment raise AttributeError.

    Without it, an assignment such as `live.gravity = (0, 0)` would be silent and change nothing. hint: what to write
    instead.
    """

    def __init__(self, name: str, hint: str):
        self._message = f"{name}: {hint}"

    def __get__(self, live, kind=None):
        if live is None:
            return self
        raise AttributeError(self._message)

    def __set__(self, live, value):
        raise AttributeError(f"{self._message}, got an assignment of {brief(value)}")


for _name in inspect.signature(Simulator.set).parameters.keys() - {"self"}:
    setattr(Simulator, _name, _NotAssigned(_name, f"expected live.set({_name}=…) to change it, live.state to read it"))
for _name in ("world", "bodies", "contacts"):
    setattr(Simulator, _name, _NotAssigned(_name, f"expected live.state.{_name}; set, add and remove change the scene"))
for _name in inspect.signature(Simulator).parameters.keys() - {"state", "push"}:
    setattr(Simulator, _name, _NotAssigned(_name, f"expected dc.Simulator(live.state, {_name}=…), a new simulator"))


class _Watched(NamedTuple):
    """Memory of watched steps, and values that are the same in all of them."""

    is_one_solve: bool  # whether the impulses of a step solve one contact problem, without substeps and restitution
    never_change: tuple[np.ndarray, ...]  # read-only masses, radii and materials
    memory: SolvedMemory


class _Now(NamedTuple):
    """Contacts, number of steps, time (s) and `State.solved` of a `Simulator`, and the solved state of its last step.

    A step replaces all fields in one assignment. An interrupt therefore finds all from before the step or all from
    after.
    """

    contacts: Contacts
    step: int
    time: float
    solved: bool
    seen: tuple = ()  # arguments of `on_step` for the last step; empty if it was not watched


def begun(state: State, options: RunOptions) -> Simulator:
    """Return the `Simulator` of a run of `simulate` with these options, before its first step.

    Unlike the class, it takes options that are collected already. Its steps are watched only if a call says so.
    """
    simulator = Simulator.__new__(Simulator)
    simulator._options, simulator._steps = options._replace(forces=False, on_step=None), None
    simulator._go_on(*_prepared(state, simulator._options))
    return simulator


def _restored(state, start: WarmStart, options: RunOptions, forces: LiveForces | None, seen: tuple) -> Simulator:
    """Return a `Simulator` that continues from the state and the sums of forces of a pickled simulator."""
    simulator = Simulator.__new__(Simulator)
    simulator._options, simulator._steps, simulator._forces = options, None, forces
    simulator._go_on(state, start, state.load.anchor, seen)
    return simulator


def _fastest(velocity: np.ndarray) -> float:
    """Return the largest speed of velocities (k, 2), m/s; 0 if there are none."""
    return float(np.hypot(*velocity.T).max(initial=0.0))


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
    if constant is not state.push:
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
