"""Model files, inference and the Cnn start (section 5.4, Algorithm 7)."""

import json
import os
import shutil
from types import SimpleNamespace

import h5py
import keras
import numpy as np
import pytest
from conftest import run_python

import deep_contact as dc
from deep_contact.cnn import evaluation, far_field, inference, model_file, registry
from deep_contact.cnn.architectures import build
from deep_contact.cnn.evaluation import held_out_errors, start_quality, velocity_errors
from deep_contact.cnn.images import ImageSpec, input_image, read_back
from deep_contact.cnn.inference import LearnedModel, load_model
from deep_contact.cnn.model_file import METADATA, ModelFileError, read_metadata, save_model
from deep_contact.cnn.start import Cnn
from deep_contact.sph.start import Copy
from deep_contact.starts.classical import NoStart
from deep_contact.starts.names import warm_start_of

SPEC = ImageSpec()
CARD = {"seed": 3, "command": "python scripts/train.py"}
BOX = (0.0, 0.0, 30.0, 30.0)


def random_network(**options):
    """A network with weights by chance: convolutions that take images of any size, or with `options` the thesis's."""
    keras.utils.set_random_seed(0)
    if options:
        network = build("thesis", stacks=[[4, [2]], [8, [2]]], **options)
    else:
        kinds = {"half": (8, 3, "relu"), "quarter": (8, 2, "tanh"), "field": (2, 1, None)}
        layers = [keras.layers.Conv2D(n, k, padding="same", activation=a, name=m) for m, (n, k, a) in kinds.items()]
        network = keras.Sequential([keras.Input((None, None, len(SPEC.channels))), *layers])
    rng = np.random.default_rng(0)
    for weight in network.weights:
        values = rng.normal(0, 0.2, weight.shape)
        # The root of a negative variance is none, of which some processors' rectifiers make 0 and others do not.
        weight.assign(np.abs(values) if "variance" in weight.path else values)
    return network


@pytest.fixture(scope="module")
def network():
    return random_network()


@pytest.fixture
def file(tmp_path, network):
    return save_model(tmp_path / "model.h5", network, SPEC, CARD)


def rewritten(path, change, digest=True):
    """The file after `change(weights, metadata, layers)`, with the digest of its contents, if asked for."""
    with h5py.File(path, "r+") as f:
        config, metadata = json.loads(f.attrs["model_config"]), json.loads(f[METADATA][()])
        change(f["model_weights"], metadata, config["config"]["layers"])
        f.attrs["model_config"] = json.dumps(config)
        if digest:
            datasets = model_file._datasets(f["model_weights"])
            metadata["digest"] = model_file._digest(f.attrs["model_config"], datasets, metadata)
        del f[METADATA]
        f[METADATA] = json.dumps(metadata)
    return path


# ---- files ----


def test_round_trip_of_a_model_file(file, network, falling_states):
    model = load_model(file)
    assert (model.spec, model.card, model.box) == (SPEC, CARD, None)
    for ours, theirs in zip(network.get_weights(), model.network.get_weights()):
        np.testing.assert_array_equal(ours, theirs)
    plain = LearnedModel(source=network, spec=SPEC).predict(falling_states[5])
    np.testing.assert_array_equal(model.predict(falling_states[5]), plain)


def test_file_opens_with_plain_keras(file, network):
    image = np.random.default_rng(0).normal(size=(1, 61, 61, len(SPEC.channels))).astype(np.float32)
    loaded = keras.models.load_model(file, compile=False)
    np.testing.assert_array_equal(loaded(image), network(image))


def test_keras_is_imported_on_request_on_the_threads_asked_for_without_a_line_of_its_log(monkeypatch):
    """Nor before: `test_without_keras`."""
    code = "from deep_contact.cnn.backend import limit_threads; limit_threads(1); import deep_contact as dc, sys"
    code += "; model = dc.load_model('far field'); print('keras' in sys.modules); model.network"
    code += "; from deep_contact.cnn.backend import tensorflow as tf"
    code += "; print(tf.config.threading.get_intra_op_parallelism_threads())"
    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL", raising=False)
    done = run_python("-c", code)
    assert (done.stdout.split(), done.stderr) == (["False", "1"], "")


