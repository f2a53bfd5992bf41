"""python scripts/table_6_3_runtimes.py: what runs the far-field network fastest, and what the rest of a start takes."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np

import deep_contact as dc
from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.break_even import sweep_times
from deep_contact.studies.scaling import fastest
from deep_contact.studies.tradeoff import pile, states_of

RUNTIMES = ("Numba", "XLA", "TensorFlow")
"""`cnn.convolution`; one program of TensorFlow's compiler; a call for each layer."""

LIMIT = 500.0
"""μs that a start may take for 100 circles on one core."""


def compute(options, seed, jobs, progress):
    """Time by time, each number of threads in a process of its own: TensorFlow takes the number only once."""
    tasks = [(threads, circles) for threads in options["threads"] for circles in options["circles"]]
    times, stages = [], []
    for threads, circles in progress(tasks, text="windows"):
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context) as alone:
            found = alone.submit(one_window, {**options, "threads": threads, "count": circles, "seed": seed}).result()
        times += found["times"]
        stages += found["stages"]
    return {"times": times, "stages": stages}


def one_window(task):
    """Times of all networks, runtimes and batches on the window of a settling pile."""
    from deep_contact.cnn.far_field import describe
    from deep_contact.cnn.inference import limit_threads, load_model, network_file

    limit_threads(task["threads"])
    state = states_of(pile("settling", task["count"], task["seed"]), count=1)[0]
    times, stages = [], []
    for path in task["models"]:
        model = load_model(network_file(path))
        image = describe(state, model.spec).image
        common = {"network": path.split("/")[-1], "circles": task["count"], "threads": task["threads"]}
        if task["threads"] == 1:
            stages.append(common | one_start(model, state, task["repeats"]))
        for batch in task["batches"]:
            images = np.repeat(image[None], batch, axis=0)
            for runtime, run in runtimes(model.network, images.shape, task["threads"]).items():
                us = fastest(lambda: run(images), task["repeats"]) / batch  # noqa: B023
                times.append(common | {"runtime": runtime, "batch": batch, "us": us})
    return {"times": times, "stages": stages}


def runtimes(network, shape, threads):
    """Runtime -> function of a batch of images of this shape."""
    import tensorflow as tf

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


def one_start(model, state, repeats):
    """μs of the parts of a start: the image, the network, the impulses at the contacts, all of it, and a sweep."""
    from deep_contact.cnn.far_field import correct, describe
    from deep_contact.cnn.inference import Cnn, projected

    start, description = Cnn(model), describe(state, model.spec)
    coefficients = model.run(description.image)

    def read():
        impulses = correct(coefficients, description, model.spec)
        return projected(impulses[:, 0], impulses[:, 1], state.world.friction)

    return {
        "image": fastest(lambda: describe(state, model.spec), repeats),
        "run": fastest(lambda: model.run(description.image), repeats),
        "read": fastest(read, repeats),
        "all": fastest(lambda: start(state, dc.PGS()), repeats),
        "sweep": 1e6 * sweep_times(state, repeats=repeats)["PGS"],
    }


def claims(data):
    """Whether the convolution in Numba is worth its lines, and a start its time."""
    times = {(t["network"], t["circles"], t["threads"], t["batch"], t["runtime"]): t["us"] for t in data["times"]}
    cases = list(dict.fromkeys(key[:-1] for key in times))
    gain = {key: min(times[*key, name] for name in RUNTIMES[1:]) / times[*key, RUNTIMES[0]] for key in cases}
    least = min(gain, key=gain.get)
    on_one = {key: value for key, value in gain.items() if key[2] == 1 and key[3] == 1}

    def of(key):
        return f"{key[0]}, {key[1]} circles, {key[2]} threads, batch of {key[3]}"

    smallest = min(stage["circles"] for stage in data["stages"])
    starts = {stage["network"]: stage["all"] for stage in data["stages"] if stage["circles"] == smallest}
    return [
        Claim(
            "for one scene on one thread the convolution in Numba is faster than TensorFlow's best",
            None,
            all(value > 1 for value in on_one.values()),
            {f"{key[0]}, {key[1]} circles": value for key, value in on_one.items()},
        ),
        Claim(
            "batches and a second thread do not change that",
            None,
            all(value > 1 for value in gain.values()),
            {"least": of(least), "gain": gain[least]},
        ),
        Claim(
            f"image, network and reading back take at most {LIMIT / 1000:g} ms for {smallest} circles on one core",
            None,
            all(us <= LIMIT for us in starts.values()),
            {f"{network}, μs": us for network, us in starts.items()},
        ),
    ]


def table(data):
    """Rows: μs of a scene by network, circles and threads for each runtime and batch; of a start, its parts."""
    batches = sorted({t["batch"] for t in data["times"]})
    many = [f"{name}, {b} at once" if b > 1 else name for name in RUNTIMES for b in batches]
    rows = [["network", "circles", "threads", *many, "image", "reading back", "start", "start in sweeps"]]
    found: dict = {}
    for t in data["times"]:
        found.setdefault((t["network"], t["circles"], t["threads"]), {})[t["runtime"], t["batch"]] = t["us"]
    stages = {(stage["network"], stage["circles"], stage["threads"]): stage for stage in data["stages"]}
    for key, us in found.items():
        parts = [None] * 4
        if key in stages:
            stage = stages[key]
            parts = [stage["image"], stage["read"], stage["all"], stage["all"] / stage["sweep"]]
        rows.append([*key, *(us[name, b] for name in RUNTIMES for b in batches), *parts])
    return rows


FIGURE = Figure(
    id="T 6.3",
    title="Runtimes of the far-field network, μs a scene",
    options={
        "models": ["models/coarse.h5", "models/model.h5"],
        "circles": [100, 1000, 10000],
        "threads": [1, 2],
        "batches": [1, 8],
        "repeats": 40,
    },
    quick={"models": ["models/coarse.h5"], "circles": [100], "threads": [1], "batches": [1]},
    compute=compute,
    claims=claims,
    table=table,
    digits=4,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
