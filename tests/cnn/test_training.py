"""Training (section 5.3): settings, resuming after a kill, same seed same history, sides by simulation."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import keras
import numpy as np
import pytest
from conftest import load_script, solved_states

import deep_contact as dc
from deep_contact.cnn.backend import limit_threads
from deep_contact.cnn.dataset import Split, Store
from deep_contact.cnn.images import ImageSpec, input_image, label_image
from deep_contact.cnn.inference import load_model
from deep_contact.cnn.model_file import read_metadata, spec_of
from deep_contact.cnn.training import TrainingConfig, config, recipe, train
from deep_contact.cnn.training.curve import learning_curve, read_history
from deep_contact.cnn.training.network import ImageRun
from deep_contact.io.simulation_h5 import write_simulation

# Before TensorFlow does anything: sums go in another order on more threads.
limit_threads(1)

TINY = {"stacks": [[4, [3, 2]], [8, [2]], [8, [2]]], "weight_decay": 0.0, "rank": None}
TRAIN = Path(__file__).parents[2] / "scripts" / "train.py"


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Five simulations of 20 states in a box of 6 m × 6 m."""
    folder = tmp_path_factory.mktemp("data")
    for sim in range(5):
        scene = dc.circles_in_box(6, size=6.0, radius=(0.5, 0.5), sigma_coef=1.7, seed=sim)
        states = solved_states(scene, steps=80, solver=dc.PGS(sweeps=200))
        write_simulation(folder / f"sim_{sim:04d}.h5", states[:20], seed=sim)
    return folder


def tiny(**changes):
    settings = {"options": TINY, "epochs": 4, "batch_size": 8, "fractions": (0.6, 0.2, 0.2), "rate": 0.01}
    return recipe("thesis", **(settings | {"optimizer": "adam", "schedule": "cosine"} | changes))


def quietly(config, data, out, **options):
    return train(config, data, out, **({"verbose": 0, "held_out": 10} | options))


def without_time(history):
    return [{name: value for name, value in line.items() if name != "seconds"} for line in history]


@pytest.fixture(scope="module")
def undisturbed(data, tmp_path_factory):
    return quietly(tiny(), data, tmp_path_factory.mktemp("undisturbed"))


def assert_same_weights(first, second):
    for ours, theirs in zip(first.network.get_weights(), second.network.get_weights()):
        np.testing.assert_array_equal(ours, theirs)


def test_training_lowers_the_loss_of_a_network_for_the_box_of_its_data(undisturbed):
    losses = [line["loss"] for line in undisturbed.history]
    assert losses[-1] < losses[0]
    model = undisturbed.model
    assert (model.box, model.spec) == ((6.0, 6.0), ImageSpec())
    assert model.network.output_shape == (None, 13 * 13 * 2)


class Killed(BaseException):
    """As abrupt as an exception can be."""


def test_interrupted_run_goes_on_to_the_same_history(undisturbed, data, tmp_path):
    """From the end of the first epoch, which has seven batches."""
    seen = []

    def kill(batch, logs):
        seen.append(batch)
        if len(seen) == 7 + 4:
            raise Killed

    with pytest.raises(Killed):
        quietly(tiny(), data, tmp_path, callbacks=[keras.callbacks.LambdaCallback(on_train_batch_begin=kill)])
    with np.load(tmp_path / "last.npz") as file:
        assert len(json.loads(file["state"].tobytes())["history"]) == 1
    resumed = quietly(tiny(), data, tmp_path)
    assert without_time(resumed.history) == without_time(undisturbed.history)
    assert_same_weights(resumed.model, undisturbed.model)


def test_history_is_written_as_csv_and_drawn_and_the_best_epoch_is_kept(undisturbed, tmp_path):
    assert read_history(undisturbed.path.with_name("history.csv")) == undisturbed.history
    assert learning_curve(undisturbed.history, tmp_path / "curve.png").stat().st_size > 10_000
    losses = [line["validation_loss"] for line in undisturbed.history]
    assert undisturbed.best_epoch == int(np.argmin(losses))
    assert_same_weights(load_model(undisturbed.path.with_name("best.h5")), undisturbed.model)


def test_card_says_what_a_reader_needs(undisturbed, data):
    card = undisturbed.model.card
    assert (card["data_hash"], card["seed"], len(card["history"])) == (Store(data).data_hash(), 0, 4)
    assert card["parameters"] == undisturbed.model.network.count_params()
    assert {"none", "builtin", "cnn", "states"} == set(card["held_out"]["phases"]["all"])
    assert {"keras", "numpy", "python"} <= set(card["versions"])
    sides = [set(card["split"][name]) for name in ("train", "validation", "test")]
    assert sum(map(len, sides)) == len(set.union(*sides)) == len(Store(data).simulations)


