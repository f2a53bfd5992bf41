"""python scripts/table_6_1_maps.py: one network for both maps of impulses, or one for each.

These are goals 7 to 9 of the thesis, which it answers by an argument only (section 6.1). The networks are the thesis's
with fewer filters, a factored last layer, and images with half as many nodes along an edge. All are trained on the same
states with the thesis's loss (Appendix B). Each is trained three times, with different random initial weights. The
optimizer is Adam, whose steps do not depend on the scale of a loss.
"""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from deep_contact import figures
from deep_contact.cnn.backend import one_thread
from deep_contact.cnn.evaluation import start_quality
from deep_contact.cnn.images import ImageSpec, input_image, label_image, read_back
from deep_contact.figures import Claim, Figure
from deep_contact.measure.errors import interval
from deep_contact.parallel import parallel_map, seeds
from deep_contact.stepping.rows import projected
from deep_contact.studies import starts
from deep_contact.studies.verdicts import FEWEST

ONE, LARGE, EACH = "one for both", "one for both, as large as two", "one each"
MAPS = {ONE: [(0, 1)], LARGE: [(0, 1)], EACH: [(0,), (1,)]}
"""Variant -> the maps that each of its networks predicts. Map 0 is λ_n, and map 1 is λ_t."""

KERNELS = (3, 3), (3, 3, 2), (2, 2, 2), (2, 2, 2), (2, 2, 2)
"""Sides of the kernels in the thesis's stacks. Each stack has twice the filters of the stack before."""

SWEEPS = 3, 10
"""Numbers of sweeps after which velocity errors are measured."""
ALIKE = 0.9, 1.1
"""Range of the ratio of two errors in which the errors count as equal."""


def compute(options, seed, jobs, progress):
    """Make states, train every variant with all its initial weights, and measure the errors on held-out scenes."""
    simulate, count = partial(states_of, options=options), options["simulations"] + options["scenes"]
    every = parallel_map(simulate, seeds(seed, count), jobs=jobs, progress=progress, text="scenes")
    train, test = every[: options["simulations"]], every[options["simulations"] :]
    spec = ImageSpec(spacing=options["spacing"], support=options["spacing"])
    tasks = [(variant, one) for variant in MAPS for one in range(options["seeds"])]
    with tempfile.TemporaryDirectory() as folder:
        for name, scenes in (("train", train), ("test", test)):
            flat = [state for of_scene in scenes for state in of_scene]
            np.save(Path(folder, f"{name}_x.npy"), np.stack([input_image(state, spec) for state in flat]))
            np.save(Path(folder, f"{name}_y.npy"), np.stack([label_image(state, spec) for state in flat]))
        learn = partial(trained_maps, folder=folder, options=options)
        made = parallel_map(learn, tasks, jobs=jobs, progress=progress, text="trainings")
    data = {variant: {"parameters": 0, "errors": []} for variant in MAPS}
    for (variant, _), (parameters, images) in zip(tasks, made):
        data[variant]["parameters"] = parameters
        data[variant]["errors"].append(errors_of(test, images, spec))
    return {"variants": data, "states": [sum(map(len, scenes)) for scenes in (train, test)]}


def states_of(seed, options):
    """Return solved states of a run of the thesis's scene."""
    return starts.solved_states(starts.scene_of(options, seed), steps=options["steps"], every=options["every"])


def trained_maps(task, folder, options):
    """Train the networks of a variant.

    task: (variant, seed of the initial weights). folder: folder with the images of the states. Returns the number of
    the networks' parameters, and the predicted maps of the held-out states, (n, n_y, n_x, 2), N·s.
    """
    one_thread()
    from deep_contact.cnn.architectures import build
    from deep_contact.cnn.backend import keras
    from deep_contact.cnn.training.network import masked_squared_error

    variant, seed = task
    inputs, labels, test = (np.load(Path(folder, f"{name}.npy")) for name in ("train_x", "train_y", "test_x"))
    filters, rank = options["filters and rank"][variant]
    images, parameters = np.zeros((*test.shape[:3], 2), np.float32), 0
    for maps in MAPS[variant]:
        keras.utils.set_random_seed(seed)
        stacks = [(filters * 2**i, sides) for i, sides in enumerate(KERNELS)]
        network = build("thesis", shape=inputs.shape[1:3], stacks=stacks, targets=len(maps), rank=rank)
        network.compile(keras.optimizers.Adam(options["rate"]), masked_squared_error, jit_compile=False)
        wanted = labels[..., maps].reshape(len(labels), -1)
        network.fit(inputs, wanted, batch_size=options["batch"], epochs=options["epochs"], verbose=0)
        images[..., maps] = np.reshape(network(test, training=False), (*test.shape[:3], len(maps)))
        parameters += network.count_params()
    return int(parameters), images


