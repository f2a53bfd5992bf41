"""The contacts of a state as a table, and as a CSV file.

Tests: tests/io/test_files.py
"""

from __future__ import annotations

import numpy as np

from deep_contact.analysis.contact_forces import forces, name_of
from deep_contact.io.files import replacing
from deep_contact.state.state import State
from deep_contact.stepping.prepare import ready


def contact_table(state: State, path=None) -> np.ndarray:
    """Return the contacts of a state as a structured array, one row a contact, which `pandas.DataFrame` accepts.

    Columns: a, the index of the first circle; b, the name of the second body: the index of a circle, "floor" … or
    "segment 3"; x, y, the contact point, m; n_x, n_y, the unit normal from a to b; separation, m; normal_impulse,
    tangent_impulse, N·s; force_x, force_y, the force on b, N. path: a CSV file to which the table is written too.
    Raises OSError if the file cannot be written.
    """
    state, force = ready(state, of_step=True), forces(state).contact
    c = state.contacts
    names = [str(name_of(state, body)) for body in c.body_b]
    numbers = [*c.position.T, *c.normal.T, c.separation, c.normal_impulse, c.tangent_impulse, *force.T]
    columns = "x y n_x n_y separation normal_impulse tangent_impulse force_x force_y".split()
    kinds = [("a", int), ("b", "U32"), *((name, float) for name in columns)]
    table = np.array([*zip(c.body_a, names, *numbers)], dtype=kinds)
    if path is not None:
        with replacing(path) as temporary:
            np.savetxt(temporary, table, "%s", ",", header=",".join(table.dtype.names), comments="", encoding="utf-8")
    return table
