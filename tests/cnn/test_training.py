"""Training (section 5.3): settings, resuming after a kill, same seed same history, sides by simulation."""

import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import keras
import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact.cnn import architectures, losses
from deep_contact.cnn.dataset import ImageBatches, Store, split_by_simulation, write_simulation
from deep_contact.cnn.images import CHANNEL_SETS, SYMMETRIES, ImageSpec, transform_state
from deep_contact.cnn.inference import LearnedModel, limit_threads, load_model
from deep_contact.cnn.model_file import read_metadata
from deep_contact.cnn.training import ImageDataset, TrainingConfig, config, thesis_config, train
from deep_contact.cnn.training.image_run import ImageRun

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
        scene = dc.circles_in_box(6, size=6.0, radius=(0.5, 0.5), sigma_coef=1.7, seed=sim)

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
    return train(config, data, out, **({"verbose": 0, "held_out": 10} | options))


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


class KillAt(keras.callbacks.Callback):
    """Raises `Killed` before a batch."""

    def __init__(self, epoch, batch):
        super().__init__()
        self.when = epoch, batch

    def on_epoch_begin(self, epoch, logs=None):
        self.epoch = epoch

    def on_train_batch_begin(self, batch, logs=None):
        if (self.epoch, batch) == self.when:
            raise Killed


@pytest.mark.parametrize(("epoch", "batch"), [(0, 1), (2, 3), (3, 0)])
def test_interrupted_run_goes_on_to_the_same_history(undisturbed, data, tmp_path, epoch, batch):
    with pytest.raises(Killed):
        quietly(tiny(), data, tmp_path, callbacks=[KillAt(epoch, batch)])
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


def test_training_writes_nothing_of_tensorflow_s_log(data, tmp_path):
    flags = ["--epochs", "1", "--batch-size", "8", "--fractions", "0.6", "0.2", "0.2", "--held-out", "2"]
    flags += ["--options", "stem=2", "width=4", "decoder=2", "dilations=1,1"]
    environment = {name: value for name, value in os.environ.items() if name != "TF_CPP_MIN_LOG_LEVEL"}
    command = [sys.executable, TRAIN, "--data", data, "--out", tmp_path, *flags]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0
    assert not [line for line in done.stderr.splitlines() if "compiling" not in line]


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
    # Given again, it has run out already.
    again = quietly(tiny(rate=1e-12, schedule="constant", patience=2, epochs=20), data, tmp_path)
    assert again.history == done.history


