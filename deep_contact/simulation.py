"""The validated interface of the engine: `solve_contacts`, `step`, `simulate`, `simulate_many`."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from deep_contact.compiled.team import cores
from deep_contact.physics import engine
from deep_contact.physics.convergence import ConvergenceRecord, convergence_record
from deep_contact.physics.engine import ContactSolution, Steps, step_input
from deep_contact.physics.solvers import PGS, NesterovPGS
from deep_contact.physics.solvers.registry import entry_of, for_state, tolerance_argument
from deep_contact.physics.step import StepLog, make_log
from deep_contact.physics.substeps import shift_flights
from deep_contact.state import (
    LIMITS,
    Bodies,
    Contacts,
    State,
    StateWithContacts,
    check_limits,
    check_state,
    check_types,
    make_bodies,
    no_contacts,
    notebook,
)
from deep_contact.trajectory import Trajectory
from deep_contact.validation import expect, integer, number
from deep_contact.warm_start import Builtin, NoStart, Start, starting_impulses, warm_start_of

if TYPE_CHECKING:
    from deep_contact.presets import Accuracy

_KINDS = [(array.dtype, array.ndim) for array in (*make_bodies([[0.0, 0.0]]), *no_contacts())]
"""Type and dimensions of the arrays of bodies and contacts."""

_WORK, _SECONDS = 20_000_000, 0.2
"""Most work of a call of compiled code, in relaxations of a contact, and its time: between calls Ctrl-C is raised."""

COINCIDENT = 0.1
"""Distance of two centres, in the smaller radius, below which `simulate` warns."""

FIRST_SWEEPS = 500, 2000
"""Least and most sweeps of the first step of a preset's run whose contacts carry no impulses: with few sweeps a pile at
rest would fall into itself. Between them it is one for each circle."""


class Simulation(NamedTuple):
    """A finished run.

    | field       | meaning                                                                                   |
    |-------------|-------------------------------------------------------------------------------------------|
    | state       | the `State` after the last step, ready to go on: its contacts have been found, not solved |
    | contacts    | number of contacts solved in each step, (steps,): all but those that are asleep           |
    | sweeps      | number of velocity sweeps in each step, (steps,); of its slowest island, with islands     |
    | theta       | θ after the last sweep of each step, (steps,), N·s; infinite where no sweep was done      |
    | relaxations | contacts times sweeps in each step, (steps,); with islands, summed over them              |
    | substeps    | into how many each step was divided, (steps,)                                             |
    | recorded    | the recorded states as a `Trajectory`, the last being `state`; None where none were asked |

    With substeps, contacts and θ are those of a step's last substep, sweeps and relaxations sums over all of them.
    """

    state: StateWithContacts
    contacts: np.ndarray
    sweeps: np.ndarray
    theta: np.ndarray
    relaxations: np.ndarray
    substeps: np.ndarray
    recorded: Trajectory | None = None

    @property
    def trajectory(self) -> Trajectory:
        """The recorded states. Raises ValueError where none were asked for."""
        if self.recorded is None:
            raise ValueError("trajectory: expected a run of simulate(…, record=…), got one that recorded no states")
        return self.recorded

    @property
    def status(self) -> np.ndarray:
        """Why each step's sweeps ended, (steps,): see `ConvergenceRecord`."""
        tolerance = tolerance_argument(self.state.solver)
        cases = [self.contacts == 0, self.theta <= tolerance, (self.sweeps > 0) & ~np.isfinite(self.theta)]
        return np.select(cases, ["no_contacts", "converged", "diverged"], "max_sweeps")

    def __repr__(self) -> str:
        return f"Simulation({', '.join(self._summary().values())}, state={self.state!r})"

    def _repr_html_(self) -> str:
        """What a notebook shows: how the run went, and its last state."""
        return notebook.shown("Simulation", self._summary().items()) + self.state._repr_html_()

    def _summary(self) -> dict[str, str]:
        summary = {"steps": notebook.counted(self.sweeps.size, "step")}
        if self.sweeps.size:
            ends, times = np.unique(self.status, return_counts=True)
            summary["sweeps"] = f"{self.sweeps.mean():.1f} sweeps a step"
            if self.substeps.max() > 1:
                summary["substeps"] = f"{self.substeps.mean():.1f} substeps a step"
            summary["last θ"] = f"last θ {self.theta[-1]:.2g} N·s"
            summary["solves"] = ", ".join(f"{count:,} {end.replace('_', ' ')}" for end, count in zip(ends, times))
        return summary | ({} if self.recorded is None else {"record": notebook.counted(len(self.recorded), "state")})


