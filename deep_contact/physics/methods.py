"""The solvers a user can choose, as frozen options, each with what it is good for and where it fails.

What they do to a contact problem is in `relaxation` (all but `SoftSteps`) and `soft_steps`. How many sweeps each needs,
and what a sweep costs, is measured by `scripts/tradeoff.py` (data/reference/tradeoff.json).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from deep_contact import constants

PRECISIONS = {"double": np.float64, "single": np.float32}
"""Name -> type of the numbers that the sweeps work on. The state is float64 with either."""


@dataclass(frozen=True, kw_only=True)
class PGS:
    """Projected Gauss-Seidel, the thesis's Algorithm 1 with the friction row of Box2D beside every normal row.

    sweeps: at most so many velocity sweeps. tolerance: stop once θ (the largest change of an impulse in the last
    sweep, N·s) is no larger; None sweeps to the end. position_sweeps: at most so many sweeps of position correction.
    precision: of the rows and velocities in the sweeps, "double" or "single". islands: sweep each island on its own.

    It fails slowly, not badly: every sweep lowers the kinetic energy that is left to lose, but information travels
    one contact a sweep, so tall piles and large mass ratios need sweeps by the square of their height.
    With islands, circles that touch each other, directly or through others, are swept on their own and stop on their
    own, so that one impact does not keep piles at rest elsewhere iterating. It does not pay for one pile, nor without a
    tolerance, where it only sorts; the other methods are not offered with it.
    Single precision buys little: a sweep waits for the one operation that the next contact needs, not for memory
    (Figure 6.7). A tight tolerance is never met in it.
    """

    sweeps: int = 3000
    tolerance: float | None = constants.THETA_TOLERANCE
    position_sweeps: int = 10
    precision: str = "double"
    islands: bool = False

    def __post_init__(self):
        _check_counts(self, "sweeps", "position_sweeps")
        _check_precision(self)
        _check_flag(self, "islands")
        if self.islands and type(self) is not PGS:
            raise ValueError(f"islands: expected False, since {type(self).__name__} sweeps them together, got True")
        if self.tolerance is not None:
            _check_number(self, "tolerance", lambda x: x >= 0, "None or a finite number >= 0")


@dataclass(frozen=True, kw_only=True)
class BatchedPGS(PGS):
    """Projected Gauss-Seidel in batches of contacts that share no circle, eight at a time: for large scenes.

    order: "levels" keeps the order of the contacts, so that it is PGS up to rounding; "colours" changes it (see
    `deep_contact.physics.colours`). threads: at most so many, for "colours" only; they change no bit of the result.
    The other options are those of `PGS`. Position correction goes in the same batches.

    It costs a third of PGS a sweep, and some nanoseconds a contact and step to find the batches, so it pays from a
    handful of sweeps on. Where contacts hang in a chain, as in a column, a level is one contact and a tile of eight is
    wasted on it. Colouring is less hurt by that, but its order takes other ways than the numbering of the circles.
    """

    order: str = "levels"
    threads: int = 1

    def __post_init__(self):
        super().__post_init__()
        if self.order not in ORDERS:
            raise ValueError(f"order: expected one of {', '.join(ORDERS)}, got {self.order!r}")
        _check_counts(self, "threads", least=1)
        if self.threads > 1 and self.order != "colours":
            raise ValueError(f"threads: expected 1 with order={self.order!r}, got {self.threads}")


ORDERS = ("levels", "colours")
"""Ways to put contacts into batches."""


@dataclass(frozen=True, kw_only=True)
class PSOR(PGS):
    """Projected successive over-relaxation: PGS with every change of an impulse multiplied by ω.

    omega: ω, between 0 and 2; with `adaptive`, the one to start with. adaptive: follow the measured rate of
    convergence (Hageman and Young, Applied Iterative Methods, 1981, chapter 9). The other options are those of `PGS`.

    Without friction it converges for every 0 < ω < 2 (Cottle, Pang and Stone, The Linear Complementarity Problem,
    1992, section 5.3), which is why others are refused. With friction nothing is proven: the bounds ±μ λ_n move as
    λ_n overshoots, and from ω of about 1.5 on single contacts flip between sticking and slipping for ever, so θ
    stalls above a tight tolerance. At a few sweeps it is no better than PGS: over-relaxing pays in the slow modes.
    Adaptive ω cannot know more than θ shows, and lags behind where contacts keep opening and closing.
    """

    omega: float = 1.3
    adaptive: bool = False

    def __post_init__(self):
        super().__post_init__()
        _check_number(self, "omega", lambda x: 0 < x < 2, "a number between 0 and 2")
        _check_flag(self, "adaptive")


@dataclass(frozen=True, kw_only=True)
class SymmetricPGS(PGS):
    """Projected Gauss-Seidel with sweeps forwards and backwards by turns (Aitken's double sweep). Options of `PGS`.

    Each direction counts as one sweep. The result depends less on the order of the contacts, and a pile that is
    numbered against the way its weight travels is not at a disadvantage. It needs more sweeps in all than PGS: the
    rows relaxed last in one sweep come first in the next, when there is nothing left to do for them.
    """


@dataclass(frozen=True, kw_only=True)
class NNCG(PGS):
    """Nonsmooth nonlinear conjugate gradient on PGS (Silcowitz, Niebe and Erleben, The Visual Computer 26, 2010).

    Options of `PGS`. Each sweep's change is taken for a descent direction, and the directions are combined as by
    Fletcher and Reeves.

    Its θ does not fall with every sweep: a budget of a handful of sweeps may end on a bad one, where PGS is the safer
    choice. What it combines assumes that the set of sticking, slipping and open contacts stands still; while a pile
    is falling apart it restarts often and is PGS at a higher price. With friction convergence is not proven.
    """


@dataclass(frozen=True, kw_only=True)
class NesterovPGS(PGS):
    """Projected Gauss-Seidel with Nesterov's momentum (Soviet Mathematics Doklady 27, 1983), restarted by the gradient
    scheme of O'Donoghue and Candès (Foundations of Computational Mathematics 15, 2015) and bound where it shakes.

    Options of `PGS`. Each sweep starts ahead of where the last one ended, on the way that it took.

    The momentum is bound by what the last sweeps were seen to do, so it learns late where contacts open and slip: for
    some sweeps the error may grow. A budget of less than ten sweeps gains little. With friction convergence is not
    proven, and θ does not fall with every sweep.
    """


@dataclass(frozen=True, kw_only=True)
class APGD(PGS):
    """Accelerated projected gradient descent (Nesterov; Mazhar, Heyn, Negrut and Tasora, ACM Transactions on Graphics
    34, 2015), with backtracking and restarts. Options of `PGS`; a "sweep" is one evaluation of the gradient.

    It relaxes all rows from the same velocities, so it is the one method here whose result does not depend on the
    order of the contacts. The paper minimises a convex problem, in which a sliding contact is pushed apart at
    μ times its slip; here the bounds of friction follow the normal impulse, so that it solves the problem that the
    other methods solve, at the price of its proof: with friction the function it descends on changes under its feet.
    It shines to tight tolerances without friction and is the worst choice for few sweeps: early on a gradient step,
    shortened to what the busiest circle can bear, does less than a sweep of PGS.
    """


@dataclass(frozen=True, kw_only=True)
class SoftSteps:
    """Sub-stepped soft contacts, as Box2D v3 solves them (E. Catto, Solver2D, 2024): many small steps, two sweeps each.

    substeps: parts of a time step, each of which integrates gravity, sweeps once with contacts that push out of
    penetration as a damped spring, moves the bodies, and sweeps once without the spring so that its push leaves no
    velocity behind. hertz: frequency of the spring, Hz, cut to a quarter of the substeps a second; walls are twice as
    stiff. damping_ratio: of the spring, 1 is critical. push_speed: penetration is worked off no faster than this, m/s.
    precision: as in `PGS`. There are no position sweeps and no tolerance: the work is always the same.

    It fails by being soft: a solution of the rigid contact problem is not what it converges to, so it is judged by
    whole runs (penetration, height, energy), not by the velocity error of one step. Weight on a deep pile is found at
    one contact a sweep, so tall or heavy piles sink into each other before they find support and mass ratios above
    about ten show. Contacts are found once a step: what meets within it is felt at its end. Impulses are reported as
    the last substep's times `substeps`, which is the step's impulse in a pile at rest and not in an impact.
    """

    substeps: int = 4
    hertz: float = 30.0
    damping_ratio: float = 10.0
    push_speed: float = 3.0
    precision: str = "double"

    def __post_init__(self):
        _check_counts(self, "substeps", least=1)
        for name in ("hertz", "damping_ratio", "push_speed"):
            _check_number(self, name, lambda x: x > 0, "a finite number > 0")
        _check_precision(self)

    @property
    def sweeps(self) -> int:
        """Sweeps a step: two in each substep."""
        return 2 * self.substeps

    @property
    def tolerance(self) -> None:
        """None: it never stops early."""
        return None

    @property
    def position_sweeps(self) -> int:
        """0: the springs correct positions."""
        return 0


_ALL = (PGS, BatchedPGS, PSOR, SymmetricPGS, NNCG, NesterovPGS, APGD, SoftSteps)
METHODS = {method.__name__: method for method in _ALL}
"""Name in a state file -> options class."""


def tolerance_argument(solver) -> float:
    """The tolerance as the compiled functions take it: a negative one is never met."""
    return -1.0 if solver.tolerance is None else float(solver.tolerance)


def check_solver(solver) -> None:
    """Raise ValueError if these are not the options of a known method."""
    if type(solver) not in METHODS.values():
        raise ValueError(
            f"solver: expected options such as PGS(sweeps=…), of one of {', '.join(METHODS)}, got {solver!r}"
        )


def describe(solver) -> str:
    """The method and what its options change of the default ones, "NNCG(sweeps=20, tolerance=None)"."""
    changed = [f for f in fields(solver) if getattr(solver, f.name) != f.default]
    return f"{type(solver).__name__}({', '.join(f'{f.name}={getattr(solver, f.name)!r}' for f in changed)})"


MOST_SWEEPS = 10_000_000
"""Upper limit of every count: the θ of each sweep is kept, which takes 8 bytes."""


def _check_counts(solver, *names: str, least: int = 0) -> None:
    for name in names:
        value = getattr(solver, name)
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise ValueError(f"{name}: expected an integer >= {least}, got {value!r}")
        if value > MOST_SWEEPS:
            raise ValueError(f"{name}: expected an integer <= {MOST_SWEEPS}, got {value!r}")


def _check_flag(solver, name: str) -> None:
    value = getattr(solver, name)
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name}: expected True or False, got {value!r}")


def _check_number(solver, name: str, fits, expected: str) -> None:
    value = getattr(solver, name)
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not (number and np.isfinite(value) and fits(value)):
        raise ValueError(f"{name}: expected {expected}, got {value!r}")


def _check_precision(solver) -> None:
    if solver.precision not in PRECISIONS:
        raise ValueError(f"precision: expected one of {', '.join(PRECISIONS)}, got {solver.precision!r}")
