"""Display in notebooks: the picture of a state, and objects whose display is updated in place."""

from __future__ import annotations

import sys
from importlib import import_module
from weakref import WeakKeyDictionary

from deep_contact.plot import plotting
from deep_contact.state import html
from deep_contact.state.state import State
from deep_contact.state.validation import expect

MOST_CIRCLES = 5000
"""Largest number of circles in a picture. With more circles, a notebook would take seconds whenever it shows a
state."""


def picture_of(state: State) -> str:
    """Return HTML with a picture of a state's circles and impulses, or "" for more than `MOST_CIRCLES` circles."""
    if state.bodies.count > MOST_CIRCLES:
        return ""
    figure, ax = plotting.subplots(size=(3.0, 3.0))
    plotting.draw_state(ax, state)
    return html.image("png", figure._repr_png_())


_places: WeakKeyDictionary = WeakKeyDictionary()
"""Displayed object -> (execution count of the cell that displays it, handle of the display)."""


def show(shown) -> None:
    """Display an object in a notebook. If the current cell already displays it, the display is updated in place.

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