def solve_contacts(state: State, *, solver=None, start: Start | Sequence[np.ndarray] = "builtin") -> ContactSolution:
    """Solve the contact problem of a state: gravity for Δt, then the impulses. The state stays as it is.

    solver: options such as `PGS(sweeps=…)`; by default the state's own. start: None, the name of a start, a callable
    of `deep_contact.warm_start`, or two arrays (normal, tangent), (m,) each, N·s.
    Raises ValueError on a state, solver or start that does not hold together.
    """
    state = ready(state)
    solver = checked_solver(solver, state)
    return engine.solve(state, solver, *starting_impulses(start, state, solver))


def step(state: State, *, solver=None, warm_start: Start = "builtin") -> StateWithContacts:
    """One step: the state Δt later, with its contacts found and the solved impulses carried over to them.

    For the impulses that the step solved, see `simulate`'s `on_step`. Arguments and errors as in `simulate`, which does
    many steps in less time than a loop of this.
    """
    return simulate(state, steps=1, solver=solver, warm_start=warm_start).state


def simulate(
    state: State,
    *,
    steps: int = 600,
    dt: float | None = None,
    solver=None,
    warm_start: Start = "builtin",
    accuracy: Accuracy | None = None,
    sleep: bool = False,
    record: int | None = None,
    on_step: Callable[[StateWithContacts, ConvergenceRecord], None] | None = None,
) -> Simulation:
    """Run a scene, or go on from a state, for so many steps.

    dt: time step, s; if it is not the state's, carried impulses are scaled by the ratio.
    solver: options such as `PGS(sweeps=…)`; by default the state's own, or what accuracy="fast" takes.
    warm_start: None, the name of a start, or a callable of `deep_contact.warm_start`.
    accuracy: "preview", "fast", "balanced", "accurate" or "reference", in place of solver and start: the cheapest that
    were measured to keep the tolerances of that preset (`presets.PRESETS`) on the errors of a run. Where the
    scene's circles are too small or too fast for its Δt, the step is divided into substeps. At step 0
    contacts that carry no impulses, as of positions from elsewhere, are first solved well (`FIRST_SWEEPS`).
    sleep: leave islands that have been still for half a second as they are until something touches them, as Box2D 2.3
    does (`physics.sleeping`). Who sleeps is known within the run only: one that goes on from its state starts awake.
    record: keep the first state, one in so many steps, and the last, as `trajectory` of the result.
    on_step: called after each step with the solved state (the bodies before the step, the contacts with the impulses
    it solved and those it started from) and the `ConvergenceRecord` of its sweeps. With substeps, after each of these,
    in units of their own: the state's Δt and step are those of the substep.
    Raises ValueError on arguments that do not hold together, and FloatingPointError where the solver diverges beyond
    all numbers; the run can be interrupted.
    """
    return _simulate(state, steps, dt, solver, warm_start, accuracy, sleep, record, on_step)


def _simulate(state, steps, dt, solver, warm_start, accuracy, sleep, record, on_step=None, stopped=None) -> Simulation:
    """`simulate`, which ends with a KeyboardInterrupt once the event `stopped` is set."""
    integer("steps", steps)
    every = steps + 1 if record is None else integer("record", record, least=1)
    if dt is not None:
        state = with_time_step(state, dt)
    given, state = state, ready(state)
    without_past = given.contacts is None or state.step == 0
    by_preset = accuracy is not None or (solver is None and state.solver is None)
    solver, start = method_of(state, solver, warm_start, accuracy, sleep=sleep)
    # Not of a run that goes on, so that it comes to the same in one go and in parts.
    if by_preset and without_past and isinstance(start, Builtin) and not state.contacts.normal_start.any():
        state = _with_a_past(state)
    # A solved state is solved again from where it started, so that a resumed run repeats the steps of the first.
    state = state.replace(solver=solver)
    substeps = solver.substeps if isinstance(solver, PGS) else 1
    advance = Steps(solver, state.bodies.count, sleep=sleep, carry=not isinstance(start, NoStart))
    if substeps > 1:
        state = _in_substeps(state, substeps, engine.motion_parts(solver))
    kept = None if record is None else every * substeps
    state, log, frames = _advance(state, steps * substeps, advance, start, kept, on_step, stopped)
    if substeps > 1:
        state, *frames = (_in_steps(one, solver, substeps) for one in (state, *frames))
        log = _log_of_steps(log, substeps)
    return Simulation(state, *log[:5], None if record is None else Trajectory.from_states(frames))


