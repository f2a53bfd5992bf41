"""python scripts/factor_thesis_network.py runs/thesis/model.h5: make the thesis's network small enough to be tracked.

It has 258 MB, of which the last layer has 244. Its matrix W (8192 × 7442) is replaced by a product of rank r, the
largest that keeps the file below --bytes; all other weights stay. W itself is mostly the noise of its initialisation,
so the product is a truncated singular value decomposition of the outputs on the features X of training states: with
Y = X W = U S Vᵀ, W V_r V_rᵀ is the matrix of rank r that changes the outputs for X least (Eckart, Young). The loss of
accuracy is measured on test states and stored in the card.

The full network is rebuilt by the command in its card: python scripts/train.py --architecture thesis …
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np


def largest_rank(model, limit: int) -> int:
    """The largest r such that the factored network is at most `limit` bytes in float32, with room for its card."""
    inputs, outputs = model.layers[-1].kernel.shape
    others = model.count_params() - inputs * outputs
    return min(int((limit - 200_000 - 4 * others) // (4 * (inputs + outputs))), inputs, outputs)


def right_vectors(features: np.ndarray, kernel: np.ndarray, rank: int) -> np.ndarray:
    """V_r, (outputs, rank): the leading right singular vectors of features @ kernel."""
    made = features @ kernel
    if len(made) < rank:
        raise ValueError(f"states: expected at least {rank}, the rank, got {len(made)}")
    return np.linalg.svd(made.astype(np.float64), full_matrices=False)[2][:rank].T.astype(made.dtype)


def factored(model, vectors: np.ndarray):
    """The network with its last layer replaced by two: W V_r, and V_rᵀ with the old bias and ReLU."""
    from deep_contact.cnn.backend import keras

    layers = keras.layers
    kernel, bias = model.layers[-1].get_weights()
    small = keras.models.clone_model(keras.Sequential([keras.Input(model.input_shape[1:]), *model.layers[:-1]]))
    small.set_weights([w for layer in model.layers[:-1] for w in layer.get_weights()])
    first = layers.Dense(vectors.shape[1], use_bias=False, name="impulses_factor")
    last = layers.Dense(kernel.shape[1], activation="relu", name="impulses")
    small = keras.Sequential([keras.Input(model.input_shape[1:], name="bodies"), *small.layers, first, last])
    first.set_weights([kernel @ vectors])
    last.set_weights([np.ascontiguousarray(vectors.T), bias])
    return small


def measured(model, images) -> dict[str, float]:
    """Appendix B's loss, the same with absolute values, and the root of the squared error over the squared labels."""
    totals = np.zeros(4)
    for inputs, labels in (images[k] for k in range(len(images))):
        labels = labels.astype(np.float64)
        off = np.where(labels != 0, model.predict_on_batch(inputs) - labels, 0.0)
        totals += np.sum(off**2), np.sum(np.abs(off)), np.sum(labels**2), labels.size
    squares, absolutes, size, count = totals.tolist()
    found = {"masked_squared_error": squares / count, "masked_absolute_error": absolutes / count}
    return found | {"relative_error": (squares / size) ** 0.5}


def main() -> int:
    """Factor, measure, save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("model", type=Path, help="model file of the trained network")
    add("--data", default="data/generated", help="folder of the simulations")
    add("--out", type=Path, default=Path("models/thesis_factored.h5"), help="the factored model file")
    add("--bytes", type=int, default=25_000_000, help="largest size of the file")
    add("--states", type=int, default=2000, help="training states for the decomposition")
    add("--held-out", type=int, default=300, help="test states to measure on")
    given = parser.parse_args()
    from deep_contact.cnn.backend import keras
    from deep_contact.cnn.dataset import Store, evenly
    from deep_contact.cnn.evaluation import BASELINES, held_out_errors
    from deep_contact.cnn.inference import Cnn, LearnedModel, load_model
    from deep_contact.cnn.model_file import save_model
    from deep_contact.cnn.training import ImageDataset

    full = load_model(given.model)
    model, spec, box = full.network, full.spec, full.box
    store, split = Store(given.data), full.card["split"]
    chosen = evenly(store.states(split["train"]), given.states)
    before = keras.Sequential([keras.Input(model.input_shape[1:]), *model.layers[:-1]])
    features = before.predict(ImageDataset(store, chosen, spec, batch_size=32), verbose=0)
    rank = largest_rank(model, given.bytes)
    small = factored(model, right_vectors(features, model.layers[-1].get_weights()[0], rank))
    tested = evenly(store.states(split["test"]), given.held_out)
    networks = {"full": model, "cnn": small}
    errors = {name: measured(one, ImageDataset(store, tested, spec, batch_size=32)) for name, one in networks.items()}
    starts = {name: Cnn(LearnedModel(source=one, spec=spec, box=box)) for name, one in networks.items()}
    card = full.card | {"parameters": int(small.count_params())}
    card["factored"] = {"rank": rank, "training_states": len(chosen), "errors": errors, "of": "the last Dense layer"}
    card["held_out"] = held_out_errors((store.state(*state) for state in tested.tolist()), BASELINES | starts)
    save_model(given.out, small, spec, card, box=(0.0, 0.0, *box))
    print(f"{given.out}: rank {rank}, {given.out.stat().st_size / 1e6:.1f} MB; {errors}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
