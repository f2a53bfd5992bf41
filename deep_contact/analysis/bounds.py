"""Bounds on the contact impulses of a motion. With friction, the motion does not determine the impulses.

A pile at rest has more contacts than equilibrium needs. Many vectors λ of impulses in Coulomb's cones then have the
same sums of force and torque on every circle. They give the same motion, so that no observation of positions and
velocities can tell them apart. The set of all these λ is convex (McNamara and Herrmann, Phys. Rev. E 70, 061303, 2004).
Each bound on a contact's impulse is therefore the solution of a linear program. Sources: Radjai, Jean, Moreau and Roux,
Phys. Rev. Lett. 77, 274 (1996); Unger, Kertész and Wolf, Phys. Rev. Lett. 94, 178001 (2005).
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
from deep_contact.state.materials import at_contacts
from deep_contact.state.state import State, StateWithContacts
from deep_contact.state.validation import expect, integer
from deep_contact.stepping import metrics
from deep_contact.stepping.prepare import ready

if TYPE_CHECKING:
    from highspy import Highs

EXACT = 1e-8
"""Largest residual (`metrics.residual`) of impulses that count as exact, m/s."""

MOVING = 1e-6
"""Relative velocity, normal or tangential, above which a contact counts as separating or as sliding, m/s."""

DETERMINED = 1e-6
"""An impulse counts as determined if its two bounds differ by less than this, divided by the mean λ_n. The linear
programs are solved to 1e-10."""

OPTIONS: dict[str, bool | int | float | str] = {
    "output_flag": False, "threads": 1, "presolve": "off", "solver": "simplex", "simplex_strategy": 4,
    "primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10,
}  # fmt: skip
"""Options of HiGHS, the solver of the linear programs: primal simplex, without output."""


@by_value
class ForceBounds(NamedTuple):
    """Bounds on the impulses of k contacts (`force_bounds`). A bound that does not exist is ±infinity.

    | field      | meaning                                                                        | shape  | unit |
    |------------|--------------------------------------------------------------------------------|--------|------|
    | normal     | least and largest λ_n                                                          | (k, 2) | N·s  |
    | tangent    | least and largest λ_t                                                          | (k, 2) | N·s  |
    | determined | share of the k contacts of which both λ_n and λ_t are known to 1e-6 mean λ_n   |        |      |

    An impulse divided by Δt is the mean force over the step.
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
    """Return bounds on λ_n and λ_t of contacts: their least and largest values over all impulses that give one motion.

    This motion is the exact motion of the state. If the `metrics.residual` of the state's impulses is at most 1e-8 m/s,
    the motion that these impulses give counts as exact. Otherwise, and for a state that is not solved,
    `dc.solve_exactly` computes the motion. If a contact separates faster than 1e-6 m/s, its impulse is 0. If a contact
    slides faster than 1e-6 m/s, its impulse lies on the edge of Coulomb's cone that opposes the sliding. The impulse of
    any other contact may lie anywhere in the cone. Its bounds may therefore lie too far apart, but never too close
    together.

    contacts: indices of the contacts; None stands for all. jobs: number of processes, or an executor. Raises
    ValueError, which names the argument, for wrong arguments and if no exact motion is found. Raises
    ModuleNotFoundError without the package highspy.
    """
    _highspy()  # raises an error at once if the package is missing
    state = ready(state)
    number_of_parts = parallel.workers(jobs) if isinstance(jobs, Executor) else integer("jobs", jobs, 1)
    m, c = state.contacts.count, state.contacts
    mu = np.full(m, at_contacts(state, state.world.friction))
    wanted = [integer("contacts", i, most=m - 1) for i in (range(m) if contacts is None else contacts)]
    exact = solve_exactly(state, *((c.normal_impulse, c.tangent_impulse) if state.solved else ()), residual=EXACT)
    expect(exact.converged, f"state: expected contacts solved to {EXACT:g} m/s, got a residual of {exact.residual:.3g}")
    impulse = np.column_stack([exact.solution.normal_impulses, exact.solution.tangent_impulses])
    u_n, u_t = metrics.row_velocities(state, exact.solution.velocities, exact.solution.angular_velocities)
    # The cone of a contact is the set of sums of its two edges, unit vectors along (1, ±μ), with factors >= 0. These
    # factors are the unknowns of the programs. With μ = 0 there is one edge.
    sides = np.array([[1.0], [-1.0]])
    side, of = np.nonzero((u_n <= MOVING) & ((sides * u_t <= MOVING) | (mu == 0)) & ((sides > 0) | (mu > 0)))
    places = np.concatenate([2 * of, 2 * of + 1]), np.tile(np.arange(of.size), 2)
    length = np.hypot(1.0, mu[of])
    edges = sparse.csc_array(
        (np.concatenate([1 / length, sides[side, 0] * mu[of] / length]), places), shape=(2 * m, of.size)
    )
    impulse[u_n > MOVING] = 0.0  # an inexact solution may have small impulses at separating contacts
    slides = np.abs(u_t) > MOVING
    impulse[slides, 1] = -np.sign(u_t[slides]) * mu[slides] * impulse[slides, 0]
    scale = float(impulse[:, 0].mean()) if impulse[:, 0].any() else 1.0
    lengths = np.column_stack([np.ones((state.bodies.count, 2)), 1 / state.bodies.radius]).ravel()
    sums = sparse.diags_array(lengths) @ sparse.csc_array(contact_problem(state).jacobian).T
    total = sums @ impulse.ravel() / scale
    program = LinearProgram(sparse.csr_array(sums @ edges), total)
    shares = np.array_split(_side_by_side(state, wanted), number_of_parts)
    parts = [([wanted[i] for i in share], edges, program) for share in shares]
    ends = np.zeros((len(wanted), 2, 2))
    for k, some in parallel.finished(_ends, parts, jobs=jobs):
        ends[shares[k]] = some
    narrow = (np.ptp(ends, axis=2) < DETERMINED).all(axis=1)
    return ForceBounds(scale * ends[:, 0], scale * ends[:, 1], float(narrow.mean()) if narrow.size else 1.0)


