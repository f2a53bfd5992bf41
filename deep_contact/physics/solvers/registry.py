"""The registry of solvers: the settings and the compiled loop that belong to a solver's options.

A solver is one file: its options (a frozen dataclass that tells its weakness and source), its settings (a named tuple:
the options as compiled code takes them), its loop, and one call of `register`. The type of the settings picks the loop
when the step is compiled, so that a run compiles no other solver and makes no choice between steps. A solver from
outside this package registers in the same way; `tests/physics/test_registry.py` has an example.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import NamedTuple

from numba.extending import overload

from deep_contact.physics.convergence import mark_divergence
from deep_contact.state import State
from deep_contact.state.scales import FOLLOWS_SCENE
from deep_contact.validation import one_of, suggesting


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

_ENTRIES: dict[type, Entry] = {}
_LOOPS: dict[type, Loop] = {}


def register(options: type, settings: Callable, loops: tuple[Loop, ...], *, advance: Callable | None = None) -> None:
    """Make a solver known, under the name of its options. Raises ValueError if another solver has that name.

    options: frozen dataclass with `sweeps`, `tolerance` and `position_sweeps`. settings: function of the
    options -> NamedTuple of a type that one of the loops has. advance: function of the options -> function that
    replaces `engine.advance`. Such steps always have tangent rows, and do not support sleeping.
    """
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


def for_state(solver, state: State):
    """The options with numbers in place of values that follow the scene; without `for_state` they stay as they are."""
    return solver.for_state(state) if hasattr(solver, "for_state") else solver


def tolerance_argument(solver) -> float:
    """The tolerance as compiled functions take it: −1, which is never met, in place of None.

    Raises ValueError if the tolerance follows the scene: `for_state` gives the number.
    """
    if solver.tolerance == FOLLOWS_SCENE:
        raise ValueError(f"tolerance: expected a number or None, of for_state(solver, state), got {solver.tolerance!r}")
    return -1.0 if solver.tolerance is None else float(solver.tolerance)


def solver_from(method: str, options: Mapping):
    """The solver of a file, from its method and options.

    Old files also have a precision, which has to be double, and a number of threads, which changes no bit.

    Raises ValueError for an unknown method, for an unknown option, and for values that the method refuses.
    """
    one_of("precision", options.get("precision", "double"), ("double",))
    known = {name: value for name, value in options.items() if name not in ("precision", "threads")}
    kind = METHODS[one_of("method", method, METHODS)]
    for name in known:
        one_of(f"option of {method}", name, [field.name for field in fields(kind)])
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
