"""Films of runs: circles and impulses drawn by Pillow, as a GIF or an MP4.

Matplotlib draws a picture well and a hundred of them slowly; a film needs discs and lines with smooth edges, no more.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib import animation, colormaps
from PIL import Image, ImageDraw

from deep_contact.io.files import replacing
from deep_contact.reporting import plotting
from deep_contact.state import contact_lines
from deep_contact.validation import expect

FINE = 3
"""A picture is drawn so many times as large, and made smaller: that smooths the edges."""

DARK = "#333333"


class Canvas:
    """Draws states of one world in a picture whose longer side has `size` pixels.

    fastest: speed of the last colour, m/s. strongest: impulse of the widest line, N·s.
    """

    def __init__(self, world, *, size: int, fastest: float, strongest: float):
        x_min, y_min, x_max, y_max = world.box
        sides = x_max - x_min, y_max - y_min
        self._scale, self._corner = (size - 16) / max(sides), np.array([x_min, y_max])
        self._fastest, self._strongest = fastest or 1.0, strongest or 1.0
        # Even sides, as films in colours of half the resolution need.
        shape = [2 * FINE * math.ceil((self._scale * side + 16) / 2) for side in sides]
        self._empty = Image.new("RGB", shape, "white")
        corners = [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]
        walls = [*zip(corners, corners[1:] + corners[:1]), *np.reshape(world.segments, (-1, 2, 2))]
        self._draw_lines(self._empty, np.array(walls), np.full(len(walls), 2.0), [DARK] * len(walls))

    def __call__(self, state) -> np.ndarray:
        """The picture of a state, (height, width, 3), uint8."""
        image, (centre, *_, radius) = self._empty.copy(), state.bodies
        colours = colormaps[plotting.COLOUR_MAP](np.hypot(*state.bodies.velocity.T) / self._fastest)
        disc, reach = ImageDraw.Draw(image).ellipse, FINE * self._scale * radius[:, None]
        boxes, fills = np.hstack([self._pixels(centre) - reach, self._pixels(centre) + reach]), 255 * colours[:, :3]
        for box, fill in zip(boxes.tolist(), fills.astype(int).tolist()):
            disc(box, tuple(fill), DARK, FINE)
        ticks, chains = plotting.ticks(state.bodies), contact_lines(state)
        self._draw_lines(image, ticks, np.full(len(ticks), 1.2), plotting.readable_on(colours).tolist())
        width = 0.5 + 7.5 * np.minimum(state.contacts.normal_impulse / self._strongest, 1.0)
        self._draw_lines(image, chains, width + 1.5, ["white"] * len(chains))
        self._draw_lines(image, chains, width, [plotting.VERMILION] * len(chains))
        return np.asarray(image.reduce(FINE))

    def _pixels(self, points: np.ndarray) -> np.ndarray:
        return FINE * ((points - self._corner) * (self._scale, -self._scale) + 8.0)

    def _draw_lines(self, image, lines: np.ndarray, widths: np.ndarray, colours: list[str]) -> None:
        """Lines with round ends. lines: (m, 2, 2), m. widths: (m,), pixels."""
        draw = ImageDraw.Draw(image)
        for ends, width, colour in zip(self._pixels(lines).tolist(), (FINE * widths).tolist(), colours):
            draw.line([*map(tuple, ends)], colour, round(width))
            for x, y in ends if width > 2 * FINE else ():
                draw.ellipse((x - width / 2, y - width / 2, x + width / 2, y + width / 2), colour)


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
