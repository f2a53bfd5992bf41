"""Experiments with trained networks: what chapters 5 and 6 of the thesis say about them.

The layers of a network (Figure 5.8, Tables 5.1 and 5.2), the CNN start beside the others (Figure 5.9), time to a
threshold by stage (Figure 5.10), one network for both impulses or one for each (Table 6.1). Keras and TensorFlow are
imported by the functions that need them; networks run on one thread.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from scipy import stats

from deep_contact.cnn.dataset import Store, evenly, phase, simulation_path, write_simulation
from deep_contact.cnn.evaluation import velocity_errors
from deep_contact.cnn.images import ImageSpec, input_image, read_back
from deep_contact.cnn.inference import network_file, network_start, one_thread, projected
from deep_contact.cnn.model_file import read_metadata
from deep_contact.physics.engine import solve
from deep_contact.physics.metrics import velocity_error
from deep_contact.physics.solvers import PGS
from deep_contact.reporting.figures import Claim, parallel_map
from deep_contact.state import State
from deep_contact.studies import timing, verdicts
from deep_contact.studies.learned_starts import stages_of
from deep_contact.studies.starts import scene_of, solved_states, sweeps_to, swept_on
from deep_contact.warm_start import WarmStart

# ---- networks ----

NETWORKS = {"cnn": "models/model.h5", "cnn thesis": "models/thesis_factored.h5"}
"""Model files of Figures 5.9 and 5.10."""

LABELS = {"cnn": "CNN (ours)", "cnn thesis": "CNN (thesis network)"}
"""Names of the networks in claims."""

STARTS = {
    "none": "none",
    "builtin": "builtin",
    "sph": {"spacing": 0.5, "transfer": "thesis"},
    "sph consistent": {"spacing": 0.5, "transfer": "consistent"},
}
"""Descriptions of the starts of Figures 5.9 and 5.10; networks follow, and Copy comes last."""


def networks_info(networks: Mapping[str, str]) -> dict[str, dict]:
    """The cards of some model files, read without TensorFlow.

    Returns name -> {"file", "architecture", "parameters", "trainable_parameters", "seed", "training_states", "visits":
    states shown in training, each as often as it was}; None if a card leaves a field out. Raises FileNotFoundError for
    a missing file, before anything long begins.
    """
    names = ("architecture", "parameters", "trainable_parameters", "seed", "training_states")
    found = {}
    for name, path in networks.items():
        card = card_of(path)
        visits = len(card["history"]) * card["config"]["states_per_epoch"]
        found[name] = {"file": str(path)} | {key: card.get(key) for key in names} | {"visits": visits}
    return found


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


def layers_of(model) -> list[dict]:
    """The layers of a Keras model from its input to its output, input included.

    Each {"name", "kind": as in Table 5.1, "shape": of the output without the batch, "parameters", "trainable",
    "kernel": sides of a convolution's kernel or None}.
    """
    found = [{"name": "input", "kind": "Input", "shape": list(model.input_shape[1:]), "parameters": 0, "trainable": 0}]
    found[0]["kernel"] = None
    for layer in model.layers:
        kind = type(layer).__name__
        if kind == "InputLayer":
            continue
        filters = f"({layer.filters})" if kind == "Conv2D" else ""
        found.append(
            {
                "name": layer.name,
                "kind": LAYER_TITLES.get(kind, kind) + filters,
                "shape": list(layer.output.shape[1:]),
                "parameters": int(layer.count_params()),
                "trainable": int(sum(np.prod(v.shape) for v in layer.trainable_variables)),
                "kernel": list(layer.kernel_size) if filters else None,
            }
        )
    return found


def thesis_layers(channels: int = 5) -> list[dict]:
    """`layers_of` the thesis's network as built here; channels: of its input."""
    one_thread()
    from deep_contact.cnn import architectures

    return layers_of(architectures.thesis(channels=channels))


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
    schedule = schedules.schedule(config.schedule, epochs=config.epochs, rate=config.rate)
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

AFTER = (3, 10, 30, 100, 1000, 3000)
"""Numbers of sweeps after which the claims of Figure 5.9 compare the starts."""

CLOSE = (0.5, 2.0)
"""Range of θ over θ of two starts that count as similar."""

THESIS_VISITS = 18_208 * 1000
"""State visits of the thesis's training: its samples in each of its epochs."""


def claims_of_network(data: Mapping, name: str, label: str) -> list[Claim]:
    """The thesis's claims on Figure 5.9 for one network, and a comparison by velocity errors, paired.

    data: of `starts.compare_starts` with the starts "none", "builtin", "sph", "copy" and this one, with the cards
    of the networks (`networks_info`) under "networks".
    """
    share = {"state visits of its training, over the thesis's": data["networks"][name]["visits"] / THESIS_VISITS}

    def compared(first, second, text, within=verdicts.FASTER):
        claim = verdicts.judged(data, first, second, f"{label} {text}", "section 5.4", within=within)
        return claim._replace(measured=claim.measured | share)

    found = [
        compared(name, "sph", "performs similarly to SPH: θ from half to twice of it", CLOSE),
        compared("sph", name, "is not as good as SPH"),
        compared(name, "builtin", "converges faster than Builtin"),
        compared("copy", name, "does not converge as rapidly as Copy"),
    ]
    if "velocity" in data:
        errors = data["velocity"]
        pairs = list(zip(errors["mean"][name], errors["mean"]["builtin"]))
        measured = {f"after {sweeps}": list(pair) for sweeps, pair in zip(errors["sweeps"], pairs)}
        text = (
            f"{label} has a smaller mean velocity error than Builtin after every number of sweeps, from the same states"
        )
        found.append(Claim(text, None, all(ours < builtin for ours, builtin in pairs), measured))
    return found


def table_of_velocity(data: Mapping) -> list[list]:
    """Rows of the mean velocity errors, to follow those of `starts.table_of_starts` for the same sweeps."""
    errors = data["velocity"]
    return [[f"{name}, velocity error", errors["states"], None, None, *m] for name, m in errors["mean"].items()]


# ---- time to a threshold, by stage: Figure 5.10 ----

STAGES = ("splat", "network", "gather", "solve")
"""Stages of a step's contact solution: particles to image, image to image, image to contacts, sweeps."""

THETAS = {"θ < 6e-5": 6e-5, "θ < 1e-2": 1e-2}
"""Thresholds of θ, N·s: that of the thesis's authors' code, and a looser one."""

ERRORS = {"velocity error < 1e-1": 1e-1, "velocity error < 1e-2": 1e-2}
"""Thresholds of the relative velocity error. They need the solution, so they can measure a solver but not stop it."""


def sweeps_to_errors(state: State, start, errors: Sequence[float], *, most: int) -> list[int | None]:
    """Sweeps until the relative velocity error is within each of `errors`, to a tenth; None if `most` do not suffice.

    state: solved; its impulses are the reference solution. start: (λ_n, λ_t).
    """
    held = state.contacts.normal_impulse, state.contacts.tangent_impulse
    reference = solve(state, PGS(sweeps=0, tolerance=None), *held)
    counts = np.unique(np.concatenate([np.arange(20), np.geomspace(20, most, 120)]).round().astype(int)).tolist()
    impulses, found = start, {}
    for count, more in zip(counts, np.diff(counts, prepend=0).tolist()):
        solution = solve(state, PGS(sweeps=more, tolerance=None), *impulses)
        impulses = solution.normal_impulses, solution.tangent_impulses
        error = velocity_error(state, solution, reference)
        found |= {wanted: count for wanted in errors if error <= wanted and wanted not in found}
        if len(found) == len(errors):
            break
    return [found.get(wanted) for wanted in errors]


def sampled_states(scene: State, *, steps: int, count: int, sweeps: int) -> list[State]:
    """About `count` solved states with contacts, evenly from a run. Raises ValueError if no step has contacts."""
    states = solved_states(scene, steps=steps, solver=PGS(sweeps=sweeps))
    if not states:
        raise ValueError(f"steps: expected enough of them for contacts, got none after {steps}")
    return [states[i] for i in np.unique(np.linspace(0, len(states) - 1, count).round().astype(int))]


def time_to_thresholds(
    states: Sequence[State], starts: Mapping[str, WarmStart], *, most: int, repeats: int, progress: Callable
) -> dict:
    """Sweeps and seconds from each start to each threshold, on the same states.

    most: sweeps after which a start is given up. repeats: interleaved runs of every timing; their median counts.
    Returns {"criteria": names, "phases": one a state, "contacts": their mean, "starts": {name: {"stages":
    {stage: seconds, one a state}, "sweeps": {criterion: one a state, None where not reached}, "solve": {criterion:
    seconds of so many sweeps, one a state}}}}.
    """
    criteria = [*THETAS, *ERRORS]
    solver = PGS(sweeps=most, tolerance=min(THETAS.values()))
    found = {
        name: {"stages": {}, "sweeps": {c: [] for c in criteria}, "solve": {c: [] for c in criteria}} for name in starts
    }
    for state in progress(states, total=len(states), text="states"):
        goal, calls = swept_on(state), {}
        for name, start in starts.items():
            impulses = start(state, solver)
            theta = solve(state, solver, *impulses).record.theta
            counts = [sweeps_to(theta, t) if theta[-1] <= t else None for t in THETAS.values()]
            counts += sweeps_to_errors(goal, impulses, list(ERRORS.values()), most=most)
            calls |= {(name, "stages", stage): call for stage, call in stages_of(start, state).items()}
            for criterion, count in zip(criteria, counts):
                found[name]["sweeps"][criterion].append(count)
                counted = PGS(sweeps=most if count is None else count, tolerance=None)
                calls[name, "solve", criterion] = partial(solve, state, counted, *impulses)
        for (name, part, key), seconds in timing.interleaved(calls, repeats=repeats, reduce=np.median).items():
            found[name][part].setdefault(key, []).append(float(seconds))
    return {
        "criteria": criteria,
        "phases": [phase(state) for state in states],
        "contacts": float(np.mean([state.contacts.count for state in states])),
        "most": most,
        "starts": found,
    }


def seconds_of(data: Mapping, name: str, criterion: str) -> dict[str, np.ndarray]:
    """Seconds of each of `STAGES` of a start to a criterion, one a state; of a state given up, of all its sweeps."""
    found = data["starts"][name]
    stages = found["stages"] | {"solve": found["solve"][criterion]}
    return {stage: np.array(stages.get(stage, np.zeros(len(data["phases"])))) for stage in STAGES}


def times_of(data: Mapping, name: str, criterion: str) -> np.ndarray:
    """Seconds of a whole contact solution, one a state."""
    return sum(seconds_of(data, name, criterion).values())


def sweeps_of(data: Mapping, name: str, criterion: str) -> np.ndarray:
    """Sweeps to a criterion, one a state; a state given up counts with all its sweeps."""
    return np.array([data["most"] if n is None else n for n in data["starts"][name]["sweeps"][criterion]])


def time_by_tree(states: Sequence[State], *, repeats: int) -> float:
    """Median seconds of the splat of the bodies by k-d tree, as the thesis's Algorithm 2 has it, d = h = 0.5 m."""
    from deep_contact.sph.neighbours import splat_by_tree

    seconds, spec = [], ImageSpec()
    for state in states:
        grid, bodies = spec.grid(state.world), state.bodies
        values = np.column_stack([bodies.mass, bodies.velocity, bodies.spin])
        splat = partial(splat_by_tree, grid, bodies.position, values, h=spec.support, normalization="particle")
        seconds += [timing.timed(splat)[0] for _ in range(repeats)]
    return float(np.median(seconds))


# ---- one network for both impulses, or one each: Table 6.1 ----

NORMAL, TANGENT = "normal_impulse", "tangent_impulse"

VARIANTS = {
    "one for both": [(NORMAL, TANGENT)],
    "one for both, as large as two": [(NORMAL, TANGENT)],
    "one each": [(NORMAL,), (TANGENT,)],
}
"""Name of a variant of Table 6.1 -> targets of each of its networks."""


def train_on_targets(task: tuple) -> str:
    """Train a network on images, or continue its training; the path of its model file.

    task: (settings of `thesis_config`, data, folder of the run).
    """
    one_thread()
    from deep_contact.cnn import training

    settings, data, out = task
    return str(training.train(training.thesis_config(**settings), data, out, verbose=0).path)


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

    Returns means over the states: "normal" and "tangent", ‖λ'_n − λ_n‖ and ‖λ'_t − λ_t‖ relative to ‖λ‖ of the whole
    solution, before any sweep; "velocity", the relative velocity error after each number of `sweeps`, from both
    impulses projected on the cone. States with nothing to solve are omitted. Raises ValueError if no other is left.
    """
    models = [network_start(path).model for path in paths]
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
    return {"states": len(errors), "normal": normal, "tangent": tangent, "velocity": velocity}


def one_or_two_networks(
    data: Path, out: Path, options: Mapping, *, seeds: Sequence[int], jobs: int, progress: Callable
) -> dict:
    """Train and compare the `VARIANTS`, once for each seed.

    data: folder of simulations. out: of the networks. options: about "states" states of the last "held_out" simulations
    are for the errors after "sweeps", the other simulations for training; "stacks" of `architectures.thesis`, "deeper":
    of the network with more convolutions; "settings" of the training, in which every network sees the same states in
    the same order. Returns {"variants": {name: {"parameters", "errors": one a seed, see `errors_of_networks`}},
    "sweeps", "seeds", "held-out states"}.
    """
    store, held_out = Store(data), options["held_out"]
    shared = options["settings"] | {"fractions": (0.8, 0.2, 0.0), "simulations": len(store.simulations) - held_out}
    tasks = {}
    for seed in seeds:
        for variant, networks in VARIANTS.items():
            stacks = options["deeper" if variant.endswith("as large as two") else "stacks"]
            for number, targets in enumerate(networks):
                own = {"targets": targets, "seed": seed, "options": {"stacks": stacks}}
                name = f"{variant.replace(',', '').replace(' ', '_')}_{number}_{seed}"
                tasks[variant, seed, number] = (shared | own, str(data), str(out / name))
    trained = parallel_map(train_on_targets, tasks.values(), jobs=jobs, progress=progress, text="networks")
    paths = dict(zip(tasks, trained))
    tested = store.states(store.simulations[-held_out:])
    tested = [store.state(*state) for state in evenly(tested, options["states"]).tolist()]
    found = {}
    for variant, networks in VARIANTS.items():
        of_seeds = [[paths[variant, seed, number] for number in range(len(networks))] for seed in seeds]
        errors = [errors_of_networks(of_seed, tested, options["sweeps"]) for of_seed in of_seeds]
        parameters = sum(network_start(path).model.network.count_params() for path in of_seeds[-1])
        found[variant] = {"parameters": int(parameters), "errors": errors}
    return {"variants": found, "sweeps": options["sweeps"], "seeds": seeds, "held-out states": len(tested)}


MEASURES = ("normal", "tangent", "velocity")
"""Errors that Table 6.1 compares: of λ_n, of λ_t, and of the velocities before any sweep."""


def of_seeds(data: Mapping, variant: str, measure: str) -> np.ndarray:
    """One of the `MEASURES` of a variant, one a seed."""
    errors = [found[measure] for found in data["variants"][variant]["errors"]]
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