def simulate_many(
    states: Iterable[State],
    *,
    steps: int = 600,
    dt: float | None = None,
    solver=None,
    warm_start: Literal["builtin", "none"] | Builtin | NoStart | None = "builtin",
    accuracy: Accuracy | None = None,
    sleep: bool = False,
    record: int | None = None,
    threads: int | None = None,
) -> list[Simulation]:
    """Run many scenes, each on its own, on all cores: for each what `simulate` returns, in their order, bit for bit.

    The compiled steps of one scene leave the interpreter to the others, so this pays for many small scenes, for which
    threads within a step would not. threads: at most so many; by default one a core. warm_start: "builtin", None or
    "none", which need nothing from Python between two steps. The other arguments are those of `simulate`.
    Raises ValueError and FloatingPointError as `simulate` does, with the number of the state.
    """
    threads = cores() if threads is None else integer("threads", threads, least=1)
    start = warm_start_of(warm_start)
    fits, states = isinstance(start, (Builtin, NoStart)), list(states)
    expect(fits, f"warm_start: expected 'builtin', 'none' or None for many scenes, got {warm_start!r}")
    for one in (solver, *(getattr(state, "solver", None) for state in states)):
        # Teams beside one thread a core would wait for each other.
        fits = (getattr(one, "threads", None) or 1) == 1
        expect(fits, f"solver: expected one with threads=1 for many scenes, got {one!r}")
    stopped = threading.Event()

    def run(number: int) -> Simulation:
        try:
            return _simulate(states[number], steps, dt, solver, start, accuracy, sleep, record, stopped=stopped)
        except (ValueError, FloatingPointError) as error:
            raise type(error)(f"states[{number}]: {error}") from error

    with ThreadPoolExecutor(min(threads, max(1, len(states)))) as pool:
        runs = [pool.submit(run, number) for number in range(len(states))]
        try:
            return [future.result() for future in runs]
        except BaseException:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _advance(
    state: State, steps: int, advance: Steps, start, record: int | None, on_step, stopped
) -> tuple[State, StepLog, list]:
    """So many steps of a state with its solver: the state after them, their log, the recorded states."""
    solver = state.solver
    # Builtin and NoStart need nothing from Python between two steps.
    by_step = on_step is not None or not isinstance(start, (Builtin, NoStart))
    if by_step and engine.motion_parts(solver) > 1:
        return _advance_by_parts(state, steps, advance, start, record, on_step, stopped)
    every = record or steps + 1
    log = make_log(steps)
    scales = engine.scales_of(state, solver)  # of radii that do not change in a run
    # Before the arrays of the result, so that its release leaves no gap on top of the heap, which would be given back.
    advance.memory(step_input(state, solver, scales))
    frames = [] if record is None else [state]
    done, is_own = 0, False  # whether nobody else sees the arrays that a step writes into
    work = _WORK // 8
    while done < steps:
        if stopped is not None and stopped.is_set():
            raise KeyboardInterrupt
        most = 1 if by_step else 1 + work // (10 * state.bodies.count + 50)
        count = min(steps - done, every - done % every, most)
        before, contacts = state, state.contacts
        if isinstance(start, Builtin):
            normal, tangent, problem = contacts.normal_start, contacts.tangent_start, None  # no step writes into these
        else:
            normal, tangent, problem = starting_impulses(start, state, solver, scales)
        state = state.replace(contacts=contacts._replace(normal_start=normal, tangent_start=tangent))
        if not is_own:
            state = _with_own_arrays(state)
        is_own = on_step is None
        if on_step is None:
            before = contacts = normal = tangent = None  # a million circles have 200 MB of them
        given = step_input(state, solver, scales)
        chunk = StepLog(*(column[done : done + count] for column in log[:5]), np.array([0, work]))
        begun = time.perf_counter()
        solved, found = advance(given, chunk, problem)
        # How a run is divided changes no bit of it.
        work = min(_WORK, 2 * work, 1 + int(work * _SECONDS / (time.perf_counter() - begun)))
        count = int(chunk.progress[0])
        if not np.isfinite(state.bodies.position.sum()):
            _raise_diverged(state.bodies, state.step + count)
        if on_step is not None:
            theta = advance.memory(given).theta[: chunk.sweeps[0]]
            convergence = convergence_record(theta, solver, int(chunk.contacts[0]))
            on_step(before.replace(contacts=Contacts(*map(np.copy, solved)), solved=True), convergence)
        done += count
        number = state.step + count
        # From the number of steps, not by adding up, so that time does not depend on how a run was divided.
        now = number * state.dt if state.time == state.step * state.dt else state.time + count * state.dt
        state, given, solved = state.replace(contacts=found, time=now, step=number, solved=False), None, None
        if record is not None and (done % every == 0 or done == steps):
            frames.append(state)
            is_own = False
    return state, log, frames


