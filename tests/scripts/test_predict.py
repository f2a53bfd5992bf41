"""scripts/predict.py, for a network that predicts images of impulses and for one that corrects Builtin's start."""

import csv
from pathlib import Path

import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def script():
    return load_script("predict")


def untrained(kind):
    """A network of this kind, as `load_model` gives it."""
    pytest.importorskip("keras")
    from deep_contact.cnn import architectures, training
    from deep_contact.cnn.far_field import FarFieldSpec
    from deep_contact.cnn.images import SOLVER_CHANNELS, ImageSpec
    from deep_contact.cnn.inference import FarFieldModel, LearnedModel

    if kind == "far field":
        spec = FarFieldSpec()
        network = architectures.far_field(channels=len(spec.channels), outputs=len(spec.targets), width=2)
        return FarFieldModel(source=network, spec=spec, coarsening=8)
    spec = ImageSpec(channels=SOLVER_CHANNELS, transfer="consistent", scale_free=True)
    options = training.compact_options(spec) | {"stem": 2, "width": 2, "decoder": 2, "dilations": (1,)}
    network = architectures.compact(channels=len(spec.channels), outputs=len(spec.targets), **options)
    return LearnedModel(source=network, spec=spec, coarsening=architectures.coarsening("compact"))


@pytest.mark.parametrize("kind", ["compact", "far field"])
def test_a_state_is_predicted_and_drawn_with_either_kind_of_network(kind, script, tmp_path):
    path, model = ROOT / "data" / "sample" / "impact_154.xml.gz", untrained(kind)
    printed = script.predict_file(path, model, tmp_path, True)
    state = dc.read_state(path)
    assert "relative velocity error" in printed[3]
    with open(tmp_path / "impact_154.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    predicted = [[float(row[f"predicted_{part}"]) for row in rows] for part in "nt"]
    np.testing.assert_array_equal(predicted, model.predict(state))
    np.testing.assert_array_equal(np.load(tmp_path / "impact_154.npy"), model.predict_image(state))
    assert (tmp_path / "impact_154.png").stat().st_size > 10_000
