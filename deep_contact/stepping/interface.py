"""The interface of a solver: its options, and the registry of solvers.

A solver is one file with four parts. Its options are a frozen dataclass, a subclass of `SolverOptions`, whose docstring
states the solver's weakness and source. Its settings are a NamedTuple: the options in the form for compiled code. The
third part is a loop of sweeps, and the fourth is one call of `register`. The type of the settings selects the loop when
the step is compiled. A run therefore compiles no other solver, and makes no choice between steps. A solver from outside
this package registers in the same way; `tests/stepping/test_interface.py` has an example.
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
    """Options that end the velocity sweeps of a solve.

    sweeps: largest number of velocity sweeps in a solve.
    tolerance: the sweeps end once θ, the largest change of an impulse in the last sweep, is at most this, N·s. With
    None all sweeps are done. With "scene" the tolerance is 6e-5 N·s times a factor: the scene's m g Δt over that of the
    thesis's scene (`scales.theta_tolerance`).
    Raises ValueError, which names the option and its value.
    """

    sweeps: int = 3000
    tolerance: float | str | None = FOLLOWS_SCENE

    def __post_init__(self):
        validation.integer("sweeps", self.sweeps, most=MOST_SWEEPS)
        if self.tolerance is not None and not (isinstance(self.tolerance, str) and self.tolerance == FOLLOWS_SCENE):
            validation.number("tolerance", self.tolerance, low=0)


@dataclass(frozen=True, kw_only=True)
class SolverOptions(SweepOptions):
    """The options that all solvers share: `SweepOptions`, position correction, and the division of a time step.

    position_sweeps: largest number of sweeps of position correction in a substep.
    substeps: number of substeps of every step of a run. Each substep has sweeps and position sweeps of its own (Macklin
    et al., Small Steps in Physics Simulation, 2019). Contacts store the impulses of the last substep times `substeps`,
    so that they fit as a start for any division of Δt. If `substeps` is a power of two, a run that is read back from a
    file goes on bit for bit.
    most_substeps: largest number of substeps of a step in which circles are about to collide, `substeps` times a power
    of two; by default `substeps`. A tolerance holds for the longest substep, and is not reduced for shorter ones.
    approach: largest displacement in a substep of a circle that is about to collide, in mean radii. The number of
    substeps follows from it, up to `most_substeps` (`stepping.substeps`).
    slop: penetration that position correction leaves, in units of the scene's slop (`scales`). With a small slop and
    one substep a pile may tremble; with a slop of a quarter, two substeps are enough.
    Raises ValueError, which names the option and its value.
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
        """Largest number of parts into which motion divides each of the `substeps`: a power of two."""
        return 1 if self.most_substeps is None else self.most_substeps // self.substeps

    def for_state(self, state: State) -> SolverOptions:
        """Return the options with a number in place of the tolerance "scene".

        The number is the tolerance of a substep in this state, N·s.
        """
        if self.tolerance != FOLLOWS_SCENE:
            return self
        bodies = state.bodies
        solver = copy(self)  # not by `replace`, which would validate all options again
        tolerance_of_state = theta_tolerance(bodies.mass, bodies.radius, state.world.gravity, state.dt)
        object.__setattr__(solver, "tolerance", tolerance_of_state / self.substeps)
        return solver


class Loop(NamedTuple):
    """A compiled loop of sweeps. The type of the settings selects it.

    settings: type, a NamedTuple with at least `tolerance`, the θ at which the sweeps end, N·s. A negative tolerance is
    never reached.
    relax: compiled function (settings, rows, friction, solver_bodies, theta, workspace) -> number of sweeps. It changes
    the impulses λ = `rows.impulse` and the velocities of the solver bodies in place. The velocities stay v⁻ + M⁻¹ Jᵀ λ,
    where v⁻ are those without impulses. `relax` writes θ of each sweep into `theta`. It ends if `convergence.is_over`
    is true, at the latest after theta.shape[0] sweeps.
    workspace: compiled function (rows, solver_bodies) -> work arrays of `relax`, made once a run; or None.
    counts_relaxations: whether `relax` returns (sweeps, relaxations of a contact). If not, each sweep relaxes every
    contact once.
    """

    settings: type
    relax: Callable
    workspace: Callable | None = None
    counts_relaxations: bool = False


class Entry(NamedTuple):
    """A registered solver: the functions `settings` and `advance` of `register`, and whether it has rolling rows."""

    settings: Callable
    advance: Callable | None
    rolls: bool = False

    @property
    def can_sleep(self) -> bool:
        """Whether islands of contacts can fall asleep in the steps of this solver."""
        return self.advance is None


