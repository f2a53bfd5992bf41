"""Errors of a run: what a user sees of a pile that falls, hits the floor and comes to rest.

A pile is chaotic: two runs part after a second, whatever the solver. What is compared are means and distributions over
ensembles of seeds, with bootstrap intervals. The reference is the limit of small steps (`studies.runs`).

Lengths are in mean radii r, times in √(r / g), so speeds in √(g r): the numbers are the same at every scale. At
r = 1 m, √(r / g) is 0.32 s and √(g r) is 3.1 m/s.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from deep_contact.state import State

LOADS = np.linspace(0.0, 6.0, 121)
"""Where the distribution of λ_n / mean λ_n is kept."""

REST = 20
"""The last so many observations are those at rest."""

TOUCHING = 1e-3
"""Gap, in radii, below which two circles count as in contact: rigid ones that touch have a gap of 0."""

ERRORS = {
    "energy": "kinetic-energy curve: Σ |⟨E_k⟩ − ⟨E_k⟩*| / Σ ⟨E_k⟩* over the whole run, %",
    "height": "settled height of the centre of mass: difference, % of the reference's",
    "creep": "change of the settled height: difference of speeds, % of √(g r)",
    "penetration": "penetration at rest, mean over contacts, % of r",
    "penetration_95": "penetration at rest, 95th percentile over contacts, % of r",
    "penetration_max": "deepest penetration at any time, mean over seeds, % of r",
    "restlessness": "rms speed at rest above the reference's, % of √(g r)",
    "contacts": "contacts per circle at rest, gap below 0.1 % of r: difference",
    "forces": "distribution of λ_n / mean λ_n at rest: Kolmogorov-Smirnov distance, %",
    "impact": "largest force on the box in an interval: difference, % of the reference's",
}
"""Name -> what it is, and its unit. All but the penetrations, which should be 0, are against the reference.

