"""`==` and `in` of states and of all results: "the same bits" is a promise that people test with them."""

import copy
import pickle
from dataclasses import fields, is_dataclass
from functools import cache

import numpy as np
import pytest
from conftest import readings

import deep_contact as dc
from deep_contact.analysis.lcp import contact_problem
from deep_contact.measure.errors import observe
from deep_contact.measure.trade import load_trade
from deep_contact.state.equality import same
from deep_contact.stepping.problem import step_problem

SCENE = dc.column(3)
TABLES = {
    "friction": [[0.3, 0.1], [0.1, 0.5]], "restitution": [[0.0, 0.2], [0.2, 0.1]],
    "rolling_friction": [[0.0, 0.05], [0.05, 0.1]], "touches": [[True, True], [True, False]],
    "wall_materials": [1, 0, 0, 0], "segment_materials": [1], "segments": [((0.0, 20.0), (4.0, 22.0))],
}  # fmt: skip
RUN = dc.simulate(SCENE, steps=20, record=1, forces=True)


def of_materials(**changed):
    """A scene of two materials in a world with all tables."""
    bodies = SCENE.bodies._replace(material=np.array([0, 1, 1]))
    return dc.find_contacts(SCENE.replace(world=dc.World(**TABLES | changed), bodies=bodies))


def seen():
    """The solved state of the last step of a live run."""
    live = dc.Simulator(SCENE, forces=True)
    live.step(20)
    return live.solved


def results():
    """Name -> a function that makes a result anew."""
    return {
        "state with materials": of_materials,
        "state of live.solved": seen,
        "StepProblem": lambda: step_problem(RUN.state),
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
        "Observation": lambda: observe(readings(RUN.trajectory)),
        "LearnedModel": lambda: dc.load_model(),
        "FarFieldModel": lambda: dc.load_model("far field"),
    }


@cache
def result(name):
    """A result made once, and not when tests are collected: a network makes TensorFlow keep its number of threads."""
    return results()[name]()


def altered(value, number=None):
    """Copies of a value, each with one number of one array changed, as far down as there are arrays.

    number: what it is changed to, in arrays of floats alone; by default to 0 or 1.
    """
    if isinstance(value, np.ndarray):
        if value.size and value.dtype.kind in ("iuf" if number is None else "f") and not np.isnan(value.flat[-1]):
            other = value.copy()
            other.flat[-1] = other.flat[-1] == 0 if number is None else number
            yield other
    elif isinstance(value, dict):
        yield from ({**value, key: other} for key, item in value.items() for other in altered(item, number))
    elif isinstance(value, list):
        yield from (list(other) for other in altered(tuple(value), number))
    elif isinstance(value, tuple):
        for k, item in enumerate(value):
            for other in altered(item, number):
                parts = (*value[:k], other, *value[k + 1 :])
                yield type(value)(*parts) if hasattr(value, "_fields") else parts
    elif is_dataclass(value):
        for field in fields(value):
            for other in altered(getattr(value, field.name), number) if field.compare else ():
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


WITH_ARRAYS = sorted({*results()} - {"World", "Recommendation", "Plan", "LearnedModel"})


@pytest.mark.parametrize("name", WITH_ARRAYS)
def test_one_number_of_one_array_makes_a_result_another(name):
    others = list(altered(result(name)))
    assert len(others) >= (1 if name == "ConvergenceRecord" else 2)
    for other in others:
        assert (result(name) == other) is False
        assert result(name) not in [other]


@pytest.mark.parametrize("name", WITH_ARRAYS)
def test_nan_in_any_array_equals_nan_there_alone(name):
    first = result(name)
    pairs = list(zip(altered(first, np.nan), altered(first, np.nan)))
    assert pairs
    for one, other in pairs:
        assert (one == other) is True
        assert one in [None, other]
        assert (one == first) is False


@pytest.mark.parametrize("name", TABLES)
def test_worlds_differ_if_one_element_of_a_table_does(name):
    other = np.array(TABLES[name])
    if other.dtype == bool:
        other = ~other
    else:
        other.flat[0] = other.flat[0] == 0
    world = of_materials().world
    assert world == of_materials().world
    assert world in [None, pickle.loads(pickle.dumps(world))]
    assert world not in [of_materials(**{name: other}).world]


def test_a_live_run_equals_itself_alone():
    live = dc.Simulator(SCENE)
    assert live in [None, live]
    assert live not in [dc.Simulator(SCENE)]


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
