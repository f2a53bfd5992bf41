"""Experiments with trained networks: what chapters 5 and 6 of the thesis say of them, layer by layer and by the clock.

The layers of a network (Figure 5.8, Tables 5.1 and 5.2), the CNN start beside the others (Figure 5.9), time to a
threshold by stage (Figure 5.10), one network for both impulses or one each (Table 6.1). Keras and TensorFlow are
imported by the functions that need them; networks work on one thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact import sph
from deep_contact.cnn.dataset import PHASES, Store, phase, simulation_path, write_simulation
from deep_contact.cnn.evaluation import velocity_errors
from deep_contact.cnn.images import input_image, read_back
from deep_contact.cnn.inference import network_file, network_start, one_thread
from deep_contact.physics.engine import solve
from deep_contact.physics.methods import PGS
from deep_contact.physics.scenes import circles_in_box
from deep_contact.reporting.figures import Claim, parallel_map
from deep_contact.state import State
from deep_contact.studies.comparison import scene_of, solved_states, sweeps_to, swept_on, theta_after
from deep_contact.warm_start import Sph, WarmStart

# ---- networks ----


def networks_info(networks: Mapping[str, str]) -> dict[str, dict]:
    """What the cards of some model files say, name -> {"architecture", "parameters", "trainable_parameters", "seed",
    "training_states"}; None for what a card leaves out. Without TensorFlow.

    Raises FileNotFoundError where one is missing, before anything long begins.
    """
    from deep_contact.cnn.model_file import read_metadata

    names = ("architecture", "parameters", "trainable_parameters", "seed", "training_states")
    found = {}
    for name, path in networks.items():
        card = read_metadata(network_file(path))["card"]
        found[name] = {"file": str(path)} | {key: card.get(key) for key in names}
    return found


# ---- layers: Figure 5.8, Tables 5.1 and 5.2 ----

LAYER_TITLES = {
    "InputLayer": "Input",
    "Conv2D": "Convolution",
    "MaxPooling2D": "MaxPooling",
    "BatchNormalization": "BatchNormalization",
    "Dropout": "Dropout",
    "Flatten": "Flatten",
    "Dense": "Dense",
}
"""Class of a Keras layer -> its name in Table 5.1."""

_STACKS = ((61, 32, 2), (31, 64, 3), (16, 128, 3), (8, 256, 3), (4, 512, 3))


def _printed_layers() -> tuple[tuple[str, tuple[int, ...]], ...]:
    rows = [("Input", (61, 61, 4))]
    for number, (side, filters, convolutions) in enumerate(_STACKS):
        rows += [(f"Convolution({filters})", (side, side, filters))] * convolutions
        rows.append(("Dropout", (side, side, filters)))
        if number < len(_STACKS) - 1:
            pooled = _STACKS[number + 1][0]
            rows.append(("MaxPooling", (pooled, pooled, filters)))
        if filters == 64:
            rows.append(("BatchNormalization", (16, 16, 64)))
        if filters == 256:
            rows.append(("BatchNormalization", (4, 4, 512)))  # as printed; the pooling before it gives 256
    return (*rows, ("Flatten", (8192,)), ("Dense", (7442,)))


PRINTED_LAYERS = _printed_layers()
"""Table 5.1 as the thesis prints it (L1223-1252): (layer, output shape without the batch)."""

PRINTED_HYPERPARAMETERS = {
    "Activation function": "ReLU",
    "Weight initialization": "He normal",
    "Weight regularizer": "L2",
    "Convolution border mode": "same",
    "Stride": "2",
    "Kernel size": "(3, 3)",
    "Dropout rate": "0.1",
    "Optimizer": "SGD",
    "Initial learning rate": "0.005",
    "Batch size": "200",
    "Epochs": "1000",
    "Validation rate": "0.2",
}
"""Table 5.2 as the thesis prints it (L1260-1272); its "1 × 5 × 10⁻³" is 0.005."""


def layers_of(model) -> list[dict]:
    """The layers of a Keras model from its input to its output, input included.

    Each {"name", "kind": as in Table 5.1, "shape": of the output without the batch, "parameters", "trainable",
    "kernel": sides of a convolution's kernel or None}.
    """
    inputs = [int(n) for n in model.input_shape[1:]]
    found = [{"name": "input", "kind": "Input", "shape": inputs, "parameters": 0, "trainable": 0, "kernel": None}]
    for layer in model.layers:
        kind = type(layer).__name__
        if kind == "InputLayer":
            continue
        title = LAYER_TITLES.get(kind, kind)
        if kind == "Conv2D":
            title += f"({layer.filters})"
        found.append(
            {
                "name": layer.name,
                "kind": title,
                "shape": [int(n) for n in layer.output.shape[1:]],
                "parameters": int(layer.count_params()),
                "trainable": int(sum(np.prod(v.shape) for v in layer.trainable_variables)),
                "kernel": [int(n) for n in layer.kernel_size] if kind == "Conv2D" else None,
            }
        )
    return found


def thesis_layers(channels: int | None = None) -> list[dict]:
    """`layers_of` the thesis's network as it is built here; channels: of its input, by default the thesis's five."""
    one_thread()
    from deep_contact.cnn import architectures

    return layers_of(architectures.thesis(channels=channels or architectures.THESIS_CHANNELS))


def thesis_hyperparameters() -> dict[str, str]:
    """The lines of Table 5.2 as the built network and `training.thesis_config` have them."""
    one_thread()
    from deep_contact.cnn import architectures, schedules
    from deep_contact.cnn.training import thesis_config

    config = thesis_config()
    model = architectures.build(config.architecture, **config.options)
    layers = {kind: [layer for layer in model.layers if type(layer).__name__ == kind] for kind in LAYER_TITLES}
    convolutions, active = layers["Conv2D"], [*layers["Conv2D"], *layers["Dense"]]
    schedule = schedules.schedule(config.schedule, epochs=config.epochs, rate=config.rate)

    def only(values, form: str = "{}") -> str:
        return " and ".join(form.format(value) for value in dict.fromkeys(values))

    activations = {"relu": "ReLU"}
    initializers = {"HeNormal": "He normal"}
    return {
        "Activation function": only(activations.get(a.activation.__name__, a.activation.__name__) for a in active),
        "Weight initialization": only(
            initializers.get(type(c.kernel_initializer).__name__, type(c.kernel_initializer).__name__)
            for c in convolutions
        ),
        "Weight regularizer": only(type(c.kernel_regularizer).__name__ for c in convolutions),
        "Convolution border mode": only(c.padding for c in convolutions),
        "Stride": only(p.strides[0] for p in layers["MaxPooling2D"]),
        "Kernel size": only(tuple(c.kernel_size) for c in convolutions),
        "Dropout rate": only((d.rate for d in layers["Dropout"]), "{:g}"),
        "Optimizer": config.optimizer.upper(),
        "Initial learning rate": f"{schedule(0):g}",
        "Batch size": str(config.batch_size),
        "Epochs": str(config.epochs),
        "Validation rate": f"{config.fractions[1]:g}",
    }


# ---- the CNN start beside the others: Figure 5.9 ----

AFTER = (3, 10, 30, 100, 1000, 3000)
"""Sweeps after which Figure 5.9's claims compare the starts."""

CLOSE = 2.0
"""Two starts are close to each other where their mean θ differ by no more than this factor."""


def theta_ratios(data: Mapping, first: str, second: str, mode: str) -> dict[str, float]:
    """Mean θ of one start over that of another after each of `AFTER` sweeps, and none where both are zero."""
    ratios = {}
    for sweeps in AFTER:
        if sweeps <= data["sweep"][-1]:
            above, below = (theta_after(data, mode, name, sweeps) for name in (first, second))
            if below > 0:
                ratios[f"θ({sweeps}), {first} / {second}"] = above / below
    return ratios


def claims_of_network(data: Mapping, name: str, label: str, *, mode: str = "independent") -> list[Claim]:
    """What the thesis says of Figure 5.9, of one of the networks; and the same by the velocity error, paired.

    data: of `experiments.compare_starts` with the starts "none", "builtin", "sph", "copy" and this one. A comparison
    holds if it does after every number of `AFTER` sweeps; what is measured says after which it does not.
    """

    def compared(other, within: Callable[[float], bool], text, thesis):
        ratios = theta_ratios(data, name, other, mode)
        return Claim(text, thesis, bool(all(map(within, ratios.values()))), ratios)

    found = [
        compared("sph", lambda r: 1 / CLOSE <= r <= CLOSE, f"{label} performs similarly to SPH", "L1337"),
        compared("sph", lambda r: r >= 1, f"{label} is not as good as SPH", "L1339"),
        compared("builtin", lambda r: r < 1, f"{label} converges faster than Builtin", "L1339-1341"),
        compared("copy", lambda r: r > 1, f"{label} does not converge as rapidly as Copy", "L1341"),
    ]
    if "velocity" in data:
        found.append(_fewer_errors(data, name, "builtin", f"{label} has a smaller mean velocity error than Builtin"))
    return found


def _fewer_errors(data, name, other, text) -> Claim:
    errors = data["velocity"]
    measured, holds = {}, []
    for i, sweeps in enumerate(errors["sweeps"]):
        pair = [errors["mean"][start][i] for start in (name, other)]
        measured[f"after {sweeps}"] = pair
        holds.append(pair[0] < pair[1])
    return Claim(f"{text} after every number of sweeps, from the same states", None, all(holds), measured)


def table_of_velocity(data: Mapping) -> list[list]:
    """Rows of the mean velocity errors below those of `experiments.table_of_starts` for the same sweeps."""
    errors = data["velocity"]
    return [[f"{name}, velocity error", errors["states"], None, None, *m] for name, m in errors["mean"].items()]


# ---- time to a threshold, by stage: Figure 5.10 ----

STAGES = ("splat", "network", "gather", "solve")
"""Stages of a step's contact solution: particles to image, image to image, image to contacts, sweeps."""

THETAS = {"θ < 6e-5": 6e-5, "θ < 1e-2": 1e-2}
"""Thresholds of θ, N·s: the thesis's, and one for those who need not wait."""

ERRORS = {"velocity error < 1e-1": 1e-1, "velocity error < 1e-2": 1e-2}
"""Thresholds of the relative velocity error. Only who knows the solution can stop by them: they measure the road."""


class Staged(NamedTuple):
    """Impulses (λ_n, λ_t) of a start, and the seconds of its stages that are its own (none for None, Builtin, Copy)."""

    impulses: tuple[np.ndarray, np.ndarray]
    seconds: dict[str, float]


def staged(start: WarmStart, state: State, solver) -> Staged:
    """start(state, solver), by the clock: to the last bit the same impulses.

    What SPH is given, the solution itself, costs nothing here.
    """
    clock = time.perf_counter
    if isinstance(start, Sph):
        return _staged_sph(start, state)
    if hasattr(start, "model"):
        from deep_contact.cnn.inference import projected

        model = start.model
        model.check_scene(state)
        begin = clock()
        image = input_image(state, model.spec)
        splatted = clock()
        out = model.run(image)
        mapped = clock()
        impulses = projected(*read_back(out, state, model.spec), state.world.friction)
        seconds = {"splat": splatted - begin, "network": mapped - splatted, "gather": clock() - mapped}
        return Staged(impulses, seconds)
    return Staged(start(state, solver), {})


def _staged_sph(start: Sph, state: State) -> Staged:
    contacts, clock = state.contacts, time.perf_counter
    solution = np.column_stack([contacts.normal_impulse, contacts.tangent_impulse])
    grid = sph.Grid.over_box(state.world.box, start.spacing)
    h = start.spacing if start.support is None else start.support
    thesis = start.transfer == "thesis"
    reach = {"h": h, "kernel": start.kernel, "outside": "clamp", "unreached": "zero" if thesis else "nearest"}
    begin = clock()
    image = sph.splat(grid, contacts.position, solution, normalization="particle", **reach)
    splatted = clock()
    options = {"outside": "clamp", "unreached": "zero"}
    if thesis:
        back = sph.gather(grid, image, contacts.position, h=h, kernel=start.kernel, **options)
    else:
        density = sph.density(grid, contacts.position, **reach)
        back = sph.gather(grid, image, contacts.position, normalization="consistent", density=density, **options)
    impulses = back[:, 0].copy(), back[:, 1].copy()
    return Staged(impulses, {"splat": splatted - begin, "gather": clock() - splatted})


def sweeps_to_errors(state: State, start, errors: Sequence[float], *, most: int) -> list[int | None]:
    """Sweeps until the relative velocity error is within each of `errors`, to a tenth; None if `most` do not do.

    state: solved; its impulses are what the error is measured against. start: (λ_n, λ_t).
    """
    counts = np.unique(np.concatenate([np.arange(20), np.geomspace(20, most, 120)]).round().astype(int)).tolist()
    found: list[int | None] = [None] * len(errors)
    impulses, done = start, 0
    for count in counts:
        if count > done:
            # On from where the last ones ended: the same sweeps, each of them done once.
            solution = solve(state, PGS(sweeps=count - done, tolerance=None), *impulses)
            impulses, done = (solution.normal_impulses, solution.tangent_impulses), count
        error = velocity_errors(state, impulses, [0])[0]
        found = [count if best is None and error <= wanted else best for best, wanted in zip(found, errors)]
        if None not in found:
            break
    return found


def sampled_states(scene: State, *, steps: int, count: int, sweeps: int) -> list[State]:
    """About `count` solved states of a run with contacts, evenly taken. Raises ValueError where there are none."""
    states = solved_states(scene, steps=steps, solver=PGS(sweeps=sweeps))
    if not states:
        raise ValueError(f"steps: expected enough of them for contacts, got none after {steps}")
    return [states[i] for i in np.unique(np.linspace(0, len(states) - 1, count).round().astype(int))]


def time_to_thresholds(
    states: Sequence[State], starts: Mapping[str, WarmStart], *, most: int, repeats: int, progress: Callable
) -> dict:
    """Sweeps and seconds from each start to each threshold, on the same states.

    most: sweeps after which a start is given up. repeats: of every timing, start after start, of which the median
    counts. Returns {"criteria": names, "phases": one a state, "contacts": their mean, "starts": {name: {"stages":
    {stage: seconds, one a state}, "sweeps": {criterion: one a state, None where not reached}, "solve": {criterion:
    seconds of so many sweeps, one a state}}}}.
    """
    criteria = [*THETAS, *ERRORS]
    solver = PGS(sweeps=most, tolerance=min(THETAS.values()))
    found = {
        name: {"stages": {}, "sweeps": {c: [] for c in criteria}, "solve": {c: [] for c in criteria}} for name in starts
    }
    for state in progress(states, total=len(states), text="states"):
        goal = swept_on(state)
        needed = {}
        for name, start in starts.items():
            impulses = staged(start, state, solver).impulses  # and everything is compiled before it is timed
            theta = solve(state, solver, *impulses).record.theta
            counts = [sweeps_to(theta, t) if theta[-1] <= t else None for t in THETAS.values()]
            counts += sweeps_to_errors(goal, impulses, list(ERRORS.values()), most=most)
            needed[name] = dict(zip(criteria, counts))
        clocked = []
        for _ in range(repeats):
            clocked.append({name: _timed(start, state, needed[name], most) for name, start in starts.items()})
        for name in starts:
            stages, solves = ([part[name][i] for part in clocked] for i in range(2))
            for stage in stages[0]:
                found[name]["stages"].setdefault(stage, []).append(float(np.median([s[stage] for s in stages])))
            for criterion in criteria:
                found[name]["sweeps"][criterion].append(needed[name][criterion])
                found[name]["solve"][criterion].append(float(np.median([s[criterion] for s in solves])))
    return {
        "criteria": criteria,
        "phases": [phase(state) for state in states],
        "contacts": float(np.mean([state.contacts.count for state in states])),
        "most": most,
        "starts": found,
    }


def _timed(start, state, needed, most) -> tuple[dict[str, float], dict[str, float]]:
    """Seconds of a start's stages, and of the sweeps to each criterion."""
    impulses, seconds = staged(start, state, PGS())
    solves = {}
    for criterion, sweeps in needed.items():
        solver = PGS(sweeps=most if sweeps is None else sweeps, tolerance=None)
        begin = time.perf_counter()
        solve(state, solver, *impulses)
        solves[criterion] = time.perf_counter() - begin
    return seconds, solves


def mean_stages(data: Mapping, name: str, criterion: str, phases: Sequence[str] = PHASES) -> dict[str, float]:
    """Mean seconds of each stage of a start over the states of some phases, those given up with all their sweeps."""
    found = data["starts"][name]
    chosen = np.isin(data["phases"], list(phases))
    stages = found["stages"] | {"solve": found["solve"][criterion]}
    return {stage: float(np.mean(stages[stage], where=chosen)) if stage in stages else 0.0 for stage in STAGES}


def total_time(data: Mapping, name: str, criterion: str, phases: Sequence[str] = PHASES) -> float:
    """Mean seconds of a whole contact solution, see `mean_stages`."""
    return sum(mean_stages(data, name, criterion, phases).values())


def mean_sweeps_to(data: Mapping, name: str, criterion: str, phases: Sequence[str] = PHASES) -> float:
    """Mean sweeps to a criterion over the states of some phases; a state given up counts with all of them."""
    counts = data["starts"][name]["sweeps"][criterion]
    chosen = np.isin(data["phases"], list(phases))
    return float(np.mean([data["most"] if n is None else n for n in counts], where=chosen))


def time_by_tree(states: Sequence[State], spec, *, repeats: int) -> float:
    """Median seconds of the splat of the bodies by k-d tree, as the thesis's Algorithm 2 has it."""
    from deep_contact.sph.neighbours import splat_by_tree

    seconds = []
    for state in states:
        grid, bodies = spec.grid(state.world), state.bodies
        values = np.column_stack([bodies.mass, bodies.velocity, bodies.spin])
        for _ in range(repeats):
            begin = time.perf_counter()
            splat_by_tree(grid, bodies.position, values, h=spec.support, normalization="particle")
            seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))


