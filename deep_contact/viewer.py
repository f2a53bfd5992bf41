"""A running simulation in a window or as a film (`python -m deep_contact view`): circles, impulses, and θ by sweep."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deep_contact.physics.convergence import ConvergenceRecord
from deep_contact.reporting import plotting
from deep_contact.reporting.film import write_film
from deep_contact.simulation import simulate
from deep_contact.state import State
from deep_contact.validation import integer
from deep_contact.warm_start import Start

PANELS = (1.0, 0.8)
"""Widths of the scene and of θ, in heights of a frame."""
LAYOUT: dict = {"figsize": (5.0 * sum(PANELS), 5.0), "layout": "constrained"}
FLOOR = 1e-9
"""Smallest θ that is drawn, N·s; an isolated contact is solved exactly."""


class Frame(NamedTuple):
    """A solved state and the `ConvergenceRecord` of its sweeps."""

    state: State
    record: ConvergenceRecord


def frames(scene: State, *, steps: int, every: int = 1, solver=None, warm_start: Start = "builtin") -> Iterator[Frame]:
    """Run a scene, or continue from a state, and yield the last frame of each `every` steps as soon as it is solved.

    Raises ValueError at once on counts below one, and with the first step on arguments that `simulate` refuses.
    """
    steps, every = integer("steps", steps, least=1), integer("every", every, least=1)

    def run(state: State) -> Iterator[Frame]:
        last: deque[Frame] = deque(maxlen=1)
        options = {"solver": solver, "warm_start": warm_start, "on_step": lambda *solved: last.append(Frame(*solved))}
        for done in range(0, steps, every):
            state = simulate(state, steps=min(every, steps - done), **options).state
            yield last[0]

    return run(scene)


class Painter:
    """Draws frames into two axes. The scales only grow, so that frames can be compared."""

    _speed, _impulse, _sweeps = 12.0, 0.0, 10  # m/s, N·s, sweeps
    _theta = (np.inf, 0.0)  # smallest and largest so far

    def __call__(self, axes, frame: Frame) -> None:
        """Draw a frame; axes: of the scene and of θ, empty."""
        (scene, ax), (state, record), count = axes, frame, frame.record.theta.size
        largest = float(state.contacts.normal_impulse.max(initial=0.0))
        self._impulse = max(self._impulse, largest)
        self._speed = max(self._speed, float(np.hypot(*state.bodies.velocity.T).max(initial=0.0)))
        plotting.draw_state(scene, state, limits=(0.0, self._speed), largest_impulse=self._impulse or None)
        text = f"t = {state.time:.2f} s, {state.contacts.count} contacts, largest λ$_n$ = {largest:.3g} N·s"
        scene.set_title(text, loc="left")
        ax.set_title(f"{count} sweep{'' if count == 1 else 's'}, {record.status.replace('_', ' ')}", loc="left")
        ax.set(xscale="log", yscale="log")
        if count:
            theta = np.maximum(record.theta, FLOOR)
            self._sweeps = max(self._sweeps, count)
            self._theta = min(self._theta[0], theta.min()), max(self._theta[1], theta.max())
            ax.plot(np.arange(1, count + 1), theta, "o-" if count < 30 else "-", markersize=3)
        if tolerance := getattr(state.solver, "tolerance", None):
            ax.axhline(tolerance, color=plotting.GREY, linewidth=1.0, linestyle="--")
        if self._theta[1]:
            ax.set_ylim(0.5 * self._theta[0], 2 * self._theta[1])
        ax.set_xlim(0.9, 1.1 * self._sweeps)
        plotting.label_axes(ax, "sweep of this step", "convergence rate θ", y_unit="N·s")


def has_display() -> bool:
    """Whether matplotlib can open a window here."""
    try:
        figure = pyplot.figure()
    except ImportError:  # MPLBACKEND names a backend for windows that cannot be loaded
        return False
    framework = figure.canvas.required_interactive_framework
    pyplot.close(figure)  # which takes the canvas of a window away
    return framework is not None


def _painted(frames: Iterable[Frame], figure) -> Iterator[None]:
    """Draw one frame after the other into a figure."""
    painter, axes = Painter(), figure.subplots(1, 2, width_ratios=PANELS)
    for frame in frames:
        for ax in axes:
            ax.clear()
        painter(axes, frame)
        yield


def play(frames: Iterable[Frame]) -> int:
    """Show frames in a window until they end or the window is closed. Returns how many were shown."""
    shown = 0
    with plotting.style():
        figure = pyplot.figure(**LAYOUT)
        for shown, _ in enumerate(_painted(frames, figure), start=1):
            pyplot.pause(0.001)
            if not pyplot.fignum_exists(figure.number):
                return shown
        pyplot.show()
    return shown


def record(frames: Iterable[Frame], path, *, fps: float = 25) -> Path:
    """Write frames as a film, a .gif, or an .mp4 where ffmpeg is installed. Returns the path.

    Raises ValueError for another kind of file, and for an MP4 without ffmpeg, before the first frame is made.
    """
    with plotting.style():
        canvas = FigureCanvasAgg(Figure(**LAYOUT, dpi=80))

        def pictures():
            for _ in _painted(frames, canvas.figure):
                canvas.draw()
                yield np.asarray(canvas.buffer_rgba())[..., :3].copy()

        return write_film(path, pictures(), fps)