def errors_of(scenes, images, spec):
    """Return the relative errors of predicted maps: name in `MEASURES` -> list with an error for each scene.

    The errors of the maps count only nodes at which the solution's map is not 0. scenes: list of the states of each
    scene. images: predicted maps of all states, (n, n_y, n_x, 2), N·s. spec: definition of the images.
    """
    images, found = iter(images), []
    for states in scenes:
        ours, true = [next(images) for _ in states], [label_image(state, spec) for state in states]
        off = np.where(np.array(true) != 0, np.array(ours) - true, 0)
        maps = [float(np.linalg.norm(off[..., i]) / np.linalg.norm(np.array(true)[..., i])) for i in (0, 1)]
        each = iter(ours)
        read = lambda state, solver, each=each: projected(*read_back(next(each), state, spec), state.world.friction)  # noqa: E731
        quality = start_quality(states, read, sweeps=SWEEPS)
        found.append(dict(zip(MEASURES, [*maps, *(quality[f"velocity_error_{k}"] for k in SWEEPS)])))
    return {measure: [one[measure] for one in found] for measure in MEASURES}


MEASURES = ["error of the λ_n map", "error of the λ_t map", *(f"velocity error after {k} sweeps" for k in SWEEPS)]


def of(data, variant, measure):
    """Return an error of a variant for each initial weights and scene, (seeds, scenes). measure: one of `MEASURES`."""
    return np.array([errors[measure] for errors in data["variants"][variant]["errors"]])


def claims(data):
    for variant, thesis in ((ONE, "section 1.3.1"), (LARGE, "section 6.1")):
        for measure in MEASURES:
            text = f"{variant}: its {measure} equals that of {EACH}, within a tenth"
            yield equal(text, thesis, of(data, variant, measure), of(data, EACH, measure))


def equal(text, thesis, first, second):
    """Return the claim that the errors of two variants are equal, whichever two of their trainings are compared.

    It holds if the confidence intervals of the largest and of the smallest ratio of two trainings lie within `ALIKE`.
    The intervals are those over the held-out scenes. text, thesis: fields of the `Claim`. first, second: errors of the
    variants, (seeds, scenes).
    """
    (low, high), scenes = ALIKE, first.shape[1]
    means = lambda errors, drawn: errors[:, drawn].mean(axis=-1)  # noqa: E731
    largest = interval(lambda drawn: means(first, drawn).max(axis=0) / means(second, drawn).min(axis=0), scenes)
    smallest = interval(lambda drawn: means(first, drawn).min(axis=0) / means(second, drawn).max(axis=0), scenes)
    holds, fails = smallest[1] > low and largest[2] < high, smallest[1] > high or largest[2] < low
    measured = {"scenes": scenes, "trainings of each": len(first), "ratio": float(first.mean() / second.mean())}
    measured |= {"smallest and its interval": smallest.tolist(), "largest and its interval": largest.tolist()}
    if scenes < FEWEST:
        return Claim(text, thesis, None, measured, f"open: {scenes} scenes")
    if not (holds or fails):
        return Claim(text, thesis, None, measured, "within the noise")
    return Claim(text, thesis, bool(holds), measured)


def table(data):
    """Return the rows of the table: for each variant and error the mean, least and largest of its trainings."""
    rows = [["networks", "parameters", *MEASURES]]
    for variant, found in data["variants"].items():
        means = [of(data, variant, measure).mean(axis=1) for measure in MEASURES]
        spread = (f"{one.mean():.3f} ({one.min():.3f} to {one.max():.3f})" for one in means)
        rows.append([variant, f"{found['parameters']:,}", *spread])
    return rows


OPTIONS = starts.THESIS_SCENE | {
    "n_bodies": [70, 110], "steps": 600, "every": 6, "simulations": 16, "scenes": 10, "seeds": 3, "spacing": 1.0,
    "filters and rank": {ONE: [8, 42], LARGE: [11, 50], EACH: [8, 42]}, "rate": 1e-3, "batch": 50, "epochs": 5,
}  # fmt: skip
QUICK = {"simulations": 4, "scenes": 2, "steps": 200, "seeds": 1, "epochs": 1, "batch": 10}
QUICK |= {"filters and rank": {ONE: [2, 10], LARGE: [3, 12], EACH: [2, 10]}}
FIGURE = Figure("T 6.1", "One network for both maps, or one for each", compute, table, claims=claims,
                options=OPTIONS, quick=QUICK, seed=61)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
