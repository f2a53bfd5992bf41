"""Experiments with trained networks: what chapters 5 and 6 of the thesis say about them.

The layers of a network (Figure 5.8, Tables 5.1 and 5.2), the CNN start beside the others (Figure 5.9), time to a
threshold by stage (Figure 5.10), one network for both impulses or one for each (Table 6.1). Keras and TensorFlow are
imported by the functions that need them; networks run on one thread.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
from scipy import stats

from deep_contact.cnn.backend import one_thread
from deep_contact.cnn.dataset import Store, evenly, simulation_path
from deep_contact.cnn.evaluation import velocity_errors
from deep_contact.cnn.images import ImageSpec, input_image, read_back
from deep_contact.cnn.model_file import read_metadata
from deep_contact.cnn.registry import network_file
from deep_contact.io.simulation_h5 import write_simulation
from deep_contact.physics.contact_solver import projected
from deep_contact.physics.engine import solve
from deep_contact.physics.solvers import PGS
from deep_contact.reporting.figures import Claim, parallel_map
from deep_contact.state import State
from deep_contact.studies import timing, verdicts
from deep_contact.studies.learned_starts import stages_of
from deep_contact.studies.starts import READ, THRESHOLD, scene_of, solved_states, start_of, sweeps_to
from deep_contact.warm_start import Sph, WarmStart

# ---- networks ----

NETWORKS = {"cnn": "models/model.h5", "cnn thesis": "models/thesis_factored.h5"}
"""Model files of Figures 5.9 and 5.10."""


def networks_info(networks: Mapping[str, str]) -> dict[str, dict]:
    """What the cards of some model files say, read without TensorFlow.

    Returns name -> {"file", "architecture", "parameters": None if the card has none, "visits": states shown in
    training, each as often as it was}. Raises FileNotFoundError for a missing file, before anything long begins.
    """
    infos = {}
    for name, path in networks.items():
        card = card_of(path)
        about = {"file": str(path), "architecture": card["architecture"], "parameters": card.get("parameters")}
        infos[name] = about | {"visits": len(card["history"]) * card["config"]["states_per_epoch"]}
    return infos


def card_of(path) -> dict:
    """What a model file says of its training."""
    return read_metadata(network_file(path))["card"]


# ---- layers: Figure 5.8, Tables 5.1 and 5.2 ----

LAYER_TITLES = {"Conv2D": "Convolution", "MaxPooling2D": "MaxPooling"}
"""Class of a Keras layer -> its name in Table 5.1, if they differ."""

PRINTED = json.loads((Path(__file__).parent / "printed_tables.json").read_text(encoding="utf-8"))

PRINTED_LAYERS = PRINTED["layers"]
"""Table 5.1 as the thesis prints it, misprints included: (layer, output shape without the batch)."""

PRINTED_HYPERPARAMETERS = PRINTED["hyperparameters"]
"""Table 5.2 as the thesis prints it; its "1 × 5 × 10⁻³" is 0.005."""


def thesis_layers(channels: int = 5) -> list[dict]:
    """The layers of the thesis's network as built here, input included; channels: of its input.

    Each {"kind": as in Table 5.1, "shape": of the output without the batch, "parameters", "trainable", "kernel": sides
    of a convolution's kernel or None}.
    """
    one_thread()
    from deep_contact.cnn import architectures

    model = architectures.thesis(channels=channels)
    given = {"kind": "Input", "shape": list(model.input_shape[1:])}
    found = [given | {"parameters": 0, "trainable": 0, "kernel": None}]
    for layer in model.layers:
        kind, kernel = type(layer).__name__, getattr(layer, "kernel_size", None)
        kind = LAYER_TITLES.get(kind, kind) + (f"({layer.filters})" if kernel else "")
        trainable = int(sum(np.prod(v.shape) for v in layer.trainable_variables))
        about = {"kind": kind, "shape": list(layer.output.shape[1:]), "parameters": int(layer.count_params())}
        found.append(about | {"trainable": trainable, "kernel": list(kernel) if kernel else None})
    return found


def thesis_hyperparameters() -> dict[str, str]:
    """The lines of Table 5.2 as the built network and `training.thesis_config` have them."""
    one_thread()
    from deep_contact.cnn import architectures, schedules
    from deep_contact.cnn.training import thesis_config

    config = thesis_config()
    model = architectures.build(config.architecture, **config.options)
    layers = {}
    for layer in model.layers:
        layers.setdefault(type(layer).__name__, []).append(layer)
    convolutions = layers["Conv2D"]
    schedule = schedules.SCHEDULES[config.schedule](config.epochs, config.rate)
    spelling = {"relu": "ReLU", "HeNormal": "He normal"}

    def only(values) -> str:
        return " and ".join(spelling.get(value, str(value)) for value in dict.fromkeys(values))

    return {
        "Activation function": only(layer.activation.__name__ for layer in [*convolutions, *layers["Dense"]]),
        "Weight initialization": only(type(layer.kernel_initializer).__name__ for layer in convolutions),
        "Weight regularizer": only(type(layer.kernel_regularizer).__name__ for layer in convolutions),
        "Convolution border mode": only(layer.padding for layer in convolutions),
        "Stride": only(layer.strides[0] for layer in layers["MaxPooling2D"]),
        "Kernel size": only(tuple(layer.kernel_size) for layer in convolutions),
        "Dropout rate": only(layer.rate for layer in layers["Dropout"]),
        "Optimizer": config.optimizer.upper(),
        "Initial learning rate": f"{schedule(0):g}",
        "Batch size": str(config.batch_size),
        "Epochs": str(config.epochs),
        "Validation rate": f"{config.fractions[1]:g}",
    }


def hyperparameters_of(path: str) -> dict[str, str]:
    """The lines of Table 5.2 that a training decides, of the training that made a model file, by its card."""
    card = card_of(path)
    config, history = card["config"], card["history"]
    rates = dict.fromkeys(f"{epoch['rate']:g}" for epoch in history)
    return {
        "Optimizer": config["optimizer"].upper(),
        "Initial learning rate": f"{' then '.join(rates)} ({config['schedule']})",
        "Batch size": str(config["batch_size"]),
        "Epochs": f"{len(history)} of {config['states_per_epoch']:,} states",
        "Validation rate": f"{config['fractions'][1]:g} of the simulations",
        "States shown": f"{len(history) * config['states_per_epoch']:,}",
    }


# ---- the CNN start beside the others: Figure 5.9 ----

CLOSE = (0.5, 2.0)
"""Range of θ over θ of two starts that count as similar."""

PLACE = "section 5.4, Figure 5.9"

THESIS_VISITS = 18_208 * 8 // 10 * 1000
"""States that the thesis's training showed: its samples without the fifth that is held out, in each of its epochs."""

OPEN = "open: the rebuilt network starts little better than None"
"""Verdict on what the thesis says of its network."""


@dataclass(frozen=True)
class ReadBySharing:
    """A network's start, its image read back as the thesis's authors programmed it: each node shares out its value."""

    model: str

    def __call__(self, state: State, solver) -> tuple[np.ndarray, np.ndarray]:
        model = start_of({"model": self.model}).model
        way = Sph(spacing=model.spec.spacing, support=model.spec.support, transfer="shared")
        return projected(*way.gather(state, np.float64(model.predict_image(state))), state.world.friction)


READ_NETWORK = {"": "", ", shared": ", shared (authors' code),"}
"""What follows the name of a network's start, by how its image is read back -> the same in claims."""


def label_of(network: Mapping) -> str:
    """A network of `networks_info` in claims, by its file."""
    return f"CNN ({Path(network['file']).name})"


def of_network(network: Mapping, claim: Claim) -> Claim:
    """The claim; of the thesis's network it is left open, and `measured` has the verdict on the rebuilt one."""
    if network["architecture"] != "thesis":
        return claim
    return claim._replace(holds=None, verdict=OPEN, measured=claim.measured | {"verdict, rebuilt": claim.verdict})


def claims_of_network(data: Mapping, name: str) -> Iterator[Claim]:
    """The thesis's claims on Figure 5.9 for one network.

    data: of `starts.compare_starts` with the starts "none", "builtin", those of `READ`, "copy" and this one, with the
    cards of the networks (`networks_info`) under "networks".
    """
    network = data["networks"][name]

    def judged(*names, **keywords):
        return of_network(network, verdicts.judged(data, *names, PLACE, **keywords))

    for read, how in READ_NETWORK.items():
        if name + read in data["independent"]:
            start, label = name + read, label_of(network) + how
            for sph, way in READ.items():
                similar = f"{label} performs similarly to SPH, {way}: θ from half to twice of it"
                yield judged(start, sph, similar, within=CLOSE)
                yield judged(sph, start, f"{label} is not as good as SPH, {way}")
            yield judged(start, "builtin", f"{label} converges faster than Builtin")
            small = f"{label} is just a small improvement to Builtin: θ from half of Builtin's to Builtin's"
            yield judged(start, "builtin", small, within=(0.5, 1.0))
            yield judged("copy", start, f"{label} does not converge as rapidly as Copy")
            useful = f"{label} is a start: its θ is at most half of None's"
            yield verdicts.judged(data, start, "none", useful, within=verdicts.MUCH_FASTER)


# ---- time to a threshold, by stage: Figure 5.10 ----

STAGES = ("splat", "network", "gather", "solve")
"""Stages of a step's contact solution: particles to image, image to image, image to contacts, sweeps."""


CLOCK = {"reduce": np.median, "clock": process_time}
"""Processor time of this process, so that what else runs is not counted; its networks run on one thread."""


def time_to_threshold(
    states: Sequence[State], starts: Mapping[str, WarmStart], *, most: int, repeats: int, progress: Callable
) -> dict[str, dict]:
    """Sweeps and seconds of the processor from each start to θ < `THRESHOLD`, on the same states.

    most: sweeps after which a start is given up. repeats: interleaved runs of every timing; their median counts.
    Returns {name: {"sweeps": one a state, all of them where given up, "missed": states given up, "seconds": {stage: one
    a state}}}; a start has the stages that it needs.
    """
    solver = PGS(sweeps=most, tolerance=THRESHOLD)
    times = {name: {"sweeps": [], "missed": 0, "seconds": {}} for name in starts}
    for state in progress(states, total=len(states), text="states"):
        calls = {}
        for name, start in starts.items():
            impulses = start(state, solver)
            theta = solve(state, solver, *impulses).record.theta
            times[name]["sweeps"].append(sweeps_to(theta))
            times[name]["missed"] += int(theta[-1] > THRESHOLD)
            counted = partial(solve, state, PGS(sweeps=sweeps_to(theta), tolerance=None), *impulses)
            calls |= {(name, stage): call for stage, call in (stages_of(start, state) | {"solve": counted}).items()}
        for (name, stage), seconds in timing.interleaved(calls, repeats=repeats, **CLOCK).items():
            times[name]["seconds"].setdefault(stage, []).append(float(seconds))
    return times


def time_by_tree(state: State, *, repeats: int) -> float:
    """Median seconds of the splat of the bodies by k-d tree (the thesis's Algorithm 2, d = h = 0.5 m)."""
    from deep_contact.sph.thesis import splat_by_tree

    spec, bodies = ImageSpec(), state.bodies
    values = np.column_stack([bodies.mass, bodies.velocity, bodies.spin])
    splat = partial(
        splat_by_tree, spec.grid(state.world), bodies.position, values, h=spec.support, normalization="particle"
    )
    return timing.interleaved({"": splat}, repeats=repeats, **CLOCK)[""]


# ---- one network for both impulses, or one each: Table 6.1 ----

NORMAL, TANGENT = "normal_impulse", "tangent_impulse"

VARIANTS = {
    "one for both": [(NORMAL, TANGENT)],
    "one for both, as large as two": [(NORMAL, TANGENT)],
    "one each": [(NORMAL,), (TANGENT,)],
}
"""Name of a variant of Table 6.1 -> targets of each of its networks."""


def make_states(folder, *, simulations: int, steps: int, bodies: Sequence[int], seed: int, progress: Callable) -> Path:
    """A small data set of the thesis's scene, like that of `scripts/generate_data.py`. Existing files are kept."""
    folder = Path(folder)
    for number in progress(range(simulations), total=simulations, text="simulations"):
        path = simulation_path(folder, number)
        if not path.exists():
            child = np.random.SeedSequence((seed, number)).generate_state(1, np.uint64)[0]
            scene = scene_of(tuple(bodies), size=30.0, seed=int(child))
            states = solved_states(scene, steps=steps, solver=PGS(sweeps=5000))
            options = {"steps": steps, "bodies": list(bodies)}
            write_simulation(path, states, options=options, seed={"entropy": [seed, number]})
    return folder


def errors_of_networks(paths: Sequence[str], states: Sequence[State], sweeps: Sequence[int]) -> dict:
    """Held-out errors of one network for both impulses, or of two networks for one each.

    Returns their "parameters" in all, the number of "states", and means over them: "normal" and "tangent", ‖λ'_n − λ_n‖
    and ‖λ'_t − λ_t‖ relative to ‖λ‖ of the whole solution, before any sweep; "velocity", the relative velocity error
    after each number of `sweeps`, from both impulses projected on the cone. States with nothing to solve are omitted.
    Raises ValueError if no other is left.
    """
    models = [start_of({"model": path}).model for path in paths]
    errors = []
    for state in states:
        found = {}
        for model in models:  # not projected on the cone
            found |= zip(model.spec.targets, read_back(model.run(input_image(state, model.spec)), state, model.spec))
        right = np.array([state.contacts.normal_impulse, state.contacts.tangent_impulse])
        given = np.array([found[NORMAL], found[TANGENT]])
        with np.errstate(divide="ignore", invalid="ignore"):
            own = np.linalg.norm(given - right, axis=1) / np.linalg.norm(right)
        errors.append([*own, *velocity_errors(state, projected(*given, state.world.friction), sweeps)])
    errors = np.array(errors)
    errors = errors[np.isfinite(errors).all(axis=1)]
    if not len(errors):
        raise ValueError("states: expected some with impulses to be found, got none")
    normal, tangent, *velocity = errors.mean(axis=0).tolist()
    parameters = int(sum(model.network.count_params() for model in models))
    means = {"normal": normal, "tangent": tangent, "velocity": velocity}
    return {"parameters": parameters, "states": len(errors)} | means


def train_and_measure(task: tuple) -> dict:
    """Train the networks of a variant, or continue their training; their `errors_of_networks`.

    task: (variant, seed, folder of simulations, folder of the runs, options of `one_or_two_networks`).
    """
    one_thread()
    from deep_contact.cnn import training

    variant, seed, data, out, options = task
    store, held_out = Store(data), options["held_out"]
    shared = options["settings"] | {"fractions": (0.8, 0.2, 0.0), "simulations": len(store.simulations) - held_out}
    shared |= {"seed": seed, "options": {"stacks": options["deeper" if "as large" in variant else "stacks"]}}
    paths = []
    for number, targets in enumerate(VARIANTS[variant]):
        folder = out / f"{variant.replace(',', '').replace(' ', '_')}_{number}_{seed}"
        config = training.thesis_config(**shared, targets=targets)
        paths.append(training.train(config, data, folder, verbose=0).path)
    tested = evenly(store.states(store.simulations[-held_out:]), options["states"]).tolist()
    return errors_of_networks(paths, [store.state(*state) for state in tested], options["sweeps"])


def one_or_two_networks(
    data: Path, out: Path, options: Mapping, *, seeds: Sequence[int], jobs: int, progress: Callable
) -> dict:
    """Train and compare the `VARIANTS`, once for each seed.

    data: folder of simulations. out: of the networks. options: about "states" states of the last "held_out" simulations
    are for the errors after "sweeps", the other simulations for training; "stacks" of `architectures.thesis`, "deeper":
    of the network with more convolutions; "settings" of the training, in which every network sees the same states in
    the same order. Returns {"variants": {name: {"parameters", "errors": one a seed, see `errors_of_networks`}},
    "sweeps", "seeds"}.
    """
    tasks = [(variant, seed, data, out, dict(options)) for variant in VARIANTS for seed in seeds]
    found: dict = {variant: {"errors": []} for variant in VARIANTS}
    errors = parallel_map(train_and_measure, tasks, jobs=jobs, progress=progress, text="trainings")
    for (variant, *_), one in zip(tasks, errors):
        found[variant]["parameters"] = one.pop("parameters")
        found[variant]["errors"].append(one)
    return {"variants": found, "sweeps": options["sweeps"], "seeds": seeds}


MEASURES = ("normal", "tangent", "velocity")
"""Errors that Table 6.1 compares: of λ_n, of λ_t, and of the velocities before any sweep."""


def of_seeds(data: Mapping, variant: str, measure: str) -> np.ndarray:
    """One of the `MEASURES` of a variant, one a seed."""
    errors = [one[measure] for one in data["variants"][variant]["errors"]]
    return np.array([e[0] if measure == "velocity" else e for e in errors])


def within_spread(data: Mapping, first: str, second: str) -> tuple[bool, dict]:
    """Whether Welch's t test finds no difference between two variants in any measure (p ≥ 0.05), and the numbers.

    The numbers are both means and p, by measure. Three seeds reveal only differences of several standard deviations.
    """
    measured, equal = {}, True
    for measure in MEASURES:
        a, b = (of_seeds(data, variant, measure) for variant in (first, second))
        p = float(stats.ttest_ind(a, b, equal_var=False).pvalue)
        measured[f"{measure}: {first}, {second}, p"] = [float(a.mean()), float(b.mean()), p]
        equal &= not p < 0.05
    return equal, measured
