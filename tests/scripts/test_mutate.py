"""Mutants that are drawn can be made: their places are in the sources of today."""

import ast
from pathlib import Path

import pytest
from conftest import ROOT, load_script


def test_every_drawn_mutant_is_another_valid_source():
    pytest.importorskip("cosmic_ray")
    mutate = load_script("mutate")
    drawn = mutate.draw(12, seed=0)
    assert len(drawn) == 12
    assert {Path(mutant["file"]).parts[1] for mutant in drawn.values()} == {"physics", "sph"}
    named = mutate.draw(3, seed=0, files=["deep_contact/cnn/convolution.py"])
    assert {mutant["file"] for mutant in named.values()} == {"deep_contact/cnn/convolution.py"}
    for mutant in [*drawn.values(), *named.values()]:
        source = (ROOT / mutant["file"]).read_text(encoding="utf-8")
        changed = mutate.mutate_code(source, mutate.OPERATORS[mutant["operator"]], mutant["occurrence"])
        assert changed != source
        ast.parse(changed)
