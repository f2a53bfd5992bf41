"""PGS and NesterovPGS on a contact problem of matrices, A λ + b: for problems whose bodies are unknown.

A sweep gathers the velocities of a contact's two rows from A's blocks of 2 × 2, one for every contact with which it
shares a body. The blocks on the diagonal may couple normal and tangent, as they do for shapes other than circles, and μ
may differ from contact to contact. In exact arithmetic the sweeps are the engine's.
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
    """A problem as blocks of 2 × 2: for each contact the blocks beside the diagonal, and the block on it."""

    first: np.ndarray  # (m + 1,): the blocks of contact i are first[i] to first[i + 1]
    contact: np.ndarray  # (k,): the contact whose impulses a block multiplies
    entry: np.ndarray  # (k, 4): nn, nt, tn, tt of every block
    diagonal: np.ndarray  # (m, 6): nn, nt, tn, tt of the block on the diagonal, and the inverses of nn and tt
    b: np.ndarray  # (m, 2): b of the problem, velocities without impulses, m/s
    mu: np.ndarray  # (m,): μ of every contact


def blocks_of(problem: ContactProblem) -> Blocks:
    """The `Blocks` of a problem that `check_problem` has validated."""
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
    """Impulses of a contact problem with friction, (2 m,), N·s, and the `ConvergenceRecord` of the sweeps.

    solver: `PGS` (the default) or `NesterovPGS`; its tolerance is a number, or None. start: λ to start from, (2 m,); by
    default 0. Returns impulses in the friction cone. The problem stays as it is. Raises ValueError naming the argument.
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
    """(A λ + b)_n and (A λ + b)_t of contact i without the contributions of its own impulses, m/s."""
    u_n, u_t = blocks.b[i, 0], blocks.b[i, 1]
    for k in range(blocks.first[i], blocks.first[i + 1]):
        j = blocks.contact[k]
        p_n, p_t = impulse[j, 0], impulse[j, 1]
        u_n += blocks.entry[k, 0] * p_n + blocks.entry[k, 1] * p_t
        u_t += blocks.entry[k, 2] * p_n + blocks.entry[k, 3] * p_t
    return u_n, u_t


@njit(cache=True)
def sweep_matrix(blocks, impulse):
    """A sweep over all contacts, in place, the friction row before the normal row. Returns θ, N·s."""
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
    """u = A λ + b, in place, (m, 2)."""
    for i in range(impulse.shape[0]):
        own = blocks.diagonal[i]
        u_n, u_t = gather(blocks, impulse, i)
        u[i, 0] = u_n + own[0] * impulse[i, 0] + own[1] * impulse[i, 1]
        u[i, 1] = u_t + own[2] * impulse[i, 0] + own[3] * impulse[i, 1]


@njit(cache=True)
def _relax(blocks, impulse, tolerance, theta, has_momentum):
    """Sweep until θ is within the tolerance, with or without the momentum of `solvers.nesterov`.

    A negative tolerance is never met. Returns the number of sweeps.
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
