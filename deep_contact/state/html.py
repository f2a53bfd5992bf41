"""HTML for notebooks: tables, pictures and framed pages.

Tests: tests/plot/test_notebook.py
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

MOST_ROWS = 10
"""Largest number of rows that a table of arrays shows."""


def shown(title: str, rows: Iterable[Sequence], picture: str = "", header: Sequence[str] = ()) -> str:
    """Return HTML of a title, a table, and a picture beside the table.

    rows: (name, value, …) of each row. picture: HTML of the picture, or "". header: names of the columns, or ().
    """
    body = f"<tr>{''.join(f'<th>{escape(name)}</th>' for name in header)}</tr>" if header else ""
    for name, *values in rows:
        cells = "".join(f"<td>{escape(str(value))}</td>" for value in values)
        body += f"<tr><th>{escape(str(name))}</th>{cells}</tr>"
    text = f"<div><b>{escape(title)}</b><table>{body}</table></div>"
    return f'<div style="display:flex;gap:1em;align-items:flex-start">{text}{picture}</div>'


def arrays_shown(title: str, columns: dict[str, np.ndarray]) -> str:
    """Return HTML of a table with a column for each array and a row for each index, cut after `MOST_ROWS` rows.

    columns: name -> array. All arrays have the same length.
    """
    count = len(next(iter(columns.values())))
    rows = [[i, *(_text(column[i]) for column in columns.values())] for i in range(min(count, MOST_ROWS))]
    if count > MOST_ROWS:
        rows.append(["…", f"{count - MOST_ROWS:,} more"])
    return shown(title, rows, header=("", *columns))


def _text(value) -> str:
    return ", ".join(f"{number:.4g}" for number in np.atleast_1d(value).tolist())


def image(kind: str, data: bytes) -> str:
    """Return HTML of a picture. kind: "png" or "gif". data: content of the picture file."""
    return f'<img src="data:image/{kind};base64,{base64.b64encode(data).decode()}">'


def framed(page: str) -> str:
    """Return HTML of a page in a frame, which separates its scripts and styles from those of the notebook."""
    style = "width:100%;height:640px;border:1px solid #c8c8c8"
    return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{escape(page)}"></iframe>'


def counted(number: int, thing: str) -> str:
    """Return a number with its noun, such as "1 contact" or "2,000 contacts"."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"
