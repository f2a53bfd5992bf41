"""Model files, inference and the Cnn start (section 5.4, Algorithm 7)."""

import json
import os
import shutil
import subprocess
import sys

import h5py
import keras
import numpy as np
import pytest

import deep_contact as dc
from deep_contact.cnn import inference
from deep_contact.cnn.architectures import build
from deep_contact.cnn.evaluation import held_out_errors, velocity_errors
from deep_contact.cnn.images import SOLVER_CHANNELS, ImageSpec, input_image, read_back
from deep_contact.cnn.inference import Cnn, LearnedModel, load_model, padded_shape, projected
from deep_contact.cnn.model_file import METADATA, ModelFileError, read_metadata, save_model
from deep_contact.warm_start import Copy, NoStart, warm_start_of

SPEC = ImageSpec(transfer="consistent", channels=SOLVER_CHANNELS, scale_free=True, target_scales=(2.0, 0.5))
CARD = {"seed": 3, "command": "python scripts/train.py"}
BOX = (0.0, 0.0, 30.0, 30.0)


def random_network(name="compact", seed=0, **options):
    """A network with weights by chance, as small as it gets."""
    keras.utils.set_random_seed(seed)
    if name == "compact":
        options = {"channels": len(SPEC.channels), "stem": 4, "width": 8, "decoder": 4, "density": 0} | options
    network = build(name, **options)
    rng = np.random.default_rng(seed)
    network.set_weights([rng.normal(0, 0.2, w.shape) for w in network.get_weights()])
    return network


@pytest.fixture(scope="module")
def network():
    return random_network()


@pytest.fixture
def file(tmp_path, network):
    return save_model(tmp_path / "model.h5", network, SPEC, CARD, coarsening=4)


def changed(path, change):
    """The file with its Keras configuration changed."""
    with h5py.File(path, "r+") as f:
        config = json.loads(f.attrs["model_config"])
        change(config)
        f.attrs["model_config"] = json.dumps(config)
    return path


# ---- files ----


def test_round_trip_of_a_model_file(file, network, falling_states):
    model = load_model(file)
    assert (model.spec, model.card, model.coarsening, model.box) == (SPEC, CARD, 4, None)
    for ours, theirs in zip(network.get_weights(), model.keras.get_weights()):
        np.testing.assert_array_equal(ours, theirs)
    plain = LearnedModel(source=network, spec=SPEC, coarsening=4).predict(falling_states[5])
    np.testing.assert_array_equal(model.predict(falling_states[5]), plain)


def test_file_opens_with_plain_keras(file, network):
    image = np.random.default_rng(0).normal(size=(1, 61, 61, len(SPEC.channels))).astype(np.float32)
    loaded = keras.models.load_model(file, compile=False)
    np.testing.assert_array_equal(loaded(image), network(image))


def test_metadata_is_read_without_tensorflow(file):
    code = f"import sys\nfrom deep_contact.cnn.model_file import read_metadata\nread_metadata({str(file)!r})\n"
    code += "assert not {'tensorflow', 'keras'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_truncated_file_is_refused(file, share):
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ModelFileError, match=r"model\.h5"):
        load_model(file)


def test_foreign_files_are_refused(tmp_path, network):
    path = tmp_path / "model.h5"
    path.write_bytes(b"\x80\x04\x95 not a model")
    with pytest.raises(ModelFileError, match="HDF5"):
        load_model(path)
    with h5py.File(path, "w") as f:
        f["data"] = 1.0
    with pytest.raises(ModelFileError, match="model_config"):
        load_model(path)
    keras.saving.save_model(network, path)
    with pytest.raises(ModelFileError, match=METADATA):
        load_model(path)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.h5"):
        load_model(tmp_path / "none.h5")


def test_changed_weights_are_refused(file):
    with h5py.File(file, "r+") as f:
        found = []
        f["model_weights"].visititems(lambda _, item: found.append(item) if isinstance(item, h5py.Dataset) else None)
        found[0][...] += 1e-3
    with pytest.raises(ModelFileError, match="digest"):
        load_model(file)


def test_changed_metadata_are_refused(file):
    with h5py.File(file, "r+") as f:
        metadata = json.loads(f[METADATA][()])
        metadata["spec"]["spacing"] = 0.25
        del f[METADATA]
        f[METADATA] = json.dumps(metadata)
    with pytest.raises(ModelFileError, match="digest"):
        load_model(file)