def _advance_by_parts(state, steps, advance, start, record, on_step, stopped) -> tuple[State, StepLog, list]:
    """`_advance` where motion divides the steps, and Python is called between their parts."""
    solver, log, frames = state.solver, make_log(steps), [] if record is None else [state]
    for k in range(steps):
        parts = advance.parts(step_input(state, solver))
        change = state.dt - state.dt / parts
        divided = _shifted(_in_substeps(state, parts), change)
        inside, of_parts, _ = _advance(divided, parts, advance, start, None, on_step, stopped)
        state = _shifted(_in_steps(inside, solver, parts), -change)
        for column, value in zip(log[:5], _log_of_steps(of_parts, parts)):
            column[k] = value[0]
        if record is not None and ((k + 1) % record == 0 or k + 1 == steps):
            frames.append(state)
    return state, log, frames


def _shifted(state: StateWithContacts, change: float) -> StateWithContacts:
    """The state whose Δt has become shorter by `change`, s (`substeps.shift_flights`)."""
    if change == 0.0 or state.world.restitution == 0.0:
        return state
    bodies = state.bodies._replace(velocity=state.bodies.velocity.copy())
    shift_flights(bodies, state.contacts, state.world.gravity, change)
    return state.replace(bodies=bodies)


def _with_a_past(state: StateWithContacts) -> StateWithContacts:
    """The state with the impulses of `FIRST_SWEEPS` sweeps from what its positions say (`warm_start.Support`)."""
    if state.contacts.count == 0:
        return state
    least, most = FIRST_SWEEPS
    solver = NesterovPGS(sweeps=min(max(least, state.bodies.count), most), tolerance=None)
    solution = solve_contacts(state, solver=solver, start="support")
    normal, tangent = solution.normal_impulses, solution.tangent_impulses
    contacts = state.contacts._replace(normal_start=normal, tangent_start=tangent)
    if not state.solved:
        contacts = contacts._replace(normal_impulse=normal, tangent_impulse=tangent)
    return state.replace(contacts=contacts)


def _with_own_arrays(state: State) -> State:
    """The state with copies of what steps write into."""
    contacts = state.contacts
    impulses = {name: getattr(contacts, name).copy() for name in Contacts._fields[5:]}
    return state.replace(bodies=Bodies(*map(np.copy, state.bodies)), contacts=contacts._replace(**impulses))


def _in_substeps(state: State, substeps: int, most: int | None = None) -> State:
    """The state as the substeps see it: their Δt, their number, the impulses that one of them carries.

    most: parts into which motion may divide a substep.
    """
    solver = replace(state.solver, substeps=1, most_substeps=most)
    return with_time_step(state, state.dt / substeps).replace(step=state.step * substeps, solver=solver)


def _in_steps(state: State, solver: PGS, substeps: int) -> State:
    """The inverse of `_in_substeps`, after whole steps."""
    step, dt = state.step // substeps, state.dt * substeps
    time = step * dt if state.time == state.step * state.dt else state.time
    return with_time_step(state, dt).replace(step=step, time=time, solver=solver)


def _log_of_steps(log: StepLog, substeps: int) -> StepLog:
    """The log of substeps, step by step: see `Simulation`."""
    contacts, sweeps, theta, relaxations, parts = (column.reshape(-1, substeps) for column in log[:5])
    sums = relaxations.sum(axis=1), parts.sum(axis=1)
    return StepLog(contacts[:, -1], sweeps.sum(axis=1), theta[:, -1], *sums, log.progress)


