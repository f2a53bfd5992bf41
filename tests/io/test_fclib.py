"""fc2d and FCLIB files: problems come back bit for bit, foreign files are read, bad ones name what is wrong."""

import gzip

import h5py
import numpy as np
import pytest
from scipy import sparse

from deep_contact.io.fclib import read_problem, write_fclib
from deep_contact.physics.lcp import ContactProblem, contact_problem

# By hand, as CSparse prints it: two contacts that share a body.
TEXT = """2
2
2
4
4
CSparse Version 3.1.9, May 4, 2016.  Copyright (c) Timothy A. Davis, 2006-2016
4-by-4, nzmax: 6 nnz: 6, 1-norm: 4.5
    col 0 : locations 0 to 1
      0 : 2
      2 : -0.5
    col 1 : locations 2 to 2
      1 : 3
    col 2 : locations 3 to 4
      0 : -0.5
      2 : 4
    col 3 : locations 5 to 5
      3 : 1.5
 -1.0e+00  2.5e-01 -3.0e+00 0
 5.0e-01 2.0e-01
"""
W = np.array([[2, 0, -0.5, 0], [0, 3, 0, 0], [-0.5, 0, 4, 0], [0, 0, 0, 1.5]])


def check_equal(problem, A, b, friction):
    np.testing.assert_array_equal(problem.A.toarray(), A)
    np.testing.assert_array_equal(problem.b, b)
    np.testing.assert_array_equal(problem.friction, friction)


@pytest.mark.parametrize("zipped", [False, True])
def test_a_file_of_siconos(tmp_path, zipped):
    path = tmp_path / "two.dat"
    path.write_bytes(gzip.compress(TEXT.encode()) if zipped else TEXT.encode())
    check_equal(read_problem(path), W, [-1.0, 0.25, -3.0, 0.0], [0.5, 0.2])
    # Dense, by columns: the second number is W[1, 0].
    path.write_text("2\n1\n0\n2\n2\n2.0 0.5\n0.25 1.0\n-1 0\n0.3\n")
    check_equal(read_problem(path), [[2.0, 0.25], [0.5, 1.0]], [-1.0, 0.0], [0.3])


def test_states_come_back_bit_for_bit(tmp_path, falling_states):
    expected = contact_problem(falling_states[9])
    found = read_problem(write_fclib(tmp_path / "pile.hdf5", falling_states[9]))
    check_equal(found, expected.A.toarray(), expected.b, expected.friction)
    assert found.jacobian is None


def test_the_start_of_a_state_is_a_guess(tmp_path, falling_states):
    contacts = falling_states[9].contacts
    assert contacts.normal_start.any()
    with h5py.File(write_fclib(tmp_path / "pile.hdf5", falling_states[9])) as file:
        assert (file["guesses/number_of_guesses"][0], len(file["guesses"])) == (1, 2)
        np.testing.assert_array_equal(file["guesses/1/r"][0::2], contacts.normal_start)
        np.testing.assert_array_equal(file["guesses/1/r"][1::2], contacts.tangent_start)
    with h5py.File(write_fclib(tmp_path / "pile.hdf5", contact_problem(falling_states[9]))) as file:
        assert "guesses" not in file


@pytest.mark.parametrize(("kind", "make"), [(-1, sparse.csc_array), (-2, sparse.csr_array), (None, sparse.coo_array)])
def test_all_storages_of_fclib(tmp_path, kind, make):
    path = tmp_path / "problem.hdf5"
    write_fclib(path, ContactProblem(sparse.csr_array(np.eye(4)), np.zeros(4), friction=np.ones(2)))
    A = make(W)
    nz, p, i = (A.nnz, *A.coords) if kind is None else (kind, A.indptr, A.indices)
    with h5py.File(path, "r+") as file:
        for name, value in {"nz": [nz], "nzmax": [A.nnz], "p": p, "i": i, "x": A.data}.items():
            del file[f"fclib_local/W/{name}"]
            file[f"fclib_local/W/{name}"] = np.array(value)
    np.testing.assert_array_equal(read_problem(path).A.toarray(), W)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2\n2\n2\n", "3\n2\n2\n", "dimension: expected 2, got 3"),
        ("2\n2\n2\n", "2\n3\n2\n", "W: expected 6 rows and columns, two a contact, got 4 and 4"),
        ("2\n2\n2\n", "2\n2\n1\n", "storage of W: expected 0"),
        ("2\n2\n2\n", "2\nx\n2\n", "number of contacts: expected an integer, got 'x'"),
        ("4-by-4", "5-by-4", "W: expected 4 rows and columns, got 5 and 4"),
        ("nnz: 6", "nnz: 99999999", "W: expected 4 columns and 99999999 entries, got"),
        ("col 1", "col 2", "line 11: expected column 1 with entries from 2, got"),
        ("1 : 3", "1 3", "line 12: expected 'row : value', got"),
        ("1 : 3", "4 : 3", "line 12: expected a row from 0 to 3, got 4"),
        ("1 : 3", "1 : nan", "A: expected finite entries, got nan"),
        ("1 : 3", "1 : -3", r"A\[1, 1\]: expected a number > 0, got -3.0"),
        (" 2.0e-01", "", "expected 6 numbers to the end of the file, got 5"),
        ("2.5e-01", "x", "W, q and μ: expected numbers: .*'x'"),
        ("2.5e-01", "inf", "q and μ.1.: expected a finite number, got inf"),
        ("5.0e-01", "-5.0e-01", r"friction\[0\]: expected a number >= 0, got -0.5"),
        (TEXT, "", "dimension: expected an integer, got ''"),
    ],
)
def test_bad_text_says_where(tmp_path, old, new, message):
    path = tmp_path / "bad.dat"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(ValueError, match=message) as error:
        read_problem(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("fclib_local/spacedim", [3], "spacedim: expected 2, got 3"),
        ("fclib_local/spacedim", [2.0], "spacedim: expected an integer, got float64"),
        ("fclib_local/W/n", [5], "W: expected as many rows as columns, got 4 and 5"),
        ("fclib_local/W/nz", [-3], "W/nz: expected -2"),
        ("fclib_local/W/p", [0, 2, 1, 3, 4], "W/p: expected 5 offsets"),
        ("fclib_local/W/i", [0, 1, 2, 9], "W/i: expected indices from 0 to 3, got 0 to 9"),
        ("fclib_local/vectors/q", [0.0, 1.0], r"vectors/q: expected 4 numbers, as W has rows, got shape \(2,\)"),
        ("fclib_local/vectors/mu", [b"a", b"b"], "vectors/mu: expected numbers"),
        ("fclib_local/V", [0], "V, R: expected a problem of contacts alone"),
    ],
)
def test_bad_hdf5_says_where(tmp_path, name, value, message):
    path = tmp_path / "bad.hdf5"
    write_fclib(path, ContactProblem(sparse.csr_array(np.eye(4)), np.zeros(4), friction=np.ones(2)))
    with h5py.File(path, "r+") as file:
        if name in file:
            del file[name]
        file[name] = np.array(value)
    with pytest.raises(ValueError, match=message):
        read_problem(path)
    with h5py.File(path, "w") as file:
        file["other"] = 1
    with pytest.raises(ValueError, match="expected the group fclib_local, got"):
        read_problem(path)
