"""The files that come with the package, in a checkout and in a wheel."""

import pytest

import deep_contact as dc
from deep_contact.io import shipped


def test_every_sample_is_a_solved_state_of_its_step():
    assert "impact_154" in shipped.sample_names()
    for name in shipped.sample_names():
        state = dc.read_state(dc.sample_file(name))
        assert state.solved
        assert name.endswith(f"_{state.step}")
    assert dc.sample_file() == dc.sample_file("impact_154")


def test_an_unknown_sample_is_refused_by_the_names_of_those_that_there_are():
    with pytest.raises(ValueError, match=r"sample: expected one of impact_154, .*rest_530, got 'mine'"):
        dc.sample_file("mine")


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
    with pytest.raises(FileNotFoundError, match=r"none\.json: expected a file"):
        shipped.find("none.json")
