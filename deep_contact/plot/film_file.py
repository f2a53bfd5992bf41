"""Films of runs as GIF or MP4: pictures of states with the time, a scale, and a key of colours or forces.

Tests: tests/run/test_trajectory.py
"""

from __future__ import annotations

import errno
import math
import shutil
import signal
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from deep_contact.io.files import replacing
from deep_contact.plot import plotting
from deep_contact.state.validation import expect

MARGIN = 8
"""Margin around the box, pixels."""

LINE = 22
"""Height of a line of text in the strip below the box, pixels."""

LEAST_STRIP = 112
"""Width of the narrowest picture with a strip below the box, pixels."""


class Canvas:
    """Draws states of one world. Called with a state, a canvas returns its picture.

    The longer side of the box, with a margin at either end, has `size` pixels. A strip below the box shows the time, a
    scale and a key.

    strongest: impulse of the widest line, N·s. fastest: speed of the last colour, m/s. forces: whether the network of
    contact forces is drawn in place of the speeds; `strongest` is then a force, N.
    """

    def __init__(self, world, *, size: int, strongest: float, fastest: float = 0.0, forces: bool = False):
        x_min, y_min, x_max, y_max = world.box
        sides = x_max - x_min, y_max - y_min
        pixel = max(sides) / (size - 2 * MARGIN)
        # Even numbers of pixels, because films store colours at half the resolution.
        width, height = (2 * math.ceil((side / pixel + 2 * MARGIN) / 2) for side in sides)
        lines = 0 if width < LEAST_STRIP else 1 if width >= 3 * LEAST_STRIP else 3
        whole = height + LINE * lines
        figure = Figure(figsize=(width / plotting.DPI, whole / plotting.DPI), dpi=plotting.DPI)
        self._canvas = FigureCanvasAgg(figure)
        self._ax = figure.add_axes((0.0, LINE * lines / whole, 1.0, height / whole))
        left, top = x_min - MARGIN * pixel, y_max + MARGIN * pixel
        self._place = {"xlim": (left, left + width * pixel), "ylim": (top - height * pixel, top)}
        self._draw = plotting.draw_contact_forces if forces else plotting.draw_state
        self._look = {"largest": strongest, "key": False} if forces else {"largest_impulse": strongest, "bar": False}
        self._look |= {} if forces else {"limits": (0.0, fastest)}
        self._clock = None
        if lines:
            strip = figure.add_axes((0.0, 0.0, 1.0, LINE * lines / whole))
            strip.set(xlim=(0, width), ylim=(0, LINE * lines))
            strip.axis("off")
            (x, y), *others = _corners(width, lines)
            self._clock = strip.text(x, y, "", **_LETTERS)
            _draw_scale(strip, *others[0], pixel, width / 5 if lines == 1 else width / 2)
            if forces:
                _draw_force(strip, *others[1], strongest)
            else:
                _draw_colours(strip, *others[1], fastest)

    def __call__(self, state) -> np.ndarray:
        """Return the picture of a state, (height, width, 3), uint8."""
        self._ax.clear()
        self._draw(self._ax, state, **self._look)
        self._ax.set(**self._place, aspect="auto")
        self._ax.axis("off")
        if self._clock is not None:
            self._clock.set_text(f"t = {state.time:.2f} s" if state.time < 1e4 else f"t = {state.time:.4g} s")
        self._canvas.draw()
        return np.array(self._canvas.buffer_rgba())[:, :, :3]


_LETTERS = {"fontsize": 12 * 72 / plotting.DPI, "va": "center", "family": "DejaVu Sans"}
"""Style of letters 12 pixels high."""


def _corners(width: int, lines: int) -> list[tuple[float, float]]:
    """Return the places (x, y) at which time, scale and key begin, pixels.

    They lie in one line, or in three lines from the top.
    """
    if lines == 1:
        return [(share * width + MARGIN, LINE / 2) for share in (0.0, 0.31, 0.62)]
    return [(MARGIN, LINE * (line + 0.5)) for line in (2, 1, 0)]


def _draw_scale(strip, x: float, y: float, pixel: float, most: float) -> None:
    """Draw a scale bar of 1, 2 or 5 · 10ᵏ m. x, y: its left end, pixels.

    pixel: size of a pixel, m. most: largest length of the bar, pixels.
    """
    metres = plotting.round_down(most * pixel)
    end = x + metres / pixel
    strip.plot([x, x, x, end, end, end], [y - 4, y + 4, y, y, y - 4, y + 4], color=plotting.BLACK, linewidth=0.6)
    strip.text(end + 5, y, f"{metres:g} m", **_LETTERS)


