"""scripts/predict.py, for a network that predicts images of impulses and for one that corrects Builtin's start."""

import csv

import numpy as np
import pytest
from conftest import ROOT, load_script

import deep_contact as dc


@pytest.fixture(scope="module")
def script():
    return load_script("predict")


def untrained(kind):
    """A network of this kind, as `load_model` gives it."""
    pytest.importorskip("keras")
    from deep_contact.cnn import architectures
    from deep_contact.cnn.far_field import FarFieldSpec
    from deep_contact.cnn.images import ImageSpec
    from deep_contact.cnn.inference import FarFieldModel, LearnedModel

    if kind == "far field":
        spec = FarFieldSpec()
        network = architectures.far_field(width=2)
        return FarFieldModel(source=network, spec=spec)
    network = architectures.thesis(stacks=[[2, [1]]])
    return LearnedModel(source=network, spec=ImageSpec(), box=(30.0, 30.0))


@pytest.mark.parametrize("kind", ["thesis", "far field"])
def test_a_state_is_predicted_and_drawn_with_either_kind_of_network(kind, script, tmp_path):
    path, model = ROOT / "data" / "sample" / "impact_154.xml.gz", untrained(kind)
    printed = script.predict_file(path, model, tmp_path)
    state = dc.read_state(path)
    assert "error of the velocities" in printed[2]
    with open(tmp_path / "impact_154.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    predicted = [[float(row[f"predicted_{part}"]) for row in rows] for part in "nt"]
    np.testing.assert_array_equal(predicted, model.predict(state))
    np.testing.assert_array_equal(np.load(tmp_path / "impact_154.npy"), model.predict_image(state))
    assert (tmp_path / "impact_154.png").stat().st_size > 10_000


def test_positions_alone_are_predicted_by_the_network_without_a_past_and_have_no_column_of_builtin(script, tmp_path):
    state = dc.simulate(dc.circles_in_box(40, size=20, seed=1), steps=150, solver=dc.PGS()).state
    dc.write_state(tmp_path / "alone.xml", state.replace(contacts=None))
    model = dc.load_model("far field, no past")
    printed = script.predict_file(tmp_path / "alone.xml", model, tmp_path, pictures=False)
    assert any("the network corrects the start support" in line for line in printed)
    with open(tmp_path / "alone.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [name for name in rows[0] if name.endswith("_n")] == ["predicted_n"]
    predicted = [[float(row[f"predicted_{part}"]) for row in rows] for part in "nt"]
    found = dc.find_contacts(state.replace(contacts=None))
    np.testing.assert_allclose(predicted, dc.warm_start.FarFieldNoPast()(found, None), rtol=1e-12)
    with pytest.warns(UserWarning, match="expected impulses, which this network corrects, got none"):
        dc.load_model("far field").predict(found)
    script.predict_file(ROOT / "data" / "sample" / "impact_154.xml.gz", model, tmp_path, pictures=False)
    assert "builtin_n" in (tmp_path / "impact_154.csv").read_text(encoding="utf-8")


def test_another_box_names_the_network_that_takes_it(script, tmp_path, capsys):
    pytest.importorskip("keras")
    state = dc.simulate(dc.circles_in_box(20, size=20, seed=1), steps=120).state
    dc.write_state(tmp_path / "small.xml", state)
    arguments = [str(tmp_path / "small.xml"), "--no-pictures", "--out", str(tmp_path)]
    assert script.main(arguments) != 0
    assert 'got 20 m × 20 m; the network "far field" takes any box' in capsys.readouterr().err
    assert script.main([*arguments, "--model", "far field"]) == 0
