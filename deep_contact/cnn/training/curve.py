"""The learning curve of a training run, drawn from its history.

Tests: tests/cnn/test_training.py
"""

from __future__ import annotations

import csv
from pathlib import Path

from deep_contact.plot import plotting


def read_history(path) -> list[dict]:
    """Read the file history.csv of a run. Returns a dict for each epoch: name of the column -> number."""
    with open(path, encoding="utf-8", newline="") as file:
        return [{name: float(value) for name, value in line.items()} for line in csv.DictReader(file)]


def learning_curve(history: list[dict], path) -> Path:
    """Draw the training and validation losses against the epoch into a PNG, and mark the best epoch. Returns the path.

    For a network on images the picture also has the penalty of the weights, and the errors of the predicted impulses on
    validation states.
    history: result of `read_history`. path: path of the PNG.
    """
    of_images = "penalty" in history[0]
    columns = {name: [line[name] for line in history] for name in history[0]}
    epochs, losses = [epoch + 1 for epoch in columns["epoch"]], columns["validation_loss"]
    best = losses.index(min(losses))
    look = {"marker": "o", "markersize": 3 if len(history) < 30 else 0}

    def lines(ax, names, title=""):
        for name, label in names.items():
            ax.plot(epochs, columns[name], label=label, **look)
        plotting.label_axes(ax, "epoch", "" if len(names) > 1 else label, title=title)
        if len(names) > 1:
            ax.legend()
        ax.xaxis.get_major_locator().set_params(integer=True)

    with plotting.style():
        rows = 2 if of_images else 1
        figure, axes = plotting.subplots(rows, 2, size=(8.0, 3.4 * rows))
        axes = axes.ravel()
        rates = list(dict.fromkeys(columns["rate"]))
        title = f"rates: {', '.join(map(str, rates))}" if len(rates) < 5 else ""
        lines(axes[0], {"loss": "training loss"} | ({"penalty": "penalty of the weights"} if of_images else {}), title)
        title = f"best: {losses[best]:.3g}, after epoch {epochs[best]:g}"
        lines(axes[1], {"validation_loss": "validation loss"}, title)
        axes[1].plot(epochs[best], losses[best], "o", color=plotting.VERMILION)
        if of_images:
            names = {"impulse_error": "error of λ", "scaled_error": "with the best factor"}
            names |= {"correlation": "correlation"}
            lines(axes[2], {f"validation_{name}": label for name, label in names.items()}, "starts, held-out states")
            names = {"": "at once", "_3": "after 3 sweeps", "_10": "10", "_30": "30"}
            names = {f"validation_velocity_error{k}": label for k, label in names.items()}
            lines(axes[3], names, "error of velocities, held-out states")
        figure.suptitle(f"Does it still learn? {len(history)} epochs", fontsize=10)
        plotting.save(figure, path)
    return Path(path)
