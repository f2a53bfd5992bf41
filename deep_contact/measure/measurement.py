"""`measure_trade`: the cost and the errors of settings on a scene, from runs with several seeds.

Every setting runs the scene with every seed. So does a reference, with 20 sweeps of PGS in substeps of at most a
sixteenth of the longest step that a preset uses. For scenes that `stiffness` finds too stiff, the reference has a
better solver (`settings.reference_of`). Errors are the differences between the runs of a setting and those of the
reference (`measure.errors`), with intervals over seeds.

Tests: tests/measure/test_trade.py
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import pickle
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing

import numpy as np

from deep_contact import parallel
from deep_contact.accuracy import presets
from deep_contact.accuracy.scene_numbers import scene_numbers
from deep_contact.accuracy.stiffness import stiffness
from deep_contact.io.provenance import provenance
from deep_contact.measure.errors import ERRORS, REST, Observation, errors, observe, with_next
from deep_contact.measure.setting_runs import Run, noise_of, rivals, row_of, states_of, timed
from deep_contact.measure.settings import ladder, name_of, reference_of, setting_of, settings_of_presets
from deep_contact.measure.trade import REFERENCE, SHOWN, Trade, _percent, _text
from deep_contact.measure.watched import readings_of
from deep_contact.parallel import progress_bar
from deep_contact.state.scales import mean
from deep_contact.state.state import State
from deep_contact.state.validation import brief, expect, integer, number, suggesting
from deep_contact.stepping.interface import entry_of
from deep_contact.stepping.prepare import ready

FRAMES = 120
"""Smallest number of observations of a run. A run with fewer steps has one observation a step."""

SHIFT = 1e-3
"""Largest shift of a coordinate in a copy of a state, in slops."""

APART = 0.01
"""Root mean square distance of the circles of two copies, in mean radii, above which the copies count as apart."""

TIMED = 2
"""Number of seeds whose runs are timed. A timed run is one call, without observations between its steps."""

HALF = "half step"
"""Name of the runs with half the reference's step."""


@suggesting
def measure_trade(
    scene: State | Callable[[int], State],
    *,
    steps: int = 600,
    minutes: float | None = None,
    seeds: int | Iterable[int] = 6,
    quantities: Mapping[str, Callable[[State], object]] | None = None,
    settings: Iterable | None = None,
    engines: bool = False,
    jobs: int | Executor = 1,
    before: Trade | None = None,
) -> Trade:
    """Measure the cost and the errors of settings on a scene.

    scene: a state, or a function of a seed that returns a state. A state is copied for each seed, with its coordinates
    shifted by up to 0.001 slops. steps: number of steps of the scene's Δt in each run, at least 20. From 240 steps on,
    observations are several steps apart, and a run leaves out the last steps if they do not fill such an interval.
    seeds: number of seeds, or the seeds themselves.
    minutes: time after which no further run begins; the result then has the runs so far. Compiling does not count.
    quantities: name -> a function of a state that returns a number or an array. It is called at each observation: after
    each step, and from 240 steps on at 120 to 179 equal intervals.
    settings: solvers to measure besides the presets, such as PGS(sweeps=4); by default a short list around the presets.
    engines: whether other engines (`peers.ENGINES`) run the scene as well, if they can. jobs: number of processes, or
    an executor, as in `parallel.finished`. before: an earlier result, whose runs are not done again.

    Runs are done seed by seed. Ctrl-C returns the result of the runs so far.
    Raises ValueError on bad arguments, and if a run of the reference ends with an error.
    """
    numbers, quantities = _checked(steps, minutes, seeds, quantities, jobs)
    states = copies(scene, numbers)
    trade = _begun(states, steps, settings, engines, quantities)
    trade.observed = {} if before is None else _known(trade, before)
    _run(trade, states, quantities, minutes, jobs)
    _judge(trade)
    if isinstance(scene, State) and len(states) > 1:
        trade.notes.append(_together(states[:2], trade))
    return trade


