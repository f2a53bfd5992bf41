"""The validated interface of the engine: `find_contacts`, `solve_contacts`, `step`, `simulate`, `simulate_many`."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from deep_contact.parallel import cores
from deep_contact.physics import engine
from deep_contact.physics.convergence import ConvergenceRecord
from deep_contact.physics.engine import ContactSolution, contacts_of
from deep_contact.physics.forces import SIDES
from deep_contact.physics.load import has_new_load, load_of, with_a_past, with_new_load
from deep_contact.physics.ready import ready
from deep_contact.physics.solvers import PGS
from deep_contact.physics.solvers.registry import entry_of, for_state, tolerance_argument
from deep_contact.physics.substeps import shift_flights
from deep_contact.presets import Accuracy, Decision, MeasuredAccuracy, PresetWarning, decide
from deep_contact.running import run
from deep_contact.state import State, StateWithContacts, notebook
from deep_contact.state.checks import check_types, checked_indices
from deep_contact.trajectory import Trajectory
from deep_contact.validation import brief, expect, flag, integer, number, one_of
from deep_contact.warm_start import Builtin, NoStart, Start, WarmStart, starting_impulses, warm_start_of


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
    | loads       | what walls and segments received until each recorded state, (T, 4 + S, 2), N·s, or None   |
    | solved      | what `on_step` sees of the steps that led to a recorded state, a `Trajectory`, or None    |

    With substeps, contacts and θ are those of a step's last substep, sweeps and relaxations sums over all of them.
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

    @property
    def trajectory(self) -> Trajectory:
        """The recorded states. Raises ValueError where none were asked for."""
        if self.recorded is None:
            raise ValueError("trajectory: expected a run of simulate(…, record=…), got one that recorded no states")
        return self.recorded

    def force_on(self, part: str, index: int | Sequence[int] | None = None) -> np.ndarray:
        """The mean force of contacts between each recorded state and the next, (T − 1, 2), N; its times are theirs.

        part: "floor", "right", "ceiling", "left", "segment" or "circle". index: of the segment or the circle; the force
        on several is their sum. The mean is over all steps and substeps, rebounds included. Of a circle it is what
        changed its momentum, but for gravity (with e > 0, to half a step's fall of a circle that lands where motion
        divides the step); walls and segments need a run with forces=True.
        Raises ValueError where nothing was recorded, or what there is not.
        """
        recorded, world = self.trajectory, self.state.world
        if part in SIDES:
            expect(index is None, f"index: expected none of the {part}, got {brief(index)}")
            part, index = "wall", SIDES.index(part)
        count = {"wall": 4, "segment": len(world.segments), "circle": self.state.bodies.count}
        chosen = checked_indices("index", index, count[one_of("part", part, (*SIDES, "segment", "circle", "wall"))])
        seconds = np.diff(recorded.times)[:, None]
        if part == "circle":
            mass = self.state.bodies.mass[chosen]
            change = np.einsum("tik,i->tk", np.diff(recorded.velocities[:, chosen], axis=0), mass)
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
        """What a notebook shows: how the run went, and its last state."""
        return notebook.shown("Simulation", self._summary().items()) + self.state._repr_html_()

    def _summary(self) -> dict[str, str]:
        summary = {"steps": notebook.counted(self.sweeps.size, "step")}
        if self.sweeps.size:
            ends = self.status
            summary["sweeps"] = f"{self.sweeps.mean():.1f} sweeps a step"
            if self.substeps.max() > 1:
                summary["substeps"] = f"{self.substeps.mean():.1f} substeps a step"
            if tolerance_argument(self.state.solver) > 0:  # otherwise every step takes its number of sweeps, as meant
                summary["solves"] = f"converged in {np.isin(ends, ('converged', 'no_contacts')).sum():,} steps"
            if (ends == "diverged").any():
                summary["diverged"] = f"{(ends == 'diverged').sum():,} diverged"
        return summary | ({} if self.recorded is None else {"record": notebook.counted(len(self.recorded), "state")})


def find_contacts(state: State) -> StateWithContacts:
    """The state with the contacts at its positions: they are found, and nothing is solved.

    Pairs that were contacts of the state keep their impulses, others have none. What was solved stays solved where no
    contact comes or goes. Raises ValueError on a state that does not hold together.
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


