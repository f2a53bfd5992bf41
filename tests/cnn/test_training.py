"""Training (section 5.3): settings, resuming after a kill, same seed same history, sides by simulation."""

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import keras
import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact.cnn import training
from deep_contact.cnn.dataset import Store, split_by_simulation, write_simulation
from deep_contact.cnn.images import SYMMETRIES, ImageSpec, transform_state
from deep_contact.cnn.inference import LearnedModel, limit_threads, load_model
from deep_contact.cnn.training import CHANNEL_SETS, TrainingConfig, thesis_config, train

# Before TensorFlow does anything: sums go in another order on more threads.
limit_threads(1)

TINY = {"stem": 2, "width": 4, "decoder": 2, "dilations": [1, 1]}
TRAIN = Path(__file__).parents[2] / "scripts" / "train.py"


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Five simulations of 20 states in a box of 6 m × 6 m."""
    folder = tmp_path_factory.mktemp("data")
    for sim in range(5):
        states = []
        scene = dc.circles_in_box(6, size=6.0, radius=(0.5, 0.5), seed=sim)

        def keep(state, record, states=states):
            if state.contacts.count:
                states.append(state)

        dc.simulate(scene, steps=80, solver=dc.PGS(sweeps=200), on_step=keep)
        write_simulation(folder / f"sim_{sim:04d}.h5", states[:20], seed=sim)
    return folder


def tiny(**changes):
    settings = {"options": TINY, "epochs": 4, "batch_size": 8, "fractions": (0.6, 0.2, 0.2), "rate": 0.02}
    return TrainingConfig(**(settings | changes))


def quietly(config, data, out, **options):
    return train(config, data, out, log=lambda line: None, held_out=10, **options)


def without_time(history):
    return [{name: value for name, value in line.items() if name != "seconds"} for line in history]


@pytest.fixture(scope="module")
def undisturbed(data, tmp_path_factory):
    return quietly(tiny(), data, tmp_path_factory.mktemp("undisturbed"))


def test_training_lowers_the_loss(undisturbed):
    losses = [line["validation_loss"] for line in undisturbed.history]
    assert losses[-1] < 0.9 * losses[0]


def test_same_seed_same_history(undisturbed, data, tmp_path):
    again = quietly(tiny(), data, tmp_path)
    assert without_time(again.history) == without_time(undisturbed.history)
    for ours, theirs in zip(again.model.network.get_weights(), undisturbed.model.network.get_weights()):
        np.testing.assert_array_equal(ours, theirs)


def test_other_seed_other_history(undisturbed, data, tmp_path):
    other = quietly(tiny(seed=1, epochs=1), data, tmp_path)
    assert other.history[0]["loss"] != undisturbed.history[0]["loss"]


class Killed(BaseException):
    """As abrupt as an exception can be."""


@pytest.mark.parametrize(("epoch", "batch"), [(0, 1), (2, 3), (3, 0)])
def test_interrupted_run_goes_on_to_the_same_history(undisturbed, data, tmp_path, epoch, batch):
    def interrupt(*now):
        if now == (epoch, batch):
            raise Killed

    with pytest.raises(Killed):
        quietly(tiny(), data, tmp_path, on_batch=interrupt)
    resumed = quietly(tiny(), data, tmp_path)
    assert without_time(resumed.history) == without_time(undisturbed.history)
    for ours, theirs in zip(resumed.model.network.get_weights(), undisturbed.model.network.get_weights()):
        np.testing.assert_array_equal(ours, theirs)


def test_killed_process_goes_on_to_the_same_history(undisturbed, data, tmp_path):
    flags = ["--epochs", "4", "--batch-size", "8", "--fractions", "0.6", "0.2", "0.2", "--held-out", "10"]
    flags += ["--options", "stem=2", "width=4", "decoder=2", "dilations=1,1", "--rate", "0.02"]
    process = subprocess.Popen(
        [sys.executable, TRAIN, "--data", data, "--out", tmp_path, *flags], stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 120
    while not (tmp_path / "last.npz").exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    # Whatever epoch it was in, what it left is whole.
    resumed = quietly(tiny(), data, tmp_path)
    assert without_time(resumed.history) == without_time(undisturbed.history)


def test_history_is_written_as_csv(undisturbed):
    with open(undisturbed.path.with_name("history.csv"), encoding="utf-8") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    assert rows == undisturbed.history


def test_best_epoch_is_kept(undisturbed):
    losses = [line["validation_loss"] for line in undisturbed.history]
    assert undisturbed.best_epoch == int(np.argmin(losses))
    best = load_model(undisturbed.path.with_name("best.h5"))
    for ours, theirs in zip(best.network.get_weights(), undisturbed.model.network.get_weights()):
        np.testing.assert_array_equal(ours, theirs)


def test_card_says_what_a_reader_needs(undisturbed, data):
    card = undisturbed.model.card
    assert card["data_hash"] == Store(data).data_hash()
    assert card["seed"] == 0
    assert card["parameters"] == undisturbed.model.network.count_params()
    assert {"none", "builtin", "cnn", "states"} == set(card["held_out"]["phases"]["all"])
    assert {"keras", "numpy", "python"} <= set(card["versions"])
    assert len(card["history"]) == 4


def test_no_simulation_is_on_two_sides(undisturbed, data):
    split = undisturbed.model.card["split"]
    sides = [set(split[name]) for name in ("train", "validation", "test")]
    assert sum(map(len, sides)) == len(set.union(*sides)) == len(Store(data).simulations)


def test_other_settings_do_not_go_on(undisturbed, data):
    with pytest.raises(ValueError, match=r"batch_size: expected 8"):
        quietly(tiny(batch_size=4), data, undisturbed.path.parent)


def test_run_of_fixed_rates_can_be_prolonged(data, tmp_path):
    short = quietly(tiny(epochs=1, schedule="constant"), data, tmp_path)
    longer = quietly(tiny(epochs=2, schedule="constant"), data, tmp_path)
    assert longer.history[:1] == short.history
    assert len(longer.history) == 2


def test_patience_ends_a_run(data, tmp_path):
    # At a rate of next to nothing no epoch is better than the one before by more than rounding.
    done = quietly(tiny(rate=1e-12, schedule="constant", patience=2, epochs=20), data, tmp_path)
    assert len(done.history) < 20
    assert len(done.history) - 1 - done.best_epoch == 2


def test_thesis_network_trains_on_images(data, tmp_path):
    done = quietly(thesis_config(epochs=1, batch_size=8, fractions=(0.6, 0.2, 0.2)), data, tmp_path)
    assert done.model.box == (6.0, 6.0)
    assert done.model.network.output_shape == (None, 13 * 13 * 2)
    assert done.model.spec == ImageSpec()


def test_thesis_settings_are_those_of_table_5_2():
    config = thesis_config()
    assert (config.optimizer, config.rate, config.batch_size, config.epochs) == ("sgd", 5e-3, 200, 1000)
    assert config.fractions[1] == 0.2
    assert (config.schedule, config.loss) == ("algorithm 6", "appendix b")
    assert CHANNEL_SETS[config.channels] == ("mass", "velocity_x", "velocity_y", "spin", "normal_x")


@pytest.mark.parametrize("k", SYMMETRIES)
def test_contacts_of_a_turned_image_are_those_of_the_turned_state(data, k):
    store = Store(data)
    config = tiny()
    split = split_by_simulation(store, fractions=config.fractions, seed=0)
    run = training._ImageRun(config, store, split, config.spec())
    where = store.states(split.train)[10]
    turned = run.contacts(run.batches.batch([where], [k]))
    state = transform_state(store.state(*where), k)
    expected = training.losses.contact_batch(
        [training.losses.state_contacts(state, run.spec)], run.shape[0] * run.shape[1], run.spec
    )
    image = np.random.default_rng(0).normal(size=(1, *run.shape, 2)).astype(np.float32)
    found, wanted = (np.asarray(training.losses.read_at_contacts(image, batch)) for batch in (turned, expected))
    # The contacts keep their order, and λ_t its sign of before: the mirror is undone where it is read.
    wanted = wanted * [1.0, -1.0 if k >= 4 else 1.0]
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("spacing", [0.5, 0.7])
def test_training_pads_as_inference_does(data, spacing):
    store, config = Store(data), tiny(spacing=spacing, support=spacing, augment=False)
    split = split_by_simulation(store, fractions=config.fractions, seed=0)
    run = training._ImageRun(config, store, split, config.spec())
    rng = np.random.default_rng(0)
    run.model.set_weights([rng.normal(0, 0.2, w.shape) for w in run.model.get_weights()])
    batch = run.batches.batch([store.states(split.train)[10]])
    images, _ = run._predict(*run.arrays(batch))
    model = LearnedModel(source=run.model, spec=run.spec, coarsening=run.coarsening)
    np.testing.assert_allclose(np.asarray(images)[0], model.run(batch.inputs[0]), rtol=1e-4, atol=1e-6)


def test_event_files_are_written_on_request(data, tmp_path):
    import tensorflow as tf
    from tensorflow.python.summary.summary_iterator import summary_iterator

    done = quietly(tiny(epochs=1), data, tmp_path / "run", tensorboard=tmp_path / "events")
    (path,) = (tmp_path / "events").glob("events.*")
    values = {v.tag: v for event in summary_iterator(str(path)) for v in event.summary.value}
    for name in training.COLUMNS[1:]:
        assert values[name].metadata.plugin_data.plugin_name == "scalars"
        assert tf.make_ndarray(values[name].tensor) == np.float32(done.history[0][name])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("architecture", "alexnet"),
        ("channels", "all"),
        ("loss", "mse"),
        ("optimizer", "lbfgs"),
        ("schedule", "step"),
        ("epochs", 0),
        ("batch_size", 1.5),
        ("rate", -1.0),
        ("momentum", 1.0),
        ("phases", ("flight",)),
    ],
)
def test_bad_settings_are_named(field, value):
    with pytest.raises(ValueError, match=field):
        TrainingConfig(**{field: value})


def test_factored_network_of_full_rank_is_the_network():
    script = load_script("factor_thesis_network")
    keras.utils.set_random_seed(0)
    network = training.architectures.build("thesis", shape=(3, 3))
    image = np.random.default_rng(0).normal(size=(40, 3, 3, 5)).astype(np.float32)
    features = keras.Sequential([keras.Input((3, 3, 5)), *network.layers[:-1]])(image)
    vectors = script.right_vectors(np.asarray(features), network.layers[-1].get_weights()[0], 18)
    np.testing.assert_allclose(script.factored(network, vectors)(image), network(image), rtol=1e-3, atol=1e-5)
    limit = 4 * network.count_params()
    assert script.largest_rank(network, limit) < 18
