"""The tables of arguments on the site's pages, by `docs/reference.py`."""

import re
import sys

import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "docs"))
griffe = pytest.importorskip("griffe")
reference = pytest.importorskip("reference")

SOLVERS = ("pgs.PGS", "batched.BatchedPGS", "psor.PSOR", "nncg.NNCG", "nesterov.NesterovPGS")


@pytest.fixture(scope="module")
def package():
    """The package as mkdocstrings reads it, with its docstrings as the site shows them."""
    extensions = griffe.load_extensions("dataclasses", reference.Arguments)
    return griffe.load("deep_contact", search_paths=[str(ROOT)], extensions=extensions)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_solver_has_all_its_options_with_their_meanings_those_of_its_base_too(name, package):
    """They said "see `SolverOptions`", or nothing, and no page has this class."""
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| ", package[f"solvers.{name}"].docstring.value, re.MULTILINE)
    assert {"sweeps", "tolerance", "position_sweeps", "substeps", "most_substeps", "approach", "slop"} <= {*dict(rows)}
    for option, meaning in rows:
        assert len(meaning) > 10, option
        assert "see `" not in meaning, option


def test_the_nearest_class_tells_the_meaning_of_an_argument():
    def table(text, *bases):
        parameters = [griffe.Parameter(name, kind=griffe.ParameterKind.keyword_only) for name in ("one", "two")]
        return re.findall(r"^\| `\w+` \| (.*?) \| ", reference.documented(text, parameters, bases), re.MULTILINE)

    assert table("A.\n\none: mine. two: see `Base`.", "B.\n\none: near. two: near.", "C.\n\ntwo: far.") == [
        "mine",
        "near",
    ]
    assert table("A.", "B.\n\none: near.", "C.\n\none: far. two: far.") == ["near", "far"]