def _draw_colours(strip, x: float, y: float, fastest: float) -> None:
    """Draw the colours of speeds from 0 to `fastest`, m/s. x, y: left end, pixels."""
    strip.text(x, y, "0", **_LETTERS)
    strip.imshow(
        [np.linspace(0, 1, 32)], extent=(x + 11, x + 51, y - 4, y + 4), cmap=plotting.COLOUR_MAP, aspect="auto"
    )
    strip.text(x + 55, y, f"{fastest:.3g} m/s", **_LETTERS)


def _draw_force(strip, x: float, y: float, strongest: float) -> None:
    """Draw a line of the largest width, and its force `strongest`, N. x, y: left end, pixels."""
    strip.plot([x, x + 28], [y, y], color=plotting.VERMILION, linewidth=plotting.WIDEST, solid_capstyle="butt")
    strip.text(x + 34, y, f"{float(f'{strongest:.3g}'):,g} N", **_LETTERS)


def write_film(path, states: Sequence, draw: Callable[..., np.ndarray], fps: float) -> Path:
    """Write a film of states as GIF or MP4, according to the ending of `path`. Returns the path.

    draw: function of a state that returns its picture, (height, width, 3), uint8. fps: pictures a second. The delays of
    a GIF are multiples of 0.01 s, and players show no delay below 0.02 s. Above 50 pictures a second, a GIF therefore
    leaves states out; its duration stays the same. Raises ValueError for another ending, and for an MP4 without ffmpeg,
    before the first picture is made. Raises OSError, with the output of ffmpeg, if ffmpeg ends early.
    """
    path = Path(path)
    is_known = path.suffix in (".gif", ".mp4")
    expect(is_known, f"path: expected a name that ends in .html, .gif or .mp4, got {str(path)!r}")
    program = None if path.suffix == ".gif" else _ffmpeg()
    hint = "a .gif and an .html need none; `pip install imageio-ffmpeg` brings one"
    can_write = path.suffix == ".gif" or program
    expect(can_write, f"path: expected ffmpeg to be installed for {str(path)!r}, got none; {hint}")
    with replacing(path) as temporary:
        if program:
            _write_mp4(temporary, map(draw, states), fps, program)
        else:
            shown, delays = gif_timing(len(states), fps)
            _write_gif(temporary, (draw(states[i]) for i in shown), delays)
    return path


def gif_timing(count: int, fps: float) -> tuple[list[int], list[int]]:
    """Choose the pictures of a GIF from `count` pictures. Returns their indices, and their delays, ms.

    The sum of the delays differs from the duration count / fps by at most 5 ms.
    """
    end = round(100 * count / fps)
    shown, begins = [0], [0]
    for i in range(1, count):
        begin = round(100 * i / fps)
        if begins[-1] + 2 <= begin <= end - 2:
            shown.append(i)
            begins.append(begin)
    return shown, [10 * (after - before) for before, after in zip(begins, [*begins[1:], end])]


def _write_gif(path: Path, pictures, delays: list[int]) -> None:
    speeds = 255 * colormaps[plotting.COLOUR_MAP](np.linspace(0.0, 1.0, 32))[:, :3]
    palette = Image.new("P", (1, 1))
    colours = np.concatenate([speeds, np.mgrid[:6, :6, :6].reshape(3, -1).T * 51])  # and 216 colours for edges
    palette.putpalette(colours.round().astype(np.uint8).tobytes())
    shown = (Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures)
    next(shown).save(path, save_all=True, append_images=shown, duration=delays, loop=0, optimize=False)


def _ffmpeg() -> str | None:
    """Return the path of the installed ffmpeg, or else of that in the package imageio-ffmpeg.

    Returns None if there is neither.
    """
    found = shutil.which("ffmpeg")
    if found is None:
        with suppress(ImportError, RuntimeError):  # the package lacks a program for some machines
            from imageio_ffmpeg import get_ffmpeg_exe

            found = get_ffmpeg_exe()
    return found


def _write_mp4(path: Path, pictures, fps: float, program: str) -> None:
    first = next(pictures)
    size = f"{first.shape[1]}x{first.shape[0]}"
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"]
    command = [program, "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p", str(path)]
    is_whole = False
    with TemporaryFile() as said:
        # The pipe breaks if ffmpeg ends early. The output and the status of ffmpeg give the reason.
        with suppress(BrokenPipeError), subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said) as ffmpeg:
            for picture in chain([first], pictures):
                ffmpeg.stdin.write(picture.tobytes())
            ffmpeg.stdin.close()
            is_whole = True
        if ffmpeg.returncode == 0 and is_whole:
            return
        said.seek(0)
        words = said.read().decode(errors="replace").replace(str(path), "the film").split("\n")
    status = ffmpeg.returncode
    ended = f"status {status}" if status >= 0 else f"signal {-status} ({signal.strsignal(-status)})"
    why = "; ".join(line.strip() for line in words if line.strip())[-500:] or "it said nothing"
    raise OSError(errno.EIO, f"ffmpeg ended with {ended}: {why}", str(path))