def test_callbacks_of_keras_see_the_history_and_may_stop_the_run(data, tmp_path):
    seen = []
    callbacks = [
        keras.callbacks.EarlyStopping(patience=1, min_delta=1e9),
        keras.callbacks.CSVLogger(tmp_path / "theirs.csv"),
        keras.callbacks.LambdaCallback(on_train_batch_end=lambda batch, logs: seen.append((batch, logs["loss"]))),
    ]
    done = quietly(tiny(), data, tmp_path / "run", callbacks=callbacks)
    assert len(done.history) == 2
    assert [batch for batch, _ in seen] == 2 * list(range(len(seen) // 2))
    assert seen[-1][1] == done.history[-1]["loss"]
    with open(tmp_path / "theirs.csv", encoding="utf-8") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    assert rows == [line | {"val_loss": line["validation_loss"]} for line in done.history]


def test_progress_is_that_of_keras(data, tmp_path, capfd):
    done = quietly(tiny(epochs=1), data, tmp_path, verbose=2)
    text = capfd.readouterr().out
    assert f"validation_loss: {done.history[0]['validation_loss']:.4f}" in text


@pytest.mark.parametrize("spacing", [0.5, 0.7])
def test_keras_fits_the_batches_of_images(data, spacing):
    spec = tiny(spacing=spacing, support=spacing).spec()
    batches = ImageBatches(Store(data), None, spec, batch_size=10, drop_last=True)
    images = ImageDataset(batches, coarsening=4)
    first = images[0][0]
    model = architectures.build("compact", channels=len(spec.channels), stem=2, width=4, decoder=2, dilations=(1,))
    model.compile("adam", losses.masked_squared_error)
    model.fit(images, epochs=1, verbose=0)
    assert not np.array_equal(images[0][0], first)


# ---- going on from a model ----


def test_a_run_goes_on_from_a_model(undisturbed, data, tmp_path):
    settings = config.config_of(read_metadata(undisturbed.path), epochs=1, rate=1e-12, schedule="constant")
    assert settings.spec() == tiny().spec()
    further = quietly(settings, data, tmp_path, from_model=undisturbed.path)
    best = undisturbed.history[undisturbed.best_epoch]["validation_loss"]
    assert further.history[0]["validation_loss"] == pytest.approx(best, rel=1e-5)
    assert further.model.spec == undisturbed.model.spec
    with pytest.raises(ValueError, match="from_model: expected None, with which"):
        quietly(tiny(), data, undisturbed.path.parent, from_model=undisturbed.path)
    with pytest.raises(ValueError, match="from_model: expected a network for the images"):
        quietly(tiny(spacing=0.7), data, tmp_path / "other", from_model=undisturbed.path)


def test_settings_of_the_shipped_models_are_known():
    root = TRAIN.parents[1] / "models"
    for path in root.glob("*.h5"):
        metadata = read_metadata(path)
        images = config.config_of(metadata).spec().to_dict()
        changed = {name for name, value in images.items() if value != metadata["spec"][name]}
        assert changed <= {"scales", "target_scales"}


def test_names_in_the_settings_are_those_of_the_networks_and_losses():
    assert set(config.ARCHITECTURES) == set(architectures.ARCHITECTURES)
    assert set(config.LOSSES) == {"appendix b", *losses.CONTACT_LOSSES, *config.FAR_FIELD_LOSSES}


def test_thesis_network_trains_on_images(data, tmp_path):
    done = quietly(thesis_config(epochs=1, batch_size=8, fractions=(0.6, 0.2, 0.2)), data, tmp_path)
    assert done.model.box == (6.0, 6.0)
    assert done.model.network.output_shape == (None, 13 * 13 * 2)
    assert done.model.spec == ImageSpec()


def test_half_precision_differs_by_its_rounding_alone(undisturbed, data, tmp_path):
    # bfloat16 has 8 binary digits: 0.4 %.
    before = keras.config.dtype_policy()
    done = quietly(tiny(precision="mixed_bfloat16"), data, tmp_path)
    assert keras.config.dtype_policy() == before
    losses = [[line["validation_loss"] for line in run.history] for run in (done, undisturbed)]
    assert losses[0] != losses[1]
    np.testing.assert_allclose(*losses, rtol=0.02)
    layers = done.model.network.layers
    assert {layer.compute_dtype for layer in layers} == {"float32"}  # of the model file, as of any other
    assert {str(weight.dtype) for layer in layers for weight in layer.weights} == {"float32"}


def test_half_precision_goes_on_to_the_same_history(data, tmp_path):
    config = tiny(precision="mixed_bfloat16", epochs=2, schedule="constant")
    whole = quietly(config, data, tmp_path / "whole")
    quietly(replace(config, epochs=1), data, tmp_path / "parts")
    parts = quietly(config, data, tmp_path / "parts")
    assert without_time(parts.history) == without_time(whole.history)


def test_thesis_settings_are_those_of_table_5_2():
    config = thesis_config()
    assert (config.optimizer, config.rate, config.batch_size, config.epochs) == ("sgd", 5e-3, 200, 1000)
    assert config.fractions[1] == 0.2
    assert (config.schedule, config.loss) == ("algorithm 6", "appendix b")
    assert CHANNEL_SETS[config.channels] == ("mass", "velocity_x", "velocity_y", "spin", "normal_x")


@pytest.mark.parametrize("k", SYMMETRIES)
def test_contacts_of_a_turned_image_are_those_of_the_turned_state(data, k):
    store, settings = Store(data), tiny()
    split = split_by_simulation(store, fractions=settings.fractions, seed=0)
    run = ImageRun(settings, store, split, settings.spec())
    where = store.states(split.train)[10]
    turned = run.images.contact_batch(run.images.batches.batch([where], [k]))
    state = transform_state(store.state(*where), k)
    expected = losses.contact_batch([losses.state_contacts(state, run.spec)], run.shape[0] * run.shape[1], run.spec)
    image = np.random.default_rng(0).normal(size=(1, *run.shape, 2)).astype(np.float32)
    found, wanted = (np.asarray(losses.read_at_contacts(image, batch)) for batch in (turned, expected))
    # The contacts keep their order, and λ_t its sign of before: the mirror is undone where it is read.
    wanted = wanted * [1.0, -1.0 if k >= 4 else 1.0]
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("spacing", [0.5, 0.7])
def test_training_pads_as_inference_does(data, spacing):
    store, settings = Store(data), tiny(spacing=spacing, support=spacing, augment=False)
    split = split_by_simulation(store, fractions=settings.fractions, seed=0)
    run = ImageRun(settings, store, split, settings.spec())
    rng = np.random.default_rng(0)
    run.model.set_weights([rng.normal(0, 0.2, w.shape) for w in run.model.get_weights()])
    batch = run.images.batches.batch([store.states(split.train)[10]])
    images, _ = run.predict(*run.images.arrays(batch))
    model = LearnedModel(source=run.model, spec=run.spec, coarsening=run.coarsening)
    np.testing.assert_allclose(np.asarray(images)[0], model.run(batch.inputs[0]), rtol=1e-4, atol=1e-6)


def test_event_files_are_written_on_request(data, tmp_path):
    import tensorflow as tf
    from tensorflow.python.summary.summary_iterator import summary_iterator

    done = quietly(tiny(epochs=1), data, tmp_path / "run", tensorboard=tmp_path / "events")
    (path,) = (tmp_path / "events").glob("events.*")
    values = {v.tag: v for event in summary_iterator(str(path)) for v in event.summary.value}
    for name in set(done.history[0]) - {"epoch"}:
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
        ("precision", "float16"),
    ],
)
def test_bad_settings_are_named(field, value):
    with pytest.raises(ValueError, match=field):
        TrainingConfig(**{field: value})


