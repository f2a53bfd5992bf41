"""Predictions of the shipped networks against numbers on file, whatever the versions of Keras and TensorFlow.

`bash tests/tools/check_keras_range.sh` runs these tests with the oldest and with the newest versions that setup.cfg
allows.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT

import deep_contact as dc

STORED = json.loads(Path(__file__).with_name("stored_predictions.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def state():
    return dc.read_state(ROOT / "data" / "sample" / "impact_154.xml.gz")


@pytest.mark.parametrize("name", STORED)
def test_a_shipped_network_predicts_the_stored_impulses(name, state):
    found = np.array(dc.load_model(name).predict(state, project=False))
    size = np.abs(STORED[name]["first"]).max()
    np.testing.assert_allclose(found[:, :6], STORED[name]["first"], rtol=0, atol=1e-4 * size)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), STORED[name]["norm"], rtol=1e-4)
