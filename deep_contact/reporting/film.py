"""Films of runs: circles and impulses drawn pixel by pixel in compiled code, as a GIF or an MP4.

Matplotlib draws a picture well and a hundred of them slowly; a film needs discs and lines with smooth edges, no more.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numba import njit

from deep_contact.io.files import replacing
from deep_contact.reporting import plotting
from deep_contact.validation import expect

LEVELS = 32
"""Colours of speed in a film, and of each channel of the table that finds the colours of a GIF."""


def check_name(name: str, path) -> str:
    """The ending of a film's name, ".gif" or ".mp4". Raises ValueError for another, and for an MP4 without ffmpeg."""
    from matplotlib import animation

    suffix = Path(path).suffix
    expect(suffix in (".gif", ".mp4"), f"{name}: expected a name that ends in .gif or .mp4, got {str(path)!r}")
    can_write = suffix == ".gif" or animation.writers.is_available("ffmpeg")
    expect(can_write, f"{name}: expected ffmpeg to be installed for {str(path)!r}, found none; a .gif needs none")
    return suffix


class Canvas:
    """Draws states of one world in a picture whose longer side has `size` pixels.

    fastest: speed of the last colour, m/s. strongest: impulse of the widest line, N·s.
    """

    def __init__(self, world, *, size: int, fastest: float, strongest: float):
        from matplotlib import colormaps
        from matplotlib.colors import to_rgb

        x_min, y_min, x_max, y_max = world.box
        self._scale = (size - 16) / max(x_max - x_min, y_max - y_min)
        self._corner = np.array([x_min, y_max])
        # Even sides, as films in colours of half the resolution need.
        width, height = (2 * math.ceil((self._scale * side + 16) / 2) for side in (x_max - x_min, y_max - y_min))
        self._map = 255.0 * colormaps[plotting.COLOUR_MAP](np.linspace(0.0, 1.0, LEVELS))[:, :3]
        self._dark, self._red = (255.0 * np.array(to_rgb(name)) for name in ("#333333", plotting.VERMILION))
        self._fastest, self._strongest = fastest, strongest
        self._empty = np.full((height, width, 3), 255.0, np.float32)
        corners = [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]
        walls = [*zip(corners, corners[1:] + corners[:1]), *np.reshape(world.segments, (-1, 2, 2))]
        self._lines(self._empty, np.array(walls), np.full(len(walls), 2.0), self._dark)

    def __call__(self, state) -> np.ndarray:
        """The picture of a state, (height, width, 3), uint8."""
        image, bodies, contacts = self._empty.copy(), state.bodies, state.contacts
        speed = np.hypot(*bodies.velocity.T) / (self._fastest or 1.0)
        level = np.minimum(speed * LEVELS, LEVELS - 1).astype(np.int64)
        draw_discs(image, self._pixels(bodies.position), self._scale * bodies.radius, self._map[level], self._dark)
        heading = bodies.radius[:, None] * np.column_stack([np.cos(bodies.angle), np.sin(bodies.angle)])
        ticks = np.stack([bodies.position + 0.5 * heading, bodies.position + 0.9 * heading], axis=1)
        bright = self._map[level] @ np.array([0.299, 0.587, 0.114]) > 127
        self._lines(image, ticks, np.full(len(ticks), 1.2), np.where(bright, 34.0, 255.0)[:, None])
        ends = contacts.position.copy()
        between = contacts.body_b < bodies.count
        ends[between] = bodies.position[contacts.body_b[between]]
        chains = np.stack([bodies.position[contacts.body_a], ends], axis=1)
        width = 0.5 + 7.5 * np.minimum(contacts.normal_impulse / (self._strongest or 1.0), 1.0)
        self._lines(image, chains, width + 1.5, np.full(3, 255.0))
        self._lines(image, chains, width, self._red)
        return image.astype(np.uint8)

    def _pixels(self, points: np.ndarray) -> np.ndarray:
        return (points - self._corner) * (self._scale, -self._scale) + 8.0

    def _lines(self, image, lines, width, colour) -> None:
        draw_lines(image, self._pixels(lines), width, np.broadcast_to(colour, (len(lines), 3)).copy())