METHODS: dict[str, type] = {}
"""Name of a solver in a state file -> class of its options."""

COMPILED_IN = """
import deep_contact.solvers
"""
"""A text with an import of the package that registers the loops of `relax`. The import is not done here, because
modules of this folder must not import that package. The code cache reads the line as an import, so that a step is
compiled again once a loop has changed."""

_ENTRIES: dict[type, Entry] = {}
_LOOPS: dict[type, Loop] = {}


def register(
    options: type, settings: Callable, loops: tuple[Loop, ...], *, advance: Callable | None = None, rolls: bool = False
) -> None:
    """Register a solver under the name of the class of its options.

    options: frozen dataclass, a subclass of `SolverOptions`. settings: function of the options -> settings, a
    NamedTuple whose type belongs to one of the loops. loops: the solver's loops. advance: function of the options ->
    function in place of `algorithm.advance`, for a solver with a step of its own. Such a step always has tangent rows,
    and no island sleeps in it. rolls: whether the solver relaxes the rows of rolling resistance. Raises ValueError if
    another solver has that name, or if the options are not a subclass of `SolverOptions`.
    """
    expect(issubclass(options, SolverOptions), f"options: expected a subclass of SolverOptions, got {options.__name__}")
    if METHODS.setdefault(options.__name__, options) is not options:
        raise ValueError(f"options: expected a new name, got {options.__name__}, which is {METHODS[options.__name__]}")
    _ENTRIES[suggesting(options)] = Entry(settings, advance, rolls)
    for loop in loops:
        _LOOPS[loop.settings] = loop


def entry_of(solver) -> Entry:
    """Return the entry of a solver's options. Raises ValueError if no solver is registered for them."""
    entry = _ENTRIES.get(type(solver))
    if entry is None:
        raise ValueError(
            f"solver: expected options such as PGS(sweeps=…), of one of {', '.join(METHODS)}, got {solver!r}"
        )
    return entry


def tolerance_argument(solver) -> float:
    """Return the tolerance for compiled functions, N·s: −1, which is never reached, in place of None.

    Raises ValueError if the tolerance is "scene", which `for_state` replaces by a number.
    """
    if solver.tolerance == FOLLOWS_SCENE:
        raise ValueError(f"tolerance: expected a number or None, of solver.for_state(state), got {solver.tolerance!r}")
    return -1.0 if solver.tolerance is None else float(solver.tolerance)


def solver_from(method: str, options: Mapping):
    """Return the options of a solver in a file. method: name of the solver. options: name -> value.

    Old files may have three more options: a precision, which is always double; a number of threads, which changes no
    bit; and `islands`, always False, of solvers without islands. They are left out.

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
    """Return a solver as text, with the options that differ from their defaults.

    For example: "NNCG(sweeps=20, tolerance=None)".
    """
    changed = [f for f in fields(solver) if getattr(solver, f.name) != f.default]
    return f"{type(solver).__name__}({', '.join(f'{f.name}={getattr(solver, f.name)!r}' for f in changed)})"


def make_workspace(settings, rows, solver_bodies):
    """Return work arrays of the loop for rows and solver bodies of this size; None if the loop needs none."""
    make = _LOOPS[type(settings)].workspace
    return None if make is None else make(rows, solver_bodies)


def relax(settings, rows, friction, solver_bodies, theta, workspace):
    """Relax all contacts, in place, by the loop of the settings.

    Returns (number of sweeps, number of relaxations of a contact). rows: `Rows`. friction: as in `StepInput`, or None
    for rows without tangents. solver_bodies: (N, 4). theta: buffer for the θ of each sweep, N·s; its length is the
    largest number of sweeps. workspace: from `make_workspace`.
    """
    return _relax(type(settings))(settings, rows, friction, solver_bodies, theta, workspace)


# In compiled callers, Numba replaces the two functions above by a loop that the type of the settings selects. Python
# callers, and all callers under NUMBA_DISABLE_JIT=1, run them as they stand.
@overload(make_workspace)
def _overload_make_workspace(settings, rows, solver_bodies):
    make = _LOOPS[settings.instance_class].workspace
    if make is None:
        return lambda settings, rows, solver_bodies: None
    return lambda settings, rows, solver_bodies: make(rows, solver_bodies)


@overload(relax)
def _overload_relax(settings, rows, friction, solver_bodies, theta, workspace):
    return _relax(settings.instance_class)


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