def test_a_file_of_plain_keras_is_refused(tmp_path, network):
    keras.saving.save_model(network, tmp_path / "model.h5")
    with pytest.raises(ModelFileError, match=METADATA):
        read_metadata(tmp_path / "model.h5")
    with pytest.raises(ModelFileError, match=r"LearnedModel\(source=keras.models.load_model\(…\), spec=ImageSpec"):
        load_model(tmp_path / "model.h5")


@pytest.mark.parametrize("text", ["[" * 60_000, '{"a":' * 12_000])
def test_deep_nesting_is_refused(file, text):
    with h5py.File(file, "r+") as f:
        del f[METADATA]
        f[METADATA] = text
    with pytest.raises(ModelFileError, match=METADATA):
        read_metadata(file)
    with h5py.File(file, "r+") as f:
        f.attrs["model_config"] = text
    with pytest.raises(ModelFileError, match="model_config"):
        read_metadata(file)


@pytest.mark.parametrize("text", ["[]", '{"model": {"file": "model.h5"}}', '{"model": -1}', "[" * 100_000])
def test_a_registry_that_is_none_is_refused(tmp_path, monkeypatch, text):
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "registry.json").write_text(text)
    monkeypatch.setattr(registry, "ROOT", tmp_path)
    with pytest.raises(ModelFileError, match=r"registry\.json: expected"):
        load_model("model")


class Mine(keras.layers.Layer):
    def call(self, x):
        return x


@pytest.mark.parametrize(
    ("made", "spec", "field"),
    [
        (lambda network: keras.Sequential([network, Mine()]), SPEC, "expected a stock"),
        (lambda network: keras.Sequential([keras.Input((None, None, 4)), keras.layers.ReLU()]), SPEC, "channels"),
        (lambda network: keras.Sequential([keras.Input((None, None, 5)), keras.layers.ReLU()]), SPEC, "targets"),
        (lambda network: random_network(shape=(9, 13)), ImageSpec(), "box"),
        (lambda network: network, far_field.FarFieldSpec(), "model_weights: expected"),
    ],
)
def test_a_network_that_may_not_or_does_not_fit_is_not_written(tmp_path, network, made, spec, field):
    with pytest.raises(ValueError, match=field):
        save_model(tmp_path / "model.h5", made(network), spec, CARD)
    assert not list(tmp_path.iterdir())


# Arguments that Keras 3.15 writes and Keras 3.4 refuses, one that no Keras knows, and one that is none.
FOREIGN = {"quantization_config": None, "later": 1, "bias_initializer": {"module": "os", "class_name": "system"}}
FOREIGN["kernel_initializer"] = {"input_axes": None, "output_axes": None}


def test_arguments_that_do_not_shape_a_layer_stay_out_of_keras(file, network):
    def later(weights, metadata, layers):
        for layer in (layer for layer in layers if layer["class_name"] == "Conv2D"):
            layer["config"] |= FOREIGN

    for ours, theirs in zip(network.get_weights(), load_model(rewritten(file, later)).network.get_weights()):
        np.testing.assert_array_equal(ours, theirs)


def test_a_written_file_holds_only_the_arguments_of_the_list(file):
    with h5py.File(file) as f:
        config = json.loads(f.attrs["model_config"])
    kept = {name for layer in config["config"]["layers"] for name in layer["config"]}
    assert kept <= model_file._ARGUMENTS
    assert model_file.portable(config) == config


def weight(value):
    return lambda weights, metadata, layers: weights["half/half/bias"].__setitem__(1, value)


def said(**changes):
    return lambda weights, metadata, layers: metadata.update(changes)


def part(**changes):
    return lambda weights, metadata, layers: layers[-1]["config"].update(changes)


