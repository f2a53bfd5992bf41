"""Times of the far-field network by runtime, and of the parts of its start: Table 6.3. In μs, the least of several."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from deep_contact.physics.solvers import PGS
from deep_contact.state import State
from deep_contact.studies import piles, timing
from deep_contact.studies.learned_starts import sweep_time

RUNTIMES = ("Numba", "XLA", "TensorFlow")
"""`cnn.convolution`; one program of TensorFlow's compiler; one call per layer."""


def times_in_process(task: Mapping) -> dict[str, list]:
    """`times` in a fresh process: TensorFlow takes its number of threads only once."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as alone:
        return alone.submit(times, task).result()


def times(task: Mapping) -> dict[str, list]:
    """Times of all networks, runtimes and batches on the image of a settling pile.

    task: "models": paths, "count" of circles, "threads", "batches": images at once, "repeats", "seed".
    Returns {"times": [{"network", "circles", "threads", "runtime", "batch", "us": per image}], "stages":
    [{"network", "circles", "threads", **`parts_of_start`}], with one thread only}.
    """
    from deep_contact.cnn.far_field import describe
    from deep_contact.cnn.inference import limit_threads, load_model, network_file

    limit_threads(task["threads"])
    state = piles.states_of(piles.pile("settling", task["count"], task["seed"]), count=1)[0]
    found: dict = {"times": [], "stages": []}
    for path in task["models"]:
        model = load_model(network_file(path))
        image = describe(state, model.spec).image
        common = {"network": path.split("/")[-1], "circles": task["count"], "threads": task["threads"]}
        if task["threads"] == 1:
            found["stages"].append(common | parts_of_start(model, state, task["repeats"]))
        for batch in task["batches"]:
            images = np.repeat(image[None], batch, axis=0)
            for runtime, run in runtimes(model.network, images.shape, task["threads"]).items():
                us = _us(lambda: run(images), task["repeats"]) / batch  # noqa: B023
                found["times"].append(common | {"runtime": runtime, "batch": batch, "us": us})
    return found


def _us(function: Callable, repeats: int) -> float:
    return 1e6 * timing.fastest(function, repeats)


def runtimes(network, shape: tuple, threads: int) -> dict[str, Callable]:
    """Runtime -> function of a batch of images of this shape."""
    from deep_contact.cnn.backend import tensorflow as tf
    from deep_contact.cnn.convolution import Program

    program = Program(network, shape[1:3], threads=threads)

    def in_tensorflow(one_program):
        signature = [tf.TensorSpec(shape, tf.float32)]
        function = tf.function(
            lambda images: network(images, training=False), input_signature=signature, jit_compile=one_program or None
        ).get_concrete_function()
        return lambda images: function(tf.constant(images)).numpy()

    one_by_one = [lambda images: [program(image) for image in images], in_tensorflow(True), in_tensorflow(False)]
    return dict(zip(RUNTIMES, one_by_one))


def parts_of_start(model, state: State, repeats: int) -> dict[str, float]:
    """Times of the image, the network ("run"), the impulses at the contacts ("read"), of all of it, and of a sweep."""
    from deep_contact.cnn.far_field import correct, describe
    from deep_contact.cnn.inference import Cnn, projected

    start, description = Cnn(model), describe(state, model.spec)
    coefficients = model.run(description.image)

    def read():
        impulses = correct(coefficients, description, model.spec)
        return projected(impulses[:, 0], impulses[:, 1], state.world.friction)

    return {
        "image": _us(lambda: describe(state, model.spec), repeats),
        "run": _us(lambda: model.run(description.image), repeats),
        "read": _us(read, repeats),
        "all": _us(lambda: start(state, PGS()), repeats),
        "sweep": 1e6 * sweep_time(state, "PGS", repeats),
    }
