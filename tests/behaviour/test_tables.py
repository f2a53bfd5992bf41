"""Tables of circles, contacts and runs: columns that pandas and polars take."""

import numpy as np
import pytest

import deep_contact as dc

RUN = dc.simulate(dc.column(3), steps=4, record=2)


def test_columns_are_what_the_arrays_hold():
    bodies, contacts = RUN.state.bodies, RUN.state.contacts
    table = bodies.table()
    assert list(table) == ["x", "y", "v_x", "v_y", "angle", "spin", "mass", "radius"]
    np.testing.assert_array_equal(np.column_stack([table["x"], table["y"]]), bodies.position)
    np.testing.assert_array_equal(np.column_stack([table["v_x"], table["v_y"]]), bodies.velocity)
    for name in ("angle", "spin", "mass", "radius"):
        np.testing.assert_array_equal(table[name], getattr(bodies, name))
    table = contacts.table()
    np.testing.assert_array_equal(np.column_stack([table["x"], table["y"]]), contacts.position)
    np.testing.assert_array_equal(np.column_stack([table["n_x"], table["n_y"]]), contacts.normal)
    for name in ("body_a", "body_b", *contacts._fields[4:]):
        np.testing.assert_array_equal(table[name], getattr(contacts, name))


def test_a_run_has_a_row_for_each_circle_at_each_time():
    table = RUN.trajectory.table()
    for k, state in enumerate(RUN.trajectory):
        mine = slice(3 * k, 3 * k + 3)
        assert set(table["time"][mine]) == {state.time}
        assert table["circle"][mine].tolist() == [0, 1, 2]
        for name, column in state.bodies.table().items():
            np.testing.assert_array_equal(table[name][mine], column)
    assert {len(column) for column in table.values()} == {9}


def test_pandas_takes_them():
    pandas = pytest.importorskip("pandas")
    for table in (RUN.state.bodies.table(), RUN.state.contacts.table(), RUN.trajectory.table()):
        frame = pandas.DataFrame(table)
        assert list(frame.columns) == list(table)
        assert len(frame) == len(next(iter(table.values())))