@pytest.mark.parametrize(
    ("change", "digest", "expected"),
    [
        (weight(0.5), False, "digest"),
        (weight(np.nan), True, "model_weights/half/half/bias: .*nan"),
        (said(card=None), True, "card"),
        (said(spec=[]), True, "spec"),
        (said(spec=SPEC.to_dict() | {"scale_free": True}), True, "spec: ImageSpec: scale_free: expected"),
        (said(spec=SPEC.to_dict() | {"spacing": 0.25}), False, "digest"),
        (said(coarsening=4), True, "coarsening"),
        (said(box=[1]), True, "box"),
        (lambda weights, metadata, layers: layers[-1].update(class_name="Lambda"), True, "model_config"),
        (part(activation="os.system"), True, "model_config"),
        (part(activation={"class_name": "__lambda__", "config": "4wAAAA=="}), True, "model_config"),
        (part(bias_regularizer={"module": "keras.regularizers", "class_name": "Mine"}), True, "model_config"),
    ],
)
def test_what_was_changed_or_is_not_stock_is_refused_before_keras_sees_it(file, change, digest, expected, monkeypatch):
    monkeypatch.setattr(model_file.StoredNetwork, "build", None)
    with pytest.raises(ModelFileError, match=rf"model\.h5: {expected}"):
        load_model(rewritten(file, change, digest))


# ---- names ----


def test_every_shipped_file_is_registered_under_its_hash():
    models = registry.ROOT / "models"
    assert sorted(map(registry.network_file, registry.registered())) == sorted(models.rglob("*.h5"))
    assert load_model("far field, no past").path.samefile(load_model("models/far_field_no_past.h5").path)


def test_models_are_found_in_the_folder_that_is_named_and_in_the_current_one(tmp_path, monkeypatch):
    (tmp_path / "models").mkdir()
    copy = shutil.copy(registry.network_file("far field, no past"), tmp_path / "models")
    monkeypatch.setenv("DEEP_CONTACT_MODELS", str(tmp_path / "models"))
    assert str(registry.network_file("far field, no past")) == copy
    assert registry.network_file("model") == registry.ROOT / "models" / "model.h5"
    shutil.copy(registry.network_file("model"), copy)
    with pytest.raises(ModelFileError, match=r"far_field_no_past\.h5: sha256: expected"):
        load_model("far field, no past")
    monkeypatch.delenv("DEEP_CONTACT_MODELS")
    for name in ("model.h5", "registry.json"):
        shutil.copy(registry.ROOT / "models" / name, tmp_path / "models")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "ROOT", tmp_path / "elsewhere")
    assert load_model().path == tmp_path / "models" / "model.h5"


def test_a_model_that_is_missing_is_named(tmp_path, monkeypatch):
    known = registry.registered()
    monkeypatch.setattr(registry, "ROOT", tmp_path)
    monkeypatch.setattr(registry, "registered", lambda: known)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match="model far field, no past: expected"):
        load_model("far field, no past")
    with pytest.raises(FileNotFoundError, match=r"or one of .*'far field, no past'.*got magic\.h5"):
        load_model("magic.h5")


@pytest.mark.parametrize("name", ["no_past", "no_past.h5", "models/thesis_factored.h5", "thesis_factored"])
def test_a_name_of_before_names_that_of_today(name):
    now = "'model'" if "thesis" in name else "'far field, no past'"
    with pytest.raises(ValueError, match=f"model file: {name} is called {now} now"):
        load_model(name)


# ---- the scene ----


@pytest.fixture(scope="module")
def fixed(tmp_path_factory):
    """A network of one size, as the thesis's, for a box of 6 m × 4 m."""
    path = tmp_path_factory.mktemp("fixed") / "thesis.h5"
    return load_model(save_model(path, random_network(shape=(9, 13)), ImageSpec(), {}, box=(0, 0, 6, 4)))


