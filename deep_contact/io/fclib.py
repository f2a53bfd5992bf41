"""Contact problems of other programs: Siconos's text files (fc2d), which are read, and FCLIB's HDF5, read and written.

Both hold Delassus' operator W, the velocities q without reactions and μ; with two rows a contact, normal first, they
are A, b and friction of a `ContactProblem`, without bodies. `read_problem` knows which it is.

fc2d (Siconos, `frictionContactProblem_newFromFile`): numbers apart by white space: the dimension, 2; the number of
contacts; the storage of W (0 dense, by columns; 2 sparse, as CSparse prints it, "col j : locations …" and lines
"i : value"); rows and columns; W; q; μ. Anything may be compressed by gzip.

FCLIB (Acary et al., `fclib_write_local`): group `fclib_local` with the integer `spacedim`, group `W` (`nzmax`, `m`,
`n`, `nz`, `p`, `i`, `x`; nz = −1 compressed columns, −2 compressed rows, otherwise triplets: p rows, i columns) and
group `vectors` (`q`, `mu`). Impulses to start from are a guess, which is written and not read: group `guesses` with
`number_of_guesses`, and `r` in the group of each, which are named 1, 2, ….
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import h5py
import numpy as np
from scipy import sparse

from deep_contact.io import hdf5
from deep_contact.io.files import read_bytes, replacing
from deep_contact.physics.lcp import ContactProblem, check_problem, contact_problem, finite
from deep_contact.state import State
from deep_contact.validation import expect

MAX_TEXT, MAX_BYTES = 2**26, 2**28
"""Bytes of the largest text, and of all arrays of the largest HDF5 file, unpacked: 80,000 and 700,000 contacts."""

_SIZES = re.compile(r"\s*(\d+)-by-(\d+), nzmax: (-?\d+) nnz: (\d+)")
_COLUMN = re.compile(r"\s*col (\d+) : locations (-?\d+) to (-?\d+)\s*$")


def read_problem(path: str | os.PathLike) -> ContactProblem:
    """The contact problem of an fc2d file, plain or gzipped, or of an FCLIB file.

    Raises ValueError with the path, and what was expected and found, and OSError where the file cannot be opened.
    """
    path = Path(path)
    if path.is_file() and h5py.is_hdf5(path):
        with hdf5.opened(path) as file:
            return _read_fclib(file)
    text = read_bytes(path, MAX_TEXT)
    try:
        return _read_fc2d(text.decode("ascii", errors="replace").split("\n"))
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{path}: {error}") from error


def write_fclib(path: str | os.PathLike, problem: ContactProblem | State, *, guess: np.ndarray | None = None) -> Path:
    """Write a problem, or that of a state, as a local problem of FCLIB. Returns the path.

    guess: impulses to start from, (2 m,), N·s; by default those that a state starts from, and none of a problem.
    """
    if guess is None and isinstance(problem, State) and problem.contacts is not None:
        guess = np.column_stack([problem.contacts.normal_start, problem.contacts.tangent_start]).ravel()
    problem = check_problem(contact_problem(problem) if isinstance(problem, State) else problem)
    A = sparse.csc_array(problem.A)
    A.sort_indices()
    arrays = {
        "fclib_local/spacedim": np.array([2], np.int32),
        "fclib_local/vectors/q": problem.b,
        "fclib_local/vectors/mu": problem.friction,
        "fclib_local/W/p": A.indptr.astype(np.int32),
        "fclib_local/W/i": A.indices.astype(np.int32),
        "fclib_local/W/x": A.data,
    }
    for name, value in (("nzmax", A.nnz), ("m", A.shape[0]), ("n", A.shape[1]), ("nz", -1)):
        arrays[f"fclib_local/W/{name}"] = np.array([value], np.int32)
    if guess is not None:
        arrays["guesses/number_of_guesses"] = np.array([1], np.int32)
        arrays["guesses/1/r"] = finite("guess", guess, problem.b.shape)
    size = sum(array.nbytes for array in arrays.values())
    expect(size <= MAX_BYTES, f"problem: expected at most {MAX_BYTES} bytes, got {size}")
    with replacing(path) as temporary, h5py.File(temporary, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array)
    return Path(path)


def _read_fc2d(lines: list[str]) -> ContactProblem:
    dimension, contacts, storage, rows, columns = _header(lines)
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


def _header(lines: list[str]) -> list[int]:
    """The five integers before W, each on a line of its own."""
    found = []
    for name, line in zip(("dimension", "number of contacts", "storage of W", "rows", "columns"), [*lines, *[""] * 5]):
        expect(re.fullmatch(r"\s*\d{1,9}\s*", line), f"{name}: expected an integer, got {line[:40]!r}")
        found.append(int(line))
    return found


def _printed_by_csparse(lines: list[str], rows: int) -> tuple[sparse.csc_array, int]:
    """The matrix of CSparse's print, and the line after it. A title may stand before its sizes."""
    found = ((at, match) for at, line in enumerate(lines[5:9], 5) if (match := _SIZES.match(line)))
    at, sizes = next(found, (0, None))
    expect(sizes, "W: expected CSparse's print, 'r-by-c, nzmax: … nnz: …', within 3 lines of line 6")
    is_square = (int(sizes[1]), int(sizes[2])) == (rows, rows)
    expect(is_square, f"W: expected {rows} rows and columns, got {sizes[1]} and {sizes[2]}")
    end, wanted = at + 1 + rows + int(sizes[4]), f"W: expected {rows} columns and {sizes[4]} entries, got "
    expect(len(lines) >= end, f"{wanted}{len(lines) - at - 1} lines")
    starts, indices, data = [], [], []
    for number, line in enumerate(lines[at + 1 : end], at + 2):
        if column := _COLUMN.match(line):
            follows = (int(column[1]), int(column[2])) == (len(starts), len(data))
            expected = f"column {len(starts)} with entries from {len(data)}"
            expect(follows, f"line {number}: expected {expected}, got {line[:60]!r}")
            starts.append(len(data))
            continue
        row, _, value = line.partition(":")
        try:
            indices.append(int(row))
            data.append(float(value))
        except ValueError:
            raise ValueError(f"line {number}: expected 'row : value', got {line[:60]!r}") from None
        expect(0 <= indices[-1] < rows, f"line {number}: expected a row from 0 to {rows - 1}, got {indices[-1]}")
    expect((len(starts), len(data)) == (rows, int(sizes[4])), f"{wanted}{len(starts)} and {len(data)}")
    return sparse.csc_array((data, indices, [*starts, len(data)]), shape=(rows, rows)), end


