"""Contact problems of other programs: Siconos's text files (fc2d) and FCLIB's HDF5, planar with friction.

Both hold Delassus' operator W, the velocities q without reactions and μ; with two rows a contact, normal first, they
are A, b and friction of a `ContactProblem`, without bodies. `read_problem` knows which it is.

fc2d (Siconos, `frictionContactProblem_newFromFile`): numbers apart by white space: the dimension, 2; the number of
contacts; the storage of W (0 dense, by columns; 2 sparse, as CSparse prints it, "col j : locations …" and lines
"i : value"); rows and columns; W; q; μ. Anything may be compressed by gzip.

FCLIB (Acary et al., `fclib_write_local`): group `fclib_local` with the integer `spacedim`, group `W` (`nzmax`, `m`,
`n`, `nz`, `p`, `i`, `x`; nz = −1 compressed columns, −2 compressed rows, otherwise triplets: p rows, i columns) and
group `vectors` (`q`, `mu`). Impulses to start from are a guess: group `guesses` with `number_of_guesses`, and `r` in
the group of each, which are named 1, 2, ….
"""

from __future__ import annotations

import gzip
import math
import os
import re
from pathlib import Path

import h5py
import numpy as np
from scipy import sparse

from deep_contact.io.files import replacing
from deep_contact.physics.lcp import ContactProblem, check_problem, contact_problem, finite
from deep_contact.state import State

MAX_BYTES = 2**31
"""Largest text, or HDF5 array, that is read, unpacked."""

DENSE, SPARSE = 0, 2
"""Storage of W in an fc2d file."""

_COLUMN = re.compile(r"\s*col (\d+) : locations (-?\d+) to (-?\d+)\s*$")


