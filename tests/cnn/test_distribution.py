"""Training on several devices (`training.image_run.strategy_for`): two logical CPUs, in a process of their own, since
TensorFlow takes such a setting only before it starts."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.cnn.dataset import Store, split_by_simulation, write_simulation

COMMON = {"batch_size": 8, "fractions": (0.5, 0.25, 0.25), "optimizer": "sgd", "rate": 1.0, "clip": None}
TINY = {**COMMON, "options": {"stem": 2, "width": 4, "decoder": 2, "dilations": [1, 1]}}
THESIS = {"architecture": "thesis", "channels": "thesis", "loss": "appendix b", "options": {"dropout": 0.0}}
NETWORKS = {
    "velocity loss": TINY,
    "clipped gradient": {**TINY, "clip": 1e-3},
    "batch normalisation, image loss": {**COMMON, **THESIS},
}
RUN = {**TINY, "optimizer": "adam", "rate": 0.02, "clip": 1.0, "schedule": "constant"}


def in_a_process_with_two_devices(folder, out):
    """What the tests below look at; printed, in a process of its own."""
    import tensorflow as tf

    cpu = tf.config.list_physical_devices("CPU")[0]
    tf.config.set_logical_device_configuration(cpu, [tf.config.LogicalDeviceConfiguration()] * 2)
    from deep_contact.cnn.training import TrainingConfig, train

    found = {"steps": {name: one_step(TrainingConfig(**settings), folder) for name, settings in NETWORKS.items()}}

    def history(name, epochs):
        config = TrainingConfig(**RUN, epochs=epochs)
        run = train(config, folder, f"{out}/{name}", threads=1, devices=2, held_out=10, verbose=0)
        return [{key: value for key, value in line.items() if key != "seconds"} for line in run.history]

    found["undisturbed"] = history("undisturbed", 2)
    history("resumed", 1)
    found["resumed"] = history("resumed", 2)
    print(json.dumps(found))


def one_step(config, folder):
    """The loss of the first batch, and by how much its step changes every number of the network, on one and two."""
    from deep_contact.cnn.training.image_run import ImageRun, strategy_for
    from deep_contact.cnn.training.run import set_up

    store, losses, steps = Store(folder), [], []
    split = split_by_simulation(store.simulations, fractions=config.fractions)
    for devices in (1, 2):
        set_up(0, threads=1)
        run = ImageRun(config, store, split, config.spec(), strategy=strategy_for(config, devices))
        before = run.model.get_weights()
        losses.append(float(run.step(*run.images.parts(0, devices))))
        steps.append(np.concatenate([(a - b).ravel() for a, b in zip(run.model.get_weights(), before)], dtype=float))
    size, error = np.linalg.norm(steps[0]), np.linalg.norm(steps[1] - steps[0])
    return {"losses": losses, "size": float(size), "error": float(error / size)}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Four simulations of 20 states in a box of 6 m × 6 m."""
    folder = tmp_path_factory.mktemp("data")
    for sim in range(4):
        states = []

        def keep(state, record, states=states):
            if state.contacts.count:
                states.append(state)

        scene = dc.circles_in_box(6, size=6.0, radius=(0.5, 0.5), seed=sim)
        dc.simulate(scene, steps=80, solver=dc.PGS(sweeps=200), on_step=keep)
        write_simulation(folder / f"sim_{sim:04d}.h5", states[:20], seed=sim)
    return folder


@pytest.fixture(scope="module")
def found(data, tmp_path_factory):
    arguments = f"{str(data)!r}, {str(tmp_path_factory.mktemp('runs'))!r}"
    code = f"import test_distribution as t; t.in_a_process_with_two_devices({arguments})"
    paths = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": paths, "TF_CPP_MIN_LOG_LEVEL": "3"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=600)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("name", NETWORKS)
def test_two_devices_make_the_step_of_one(found, name):
    """The batch in two halves against the whole of it; float32, whose sums go in another order."""
    step = found["steps"][name]
    assert step["losses"][1] == pytest.approx(step["losses"][0], rel=1e-5)
    assert step["size"] > 0
    assert step["error"] < 1e-4


def test_the_gradient_is_clipped_as_a_whole(found):
    """Weights, of which one is no gradient's: SGD with rate 1 moves by the clipped norm."""
    assert found["steps"]["clipped gradient"]["size"] == pytest.approx(1e-3, rel=1e-3)


def test_a_run_on_two_devices_goes_on_where_it_was(found):
    assert found["resumed"] == found["undisturbed"]
    assert len(found["resumed"]) == 2


@pytest.mark.parametrize(
    ("settings", "devices", "message"),
    [
        ({}, 0, "devices: expected an integer >= 1, got 0"),
        ({}, 999, "batch_size: expected a multiple of the 999 devices, got 32"),
        ({"batch_size": 999}, 999, "devices: expected at most the"),
        ({"architecture": "far field", "loss": "through solver"}, 2, "devices: expected 1 for the far-field network"),
    ],
)
def test_devices_that_cannot_share_are_refused(settings, devices, message):
    from deep_contact.cnn.training import TrainingConfig
    from deep_contact.cnn.training.image_run import strategy_for

    with pytest.raises(ValueError, match=message):
        strategy_for(TrainingConfig(**settings), devices)