# ---- one network for both impulses, or one each: Table 6.1 ----

TARGET_SETS = {
    "both": ("normal_impulse", "tangent_impulse"),
    "normal": ("normal_impulse",),
    "tangent": ("tangent_impulse",),
}
"""What a network of Table 6.1 may have to learn."""


@dataclass(frozen=True, kw_only=True)
class TargetTask:
    """One training of Table 6.1, small enough to be sent to another process.

    targets: one of `TARGET_SETS`. options: of `architectures.compact`. simulations: to train on and to choose by, the
    first ones of `data`. settings: changes to `TrainingConfig`. out: folder of the run, which is gone on with.
    """

    targets: str
    options: dict
    seed: int
    data: str
    simulations: int
    settings: dict
    out: str


def train_on_targets(task: TargetTask) -> str:
    """Train a network for one impulse or both; the path of its model file. What is trained already is kept."""
    one_thread()
    from deep_contact.cnn import training

    @dataclass(frozen=True, kw_only=True)
    class Config(training.TrainingConfig):
        targets: tuple[str, ...] = TARGET_SETS["both"]

        def spec(self):
            return super().spec().replace(targets=self.targets, target_scales=None)

    config = Config(
        targets=TARGET_SETS[task.targets],
        options=task.options,
        seed=task.seed,
        simulations=task.simulations,
        # The masked loss on images: the only one that asks for no second impulse. No test side, which is elsewhere.
        loss="appendix b",
        fractions=(0.8, 0.2, 0.0),
        **task.settings,
    )
    done = training.train(config, task.data, task.out, verbose=0)
    return str(done.path)