def solve_contacts(state: State, *, solver=None, start: Start | Sequence[np.ndarray] = "builtin") -> ContactSolution:
    """Solve the contact problem of a state: gravity for Δt, then the impulses. The state stays as it is.

    solver: options such as `PGS(sweeps=…)`; by default the state's own. start: as `warm_start` of `simulate`, or
    two arrays (normal, tangent), (m,) each, N·s.
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
    accuracy: Accuracy | MeasuredAccuracy | None = None,
    sleep: bool = False,
    record: int | None = None,
    forces: bool = False,
    until: Callable[[StateWithContacts], object] | None = None,
    on_step: Callable[[StateWithContacts, ConvergenceRecord], None] | None = None,
) -> Simulation:
    """Run a scene, or go on from a state, for so many steps.

    dt: time step, s; if it is not the state's, carried impulses are scaled by the ratio.
    solver: options such as `PGS(sweeps=…)`; by default the state's own, or what accuracy="fast" takes.
    warm_start: None, the name of a start, a callable of `deep_contact.warm_start`, which is asked once a step, or a
    network, as `dc.load_model` gives it or by the path of its file, "….h5".
    accuracy: "preview", "fast", "balanced", "accurate" or "reference", in place of solver and start: the cheapest that
    were measured to keep the tolerances of that preset (`presets.PRESETS`) on the errors of a run; or what
    `measure_trade` measured on your scene. Where the scene's circles are too small or too fast for its Δt, the step is
    divided into substeps. At step 0 contacts that carry no impulses, as of positions from elsewhere, get those at which
    they rest, where there are any (`physics.relaxation`), or are solved well.
    sleep: leave islands that have been still for half a second as they are until something touches them, as Box2D 2.3
    does (`physics.sleeping`). Who sleeps is known within the run only: one that goes on from its state starts awake.
    record: keep the first state, one in so many steps, and the last, as `trajectory` of the result.
    forces: add up what walls and segments receive between the states that `record` keeps, for `Simulation.force_on`,
    and keep what `on_step` sees of the step that led to each, as `Simulation.solved`.
    until: called after each step with the state that it led to; the run ends where this is true.
    on_step: called after each step with the solved state and the `ConvergenceRecord` of its sweeps, of a divided step
    of its last. The state has the bodies before the step and its contacts: with the impulses that they started from,
    and with all that they gave in the step, in its substeps and rebounds. So the changes of momentum are the sums of
    these impulses and gravity's. Contacts that came during the step are among them, where they came, and started from
    0. To go on from such a state repeats the step.
    Arrays that `until` and `on_step` get cannot be written into: `Simulator` changes what goes on.
    Raises ValueError on arguments that do not hold together, and FloatingPointError where the solver diverges beyond
    all numbers; the run can be interrupted.
    """
    return _simulate(state, steps, dt, solver, warm_start, accuracy, sleep, record, forces, until, on_step)


def _simulate(
    state, steps, dt, solver, warm_start, accuracy, sleep, record, forces=False, until=None, on_step=None, stopped=None
) -> Simulation:
    """`simulate`, which ends with a KeyboardInterrupt once the event `stopped` is set."""
    integer("steps", steps)
    if record is not None:
        integer("record", record, least=1)
    expect(not flag("forces", forces) or record is not None, "forces: expected False without record=…, got True")
    if dt is not None:
        state = with_time_step(state, dt)
    first, state = state, ready(state)
    without_past = first.contacts is None or state.step == 0
    solver, start, _, decision = method_of(state, solver, warm_start, accuracy, sleep=sleep)
    for sentence in decision.warnings if decision else ():
        warnings.warn(sentence, PresetWarning, stacklevel=3)
    # Not of a run that goes on, so that it comes to the same in one go and in parts.
    if decision and without_past and isinstance(start, Builtin) and not state.contacts.normal_start.any():
        state = with_a_past(state)
    elif has_new_load(state):
        state = find_contacts(state)
        state = state if isinstance(start, NoStart) else with_new_load(state, solver)
    # A solved state is solved again from where it started, so that a resumed run repeats the steps of the first.
    state = state.replace(solver=solver)
    state, log, frames, loads, solved = run(state, start, steps, sleep, record, on_step, until, forces, stopped)
    recorded, solved = (Trajectory.from_states(states) if states else None for states in (frames, solved))
    return Simulation(state, *log[:5], recorded, np.array(loads) if forces else None, solved)


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
) -> list[Simulation]:
    """Run many scenes, each on its own, on all cores: for each what `simulate` returns, in their order, bit for bit.

    The compiled steps of one scene leave the interpreter to the others. threads: at most so many; by default one a
    core. warm_start: "builtin", None or "none", which need nothing from Python between two steps. The other arguments
    are those of `simulate`.
    Raises ValueError and FloatingPointError as `simulate` does, with the number of the state.
    """
    threads = cores() if threads is None else integer("threads", threads, least=1)
    start = warm_start_of(warm_start)
    fits, states = isinstance(start, (Builtin, NoStart)), list(states)
    expect(fits, f"warm_start: expected 'builtin', 'none' or None for many scenes, got {warm_start!r}")
    stopped = threading.Event()

    def one(number: int) -> Simulation:
        try:
            return _simulate(states[number], steps, dt, solver, start, accuracy, sleep, record, forces, stopped=stopped)
        except (ValueError, FloatingPointError) as error:
            raise type(error)(f"states[{number}]: {error}") from error

    with ThreadPoolExecutor(min(threads, max(1, len(states)))) as pool:
        runs = [pool.submit(one, number) for number in range(len(states))]
        try:
            return [future.result() for future in runs]
        except BaseException:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def with_time_step(state: State, dt: float) -> State:
    """The state with another Δt, s; the impulses that it carries from the last step are scaled by the ratio.

    Without the scaling a change of Δt kicks a pile at rest, whose impulses are m g Δt (Box2D 2.3 scales by `dtRatio`).
    Where e > 0 circles in flight keep their energy (`substeps.shift_flights`).
    """
    contacts = check_types(state).contacts
    if contacts is not None and number("dt", dt, above=0) != state.dt:
        ratio, names = dt / state.dt, ["normal_start", "tangent_start"]
        if not state.solved:  # whose impulses are the starts
            names += ["normal_impulse", "tangent_impulse"]
        contacts = contacts._replace(**{name: ratio * getattr(contacts, name) for name in names})
        if state.world.restitution > 0.0 and state.step > 0:
            state = state.replace(bodies=state.bodies._replace(velocity=state.bodies.velocity.copy()))
            shift_flights(state.bodies, contacts, state.world.gravity, state.dt - dt)
    return state.replace(dt=dt, contacts=contacts)


class Method(NamedTuple):
    """How a run solves: what `simulate` takes, and `plan` prints."""

    solver: object  # with numbers in place of what follows the scene
    start: WarmStart
    start_name: str
    decision: Decision | None  # of the preset that chose the solver; None where the caller did


def method_of(state: State, solver=None, start="builtin", accuracy=None, *, sleep=False) -> Method:
    """The method of a run from this state: that of a preset, or of the solver, or of the state's.

    Without any of these the solver is that of the preset "fast". Raises ValueError where they do not fit each other.
    """
    if accuracy is not None and solver is not None:
        raise ValueError(f"accuracy: expected no solver beside it, got {solver!r}")
    decision = None
    if accuracy is not None or (solver is None and state.solver is None):
        decision = decide(state, accuracy, sleep=sleep)
        solver, start = decision.solver, start if accuracy is None else decision.start
    solver = checked_solver(solver, state)
    if decision and _goes_on(state, solver):
        solver = state.solver
    if flag("sleep", sleep) and not entry_of(solver).can_sleep:
        raise ValueError(f"sleep: expected False with {type(solver).__name__}, got True")
    named = str(start) if isinstance(start, (str, Path)) else getattr(start, "__name__", type(start).__name__)
    return Method(solver, warm_start_of(start), "none" if start is None else named, decision)


def _goes_on(state: State, solver) -> bool:
    """Whether a run has come to this state with this solver, but for the division of its steps, which it then keeps.

    A preset divides by the speed of the fastest circle, which changes in a run.
    """
    if state.step == 0 or type(state.solver) is not type(solver) or state.load not in (None, load_of(state)):
        return False
    divided = {"substeps": solver.substeps, "most_substeps": solver.most_substeps}
    return replace(state.solver, **divided) == solver


def checked_solver(solver, state: State):
    """The solver, or the state's, or PGS, for this state. Raises ValueError where it does not fit the state."""
    solver = next(one for one in (solver, state.solver, PGS()) if one is not None)
    entry_of(solver)
    return for_state(solver, state)
