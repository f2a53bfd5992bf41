"""The packages that each job imports: no job loads a package that it does not need."""

import inspect
import re
from pathlib import Path

import pytest
from conftest import ROOT, run_python

import deep_contact as dc

PACKAGE = Path(dc.__file__).parent
HEAVY = {"numpy", "numba", "scipy", "matplotlib", "tensorflow", "keras", "h5py", "lxml"}
THESIS = {f"deep_contact.{folder}" for folder in ("sph", "cnn", "figures", "studies")}
HELP = "import runpy, sys; sys.argv = ['x', '--help']; runpy.run_path('{}', run_name='__main__')"
MAIN = "import sys; from deep_contact.__main__ import main; sys.argv[1:] = ['{}']; main()"


@pytest.mark.parametrize(
    ("code", "unused"),
    [
        ("import deep_contact", HEAVY),
        ("from deep_contact.io import provenance; assert provenance.provenance()['packages']", HEAVY),
        *((MAIN.format(argument), HEAVY) for argument in ("--version", "--help", "figure")),
        *((HELP.format(ROOT / "scripts" / name), HEAVY - {"numpy", "h5py"}) for name in ("train.py", "model_cards.py")),
        ("from deep_contact import plotting; plotting.subplots()", {"matplotlib.pyplot"}),
        # Numba asks for scipy.linalg, which takes a quarter of the time to the first step: see `deep_contact.compiled`.
        (
            "import deep_contact as dc; dc.simulate(dc.column(2), steps=1)",
            {"tensorflow", "keras", "matplotlib", "h5py", "scipy.linalg", "scipy.spatial"} | THESIS,
        ),
    ],
)
def test_nothing_is_loaded_that_the_job_does_not_need(code, unused):
    code = f"import atexit, sys; atexit.register(lambda: print(*sys.modules)); {code}"
    assert not set(run_python("-c", code).stdout.split()) & unused


def test_imports_point_down_and_make_no_circle():
    # The contracts are in pyproject.toml. Imports inside functions count, too.
    code = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(sys.argv[1], no_cache=True))"
    run_python("-c", code, ROOT / "pyproject.toml", cwd=ROOT)


def test_every_public_name_is_there():
    for name in dc.__all__:
        assert getattr(dc, name) is not None


EVERY_MODULE = """
import importlib, inspect, pkgutil
import deep_contact as dc
for found in pkgutil.walk_packages(dc.__path__, "deep_contact."):
    if found.name != "deep_contact.__main__":
        importlib.import_module(found.name)
from deep_contact import lazy
for name, (module, of) in lazy.homes(dc.__file__).items():
    if not inspect.ismodule(getattr(importlib.import_module(module), of)):
        assert not inspect.ismodule(getattr(dc, name)), name
"""


@pytest.mark.slow
def test_every_public_name_is_itself_once_every_module_is_imported():
    run_python("-c", EVERY_MODULE, environment={"TF_CPP_MIN_LOG_LEVEL": "3"})


def test_no_module_takes_the_place_of_a_public_name():
    """A package `deep_contact.step` would be what `dc.step` means once it is imported."""
    modules = {path.stem for path in PACKAGE.rglob("*.py")} | {
        path.name for path in PACKAGE.rglob("*") if path.is_dir()
    }
    assert not {name for name in dc.__all__ if not inspect.ismodule(getattr(dc, name))} & modules


def test_a_public_name_may_differ_from_that_of_its_module():
    from deep_contact.studies import starts

    assert dc.experiments is starts
    assert "starts" not in dir(dc)
    with pytest.raises(AttributeError, match="no attribute 'magic'"):
        dc.magic  # noqa: B018


def test_every_module_has_tests_of_its_name_or_names_them():
    """A module a/b.py has tests/a/test_b.py, or a line `Tests:` with the files that test it. All these files exist."""
    without = []
    for path in PACKAGE.rglob("*.py"):
        module, text = path.relative_to(PACKAGE), path.read_text(encoding="utf-8")
        if path.name == "__init__.py" and not re.search(r"^(def|class) ", text, re.MULTILINE):
            continue
        named = re.findall(r"tests/[\w/]+\.py", " ".join(re.findall(r"^Tests: ([^\"]*)", text, re.MULTILINE)))
        own = ROOT / "tests" / module.parent / f"test_{path.stem}.py"
        if not (own.is_file() or named) or not all((ROOT / name).is_file() for name in named):
            without.append(str(module))
    assert without == []