def test_factored_network_of_full_rank_is_the_network():
    script = load_script("factor_thesis_network")
    keras.utils.set_random_seed(0)
    network = architectures.build("thesis", shape=(3, 3))
    image = np.random.default_rng(0).normal(size=(40, 3, 3, 5)).astype(np.float32)
    features = keras.Sequential([keras.Input((3, 3, 5)), *network.layers[:-1]])(image)
    vectors = script.right_vectors(np.asarray(features), network.layers[-1].get_weights()[0], 18)
    np.testing.assert_allclose(script.factored(network, vectors)(image), network(image), rtol=1e-3, atol=1e-5)
    limit = 4 * network.count_params()
    assert script.largest_rank(network, limit) < 18


def test_the_trend_of_a_training_is_the_power_law_of_its_second_half():
    script, visits = load_script("factor_thesis_network"), 1000.0 * np.arange(1, 41)
    losses = np.where(visits < 20_000, 9.0, 0.5 * visits**-0.1)
    card = {"config": {"states_per_epoch": 1000}, "history": [{"validation_loss": loss} for loss in losses]}
    trend = script.trend_of(card)
    expected = 0.5 * 18_208_000**-0.1
    assert (trend["visits"], trend["share"]) == (40_000, pytest.approx(40 / 18_208))
    assert trend["loss_after_the_thesis_training"] == pytest.approx(expected, rel=1e-6)
    np.testing.assert_allclose(trend["interval"], expected, rtol=1e-6)
    noisy = losses * np.exp(np.random.default_rng(0).normal(0, 0.01, 40))
    card["history"] = [{"validation_loss": loss} for loss in noisy]
    low, high = script.trend_of(card)["interval"]
    assert low < expected < high < 1.3 * low


# ---- scripts/train.py, scripts/model_cards.py ----


