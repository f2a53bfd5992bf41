"""HTML of what notebooks show: tables, pictures and pages."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

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


def image(kind: str, data: bytes) -> str:
    """HTML of a picture from its bytes. kind: "png" or "gif"."""
    return f'<img src="data:image/{kind};base64,{base64.b64encode(data).decode()}">'


def framed(page: str) -> str:
    """HTML of a page in a frame of its own: its scripts and styles do not meet those of the notebook."""
    style = "width:100%;height:640px;border:1px solid #c8c8c8"
    return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{escape(page)}"></iframe>'


def counted(number: int, thing: str) -> str:
    """1 contact, 2,000 contacts."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"
