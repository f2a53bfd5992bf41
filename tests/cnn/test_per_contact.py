"""The perceptron on each contact: what its inputs must not depend on, its compiled form, its file, its training."""

import itertools
import json

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.cnn.model_file import ModelFileError
from deep_contact.cnn.per_contact import PerContact, card_of, describe, load, save
from deep_contact.cnn.perceptron import CORRECTIONS, HIDDEN, INPUTS, Perceptron
from deep_contact.cnn.through_solver import errors_after, over_relaxed, solved_problem
from deep_contact.cnn.training.per_contact_run import (
    PerContactConfig,
    initial,
    loss_of,
    network_of,
    samples_of,
    train,
)
from deep_contact.physics import metrics
from deep_contact.physics.engine import step_problem
from deep_contact.state import Bodies

SOLVER = dc.PSOR(sweeps=10, tolerance=None, omega=1.75, friction_omega=1.45)


@pytest.fixture(scope="module")
def pile():
    """A falling pile with contacts new and old, stuck and sliding, and with walls."""
    scene = dc.lattice_in_box(60, radius=(0.7, 1.3), seed=3)
    return dc.simulate(scene, steps=90, solver=SOLVER).state


def network(least=0.0, seed=0, size=0.05):
    rng = np.random.default_rng(seed)
    first = 0.3 * rng.normal(size=(len(INPUTS) + 1, HIDDEN))
    second = size * rng.normal(size=(HIDDEN + 1, len(CORRECTIONS)))
    return Perceptron(first.astype(np.float32), second.astype(np.float32), least)


def moved(state, position, velocity, spin=1.0, impulse=1.0, *, gravity=None, box=None, dt=None, **bodies):
    """The state with its vectors mapped by functions, found contacts included, tangent impulses times `impulse`."""
    mapped = state.bodies._replace(
        position=position(state.bodies.position),
        velocity=velocity(state.bodies.velocity),
        spin=spin * state.bodies.spin,
        **bodies,
    )
    world = dc.World(box=box or state.world.box, gravity=gravity or state.world.gravity, friction=state.world.friction)
    return state.replace(bodies=Bodies(*map(np.ascontiguousarray, mapped)), world=world, dt=dt or state.dt)


def described(state, contacts):
    return describe(step_problem(state.replace(contacts=contacts)))


def assert_same(state, contacts, pile, normal=1.0):
    """Inputs alike but for rounding in float32, and corrections times a factor."""
    one, other = describe(step_problem(pile)), described(state, contacts)
    np.testing.assert_allclose(other.inputs, one.inputs, atol=1e-5)
    np.testing.assert_allclose(np.abs(other.corrections), normal * np.abs(one.corrections), rtol=1e-6, atol=1e-9)
    assert other.unsolved == pytest.approx(one.unsolved, rel=1e-9)


def test_inputs_do_not_change_when_the_scene_is_turned(pile):
    def turn(v):
        return np.column_stack([-v[:, 1], v[:, 0]])

    contacts = pile.contacts._replace(normal=turn(pile.contacts.normal), position=turn(pile.contacts.position))
    # Walls: their solver bodies are at rest whatever their number.
    assert_same(moved(pile, turn, turn, gravity=(9.81, 0.0)), contacts, pile)


def test_inputs_do_not_change_when_the_scene_is_mirrored(pile):
    def mirror(v):
        return v * [-1.0, 1.0]

    contacts = pile.contacts._replace(
        normal=mirror(pile.contacts.normal),
        position=mirror(pile.contacts.position),
        tangent_start=-pile.contacts.tangent_start,
    )
    assert_same(moved(pile, mirror, mirror, spin=-1.0), contacts, pile)


@pytest.mark.parametrize(("length", "mass", "time"), [(1e-3, 1.0, 1e-3**0.5), (1.0, 50.0, 1.0), (1.0, 1.0, 7.0)])
def test_inputs_do_not_change_with_the_units(pile, length, mass, time):
    # λ has the unit kg m / s. With an area density of kg / m², the masses follow from the given factor alone.
    speed, impulse = length / time, mass * length / time
    bodies = {"radius": length * pile.bodies.radius, "mass": mass * pile.bodies.mass}
    if "inertia" in Bodies._fields:
        bodies["inertia"] = mass * length**2 * pile.bodies.inertia
    g = pile.world.gravity[1] * length / time**2
    contacts = pile.contacts._replace(
        separation=length * pile.contacts.separation,
        normal_start=impulse * pile.contacts.normal_start,
        tangent_start=impulse * pile.contacts.tangent_start,
    )
    state = moved(
        pile,
        lambda v: length * v,
        lambda v: speed * v,
        spin=1.0 / time,
        gravity=(0.0, g),
        dt=time * pile.dt,
        **bodies,
    )
    assert_same(state, contacts, pile, normal=impulse)