@pytest.mark.parametrize(
    ("flags", "status", "message"),
    [
        (["--ratee", "3"], 2, "unrecognized arguments: --ratee 3"),
        (["--rate", "abc"], 2, "invalid float value: 'abc'"),
        (["--options", "stem"], 2, "invalid option value: 'stem'"),
        (["--epochs", "0"], 1, "epochs: expected an integer >= 1, got 0"),
        (["--data", "nowhere"], 1, "nowhere: expected files sim_0000.h5"),
        (["--from", "nowhere.h5"], 1, "nowhere.h5 does not exist"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(flags, status, message, capsys):
    script = load_script("train")
    try:
        found = script.main(flags)
    except SystemExit as error:
        found = error.code
    assert found == status
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


def test_ctrl_c_ends_training_with_one_line(data, tmp_path, monkeypatch, capsys):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("deep_contact.cnn.training.run.train", interrupted)
    assert load_script("train").main(["--data", str(data), "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err.splitlines()[-1].startswith("train.py: stopped; the same command goes on")


@pytest.mark.parametrize("script", ["train", "model_cards"])
def test_help_loads_neither_tensorflow_nor_numba(script):
    code = "import runpy, sys\ntry: runpy.run_path(sys.argv[0], run_name='__main__')\nfinally: print(*sys.modules)"
    code = f"import sys; sys.argv = [{str(TRAIN.with_name(script + '.py'))!r}, '--help']\n{code}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "usage:" in done.stdout
    assert not {"tensorflow", "keras", "numba"} & set(done.stdout.splitlines()[-1].split())


def test_a_script_goes_on_from_a_model(undisturbed):
    script = load_script("train")
    settings = script.configuration({"epochs": 2, "options": [("stem", 3)]}, undisturbed.path)
    assert (settings.epochs, settings.rate, settings.options) == (2, 0.02, {"stem": 3})


def test_the_learning_curve_names_what_the_columns_hold(tmp_path):
    errors = {"validation_velocity_error": 0.5, "validation_velocity_error_10": 0.1, "validation_impulse_error": 0.3}
    line = {"epoch": 0, "loss": 1.0, "validation_loss": 1.0, **errors}
    right = load_script("train").learning_curve([line], tmp_path / "curve.png")
    labels = [text.get_text() for text in right.get_legend().get_texts()]
    assert labels == ["velocity, no sweep", "velocity, 10 sweeps", "impulse, no sweep"]


def test_shipped_histories_have_the_columns_of_new_ones():
    for path in (TRAIN.parents[1] / "models").glob("*_history.csv"):
        with open(path, encoding="utf-8") as file:
            columns = next(csv.reader(file))
        far_field = path.stem not in ("compact_history", "thesis_factored_history")
        assert ("validation_velocity_error_30" in columns) == far_field
        assert ("validation_impulse_error" in columns) != far_field


def test_nesterov_looks_ahead_as_in_eq_4_9(data, tmp_path, monkeypatch):
    """Keras keeps the point of the gradient, θ − γ v; Eq 4.9 keeps θ. On L = ½ a θ², both by hand and by Keras."""
    keras = pytest.importorskip("keras")
    rate, gamma, a = 0.1, 0.9, 3.0
    theta, v, ahead = 1.0, 0.0, []
    for _ in range(6):
        v = gamma * v + rate * a * (theta - gamma * v)
        theta -= v
        ahead.append(theta - gamma * v)
    made = []

    class Seen(keras.optimizers.SGD):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            made.append((arguments, options))

    monkeypatch.setattr(keras.optimizers, "SGD", Seen)
    quietly(tiny(optimizer="nesterov", momentum=gamma, rate=rate, epochs=1), data, tmp_path)
    ((arguments, options),) = made
    optimizer, weight = Seen(*arguments, **options | {"global_clipnorm": None}), keras.Variable([1.0])
    optimizer.build([weight])
    found = []
    for _ in range(6):
        optimizer.apply([a * weight.value], [weight])
        found.append(float(np.asarray(weight.value)[0]))
    np.testing.assert_allclose(found, ahead, rtol=1e-5)
