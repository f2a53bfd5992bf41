"""How accurate a single step is, and the fastest way there: a diagnostic, for those who study solvers.

What a user sees of a run is another matter: `recommendation.runs`. The settings are read from what
`scripts/tradeoff.py --install` measured: velocity errors of single steps (`physics.metrics.nearest_velocity_error`) on
falling, settling and resting piles of equal circles.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deep_contact.physics.solvers import METHODS, describe
from deep_contact.reporting import results
from deep_contact.state import State

TABLE = Path(__file__).parents[1] / "reference" / "tradeoff.json"
"""The study's results file, shipped with the package."""

NEAR = 1.5
"""An error is near to the least one of the study where it is at most so many times as large."""


@dataclass(frozen=True, kw_only=True)
class StepRecommendation:
    """A solver and a start for a scene, what they cost, and what that was measured on. `print` tells all of it.

    solver: options of `physics.solvers`. warm_start: name of the start. velocity_error: asked for, relative.
    measured: the worst 95th percentile of the velocity error over the kinds of piles. us: mean time of a step, μs, of
    the pile of the study nearest in size, n_bodies circles, on the processor `cpu`. by_kind: kind of pile -> (median,
    95th percentile of the velocity error, mean sweeps, μs a step). states: how many it was measured on.
    margin: how many times smaller than asked the measured error has to be.
    reached: whether it is; if not, this is the fastest setting measured that comes near to the least error (`NEAR`).
    """

    solver: object
    warm_start: str
    velocity_error: float
    measured: float
    us: float
    n_bodies: int
    cpu: str
    by_kind: dict
    states: int
    margin: float
    reached: bool

    def __str__(self) -> str:
        first = f"{describe(self.solver)} from {self.warm_start}"
        if not self.reached:
            first += f": near to the most accurate of the study, which does not reach {self.velocity_error:g}"
        lines = [first, f"  velocity error of a step in 95 % of states: {self.measured:.2g}"]
        lines.append(f"  asked for: {self.velocity_error:g} (relative, in the norm of kinetic energy)")
        if self.margin > 1:
            lines[-1] += f", with a margin of {self.margin:g} for scenes outside the study"
        lines.append(f"  cost: {self.us:,.0f} μs a step of {self.n_bodies:,} circles")
        for kind, (median, worst, sweeps, us) in self.by_kind.items():
            lines.append(
                f"    {kind:9s} error {median:.1e} (median), {worst:.1e} (95 %); {sweeps:.0f} sweeps, {us:,.0f} μs"
            )
        lines.append(f"  measured on {self.states} states of piles of equal circles, Δt = 0.01 s; {self.cpu}")
        return "\n".join(lines)


def recommend_step(scene: State, *, velocity_error: float, table: Mapping | None = None) -> StepRecommendation:
    """The fastest setting that was measured to keep the velocity error of a step within the one asked for.

    scene: a `State`; its number of circles picks the piles of the study nearest in size (by ratio), and its mean mass,
    gravity and Δt scale the tolerance. velocity_error: relative, see `physics.metrics.nearest_velocity_error`; it holds
    for 95 % of the states of each kind of pile, divided by the study's margin, where it has one: that with which it
    was met in 95 % of the states of other scenes too (`scripts/tradeoff.py --verify --install`).
    table: results of `scripts/tradeoff.py`; by default the ones in the package.
    Radii that differ widely, mass ratios and tall columns make a scene harder than the piles of the study.
    Raises ValueError on a velocity error out of (0, 1] and FileNotFoundError where no study has been installed.
    """
    number = isinstance(velocity_error, (int, float, np.number)) and not isinstance(velocity_error, bool)
    if not (number and 0 < velocity_error <= 1):
        raise ValueError(f"velocity_error: expected a number above 0, up to 1, got {velocity_error!r}")
    study = table if table is not None else installed_study()
    rows = study["data"]["rows"]
    sizes = sorted({row["n_bodies"] for row in rows})
    nearest = min(sizes, key=lambda n: abs(np.log(n / scene.bodies.count)))
    candidates = _candidates([row for row in rows if row["n_bodies"] == nearest])
    margin = study["data"].get("margin", 1.0)
    within = [found for found in candidates if found["worst"] * margin <= velocity_error]
    chosen = min(within or _nearly(candidates, velocity_error), key=lambda found: found["us"])
    return _recommendation(chosen, scene, float(velocity_error), nearest, study, bool(within))


