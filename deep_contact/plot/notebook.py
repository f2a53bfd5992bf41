"""Pictures in a notebook: of a state, and of what is drawn anew in its place."""

from __future__ import annotations

import sys
from importlib import import_module
from weakref import WeakKeyDictionary

from deep_contact.plot import plotting
from deep_contact.state import html
from deep_contact.state.state import State
from deep_contact.state.validation import expect

MOST_CIRCLES = 5000
"""Of more circles no picture is made: it would take seconds each time that a notebook shows a state."""


def picture_of(state: State) -> str:
    """HTML of a picture of circles and impulses; "" of more than `MOST_CIRCLES` circles."""
    if state.bodies.count > MOST_CIRCLES:
        return ""
    figure, ax = plotting.subplots(size=(3.0, 3.0))
    plotting.draw_state(ax, state)
    return html.image("png", figure._repr_png_())


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