def small_state(size=(6.0, 4.0)):
    return dc.simulate(dc.circles_in_box(3, size=size, radius=(0.5, 0.5), seed=0), steps=60).state


@pytest.mark.parametrize("size", [(4.0, 6.0), (5.9, 4.0)])
def test_network_of_fixed_size_refuses_another_box(fixed, size):
    with pytest.raises(ModelFileError, match=r'box: expected .* the network "far field" takes any box'):
        fixed.predict(small_state(size))


@pytest.mark.parametrize("size", [(6.0, 6.0), (7.3, 4.1)])
def test_convolutional_network_runs_in_any_box(network, size):
    state, model = small_state(size), LearnedModel(source=network, spec=SPEC)
    image = model.predict_image(state)
    assert image.shape == (*SPEC.shape(state.world), 2)
    np.testing.assert_array_equal(model.predict(state, project=False), read_back(image, state, SPEC))
    np.testing.assert_allclose(image, network(input_image(state, SPEC)[None])[0], rtol=1e-5, atol=1e-6)
    run = dc.simulate(state, steps=3, solver=dc.PGS(), warm_start=Cnn(model))
    assert set(run.status) <= {"converged", "no_contacts"}


@pytest.mark.parametrize("policy", ["mixed_float16", "bfloat16", "float64"])
def test_a_policy_of_keras_changes_no_prediction(policy, falling_states):
    """Under mixed_float16 the thesis's network was off by 6e-4."""
    state, before = falling_states[5], keras.config.dtype_policy()
    expected = load_model().predict(state)
    try:
        keras.config.set_dtype_policy(policy)
        found = load_model().predict(state)
    finally:
        keras.config.set_dtype_policy(before)
    np.testing.assert_array_equal(found, expected)


SPOILT = {
    "position": lambda state: state.replace(bodies=state.bodies._replace(position=0.0 * state.bodies.position / 0.0)),
    "velocity": lambda state: state.replace(bodies=state.bodies._replace(velocity=0.0 * state.bodies.velocity / 0.0)),
    "normal": lambda state: state.replace(contacts=state.contacts._replace(normal=state.contacts.normal[:, :1].copy())),
    "body_b": lambda state: state.replace(contacts=state.contacts._replace(body_b=state.contacts.body_b + 10**6)),
}
"""Field -> a state that does not hold together there."""


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("field", SPOILT)
@pytest.mark.parametrize("name", ["far field", "model"])
def test_a_state_that_does_not_hold_together_is_not_predicted(name, field, falling_states):
    with pytest.raises(ValueError, match=field):
        load_model(name).predict(SPOILT[field](falling_states[5]))


@pytest.mark.parametrize("name", ["model", "far field"])
def test_plain_keras_between_input_and_impulses_gives_the_prediction(name, falling_states):
    net, state = load_model(name), falling_states[5]
    y = net.network(net.input(state)[None], training=False)
    for project in (True, False):
        expected = np.array(net.predict(state, project=project))
        found = np.array(net.impulses(state, y, project=project))
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
    with pytest.raises(ValueError, match="output: expected"):
        net.impulses(state, np.zeros((1, 7)))
    with pytest.raises(ValueError, match="image: expected"):
        net.run(np.zeros((60, 60, 5)))


def plain(*layers, takes=(None, None, 5), gives=2, **options):
    """A small network of plain Keras, called "mine", whose last layer is a convolution."""
    last = keras.layers.Conv2D(gives, 3, padding="same", **options)
    return keras.Sequential([keras.Input(takes), *layers, last], name="mine")


def plain_of_two():
    """A network of plain Keras, "mine", that takes two images."""
    images = [keras.Input((61, 61, 5)) for _ in range(2)]
    return keras.Model(images, plain()(keras.layers.add(images)), name="mine")


def flat(network):
    """The network with its output flattened, "mine"."""
    return keras.Model(network.inputs, keras.layers.Flatten()(network.outputs[0]), name="mine")


