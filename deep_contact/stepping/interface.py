"""The interface of a solver: its options, and the registry of the settings and loops that belong to them.

A solver is one file: its options (a frozen dataclass, a subclass of `SolverOptions`, that tells its weakness and
source), its settings (a named tuple: the options as compiled code takes them), its loop, and one call of `register`.
The type of the settings picks the loop when the step is compiled, so that a run compiles no other solver and makes no
choice between steps. A solver from outside this package registers in the same way;
`tests/stepping/test_interface.py` has an example.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, fields
from typing import NamedTuple

from numba.extending import overload

from deep_contact.state import validation
from deep_contact.state.scales import FOLLOWS_SCENE, theta_tolerance
from deep_contact.state.state import State
from deep_contact.state.validation import expect, one_of, suggesting
from deep_contact.stepping.convergence import mark_divergence

MOST_SWEEPS = 10_000_000
"""Upper limit of the numbers of sweeps and of substeps. Each sweep stores its θ, 8 bytes."""


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """When the velocity sweeps of a solve end.

    sweeps: the most velocity sweeps of a solve.
    tolerance: the sweeps end once θ, the largest change of an impulse in the last sweep, N·s, is no larger. None sweeps
    to the end. "scene" takes 6e-5 N·s times the scene's m g Δt over the thesis's (`scales.theta_tolerance`).
    Raises ValueError naming the option and its value.
    """

    sweeps: int = 3000
    tolerance: float | str | None = FOLLOWS_SCENE

    def __post_init__(self):
        validation.integer("sweeps", self.sweeps, most=MOST_SWEEPS)
        if self.tolerance is not None and not (isinstance(self.tolerance, str) and self.tolerance == FOLLOWS_SCENE):
            validation.number("tolerance", self.tolerance, low=0)


@dataclass(frozen=True, kw_only=True)
class SolverOptions(SweepOptions):
    """The base of the options of every solver: `SweepOptions`, and how a time step is divided around its solves.

    position_sweeps: the most sweeps of position correction in a substep.
    substeps: the number of substeps of every step of a run. Each has sweeps and position sweeps of its own (Macklin et
    al., Small Steps in Physics Simulation, 2019). Contacts carry the impulses of the last substep times `substeps`, so
    that a start fits any division of Δt. Where `substeps` is a power of two, a run that is read back goes on bit for
    bit.
    most_substeps: the most substeps of a step in which something is about to hit, `substeps` times a power of two; by
    default `substeps`. A tolerance is that of the longest substep.
    approach: how far what hits may move in a substep, in mean radii. It decides the number of substeps up to
    `most_substeps` (`stepping.substeps`).
    slop: the penetration that position correction leaves alone, in units of the scene's (`scales`). With a small slop
    and one substep a pile may tremble; with a quarter, two substeps are enough.
    Raises ValueError naming the option and its value.
    """

    position_sweeps: int = 10
    substeps: int = 1
    most_substeps: int | None = None
    approach: float = 0.03
    slop: float = 1.0

    def __post_init__(self):
        super().__post_init__()
        validation.integer("position_sweeps", self.position_sweeps, most=MOST_SWEEPS)
        validation.integer("substeps", self.substeps, least=1, most=MOST_SWEEPS)
        if self.most_substeps is not None:
            most = validation.integer("most_substeps", self.most_substeps, least=self.substeps, most=MOST_SWEEPS)
            parts, rest = divmod(most, self.substeps)
            if rest or parts & (parts - 1):
                raise ValueError(f"most_substeps: expected {self.substeps} times a power of two, got {most}")
        validation.number("approach", self.approach, above=0)
        validation.number("slop", self.slop, low=0, high=100)

    @property
    def motion_parts(self) -> int:
        """The most parts into which motion divides each of the `substeps`: a power of two."""
        return 1 if self.most_substeps is None else self.most_substeps // self.substeps

    def for_state(self, state: State) -> SolverOptions:
        """The options with the tolerance of a substep in N·s, if it follows the scene."""
        if self.tolerance != FOLLOWS_SCENE:
            return self
        bodies = state.bodies
        solver = copy(self)  # not by `replace`, which would validate all options again
        tolerance_of_state = theta_tolerance(bodies.mass, bodies.radius, state.world.gravity, state.dt)
        object.__setattr__(solver, "tolerance", tolerance_of_state / self.substeps)
        return solver


class Loop(NamedTuple):
    """A compiled loop of sweeps, chosen by the type of its settings.

    settings: type, a NamedTuple with at least `tolerance`, the θ at which to stop, N·s; a negative one is never met.
    relax: compiled function (settings, rows, friction, solver_bodies, theta, workspace) -> number of sweeps. It works
    in place on `rows.impulse` and on the solver bodies, which stay v + M⁻¹ Jᵀ λ; writes the θ of each sweep; stops
    where `convergence.is_over` says so, at the latest after theta.shape[0] sweeps.
    workspace: compiled function (rows, solver_bodies) -> work arrays of `relax`, made once a run; or None.
    counts_relaxations: whether `relax` returns (sweeps, relaxations). If not, each sweep relaxes every contact once.
    """

    settings: type
    relax: Callable
    workspace: Callable | None = None
    counts_relaxations: bool = False


class Entry(NamedTuple):
    """A registered solver: see `register`."""

    settings: Callable
    advance: Callable | None

    @property
    def can_sleep(self) -> bool:
        """Whether islands can sleep in the steps of this solver."""
        return self.advance is None


METHODS: dict[str, type] = {}
"""Name in a state file -> options class."""

COMPILED_IN = """
import deep_contact.solvers
"""
"""The loops that `relax` calls are registered there, above this folder. The code cache takes the line for an import, so
that a step is compiled again once a loop has changed."""

_ENTRIES: dict[type, Entry] = {}
_LOOPS: dict[type, Loop] = {}


def register(options: type, settings: Callable, loops: tuple[Loop, ...], *, advance: Callable | None = None) -> None:
    """Make a solver known, under the name of its options.

    options: frozen dataclass, a subclass of `SolverOptions`. settings: function of the options -> NamedTuple of a type
    that one of the loops has. advance: function of the options -> function in place of `algorithm.advance`, for a step
    of its own, which always has tangent rows and puts nothing to sleep.
    Raises ValueError if another solver has that name, and where the options are not a subclass of `SolverOptions`.
    """
    expect(issubclass(options, SolverOptions), f"options: expected a subclass of SolverOptions, got {options.__name__}")
    if METHODS.setdefault(options.__name__, options) is not options:
        raise ValueError(f"options: expected a new name, got {options.__name__}, which is {METHODS[options.__name__]}")
    _ENTRIES[suggesting(options)] = Entry(settings, advance)
    for loop in loops:
        _LOOPS[loop.settings] = loop


def entry_of(solver) -> Entry:
    """The entry of a solver's options. Raises ValueError if these are not the options of a registered solver."""
    entry = _ENTRIES.get(type(solver))
    if entry is None:
        raise ValueError(
            f"solver: expected options such as PGS(sweeps=…), of one of {', '.join(METHODS)}, got {solver!r}"
        )
    return entry


