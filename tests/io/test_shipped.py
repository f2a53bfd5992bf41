"""The files that come with the package, in a checkout and in a wheel; and JSON as it is written."""

import json

import pytest

import deep_contact as dc
from deep_contact.io import shipped
from deep_contact.io.files import write_json


def test_every_sample_is_a_solved_state_of_its_step():
    assert "impact_154" in shipped.sample_names()
    for name in shipped.sample_names():
        state = dc.read_state(dc.sample_file(name))
        assert state.solved
        assert name.endswith(f"_{state.step}")
    assert dc.sample_file() == dc.sample_file("impact_154")


def test_without_samples_the_error_says_where_they_are(tmp_path, monkeypatch):
    monkeypatch.setattr(shipped, "ROOT", tmp_path)
    with pytest.raises(FileNotFoundError, match="source repository"):
        dc.sample_file()


def test_a_file_is_found_here_first_then_among_those_that_are_shipped(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "data/sample/rest_362.xml.gz"
    assert shipped.find(name) == shipped.ROOT / name
    (tmp_path / "data" / "sample").mkdir(parents=True)
    (tmp_path / name).touch()
    assert shipped.find(name).samefile(tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"none\.json: expected"):
        shipped.find("none.json")


def test_json_keeps_bits_puts_one_object_a_line_and_holds_finite_numbers(tmp_path):
    value = {"a": [0.1, 1e-300], "θ": [{"b": None}, {"b": True}], "empty": {}}
    text = write_json(tmp_path / "new" / "a.json", value).read_text(encoding="utf-8")
    assert json.loads(text) == value
    assert '"a": [0.1,1e-300],\n' in text
    assert '"θ"' in text
    assert text.splitlines()[3:5] == ["    {", '      "b": null']
    assert write_json(tmp_path / "c.json", [1, [2, 3], "x"]).read_text() == '[1,[2,3],"x"]\n'
    assert write_json(tmp_path / "d.json", [{"a": 1}]).read_text() == '[\n  {\n    "a": 1\n  }\n]\n'
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "b.json", {"a": float("nan")})
    assert not (tmp_path / "b.json").exists()