WRONG_SHAPES = {
    "four channels": (
        lambda: plain(takes=(None, None, 4)),
        r"channels: expected an input of shape \(None, n_y, n_x, 5\) for mass, .*, got \(None, None, None, 4\)",
    ),
    "a vector": (
        lambda: keras.Sequential([keras.Input((5,)), keras.layers.Dense(2)], name="mine"),
        r"channels: expected an input of shape .*, got \(None, 5\)",
    ),
    "two inputs": (
        plain_of_two,
        r"channels: expected an input of shape .*, got \[\(None, 61, 61, 5\), \(None, 61, 61, 5\)\]",
    ),
    "one target": (
        lambda: plain(gives=1),
        r"targets: expected an output of shape \(None, n_y, n_x, 2\) for normal_.*, got \(None, None, None, 1\)",
    ),
    "half of the nodes": (
        lambda: plain(takes=(61, 61, 5), strides=2),
        r"targets: expected an output of shape \(None, 61, 61, 2\) for .*, got \(None, 31, 31, 2\)",
    ),
    "flat, too short": (
        lambda: flat(plain(takes=(61, 61, 5), gives=1)),
        r"targets: expected an output of shape \(None, 61, 61, 2\) for .*, got \(None, 3721\)",
    ),
}
"""What is wrong with a network of fixed shapes -> the network, and what the error says."""


@pytest.mark.parametrize("name", WRONG_SHAPES)
def test_a_network_of_a_wrong_shape_is_refused_when_it_is_made_a_start(name):
    made, said = WRONG_SHAPES[name]
    with pytest.raises(ValueError, match=f"^model 'mine': {said}$"):
        LearnedModel(source=made(), spec=SPEC)


def test_a_network_that_halves_images_of_any_size_is_refused_when_it_is_used(falling_states):
    """Its shapes are known once it has seen an image."""
    model, state = LearnedModel(source=plain(strides=2), spec=SPEC), falling_states[5]
    expected = r"expected shape \(1, 61, 61, 2\) for an input of \(1, 61, 61, 5\), got \(1, 31, 31, 2\)"
    for use in (model.predict, lambda state: dc.step(state, warm_start=model)):
        with pytest.raises(ValueError, match=f"^model 'mine': output: {expected}$"):
            use(state)


def test_a_network_of_one_size_names_itself_where_an_image_has_another(tmp_path):
    state = small_state((4.0, 6.0))
    own = LearnedModel(source=plain(takes=(9, 13, 5)), spec=SPEC)
    with pytest.raises(ValueError, match=r"^model 'mine': shape: expected images of \(9, 13\) .*, got \(13, 9\)$"):
        own.predict(state)
    path = save_model(tmp_path / "own.h5", own.source, SPEC, {}, box=(0, 0, 4, 6))
    with pytest.raises(ModelFileError, match=r"own\.h5: shape: expected images of \(9, 13\) .*, got \(13, 9\)$"):
        load_model(path).predict(state)


def test_a_flat_output_of_one_size_fits():
    made = flat(plain(takes=(61, 61, 5)))
    assert LearnedModel(source=made, spec=SPEC).run(np.zeros((61, 61, 5))).shape == (61, 61, 2)


def test_a_network_without_shapes_of_its_own_is_refused():
    """As a Sequential before its first call, or a subclass of `keras.Model`."""
    with pytest.raises(ValueError, match=r"^source: expected a keras\.Model with an input_shape, .*keras\.Input$"):
        LearnedModel(source=keras.Sequential([keras.layers.ReLU()]), spec=SPEC)


def test_a_network_that_is_no_far_field_network_is_refused():
    with pytest.raises(ValueError, match=r"^model 'mine': model_weights: expected the layers of"):
        inference.FarFieldModel(source=plain(), spec=far_field.FarFieldSpec())


