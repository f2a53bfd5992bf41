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
    # Through the smaller Gram matrix, in float64: Y Yᵀ = U S² Uᵀ, and V = Yᵀ U / S.
    values, left = np.linalg.eigh((made @ made.T).astype(np.float64))
    order = np.argsort(values)[::-1][:rank]
    vectors = made.T @ (left[:, order] / np.sqrt(np.maximum(values[order], 1e-30)))
    # Where S is nearly 0 the columns are not quite orthogonal any more.
    return np.linalg.qr(vectors)[0]


def factored(model, vectors: np.ndarray):
    """The network with its last layer replaced by two: W V_r, and V_rᵀ with the old bias and ReLU."""
    from deep_contact.cnn.backend import keras

    layers = keras.layers
    kernel, bias = model.layers[-1].get_weights()
    small = keras.Sequential(
        [
            keras.Input(model.input_shape[1:], name="bodies"),
            *(type(layer).from_config(layer.get_config()) for layer in model.layers[:-1]),
            layers.Dense(vectors.shape[1], use_bias=False, name="impulses_factor"),
            layers.Dense(kernel.shape[1], activation="relu", name="impulses"),
        ],
        name="thesis_factored",
    )
    for new, old in zip(small.layers, model.layers[:-1]):
        new.set_weights(old.get_weights())
    small.layers[-2].set_weights([kernel @ vectors])
    small.layers[-1].set_weights([np.ascontiguousarray(vectors.T), bias])
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
    add("model", type=Path)
    add("--data", default="data/generated")
    add("--out", type=Path, default=Path("models/thesis_factored.h5"))
    add("--bytes", type=int, default=25_000_000, help="largest size of the file")
    add("--states", type=int, default=2000, help="training states for the decomposition")
    add("--held-out", type=int, default=300, help="test states to measure on")
    add("--threads", type=int, default=1)
    given = parser.parse_args()
    from deep_contact.cnn.backend import keras
    from deep_contact.cnn.dataset import Store, evenly
    from deep_contact.cnn.evaluation import BASELINES, held_out_errors
    from deep_contact.cnn.inference import Cnn, LearnedModel, limit_threads, load_model
    from deep_contact.cnn.model_file import save_model
    from deep_contact.cnn.training import ImageDataset

    limit_threads(given.threads)
    full = load_model(given.model)
    model, spec, box = full.network, full.spec, full.box
    store, split = Store(given.data), full.card["split"]
    chosen = evenly(store.states(split["train"]), given.states)
    images = ImageDataset(store, chosen, spec, batch_size=32)
    before = keras.Sequential([keras.Input(model.input_shape[1:]), *model.layers[:-1]])
    features = np.concatenate([before.predict_on_batch(images[k][0]) for k in range(len(images))])
    rank = largest_rank(model, given.bytes)
    small = factored(model, right_vectors(features, model.layers[-1].get_weights()[0], rank))
    tested = evenly(store.states(split["test"]), given.held_out)
    test = ImageDataset(store, tested, spec, batch_size=32)
    errors = {name: measured(network, test) for name, network in (("full", model), ("factored", small))}
    networks = {"full": model, "cnn": small}
    starts = {name: Cnn(LearnedModel(source=network, spec=spec, box=box)) for name, network in networks.items()}
    card = full.card | {"parameters": int(small.count_params())}
    card["factored"] = {"rank": rank, "training_states": len(chosen), "errors": errors, "of": "the last Dense layer"}
    card["held_out"] = held_out_errors((store.state(*state) for state in tested.tolist()), BASELINES | starts)
    save_model(given.out, small, spec, card, box=(0.0, 0.0, *box))
    print(f"{given.out}: rank {rank}, {given.out.stat().st_size / 1e6:.1f} MB")
    for name, found in errors.items():
        print(f"  {name:9s}", "  ".join(f"{key} {value:.6g}" for key, value in found.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