def _side_by_side(state: StateWithContacts, wanted: Sequence[int]) -> np.ndarray:
    """Return the order, (k,), in which the contacts `wanted` are solved: indices into `wanted`, neighbours in sequence.

    The order goes up one vertical strip of the scene and down the next. The solutions for neighbouring contacts differ
    little, so that the simplex method gets from one to the next in few steps.
    """
    position = state.contacts.position[wanted]
    strip = np.floor(position[:, 0] / (4.0 * state.bodies.radius.mean()))
    return np.lexsort((np.where(strip % 2 == 0, 1.0, -1.0) * position[:, 1], strip))


class LinearProgram(NamedTuple):
    """The constraints x >= 0 and A x = total, which all linear programs share; A is `matrix`. Only the costs differ."""

    matrix: sparse.csr_array
    total: np.ndarray


def _highspy():
    """Return the module highspy. If it is missing, raises ModuleNotFoundError with the command that installs it."""
    try:
        import highspy
    except ModuleNotFoundError as error:
        needs = "expected the package, which force_bounds needs"
        raise ModuleNotFoundError(f"highspy: {needs}, got none: pip install highspy") from error
    return highspy


def _highs(program: LinearProgram) -> Highs:
    """Return a HiGHS solver that has solved the program for costs of 0.

    When the costs are changed, the primal simplex method continues from this solution.
    """
    highs, A = _highspy().Highs(), program.matrix
    for option, value in OPTIONS.items():
        highs.setOptionValue(option, value)
    highs.addVars(A.shape[1], np.zeros(A.shape[1]), np.full(A.shape[1], np.inf))
    highs.addRows(A.shape[0], program.total, program.total, A.nnz, A.indptr, A.indices, A.data)
    highs.run()
    return highs


def _ends(part: tuple) -> np.ndarray:
    """Return the least and the largest λ_n and λ_t of k contacts, divided by the mean λ_n: (k, 2, 2).

    The second index of the result tells λ_n (0) from λ_t (1), the third the least value (0) from the largest (1). part:
    (indices of the contacts, edges of all cones as columns, `LinearProgram`).
    """
    contacts, edges, program = part
    edges, ends = edges.tocsr(), np.zeros((len(contacts), 2, 2))
    is_zero, columns = np.zeros(edges.shape[0], bool), np.arange(edges.shape[1], dtype=np.int32)
    highs, known = _highs(program), _highspy().HighsModelStatus
    for row_of, end, k in np.ndindex(2, 2, len(contacts)):  # one bound for all contacts, then the next bound
        row, sign, place = 2 * contacts[k] + row_of, (1.0, -1.0)[end], (k, row_of, end)
        cost = sign * edges[[row]].toarray()[0]
        if not cost.any() or (end == 0 and is_zero[row]):
            continue
        highs.changeColsCost(columns.size, columns, cost)
        highs.run()
        status = highs.getModelStatus()
        if status == known.kOptimal:
            ends[place] = sign * highs.getInfo().objective_function_value
            # If another contact has λ_n = 0 in this solution, its least λ_n is 0, and no program has to find it.
            is_zero[::2] |= (edges @ highs.getSolution().col_value)[::2] == 0.0
        else:
            expect(status == known.kUnbounded, f"state: expected programs that HiGHS solves, got {status}")
            ends[place] = -sign * np.inf
    return ends
