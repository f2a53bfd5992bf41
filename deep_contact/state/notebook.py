"""How notebooks show things: tables, and circles as inline SVG. No plotting package is needed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

WIDTH = 260
"""Of a picture, pixels; its height is at most twice that."""

MOST_CIRCLES = 5000
"""Of more circles no picture is made: a notebook keeps its pictures."""

MOST_ROWS = 10
"""Most rows of a table of arrays."""


def shown(title: str, rows: Iterable[Sequence], picture: str = "", header: Sequence[str] = ()) -> str:
    """HTML of a title, a table, and a picture beside it. rows: a name and values each. header: of the columns."""
    body = f"<tr>{''.join(f'<th>{escape(name)}</th>' for name in header)}</tr>" if header else ""
    for name, *values in rows:
        cells = "".join(f"<td>{escape(str(value))}</td>" for value in values)
        body += f"<tr><th>{escape(str(name))}</th>{cells}</tr>"
    text = f"<div><b>{escape(title)}</b><table>{body}</table></div>"
    return f'<div style="display:flex;gap:1em;align-items:flex-start">{text}{picture}</div>'


def arrays_shown(title: str, columns: dict[str, np.ndarray]) -> str:
    """HTML of the first rows of arrays of one length, as a table of their names and numbers."""
    count = len(next(iter(columns.values())))
    rows = [[i, *(_text(column[i]) for column in columns.values())] for i in range(min(count, MOST_ROWS))]
    if count > MOST_ROWS:
        rows.append(["…", f"{count - MOST_ROWS:,} more"])
    return shown(title, rows, header=("", *columns))


def _text(value) -> str:
    return ", ".join(f"{number:.4g}" for number in np.atleast_1d(value).tolist())


def picture_of(box, position: np.ndarray, radius, lines=(), strength=(), segments=()) -> str:
    """SVG of circles in their box, and of lines over them.

    box: (x_min, y_min, x_max, y_max), m. position: (n, 2), m. radius: (n,), m. lines: start and end, (m, 2, 2), m.
    strength: of each line, (m,); the width is proportional to it. segments: static ones, (x_0, y_0, x_1, y_1) each, m.
    What is not finite is left out. Empty for more than `MOST_CIRCLES` circles.
    """
    if len(radius) > MOST_CIRCLES:
        return ""
    x_min, y_min, x_max, y_max = box
    scale = WIDTH / max(x_max - x_min, 0.5 * (y_max - y_min))
    width, height = scale * (x_max - x_min), scale * (y_max - y_min)

    def on_screen(points):
        return (np.asarray(points) - (x_min, y_max)) * (scale, -scale)

    with np.errstate(over="ignore", invalid="ignore"):
        places, r = on_screen(position), scale * np.asarray(radius)
        ends = on_screen(np.reshape(lines, (-1, 2, 2))).reshape(-1, 4)
        widths = 0.3 + 3.0 * np.asarray(strength) / max(float(np.max(strength, initial=0.0)), 1e-300)
    seen = np.isfinite(places).all(axis=1) & np.isfinite(r)
    kept = np.isfinite(ends).all(axis=1) & np.isfinite(widths)
    stroke = 'stroke="currentColor"'
    return "".join((
        f'<svg width="{width + 2:.0f}" height="{height + 2:.0f}" viewBox="-1 -1 {width + 2:.0f} {height + 2:.0f}">',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="none" {stroke}/>',
        *(_line(end, stroke) for end in on_screen(np.reshape(segments, (-1, 2, 2))).reshape(-1, 4)),
        '<g fill="#CFE6F5" stroke="#333333" stroke-width="0.5">',
        *('<circle cx="{:.1f}" cy="{:.1f}" r="{:.1f}"/>'.format(*places[i], r[i]) for i in np.flatnonzero(seen)),
        '</g><g stroke="#D55E00">',
        *(_line(end, f'stroke-width="{thick:.1f}"') for end, thick in zip(ends[kept], widths[kept])),
        "</g></svg>",
    ))  # fmt: skip


def _line(end: np.ndarray, stroke: str) -> str:
    return '<line x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}" {}/>'.format(*end, stroke)


def counted(number: int, thing: str) -> str:
    """1 contact, 2,000 contacts."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"