@njit(cache=True, error_model="numpy", fastmath=True)
def draw_discs(image, centre, radius, colour, edge):
    """Draw discs with an edge of one pixel, in place. centre: (n, 2), pixels. colour: (n, 3). edge: (3,)."""
    for i in range(radius.shape[0]):
        (x, y), r = centre[i], radius[i]
        rows, columns = _range(y - r, y + r, image.shape[0]), _range(x - r, x + r, image.shape[1])
        for row in range(rows[0], rows[1]):
            for column in range(columns[0], columns[1]):
                square = (column - x) * (column - x) + (row - y) * (row - y)
                if square >= (r + 0.5) * (r + 0.5):
                    continue
                d = math.sqrt(square)
                inside, whole = min(max(r - 0.5 - d, 0.0), 1.0), min(max(r + 0.5 - d, 0.0), 1.0)
                for k in range(3):
                    shade = inside * colour[i, k] + (1.0 - inside) * edge[k]
                    image[row, column, k] += whole * (shade - image[row, column, k])


@njit(cache=True, error_model="numpy", fastmath=True)
def draw_lines(image, line, width, colour):
    """Draw lines with round ends, in place. line: (m, 2, 2), pixels. width: (m,), pixels. colour: (m, 3)."""
    for i in range(width.shape[0]):
        (x, y), half = line[i, 0], 0.5 * width[i]
        e_x, e_y = line[i, 1, 0] - x, line[i, 1, 1] - y
        square = e_x * e_x + e_y * e_y
        rows = _range(min(y, y + e_y) - half, max(y, y + e_y) + half, image.shape[0])
        columns = _range(min(x, x + e_x) - half, max(x, x + e_x) + half, image.shape[1])
        for row in range(rows[0], rows[1]):
            for column in range(columns[0], columns[1]):
                share = ((column - x) * e_x + (row - y) * e_y) / square if square > 0.0 else 0.0
                share = min(max(share, 0.0), 1.0)
                d_x, d_y = column - x - share * e_x, row - y - share * e_y
                if d_x * d_x + d_y * d_y >= (half + 0.5) * (half + 0.5):
                    continue
                cover = min(half + 0.5 - math.sqrt(d_x * d_x + d_y * d_y), 1.0)
                for k in range(3):
                    image[row, column, k] += cover * (colour[i, k] - image[row, column, k])


@njit(cache=True)
def _range(low, high, size):
    """The pixels from one below `low` to one beyond `high`, of so many."""
    return int(min(max(low - 1.0, 0.0), size)), int(min(max(high + 2.0, 0.0), size))


def write_film(path, pictures: Iterable[np.ndarray], fps: float) -> Path:
    """Write pictures, (height, width, 3), uint8, as a GIF or an MP4, by the ending of its name. Returns the path."""
    suffix, path = check_name("path", path), Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        (_write_gif if suffix == ".gif" else _write_mp4)(temporary, iter(pictures), fps)
    return path


def _write_gif(path: Path, pictures, fps: float) -> None:
    from matplotlib import colormaps
    from PIL import Image

    speeds = 255 * colormaps[plotting.COLOUR_MAP](np.linspace(0.0, 1.0, LEVELS))[:, :3]
    palette = np.concatenate([speeds, np.mgrid[:6, :6, :6].reshape(3, -1).T * 51]).round()  # and what edges need
    shades = (np.mgrid[:32, :32, :32].reshape(3, -1).T * 8 + 4).astype(float)
    nearest = ((palette**2).sum(axis=1) - 2 * shades @ palette.T).argmin(axis=1).astype(np.uint8)

    def frame(picture: np.ndarray):
        red, green, blue = (picture[..., k].astype(np.uint16) >> 3 for k in range(3))
        shown = Image.fromarray(nearest[(red << 10) | (green << 5) | blue])
        shown.putpalette(palette.astype(np.uint8).tobytes())
        return shown

    first, *others = map(frame, pictures)
    first.save(path, save_all=True, append_images=others, duration=1000 / fps, loop=0, optimize=False)


def _write_mp4(path: Path, pictures, fps: float) -> None:
    from matplotlib import animation

    first = next(pictures)
    size = f"{first.shape[1]}x{first.shape[0]}"
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-"]
    command = [animation.FFMpegWriter.bin_path(), "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p", str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as ffmpeg:
        for picture in (first, *pictures):
            ffmpeg.stdin.write(picture.tobytes())
    expect(ffmpeg.returncode == 0, f"path: expected ffmpeg to write {str(path)!r}, it ended with {ffmpeg.returncode}")
