"""The functions of `simd` on NumPy arrays of eight numbers, for runs without the compiler (NUMBA_DISABLE_JIT=1)."""

from __future__ import annotations

import numpy as np

WIDTH = 8

root = np.sqrt
times = np.multiply


def where_less(x, y, then, otherwise):
    return np.where(x < y, then, otherwise)


def any_less(x, y):
    return bool((x < y).any())


def least(x, y):
    return np.where(y < x, y, x)


def most(x, y):
    return np.where(y > x, y, x)


def spread(number):
    return np.full(WIDTH, number)


def spread_like(like, number):
    return np.full_like(like, number)


def doubled(x):
    return np.concatenate([x, x])


def lane(x, i):
    return x[i]


def load(array, i):
    return array.reshape(-1)[WIDTH * i : WIDTH * (i + 1)].copy()


def load_like(like, array, i):
    return array.reshape(-1)[WIDTH * i : WIDTH * i + like.size].copy()


def store(array, i, x):
    array.reshape(-1)[WIDTH * i : WIDTH * i + x.size] = x


def load_rows(rows, index, i):
    return tuple(rows[load(index, i)].T.copy())


def store_rows(rows, index, i, columns):
    rows[load(index, i)] = np.stack(columns, axis=1)


def lowest_zero(mask):
    return next((bit for bit in range(64) if not int(mask) >> bit & 1), 64)