def make_states(folder, *, simulations: int, steps: int, bodies: Sequence[int], seed: int, progress: Callable) -> Path:
    """A small data set of the thesis's scene, as `scripts/generate_data.py` makes a large one. What is there stays."""
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


def predict_targets(path, state: State) -> dict[str, np.ndarray]:
    """Impulses at a state's contacts by a network of one or both targets, target -> (m,), N·s, not projected."""
    model = network_start(path).model
    found = read_back(model.run(input_image(state, model.spec)), state, model.spec)
    return dict(zip(model.spec.targets, found))


def errors_of_networks(paths: Sequence[str], states: Sequence[State], sweeps: Sequence[int]) -> dict:
    """Held-out errors of one network for both impulses, or of two for one each.

    Returns means over the states: "normal" and "tangent", ‖λ'_n − λ_n‖ and ‖λ'_t − λ_t‖ over the size ‖λ‖ of the whole
    solution, before any sweep; "velocity", the relative velocity error after each of `sweeps`, from both together,
    projected. States with nothing to solve are left out. Raises ValueError where no other is left.
    """
    from deep_contact.cnn.inference import projected

    errors = []
    for state in states:
        found = {}
        for path in paths:
            found |= predict_targets(path, state)
        right = {"normal_impulse": state.contacts.normal_impulse, "tangent_impulse": state.contacts.tangent_impulse}
        size = np.linalg.norm(list(right.values()))
        start = projected(found["normal_impulse"], found["tangent_impulse"], state.world.friction)
        with np.errstate(divide="ignore", invalid="ignore"):
            own = [np.linalg.norm(found[name] - right[name]) / size for name in right]
        errors.append([*own, *velocity_errors(state, start, sweeps)])
    errors = np.array(errors)
    errors = errors[np.isfinite(errors).all(axis=1)]
    if not len(errors):
        raise ValueError("states: expected some with impulses to be found, got none")
    normal, tangent, *velocity = errors.mean(axis=0).tolist()
    return {"states": len(errors), "normal": normal, "tangent": tangent, "velocity": velocity}