def test_inputs_do_not_change_with_the_numbers_of_bodies_and_contacts(pile):
    rng = np.random.default_rng(1)
    n, contacts = pile.bodies.count, pile.contacts
    order = rng.permutation(n)  # body i becomes place[i]
    place = np.argsort(order)
    place = np.concatenate([place, np.arange(n, n + 4)])
    a, b = place[contacts.body_a], place[contacts.body_b]
    flip = np.where(a > b, -1.0, 1.0)
    renamed = contacts._replace(
        body_a=np.minimum(a, b), body_b=np.maximum(a, b), normal=flip[:, None] * contacts.normal
    )
    sort = np.lexsort((renamed.body_b, renamed.body_a))
    renamed = type(contacts)(*(np.ascontiguousarray(values[sort]) for values in renamed))
    bodies = Bodies(*(np.ascontiguousarray(values[order]) for values in pile.bodies))
    one, other = describe(step_problem(pile)), describe(step_problem(pile.replace(bodies=bodies, contacts=renamed)))
    np.testing.assert_allclose(other.inputs, one.inputs[sort], atol=1e-5)
    np.testing.assert_allclose(other.corrections, one.corrections[sort], rtol=1e-9, atol=1e-9)


def test_the_compiled_perceptron_is_two_matrix_products(pile):
    net = network()
    found = describe(step_problem(pile))
    hidden = np.maximum(found.inputs @ net.first[:-1] + net.first[-1], 0.0)
    parts = (hidden @ net.second[:-1] + net.second[-1]) * found.corrections
    normal = np.maximum(pile.contacts.normal_start + parts[:, :4].sum(axis=1), 0.0)
    tangent = pile.contacts.tangent_start + parts[:, 4:].sum(axis=1)
    bound = pile.world.friction * normal
    p_n, p_t = PerContact(net)(pile, SOLVER)
    np.testing.assert_allclose(p_n, normal, atol=1e-5 * normal.max())
    np.testing.assert_allclose(p_t, np.clip(tangent, -bound, bound), atol=1e-5 * normal.max())


def test_gates_of_zero_and_a_high_threshold_give_builtin(pile):
    for start in (PerContact(network(size=0.0)), PerContact(network(least=1.0))):
        p_n, p_t = start(pile, SOLVER)
        np.testing.assert_array_equal(p_n, pile.contacts.normal_start)
        bound = pile.world.friction * p_n
        # Builtin's friction may lie outside the cone, whose bound was swept after it; the corrected one may not.
        expected = pile.contacts.tangent_start
        assert np.array_equal(p_t, expected) or np.array_equal(p_t, np.clip(expected, -bound, bound))


def test_at_rest_it_is_left_out():
    state = dc.simulate(dc.column(5), steps=300, solver=SOLVER).state
    np.testing.assert_array_equal(PerContact(network(least=0.02))(state, SOLVER)[0], state.contacts.normal_start)


@pytest.mark.parametrize("solver", [SOLVER, dc.PGS(sweeps=8, tolerance=None), dc.NNCG(sweeps=8, tolerance=None)])
def test_compiled_steps_start_as_python_steps_do(solver):
    start, scene = PerContact(network(least=0.02)), dc.lattice_in_box(50, seed=4)
    compiled = dc.simulate(scene, steps=80, solver=solver, warm_start=start)
    by_step = dc.simulate(scene, steps=80, solver=solver, warm_start=lambda state, given: start(state, given))
    builtin = dc.simulate(scene, steps=80, solver=solver)
    np.testing.assert_array_equal(compiled.state.bodies.position, by_step.state.bodies.position)
    np.testing.assert_array_equal(compiled.theta, by_step.theta)
    assert not np.array_equal(compiled.state.bodies.position, builtin.state.bodies.position)


@pytest.mark.parametrize(
    "options",
    [
        {"solver": dc.BatchedPGS(sweeps=5, tolerance=None)},
        {"solver": dc.PGS(sweeps=5, tolerance=None, precision="single")},
        {"sleep": True},
        {"friction": 0.0},
    ],
    ids=["batched", "single", "sleep", "frictionless"],
)
def test_other_steps_call_it_between_them(options):
    options = {"solver": SOLVER, "friction": 0.5} | options
    scene = dc.lattice_in_box(30, friction=options.pop("friction"), seed=4)
    run = dc.simulate(scene, steps=60, warm_start=PerContact(network()), **options)
    assert run.contacts.max() > 20
    assert np.isfinite(run.state.bodies.position).all()


