"""Results files, by the contract of the figures: six fields, strict JSON, whole, checked when written and read."""

import copy
import json
import re

import numpy as np
import pytest

from deep_contact.figures import results
from deep_contact.figures.results import Claim
from deep_contact.io.json_data import ResultsError

GOOD = {
    "id": "3.7",
    "title": "Convergence",
    "options": {"steps": 600, "starts": ["none", "copy"]},
    "provenance": {
        "version": "0.1.0",
        "commit": "0" * 40,
        "python": "3.11.7",
        "packages": {"numpy": "2.0.0"},
        "cpu": "any, 2 cores",
        "seed": 0,
        "wall_s": 1.5,
    },
    "claims": [{"text": "Copy needs none", "thesis": "section 3.4.1", "holds": True, "measured": {"sweeps": 0}}],
    "data": {"theta": [1.0, 0.1], "missing": [1, None]},
}
BAD = {
    "id": "figure 3.7",
    "title": " ",
    "options": [],
    "data": None,
    "claims": {},
    "provenance.commit": "abc",
    "provenance.seed": 0.5,
    "provenance.wall_s": -1,
    "provenance.packages": {"numpy": 2},
    "provenance.cpu": "",
    "claims.0.text": "",
    "claims.0.holds": 1,
    "claims.0.measured": {},
    "claims.0.verdict": " ",
    "provenance.inputs": {"models/model.h5": "abc"},
}


NO_PLACES = ("L669", "page 3", "section", "section 3.4.1,", "Eq")


def changed(place, value):
    """A copy of GOOD with one field set."""
    found = copy.deepcopy(GOOD)
    *parents, last = place.split(".")
    target = found
    for key in parents:
        target = target[int(key)] if key.isdigit() else target[key]
    target[last] = value
    return found


@pytest.mark.parametrize(("place", "value"), [*BAD.items(), *(("claims.0.thesis", bad) for bad in NO_PLACES)])
def test_a_bad_field_is_refused_by_its_name(place, value):
    name = place.replace(".0.", "[0].")
    with pytest.raises(ResultsError, match=rf"^{re.escape(name)}\b.*: expected .*, got "):
        results.check_results(changed(place, value))


@pytest.mark.parametrize("name", GOOD)
def test_a_missing_and_an_unknown_field_are_refused(name):
    missing = {key: value for key, value in GOOD.items() if key != name}
    for found in (missing, GOOD | {"colour": "red"}):
        with pytest.raises(ResultsError, match="expected an object with the fields id, title"):
            results.check_results(found)


def test_what_is_written_is_read_back_to_the_last_bit(tmp_path):
    """Claims by the names of their fields."""
    claim = Claim("Builtin like None", "section 3.4.1", None, {"ratio": np.float64(0.3)}, "within the noise")
    numbers = np.random.default_rng(0).normal(size=(3, 4)) * 10.0 ** np.arange(-8, 4).reshape(3, 4)
    data = {"numbers": numbers, "scalar": np.float64(0.1), "count": np.int64(7), "flag": np.bool_(True), "none": None}
    path = results.write_results(tmp_path / "new" / "figure_3_7.json", GOOD | {"data": data, "claims": [claim]})
    assert results.read_results(path)["claims"] == [claim._asdict()]
    found = results.read_results(path)["data"]
    np.testing.assert_array_equal(np.array(found["numbers"]), numbers)
    assert [found["scalar"], found["count"], found["flag"], found["none"]] == [0.1, 7, True, None]


def test_digits_round_arrays_of_floats_and_nothing_else():
    data = {"curve": np.array([np.pi, 1e-9 * np.pi]), "scalar": np.pi, "counts": np.array([1234567])}
    found = results.plain(data, digits=3)
    assert found == {"curve": [3.14, 3.14e-9], "scalar": np.pi, "counts": [1234567]}
    x = np.random.default_rng(1).lognormal(sigma=20, size=1000)
    rounded = np.array(results.plain(x, digits=6))
    assert (np.abs(rounded / x - 1) <= 5.0001e-6).all()  # half a unit of the sixth digit, of a number 1.00000…


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused_with_their_place(bad):
    with pytest.raises(ResultsError, match=r"data\.theta\[1\]\[0\]: expected"):
        results.plain({"theta": np.array([[0.0], [bad]])})
    with pytest.raises(ResultsError, match=r"data\.runs\[1\]: expected"):
        results.plain({"runs": [1.0, bad]})


@pytest.mark.parametrize("bad", [object(), {1, 2}, b"bytes", np.array([1j]), {3: 4}])
def test_what_json_does_not_know_is_refused(bad):
    with pytest.raises(ResultsError, match=r"data\.thing"):
        results.plain({"thing": bad})


PARTLY = {"text": "near", "holds": None, "verdict": "holds, sweeps 1 to 2; does not hold, sweeps 4 to 28"}
FULL = {"claims": [{"text": "faster, 100 circles", "holds": True}, PARTLY]}


@pytest.mark.parametrize(
    ("text", "holds", "own", "beside", "expected"),
    [
        ("", True, None, None, "holds"),
        ("", False, None, None, "does not hold"),
        ("", None, None, None, "open"),
        ("", True, "holds, sweeps 1 to 180", None, "holds, sweeps 1 to 180"),
        ("faster, 60 circles", True, None, FULL, "as in the reference run, holds"),
        ("faster, 60 circles", False, None, FULL, "too few states to tell (reference run: holds)"),
        ("near", True, None, FULL, "too few states to tell (reference run: holds in part)"),
        ("slower", False, None, FULL, "too few states to tell"),
    ],
)
def test_a_verdict_is_the_claims_own_and_that_of_a_quick_run_never_contradicts_the_reference(
    text, holds, own, beside, expected
):
    assert results.verdict({"text": text, "holds": holds, "verdict": own}, beside) == expected


LARGE = json.dumps(GOOD).replace("0.1]", "1e999]")  # too large for a float


@pytest.mark.parametrize(
    "text", ["", "{", '{"id": NaN}', "[" * 100_000, "[1, 2]", json.dumps(GOOD)[:-2], "\xff", LARGE]
)
def test_a_file_that_is_not_a_results_file_is_refused_by_name(tmp_path, text):
    path = tmp_path / "broken.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ResultsError, match=r"^broken\.json: "):
        results.read_results(path)
