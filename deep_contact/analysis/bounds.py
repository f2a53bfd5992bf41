"""Bounds on the impulses behind a motion, which with friction does not determine them.

A pile has more contacts than it needs to rest. All impulses in Coulomb's cone with the same sums on every circle give
the same motion, and no observer of positions and velocities can tell them apart. Their set is convex (McNamara and
Herrmann, Phys. Rev. E 70, 061303, 2004): each end of a contact's interval is a linear program. Sources: Radjai, Jean,
Moreau and Roux, Phys. Rev. Lett. 77, 274 (1996); Unger, Kertész and Wolf, Phys. Rev. Lett. 94, 178001 (2005).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import sparse

from deep_contact import parallel
from deep_contact.analysis.exact import solve_exactly
from deep_contact.analysis.lcp import contact_problem
from deep_contact.state.equality import by_value
from deep_contact.state.state import State, StateWithContacts
from deep_contact.state.validation import expect, integer
from deep_contact.stepping import metrics
from deep_contact.stepping.prepare import ready

if TYPE_CHECKING:
    from highspy import Highs

EXACT = 1e-8
"""Largest residual of the impulses, m/s."""

MOVING = 1e-6
"""Least velocity of a contact that separates or slides, m/s."""

DETERMINED = 1e-6
"""Width below which an interval counts as a point, over the mean λ_n; the programs are solved to 1e-10."""

OPTIONS: dict[str, bool | int | float | str] = {
    "output_flag": False, "threads": 1, "presolve": "off", "solver": "simplex", "simplex_strategy": 4,
    "primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10,
}  # fmt: skip
"""Options of HiGHS: primal simplex, without output."""


@by_value
class ForceBounds(NamedTuple):
    """Bounds on the impulses of k contacts; a force is an impulse over Δt. A missing bound is ±infinity.

    | field      | meaning                                                                       | shape  | unit |
    |------------|-------------------------------------------------------------------------------|--------|------|
    | normal     | least and largest λ_n                                                         | (k, 2) | N·s  |
    | tangent    | least and largest λ_t                                                         | (k, 2) | N·s  |
    | determined | share of the contacts whose intervals are narrower than 1e-6 of the mean λ_n  |        |      |
    """

    normal: np.ndarray
    tangent: np.ndarray
    determined: float


def force_bounds(
    state: State,
    contacts: Sequence[int] | np.ndarray | None = None,
    *,
    jobs: int | Executor = 1,
) -> ForceBounds:
    """Least and largest λ_n and λ_t of each contact over all impulses that give the state's exact motion.

    The motion is that of the state's impulses if their `metrics.residual` is at most 1e-8 m/s. From other impulses, and
    for a state that is not solved, `dc.solve_exactly` finds the motion.
    A contact that separates at more than 1e-6 m/s, a hundred times that residual, carries no impulse. A contact that
    slides faster than that lies on an edge of Coulomb's cone. Slower contacts may carry all that the cone allows: their
    intervals are too wide rather than too narrow.

    contacts: indices of contacts; None for all. jobs: number of processes, or an executor.
    Raises ValueError naming the argument, also if no exact motion was found.
    """
    _highspy()  # before anything is computed
    state = ready(state)
    number_of_parts = parallel.workers(jobs) if isinstance(jobs, Executor) else integer("jobs", jobs, 1)
    m, mu, c = state.contacts.count, state.world.friction, state.contacts
    wanted = [integer("contacts", i, most=m - 1) for i in (range(m) if contacts is None else contacts)]
    exact = solve_exactly(state, *((c.normal_impulse, c.tangent_impulse) if state.solved else ()), residual=EXACT)
    expect(exact.converged, f"state: expected contacts solved to {EXACT:g} m/s, got a residual of {exact.residual:.3g}")
    impulse = np.column_stack([exact.solution.normal_impulses, exact.solution.tangent_impulses])
    u_n, u_t = metrics.row_velocities(state, exact.solution.velocities, exact.solution.angular_velocities)
    # λ of a contact is a sum of the unit vectors along the edges of its cone, (1, ±μ). The cone is the set of all sums
    # with factors >= 0.
    sides = np.array([1.0, -1.0] if mu > 0 else [0.0])
    side, of = np.nonzero((u_n <= MOVING) & (sides[:, None] * u_t <= MOVING))
    places = np.concatenate([2 * of, 2 * of + 1]), np.tile(np.arange(of.size), 2)
    length = np.hypot(1.0, mu)
    edges = sparse.csc_array(
        (np.concatenate([np.full(of.size, 1 / length), sides[side] * mu / length]), places), shape=(2 * m, of.size)
    )
    impulse[u_n > MOVING] = 0.0  # the residual leaves small impulses there
    slides = np.abs(u_t) > MOVING
    impulse[slides, 1] = -np.sign(u_t[slides]) * mu * impulse[slides, 0]
    scale = float(impulse[:, 0].mean()) if impulse[:, 0].any() else 1.0
    lengths = np.column_stack([np.ones((state.bodies.count, 2)), 1 / state.bodies.radius]).ravel()
    sums = sparse.diags_array(lengths) @ sparse.csc_array(contact_problem(state).jacobian).T
    total = sums @ impulse.ravel() / scale
    program = Program(sparse.csr_array(sums @ edges), total)
    shares = np.array_split(_side_by_side(state, wanted), number_of_parts)
    parts = [([wanted[i] for i in share], edges, program) for share in shares]
    ends = np.zeros((len(wanted), 2, 2))
    for k, some in parallel.finished(_ends, parts, jobs=jobs):
        ends[shares[k]] = some
    narrow = (np.ptp(ends, axis=2) < DETERMINED).all(axis=1)
    return ForceBounds(scale * ends[:, 0], scale * ends[:, 1], float(narrow.mean()) if narrow.size else 1.0)


def _side_by_side(state: StateWithContacts, wanted: Sequence[int]) -> np.ndarray:
    """An order of contacts in which each lies beside the one before: up a strip of the scene and down the next one.

    The solutions of neighbours differ little, so that simplex gets from one to the next in fewer steps.
    """
    position = state.contacts.position[wanted]
    strip = np.floor(position[:, 0] / (4.0 * state.bodies.radius.mean()))
    return np.lexsort((np.where(strip % 2 == 0, 1.0, -1.0) * position[:, 1], strip))


class Program(NamedTuple):
    """Linear programs x >= 0, A x = total that differ in their costs."""

    matrix: sparse.csr_array
    total: np.ndarray


def _highspy():
    """The package highspy. Raises ModuleNotFoundError with the command that installs it."""
    try:
        import highspy
    except ModuleNotFoundError as error:
        needs = "expected the package, which force_bounds needs"
        raise ModuleNotFoundError(f"highspy: {needs}, got none: pip install highspy") from error
    return highspy


def _highs(program: Program) -> Highs:
    """The program in HiGHS, solved without a cost. Primal simplex goes on from its solution when the cost changes."""
    highs, A = _highspy().Highs(), program.matrix
    for option, value in OPTIONS.items():
        highs.setOptionValue(option, value)
    highs.addVars(A.shape[1], np.zeros(A.shape[1]), np.full(A.shape[1], np.inf))
    highs.addRows(A.shape[0], program.total, program.total, A.nnz, A.indptr, A.indices, A.data)
    highs.run()
    return highs


def _ends(part: tuple) -> np.ndarray:
    """Least and largest λ_n and λ_t over the scale, (k, 2, 2), of some contacts. part: (contacts, edges, program)."""
    contacts, edges, program = part
    edges, ends = edges.tocsr(), np.zeros((len(contacts), 2, 2))
    is_zero, columns = np.zeros(edges.shape[0], bool), np.arange(edges.shape[1], dtype=np.int32)
    highs, known = _highs(program), _highspy().HighsModelStatus
    for row_of, end, k in np.ndindex(2, 2, len(contacts)):  # one end of all contacts, then the next
        row, sign, place = 2 * contacts[k] + row_of, (1.0, -1.0)[end], (k, row_of, end)
        cost = sign * edges[[row]].toarray()[0]
        if not cost.any() or (end == 0 and is_zero[row]):
            continue
        highs.changeColsCost(columns.size, columns, cost)
        highs.run()
        status = highs.getModelStatus()
        if status == known.kOptimal:
            ends[place] = sign * highs.getInfo().objective_function_value
            is_zero[::2] |= (edges @ highs.getSolution().col_value)[::2] == 0.0  # the least λ_n: no program
        else:
            expect(status == known.kUnbounded, f"state: expected programs that HiGHS solves, got {status}")
            ends[place] = -sign * np.inf
    return ends