def read_problem(path: str | os.PathLike) -> ContactProblem:
    """The contact problem of an fc2d file, plain or gzipped, or of an FCLIB file.

    Raises ValueError with the path, and what was expected and found, and OSError where the file cannot be opened.
    """
    path = Path(path)
    with path.open("rb") as file:
        begin = file.read(8)
    try:
        return _read_fclib(path) if begin == b"\x89HDF\r\n\x1a\n" else _read_fc2d(path, zipped=begin[:2] == b"\x1f\x8b")
    except (ValueError, KeyError, IndexError, EOFError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from error


def read_guess(path: str | os.PathLike) -> np.ndarray | None:
    """The first guess of λ in an FCLIB file, (2 m,), N·s; None if there is none. Raises ValueError and OSError."""
    with h5py.File(path, "r") as file:
        return np.array(_array(file, "guesses/1/r"), np.float64) if "guesses/1/r" in file else None


def write_fc2d(path: str | os.PathLike, problem: ContactProblem | State) -> Path:
    """Write a problem, or that of a state, as Siconos's text; gzipped where the path ends so. Returns the path.

    Numbers have 17 digits, so that reading returns the same bits; Siconos's own files have 6 in W.
    """
    problem, path = _checked(problem), Path(path)
    A = sparse.csc_array(problem.A)
    A.sort_indices()
    rows = A.shape[0]
    lines = [str(2), str(rows // 2), str(SPARSE), str(rows), str(rows)]
    lines += ["CSparse Version 3.1.9"]
    lines += [f"{rows}-by-{rows}, nzmax: {A.nnz} nnz: {A.nnz}, 1-norm: {sparse.linalg.norm(A, 1) if A.nnz else 0:.6g}"]
    for j in range(rows):
        first, last = A.indptr[j], A.indptr[j + 1]
        lines.append(f"    col {j} : locations {first} to {last - 1}")
        lines += [f"      {i} : {value!r}" for i, value in zip(A.indices[first:last], A.data[first:last].tolist())]
    lines += [" ".join(map(repr, values.tolist())) for values in (problem.b, problem.friction)]
    text = ("\n".join(lines) + "\n").encode()
    with replacing(path) as temporary:
        temporary.write_bytes(gzip.compress(text, mtime=0) if path.suffix == ".gz" else text)
    return path


def write_fclib(path: str | os.PathLike, problem: ContactProblem | State, *, guess: np.ndarray | None = None) -> Path:
    """Write a problem, or that of a state, as a local problem of FCLIB. Returns the path.

    guess: impulses to start from, (2 m,), N·s; by default those that a state starts from, and none of a problem.
    """
    if guess is None and isinstance(problem, State) and problem.contacts is not None:
        guess = np.column_stack([problem.contacts.normal_start, problem.contacts.tangent_start]).ravel()
    problem, path = _checked(problem), Path(path)
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
    with replacing(path) as temporary, h5py.File(temporary, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array)
    return path


def _checked(problem: ContactProblem | State) -> ContactProblem:
    return check_problem(contact_problem(problem) if isinstance(problem, State) else problem)


def _read_fc2d(path: Path, *, zipped: bool) -> ContactProblem:
    with gzip.open(path) if zipped else path.open("rb") as file:
        text = file.read(MAX_BYTES + 1)
    if len(text) > MAX_BYTES:
        raise ValueError(f"expected at most {MAX_BYTES} bytes of text, got more")
    lines = text.decode("ascii", errors="replace").split("\n")
    dimension, contacts, storage, rows, columns = _header(lines)
    if dimension != 2:
        raise ValueError(f"dimension: expected 2, got {dimension}")
    if rows != 2 * contacts or columns != rows:
        raise ValueError(f"W: expected {2 * contacts} rows and columns, two a contact, got {rows} and {columns}")
    if storage not in (DENSE, SPARSE):
        raise ValueError(f"storage of W: expected {DENSE} (dense) or {SPARSE} (sparse), got {storage}")
    if storage == DENSE:
        numbers = _numbers(lines[5:], rows * rows + rows + contacts)
        W, rest = numbers[: rows * rows].reshape(rows, rows, order="F"), numbers[rows * rows :]
    else:
        W, end = _printed_by_csparse(lines, 5, rows)
        rest = _numbers(lines[end:], rows + contacts)
    return check_problem(ContactProblem(sparse.csr_array(W), rest[:rows], friction=rest[rows:]))


def _header(lines: list[str]) -> list[int]:
    """The five integers before W, each on a line of its own."""
    found = []
    for name, line in zip(("dimension", "number of contacts", "storage of W", "rows", "columns"), [*lines, *[""] * 5]):
        if not re.fullmatch(r"\s*\d{1,9}\s*", line):
            raise ValueError(f"{name}: expected an integer, got {line[:40]!r}")
        found.append(int(line))
    return found


def _printed_by_csparse(lines: list[str], begin: int, rows: int) -> tuple[sparse.csc_array, int]:
    """The matrix of CSparse's print, and the line after it. A title may stand before its sizes."""
    sizes, at = None, begin
    while sizes is None:
        if at == len(lines) or at > begin + 3:
            raise ValueError(
                f"W: expected CSparse's print, 'r-by-c, nzmax: … nnz: …', within 3 lines of line {begin + 1}"
            )
        sizes = re.match(r"\s*(\d+)-by-(\d+), nzmax: (-?\d+) nnz: (\d+)", lines[at])
        at += 1
    count = int(sizes[4])
    if (int(sizes[1]), int(sizes[2])) != (rows, rows):
        raise ValueError(f"W: expected {rows} rows and columns, got {sizes[1]} and {sizes[2]}")
    if rows + count > len(lines) - at:
        raise ValueError(f"W: expected {rows} columns and {count} entries, got {len(lines) - at} lines")
    indptr, indices, data = np.zeros(rows + 1, np.int64), np.empty(count, np.int64), np.empty(count)
    done = 0
    for j in range(rows):
        column = _COLUMN.match(lines[at])
        if column is None or int(column[1]) != j or int(column[2]) != done:
            raise ValueError(f"line {at + 1}: expected column {j} with entries from {done}, got {lines[at][:60]!r}")
        last = int(column[3]) + 1
        if not done <= last <= count:
            raise ValueError(f"line {at + 1}: expected at most {count} entries, got {last}")
        at += 1
        for k in range(done, last):
            row, _, value = lines[at].partition(":")
            try:
                indices[k], data[k] = int(row), float(value)
            except ValueError:
                raise ValueError(f"line {at + 1}: expected 'row : value', got {lines[at][:60]!r}") from None
            if not 0 <= indices[k] < rows:
                raise ValueError(f"line {at + 1}: expected a row from 0 to {rows - 1}, got {indices[k]}")
            at += 1
        indptr[j + 1] = done = last
    if done != count:
        raise ValueError(f"W: expected {count} entries, got {done}")
    return sparse.csc_array((data, indices, indptr), shape=(rows, rows)), at


def _numbers(lines: list[str], count: int) -> np.ndarray:
    words = " ".join(lines).split()
    if len(words) != count:
        raise ValueError(f"q and μ: expected {count} numbers to the end of the file, got {len(words)}")
    values = [_number(word) for word in words]
    return np.array(values, np.float64)


def _number(word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"q and μ: expected finite numbers, got {word[:40]!r}")
    return value


def _read_fclib(path: Path) -> ContactProblem:
    with h5py.File(path, "r") as file:
        if "fclib_local" not in file:
            raise ValueError(f"expected the group fclib_local, got {sorted(file)[:8]}")
        local = file["fclib_local"]
        spacedim = _integer(local, "spacedim")
        if spacedim != 2:
            raise ValueError(f"spacedim: expected 2, got {spacedim}")
        if "V" in local:
            raise ValueError("V, R: expected a problem of contacts alone, got one with bilateral constraints")
        rows, columns, kind = (_integer(local, f"W/{name}") for name in ("m", "n", "nz"))
        if rows != columns or rows < 0:
            raise ValueError(f"W: expected as many rows as columns, got {rows} and {columns}")
        p, i, x = (_array(local, f"W/{name}") for name in "pix")
        q, mu = (_array(local, f"vectors/{name}") for name in ("q", "mu"))
    if kind in (-1, -2):
        if p.shape != (rows + 1,) or p[0] != 0 or (np.diff(p) < 0).any() or p[-1] > len(i) or len(i) != len(x):
            raise ValueError(f"W/p: expected {rows + 1} offsets from 0 to at most {len(x)} in rising order")
        i, x = i[: p[-1]], x[: p[-1]]
        if i.size and not (0 <= i.min() and i.max() < rows):
            raise ValueError(f"W/i: expected indices from 0 to {rows - 1}, got {i.min()} to {i.max()}")
        make = sparse.csc_array if kind == -1 else sparse.csr_array
        W = make((x, i.astype(np.int64), p.astype(np.int64)), shape=(rows, rows))
    elif kind >= 0:
        W = sparse.coo_array((x[:kind], (p[:kind], i[:kind])), shape=(rows, rows))
    else:
        raise ValueError(f"W/nz: expected -2 (rows), -1 (columns) or a number of triplets, got {kind}")
    return check_problem(ContactProblem(sparse.csr_array(W), q, friction=mu))


def _integer(group: h5py.Group, name: str) -> int:
    value = _array(group, name)
    if value.size != 1 or not np.issubdtype(value.dtype, np.integer):
        raise ValueError(f"{name}: expected an integer, got {value.dtype}, {value.shape}")
    return int(value.ravel()[0])


def _array(group: h5py.Group, name: str) -> np.ndarray:
    """A numeric dataset, in memory once its declared size is known to be bearable."""
    data = group[name]
    if not isinstance(data, h5py.Dataset) or data.dtype.kind not in "iuf" or data.nbytes > MAX_BYTES:
        raise ValueError(f"{name}: expected numbers of at most {MAX_BYTES} bytes, got {data!r}")
    return data[()]
