"""How much of its impulses a motion determines: widths, errors and percentiles of known intervals."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import circles_at, load_script

import deep_contact as dc
from deep_contact.analysis.bounds import ForceBounds
from deep_contact.stepping.problem import ContactSolution

determinacy = load_script("figure_6_15")

SEED = 5
"""Draws two of three contacts that do not rise."""


@pytest.fixture
def measured(monkeypatch):
    """What is measured of three circles on the floor whose exact impulses are 1, 2 and 3, and what was bounded."""
    state = dc.find_contacts(circles_at([[5.0, 1.0], [9.0, 1.0], [13.0, 1.0]]))
    solution = ContactSolution(np.arange(1.0, 4.0), np.full(3, 0.5), np.array([[0.1, -0.3]]), np.zeros(1), None)
    seen = []

    def force_bounds(state, contacts):
        seen.append((state, contacts))
        return ForceBounds(np.array([[0.0, 4.0], [2.0, 3.0]]), np.zeros((2, 2)), 0.0)

    monkeypatch.setattr(determinacy, "force_bounds", force_bounds)
    monkeypatch.setattr(determinacy, "solve_exactly", lambda past: SimpleNamespace(converged=True, solution=solution))
    return determinacy.measure(state, 2, SEED, []), *seen[0]


def test_widths_are_those_of_drawn_contacts_over_the_mean_impulse(measured):
    found, state, contacts = measured
    assert found["widths"].tolist() == [2.0, 0.5]
    assert (found["exact"], found["fastest"]) == (True, 0.3)
    assert len(set(contacts)) == 2
    assert list(contacts) == sorted(contacts)
    assert state.solved
    np.testing.assert_array_equal(state.contacts.normal_impulse, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(state.contacts.tangent_impulse, 0.5)


def test_a_pile_without_an_exact_motion_has_no_widths(monkeypatch):
    monkeypatch.setattr(determinacy, "solve_exactly", lambda past: SimpleNamespace(converged=False))
    assert determinacy.measure(None, 2, 0, []) == {"exact": False}


@pytest.mark.parametrize(
    ("kind", "speeds", "steps"),
    [("settling", [], [50, 1]), ("resting", [1.0, 9e-4], [50, 50, 50]), ("resting", [1.0] * 20, [50] * 21),
     ("thesis", [0.0], [600, 50])],
)  # fmt: skip
def test_a_packing_settles_for_51_steps_or_until_it_rests(kind, speeds, steps, monkeypatch):
    done, left = [], iter(speeds)
    run = lambda state, *, steps, solver: done.append(steps) or SimpleNamespace(state=state)  # noqa: E731
    monkeypatch.setattr(determinacy, "simulate", run)
    monkeypatch.setattr(determinacy.piles, "rms_speed_of_state", lambda state: next(left))
    determinacy.packed(kind, 5, 0.5, 0.8, 1)
    assert done == steps


def pile(widths, *, friction=0.5, kind="resting", exact=True, **errors):
    about = {"kind": kind, "n_bodies": 30, "friction": friction, "smallest": 0.8}
    return about | {"exact": exact, "widths": widths, "errors": errors}


def test_claims_are_about_the_median_of_piles():
    """Of four contacts the third and the last count; an open end is none in JSON; what is not exact is left out."""
    ends = [0.0, 1.0, 2.0, None]
    piles = [pile(ends), pile(ends[::-1]), pile([0.0] * 4), pile([9.0] * 4, exact=False)]
    assert determinacy.widths({"piles": piles}, ("resting", 30, 0.5, 0.8)).tolist() == [
        [2.0, np.inf],
        [2.0, np.inf],
        [0.0, 0.0],
    ]
    starts = {"Builtin": [0.0, 0.0], "PGS from zero": [0.1, 0.5], "NNCG from zero": [0.3, 0.5]}
    smooth = [pile([0.0, 0.0, 0.0, width], friction=0.0) for width in (1e-9, 1e-7, 1e-3)]
    data = {"piles": [*piles, *smooth, pile([0.0], kind="settling"), pile([4.0], **starts)]}
    determined, open_, far = determinacy.claims(data)
    assert (determined.holds, determined.measured) == (True, {"width": pytest.approx(1e-7)})
    assert open_.holds
    assert far.holds
    narrow, near = determinacy.claims({"piles": [pile([0.4], **{"PGS from zero": [0.09, 0.5]})]})
    assert [narrow.holds, near.holds] == [False, False]