def test_other_settings_do_not_go_on(undisturbed, data):
    with pytest.raises(ValueError, match="batch_size: expected"):
        quietly(tiny(batch_size=4), data, undisturbed.path.parent)


@pytest.mark.slow
def test_run_of_fixed_rates_can_be_prolonged(data, tmp_path):
    fixed = tiny(epochs=2, schedule="algorithm 6")
    whole = quietly(fixed, data, tmp_path / "whole")
    short = quietly(replace(fixed, epochs=1), data, tmp_path / "parts")
    longer = quietly(fixed, data, tmp_path / "parts")
    assert longer.history[:1] == short.history
    assert without_time(longer.history) == without_time(whole.history)


@pytest.mark.slow
def test_half_precision_learns_alike(data, tmp_path):
    # bfloat16 has 8 binary digits, 0.4 %.
    runs = [quietly(tiny(epochs=1, precision=p), data, tmp_path / p) for p in ("float32", "mixed_bfloat16")]
    losses = [run.history[0]["validation_loss"] for run in runs]
    assert losses[0] != losses[1]
    assert losses[0] == pytest.approx(losses[1], rel=0.02)
    layers = runs[1].model.network.layers
    assert {layer.compute_dtype for layer in layers} == {"float32"}  # of the model file, as of any other
    assert {str(weight.dtype) for layer in layers for weight in layer.weights} == {"float32"}


