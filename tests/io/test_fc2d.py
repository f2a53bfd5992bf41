"""Files of Siconos: problems are read as they are, bad files name what is wrong."""

import gzip

import numpy as np
import pytest

from deep_contact.io.fc2d import MAX_TEXT, read_problem

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
    for found, expected in ((problem.A.toarray(), A), (problem.b, b), (problem.friction, friction)):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("zipped", [False, True])
def test_sparse_and_dense_problems_are_read(tmp_path, zipped):
    path = tmp_path / "two.dat"
    path.write_bytes(gzip.compress(TEXT.encode()) if zipped else TEXT.encode())
    check_equal(read_problem(path), W, [-1.0, 0.25, -3.0, 0.0], [0.5, 0.2])
    # Dense, by columns: the second number is W[1, 0].
    path.write_text("2\n1\n0\n2\n2\n2.0 0.5\n0.25 1.0\n-1 0\n0.3\n")
    check_equal(read_problem(path), [[2.0, 0.25], [0.5, 1.0]], [-1.0, 0.0], [0.3])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2\n2\n2\n", "3\n2\n2\n", "dimension: expected 2, got 3"),
        ("2\n2\n2\n", "2\n3\n2\n", "W: expected 6 rows and columns, two a contact, got 4 and 4"),
        ("2\n2\n2\n", "2\n2\n1\n", "storage of W: expected 0"),
        ("4-by-4", "5-by-4", "W: expected 4 rows and columns with 6 entries, got 5 and 4"),
        ("nnz: 6", "nnz: 99999999", "W: .* with 99999999 entries, got 4 and 4, 4 columns with 6"),
        ("col 1", "col 2", "line 11: expected column 1, got"),
        ("1 : 3", "1 3", "W: .* got 4 and 4, 2 columns with 2 entries"),
        ("1 : 3", "1 : x", "line 12: expected 'row : value', got '.*1 : x'"),
        ("1 : 3", "4 : 3", "line 12: expected a row from 0 to 3, got 4"),
        ("1 : 3", "1 : nan", "A: expected finite entries, got nan"),
        ("1 : 3", "1 : -3", r"A\[1, 1\]: expected a number > 0, got -3.0"),
        ("2.5e-01", "x", "W, q and μ: expected numbers: .*'x'"),
        ("2.5e-01", "inf", "q and μ.1.: expected a finite number, got inf"),
        ("5.0e-01", "-5.0e-01", r"friction\[0\]: expected a number >= 0, got -0.5"),
        (TEXT, "", "dimension: expected an integer, got ''"),
        (" 0 : 2", f" {'9' * 5000} : 2", "W: .* got 4 and 4, 1 columns with 0 entries"),
        ("nnz: 6", f"nnz: {'9' * 5000}", "Exceeds the limit"),
    ],
)
def test_bad_text_says_where(tmp_path, old, new, message):
    path = tmp_path / "bad.dat"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(ValueError, match=message) as error:
        read_problem(path)
    assert str(path) in str(error.value)


def test_what_gzip_packs_is_refused_beyond_the_limit(tmp_path):
    """In one member; `test_state_xml` has many, and damaged ones."""
    path = tmp_path / "zeros.dat"
    path.write_bytes(gzip.compress(bytes(MAX_TEXT + 1), compresslevel=1))
    with pytest.raises(ValueError, match=f"zeros.dat: .* expected at most {MAX_TEXT} bytes"):
        read_problem(path)