def _numbers(lines: list[str], count: int) -> np.ndarray:
    words = " ".join(lines).split()
    expect(len(words) == count, f"W, q and μ: expected {count} numbers to the end of the file, got {len(words)}")
    try:
        numbers = np.array(words, np.float64)
    except ValueError as error:
        raise ValueError(f"W, q and μ: expected numbers: {str(error)[:80]}") from None
    return finite("W, q and μ", numbers, (count,))


def _read_fclib(file: h5py.File) -> ContactProblem:
    expect("fclib_local" in file, f"expected the group fclib_local, got {sorted(file)[:8]}")
    names = ("spacedim", "W/m", "W/n", "W/nz", "W/p", "W/i", "W/x", "vectors/q", "vectors/mu")
    arrays = hdf5.read({name: hdf5.dataset(file, f"fclib_local/{name}") for name in names}, MAX_BYTES)
    is_alone = "V" not in file["fclib_local"]
    expect(is_alone, "V, R: expected a problem of contacts alone, got one with bilateral constraints")
    spacedim, rows, columns, kind = (_integer(name, arrays[name]) for name in names[:4])
    p, i = (_integers(name, arrays[name]) for name in ("W/p", "W/i"))
    x, q, mu = (arrays[name].astype(np.float64) for name in ("W/x", "vectors/q", "vectors/mu"))
    expect(spacedim == 2, f"spacedim: expected 2, got {spacedim}")
    expect(rows == columns and rows >= 0, f"W: expected as many rows as columns, got {rows} and {columns}")
    expect(q.shape == (rows,), f"vectors/q: expected {rows} numbers, as W has rows, got shape {q.shape}")
    expect(kind >= -2, f"W/nz: expected -2 (rows), -1 (columns) or a number of triplets, got {kind}")
    if kind < 0:
        rise = p.shape == (rows + 1,) and p[0] == 0 and (np.diff(p) >= 0).all() and p[-1] <= len(i) == len(x)
        expect(rise, f"W/p: expected {rows + 1} offsets from 0 to at most {len(x)} in rising order")
        make, used, indices = sparse.csc_array if kind == -1 else sparse.csr_array, p[-1], {"W/i": i}
    else:
        as_many = p.shape == i.shape == x.shape and p.ndim == 1
        expect(as_many, f"W/p, W/i, W/x: expected as many of each, got {p.shape}, {i.shape} and {x.shape}")
        make, used, indices = sparse.coo_array, kind, {"W/p": p, "W/i": i}
    for name, index in indices.items():
        least, most = index[:used].min(initial=0), index[:used].max(initial=0)
        fit = least >= 0 and most < max(rows, 1)
        expect(fit, f"{name}: expected indices from 0 to {rows - 1}, got {least} to {most}")
    given = (x[:used], (p[:used], i[:used])) if kind >= 0 else (x[:used], i[:used], p)
    return check_problem(ContactProblem(sparse.csr_array(make(given, shape=(rows, rows))), q, friction=mu))


def _integer(name: str, array: np.ndarray) -> int:
    expect(array.size == 1, f"{name}: expected an integer, got {array.dtype}, {array.shape}")
    return int(_integers(name, array).ravel()[0])


def _integers(name: str, array: np.ndarray) -> np.ndarray:
    """The array with signs: differences of unsigned integers are never negative, whatever the offsets are."""
    fits = array.dtype.kind in "iu" and array.max(initial=0) < 2**63
    expect(fits, f"{name}: expected an integer, got {array.dtype}, {array.shape}")
    return array.astype(np.int64)
