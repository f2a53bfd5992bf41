"""Train the perceptron on each contact through the solver, in rounds of states of its own runs: `per_contact`.

A start that is trained on states of solved runs, or of Builtin's, meets others once it drives a run: it changes what is
carried. So after a first round on Builtin's runs, each round adds states of runs that the last version started, at the
budgets of sweeps that users take (dataset aggregation: Ross, Gordon and Bagnell, AISTATS 2011).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deep_contact.cnn.per_contact import PerContact, describe
from deep_contact.cnn.perceptron import CORRECTIONS, HIDDEN, INPUTS, Perceptron
from deep_contact.cnn.through_solver import SolvedProblem, errors_after, loss_and_gradient, over_relaxed
from deep_contact.physics.engine import solve, step_problem
from deep_contact.physics.scenes import lattice_in_box
from deep_contact.physics.solvers import NNCG, PSOR

OMEGA, FRICTION_OMEGA = 1.75, 1.45
"""Of the solver that it is trained through: the best pair from 20 to 50 sweeps."""

BUDGETS = (4, 8, 15, 25, 40, 60, 100)
"""Sweeps a step of the runs, and of the loss."""

FIRST_SEED, VALIDATION_SEED = 100_000, 200_000
"""Seeds of the scenes count from here, by round and seed of the training."""

_FLOOR = 0.03
"""Added to Builtin's error, by which a state's loss is divided: nearly solved states count little."""


@dataclass(frozen=True, kw_only=True)
class PerContactConfig:
    """How to train. scenes: per round, `states` of each. sweeps: NNCG's, for the reference solutions. least: share
    unsolved below which the start is left out. rate: of Adam, falling to zero over each round by a cosine."""

    rounds: int = 4
    scenes: int = 70
    states: int = 5
    largest: int = 2000
    sweeps: int = 600
    epochs: int = 6
    batch: int = 8
    rate: float = 5e-3
    least: float = 0.02
    seed: int = 0


class Sample(NamedTuple):
    """A state for training: its problem with the masses of the solver, its description, budget and Builtin's error."""

    problem: SolvedProblem
    inputs: np.ndarray
    corrections: np.ndarray
    budget: int
    builtin_error: float


def scene_of(seed: int, largest: int):
    """A random falling scene: 50 to `largest` circles, radii 0.5 to 2 m, μ to 1, Δt 0.002 to 0.03 s; and its budget."""
    rng = np.random.default_rng(seed)
    n = round(float(np.exp(rng.uniform(np.log(50), np.log(largest)))))
    radius = ((1.0, 1.0), (0.7, 1.3), (0.5, 2.0))[rng.integers(3)]
    friction = 0.5 if rng.uniform() < 0.4 else float(rng.uniform(0.02, 1.0))
    scene = lattice_in_box(n, radius=radius, gap=float(rng.uniform(0.03, 0.3)), friction=friction, seed=rng)
    dt = 0.01 if rng.uniform() < 0.5 else float(np.exp(rng.uniform(np.log(0.002), np.log(0.03))))
    return scene, dt, float(rng.uniform(0.3, 3.0)), int(rng.choice(BUDGETS))


def samples_of(simulate: Callable, network: Perceptron | None, seed: int, config: PerContactConfig) -> list[Sample]:
    """Samples of one scene. simulate: `deep_contact.simulate`, which lies above this package. network: of its runs."""
    scene, dt, until, budget = scene_of(seed, config.largest)
    solver = PSOR(sweeps=budget, tolerance=None, omega=OMEGA, friction_omega=FRICTION_OMEGA)
    start = "builtin" if network is None else PerContact(network)
    state = simulate(scene, steps=round(until / scene.dt), solver=solver, warm_start=start).state
    found = []
    for _ in range(config.states):
        state = simulate(state, steps=8, dt=dt, solver=solver, warm_start=start).state
        if state.contacts.count:
            sample = _sample(state, solver, budget, config)
            found += [] if sample is None else [sample]
    return found


def _sample(state, solver, budget: int, config: PerContactConfig) -> Sample | None:
    """None where the start is left out."""
    problem = step_problem(state)
    description = describe(problem)
    if description.unsolved < config.least:
        return None
    # From where the solver itself comes to, for a pile with friction has many solutions.
    end = solve(state, solver, state.contacts.normal_start, state.contacts.tangent_start)
    reference = NNCG(sweeps=config.sweeps, tolerance=1e-9)
    led = solve(state, reference, end.normal_impulses, end.tangent_impulses)
    solution = np.column_stack([led.normal_impulses, led.tangent_impulses])
    solved = SolvedProblem(problem.rows, problem.solver_bodies, solution, problem.friction)
    solved = over_relaxed(solved, OMEGA, FRICTION_OMEGA)
    error = float(errors_after(solved, problem.rows.impulse, [budget])[0])
    return Sample(solved, description.inputs, description.corrections, budget, error)