def test_lambda_layer_is_refused_before_keras_sees_it(file, monkeypatch):
    def poison(config):
        config["config"]["layers"][1]["class_name"] = "Lambda"

    monkeypatch.setattr(keras.models, "load_model", None)
    with pytest.raises(ModelFileError, match="Lambda"):
        load_model(changed(file, poison))


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("activation", "os.system"),
        ("activation", {"class_name": "__lambda__", "config": "4wAAAA=="}),
        ("kernel_initializer", {"module": "os", "class_name": "system", "config": {}}),
        ("kernel_initializer", {"module": "builtins", "class_name": "function", "config": "eval"}),
        ("bias_regularizer", {"module": "keras.regularizers", "class_name": "Mine", "config": {}}),
    ],
)
def test_parts_that_are_not_stock_are_refused(file, part, value):
    def poison(config):
        layer = next(layer for layer in config["config"]["layers"] if layer["class_name"] == "Conv2D")
        layer["config"][part] = value

    with pytest.raises(ModelFileError, match="model_config"):
        load_model(changed(file, poison))


def test_custom_layer_is_not_written(tmp_path):
    class Mine(keras.layers.Layer):
        def call(self, x):
            return x

    network = keras.Sequential([keras.Input((None, None, len(SPEC.channels))), Mine(), keras.layers.Conv2D(2, 1)])
    with pytest.raises(ModelFileError, match="Mine"):
        save_model(tmp_path / "model.h5", network, SPEC, CARD)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("spec", "field"),
    [
        (SPEC.replace(channels=("mass",), scales=None), "channels"),
        (SPEC.replace(targets=("normal_impulse",), target_scales=None), "targets"),
    ],
)
def test_network_that_does_not_fit_the_spec_is_not_written(tmp_path, network, spec, field):
    with pytest.raises(ModelFileError, match=field):
        save_model(tmp_path / "model.h5", network, spec, CARD)


# ---- the scene ----


@pytest.fixture(scope="module")
def fixed(tmp_path_factory):
    """A network of one size, as the thesis's, for a box of 6 m × 4 m."""
    path = tmp_path_factory.mktemp("fixed") / "thesis.h5"
    return load_model(save_model(path, random_network("thesis", shape=(9, 13)), ImageSpec(), {}, box=(0, 0, 6, 4)))


def small_state(size=(6.0, 4.0)):
    return dc.simulate(dc.circles_in_box(3, size=size, radius=(0.5, 0.5), seed=0), steps=60).state


def test_network_of_fixed_size_predicts_in_its_box(fixed):
    state = small_state()
    image = fixed.predict_image(state)
    assert image.shape == (9, 13, 2)
    np.testing.assert_array_equal(fixed.predict(state), read_back(image, state, fixed.spec))


@pytest.mark.parametrize("size", [(4.0, 6.0), (5.9, 4.0), (12.0, 8.0)])
def test_network_of_fixed_size_refuses_another_box(fixed, size):
    with pytest.raises(ModelFileError, match="box: expected"):
        fixed.predict(small_state(size))


def test_network_of_fixed_size_needs_its_box(tmp_path):
    with pytest.raises(ModelFileError, match="box"):
        save_model(tmp_path / "model.h5", random_network("thesis", shape=(9, 13)), ImageSpec(), {})


@pytest.mark.parametrize("size", [(6.0, 6.0), (7.3, 4.1)])
def test_convolutional_network_takes_any_box(network, size):
    state = small_state(size)
    image = LearnedModel(source=network, spec=SPEC, coarsening=4).predict_image(state)
    assert image.shape == (*SPEC.shape(state.world), 2)


@pytest.mark.parametrize(
    ("shape", "coarsening", "expected"), [((61, 61), 4, (61, 61)), ((62, 64), 4, (65, 65)), ((3, 7), 1, (3, 7))]
)
def test_padded_shape(shape, coarsening, expected):
    assert padded_shape(shape, coarsening) == expected


# ---- inference ----


def test_inference_is_the_network(network, falling_states):
    model = LearnedModel(source=network, spec=SPEC, coarsening=4)
    image = input_image(falling_states[5], SPEC)
    np.testing.assert_allclose(model.run(image), np.asarray(network(image[None]))[0], rtol=1e-5, atol=1e-6)


