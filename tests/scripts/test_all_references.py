"""One command for all references: what it runs, and what it keeps."""

import json

from conftest import load_script

from deep_contact.io.provenance import provenance

SCRIPT = load_script("all_references")


def test_every_file_of_data_reference_is_made_by_one_of_the_commands():
    made = {path.stem for path in SCRIPT.REFERENCE.glob("*.json")}
    figures = {name for name in made if name.startswith(("figure_", "table_"))}
    assert made - figures - set(SCRIPT.ELSEWHERE) == SCRIPT.STUDIES.keys()
    *_, most, _ = SCRIPT.commands()
    assert len(most[-1].split(",")) == len(figures)
    assert all((SCRIPT.HERE / script).is_file() for script, *_ in SCRIPT.STUDIES.values())


def test_what_this_commit_made_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(SCRIPT, "REFERENCE", tmp_path)
    monkeypatch.setattr(SCRIPT, "commit", lambda: "0" * 40)
    before = len(SCRIPT.commands())
    for name, commit in (("run_tradeoff", "0" * 40), ("mutants", "1" * 40)):
        (tmp_path / f"{name}.json").write_text(json.dumps({"provenance": provenance() | {"commit": commit}}))
    assert len(SCRIPT.commands()) == before - 1
    assert not any(command[-1].endswith("/run_tradeoff.json") for command in SCRIPT.commands())
    monkeypatch.setattr(SCRIPT, "commit", lambda: "0" * 40 + "+changes")
    assert len(SCRIPT.commands()) == before