Energy, height and force are those of the whole pile (the force from its momentum: M (g + dv_y / dt), in weights; its
mean at rest is 1, exactly). The distribution of forces is the classical fingerprint of a granular packing (Radjai et
al., Phys. Rev. Lett. 77, 1996); penetration and restlessness are what engine users look at (Catto, Solver2D, 2024).
"""


class Observation(NamedTuple):
    """What is looked at of one run, at T equally spaced times.

    | field       | meaning                                                                    | shape    | unit    |
    |-------------|----------------------------------------------------------------------------|----------|---------|
    | kinetic     | kinetic energy                                                             | (T,)     | M g r   |
    | height      | of the centre of mass above the floor                                      | (T,)     | r       |
    | speed       | root mean square over the circles                                          | (T,)     | √(g r)  |
    | penetration | mean, 95th percentile and largest over the contacts                        | (T, 3)   | r       |
    | contacts    | pairs whose gap is below `TOUCHING`, per circle                            | (T,)     | –       |
    | force       | mean vertical force on the box since the time before                       | (T − 1,) | M g     |
    | loads       | share of the λ_n > 0 at rest that are at most LOADS · mean; None if unknown | (121,)   | –       |
    | interval    | between two times                                                          | ()       | √(r/g)  |
    """

    kinetic: np.ndarray
    height: np.ndarray
    speed: np.ndarray
    penetration: np.ndarray
    contacts: np.ndarray
    force: np.ndarray
    loads: np.ndarray | None
    interval: float


def observe(states: Iterable[State]) -> Observation:
    """What is looked at of a run: of its states, with contacts, at equally spaced times (a `Trajectory` has them).

    Impulses are those that unsolved states carry. Raises ValueError without gravity, or with fewer than `REST` states.
    """
    rows, momentum, loads, times = [], [], [], []
    for state in states:
        bodies = state.bodies
        g, r, mass = float(np.hypot(*state.world.gravity)), float(bodies.radius.mean()), float(bodies.mass.sum())
        if g == 0:
            raise ValueError("states: expected gravity, by which errors of a run are scaled, got none")
        squares = (bodies.velocity**2).sum(axis=1)
        kinetic = 0.5 * (bodies.mass @ squares + bodies.inertia @ bodies.spin**2) / (mass * g * r)
        height = (bodies.mass @ bodies.position[:, 1] / mass - state.world.box[1]) / r
        speed = np.sqrt(squares.mean() / (g * r))
        depth = np.maximum(0.0, -state.contacts.separation) / r
        deep = (depth.mean(), np.percentile(depth, 95), depth.max()) if depth.size else (0.0, 0.0, 0.0)
        touching = np.count_nonzero(state.contacts.separation <= TOUCHING * r) / bodies.count
        rows.append((kinetic, height, speed, *deep, touching))
        momentum.append(bodies.mass @ bodies.velocity[:, 1] / mass / np.sqrt(g * r))
        impulses = state.contacts.normal_start
        loads.append(impulses[impulses > 0])
        times.append(state.time / np.sqrt(r / g))
    if len(rows) < REST:
        raise ValueError(f"states: expected at least {REST}, got {len(rows)}")
    table = np.array(rows)
    interval = (times[-1] - times[0]) / (len(times) - 1)
    force = 1.0 + np.diff(momentum) / interval
    at_rest = np.concatenate([found / found.mean() for found in loads[-REST:] if found.size] or [np.empty(0)])
    known = np.searchsorted(np.sort(at_rest), LOADS, side="right") / at_rest.size if at_rest.size else None
    return Observation(table[:, 0], table[:, 1], table[:, 2], table[:, 3:6], table[:, 6], force, known, interval)


def errors(found: Sequence[Observation], reference: Sequence[Observation]) -> dict[str, float | None]:
    """The `ERRORS` of an ensemble against the reference's ensemble of the same scenes; None for an unknown one."""
    mean, true = _means(found), _means(reference)
    at_rest = slice(-REST, None)
    interval = reference[0].interval
    values = {
        "energy": np.abs(mean["kinetic"] - true["kinetic"]).sum() / true["kinetic"].sum(),
        "height": abs(mean["height"][at_rest].mean() / true["height"][at_rest].mean() - 1),
        "creep": abs(_slope(mean["height"][at_rest], interval) - _slope(true["height"][at_rest], interval)),
        "penetration": mean["penetration"][at_rest, 0].mean(),
        "penetration_95": mean["penetration"][at_rest, 1].mean(),
        "penetration_max": np.mean([one.penetration[:, 2].max() for one in found]),
        "restlessness": max(0.0, mean["speed"][at_rest].mean() - true["speed"][at_rest].mean()),
        "contacts": abs(mean["contacts"][at_rest].mean() - true["contacts"][at_rest].mean()),
        "forces": None if mean["loads"] is None else np.abs(mean["loads"] - true["loads"]).max(),
        "impact": abs(_peak(found) / _peak(reference) - 1),
    }
    return {
        name: None if value is None else float(value) * (1.0 if name == "contacts" else 100.0)
        for name, value in values.items()
    }


def intervals(
    found: Sequence[Observation], reference: Sequence[Observation], *, resamples: int = 400, level: float = 0.95
) -> dict[str, tuple[float, float, float] | None]:
    """Each of the `errors` with its bootstrap interval: name -> (value, low, high), or None for an unknown one.

    The seeds are drawn with replacement, the same for both ensembles (Efron 1979; percentile interval). Raises
    ValueError where the ensembles differ in length.
    """
    if len(found) != len(reference):
        raise ValueError(f"found: expected {len(reference)} runs, as the reference has, got {len(found)}")
    rng = np.random.default_rng(0)
    values = errors(found, reference)
    drawn = rng.integers(len(found), size=(resamples, len(found)))
    samples = [errors([found[i] for i in row], [reference[i] for i in row]) for row in drawn]
    tails = 100 * (1 - level) / 2
    return {
        name: None
        if value is None
        else (value, *(float(q) for q in np.percentile([one[name] for one in samples], (tails, 100 - tails))))
        for name, value in values.items()
    }


def _means(runs: Sequence[Observation]) -> dict:
    """Mean curves of an ensemble."""
    names = ("kinetic", "height", "speed", "penetration", "contacts")
    means = {name: np.mean([getattr(run, name) for run in runs], axis=0) for name in names}
    known = all(run.loads is not None for run in runs)
    return means | {"loads": np.mean([run.loads for run in runs], axis=0) if known else None}


def _slope(height: np.ndarray, interval: float) -> float:
    """Of the straight line through the settled heights, √(g r)."""
    return float(np.polyfit(interval * np.arange(height.size), height, 1)[0])


def _peak(runs: Sequence[Observation]) -> float:
    return float(np.mean([run.force.max() for run in runs]))