def initial(seed: int) -> list[np.ndarray]:
    """Weights whose gates are nearly 0: [first (21, 16), second (17, 8)], float64, biases last."""
    rng = np.random.default_rng(seed)
    first = rng.normal(0.0, 1.0 / np.sqrt(len(INPUTS)), (len(INPUTS) + 1, HIDDEN))
    second = rng.normal(0.0, 0.01, (HIDDEN + 1, len(CORRECTIONS)))
    first[-1], second[-1] = 0.0, 0.0
    return [first, second]


def loss_of(weights: Sequence[np.ndarray], sample: Sample) -> tuple[float, list[np.ndarray]]:
    """(error after the budget, gradient of error / (Builtin's error + floor) by the weights)."""
    first, second = weights
    hidden = np.maximum(sample.inputs @ first[:-1] + first[-1], 0.0)
    gates = hidden @ second[:-1] + second[-1]
    parts = gates * sample.corrections
    start = sample.problem.rows.impulse + np.column_stack([parts[:, :4].sum(axis=1), parts[:, 4:].sum(axis=1)])
    weight = 1.0 / (sample.builtin_error + _FLOOR)
    _, by_start, errors = loss_and_gradient(sample.problem, start, [sample.budget], [weight])
    by_gates = sample.corrections * np.repeat(by_start, 4, axis=1)
    by_hidden = np.where(hidden > 0.0, by_gates @ second[:-1].T, 0.0)
    gradient = [
        np.vstack([sample.inputs.T @ by_hidden, by_hidden.sum(axis=0)]),
        np.vstack([hidden.T @ by_gates, by_gates.sum(axis=0)]),
    ]
    return float(errors[0]), gradient


def fit(weights, samples: Sequence[Sample], config: PerContactConfig, rate: float, rng) -> list[np.ndarray]:
    """The weights after `epochs` passes of Adam over the samples; gradients are cut to a norm of 2."""
    mean, square = [np.zeros_like(w) for w in weights], [np.zeros_like(w) for w in weights]
    steps, k = config.epochs * -(-len(samples) // config.batch), 0
    for _ in range(config.epochs):
        order = rng.permutation(len(samples))
        for at in range(0, len(samples), config.batch):
            chosen = order[at : at + config.batch]
            gradient = [sum(g) / len(chosen) for g in zip(*(loss_of(weights, samples[i])[1] for i in chosen))]
            size = np.sqrt(sum((g**2).sum() for g in gradient))
            gradient = [g * min(1.0, 2.0 / max(size, 1e-12)) for g in gradient]
            k += 1
            step = rate * min(1.0, k / 30) * 0.5 * (1.0 + np.cos(np.pi * k / steps))
            for i, g in enumerate(gradient):
                mean[i] = 0.9 * mean[i] + 0.1 * g
                square[i] = 0.999 * square[i] + 0.001 * g**2
                unit = mean[i] / (1 - 0.9**k) / (np.sqrt(square[i] / (1 - 0.999**k)) + 1e-8)
                weights[i] = weights[i] - step * unit
    return weights


def ratio(weights, samples: Sequence[Sample]) -> float:
    """Mean error over Builtin's mean error."""
    return sum(loss_of(weights, sample)[0] for sample in samples) / sum(sample.builtin_error for sample in samples)


def network_of(weights, config: PerContactConfig) -> Perceptron:
    """The weights as the compiled steps take them."""
    return Perceptron(*(np.ascontiguousarray(w, np.float32) for w in weights), config.least)


def train(simulate: Callable, config: PerContactConfig, tell: Callable = print) -> tuple[Perceptron, dict]:
    """(perceptron, history) of a training from nothing. tell: is told of each round. simulate: see `samples_of`."""
    begin = time.perf_counter()
    rng = np.random.default_rng(config.seed)
    weights, samples, network, rounds = initial(config.seed), [], None, []
    for k in range(config.rounds):
        seed = FIRST_SEED + 10_000 * config.seed + 1000 * k
        new = [s for i in range(config.scenes) for s in samples_of(simulate, network, seed + i, config)]
        before = ratio(weights, new)
        samples += new
        weights = fit(weights, samples, config, config.rate * (1.0 if k == 0 else 0.5), rng)
        network = network_of(weights, config)
        held = range(VALIDATION_SEED + 1000 * k, VALIDATION_SEED + 1000 * k + max(2, config.scenes // 5))
        own = [s for i in held for s in samples_of(simulate, network, i, config)]
        found = {"states": len(samples), "new_before": before, "own_held_out": ratio(weights, own)}
        rounds.append(found | {"seconds": time.perf_counter() - begin})
        tell(f"round {k}: " + ", ".join(f"{name} {value:.4g}" for name, value in rounds[-1].items()))
    return network, {"rounds": rounds}
