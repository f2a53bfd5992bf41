"""Pictures and tables of chapter 6 show what their numbers say: prices, units, ends of axes, one colour a thing."""

import pytest
from conftest import load_script

from deep_contact.figures import results
from deep_contact.studies import runs


def drawn(id):
    """(Script, its stored data, its picture)."""
    script = load_script(f"figure_{id.replace('.', '_')}")
    stored = results.reference(f"figure_{id.replace('.', '_')}")
    return script, stored["data"], script.draw(stored["data"], stored["options"])


def test_the_time_step_s_picture_ends_above_the_step_that_is_taken_for_the_truth():
    script, data, picture = drawn("6.2")
    assert any(script.is_below(row) for row in data["rows"])
    shown = [x for ax in picture.axes for one in ax.containers for x in one.lines[0].get_xdata()]
    assert min(shown) > runs.REFERENCE["dt"]


@pytest.mark.parametrize("row", ["asleep: a step", "islands, thesis scene: time", "job: import"])
def test_what_is_saved_has_a_unit_of_its_size(row):
    script, data, _ = drawn("6.7")
    head, *rows = script.table(data)
    found = dict(zip(head, next(cells for cells in rows if str(cells[0]).startswith(row))))
    assert found["unit"] in ("µs", "ms", "s")
    assert 1e-3 < found["special"] < 1e3
