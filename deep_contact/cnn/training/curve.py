"""The learning curve of a run, from its history."""

from __future__ import annotations

import csv
from pathlib import Path

from deep_contact.reporting import plotting


def read_history(path) -> list[dict]:
    """The lines of a run's history.csv, as numbers."""
    with open(path, encoding="utf-8", newline="") as file:
        return [{name: float(value) for name, value in line.items()} for line in csv.DictReader(file)]


def learning_curve(history: list[dict], path) -> Path:
    """Draw the losses against the epoch, with the best one marked, into a PNG. Returns its path."""
    epochs = [line["epoch"] + 1 for line in history]
    losses = [line["validation_loss"] for line in history]
    best = losses.index(min(losses))
    with plotting.style():
        figure, (left, right) = plotting.subplots(1, 2, size=(8.0, 3.4))
        look = {"marker": "o", "markersize": 3 if len(history) < 30 else 0}
        left.plot(epochs, [line["loss"] for line in history], **look)
        right.plot(epochs, losses, **look)
        right.plot(epochs[best], losses[best], "o", color=plotting.VERMILION)
        plotting.label_axes(left, "epoch", "training loss")
        title = f"best: {losses[best]:.3g}, after epoch {epochs[best]:g}"
        plotting.label_axes(right, "epoch", "validation loss", title=title)
        for ax in (left, right):
            ax.xaxis.get_major_locator().set_params(integer=True)
        figure.suptitle(f"Does it still learn? {len(history)} epochs", fontsize=10)
        plotting.save(figure, path)
    return Path(path)
