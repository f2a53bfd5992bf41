"""How notebooks show things: tables, and pictures beside them."""

from __future__ import annotations

import base64
import sys
from collections.abc import Iterable, Sequence
from html import escape
from importlib import import_module
from weakref import WeakKeyDictionary

import numpy as np

from deep_contact.validation import expect

MOST_CIRCLES = 5000
"""Of more circles no picture is made: it would take seconds each time that a notebook shows a state."""

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


_places: WeakKeyDictionary = WeakKeyDictionary()
"""What is shown live -> the run of a cell, and its place there."""


def show(shown) -> None:
    """Show something in a notebook, or draw it anew in its place if this cell shows it already.

    Raises ValueError outside of a notebook.
    """
    found = sys.modules.get("IPython")
    shell = found.get_ipython() if found else None
    expect(
        shell is not None, "show: expected a notebook, or an IPython shell, got none; `dc.film` makes a page or a film"
    )
    cell, place = _places.get(shown, (None, None))
    if place is None or cell != shell.execution_count:
        _places[shown] = shell.execution_count, import_module("IPython.display").display(shown, display_id=True)
    else:
        place.update(shown)


def counted(number: int, thing: str) -> str:
    """1 contact, 2,000 contacts."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"
