"""python scripts/train.py [--architecture compact|thesis|"far field"] [--out FOLDER] …: train a network.

    python scripts/generate_data.py                          # the data, once
    python scripts/train.py --out runs/compact               # ours
    python scripts/train.py --architecture thesis --out runs/thesis --epochs 10
    python scripts/train.py --architecture "far field"       # the far-field network, through the solver

With --devices N, TensorFlow shares every batch among N of its devices, the same step but for rounding.

Started again with the same flags, a run goes on where it was stopped. At the end <out>/model.h5 is a model file with
its card, and <out>/history.png the learning curve; --model copies both to where they are wanted.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import sys
import types
import typing
from dataclasses import MISSING, fields
from pathlib import Path


def arguments(config_class) -> argparse.ArgumentParser:
    """A flag for every field of the configuration, and those of this script."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, argument_default=argparse.SUPPRESS
    )
    parser.add_argument("--data", default="data/generated", help="folder of the simulations")
    parser.add_argument("--out", default=None, help="folder of the run; by default runs/<architecture>")
    parser.add_argument("--model", default=None, metavar="PATH", help="copy the finished model file there too")
    parser.add_argument("--threads", type=int, default=1, help="of TensorFlow")
    parser.add_argument("--devices", type=int, default=1, metavar="N", help="GPUs that share every batch (1)")
    parser.add_argument("--held-out", type=int, default=300, metavar="N", help="test states for the card")
    parser.add_argument("--tensorboard", default=None, metavar="DIR", help="write event files there")
    settings = parser.add_argument_group("settings (defaults by architecture)")
    hints = typing.get_type_hints(config_class)
    for field in fields(config_class):
        flag, kind = "--" + field.name.replace("_", "-"), hints[field.name]
        shown = field.default if field.default is not MISSING else None
        if field.name == "options":
            settings.add_argument(flag, nargs="*", type=option, metavar="NAME=NUMBER", help="of the network")
        elif field.name == "phases":
            settings.add_argument(flag, nargs="+", help=f"train on these alone; compact: {' '.join(shown)}")
        elif field.name == "sweeps":
            settings.add_argument(flag, nargs="+", type=int, help=f"whose errors the far-field network learns: {shown}")
        elif field.name == "fractions":
            settings.add_argument(flag, nargs=3, type=float, help=f"train, validation, test; compact: {shown}")
        elif kind is bool:
            settings.add_argument(flag, action=argparse.BooleanOptionalAction, help=f"compact: {shown}")
        elif isinstance(kind, types.UnionType):
            inner = next(t for t in typing.get_args(kind) if t is not type(None))
            settings.add_argument(flag, type=optional(inner), help=f"a number or none; compact: {shown}")
        else:
            settings.add_argument(flag, type=kind, help=f"compact: {shown}")
    return parser


def option(text: str):
    """NAME=NUMBER or NAME=1,2,4 as (name, value)."""
    name, _, value = text.partition("=")
    numbers = [float(v) if "." in v or "e" in v else int(v) for v in value.split(",")]
    return name, numbers if "," in value else numbers[0]


def optional(kind):
    """Parser of a number, or None for "none"."""
    return lambda text: None if text.lower() == "none" else kind(text)


def learning_curve(history, path, last="impulses") -> None:
    """Loss and errors against the epoch. last: what the last column of errors is of."""
    from deep_contact.reporting import plotting

    with plotting.style():
        figure, (left, right) = plotting.subplots(1, 2, size=(8.4, 3.4))
    epochs = [line["epoch"] + 1 for line in history]
    left.plot(epochs, [line["loss"] for line in history], label="training")
    left.plot(epochs, [line["validation_loss"] for line in history], label="validation")
    plotting.label_axes(left, "epoch", "loss")
    right.semilogy(epochs, [line["validation_velocity_error"] for line in history], label="velocities, no sweep")
    right.semilogy(epochs, [line["validation_impulse_error"] for line in history], label=last)
    plotting.label_axes(right, "epoch", "relative error, validation")
    left.legend()
    right.legend()
    plotting.save(figure, path)


def main() -> int:
    """Train, and print the errors on the test states."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    from deep_contact.cnn.training import TrainingConfig, far_field_config, thesis_config, train

    given = vars(arguments(TrainingConfig).parse_args())
    names = ("data", "out", "model", "threads", "devices", "held_out", "tensorboard")
    data, out, model, threads, devices, held_out, tensorboard = (given.pop(name) for name in names)
    given["options"] = dict(given.get("options") or [])
    configs = {"thesis": thesis_config, "far field": far_field_config}
    config = configs.get(given.get("architecture"), TrainingConfig)(**given)
    out = Path(out or f"runs/{config.architecture.replace(' ', '_')}")
    done = train(
        config,
        data,
        out,
        threads=threads,
        devices=devices,
        held_out=held_out,
        tensorboard=tensorboard,
        command=shlex.join(["python", "scripts/train.py", *sys.argv[1:]]),
    )
    far = config.architecture == "far field"
    last = f"velocities, {config.sweeps[-1]} sweeps" if far else "impulses, no sweep"
    learning_curve(done.history, out / "history.png", last)
    print(f"best epoch {done.best_epoch + 1} of {len(done.history)}; {done.path}")
    errors = done.model.card["held_out"]
    print("mean relative velocity error after", ", ".join(map(str, errors["sweeps"])), "sweeps, test states")
    for phase, found in errors["phases"].items():
        for start in ("none", "builtin", "cnn"):
            if start in found:
                numbers = "  ".join(f"{value:8.4f}" for value in found[start]["mean"])
                print(f"  {phase:9s} ({found['states']:4d})  {start:8s} {numbers}")
    if model:
        model = Path(model)
        model.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(done.path, model)
        shutil.copyfile(out / "history.png", model.with_name(f"{model.stem}_history.png"))
        shutil.copyfile(out / "history.csv", model.with_name(f"{model.stem}_history.csv"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