VARIANTS = {
    "one for both": ("both",),
    "one for both, as large as two": ("both",),
    "one each": ("normal", "tangent"),
}
"""Name of a variant of Table 6.1 -> what its networks learn."""


def one_or_two_networks(
    *,
    data: str,
    out: str,
    simulations: int,
    held_out: int,
    states: int,
    sweeps: Sequence[int],
    options: dict,
    larger: dict,
    settings: dict,
    seeds: Sequence[int],
    jobs: int,
    progress: Callable,
) -> dict:
    """Train and compare the `VARIANTS`, once for each seed.

    data: folder of simulations; the first `simulations` are trained on, the next `held_out` report, with about
    `states` of their states. options: of the compact network, for one for both and one each; larger: of the one that
    is as large as two. settings: of the training, the same for all; every network sees the same states in the same
    order. Returns {variant: {"parameters", "errors": one a seed, see `errors_of_networks`}}, and the numbers of states.
    Raises ValueError where there are too few simulations.
    """
    store = Store(data)
    if len(store.simulations) < simulations + held_out:
        raise ValueError(f"simulations: expected {simulations + held_out} in {data}, got {len(store.simulations)}")
    tasks, of_variant = [], []
    for seed in seeds:
        for variant, targets in VARIANTS.items():
            for target in targets:
                name = f"{variant.replace(',', '').replace(' ', '_')}_{target}_{seed}"
                chosen = larger if variant.endswith("as large as two") else options
                tasks.append(
                    TargetTask(targets=target, options=chosen, seed=seed, data=data, simulations=simulations,
                               settings=settings, out=str(Path(out) / name))
                )  # fmt: skip
                of_variant.append((variant, seed))
    paths = parallel_map(train_on_targets, tasks, jobs=jobs, progress=progress, text="networks")
    tested = store.states(store.simulations[simulations : simulations + held_out])
    tested = [store.state(*state) for state in tested[:: max(1, len(tested) // states)].tolist()]
    found = {}
    for variant in VARIANTS:
        errors, parameters = [], 0
        for seed in seeds:
            of_seed = [path for path, key in zip(paths, of_variant) if key == (variant, seed)]
            errors.append(errors_of_networks(of_seed, tested, sweeps))
            parameters = sum(network_start(path).model.keras.count_params() for path in of_seed)
        found[variant] = {"parameters": int(parameters), "errors": errors}
    return {"variants": found, "sweeps": list(sweeps), "seeds": list(seeds), "held-out states": len(tested)}


MEASURES = ("normal", "tangent", "velocity")
"""Errors by which Table 6.1 compares: of λ_n, of λ_t, and of the velocities before any sweep."""


def of_seeds(data: Mapping, variant: str, measure: str) -> np.ndarray:
    """One of the `MEASURES` of a variant, one a seed."""
    errors = [found[measure] for found in data["variants"][variant]["errors"]]
    return np.array([e[0] if measure == "velocity" else e for e in errors])


def within_spread(data: Mapping, first: str, second: str) -> tuple[bool, dict]:
    """Whether two variants are equal by every measure, as far as the seeds tell: Welch's t within ± its 97.5 % point.

    And what was measured: the means of both and t. With three seeds each only differences of several standard
    deviations are seen.
    """
    from scipy import stats

    measured, equal = {}, []
    for measure in MEASURES:
        a, b = (of_seeds(data, variant, measure) for variant in (first, second))
        test = stats.ttest_ind(a, b, equal_var=False)
        measured[f"{measure}: {first}, {second}, p"] = [float(a.mean()), float(b.mean()), float(test.pvalue)]
        equal.append(not test.pvalue < 0.05)
    return all(equal), measured


# ---- starts on held-out scenes ----

OFF = 0.05
"""Error of Builtin's own start above which a state counts as one where there is something to win."""


def errors_on_thesis_scene(starts: Mapping[str, object], task: Mapping) -> dict:
    """`errors_on_scene` of one scene of as many circles as the training data have, 70 to 110.

    task: "seed" of the scene; "steps", "every", and the numbers of sweeps "after" which errors are taken.
    """
    from deep_contact.studies.scene_errors import errors_on_scene

    rng = np.random.default_rng(task["seed"])
    scene = circles_in_box(int(rng.integers(70, 111)), seed=rng)
    return errors_on_scene(scene, starts, steps=task["steps"], every=task["every"], sweeps=task["after"])


def mean_errors(scenes: Sequence[Mapping], name: str, where: str) -> np.ndarray:
    """Mean velocity error of a start by scene and number of sweeps, of scenes as `errors_on_scene` has them.

    where: "all" states, or those where Builtin is "off" by more than `OFF`; scenes without any are left out.
    """
    means = []
    for scene in scenes:
        found, builtin = (np.array(scene["errors"][n]) for n in (name, "builtin"))
        chosen = builtin[:, 0] > OFF if where == "off" else np.ones(len(found), bool)
        if chosen.any():
            means.append(found[chosen].mean(axis=0))
    return np.array(means)


def ratios_to_builtin(scenes: Sequence[Mapping], name: str, where: str) -> np.ndarray:
    """Error over Builtin's, of the means over scenes, and its 95 % interval by resampling scenes: (sweeps, 3)."""
    found, builtin = mean_errors(scenes, name, where), mean_errors(scenes, "builtin", where)
    chosen = np.random.default_rng(0).integers(0, len(found), (2000, len(found)))
    sampled = found[chosen].mean(axis=1) / builtin[chosen].mean(axis=1)
    return np.column_stack([found.mean(axis=0) / builtin.mean(axis=0), *np.quantile(sampled, [0.025, 0.975], axis=0)])