def tolerance_argument(solver) -> float:
    """The tolerance as compiled functions take it: −1, which is never met, in place of None.

    Raises ValueError if the tolerance follows the scene: `for_state` gives the number.
    """
    if solver.tolerance == FOLLOWS_SCENE:
        raise ValueError(f"tolerance: expected a number or None, of solver.for_state(state), got {solver.tolerance!r}")
    return -1.0 if solver.tolerance is None else float(solver.tolerance)


def solver_from(method: str, options: Mapping):
    """The solver of a file, from its method and options.

    Old files name a precision, which is always double, threads, which change no bit, and `islands` of solvers that do
    not have it, which is always False.

    Raises ValueError for an unknown method, for an unknown option, and for values that the method refuses.
    """
    one_of("precision", options.get("precision", "double"), ("double",))
    known = {name: value for name, value in options.items() if name not in ("precision", "threads")}
    kind = METHODS[one_of("method", method, METHODS)]
    names = [field.name for field in fields(kind)]
    if known.get("islands") is False and "islands" not in names:
        del known["islands"]
    for name in known:
        one_of(f"option of {method}", name, names)
    return kind(**known)


def describe(solver) -> str:
    """The solver and the options that differ from the defaults, "NNCG(sweeps=20, tolerance=None)"."""
    changed = [f for f in fields(solver) if getattr(solver, f.name) != f.default]
    return f"{type(solver).__name__}({', '.join(f'{f.name}={getattr(solver, f.name)!r}' for f in changed)})"


def make_workspace(settings, rows, solver_bodies):
    """Work arrays of the loop for rows and solver bodies of this size; None if the loop needs none."""
    return _make_workspace(type(settings))(settings, rows, solver_bodies)


def relax(settings, rows, friction, solver_bodies, theta, workspace):
    """Relax all contacts, in place, by the loop of the settings. Returns (sweeps, relaxations).

    rows: `Rows`. friction: μ, or None for rows without tangents. solver_bodies: (N, 4). theta: buffer for the θ of
    each sweep; its length is the largest number of sweeps. workspace: of `make_workspace`.
    """
    return _relax(type(settings))(settings, rows, friction, solver_bodies, theta, workspace)


# Compiled callers resolve the two functions above by the type of the settings; Python callers, and everything under
# NUMBA_DISABLE_JIT=1, run them as they stand.
@overload(make_workspace)
def _overload_make_workspace(settings, rows, solver_bodies):
    return _make_workspace(settings.instance_class)


@overload(relax)
def _overload_relax(settings, rows, friction, solver_bodies, theta, workspace):
    return _relax(settings.instance_class)


def _make_workspace(settings_type):
    make = _LOOPS[settings_type].workspace
    if make is None:
        return lambda settings, rows, solver_bodies: None
    return lambda settings, rows, solver_bodies: make(rows, solver_bodies)


def _relax(settings_type):
    loop = _LOOPS[settings_type]
    relax_all = loop.relax
    if loop.counts_relaxations:

        def relax_contacts(settings, rows, friction, solver_bodies, theta, workspace):
            sweeps, relaxations = relax_all(settings, rows, friction, solver_bodies, theta, workspace)
            mark_divergence(solver_bodies, theta, sweeps)
            return sweeps, relaxations

    else:

        def relax_contacts(settings, rows, friction, solver_bodies, theta, workspace):
            sweeps = relax_all(settings, rows, friction, solver_bodies, theta, workspace)
            mark_divergence(solver_bodies, theta, sweeps)
            return sweeps, sweeps * rows.body.shape[0]

    return relax_contacts
