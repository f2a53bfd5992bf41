"""LU factors of sparse matrices of 3 × 3 blocks, one row and column of blocks for every body, without pivoting.

The pattern is symmetric, the values need not be. Bodies are ordered by minimum degree once a problem. A right side at
two bodies that touch is non-zero, after the forward solve, on one path of the elimination tree only (Davis, Direct
Methods for Sparse Linear Systems, 2006, chapter 4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy import sparse
from scipy.sparse.linalg import splu


class Pattern(NamedTuple):
    """Where the factors of n rows of blocks have blocks. All indices are places in the order of elimination."""

    place: np.ndarray  # (n,): of every body in the order of elimination
    first: np.ndarray  # (n + 1,): the blocks below the diagonal in column k are first[k] to first[k + 1]
    row: np.ndarray  # (k,): their rows, rising; the blocks of U are those mirrored
    updates_first: np.ndarray  # (n + 1,): the blocks of row j are those at updates_first[j] to updates_first[j + 1]
    update: np.ndarray  # (k,): the index of the block, in `row`
    column: np.ndarray  # (k,): and its column


class Factors(NamedTuple):
    """Inverses of the blocks on the diagonal, (n, 9), and the blocks of L, scaled by them, and of U, (k, 9)."""

    inverse: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


def pattern_of(n: int, one: np.ndarray, other: np.ndarray) -> Pattern:
    """The pattern for n bodies with blocks between `one` and `other`, (e,) each; pairs may repeat."""
    ends = np.concatenate([one, other]), np.concatenate([other, one])
    graph = sparse.csc_array(sparse.coo_array((np.ones(ends[0].size), ends), shape=(n, n)))
    graph.data[:] = -1.0
    # SuperLU's factors of the graph's Laplacian: none of their entries vanishes.
    laplacian = sparse.csc_array(graph + sparse.diags_array(1e-6 - graph.sum(axis=0)))
    factors = splu(laplacian, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    below = sparse.csc_array(sparse.tril(factors.L, -1))
    below.sort_indices()
    first, row = below.indptr.astype(np.int64), below.indices.astype(np.int64)
    order = np.argsort(row, kind="stable")
    updates_first = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=n))]).astype(np.int64)
    column = np.repeat(np.arange(n), np.diff(first))[order]
    return Pattern(factors.perm_c.astype(np.int64), first, row, updates_first, order.astype(np.int64), column)


def make_factors(pattern: Pattern) -> Factors:
    """Uninitialised blocks for the pattern."""
    n, count = pattern.place.size, pattern.row.size
    return Factors(np.empty((n, 9)), np.empty((count, 9)), np.empty((count, 9)))


@njit(cache=True, fastmath={"contract"})
def _subtract_product(target, q, a, p, b, s):
    """target[q] ← target[q] − a[p] b[s], blocks of 9 numbers by rows, in place; by indices, views are slower."""
    b_0, b_1, b_2 = b[s, 0], b[s, 1], b[s, 2]
    b_3, b_4, b_5 = b[s, 3], b[s, 4], b[s, 5]
    b_6, b_7, b_8 = b[s, 6], b[s, 7], b[s, 8]
    a_0, a_1, a_2 = a[p, 0], a[p, 1], a[p, 2]
    target[q, 0] -= a_0 * b_0 + a_1 * b_3 + a_2 * b_6
    target[q, 1] -= a_0 * b_1 + a_1 * b_4 + a_2 * b_7
    target[q, 2] -= a_0 * b_2 + a_1 * b_5 + a_2 * b_8
    a_0, a_1, a_2 = a[p, 3], a[p, 4], a[p, 5]
    target[q, 3] -= a_0 * b_0 + a_1 * b_3 + a_2 * b_6
    target[q, 4] -= a_0 * b_1 + a_1 * b_4 + a_2 * b_7
    target[q, 5] -= a_0 * b_2 + a_1 * b_5 + a_2 * b_8
    a_0, a_1, a_2 = a[p, 6], a[p, 7], a[p, 8]
    target[q, 6] -= a_0 * b_0 + a_1 * b_3 + a_2 * b_6
    target[q, 7] -= a_0 * b_1 + a_1 * b_4 + a_2 * b_7
    target[q, 8] -= a_0 * b_2 + a_1 * b_5 + a_2 * b_8


@njit(cache=True, error_model="numpy")
def factorise(pattern, factors):
    """Turn the blocks of a matrix into its factors, in place. Returns whether no block was singular."""
    inverse, lower, upper = factors.inverse, factors.lower, factors.upper
    first, row = pattern.first, pattern.row
    at = np.empty(inverse.shape[0], np.int64)
    scaled = np.empty((1, 9))
    for j in range(inverse.shape[0]):
        for p in range(first[j], first[j + 1]):
            at[row[p]] = p
        for t in range(pattern.updates_first[j], pattern.updates_first[j + 1]):
            s = pattern.update[t]
            _subtract_product(inverse, j, lower, s, upper, s)
            for p in range(s + 1, first[pattern.column[t] + 1]):
                q = at[row[p]]
                _subtract_product(lower, q, lower, p, upper, s)
                _subtract_product(upper, q, lower, s, upper, p)
        a = inverse[j]
        c_0, c_1, c_2 = a[4] * a[8] - a[5] * a[7], a[5] * a[6] - a[3] * a[8], a[3] * a[7] - a[4] * a[6]
        determinant = a[0] * c_0 + a[1] * c_1 + a[2] * c_2
        if determinant == 0.0 or not np.isfinite(determinant):
            return False
        s_1, s_2 = a[2] * a[7] - a[1] * a[8], a[1] * a[5] - a[2] * a[4]
        s_4, s_5 = a[0] * a[8] - a[2] * a[6], a[2] * a[3] - a[0] * a[5]
        s_7, s_8 = a[1] * a[6] - a[0] * a[7], a[0] * a[4] - a[1] * a[3]
        a[0], a[1], a[2], a[3], a[4] = c_0, s_1, s_2, c_1, s_4
        a[5], a[6], a[7], a[8] = s_5, c_2, s_7, s_8
        a /= determinant
        for p in range(first[j], first[j + 1]):
            scaled[:] = 0.0
            _subtract_product(scaled, 0, lower, p, inverse, j)
            for e in range(9):
                lower[p, e] = -scaled[0, e]
    return True


@njit(cache=True, fastmath={"contract"})
def solve(pattern, factors, x, begin):
    """Solve in place for a right side x, (n, 3).

    begin: −1, or the place of the first body of a right side at bodies that touch: it is 0 off its path to the root.
    """
    inverse, lower, upper = factors.inverse, factors.lower, factors.upper
    first, row = pattern.first, pattern.row
    n = inverse.shape[0]
    k = max(begin, 0)
    while k < n:
        x_0, x_1, x_2 = x[k, 0], x[k, 1], x[k, 2]
        for p in range(first[k], first[k + 1]):
            i = row[p]
            x[i, 0] -= lower[p, 0] * x_0 + lower[p, 1] * x_1 + lower[p, 2] * x_2
            x[i, 1] -= lower[p, 3] * x_0 + lower[p, 4] * x_1 + lower[p, 5] * x_2
            x[i, 2] -= lower[p, 6] * x_0 + lower[p, 7] * x_1 + lower[p, 8] * x_2
        if begin < 0:
            k += 1
        else:
            k = row[first[k]] if first[k + 1] > first[k] else n
    for k in range(n - 1, -1, -1):
        y_0, y_1, y_2 = x[k, 0], x[k, 1], x[k, 2]
        for p in range(first[k], first[k + 1]):
            i = row[p]
            y_0 -= upper[p, 0] * x[i, 0] + upper[p, 1] * x[i, 1] + upper[p, 2] * x[i, 2]
            y_1 -= upper[p, 3] * x[i, 0] + upper[p, 4] * x[i, 1] + upper[p, 5] * x[i, 2]
            y_2 -= upper[p, 6] * x[i, 0] + upper[p, 7] * x[i, 1] + upper[p, 8] * x[i, 2]
        a = inverse[k]
        x[k, 0] = a[0] * y_0 + a[1] * y_1 + a[2] * y_2
        x[k, 1] = a[3] * y_0 + a[4] * y_1 + a[5] * y_2
        x[k, 2] = a[6] * y_0 + a[7] * y_1 + a[8] * y_2
