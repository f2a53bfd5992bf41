"""Atomic writes."""

import json

import pytest

from deep_contact.io.files import replacing, write_json


def test_an_interrupted_replacement_leaves_no_temporary_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def interrupted():
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]


def test_json_keeps_bits_and_puts_one_object_a_line(tmp_path):
    value = {"a": [0.1, 1e-300], "θ": [{"b": None}, {"b": True}], "empty": {}}
    path = write_json(tmp_path / "new" / "a.json", value)
    text = path.read_text(encoding="utf-8")
    assert json.loads(text) == value
    assert '"a": [0.1,1e-300],\n' in text
    assert '"θ"' in text


def test_json_without_finite_numbers_is_refused(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"a": float("nan")})
    assert not list(tmp_path.iterdir())
