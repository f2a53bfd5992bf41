"""Find islands: groups of circles that touch each other, directly or through other circles.

Walls and segments connect no circles. No island influences another. Therefore each island can be solved with its own
number of sweeps (`PGS(islands=True)`; Figure 6.7), or put to sleep (`sleeping`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deep_contact.compiled import njit
from deep_contact.state.state import State
from deep_contact.stepping.rows import BODY_A, BODY_B, Rows


class IslandsWorkspace(NamedTuple):
    """Work arrays: the islands of n circles, and the rows of m contacts sorted by island."""

    parent: np.ndarray  # (n,): parent of each circle in the union-find forest; a root is its own parent
    start: np.ndarray  # (n + 1,): the k-th island has the sorted rows start[k] to start[k + 1] − 1
    order: np.ndarray  # (m,): index of each sorted row before the sort
    rows: Rows  # sorted by island; within an island in their former sequence


@njit(cache=True)
def make_islands_workspace(rows, solver_bodies):
    """Return the work arrays for as many contacts as there are rows. solver_bodies: (n + 4, 4)."""
    n, m = solver_bodies.shape[0] - 4, rows.body.shape[0]
    copies = Rows(np.empty_like(rows.body), np.empty_like(rows.data), np.empty_like(rows.impulse))
    return IslandsWorkspace(np.empty(n, np.int64), np.empty(n + 1, np.int64), np.empty(m, np.int64), copies)


@njit(cache=True)
def root_of(parent, i):
    """Return the root of circle i in the union-find forest.

    The path to the root is halved, in place (Tarjan and van Leeuwen, J. ACM 31, 1984). parent: parent of each circle,
    (n,).
    """
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def unite(body_a, body_b, parent):
    """Unite the circles of all contacts by union-find, in place on parent, (n,).

    Afterwards the root of each island is the circle with its smallest index. body_a, body_b: indices of the two bodies
    of each contact, (m,).
    """
    n = parent.shape[0]
    for i in range(n):
        parent[i] = i
    for k in range(body_a.shape[0]):
        if body_b[k] < n:
            one, other = root_of(parent, np.int64(body_a[k])), root_of(parent, np.int64(body_b[k]))
            parent[max(one, other)] = min(one, other)


@njit(cache=True)
def sort_by_island(rows, workspace):
    """Sort rows by island, by a counting sort, into the workspace. Returns (number of islands, sorted rows).

    Islands are in the order of their smallest circles.
    """
    parent, start, order = workspace.parent, workspace.start, workspace.order
    n, m = parent.shape[0], rows.body.shape[0]
    unite(rows.body[:, BODY_A], rows.body[:, BODY_B], parent)
    start[:] = 0
    for i in range(m):
        start[root_of(parent, np.int64(rows.body[i, BODY_A])) + 1] += 1
    for c in range(n):
        start[c + 1] += start[c]
    # Filled from the back: afterwards start[root + 1] is the place at which the island begins.
    for i in range(m - 1, -1, -1):
        root = root_of(parent, np.int64(rows.body[i, BODY_A]))
        start[root + 1] -= 1
        order[start[root + 1]] = i
    count = 0
    for c in range(n):
        end = start[c + 2] if c + 2 <= n else m
        if end > start[c + 1]:
            start[count] = start[c + 1]
            count += 1
    start[count] = m
    sorted_rows = Rows(workspace.rows.body[:m], workspace.rows.data[:m], workspace.rows.impulse[:m])
    for i in range(m):
        for c in range(2):
            sorted_rows.body[i, c] = rows.body[order[i], c]
        for c in range(rows.data.shape[1]):
            sorted_rows.data[i, c] = rows.data[order[i], c]
        for c in range(rows.impulse.shape[1]):
            sorted_rows.impulse[i, c] = rows.impulse[order[i], c]
    return count, sorted_rows


def islands_of(state: State) -> np.ndarray:
    """Return the island of each circle of a state with contacts, (n,): the smallest index of a circle in the island."""
    parent = np.empty(state.bodies.count, np.int64)
    unite(state.contacts.body_a, state.contacts.body_b, parent)
    return np.array([root_of(parent, i) for i in range(parent.size)], np.int64)