def test_inference_is_traced_once(network, falling_states, monkeypatch):
    compilations = []
    monkeypatch.setattr(
        inference, "compiled", lambda *given, **more: compilations.append(given[1]) or (lambda image: image[..., :2])
    )
    model = LearnedModel(source=network, spec=SPEC, coarsening=4)
    for state in falling_states:
        model.predict(state)
    assert compilations == [(61, 61, len(SPEC.channels))]


def test_state_written_to_xml_predicts_the_same(file, falling_states, tmp_path):
    state, model = falling_states[5], load_model(file)
    dc.write_state(tmp_path / "state.xml", state)
    read = dc.read_state(tmp_path / "state.xml")
    np.testing.assert_array_equal(model.predict(read), model.predict(state))


# ---- the start ----


def test_projection_is_on_the_friction_cone():
    normal, tangent = projected(np.array([-1.0, 2.0, 2.0]), np.array([5.0, -5.0, 0.5]), 0.5)
    np.testing.assert_array_equal(normal, [0.0, 2.0, 2.0])
    np.testing.assert_array_equal(tangent, [0.0, -1.0, 0.5])


def test_projection_takes_a_friction_for_each_contact_and_keeps_the_precision():
    impulses = np.array([[2.0, 5.0], [2.0, -5.0]], np.float32)
    normal, tangent = projected(*impulses.T, np.array([0.5, 1.0], np.float32))
    assert normal.dtype == tangent.dtype == np.float32
    np.testing.assert_array_equal(tangent, [1.0, -2.0])


def test_cnn_start_is_the_prediction_projected(file, falling_states):
    start, state = Cnn(file), falling_states[5]
    normal, tangent = start(state, state.solver)
    expected = projected(*start.model.predict(state), state.world.friction)
    np.testing.assert_array_equal((normal, tangent), expected)
    assert (normal > 0).any()
    assert (np.abs(tangent) <= state.world.friction * normal).all()


def test_simulation_runs_from_a_network(file):
    run = dc.simulate(small_state(), steps=3, warm_start=Cnn(file))
    assert (run.status == "converged").all()


def test_cnn_start_without_contacts(file):
    state = dc.simulate(dc.circles_in_box(2, seed=0), steps=0).state
    assert [len(part) for part in Cnn(file)(state, None)] == [0, 0]


def test_the_shipped_model_is_found_from_anywhere(tmp_path, monkeypatch, file):
    (tmp_path / "models").mkdir()
    shutil.copy(file, tmp_path / "models" / "model.h5")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("deep_contact.cnn.model_file.__file__", str(tmp_path / "a" / "b" / "c.py"))
    assert load_model().path == tmp_path / "models" / "model.h5"


# ---- what a start is worth ----


def test_errors_of_known_starts(falling_states):
    state = falling_states[5]
    zero = np.zeros(state.contacts.count)
    solved = state.contacts.normal_impulse, state.contacts.tangent_impulse
    assert velocity_errors(state, (zero, zero), [0])[0] == 1.0
    assert velocity_errors(state, solved, [0])[0] == 0.0
    errors = velocity_errors(state, (zero, zero), [1, 10, 100, 1000])
    assert (np.diff(errors) < 0).all()


def test_held_out_errors_count_every_state(falling_states):
    errors = held_out_errors(falling_states, {"none": NoStart(), "copy": Copy()}, sweeps=(0, 5))
    phases = errors["phases"]
    assert phases["all"]["states"] == sum(phases[name]["states"] for name in ("impact", "settling", "rest"))
    assert phases["all"]["none"]["mean"][0] == 1.0
    assert phases["all"]["copy"]["mean"][0] == 0.0


def test_metadata_carry_the_spec(file):
    assert ImageSpec.from_dict(read_metadata(file)["spec"]) == SPEC


def test_a_start_by_name_reads_the_model_again_only_if_the_file_changes(tmp_path, monkeypatch):
    path = tmp_path / "model.h5"
    shutil.copy(inference.default_model_path(), path)
    monkeypatch.setattr(inference, "default_model_path", lambda: path)
    first, again = (warm_start_of("guarded").model for _ in range(2))
    assert warm_start_of("cnn").model is first is again
    os.utime(path, ns=(0, 0))
    assert warm_start_of("cnn").model is not first