def _intervals(trade: Trade) -> tuple[int, float]:
    """Return the number of intervals between the observations of a run, and the length of an interval, s."""
    every = max(1, trade.steps // FRAMES)
    return trade.steps // every, every * trade.dt


def _run(trade: Trade, states: Sequence[State], quantities: Mapping, minutes: float | None, jobs) -> None:
    """Do all runs, until the time is over or the user interrupts them. Their results go into the trade, in place."""
    settings = {REFERENCE: trade.reference, **trade.settings, HALF: trade.half}
    # The order is seed by seed. When the time is over, seeds are then missing, not settings.
    runs = [(name, i) for i in range(len(states)) for name in settings if (name, i) not in trade.observed]
    where = *_intervals(trade), quantities
    tasks = [(states[i], settings[name], *where, _is_timed(trade, name, i)) for name, i in runs]
    end = math.inf if minutes is None else time.monotonic() + 60.0 * minutes
    try:
        with closing(parallel.finished(_task, tasks, jobs=jobs)) as done:
            for count, (k, result) in enumerate(progress_bar(done, total=len(runs), text="trade"), 1):
                name, _ = runs[k]
                if isinstance(result, str):
                    expect(name != REFERENCE, f"scene: expected one that the reference can run, got {result}")
                    trade.notes.append(f"{name} comes to no end: {result}")
                else:
                    trade.observed[runs[k]] = result
                if count < len(runs) and time.monotonic() > end and _has_reference(trade):
                    trade.notes.append(f"after {minutes:g} min {count} of {len(runs)} runs were done")
                    break
    except KeyboardInterrupt:
        if not _has_reference(trade):
            raise
        trade.notes.append("interrupted: this is what was known then")


def _has_reference(trade: Trade) -> bool:
    """Return whether a run of the reference is done. Without such a run there are no errors."""
    return any(name == REFERENCE for name, _ in trade.observed)


def _checked(steps, minutes, seeds, quantities, jobs) -> tuple[list[int], dict[str, Callable]]:
    """Return the seeds and the quantities of `measure_trade`. Raises ValueError on bad arguments."""
    integer("steps", steps, least=REST)
    if minutes is not None:
        number("minutes", minutes, above=0)
    quantities = dict(quantities or {})
    for name, quantity in quantities.items():
        expect(callable(quantity), f"quantities[{name!r}]: expected a function of a state, got {quantity!r}")
        expect(name not in ERRORS, f"quantities: expected other names than those of the study's errors, got {name!r}")
    if not isinstance(jobs, Executor) and integer("jobs", jobs, least=1) > 1:
        try:
            pickle.dumps(quantities)
        except (AttributeError, pickle.PicklingError, TypeError) as error:
            raise ValueError(f"quantities: expected functions of a module for jobs={jobs}, got {error}") from None
    several = range(integer("seeds", seeds, least=1)) if isinstance(seeds, int) else seeds
    numbers = [integer("seeds", seed) for seed in several]
    expect(numbers and len(set(numbers)) == len(numbers), f"seeds: expected different numbers, got {brief(numbers)}")
    return numbers, quantities


def _is_timed(trade: Trade, name: str, i: int) -> bool:
    """Return whether the run of this name with the i-th seed is timed.

    Only runs of settings are timed, with the first `TIMED` seeds. Runs of the reference are not.
    """
    return i < TIMED and name in trade.settings


def _task(task: tuple) -> tuple[float | None, Observation] | str:
    """Return (seconds or None, Observation) of a run, or the message of the error with which it ends."""
    start, setting, frames, interval, quantities, is_timed = task
    try:
        seconds = timed(start, setting, frames * interval) if is_timed else None
        return seconds, observe(readings_of(start, setting, frames, interval), quantities)
    except (FloatingPointError, ValueError) as error:
        return str(error)


def copies(scene: State | Callable[[int], State], seeds: Sequence[int]) -> list[State]:
    """Return the scene of each seed.

    Raises ValueError on a value that is no scene, and on a scene that is not valid.
    """
    if isinstance(scene, State):
        bodies, slop = ready(scene).bodies, scene.scales.slop
        expect(bodies.count, "scene: expected a circle at least, got none")
        shifts = (np.random.default_rng(seed).uniform(-SHIFT, SHIFT, bodies.position.shape) * slop for seed in seeds)
        return [scene.replace(bodies=bodies._replace(position=bodies.position + shift)) for shift in shifts]
    expect(callable(scene), f"scene: expected a State or a function of a seed, got {scene!r}")
    states: list[State] = []
    for seed in seeds:
        try:
            state = scene(seed)
        except Exception as error:
            raise ValueError(f"scene({seed}): expected a State, got {type(error).__name__}: {error}") from error
        expect(ready(state).bodies.count, "scene: expected a circle at least, got none")
        states.append(state)
        alike = (state.bodies.count, state.dt) == (states[0].bodies.count, states[0].dt)
        expect(alike, f"scene({seed}): expected as many circles and the Δt of the first, got {state!r}")
    return states


def _begun(states: Sequence[State], steps: int, settings, engines: bool, quantities: Mapping) -> Trade:
    """Return the trade before its first run. All code that the runs need is compiled here."""
    first, numbers = states[0], scene_numbers(states[0])
    stiff = stiffness(first, numbers)
    by_preset, more = settings_of_presets(numbers, stiff), ladder(numbers)
    if settings is not None:
        more = [setting_of(solver, first.dt) for solver in settings if entry_of(solver)]
    found, notes = rivals(first) if engines else ([], [])
    if outside := presets.outside(numbers, stiff):
        notes.append("outside of the study of the presets: " + "; ".join(outside))
    for setting in (*by_preset.values(), *more):
        with contextlib.suppress(FloatingPointError):  # the runs of this setting will report the error
            Run(first, setting).advance(1)
    named = {name_of(one, first.dt): one for one in (*by_preset.values(), *more, *found)}
    values = {name: with_next(name, quantity, ready(first), []) for name, quantity in quantities.items()}
    true, half = (reference_of(numbers, stiff, finer) for finer in (1, 2))
    return Trade(
        scene=first.name, n_bodies=first.bodies.count, dt=first.dt, steps=steps, notes=notes,
        quantities=list(quantities), settings=named, reference=true, half=half, cpu=provenance()["cpu"],
        by_preset={preset: name_of(one, first.dt) for preset, one in by_preset.items()},
        digests=list(map(_digest_of_state, states)),
        looks={name: _digest(value if isinstance(value, str) else value[0]) for name, value in values.items()},
    )  # fmt: skip


def _digest_of_state(state: State) -> str:
    """Return a digest of everything from which a run starts.

    This is the world, the bodies, the contacts with their impulses, the time, the step and Δt.
    """
    moment = repr((state.world, state.time, state.step, state.dt, state.solved, state.contacts is None))
    return _digest(moment, *state.bodies, *(state.contacts or ()))


def _digest(*parts) -> str:
    """Return a digest of arrays and texts, sixteen hexadecimal digits."""
    sha = hashlib.sha256()
    for part in parts:
        sha.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
    return sha.hexdigest()[:16]


def _known(trade: Trade, before: Trade) -> dict:
    """Return the observations of an earlier result that belong to runs of this trade.

    Raises ValueError if the earlier result is of another scene, or of runs that differ from those of this trade.
    """
    expect(isinstance(before, Trade), f"before: expected a Trade, got {brief(before)}")
    for name in ("dt", "steps", "quantities", "looks", "reference", "cpu"):
        mine, other = getattr(trade, name), getattr(before, name)
        expect(mine == other, f"before: expected {name} {mine!r}, got {other!r}")
    common = [i for i, (one, other) in enumerate(zip(trade.digests, before.digests)) if one == other]
    expect(common, "before: expected a trade of the same scene, got another")
    same = {name for name, one in trade.settings.items() if before.settings.get(name) == one} | {REFERENCE, HALF}
    return {(name, i): seen for (name, i), seen in before.observed.items() if name in same and i in common}


def _judge(trade: Trade) -> None:
    """Compute rows, noise, convergence and notes of the trade from its observations, in place."""
    true = {i: seen for (name, i), (_, seen) in sorted(trade.observed.items()) if name == REFERENCE}
    trade.seeds, seconds_each = len(true), math.prod(_intervals(trade))

    def paired(name):
        return [(trade.observed[name, i][1], seen) for i, seen in true.items() if (name, i) in trade.observed]

    for name, setting in trade.settings.items():
        if pairs := paired(name):
            took = [seconds for (of, _), (seconds, _) in trade.observed.items() if of == name and seconds is not None]
            us = 1e6 * float(np.mean(took)) * trade.dt / seconds_each if took else None
            trade.rows.append(row_of(setting, trade.dt, *zip(*pairs)) | {"us": us})
    if pairs := paired(HALF):
        half, reference = zip(*pairs)
        chance = math.sqrt(len(half) / trade.seeds)
        trade.noise = {name: chance * value for name, value in noise_of(half, reference).items()}
        trade.converged = {name: value for name, value in errors(half, reference).items() if value is not None}
    trade.notes += _sentences(trade, list(true.values()), len(pairs))


def _sentences(trade: Trade, reference: Sequence[Observation], checked: int) -> Iterator[str]:
    """Yield the notes of a trade: undecided errors, doubts about the reference, failed quantities, missing contacts.

    reference: observations of the reference. checked: number of runs with half the reference's step.
    """
    for name, noise in trade.noise.items():
        of = [row["errors"][name][0] for row in trade.rows if row["errors"][name]]
        differ = max(of, default=0.0) - min(of, default=0.0)
        if name in (*SHOWN, *trade.quantities) and noise > differ > 1e-3 * noise:
            alone = f"seeds alone make {_text(name, noise)}, settings differ by {_text(name, differ)}"
            yield f"{name} is undecided: {alone}; {trade.enough(name, differ)} seeds would do"
        change, chance = trade.converged.get(name, 0.0), noise * math.sqrt(trade.seeds / max(1, checked))
        if change > max(2.0 * chance, 1.0 / _percent(name)):
            why = f"half its step changes it by {_text(name, change)}, seeds by {_text(name, chance)}"
            yield f"the reference is not converged in {name}: {why}"
    own = (value for _, seen in trade.observed.values() for value in seen.quantities.values())
    yield from sorted({value for value in own if isinstance(value, str)})[:3]
    if reference and not any(seen.contacts.any() or seen.penetration.any() for seen in reference):
        yield "nothing touches anything: the errors are those of free flight"


def _together(pair: Sequence[State], trade: Trade) -> str:
    """Return a sentence on how long two copies of a state stay close to each other."""
    setting, (frames, interval) = trade.settings[trade.by_preset["fast"]], _intervals(trade)
    for k, (one, other) in enumerate(zip(*(states_of(state, setting, frames, interval) for state in pair))):
        apart = np.sqrt(((one.bodies.position - other.bodies.position) ** 2).sum(axis=1).mean())
        if apart > APART * mean(one.bodies.radius):
            return f"copies of the state stay within {APART:.0%} of a radius of one another for {k * interval:.3g} s"
    return f"copies of the state stay together: the spread over seeds is that of shifts of {SHIFT:g} slops"
