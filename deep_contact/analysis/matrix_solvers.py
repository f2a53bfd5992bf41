"""PGS and NesterovPGS for a contact problem in matrix form, A λ + b, whose bodies may be unknown.

A sweep computes the velocities of a contact's two rows from 2 × 2 blocks of A. There is one block for every contact
that shares a body with this contact, and one on the diagonal. The diagonal block may couple normal and tangent, as it
does for shapes other than circles, and μ may differ from contact to contact. In exact arithmetic the sweeps are those
of the engine.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from deep_contact.analysis.lcp import ContactProblem, check_problem
from deep_contact.compiled import njit
from deep_contact.solvers import PGS, NesterovPGS, nesterov
from deep_contact.state.validation import expect, floats
from deep_contact.stepping.convergence import ConvergenceRecord, convergence_record, is_over
from deep_contact.stepping.interface import tolerance_argument
from deep_contact.stepping.rows import projected


class Blocks(NamedTuple):
    """A contact problem as 2 × 2 blocks of A: k blocks beside the diagonal, sorted by contact, and m blocks on it."""

    first: np.ndarray  # (m + 1,): contact i has the blocks first[i] to first[i + 1] - 1 beside the diagonal
    contact: np.ndarray  # (k,): for each block, the contact whose impulses it multiplies
    entry: np.ndarray  # (k, 4): elements nn, nt, tn, tt of each block, 1/kg
    diagonal: np.ndarray  # (m, 6): nn, nt, tn, tt of each diagonal block, 1/kg; 1 / nn and 1 / tt, kg
    b: np.ndarray  # (m, 2): velocities of the rows without impulses, m/s
    mu: np.ndarray  # (m,): μ of every contact


def blocks_of(problem: ContactProblem) -> Blocks:
    """Return the `Blocks` of a problem that `check_problem` has validated."""
    A = sparse.bsr_array(problem.A, blocksize=(2, 2))
    A.sort_indices()
    m = problem.b.size // 2
    row = np.repeat(np.arange(m), np.diff(A.indptr))
    beside = A.indices != row
    entry = A.data.reshape(-1, 4)
    own = entry[~beside]
    first = np.concatenate([[0], np.cumsum(np.bincount(row[beside], minlength=m))])
    diagonal = np.ascontiguousarray(np.column_stack([own, 1 / own[:, 0], 1 / own[:, 3]]))
    b, mu = np.ascontiguousarray(problem.b.reshape(m, 2)), problem.friction.copy()
    contact = A.indices[beside].astype(np.uint32)
    return Blocks(first.astype(np.uint32), contact, np.ascontiguousarray(entry[beside]), diagonal, b, mu)


def solve_problem(
    problem: ContactProblem, solver=None, start: np.ndarray | None = None
) -> tuple[np.ndarray, ConvergenceRecord]:
    """Solve a contact problem with friction. Returns (impulses, (2 m,), N·s; `ConvergenceRecord` of the sweeps).

    solver: `PGS` (the default) or `NesterovPGS`; its tolerance is a number, N·s, or None. start: λ to start from, (2
    m,), N·s; by default 0. The returned impulses lie in the friction cone. The problem is not changed. Raises
    ValueError, which names the argument.
    """
    solver = PGS(tolerance=None) if solver is None else solver
    fits = type(solver) is NesterovPGS or (type(solver) is PGS and not solver.islands)
    expect(fits, f"solver: expected one of PGS, NesterovPGS, without islands, got {solver!r}")
    problem = check_problem(problem)
    impulse = np.zeros(problem.b.size) if start is None else floats("start", start, problem.b.shape)
    theta = np.empty(solver.sweeps)
    blocks = blocks_of(problem)
    pairs = impulse.reshape(-1, 2)
    done = _relax(blocks, pairs, tolerance_argument(solver), theta, isinstance(solver, NesterovPGS))
    record = convergence_record(theta[:done], solver, blocks.mu.size)
    return np.column_stack(projected(pairs[:, 0], pairs[:, 1], problem.friction)).ravel(), record


@njit(cache=True)
def gather(blocks, impulse, i):
    """Return (A λ + b)_n and (A λ + b)_t of contact i, m/s, without the contributions of its own impulses.

    impulse: λ_n and λ_t of every contact, (m, 2), N·s.
    """
    u_n, u_t = blocks.b[i, 0], blocks.b[i, 1]
    for k in range(blocks.first[i], blocks.first[i + 1]):
        j = blocks.contact[k]
        p_n, p_t = impulse[j, 0], impulse[j, 1]
        u_n += blocks.entry[k, 0] * p_n + blocks.entry[k, 1] * p_t
        u_t += blocks.entry[k, 2] * p_n + blocks.entry[k, 3] * p_t
    return u_n, u_t


@njit(cache=True)
def sweep_matrix(blocks, impulse):
    """Do one sweep of PGS over all contacts, in place. Returns θ, the largest change of an impulse, N·s.

    Every contact relaxes its friction row before its normal row. impulse: (m, 2), N·s.
    """
    theta = 0.0
    for i in range(impulse.shape[0]):
        u_n, u_t = gather(blocks, impulse, i)
        own = blocks.diagonal[i]
        old_n, old_t = impulse[i, 0], impulse[i, 1]
        largest = blocks.mu[i] * max(old_n, 0.0)
        new_t = old_t - own[5] * (u_t + own[2] * old_n + own[3] * old_t)
        new_t = max(-largest, min(new_t, largest))
        new_n = max(0.0, old_n - own[4] * (u_n + own[0] * old_n + own[1] * new_t))
        theta = max(theta, max(abs(new_n - old_n), abs(new_t - old_t)))
        impulse[i, 0], impulse[i, 1] = new_n, new_t
    return theta


@njit(cache=True)
def velocities(blocks, impulse, u):
    """Write the velocities of all rows, A λ + b, into u, (m, 2), m/s. impulse: λ, (m, 2), N·s."""
    for i in range(impulse.shape[0]):
        own = blocks.diagonal[i]
        u_n, u_t = gather(blocks, impulse, i)
        u[i, 0] = u_n + own[0] * impulse[i, 0] + own[1] * impulse[i, 1]
        u[i, 1] = u_t + own[2] * impulse[i, 0] + own[3] * impulse[i, 1]


@njit(cache=True)
def _relax(blocks, impulse, tolerance, theta, has_momentum):
    """Sweep, in place, until θ is at most the tolerance, N·s, or `theta` is full. Returns the number of sweeps.

    A negative tolerance is never reached. theta: buffer for the θ of each sweep. has_momentum: whether the impulses are
    extrapolated after each sweep, as in `solvers.nesterov`.
    """
    flat = impulse.reshape(impulse.size)
    last, swept_from, memory = flat.copy(), flat.copy(), nesterov.FIRST_MEMORY
    for k in range(theta.shape[0]):
        theta[k] = sweep_matrix(blocks, impulse)
        if is_over(theta[k], tolerance) or k + 1 == theta.shape[0]:
            return k + 1
        if has_momentum:
            momentum, memory = nesterov.next_momentum(k, flat, swept_from, last, memory)
            nesterov.extrapolate(flat, last, momentum)
            swept_from[:] = flat
    return theta.shape[0]
