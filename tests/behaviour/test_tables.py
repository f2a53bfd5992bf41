"""Tables of circles, contacts and runs: columns that pandas and polars take."""

import runpy
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import ROOT

import deep_contact as dc

RUN = dc.simulate(dc.column(3), steps=4, record=2)


def test_columns_are_what_the_arrays_hold():
    bodies, contacts = RUN.state.bodies, RUN.state.contacts
    table = bodies.table()
    assert list(table) == ["x", "y", "v_x", "v_y", "angle", "spin", "mass", "radius", "material"]
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


def test_the_collection_for_paraview_has_a_file_and_a_time_for_each_state(tmp_path, monkeypatch):
    """The program of the gallery; meshio reads its files, and the times are to the last bit."""
    pytest.importorskip("pandas")
    meshio = pytest.importorskip("meshio")
    monkeypatch.chdir(tmp_path)
    trajectory = runpy.run_path(str(ROOT / "docs" / "gallery" / "other_programs.py"))["run"].trajectory
    collection = ElementTree.parse("run.pvd").getroot()
    assert (collection.tag, collection.attrib["type"]) == ("VTKFile", "Collection")
    listed = [one.attrib for one in collection.findall("Collection/DataSet")]
    assert [float(one["timestep"]) for one in listed] == trajectory.times.tolist()
    assert len(set(trajectory.times)) == len(listed) > 5
    for one, state in zip(listed, trajectory):
        read = meshio.read(one["file"])
        np.testing.assert_array_equal(read.points[:, :2], state.bodies.position)
        for name, column in state.bodies.table().items():
            np.testing.assert_array_equal(read.point_data[name], column)


def test_docstrings_say_what_pandas_takes():
    """`pandas.DataFrame(bodies)` raises pandas's own message, which names no way; of contacts it has a row a field."""
    pandas = pytest.importorskip("pandas")
    bodies, contacts = RUN.state.bodies, RUN.state.contacts
    with pytest.raises(ValueError):  # noqa: PT011
        pandas.DataFrame(bodies)
    assert len(pandas.DataFrame(contacts)) == len(contacts) > contacts.count
    assert "`pandas.DataFrame(bodies.table())` has a row for each circle" in type(bodies).__doc__
    assert "`pandas.DataFrame(contacts.table())` has a row for each contact" in type(contacts).__doc__