def solver_of(setting: dict, **budget):
    """Options of a setting's method with a budget: sweeps and tolerance (N·s)."""
    options = {name: value for name, value in setting.items() if name not in ("method", "start")}
    return METHODS[setting["method"]](**options, **budget)


def weight_impulse(state: State) -> float:
    """m g Δt of the mean circle, N·s; without gravity, with the g that moves it by 1e-4 of its radius in Δt."""
    gravity = float(np.hypot(*state.world.gravity)) or 1e-4 * float(state.bodies.radius.mean()) / state.dt**2
    return float(state.bodies.mass.mean()) * gravity * state.dt


@functools.cache
def installed_study() -> dict:
    """The results file in the package, checked. Raises FileNotFoundError saying how it is made."""
    if not TABLE.exists():
        raise FileNotFoundError(
            f"{TABLE.parent.name}/{TABLE.name}: expected the study's results in the package, got no file; "
            "run scripts/tradeoff.py --install"
        )
    return results.read_results(TABLE)


def _nearly(candidates: list[dict], velocity_error: float) -> list[dict]:
    """Those `NEAR` the most accurate; of these, if there are any, those that keep the error in half of the states.

    The last states that resist decide about the least error, and ten times the sweeps do little about them.
    """
    least = min(found["worst"] for found in candidates)
    near = [found for found in candidates if found["worst"] <= NEAR * least]
    return [found for found in near if found["median"] <= velocity_error] or near


def _candidates(rows: list[dict]) -> list[dict]:
    """Setting and budget with their rows of all kinds, the worst of their errors and the mean time over the kinds."""
    kinds = {row["kind"] for row in rows}
    groups: dict = {}
    for row in rows:
        budget = row["budget"]
        groups.setdefault((row["setting"], budget["sweeps"], budget["tolerance"]), {})[row["kind"]] = row
    return [
        {
            "rows": found,
            "worst": max(row["velocity"]["p95"] for row in found.values()),
            "median": max(row["velocity"]["p50"] for row in found.values()),
            "us": float(np.mean([row["us"] for row in found.values()])),
        }
        for found in groups.values()
        if found.keys() == kinds
    ]


def _recommendation(
    chosen, scene: State, asked: float, nearest: int, study: Mapping, reached: bool
) -> StepRecommendation:
    first = next(iter(chosen["rows"].values()))
    setting = study["data"]["settings"][first["setting"]]
    if setting["method"] not in METHODS:
        raise ValueError(f"table: expected a method of {', '.join(METHODS)}, got {setting['method']!r}")
    tolerance = first["budget"]["tolerance"]
    absolute = None if tolerance is None else tolerance * weight_impulse(scene)
    return StepRecommendation(
        solver=solver_of(setting, sweeps=first["budget"]["sweeps"], tolerance=absolute),
        warm_start=setting.get("start", "builtin"),
        velocity_error=asked,
        measured=chosen["worst"],
        us=chosen["us"],
        n_bodies=nearest,
        cpu=study["provenance"]["cpu"],
        by_kind={
            kind: (row["velocity"]["p50"], row["velocity"]["p95"], row["sweeps"], row["us"])
            for kind, row in chosen["rows"].items()
        },
        states=sum(row["states"] for row in chosen["rows"].values()),
        margin=study["data"].get("margin", 1.0),
        reached=reached,
    )
