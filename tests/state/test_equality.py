"""`==` and `in` of states and of all results: "the same bits" is a promise that people test with them."""

import copy
import pickle
from dataclasses import fields, is_dataclass
from functools import cache

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.analysis.lcp import contact_problem
from deep_contact.measure.errors import observe
from deep_contact.measure.trade import load_trade
from deep_contact.state.equality import same

SCENE = dc.column(3)
RUN = dc.simulate(SCENE, steps=20, record=1, forces=True)


def results():
    """Name -> a function that makes a result anew."""
    return {
        "State": lambda: dc.simulate(SCENE, steps=20).state,
        "Bodies": lambda: dc.column(3).bodies,
        "Contacts": lambda: dc.simulate(SCENE, steps=20).state.contacts,
        "World": lambda: dc.drum(5).world,
        "Simulation": lambda: dc.simulate(SCENE, steps=20, record=1, forces=True),
        "Trajectory": lambda: dc.simulate(SCENE, steps=20, record=5).trajectory,
        "ContactSolution": lambda: dc.solve_contacts(RUN.state),
        "ConvergenceRecord": lambda: dc.solve_contacts(RUN.state).record,
        "ExactSolution": lambda: dc.solve_exactly(RUN.state),
        "ContactProblem": lambda: contact_problem(RUN.state),
        "Forces": lambda: dc.forces(RUN.state),
        "ForceBounds": lambda: dc.force_bounds(RUN.state, [0, 1]),
        "Recommendation": lambda: dc.recommend(RUN.state),
        "Plan": lambda: dc.plan(RUN.state),
        "Observation": lambda: observe(RUN.trajectory),
        "LearnedModel": lambda: dc.load_model(),
        "FarFieldModel": lambda: dc.load_model("far field"),
    }


@cache
def result(name):
    """A result made once, and not when tests are collected: a network makes TensorFlow keep its number of threads."""
    return results()[name]()


def altered(value):
    """Copies of a value, each with one number of one array changed, as far down as there are arrays."""
    if isinstance(value, np.ndarray):
        if value.size and value.dtype.kind in "iuf":
            other = value.copy()
            other.flat[-1] = other.flat[-1] == 0
            yield other
    elif isinstance(value, dict):
        yield from ({**value, key: other} for key, item in value.items() for other in altered(item))
    elif isinstance(value, list):
        yield from (list(other) for other in altered(tuple(value)))
    elif isinstance(value, tuple):
        for k, item in enumerate(value):
            for other in altered(item):
                parts = (*value[:k], other, *value[k + 1 :])
                yield type(value)(*parts) if hasattr(value, "_fields") else parts
    elif is_dataclass(value):
        for field in fields(value):
            for other in altered(getattr(value, field.name)) if field.compare else ():
                changed = copy.copy(value)
                vars(changed)[field.name] = other
                yield changed


@pytest.mark.parametrize("name", results())
def test_a_result_equals_what_is_made_anew_and_a_copy_and_nothing_else(name):
    first = result(name)
    assert first == first
    for other in (results()[name](), pickle.loads(pickle.dumps(first)), copy.deepcopy(first)):
        assert (first == other) is True
        assert (first != other) is False
        assert other in [None, "text", first]
        assert [other, first].index(first) == 0
    for other in (None, 3, "text", (), *(result(key) for key in results() if key != name)):
        assert (first == other) is False
        assert (first != other) is True


@pytest.mark.parametrize("name", sorted({*results()} - {"World", "Recommendation", "Plan", "LearnedModel"}))
def test_one_number_of_one_array_makes_a_result_another(name):
    others = list(altered(result(name)))
    assert len(others) >= (1 if name == "ConvergenceRecord" else 2)
    for other in others:
        assert (result(name) == other) is False
        assert result(name) not in [other]


def test_one_weight_makes_a_network_of_keras_another():
    first = result("LearnedModel")
    other = copy.deepcopy(first)
    weights = other.network.get_weights()
    weights[3].flat[-1] += 1.0
    other.network.set_weights(weights)
    assert other != first


def test_nan_equals_nan_and_no_number():
    theta = RUN.theta.copy()
    theta[0] = np.nan
    assert RUN._replace(theta=theta) == RUN._replace(theta=theta.copy())
    assert RUN._replace(theta=theta) != RUN
    assert same({"a": float("nan"), "b": [np.float64("nan")]}, {"a": float("nan"), "b": [np.float64("nan")]})
    assert not same(float("nan"), 0.0)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (np.zeros(2), np.zeros(3)), (np.zeros(2), np.zeros((2, 1))), (np.zeros(1), 0.0), ({"a": 1}, {"b": 1}),
        ([1], [1, 2]), ((1,), [1]), (None, np.zeros(1)), (np.array(["a"]), np.array(["b"])),
    ],
)  # fmt: skip
def test_other_shapes_kinds_and_names_are_not_the_same(one, other):
    assert not same(one, other)
    assert not same(other, one)


def test_a_run_and_a_trade_equal_those_of_their_files(tmp_path):
    RUN.trajectory.save(tmp_path / "run.h5")
    assert dc.load_trajectory(tmp_path / "run.h5") == RUN.trajectory
    trade = dc.measure_trade(dc.column(2), steps=20, seeds=1, settings=[])
    trade.save(tmp_path / "trade.json")
    again = load_trade(tmp_path / "trade.json")
    assert again == trade
    again.rows[0]["us"] = 0.0
    assert again != trade


def test_a_result_is_not_hashed():
    for name in ("Simulation", "Trajectory", "ContactSolution", "Forces", "Bodies"):
        with pytest.raises(TypeError, match="unhashable"):
            hash(result(name))
