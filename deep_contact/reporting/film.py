"""Films of runs: pictures of `plotting.draw_state`, as a GIF or an MP4."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib import animation, colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from deep_contact.io.files import replacing
from deep_contact.reporting import plotting
from deep_contact.validation import expect

MARGIN = 8
"""Around the box, pixels."""


class Canvas:
    """Draws states of one world in a picture whose longer side has `size` pixels.

    fastest: speed of the last colour, m/s. strongest: impulse of the widest line, N·s.
    """

    def __init__(self, world, *, size: int, fastest: float, strongest: float):
        x_min, y_min, x_max, y_max = world.box
        sides = x_max - x_min, y_max - y_min
        pixel, self._limits = max(sides) / (size - 2 * MARGIN), {"limits": (0.0, fastest), "largest_impulse": strongest}
        # Even sides, as films in colours of half the resolution need.
        width, height = (2 * math.ceil((side / pixel + 2 * MARGIN) / 2) for side in sides)
        figure = Figure(figsize=(width / plotting.DPI, height / plotting.DPI), dpi=plotting.DPI)
        self._canvas, self._ax = FigureCanvasAgg(figure), figure.add_axes((0.0, 0.0, 1.0, 1.0))
        left, top = x_min - MARGIN * pixel, y_max + MARGIN * pixel
        self._place = {"xlim": (left, left + width * pixel), "ylim": (top - height * pixel, top)}

    def __call__(self, state) -> np.ndarray:
        """The picture of a state, (height, width, 3), uint8."""
        self._ax.clear()
        plotting.draw_state(self._ax, state, **self._limits)
        self._ax.set(**self._place, aspect="auto")
        self._ax.axis("off")
        self._canvas.draw()
        return np.array(self._canvas.buffer_rgba())[:, :, :3]


def write_film(path, pictures: Iterable[np.ndarray], fps: float) -> Path:
    """Write pictures, (height, width, 3), uint8, as a GIF or an MP4, by the ending of its name. Returns the path.

    Raises ValueError for another ending, and for an MP4 without ffmpeg, before the first picture is made.
    """
    path = Path(path)
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    expect(path.suffix in writers, f"path: expected a name that ends in .gif or .mp4, got {str(path)!r}")
    can_write = path.suffix == ".gif" or animation.writers.is_available("ffmpeg")
    expect(can_write, f"path: expected ffmpeg to be installed for {str(path)!r}, got none; a .gif needs none")
    with replacing(path) as temporary:
        writers[path.suffix](temporary, iter(pictures), fps)
    return path


def _write_gif(path: Path, pictures, fps: float) -> None:
    speeds = 255 * colormaps[plotting.COLOUR_MAP](np.linspace(0.0, 1.0, 32))[:, :3]
    palette = Image.new("P", (1, 1))
    colours = np.concatenate([speeds, np.mgrid[:6, :6, :6].reshape(3, -1).T * 51])  # and what edges need
    palette.putpalette(colours.round().astype(np.uint8).tobytes())
    shown = (Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures)
    next(shown).save(path, save_all=True, append_images=shown, duration=1000 / fps, loop=0, optimize=False)


def _write_mp4(path: Path, pictures, fps: float) -> None:
    first = next(pictures)
    size = f"{first.shape[1]}x{first.shape[0]}"
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"]
    command = [animation.FFMpegWriter.bin_path(), "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as ffmpeg:
        for picture in (first, *pictures):
            ffmpeg.stdin.write(picture.tobytes())
    expect(ffmpeg.returncode == 0, f"path: expected ffmpeg to write {str(path)!r}, it ended with {ffmpeg.returncode}")
