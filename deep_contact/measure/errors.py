"""Observations of a run, and errors of an ensemble of runs against a reference ensemble, with confidence intervals.

A pile is chaotic: two runs differ after a second, whatever the solver. An error therefore compares means and
distributions over an ensemble of seeds with those of a reference, which stands for the limit of small steps. Lengths
are counted in mean radii r and speeds in √(g r), so that errors are the same at every scale. Without gravity a tenth of
the fastest circle's speed takes the place of √(g r), as in `presets.longest_step`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy import stats

from deep_contact.accuracy.presets import FASTEST
from deep_contact.state.equality import by_value
from deep_contact.state.state import State
from deep_contact.state.validation import brief

LOADS = np.linspace(0.0, 6.0, 121)
"""Values of λ_n / mean λ_n at which the cumulative distribution of this ratio is stored, (121,)."""

REST = 20
"""Number of observations at the end of a run in which the circles count as at rest."""

SETTLED = 0.2
"""Rms speed of the reference at rest, in √(g r), below which heights count as settled. In a drum this speed is larger.
"""

TOUCHING = 1e-3
"""Gap, in mean radii, up to which two bodies count as in contact. Rigid bodies that touch have a gap of 0."""

LARGEST = 1e100
"""Largest absolute value that a user's quantity may have, so that sums of values are finite."""

ERRORS = {
    "energy": "kinetic-energy curve: Σ |⟨E_k⟩ − ⟨E_k⟩*| / Σ ⟨E_k⟩* over the whole run, %",
    "height": "settled height of the centre of mass: difference, % of the reference's",
    "creep": "change of the settled height: difference of speeds, % of √(g r)",
    "penetration": "penetration at rest, mean over contacts, % of r",
    "penetration_95": "penetration at rest, 95th percentile over contacts, % of r",
    "penetration_max": "deepest penetration after any step, mean over seeds, % of r",
    "restlessness": "rms speed at rest above the reference's, % of √(g r)",
    "contacts": "contacts per circle at rest, gap below 0.1 % of r: difference",
    "forces": "distribution of λ_n / mean λ_n at rest: Kolmogorov-Smirnov distance, %",
    "impact": "largest mean force on the box over an interval: difference, % of the reference's",
}
"""Name of an error -> its definition and unit. ⟨ ⟩ is the mean over seeds, * marks the reference.

Penetrations are errors in themselves, since they should be 0. All other errors are differences from the reference.
Energy, height and force are those of the whole pile. The force follows from the pile's momentum: M (g + dv / dt), where
v is the velocity of its centre of mass against gravity. It is divided by the weight, so that its mean at rest is
exactly 1.

Two errors are extremes over a run. Penetration is read after each step of an engine, also after each substep of ours,
so that a setting with a small step is read more often. A force cannot be read like this: a force that stops a circle
within one step is the momentum over that step, so that it grows without limit as the step shrinks. So forces are means
over windows of one length for all settings and engines: the time between two observations. A window begins at every
multiple of the scene's Δt.

The distribution of forces is the classical characteristic of a granular packing (Radjai et al., Phys. Rev.
Lett. 77, 1996). Users judge an engine by penetration and restlessness (Catto, Solver2D, 2024).
"""


class Reading(NamedTuple):
    """A state of a run, and what a watch has seen since the reading before, or since the start of the run.

    | field    | meaning                                                                             | shape    | unit |
    |----------|-------------------------------------------------------------------------------------|----------|------|
    | state    | state with contacts                                                                 |          |      |
    | deepest  | deepest penetration, from the reading before to this one, after any step, or        | ()       | m    |
    |          | substep of ours                                                                     |          |      |
    | velocity | velocity of the centre of mass of the free circles, at the reading before and after | (k+1, 2) | m/s  |
    |          | each of k steps since then                                                          |          |      |
    | step     | duration of one of these steps                                                      | ()       | s    |
    """

    state: State
    deepest: float
    velocity: np.ndarray
    step: float


