"""The tables of arguments on the site's pages, by `docs/reference.py`."""

import re
import sys

import pytest
from conftest import ROOT

import deep_contact as dc
from deep_contact import lazy

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


def public_parts(package):
    """Public names with their objects, and those of the functions and classes in public classes and modules."""
    for public, (module, name) in lazy.homes(dc.__file__).items():
        found = package[f"{module}.{name}".removeprefix("deep_contact.")]
        yield public, found
        for part, one in found.members.items() if found.is_class or found.is_module else ():
            if not part.startswith("_") and not one.is_alias:
                yield f"{public}.{part}", one


def test_every_argument_of_a_public_name_has_a_meaning(package):
    """The rows of the tables on the pages of public names: none is empty, as that of `state` once was."""
    rows = []
    for label, one in public_parts(package):
        text = one.docstring.value if one.docstring else ""
        rows += [(label, *row) for row in re.findall(r"^\| `(\**\w+)` \| (.*?) \| ", text, re.MULTILINE)]
    assert len(rows) > 350
    assert [row[:2] for row in rows if not row[2].strip()] == []


def test_arguments_with_a_default_have_a_type(package):
    """Without an annotation, pyright takes the type of the default, and refuses a list of radii."""
    parameters = [
        (label, one.name, one.default, one.annotation)
        for label, found in public_parts(package)
        if found.is_function or found.is_class
        for one in found.parameters
        if one.default not in (None, "None") and not one.kind.value.startswith("variadic")
    ]
    assert len(parameters) > 150
    assert [one[:3] for one in parameters if one[3] is None] == []


def test_the_nearest_class_tells_the_meaning_of_an_argument():
    def table(text, *bases):
        parameters = [griffe.Parameter(name, kind=griffe.ParameterKind.keyword_only) for name in ("one", "two")]
        return re.findall(r"^\| `\w+` \| (.*?) \| ", reference.documented(text, parameters, bases), re.MULTILINE)

    assert table("A.\n\none: mine. two: see `Base`.", "B.\n\none: near. two: near.", "C.\n\ntwo: far.") == [
        "mine",
        "near",
    ]
    assert table("A.", "B.\n\none: near.", "C.\n\none: far. two: far.") == ["near", "far"]
