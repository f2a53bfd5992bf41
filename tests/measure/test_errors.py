"""Errors of a run: closed forms, invariances, and ensembles whose errors are known."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import observation, readings

import deep_contact as dc
from deep_contact.measure.errors import ERRORS, LOADS, REST, errors, intervals, observe, with_reach


def states(scene, *, count=40, each=5, **options):
    state, found = scene, []
    for _ in range(count):
        state = dc.simulate(state, steps=each, solver=dc.PGS(sweeps=50, tolerance=None), **options).state
        found.append(state)
    return found


def test_a_falling_circle_by_closed_form():
    seen = observe(readings(states(dc.single_body(height=25.0), count=30, each=3)))
    t = 0.03 * np.arange(1, 31) * np.sqrt(9.81)
    np.testing.assert_allclose(seen.kinetic, 0.5 * t**2, rtol=1e-9)
    np.testing.assert_allclose(seen.speed, t, rtol=1e-9)
    np.testing.assert_allclose(seen.force, 0, atol=1e-9)  # nothing holds it
    # Symplectic Euler falls t Δt / 2 further than the parabola.
    np.testing.assert_allclose(seen.height, 26.01 - 0.5 * t * (t + 0.01 * np.sqrt(9.81)), rtol=1e-9)
    assert not seen.contacts.any()
    assert seen.loads is None
    np.testing.assert_allclose(seen.interval, 0.03 * np.sqrt(9.81))


def test_a_column_at_rest_carries_its_weight():
    seen = observe(readings(states(dc.column(5), count=80)))
    np.testing.assert_allclose(seen.force[-10:], 1, atol=1e-3)
    np.testing.assert_allclose(seen.contacts[-1], 1)  # four pairs and the floor, for five circles
    assert seen.speed[-1] < 1e-3
    # λ of contact k is k weights: 1, 2, 3, 4, 5 over their mean 3.
    for load in (1, 2, 3, 4, 5):
        at = load / 3
        np.testing.assert_allclose(np.interp(at - 0.06, LOADS, seen.loads), (load - 1) / 5, atol=0.02)
        np.testing.assert_allclose(np.interp(at + 0.06, LOADS, seen.loads), load / 5, atol=0.02)


@pytest.mark.parametrize("spin", [0.0, 2.0])
def test_fixed_circles_belong_to_the_walls_and_have_no_energy_height_or_weight(spin):
    """Of circles of one radius, since lengths are counted in the mean of all."""
    alone = states(dc.column(2), count=25, each=2)
    peg = dc.make_bodies([[2.0, 25.0]], spin=spin, fixed=True)
    pegged = [state.with_bodies(add=peg) for state in alone]
    seen, expected = observe(readings(pegged)), observe(readings(alone))
    for name in ("kinetic", "height", "force", "penetration", "loads"):
        np.testing.assert_allclose(getattr(seen, name), getattr(expected, name), rtol=1e-12, err_msg=name)
    assert np.isfinite(seen.speed).all()
    assert errors([seen], [expected])["energy"] == pytest.approx(0.0, abs=1e-9)


def test_penetration_is_that_of_the_contacts():
    scene = dc.two_bodies(speed=0.0)
    world = dc.World(gravity=(0, -1e-9))
    pushed = scene.bodies._replace(position=scene.bodies.position + np.array([[0.03, 0], [-0.03, 0]]))
    state = dc.simulate(scene.replace(world=world, bodies=pushed), steps=0).state
    seen = observe(readings(state.replace(time=float(k)) for k in range(REST)))
    np.testing.assert_allclose(seen.penetration, 0.06)
    np.testing.assert_allclose(seen.contacts, 0.5)


@pytest.mark.parametrize("scale", [1e-2, 16.0])
def test_numbers_are_the_same_at_every_scale(scale):
    """Only what is observed is scaled here, not the engine: lengths by s, times by √s, masses by s²."""
    run = states(dc.circles_in_box(30, seed=1), count=30)
    seen = observe(readings(run))

    def scaled(state):
        b, c, w = state.bodies, state.contacts, state.world
        bodies = b._replace(position=scale * b.position, velocity=np.sqrt(scale) * b.velocity,
                            spin=b.spin / np.sqrt(scale), mass=scale**2 * b.mass, radius=scale * b.radius)  # fmt: skip
        contacts = c._replace(separation=scale * c.separation, normal_start=scale**2.5 * c.normal_start)
        world = dc.World(box=np.multiply(scale, w.box), gravity=w.gravity)
        return state.replace(bodies=bodies, contacts=contacts, world=world, time=np.sqrt(scale) * state.time)

    for one, other in zip(seen[:8], observe(readings(map(scaled, run)))):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_pile_that_is_turned_with_gravity_has_the_same_numbers(quarters):
    # Height, creep, force and impact are along gravity.
    def turned(state):
        (x_min, y_min, x_max, y_max), b = state.world.box, state.bodies
        turn = np.round([[np.cos(quarters * np.pi / 2), -np.sin(quarters * np.pi / 2)],
                         [np.sin(quarters * np.pi / 2), np.cos(quarters * np.pi / 2)]])  # fmt: skip
        corners = np.array([[x_min, y_min], [x_max, y_max]]) @ turn.T
        box, gravity = (*corners.min(axis=0), *corners.max(axis=0)), tuple(turn @ state.world.gravity)
        bodies = b._replace(position=b.position @ turn.T, velocity=b.velocity @ turn.T)
        return state.replace(bodies=bodies, world=dc.World(box=box, gravity=gravity))

    run = states(dc.circles_in_box(30, seed=1), count=30)
    for one, other in zip(observe(readings(run))[:6], observe(readings(map(turned, run)))[:6]):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_an_ensemble_has_no_error_against_itself():
    runs = [observe(readings(states(dc.circles_in_box(30, seed=seed), count=30))) for seed in (1, 2)]
    found = errors(runs, runs)
    absolute = {"penetration", "penetration_95", "penetration_max"}
    assert found.keys() == ERRORS.keys()
    assert not any(found[name] for name in found.keys() - absolute)  # creep is unknown: they still fall
    assert 0 < found["penetration"] <= found["penetration_95"] <= found["penetration_max"]


@pytest.mark.parametrize(
    ("name", "changed", "expected"),
    [
        ("energy", {"kinetic": 1.1}, 10.0),
        ("height", {"height": 9.5}, 5.0),
        ("creep", {"height": 10 - 0.01 * np.arange(30)}, 8.0),
        ("penetration", {"penetration": 0.02}, 2.0),
        ("penetration_95", {"penetration": 0.02}, 2.0),
        ("penetration_max", {"penetration": 0.02 + 0.1 * (np.arange(30) == 3)}, 12.0),
        ("restlessness", {"speed": 0.07}, 7.0),
        ("contacts", {"contacts": 1.7}, 0.2),
        ("forces", {"loads": np.minimum(1, LOADS + 0.03)}, 3.0),
    ],
)
def test_each_error_by_hand(name, changed, expected):
    """The reference creeps itself, by 0.002 r in an interval of 0.1."""
    same = {"loads": np.minimum(1, LOADS), "height": 10 - 0.002 * (np.arange(30) - 19.5)}
    found = errors([observation(**(same | changed))] * 3, [observation(**same)] * 3)
    np.testing.assert_allclose(found[name], expected, rtol=1e-9)


def test_the_95th_percentile_is_that_of_the_contacts():
    """Depths of 0, 0.01 … 1 r, of circles of r = 2 m."""
    state = dc.simulate(dc.two_bodies(speed=0.0), steps=0).state
    state = state.replace(
        world=dc.World(gravity=(0, -1.0)), bodies=dc.make_bodies([[5, 5], [15, 5]], radius=2.0),
        contacts=SimpleNamespace(separation=-0.02 * np.arange(101), normal_start=np.zeros(101)),
    )  # fmt: skip
    seen = observe(readings(state.replace(time=float(k)) for k in range(REST)))
    np.testing.assert_allclose(seen.penetration, [[0.5, 0.95, 1.0]] * REST)


def test_errors_of_a_quantity_are_shares_of_its_size_over_the_run():
    """Its curve: Σ |⟨q⟩ − ⟨q⟩*| / Σ |⟨q⟩*|; its spread: the distance of the means over a run, 1 and 3 from 2 and 2."""
    found, same = ([observation(quantities={"q": q}) for q in runs] for runs in ((1.0, 3.0), (2.0, 2.0)))
    shifted = [observation(quantities={"q": 2.0 + 0.5 * (np.arange(30) < 15)})] * 2
    assert [errors(found, same)[name] for name in ("q", "q spread")] == [0.0, pytest.approx(0.5)]
    assert [errors(shifted, same)[name] for name in ("q", "q spread")] == [pytest.approx(0.125)] * 2
    nothing = [observation(quantities={"q": 0.0})] * 2  # of which there is no share
    assert [errors(found, nothing)[name] for name in ("q", "q spread")] == [pytest.approx(2.0)] * 2


def test_what_a_gas_and_a_drum_never_have_is_unknown():
    gas, drum = observation()._replace(force=None), observation(speed=1.0)
    known = {name for name, value in errors([gas], [gas]).items() if value is not None}
    assert known == {"energy", "penetration_max"}
    assert errors([drum], [drum])["creep"] is None  # heights of what flows are not settled
    assert errors([drum], [drum])["height"] == 0


def test_a_gas_is_measured_by_its_fastest_circle():
    run = states(dc.drifting_circles(20, speed=5.0, seed=1), count=30)
    seen, bodies = observe(readings(run)), run[0].bodies
    speed = np.hypot(*bodies.velocity.T)
    kinetic = 0.5 * (bodies.mass @ speed**2 + bodies.inertia @ bodies.spin**2) / bodies.mass.sum()
    np.testing.assert_allclose(seen.speed[0], 10 * np.sqrt((speed**2).mean()) / speed.max())
    np.testing.assert_allclose(seen.kinetic[0], 100 * kinetic / speed.max() ** 2)
    assert seen.force is None


def test_calm_is_no_error_and_unknown_forces_are_none():
    reference = [observation(speed=0.1, loads=np.minimum(1, LOADS))]
    found = errors([observation(speed=0.05)], reference)
    assert found["restlessness"] == 0
    assert found["forces"] is None
    assert intervals([observation()], reference)["forces"] is None


def test_the_impact_is_that_of_the_ensemble():
    seen = observation()
    low, high = (seen._replace(force=np.where(np.arange(seen.force.size) == 4, peak, 1.0)) for peak in (2.0, 4.0))
    np.testing.assert_allclose(errors([high, low], [low, low])["impact"], 50.0)


def test_intervals_hold_the_value_and_shrink_with_seeds():
    rng, widths = np.random.default_rng(1), []
    for count in (4, 64):
        ensembles = ([observation(kinetic=1 + 0.1 * rng.normal()) for _ in range(count)] for _ in range(2))
        value, low, high = intervals(*ensembles, resamples=300)["energy"]
        assert low <= value <= high
        widths.append(high - low)
    assert widths[1] < 0.6 * widths[0]


def test_what_cannot_be_observed_is_refused():
    run = states(dc.circles_in_box(20, seed=1), count=5)
    with pytest.raises(ValueError, match=f"readings: expected at least {REST}, got 5"):
        observe(readings(run))
    with pytest.raises(ValueError, match="readings: expected"):
        observe(readings([dc.simulate(dc.drifting_circles(3, speed=0.0), steps=1).state]))
    with pytest.raises(ValueError, match="found: expected"):
        intervals([observation()], [observation()] * 2)


def test_no_value_lies_outside_of_its_reach():
    value, reach = with_reach([1.0, 1.2, 2.0])  # the interval of a bootstrap may lie above the value
    assert value == 1.0
    np.testing.assert_array_equal(reach, [[0.0], [1.0]])


def test_loads_are_those_of_the_last_observations():
    """Five observations of loads 1 and 3, then twenty of equal ones: all of these are their mean."""
    state = dc.simulate(dc.two_bodies(speed=0.0), steps=0).state.replace(world=dc.World(gravity=(0, -1.0)))
    kinds = [SimpleNamespace(separation=np.zeros(2), normal_start=np.array(pair)) for pair in ([1.0, 3.0], [5.0, 5.0])]
    seen = observe(readings(state.replace(time=float(k), contacts=kinds[k >= 5]) for k in range(5 + REST)))
    np.testing.assert_array_equal(seen.loads, LOADS >= 1.0)