@by_value
class Observation(NamedTuple):
    """Observations of one run, at T equally spaced times.

    | field       | meaning                                                                       | shape    | unit    |
    |-------------|-------------------------------------------------------------------------------|----------|---------|
    | kinetic     | kinetic energy                                                                | (T,)     | M u²    |
    | height      | height of the centre of mass above the lowest corner of the box               | (T,)     | r       |
    | speed       | root mean square speed of the circles                                         | (T,)     | u       |
    | penetration | mean and 95th percentile over the contacts; deepest since the time before     | (T, 3)   | r       |
    | contacts    | number of pairs whose gap is at most `TOUCHING`, per circle                   | (T,)     | –       |
    | force       | largest mean force on the box along gravity over an interval that ends since  | (T,)     | M g     |
    |             | the time before; None if g = 0                                                |          |         |
    | loads       | share of the λ_n > 0 at rest that are at most LOADS times their mean; or None | (121,)   | –       |
    | interval    | time between two observations                                                 | ()       | r / u   |
    | quantities  | name -> values of a user's quantity, or a sentence on why it has none         | (T, …)   | its own |

    M is the total mass, r the mean radius, and u = √(g r). Without gravity u is a tenth of the fastest circle's speed
    at the first time, and the height is 0. `loads` is None if no contact at rest has an impulse.
    """

    kinetic: np.ndarray
    height: np.ndarray
    speed: np.ndarray
    penetration: np.ndarray
    contacts: np.ndarray
    force: np.ndarray | None
    loads: np.ndarray | None
    interval: float
    quantities: dict[str, np.ndarray | str]


def observation(stored: Mapping) -> Observation:
    """Return the `Observation` whose fields were stored as lists in JSON."""
    arrays = {name: np.array(of) if isinstance(of, list) else of for name, of in stored.items()}
    own = {name: of if isinstance(of, str) else np.array(of) for name, of in stored["quantities"].items()}
    return Observation(**arrays | {"quantities": own})


def observe(
    readings: Iterable[Reading], quantities: Mapping[str, Callable[[State], object]] = MappingProxyType({})
) -> Observation:
    """Return the `Observation` of a run from its readings.

    readings: readings at equally spaced times (`watched.readings_of`). quantities: name -> function of a state that
    returns a number or an array. The impulses of a state are those that it carries from the step before. Raises
    ValueError with fewer than `REST` readings, and if there is neither gravity nor motion.
    """
    rows, forces, loads, times, unit, rising = [], [], [], [], None, np.empty(0)
    own: dict[str, list | str] = {name: [] for name in quantities}
    for state, deepest, velocity, step in readings:
        own = {name: with_next(name, quantity, state, own[name]) for name, quantity in quantities.items()}
        bodies = state.bodies._replace(mass=state.bodies.free_mass)
        g, r, mass = float(np.hypot(*state.world.gravity)), float(bodies.radius.mean()), float(bodies.mass.sum())
        up, low, high = -np.array(state.world.gravity) / (g or 1.0), state.world.box[:2], state.world.box[2:]
        squares = (bodies.velocity**2).sum(axis=1)
        unit = unit or math.sqrt(g * r) or math.sqrt(squares.max()) / FASTEST
        if unit == 0:
            raise ValueError("readings: expected gravity or motion, by which errors of a run are scaled, got none")
        kinetic = 0.5 * (bodies.mass @ squares + bodies.inertia @ bodies.spin**2) / (mass * unit**2)
        height = (bodies.mass @ bodies.position @ up / mass - np.minimum(up * low, up * high).sum()) / r
        speed = np.sqrt(squares.mean()) / unit
        depth = np.maximum(0.0, -state.contacts.separation) / r
        deep = (depth.mean(), np.percentile(depth, 95)) if depth.size else (0.0, 0.0)
        touching = np.count_nonzero(state.contacts.separation <= TOUCHING * r) / bodies.count
        rows.append((kinetic, height, speed, *deep, max(deepest / r, depth.max(initial=0.0)), touching))
        if g:
            rising, steps = np.concatenate([rising[:-1], velocity @ up]), len(velocity) - 1
            forces.append(1.0 + (rising[steps:] - rising[:-steps]).max() / (g * steps * step))
            rising = rising[-steps:]
        impulses = state.contacts.normal_start
        loads.append(impulses[impulses > 0])
        times.append(state.time * unit / r)
    if len(rows) < REST:
        raise ValueError(f"readings: expected at least {REST}, got {len(rows)}")
    table = np.array(rows)
    interval = (times[-1] - times[0]) / (len(times) - 1)
    force = np.array(forces) if g else None
    at_rest = np.concatenate([found / found.mean() for found in loads[-REST:] if found.size] or [np.empty(0)])
    known = np.searchsorted(np.sort(at_rest), LOADS, side="right") / at_rest.size if at_rest.size else None
    values = {name: seen if isinstance(seen, str) else np.array(seen) for name, seen in own.items()}
    return Observation(*table[:, :3].T, table[:, 3:6], table[:, 6], force, known, interval, values)