def test_inference_is_traced_once(network, falling_states, monkeypatch):
    compilations = []
    compiled = lambda model, shape, output: compilations.append(shape) or (lambda image: image[..., :2])  # noqa: E731
    monkeypatch.setattr(LearnedModel, "_compile", compiled)
    model = LearnedModel(source=network, spec=SPEC)
    for state in falling_states:
        model.predict(state)
    assert compilations == [(61, 61, len(SPEC.channels))]


# ---- the start ----


def test_a_network_or_its_path_is_a_start(falling_states):
    state, model = falling_states[5], dc.load_model()
    starts = "cnn", model, model.path, str(model.path)
    found = {dc.solve_contacts(state, start=start).normal_impulses.tobytes() for start in starts}
    runs = {dc.step(state, solver=dc.PGS(), warm_start=start).bodies.position.tobytes() for start in starts}
    assert len(found) == len(runs) == 1


def test_cnn_start_is_the_prediction_projected(file, falling_states):
    start, state = Cnn(file), falling_states[5]
    raw_n, raw_t = start.model.predict(state, project=False)
    normal, tangent = start(state, state.solver)
    np.testing.assert_array_equal(normal, np.maximum(raw_n, 0.0))
    limit = state.world.friction * normal
    np.testing.assert_array_equal(tangent, np.clip(raw_t, -limit, limit))
    assert (normal > 0).any()


@pytest.mark.parametrize("name", ["model", "far field"])
def test_without_contacts_the_prediction_is_empty(name):
    state, model = dc.simulate(dc.circles_in_box(2, seed=0), steps=0).state, load_model(name)
    assert [part.shape for part in model.predict(state)] == [(0,), (0,)]
    assert [part.shape for part in Cnn(model)(state, None)] == [(0,), (0,)]


@pytest.mark.parametrize("name", ["model", "far field"])
def test_several_states_and_foreign_byte_orders(name, falling_states):
    model, states = load_model(name), falling_states[4:6]
    expected = [model.predict(state) for state in states]
    np.testing.assert_array_equal(np.hstack(model.predict(states)), np.hstack(expected))
    swapped = {
        name: type(part)(*(array.astype(array.dtype.newbyteorder(">")) for array in part))
        for name, part in (("bodies", states[0].bodies), ("contacts", states[0].contacts))
    }
    np.testing.assert_array_equal(model.predict(states[0].replace(**swapped)), expected[0])
    sides = (61, 61) if name == "model" else (9, 9)
    image = np.random.default_rng(0).normal(size=(*sides, len(model.spec.channels)))
    expected = model.run(image.astype(np.float32))
    np.testing.assert_array_equal(model.run(np.asfortranarray(image.astype(">f8"))), expected)


def test_a_model_says_what_it_is_takes_and_gives():
    text = repr(load_model("far field"))
    for part in (
        "far_field.h5",
        "far field",
        "115,420",
        "29 channels",
        "8 k + 1",
        "12 coefficients at every second node",
    ):
        assert part in text
    assert "any number of nodes a side" in inference.ends(ImageSpec())["takes"]
    text = load_model()._repr_html_()
    assert "30 m × 30 m" in text
    assert "<td>images of normal_impulse, tangent_impulse</td>" in text


# ---- what a start is worth ----


def test_errors_of_known_starts(falling_states):
    state = falling_states[5]
    zero = np.zeros(state.contacts.count)
    solved = state.contacts.normal_impulse, state.contacts.tangent_impulse
    assert velocity_errors(state, solved, [0])[0] == 0.0
    errors = velocity_errors(state, (zero, zero), [0, 1, 10, 100, 1000])
    assert errors[0] == 1.0
    assert (np.diff(errors) < 0).all()
    phases = held_out_errors(falling_states, {"none": NoStart(), "copy": Copy()}, sweeps=(0, 5))["phases"]
    assert phases["all"]["states"] == sum(phases[name]["states"] for name in ("impact", "settling", "rest"))
    assert (phases["all"]["none"]["mean"][0], phases["all"]["copy"]["mean"][0]) == (1.0, 0.0)