def test_callbacks_of_keras_see_the_history_and_may_stop_the_run(data, tmp_path, capfd):
    seen = []
    callbacks = [
        keras.callbacks.EarlyStopping(patience=1, min_delta=1e9),
        keras.callbacks.CSVLogger(tmp_path / "theirs.csv"),
        keras.callbacks.LambdaCallback(on_train_batch_end=lambda batch, logs: seen.append((batch, logs["loss"]))),
    ]
    done = quietly(tiny(), data, tmp_path / "run", callbacks=callbacks, verbose=2)
    assert len(done.history) == 2
    assert f"loss: {done.history[0]['loss']:.4f}" in capfd.readouterr().out
    assert [batch for batch, _ in seen] == 2 * list(range(len(seen) // 2))
    assert seen[-1][1] == pytest.approx(done.history[-1]["loss"])
    rows = read_history(tmp_path / "theirs.csv")
    assert [row["loss"] for row in rows] == [line["loss"] for line in done.history]
    assert [row["val_loss"] for row in rows] == [line["validation_loss"] for line in done.history]


def test_the_loss_is_without_the_penalty_of_the_weights(data):
    """Eq 4.6: L2 adds a factor times the squares of the kernels; in the history it stands apart."""
    settings = tiny(options=TINY | {"weight_decay": 1.0}, optimizer="nesterov")
    images = ImageRun(settings, Store(data), Split((0,), (1,), ()), None)
    kernels = [layer.kernel for layer in images.model.layers if "convolution" in layer.name]
    penalty = sum(float(np.sum(np.square(kernel))) for kernel in kernels)
    assert images.validate()["penalty"] == pytest.approx(penalty, rel=1e-5)
    assert images.validate()["validation_loss"] < penalty / 1000
    loss, count = images.step(next(images.batches(0)))
    assert loss / count < penalty / 1000


def test_momentum_is_that_of_the_authors_code(data):
    """Nesterov's, 0.9 (Eq 4.9): steps of a constant gradient g are 1.9 g and (1 + 0.9 * 1.9) g, times the rate."""
    run = ImageRun(tiny(optimizer="nesterov", rate=0.01), Store(data), Split((0,), (1,), ()), None)
    weights = run.model.trainable_variables
    before = weights[0].numpy()
    for moved in (1.9, 1.9 + 2.71):
        run.optimizer.apply([np.ones(weight.shape, np.float32) for weight in weights], weights)
        np.testing.assert_allclose(before - weights[0].numpy(), 0.01 * moved, rtol=1e-3)


# ---- batches ----


def test_an_epoch_shows_other_states_in_full_batches_and_repeats(data):
    store, settings = Store(data), tiny(seed=4, batch_size=16)
    images = ImageRun(settings, store, Split((0, 3), (1,), ()), None)
    first, again, other = (list(images.batches(epoch)) for epoch in (0, 0, 1))
    assert [len(labels) for _, labels in first] == [16, 16]
    np.testing.assert_array_equal(first[1][0], again[1][0])
    assert not np.array_equal(first[1][0], other[1][0])
    expected = np.random.default_rng((4, 0)).permutation(store.states((0, 3)))[16:32].tolist()
    for image, label, (sim, index) in zip(*first[1], expected):
        np.testing.assert_array_equal(image, input_image(store.state(sim, index), images.spec))
        np.testing.assert_array_equal(label, label_image(store.state(sim, index), images.spec).ravel())
    assert {part.dtype for part in first[1]} == {np.dtype(np.float32)}


@pytest.mark.slow
def test_boxes_of_different_sizes_are_refused(data, tmp_path):
    shutil.copy(data / "sim_0000.h5", tmp_path)
    write_simulation(tmp_path / "sim_0001.h5", [dc.simulate(dc.single_body(), steps=1).state])
    with pytest.raises(ValueError, match="one size"):
        ImageRun(tiny(), Store(tmp_path), Split((0,), (1,), ()), None)


# ---- going on from a model ----


def test_a_run_goes_on_from_a_model(undisturbed, data, tmp_path):
    settings = config.config_of(read_metadata(undisturbed.path), epochs=1, rate=1e-12)
    assert settings.spec() == tiny().spec()
    further = quietly(settings, data, tmp_path, from_model=undisturbed.path)
    for ours, theirs in zip(further.model.network.trainable_weights, undisturbed.model.network.trainable_weights):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
    assert further.model.spec == undisturbed.model.spec
    with pytest.raises(ValueError, match="from_model: expected"):
        quietly(tiny(), data, undisturbed.path.parent, from_model=undisturbed.path)
    with pytest.raises(ValueError, match="from_model: expected"):
        quietly(tiny(spacing=0.7), data, tmp_path / "other", from_model=undisturbed.path)


def test_settings_of_the_shipped_models_are_known():
    for path in (TRAIN.parents[1] / "models").glob("*.h5"):
        metadata = read_metadata(path)
        assert config.config_of(metadata).spec() == spec_of(metadata)


@pytest.mark.parametrize(
    ("field", "value"), [("architecture", "alexnet"), ("epochs", 0), ("rate", -1.0), ("sweeps", (3, 1))]
)
def test_bad_settings_are_named(field, value):
    with pytest.raises(ValueError, match=field):
        TrainingConfig(**{field: value})


@pytest.mark.parametrize(("architecture", "value"), [("thesis", "float16"), ("far field", "mixed_bfloat16")])
def test_precision_that_a_network_cannot_have_is_named(architecture, value):
    with pytest.raises(ValueError, match=f"precision of {architecture}: expected .*, got '{value}'"):
        TrainingConfig(architecture=architecture, precision=value)


# ---- scripts/train.py, scripts/model_cards.py ----


@pytest.mark.parametrize(
    ("flags", "status", "message"),
    [
        (["--ratee", "3"], 2, "unrecognized arguments: --ratee 3"),
        (["--rate", "abc"], 2, "invalid float value: 'abc'"),
        (["--options", "width"], 2, "invalid option value: 'width'"),
        (["--epochs", "0"], 2, "epochs: expected"),
        (["--data", "nowhere"], 3, "nowhere: expected"),
        (["--from", "nowhere.h5"], 3, "nowhere.h5, which does not exist"),
    ],
)
def test_what_is_wrong_is_said_without_the_list_of_options(flags, status, message, capsys):
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(load_script("train").main(flags))
    assert ended.value.code == status
    *usage, line = capsys.readouterr().err.splitlines()
    assert message in line
    assert len(usage) == message.startswith(("unrecognized", "invalid"))


def test_ctrl_c_ends_training_with_one_line(data, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("deep_contact.cnn.training.train", Mock(side_effect=KeyboardInterrupt))
    assert load_script("train").main(["--data", str(data), "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err.splitlines()[-1].startswith("train: stopped; the same command goes on")


def test_a_script_goes_on_from_a_model(undisturbed):
    script = load_script("train")
    settings = script.configuration({"epochs": 2, "options": [("dropout", 0.2)]}, undisturbed.path)
    assert (settings.epochs, settings.rate, settings.options) == (2, 0.01, {"dropout": 0.2})
    quick = script.configuration({"epochs": 2}, None, quick=True)
    assert (quick.epochs, quick.options, quick.states_per_epoch) == (2, {"width": 8}, 960)
    with pytest.raises(ValueError, match="architecture: expected a recipe of the thesis's"):
        script.configuration({"architecture": "thesis"}, None)
    with pytest.raises(ValueError, match="recipe: expected none beside --from"):
        script.configuration({"recipe": "thesis"}, undisturbed.path)
    ranked = script.configuration({"recipe": "authors' code", "options": [("rank", 9)]}, None)
    assert ranked.options == {"dropout": [0, 0, 0, 0, 0.25], "weight_decay": 1e-4, "rank": 9}
    thesis = script.configuration({"recipe": "thesis"}, None, quick=True)
    assert (thesis.optimizer, thesis.schedule, thesis.options["dropout"]) == ("sgd", "scaled algorithm 6", 0.1)