def with_next(name: str, quantity: Callable, state: State, before: list | str) -> list | str:
    """Return the values of a quantity for all states up to this one, or a sentence on what is wrong with a value.

    before: the values for the earlier states; or such a sentence, which is returned as it is.
    """
    if isinstance(before, str):
        return before
    where = f"quantities[{name!r}] at t = {state.time:.3g} s: expected"
    try:
        value = np.asarray(quantity(state), float)
    except Exception as error:
        return f"{where} a number or an array, got {type(error).__name__}: {error}"
    if not (value.size and (np.abs(value) <= LARGEST).all()):
        return f"{where} finite numbers up to {LARGEST:g}, got {brief(value.tolist())}"
    if before and before[0].shape != value.shape:
        return f"{where} the shape that it had before, {before[0].shape}, got {value.shape}"
    return [*before, value]


def errors(found: Sequence[Observation], reference: Sequence[Observation]) -> dict[str, float | None]:
    """Return the `ERRORS` of an ensemble of runs against a reference ensemble. Unknown errors are None.

    found, reference: observations of runs of the same scenes, one a seed.

    A quantity q of the user has two errors, relative to the reference's size. "q" is the error of the mean curve, Σ
    |⟨q⟩ − ⟨q⟩*| / Σ |⟨q⟩*|. "q spread" compares the means of q over a run: it is the Wasserstein distance between their
    distributions over seeds. Both errors are absolute if the reference is 0.

    Without gravity nothing comes to rest, so only the energy and the deepest penetration are known. A relative error is
    also unknown if the reference is 0, such as the energy of circles that never move.
    """
    mean, true = _means(found), _means(reference)
    at_rest = slice(-REST, None)

    def creep(means):
        """Return the slope of the straight line through the settled heights, in √(g r)."""
        return np.polyfit(reference[0].interval * np.arange(REST), means["height"][at_rest], 1)[0]

    def share(difference, whole):
        return difference / abs(whole) if whole else None

    height = true["height"][at_rest].mean()
    values = {
        "energy": share(np.abs(mean["kinetic"] - true["kinetic"]).sum(), true["kinetic"].sum()),
        "height": share(abs(mean["height"][at_rest].mean() - height), height),
        "creep": abs(creep(mean) - creep(true)) if true["speed"][at_rest].mean() < SETTLED else None,
        "penetration": mean["penetration"][at_rest, 0].mean(),
        "penetration_95": mean["penetration"][at_rest, 1].mean(),
        "penetration_max": np.mean([one.penetration[:, 2].max() for one in found]),
        "restlessness": max(0.0, mean["speed"][at_rest].mean() - true["speed"][at_rest].mean()),
        "contacts": abs(mean["contacts"][at_rest].mean() - true["contacts"][at_rest].mean()),
        "forces": None if mean["loads"] is None else np.abs(mean["loads"] - true["loads"]).max(),
        "impact": None if true["peak"] is None else share(abs(mean["peak"] - true["peak"]), true["peak"]),
    }
    if true["peak"] is None:
        values |= dict.fromkeys(values.keys() - {"energy", "penetration_max"})
    in_units = {
        name: None if value is None else float(value) * (1.0 if name == "contacts" else 100.0)
        for name, value in values.items()
    }
    return in_units | _of_quantities(found, reference)


