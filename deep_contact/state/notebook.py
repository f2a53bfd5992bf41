"""How notebooks show things: a small table, and a picture of circles as inline SVG. No plotting package is needed."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

WIDTH = 260
"""Of a picture, pixels; its height is at most twice that."""

MOST_CIRCLES = 5000
"""A notebook keeps its pictures: of more circles none is made."""


def shown(title: str, rows: Mapping[str, object], picture: str = "") -> str:
    """HTML of a title, a table of names and values, and a picture beside it."""
    body = "".join(f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows.items())
    text = f"<div><b>{escape(title)}</b><table>{body}</table></div>"
    return f'<div style="display:flex;gap:1em;align-items:flex-start">{text}{picture}</div>'


def picture_of(
    box, position: np.ndarray, radius: np.ndarray, lines: np.ndarray, strength: np.ndarray, segments=()
) -> str:
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
        circles = np.column_stack([on_screen(position).reshape(-1, 2), scale * np.asarray(radius)])
        ends = on_screen(lines).reshape(-1, 4)
        widths = 0.3 + 3.0 * np.asarray(strength) / max(float(np.max(strength, initial=0.0)), 1e-300)
    parts = [
        f'<svg width="{width + 2:.0f}" height="{height + 2:.0f}" viewBox="-1 -1 {width + 2:.0f} {height + 2:.0f}">',
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="none" stroke="currentColor"/>',
        *(
            f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="currentColor"/>'
            for x1, y1, x2, y2 in on_screen(np.reshape(segments, (-1, 2, 2))).reshape(-1, 4)
        ),
        '<g fill="#CFE6F5" stroke="#333333" stroke-width="0.5">',
        *(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r:.1f}"/>' for x, y, r in circles[np.isfinite(circles).all(axis=1)]),
        '</g><g stroke="#D55E00">',
    ]
    kept = np.isfinite(ends).all(axis=1) & np.isfinite(widths)
    for (x1, y1, x2, y2), thick in zip(ends[kept], widths[kept]):
        line = f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke-width="{thick:.1f}"/>'
        parts.append(line)
    return "".join([*parts, "</g></svg>"])


def counted(number: int, thing: str) -> str:
    """1 contact, 2,000 contacts."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"
