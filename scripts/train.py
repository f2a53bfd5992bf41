"""python scripts/train.py [--architecture "far field"|thesis] [--out FOLDER] …: train a network.

    python scripts/generate_data.py                          # the data, once
    python scripts/train.py                                  # the far-field network, through the solver
    python scripts/train.py --architecture thesis --epochs 10
    python scripts/train.py --from models/model.h5 --epochs 5 --out runs/further    # go on from a model, its settings

Started again with the same flags, a run goes on where it was stopped. At the end <out>/model.h5 is a model file with
its card, and <out>/history.png the learning curve; --model copies both to another place.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
import types
import typing
from dataclasses import fields
from pathlib import Path

from deep_contact.cnn.training.config import CONFIGS, TrainingConfig, config_of


class Parser(argparse.ArgumentParser):
    """Reports a wrong option in one line, without the list of all options."""

    def error(self, message: str):
        self.exit(2, f"{self.prog}: {message}; --help lists the options\n")


def arguments() -> argparse.ArgumentParser:
    """A flag for every field of the configuration, and those of this script."""
    parser = Parser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, argument_default=argparse.SUPPRESS
    )
    add = parser.add_argument
    add("--data", default="data/generated", help="folder of the simulations")
    add("--out", default=None, help="folder of the run; by default runs/<architecture>")
    add("--model", default=None, metavar="PATH", help="copy the finished model file there too")
    add("--from", default=None, metavar="PATH", dest="from_model", help="go on from this model file")
    add("--threads", type=int, default=1, help="of TensorFlow")
    add("--held-out", type=int, default=300, metavar="N", help="test states for the card")
    add = parser.add_argument_group("settings (defaults by architecture)").add_argument
    hints = typing.get_type_hints(TrainingConfig)
    special = {
        "options": {"nargs": "*", "type": option, "metavar": "NAME=NUMBER", "help": "of the network"},
        "sweeps": {"nargs": "+", "type": int, "help": "numbers of sweeps whose errors the far-field network learns"},
        "targets": {"nargs": "+", "help": "impulses that a network on images predicts"},
        "fractions": {"nargs": 3, "type": float, "help": "train, validation, test"},
    }
    for field in fields(TrainingConfig):
        kind, shown = hints[field.name], f"far field: {field.default}"
        if kind is bool:
            how = {"action": argparse.BooleanOptionalAction, "help": shown}
        elif isinstance(kind, types.UnionType):
            how = {"type": lambda text: None if text == "none" else int(text), "metavar": "NUMBER"}
            how["help"] = f"or none; {shown}"
        else:
            how = {"type": kind, "help": shown}
        add("--" + field.name.replace("_", "-"), **special.get(field.name, how))
    return parser


def option(text: str):
    """NAME=NUMBER as (name, value)."""
    name, _, value = text.partition("=")
    return name, float(value) if "." in value or "e" in value else int(value)


def configuration(given: dict, from_model) -> TrainingConfig:
    """The settings by their flags: those of a model, or the defaults of the architecture, with changes."""
    if "options" in given:
        given["options"] = dict(given["options"])
    if from_model is not None:
        from deep_contact.cnn.model_file import read_metadata

        return config_of(read_metadata(from_model), **given)
    return CONFIGS.get(given.get("architecture"), TrainingConfig)(**given)


def learning_curve(history, path):
    """Draw the losses, and the validation errors if there are any, against the epoch. Returns the axes."""
    from deep_contact.reporting import plotting

    errors = [name for name in history[-1] if name.startswith("validation_velocity")]
    with plotting.style():
        figure, axes = plotting.subplots(1, 2 if errors else 1, size=(8.4 if errors else 4.2, 3.4), squeeze=False)
    epochs = [line["epoch"] + 1 for line in history]
    for name, label in (("loss", "training"), ("validation_loss", "validation")):
        axes[0, 0].plot(epochs, [line[name] for line in history], label=label)
    for name in errors:
        sweeps = name.removeprefix("validation_velocity_error").lstrip("_")
        label = f"after {sweeps or 'no'} sweep{'s' if sweeps else ''}"
        axes[0, 1].semilogy(epochs, [line[name] for line in history], label=label)
    for ax, quantity in zip(axes[0], ("loss", "relative velocity error, validation")):
        plotting.label_axes(ax, "epoch", quantity)
        ax.legend()
    plotting.save(figure, path)
    return axes[0]


def run(data, out, model, **given) -> None:
    """Train, and print the errors on the test states."""
    options = {name: given.pop(name) for name in ("threads", "held_out", "from_model")}
    config = configuration(given, options["from_model"])
    out = Path(out or f"runs/{config.architecture.replace(' ', '_')}")
    from deep_contact.cnn.dataset import Store

    store = Store(data)  # before TensorFlow, which takes seconds to load
    from deep_contact.cnn.training import train

    done = train(config, store, out, command=shlex.join(["python", "scripts/train.py", *sys.argv[1:]]), **options)
    learning_curve(done.history, out / "history.png")
    print(f"best epoch {done.best_epoch + 1} of {len(done.history)}; {done.path}")
    errors = done.model.card["held_out"]
    print("mean relative velocity error after", ", ".join(map(str, errors["sweeps"])), "sweeps, test states")
    for phase, found in errors["phases"].items():
        for start in (name for name in ("none", "builtin", "cnn") if name in found):
            numbers = "  ".join(f"{value:8.4f}" for value in found[start]["mean"])
            print(f"  {phase:9s} ({found['states']:4d})  {start:8s} {numbers}")
    if model:
        model = Path(model)
        model.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(done.path, model)
        for name in ("history.png", "history.csv"):
            shutil.copyfile(out / name, model.with_name(f"{model.stem}_{name}"))


def main(given=None) -> int:
    parsed = vars(arguments().parse_args(given))
    try:
        run(**parsed)
    except KeyboardInterrupt:
        print("\ntrain.py: stopped; the same command goes on after the last finished epoch", file=sys.stderr)
        return 130
    except (OSError, ValueError, ArithmeticError, RuntimeError) as error:
        print(f"train.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