def _of_quantities(found: Sequence[Observation], reference: Sequence[Observation]) -> dict[str, float | None]:
    values: dict = {}
    for name in reference[0].quantities:
        curves, true = ([run.quantities[name] for run in runs] for runs in (found, reference))
        values |= {name: None, f"{name} spread": None}
        if any(isinstance(one, str) for one in (*curves, *true)) or curves[0].shape != true[0].shape:
            continue
        size = float(np.abs(np.mean(true, axis=0)).sum()) or float(true[0].size)
        values[name] = float(np.abs(np.mean(curves, axis=0) - np.mean(true, axis=0)).sum()) / size
        means, true_means = (np.sort([one.mean() for one in runs]) for runs in (curves, true))
        values[f"{name} spread"] = float(np.abs(means - true_means).mean()) * true[0].size / size
    return values


def intervals(
    found: Sequence[Observation], reference: Sequence[Observation], *, resamples: int = 400
) -> dict[str, tuple[float, float, float] | None]:
    """Return each error with its confidence interval: name -> (value, low, high), or None for an unknown error.

    `errors` defines the errors, `interval` the intervals. Each resampling draws the same seeds for both ensembles.
    Raises ValueError if the ensembles differ in length.
    """
    if len(found) != len(reference):
        raise ValueError(f"found: expected {len(reference)} runs, as the reference has, got {len(found)}")
    values = errors(found, reference)
    known = [name for name, value in values.items() if value is not None]

    def of_seeds(drawn):
        pairs = (([found[i] for i in row], [reference[i] for i in row]) for row in drawn)
        resampled = [errors(*pair) for pair in pairs]
        # An error that is unknown in a resampling, such as that of settled heights, is that of the whole ensemble.
        return np.array([[values[n] if one[n] is None else one[n] for n in known] for one in resampled], float)

    three = interval(of_seeds, len(found), resamples=resamples).T.tolist()
    return dict.fromkeys(values) | {name: tuple(numbers) for name, numbers in zip(known, three)}


def _means(runs: Sequence[Observation]) -> dict:
    """Return the mean curves of an ensemble by name, its mean peak of the force, and its mean `loads`."""
    names = ("kinetic", "height", "speed", "penetration", "contacts")
    means = {name: np.mean([getattr(run, name) for run in runs], axis=0) for name in names}
    known = all(run.loads is not None for run in runs)
    means["peak"] = None if runs[0].force is None else np.mean([run.force.max() for run in runs])
    return means | {"loads": np.mean([run.loads for run in runs], axis=0) if known else None}


def interval(statistic: Callable[[np.ndarray], np.ndarray], count: int, *, resamples: int = 2000) -> np.ndarray:
    """Return [value, low, high], (3, …): a statistic of scenes and its 95 % bootstrap interval.

    The interval is by percentiles (Efron 1979). statistic: function of the indices of drawn scenes, (rows, count), a
    row for each resampling. It returns (rows, …). count: number of scenes. With one scene, low and high are the value.
    """
    value = statistic(np.arange(count)[None])[0]
    if count == 1:
        return np.stack([value] * 3)
    bootstrap = stats.bootstrap(
        (np.arange(count),), lambda drawn, axis: np.moveaxis(statistic(np.atleast_2d(drawn)), 0, -1),
        vectorized=True, method="percentile", n_resamples=resamples, random_state=0,
    )  # fmt: skip
    return np.stack([value, *bootstrap.confidence_interval])


def with_reach(error: Sequence[float]) -> tuple[float, np.ndarray]:
    """Return the value of an error, and its distances to the lower and the upper end of its interval, (2, 1).

    error: (value, low, high) of `intervals`. A bootstrap interval by percentiles does not always contain the value. If
    the value lies beyond an end, the distance to this end is 0.
    """
    value, low, high = error
    return value, np.maximum([[value - low], [high - value]], 0.0)
