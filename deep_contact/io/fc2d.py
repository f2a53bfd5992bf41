"""Contact problems of Siconos: `read_problem` reads its text files (fc2d), plain or gzipped.

A file holds Delassus' operator W, the velocities q without reactions and μ; with two rows a contact, normal first, they
are A, b and friction of a `ContactProblem`, without bodies. (Siconos, `frictionContactProblem_newFromFile`.) Numbers
apart by white space: the dimension, 2; the number of contacts; the storage of W (0 dense, by columns; 2 sparse, as
CSparse prints it, "col j : locations …" and lines "i : value"); rows and columns; W; q; μ.
"""

from __future__ import annotations

import os
import re

import numpy as np
from scipy import sparse

from deep_contact.io.files import read_bytes
from deep_contact.physics.lcp import ContactProblem, check_problem
from deep_contact.validation import expect, floats

MAX_TEXT = 2**26
"""Bytes of the largest file, unpacked: 80,000 contacts."""

_HEADER = ("dimension", "number of contacts", "storage of W", "rows", "columns")
_SIZES = re.compile(r"\s*(\d+)-by-(\d+), nzmax: -?\d+ nnz: (\d+)")
_COLUMN = re.compile(r"\s*col (\d{1,9}) : locations")
_ENTRY = re.compile(r"\s*(\d{1,9}) : (\S+)\s*$")


def read_problem(path: str | os.PathLike) -> ContactProblem:
    """The contact problem of a file.

    Raises ValueError with the path, what was expected and what came, and OSError where the file cannot be opened.
    """
    text = read_bytes(path, MAX_TEXT)
    try:
        return _parse(text.decode("ascii", errors="replace").split("\n"))
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from error


def _parse(lines: list[str]) -> ContactProblem:
    for name, line in zip(_HEADER, [*lines, *[""] * 5]):
        expect(re.fullmatch(r"\s*\d{1,9}\s*", line), f"{name}: expected an integer, got {line[:40]!r}")
    dimension, contacts, storage, rows, columns = map(int, lines[:5])
    expect(dimension == 2, f"dimension: expected 2, got {dimension}")
    wanted = f"W: expected {2 * contacts} rows and columns, two a contact, got {rows} and {columns}"
    expect(rows == columns == 2 * contacts, wanted)
    expect(storage in (0, 2), f"storage of W: expected 0 (dense) or 2 (sparse), got {storage}")
    if storage == 0:
        numbers = _numbers(lines[5:], rows * rows + rows + contacts)
        W, rest = numbers[: rows * rows].reshape(rows, rows, order="F"), numbers[rows * rows :]
    else:
        W, end = _printed_by_csparse(lines, rows)
        rest = _numbers(lines[end:], rows + contacts)
    return check_problem(ContactProblem(sparse.csr_array(W), rest[:rows], friction=rest[rows:]))


def _printed_by_csparse(lines: list[str], rows: int) -> tuple[sparse.coo_array, int]:
    """The matrix of CSparse's print, and the line after it. A title may stand before its sizes."""
    titles = ((at, match) for at, line in enumerate(lines[5:9], 5) if (match := _SIZES.match(line)))
    at, sizes = next(titles, (0, None))
    expect(sizes, "W: expected CSparse's print, 'r-by-c, nzmax: … nnz: …', within 3 lines of line 6")
    end, columns, entries = at + 1, 0, []
    for end, line in enumerate(lines[at + 1 :], at + 1):
        if match := _COLUMN.match(line):
            expect(int(match[1]) == columns, f"line {end + 1}: expected column {columns}, got {line[:60]!r}")
            columns += 1
        elif match := _ENTRY.match(line):
            expect(int(match[1]) < rows, f"line {end + 1}: expected a row from 0 to {rows - 1}, got {match[1]}")
            try:
                entries.append((int(match[1]), columns - 1, float(match[2])))
            except ValueError:
                raise ValueError(f"line {end + 1}: expected 'row : value', got {line[:60]!r}") from None
        else:
            break
    height, width, count = map(int, sizes.groups())
    got = f"{height} and {width}, {columns} columns with {len(entries)} entries"
    fits = height == width == columns == rows and len(entries) == count
    expect(fits, f"W: expected {rows} rows and columns with {count} entries, got {got}")
    i, j, values = np.reshape(entries, (-1, 3)).T
    return sparse.coo_array((values, (i.astype(int), j.astype(int))), shape=(rows, rows)), end


def _numbers(lines: list[str], count: int) -> np.ndarray:
    words = " ".join(lines).split()
    expect(len(words) == count, f"W, q and μ: expected {count} numbers to the end of the file, got {len(words)}")
    try:
        numbers = np.array(words, np.float64)
    except ValueError as error:
        raise ValueError(f"W, q and μ: expected numbers: {str(error)[:80]}") from None
    return floats("W, q and μ", numbers, (count,))