def with_time_step(state: State, dt: float) -> State:
    """The state with another Δt, s; the impulses that it carries from the last step are scaled by the ratio.

    Without the scaling a change of Δt kicks a pile at rest, whose impulses are m g Δt (Box2D 2.3 scales by `dtRatio`).
    """
    contacts = check_types(state).contacts
    if contacts is not None and number("dt", dt, above=0) != state.dt:
        ratio, names = dt / state.dt, ["normal_start", "tangent_start"]
        if not state.solved:  # whose impulses are the starts
            names += ["normal_impulse", "tangent_impulse"]
        contacts = contacts._replace(**{name: ratio * getattr(contacts, name) for name in names})
    return state.replace(dt=dt, contacts=contacts)


def _raise_diverged(bodies: Bodies, step: int) -> None:
    circle = int(np.flatnonzero(~np.isfinite(bodies.position).all(axis=1))[0])
    raise FloatingPointError(
        f"up to step {step}: circle {circle} (mass {bodies.mass[circle]:g} kg, radius {bodies.radius[circle]:g} m) has "
        "come to a position that is not finite: the solver diverged; try PGS, a smaller dt"
    )


def ready(state: State) -> StateWithContacts:
    """The state checked and completed: valid, within limits, its arrays as compiled code takes them, contacts found.

    Raises ValueError naming the quantity and the value, and the limit where it is beyond `state.LIMITS`.
    """
    check_types(state)
    if not (_has_engine_arrays(state) and engine.is_valid(state.bodies, state.contacts, len(state.world.segments))):
        state = check_limits(check_state(state))
    elif not (state.world.is_within_limits and LIMITS["dt"][0] <= state.dt <= LIMITS["dt"][1]):
        check_limits(state)
    if state.contacts is None:
        state = state.replace(contacts=engine.contacts_of(state))
        _warn_of_coincidence(state)
    return state


def _warn_of_coincidence(state: StateWithContacts) -> None:
    """Warn where two circles of a scene nearly coincide, so that chance decides in which direction they part."""
    bodies, (a, b) = state.bodies, state.contacts[:2]
    a, b = a[b < bodies.count], b[b < bodies.count]
    apart = np.hypot(*(bodies.position[b] - bodies.position[a]).T)
    near = apart < COINCIDENT * np.minimum(bodies.radius[a], bodies.radius[b])
    for i in np.flatnonzero(near)[:1]:
        which = f"circles {a[i]} and {b[i]} nearly coincide, their centres are {apart[i]:.3g} m apart"
        more = f" ({near.sum():,} pairs do)" if near.sum() > 1 else ""
        warnings.warn(f"bodies.position: {which}{more}; the solver pushes them apart at once", stacklevel=5)


def _has_engine_arrays(state: State) -> bool:
    """Whether all arrays are of the kind that compiled functions were compiled for: what `check_state` makes them."""
    return state.contacts is not None and all(
        type(array) is np.ndarray and array.dtype == dtype and array.ndim == ndim and array.flags.carray
        for array, (dtype, ndim) in zip((*state.bodies, *state.contacts), _KINDS)
    )


def method_of(
    state: State, solver=None, start="builtin", accuracy: str | None = None, *, sleep: bool = False, warn: bool = True
) -> tuple:
    """(Solver, start) of a run from this state: those of a preset, or the given ones, or the state's solver.

    Without any of these the solver is that of the preset "fast". Raises ValueError where they do not fit each other.
    """
    if accuracy is not None and solver is not None:
        raise ValueError(f"accuracy: expected no solver beside it, got {solver!r}")
    if accuracy is not None or (solver is None and state.solver is None):
        from deep_contact import presets  # which reads the study

        solver, of_preset, _, sentences = presets.decide(state, accuracy, sleep=sleep)
        for sentence in sentences if warn else ():
            warnings.warn(sentence, presets.PresetWarning, stacklevel=4)
        start = start if accuracy is None else of_preset
    return checked_solver(solver, state), warm_start_of(start)


def checked_solver(solver, state: State):
    """The solver, or the state's, or PGS, for this state. Raises ValueError where it does not fit the state."""
    solver = next(one for one in (solver, state.solver, PGS()) if one is not None)
    entry_of(solver)
    return for_state(solver, state)
