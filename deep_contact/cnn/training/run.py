"""A training run, which can be interrupted and resumed after each epoch.

A run writes these files into its folder:

| file        | contents                                                                                          |
|-------------|---------------------------------------------------------------------------------------------------|
| last.npz    | state after the last epoch: weights, optimizer, random states, history and settings               |
| best.h5     | model file of the epoch with the lowest validation loss so far                                    |
| history.csv | a line for each epoch: number of the epoch from 0, learning rate, mean loss, seconds;             |
|             | validation_loss, for the far-field network divided by the loss of Builtin's start;                |
|             | validation_velocity_error, mean velocity error before any sweep, and validation_velocity_error_k, |
|             | mean velocity error after k sweeps, for each k of `TrainingConfig.sweeps`;                        |
|             | for a network on images also penalty, the L2 penalty of the weights, and                          |
|             | validation_…, the results of `evaluation.start_quality`                                           |
| model.h5    | at the end of the run: the network of best.h5 with its card                                       |

Each file is replaced as a whole. An epoch depends only on last.npz, the settings and the data. So a run that is killed
at any moment and started again gives the history of an uninterrupted run, bit by bit on the same machine. The epoch in
which the run was killed is repeated from its beginning.

Tests: tests/cnn/test_training.py
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact.cnn import schedules
from deep_contact.cnn.backend import keras, limit_threads, tensorflow
from deep_contact.cnn.dataset import Store, evenly, split_by_simulation
from deep_contact.cnn.evaluation import BASELINES, held_out_errors
from deep_contact.cnn.inference import LearnedModel, load_model
from deep_contact.cnn.model_file import read_metadata, save_model
from deep_contact.cnn.training.config import TrainingConfig
from deep_contact.cnn.training.far_field_run import FarFieldRun
from deep_contact.cnn.training.network import ImageRun
from deep_contact.state.equality import by_value
from deep_contact.stepping.problem import step_problem


@by_value
class Training(NamedTuple):
    """The result of a finished run.

    history: a dict for each epoch, name of the column in history.csv -> value. best_epoch: number of the epoch with the
    lowest validation loss, from 0. path: path of model.h5. model: the model in this file.
    """

    history: list[dict]
    best_epoch: int
    path: Path
    model: LearnedModel


def train(
    config: TrainingConfig,
    data,
    out,
    *,
    from_model=None,
    threads: int | None = None,
    command: str = "",
    held_out: int = 300,
    verbose: int | str = "auto",
    callbacks: Sequence[keras.callbacks.Callback] = (),
) -> Training:
    """Train a network until all epochs are done or a callback ends the run.

    If the folder `out` has an unfinished run, this run is resumed.
    config: settings of the run. data: folder of the simulations. out: folder of the run. from_model: path of a model
    file whose weights the network has at first; the images of the network in the file have to be defined as in `config`
    (`config.config_of` returns such settings). threads: number of TensorFlow's threads (`limit_threads`), or None for
    no change. command: the command that started the run, a text for the card. held_out: approximate number of test
    states on which the errors on the card are measured. verbose: 0 prints nothing, 1 a progress bar, 2 a line for each
    epoch, and "auto" is 1 on a terminal and 2 elsewhere; unless it is 0, the sizes of the files are printed first.
    callbacks: Keras callbacks; a resumed run calls them for the remaining epochs only.
    Raises ValueError if the run in `out` was started with other settings or data. Another number of `epochs` raises it
    only if the learning rates depend on this number. Raises FloatingPointError if the loss is not finite.
    """
    store, out = Store(data), Path(out)
    out.mkdir(parents=True, exist_ok=True)
    if threads is not None:
        limit_threads(threads)
    tensorflow.config.experimental.enable_op_determinism()
    keras.utils.set_random_seed(config.seed)
    split = split_by_simulation(store.simulations, fractions=config.fractions, seed=config.seed)
    settings = asdict(config) | {"data": store.data_hash()}
    settings["from_model"] = None if from_model is None else read_metadata(from_model)["digest"]
    initial = None if from_model is None else load_model(from_model)
    if initial and initial.spec != config.spec():
        raise ValueError(f"from_model: expected a network for the images {config.spec()}, got one for {initial.spec}")
    settings = json.loads(json.dumps(settings))
    kind = {"far field": FarFieldRun, "thesis": ImageRun}[config.architecture]
    run = kind(config, store, split, initial and initial.network)
    about = {"command": command, "config": settings, "data_hash": settings["data"], "split": split._asdict()}
    run.resume(out, about)
    if verbose == "auto":
        verbose = 1 if sys.stdout.isatty() else 2
    if len(run.history) < config.epochs:
        if verbose:
            size = 4e-6 * sum(np.prod(v.shape) for v in run.variables.values())
            print(f"{run.model.count_params():,} weights, {len(run.states):,} states to train on")
            print(f"{out} will hold last.npz, {size:.1f} MB, and best.h5 and model.h5, which are smaller")
        rates = schedules.SCHEDULES[config.schedule](config.epochs, config.rate)
        scheduler = keras.callbacks.LearningRateScheduler(lambda epoch, rate: rates(epoch))
        run.fit([scheduler, *callbacks], verbose=verbose)
    best_epoch = min(range(len(run.history)), key=lambda k: run.history[k]["validation_loss"])
    model = load_model(out / "best.h5")
    tested = evenly(store.states(split.test), held_out)
    # The contact problem is passed, as in a simulation. Without it, a far-field network would warn if all contacts are
    # new.
    starts = BASELINES | {"cnn": lambda state, solver: model.predict(state, problem=step_problem(state))}
    errors = held_out_errors((store.state(*state) for state in tested.tolist()), starts)
    card = run.card() | {"best_epoch": best_epoch, "held_out": errors}
    path = save_model(out / "model.h5", model.network, run.spec, card, box=run.box)
    return Training(run.history, best_epoch, path, load_model(path))