def test_a_state_without_contacts_has_no_start():
    state = dc.simulate(dc.single_body(height=5.0), steps=1).state
    assert [values.size for values in PerContact(network())(state, SOLVER)] == [0, 0]


# ---- through PSOR ----


def test_errors_of_over_relaxed_sweeps_are_those_of_psor(falling_states):
    state = falling_states[6]
    problem = solved_problem(state)
    start = problem.rows.impulse
    solver = dc.PSOR(sweeps=7, tolerance=None, omega=1.75, friction_omega=1.45)
    found = errors_after(over_relaxed(problem, 1.75, 1.45), start, [7])[0]
    bound = state.world.friction * start[:, 0]
    in_cone = start[:, 0].copy(), np.clip(start[:, 1], -bound, bound)
    solution = dc.solve_contacts(state, solver=solver, start=in_cone)
    reference = dc.solve_contacts(
        state, solver=dc.PGS(sweeps=0), start=(state.contacts.normal_impulse, state.contacts.tangent_impulse)
    )
    assert found == pytest.approx(metrics.velocity_error(state, solution, reference), rel=1e-6)


def test_gradient_by_the_weights_equals_finite_differences():
    config = PerContactConfig(states=2, largest=60, sweeps=200)
    # Not every scene has states to train on: some still fall, some rest. Where a start leaves the cone, the gradient
    # leads back into it on purpose (`through_solver`) and is no derivative; in the second state it stays inside.
    found = (s for seed in range(5, 50) for s in samples_of(dc.simulate, None, seed, config))
    sample = next(itertools.islice(found, 1, None))
    sample = sample._replace(budget=5)
    rng = np.random.default_rng(0)
    weights = [w + 0.02 * rng.normal(size=w.shape) for w in initial(0)]
    gradient = loss_of(weights, sample)[1]
    scale = sample.builtin_error + 0.03
    for layer, place in ((0, (3, 2)), (0, (-1, 5)), (1, (4, 1)), (1, (7, 5)), (1, (-1, 2))):
        numeric = []
        for sign in (1.0, -1.0):
            changed = [w.copy() for w in weights]
            changed[layer][place] += sign * 1e-5
            numeric.append(loss_of(changed, sample)[0])
        assert (numeric[0] - numeric[1]) / 2e-5 / scale == pytest.approx(gradient[layer][place], rel=2e-2, abs=1e-4)


def test_training_lowers_the_error_and_repeats_itself():
    config = PerContactConfig(rounds=2, scenes=6, states=3, largest=80, sweeps=150, epochs=4)
    told = []
    one, history = train(dc.simulate, config, tell=told.append)
    other, _ = train(dc.simulate, config, tell=told.append)
    np.testing.assert_array_equal(one.second, other.second)
    samples = [s for i in range(6) for s in samples_of(dc.simulate, None, 100_000 + i, config)]
    builtin = sum(s.builtin_error for s in samples)
    weights = [one.first.astype(float), one.second.astype(float)]
    assert sum(loss_of(weights, s)[0] for s in samples) < builtin
    assert len(told) == 4
    assert network_of(weights, config).least == config.least
    assert history["rounds"][1]["states"] > history["rounds"][0]["states"]


# ---- the file ----


def test_a_file_comes_back(tmp_path):
    net, path = network(least=0.03), tmp_path / "net.json"
    save(path, net, {"seed": 4})
    back = load(path)
    np.testing.assert_array_equal(back.first, net.first)
    np.testing.assert_array_equal(back.second, net.second)
    assert (back.least, card_of(path)) == (0.03, {"seed": 4})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2}, "format: expected 1, got 2"),
        ({"inputs": ["mass"]}, "inputs: expected"),
        ({"least": 0.5}, "digest: expected"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path, change, message):
    path = tmp_path / "net.json"
    save(path, network(), {})
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ModelFileError, match=message):
        load(path)


def test_what_is_no_json_or_has_other_shapes_is_refused(tmp_path):
    path = tmp_path / "net.json"
    path.write_text("weights")
    with pytest.raises(ModelFileError, match="expected JSON"):
        load(path)
    save(path, network()._replace(first=np.zeros((3, 3), np.float32)), {})
    with pytest.raises(ModelFileError, match=r"first: expected finite weights of shape \(21, 16\), got \(3, 3\)"):
        load(path)


def test_a_threshold_below_zero_is_refused():
    with pytest.raises(ValueError, match="least: expected a finite number >= 0"):
        PerContact(network(), least=-1.0)


def test_learned_names_the_shipped_one():
    start = dc.warm_start.warm_start_of("learned")
    assert start.network.first.shape == (len(INPUTS) + 1, HIDDEN)
    assert card_of()["solver"].startswith("PSOR(")
