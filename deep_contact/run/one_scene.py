"""Runs of one scene, `simulate` and `step`, and the solve of one contact problem, `solve_contacts`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import numpy as np

from deep_contact.accuracy.presets import Accuracy, MeasuredAccuracy
from deep_contact.run.last_run import _last_run
from deep_contact.run.method import RunOptions, checked_solver
from deep_contact.run.result import Simulation
from deep_contact.run.simulator import begun
from deep_contact.run.trajectory import Trajectory
from deep_contact.starts.changed_load import with_time_step
from deep_contact.starts.classical import starting_impulses
from deep_contact.starts.names import Start
from deep_contact.state.materials import largest
from deep_contact.state.state import State, StateWithContacts, read_only
from deep_contact.state.validation import flag, function, integer, suggesting
from deep_contact.stepping.convergence import ConvergenceRecord
from deep_contact.stepping.log import make_log
from deep_contact.stepping.prepare import ready
from deep_contact.stepping.problem import ContactSolution, solve

MOST_STEPS = 10**12
"""Largest number of steps of a run. The result has 40 bytes a step, so that memory limits a run before this number
does."""


@suggesting
def solve_contacts(state: State, *, solver=None, start: Start | Sequence[np.ndarray] = "builtin") -> ContactSolution:
    """Solve the contact problem of a state: apply gravity for Δt, then find the impulses. The state stays as it is.

    solver: options such as `PGS(sweeps=…)`; by default the state's own. start: as `warm_start` of `simulate`, or two
    arrays (normal, tangent), (m,) each, N·s.
    Raises ValueError on a state, solver or start that is not valid.
    """
    state = ready(state)
    solver = checked_solver(solver, state)
    return solve(state, solver, *starting_impulses(start, state, solver))


@suggesting
def step(state: State, *, solver=None, warm_start: Start = "builtin") -> StateWithContacts:
    """Do one step. Returns the state Δt later, with its contacts detected and the solved impulses carried over to them.

    The `on_step` of `simulate` has access to the impulses that the step solved. Arguments and errors are those of
    `simulate`. A `Simulator` does many steps in less time than a loop over this function.
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
    """Run a scene for a number of steps, or continue a run from its last state.

    dt: time step, s, by default the state's; carried impulses are scaled by the ratio of the two time steps.
    solver: options such as `PGS(sweeps=…)`; by default the state's solver, or the solver of accuracy="fast" if the
    state has none.
    warm_start: the start of each solve: a name; a callable as in `deep_contact.warm_start`, which is called before each
    step; a network from `dc.load_model`, or the path of its file, "….h5"; or None, which means impulses of 0.
    accuracy: a preset, "preview", "fast", "balanced", "accurate" or "reference", which chooses solver and start: the
    cheapest of the measured settings whose errors are within the tolerances of the preset (`presets.PRESETS`). A
    `Trade`, the result of `measure_trade` on your scene, can choose in place of a preset. If the scene's circles are
    too small or too fast for its Δt, the chosen solver divides each step into substeps. If no contact has an impulse at
    step 0, as in a scene of positions alone, contacts get impulses at which the circles rest, if there are any
    (`starts.impulses_at_rest`), or accurately solved impulses.
    sleep: whether an island, a group of connected circles, falls asleep once it has been still for
    `State.scales.sleep_time` (0.5 s for circles of r = 1 m), as in Box2D 2.3. The island wakes when something touches
    it or the push on it changes (`stepping.sleeping`). States do not store which circles sleep: a run that continues
    from a state starts with all circles awake.
    push: external forces on the circles besides gravity, (n, 2), N, or a tuple of forces and torques, (n,), N·m; or a
    function of the state that returns them, which is called before each step. They do not act on fixed circles.
    record: number of steps between two recorded states. The first and the last state are recorded too.
    `Simulation.trajectory` has the recorded states.
    forces: whether to sum the impulses on walls and segments between recorded states, for `Simulation.force_on`, and to
    store the solved state of the last step before each recorded state, as `Simulation.solved`.
    until: function that is called after each step with the state after it; the run ends when it returns a true value.
    on_step: function that is called after each step with the solved state and the `ConvergenceRecord` of the step's
    sweeps. If the step has substeps, the record is that of the last substep. The solved state has the bodies before the
    step, and the contacts of the step. Their `normal_start` and `tangent_start` are the impulses from which the solve
    started. Their `normal_impulse` and `tangent_impulse` are the impulses in the step, summed over substeps and
    rebounds. Contacts that began during the step are among them, at the positions where they began, and with starting
    impulses of 0. The change of a circle's momentum is the sum of these impulses, of those of gravity and pushes, and
    if e > 0 of the record's `shifts`. A run that continues from such a state, with the same push, repeats the step. The
    arrays that `until` and `on_step` get are read-only. Use a `Simulator` to change a run between steps.
    Raises ValueError on arguments that do not fit each other, and FloatingPointError if the solver diverges to
    positions that are not finite. The run can be interrupted.
    """
    options = RunOptions(
        steps=steps, dt=dt, solver=solver, warm_start=warm_start, accuracy=accuracy, sleep=sleep, push=push,
        record=record, forces=forces, until=until, on_step=on_step,
    )  # fmt: skip
    return _simulate(state, options)


def _simulate(state: State, options: RunOptions, stopped: threading.Event | None = None) -> Simulation:
    """Do `simulate` with these options. Raises KeyboardInterrupt once the event `stopped` is set."""
    record, forces, until, on_step = options.record, options.forces, options.until, options.on_step
    steps = integer("steps", options.steps, most=MOST_STEPS, hint="; Δt is dt=…")
    if record is not None:
        integer("record", record, least=1)
    if flag("forces", forces) and record is None:
        raise ValueError("forces: expected False without record=…, got True")
    for name, value in (("until", until), ("on_step", on_step)):
        if value is not None:
            function(name, value)
    if options.dt is not None:
        state = with_time_step(state, options.dt)
    how = options.how
    run = _last_run.take(state, how) if options.push is None else None
    if run is None:
        run = begun(state, options)
    is_driven, every, done = record is not None and run._inputs.actuation is not None, record or steps + 1, 0
    is_shifted = record is not None and not is_driven and largest(state.world.restitution) > 0.0
    loads_of, n = 4 + len(state.world.segments) if forces else 0, state.bodies.count if record is not None else 0
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
            most = min(most, left - 1)  # the last step before a recorded state has to be a call of its own
        is_watched = on_step is not None or (forces and (left == 1 or until is not None))
        done += run._advance(run._rows(log, done, min(left, most), is_watched), is_watched)
        if on_step is not None:
            on_step(*run._now.seen)
        if until is not None:
            is_over = bool(until(read_only(run.state)))
        if record is not None and (done % every == 0 or done == steps or is_over):
            frames.append(run.state)
            loads.append(log.loads.copy())
            on_circles.append(log.on_circles.copy())
            shifts.append(log.shifts.copy())
            work.append(float(log.work[0]))
            solved += run._now.seen[:1]
    recorded = Trajectory.from_states(frames, work=work if is_driven else None) if frames else None
    of_steps = Trajectory.from_states(solved) if solved else None
    columns = [column[:done] for column in log[:5]]
    sums = np.array(loads) if forces else None, of_steps, np.array(on_circles) if is_driven else None
    sums += (np.array(shifts) if is_shifted else None,)
    last = _last_run.keep(run, how) if done else run._state(np.asarray)
    return Simulation(last, *columns, recorded, *sums)
