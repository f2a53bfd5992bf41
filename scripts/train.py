"""python scripts/train.py [--quick] [--recipe "far field"|thesis|"authors' code"] [--out FOLDER] …: train a network.

    python scripts/train.py --quick                          # a small network on its own small data, in two minutes
    python scripts/generate_data.py                          # the data, once
    python scripts/train.py                                  # the far-field network, through the solver
    python scripts/train.py --recipe thesis --epochs 80             # the thesis's network, as the thesis prints it
    python scripts/train.py --recipe "authors' code" --epochs 80    # as its authors' code trains it
    python scripts/train.py --from models/far_field.h5 --epochs 5 --out runs/further    # go on, with its settings

The learning curve, <out>/history.png, is drawn after every epoch. If the same command is started again, the run
continues after the last finished epoch. At the end, <out>/model.h5 is the model file with its card. `deep-contact
train` and `deep-contact generate-data` do the same without the repository.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import types
import typing
from dataclasses import fields
from pathlib import Path

from deep_contact.__main__ import INTERRUPTED, status_of
from deep_contact.cnn.training.config import RECIPES, TrainingConfig, config_of, recipe
from deep_contact.io.argument_parser import Parser

QUICK_DATA = "--simulations 12 --steps 250 --bodies 40 60 --seed 1 --jobs 1".split()
"""Arguments of `generate_data.py` with which --quick makes its data."""
QUICK = {
    "far field": {"options": {"width": 8}, "epochs": 8, "states_per_epoch": 960},
    "thesis": {
        "options": {"stacks": [[4, [3]], [8, [3]], [8, [2]], [16, [2]], [16, [2]]], "rank": None},
        **{"epochs": 16, "states_per_epoch": 640, "batch_size": 8},
    },
}
"""Architecture -> settings that --quick changes."""
for _small in QUICK.values():
    _small |= {"validation_states": 100, "fractions": (0.7, 0.15, 0.15)}


def arguments() -> Parser:
    """Return the parser, with an option for every field of `TrainingConfig`, and the options of this script."""
    layout = {"formatter_class": argparse.RawDescriptionHelpFormatter, "usage": "%(prog)s [--quick] [--OPTION VALUE …]"}
    parser = Parser(description=__doc__, argument_default=argparse.SUPPRESS, **layout)
    add = parser.add_argument
    add("--quick", action="store_true", default=False, help="a small network and its data, made in <out>/data")
    add("--recipe", choices=RECIPES, help="settings by name (far field)")
    add("--data", default=None, help="folder of the simulations (data/generated)")
    add("--out", default=None, help="folder of the run; by default runs/<recipe> or runs/quick_<recipe>")
    add("--from", default=None, metavar="PATH", dest="from_model", help="go on from this model, by its file or name")
    add("--threads", type=int, default=1, help="of TensorFlow")
    add("--held-out", type=int, default=300, metavar="N", help="test states for the card")
    add = parser.add_argument_group("settings (defaults by recipe)").add_argument
    hints = typing.get_type_hints(TrainingConfig)
    special = {
        "options": {"nargs": "*", "type": option, "metavar": "NAME=NUMBER", "help": "of the network"},
        "sweeps": {"nargs": "+", "type": int, "help": "numbers of sweeps whose errors the far-field network learns"},
        "fractions": {"nargs": 3, "type": float, "help": "train, validation, test"},
    }
    for field in fields(TrainingConfig):
        how = {"type": hints[field.name], "help": f"far field: {field.default}"}
        if isinstance(how["type"], types.UnionType):
            how = {"type": lambda text: None if text == "none" else int(text), "metavar": "NUMBER", "help": "or none"}
        add("--" + field.name.replace("_", "-"), **special.get(field.name, how))
    return parser


def option(text: str):
    """Parse "NAME=NUMBER". Returns (name, value)."""
    name, _, value = text.partition("=")
    return name, float(value) if "." in value or "e" in value else int(value)


def configuration(changes: dict, from_model, quick: bool = False) -> TrainingConfig:
    """Return the settings of a model file or of a recipe, with changes.

    changes: fields of `TrainingConfig`, and "recipe", from the command line. from_model: path of the model file, or
    None to take a recipe. quick: whether the settings `QUICK` replace those of the recipe. Raises ValueError if the
    options contradict each other.
    """
    if "options" in changes:
        changes["options"] = dict(changes["options"])
    name = changes.pop("recipe", None)
    if from_model is not None:
        if name is not None:
            raise ValueError("recipe: expected none beside --from, which has the settings of its model")
        from deep_contact.cnn.model_file import read_metadata

        return config_of(read_metadata(from_model), **changes)
    if name is None and changes.get("architecture") == "thesis":
        raise ValueError(
            "architecture: expected a recipe of the thesis's, --recipe thesis or \"authors' code\", got none"
        )
    settings = recipe(name or "far field")
    small = QUICK[settings.architecture] if quick else {}
    options = small.get("options", {}) | changes.get("options", {})
    return recipe(name or "far field", **(small | changes | {"options": options}))


def run(data, out, quick, **changes) -> None:
    """Train a network, and print its errors on the test states.

    data, out: folders of the simulations and of the run, or None for the default. quick: whether to train a small
    network on a small data set. changes: the other options of the command line.
    """
    options = {name: changes.pop(name) for name in ("threads", "held_out", "from_model")}
    if options["from_model"] is not None:
        from deep_contact.cnn.registry import network_file

        options["from_model"] = network_file(options["from_model"])
    folder = changes.get("recipe", "far field").replace(" ", "_").replace("'", "")
    config = configuration(changes, options["from_model"], quick)
    print(config)
    out = Path(out or f"runs/{'quick_' if quick else ''}{folder}")
    from deep_contact.cnn.dataset import Store

    if quick and data is None:
        data = out / "data"
        print(f"{data}: short simulations, about 8 MB", flush=True)
        made = [sys.executable, Path(__file__).with_name("generate_data.py"), "--out", data, *QUICK_DATA]
        if subprocess.run(made).returncode:
            raise OSError(f"{data}: expected simulations, got none")
    data = Store(data or "data/generated").folder  # fails before TensorFlow is imported, which takes seconds
    from deep_contact.cnn.backend import keras
    from deep_contact.cnn.training import train
    from deep_contact.cnn.training.curve import learning_curve, read_history

    def draw(epoch, logs):
        learning_curve(read_history(out / "history.csv"), out / "history.png")

    options["callbacks"] = [keras.callbacks.LambdaCallback(on_epoch_end=draw)]
    done = train(config, data, out, command=shlex.join(["python", "scripts/train.py", *sys.argv[1:]]), **options)
    print(f"best epoch {done.best_epoch + 1} of {len(done.history)}; {done.path}; {out / 'history.png'}")
    errors = done.model.card["held_out"]
    print("mean relative velocity error after", ", ".join(map(str, errors["sweeps"])), "sweeps, test states")
    for phase, starts in errors["phases"].items():
        count = starts.pop("states")
        for start, values in starts.items():
            print(f"  {phase:9s} ({count:4d})  {start:8s} {'  '.join(f'{value:8.4f}' for value in values['mean'])}")


def main(argv=None) -> int:
    parsed = vars(arguments().parse_args(argv))
    try:
        run(**parsed)
    except KeyboardInterrupt:
        print("\ntrain: stopped; the same command goes on after the last whole epoch", file=sys.stderr)
        return INTERRUPTED
    except (ModuleNotFoundError, OSError, ValueError, ArithmeticError, RuntimeError, MemoryError) as error:
        print(f"train: {error}", file=sys.stderr)
        return status_of(error)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