def test_quality_of_known_starts(falling_states):
    """A tenth of the solution has an error of 0.9, which the best factor takes to 0; zero has 1, with any factor."""
    tenth = start_quality(falling_states, lambda state, solver: [0.1 * part for part in Copy()(state, solver)])
    expected = {"impulse_error": 0.9, "scaled_error": 0.0, "factor": 10.0, "correlation": 1.0, "velocity_error": 0.9}
    assert {name: tenth[name] for name in expected} == pytest.approx(expected, abs=1e-9)
    zero = start_quality(falling_states, NoStart(), sweeps=(0, 5))
    expected = {"impulse_error": 1.0, "scaled_error": 1.0, "factor": 0.0, "correlation": 0.0, "velocity_error": 1.0}
    assert {name: zero[name] for name in expected} == expected
    errors = [velocity_errors(state, NoStart()(state, None), (5,)) for state in falling_states]
    assert zero["velocity_error_5"] == pytest.approx(np.mean(errors))


def test_states_that_carry_nothing_do_not_decide_on_the_quality_of_a_start(falling_states):
    """Where v* is v⁻ but for rounding, any start has a velocity error of up to 1e16: the mean of a training had it."""
    state = falling_states[5]
    nothing = {name: 1e-9 * getattr(state.contacts, name) for name in ("normal_impulse", "tangent_impulse")}
    touching = state.replace(contacts=state.contacts._replace(**nothing))
    builtin = evaluation.BASELINES["builtin"]
    found = start_quality([*falling_states, touching], builtin, sweeps=(0,))
    assert found["velocity_error"] == start_quality(falling_states, builtin, sweeps=(0,))["velocity_error"]


def test_a_start_by_name_reads_the_model_again_only_if_the_file_changes(tmp_path, monkeypatch):
    path = tmp_path / "model.h5"
    shutil.copy(registry.network_file("model"), path)
    monkeypatch.setenv(registry.FOLDER, str(tmp_path))
    first, again = (warm_start_of("cnn").model for _ in range(2))
    assert first is again
    os.utime(path, ns=(0, 0))
    assert warm_start_of("cnn").model is not first


@pytest.mark.parametrize("shape", [(16, 9), (9, 16), (9, 9, -1), (9, 9, 0, 1)])
def test_a_far_field_network_names_the_sides_that_it_takes(shape):
    model = dc.load_model("far field")
    channels = len(model.spec.channels)
    assert model._output_shape((17, 9, channels)) == (9, 5, len(model.spec.targets))
    shape = (*shape[:2], channels + sum(shape[2:3]), *shape[3:])
    with pytest.raises(ValueError, match=r"image: expected shape \(8 j \+ 1, 8 k \+ 1, "):
        model.run(np.zeros(shape))


def test_errors_of_held_out_states_are_means_and_medians_by_phase(monkeypatch):
    """States without a finite error are left out."""
    seen = [("impact", 1.0, 2.0), ("impact", 2.0, 4.0), ("impact", 6.0, 9.0), ("rest", 3.0, 1.0), ("rest", np.inf, 1.0)]
    states = [SimpleNamespace(phase=phase, errors=errors, solver=None) for phase, *errors in seen]
    monkeypatch.setattr(evaluation, "phase", lambda state: state.phase)
    monkeypatch.setattr(evaluation, "velocity_errors", lambda state, start, sweeps: start * np.array(state.errors))
    starts = {"one": lambda state, solver: 1.0, "ten": lambda state, solver: 10.0}
    found = held_out_errors(states, starts, sweeps=(0, 5))["phases"]
    assert {phase: of["states"] for phase, of in found.items()} == {"impact": 3, "settling": 0, "rest": 1, "all": 4}
    assert found["impact"]["one"] == {"mean": [3.0, 5.0], "median": [2.0, 4.0]}
    assert found["all"]["ten"] == {"mean": [30.0, 40.0], "median": [25.0, 30.0]}
