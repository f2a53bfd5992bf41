"""The extremes (Figure 6.6): what is refused, what stays bounded, what rests."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import SCRIPTS, circles_at, load_script, run_python

import deep_contact as dc
from deep_contact import figures
from deep_contact.solvers import METHODS
from deep_contact.starts import classical
from deep_contact.starts.names import STARTS
from deep_contact.state.arrays import LIMITS, Bodies
from deep_contact.state.constants import LINEAR_SLOP
from deep_contact.stepping.metrics import kinetic_energy
from deep_contact.stepping.prepare import is_valid, ready
from deep_contact.stepping.problem import contacts_of, solve
from deep_contact.studies import hard_scenes

extremes = load_script("figure_6_6")
ACCURATE, Trial, measure = extremes.ACCURATE, extremes.Trial, extremes.measure
SAFE, DEGRADED, FAILED, REFUSED = extremes.SAFE, extremes.DEGRADED, extremes.FAILED, extremes.REFUSED

pytestmark = pytest.mark.filterwarnings("ignore:.*(nearly coincide|outside of the box)")
TEN = dc.PGS(sweeps=10, tolerance=None)


def with_value(name, value):
    """A scene of three circles in which one quantity of `LIMITS` has a value."""
    owner, _, field = name.rpartition(".")
    scene = hard_scenes.silo(3)
    if not owner:
        return scene.replace(dt=value)
    if owner == "world":
        value = {
            "gravity": (0.0, value),
            "box": (0.0, 0.0, 2.02, value),
            "segments": [((-3.0, 0.0), (-3.0, value))],
            "surface_speeds": [value],
            "segment_velocities": [((0.0, value), (0.0, value))],
        }.get(field, value)
        moves = field in ("surface_speeds", "segment_velocities")
        belt = {"segments": [((0.0, 0.0), (3.0, 0.0))]} if moves else {}
        return scene.replace(world=dc.World(**{"box": scene.world.box, field: value}, **belt))
    if owner == "scales":
        return scene.replace(world=replace(scene.world, scales=dc.BOX2D._replace(**{field: value})))
    scene = ready(scene) if owner == "contacts" else scene
    array = getattr(getattr(scene, owner), field).copy()
    array[1] = value
    return scene.replace(**{owner: getattr(scene, owner)._replace(**{field: array})})


@pytest.mark.parametrize("name", LIMITS)
def test_beyond_a_limit_is_refused_with_quantity_limit_and_value(name):
    low, high, _ = LIMITS[name]
    for value in (np.nextafter(high, np.inf), 2 * high):
        with pytest.raises(ValueError, match=rf"{name}.*: expected .* to {high:g}".replace("+", r"\+")) as error:
            dc.simulate(with_value(name, value), steps=1)
        assert f"got {value}" in str(error.value)
    if low > 0:
        with pytest.raises(ValueError, match=rf"{name}.*: expected {low:g} to .*got {low / 2}"):
            dc.solve_contacts(with_value(name, low / 2))


SLOW = "world.segment_velocities", "world.rolling_friction"  # each compiles a kind of its own


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in LIMITS])
def test_at_a_limit_all_stays_finite_and_is_accepted_again(name):
    for value in LIMITS[name][:2]:
        if (value < 0 and name.endswith(("box", "normal_impulse"))) or value == 0:
            continue  # refused for other reasons: an empty box, a contact that pulls
        state = with_value(name, value)
        for _ in range(20):
            state = dc.step(state, solver=TEN)  # every step looks at the state again
        assert all(np.isfinite(field).all() for field in (*state.bodies, *state.contacts))


FIELDS = [(owner, name) for owner, kind in (("bodies", Bodies), ("contacts", dc.Contacts)) for name in kind._fields]


@pytest.mark.parametrize(("owner", "name"), FIELDS)
def test_a_field_of_the_wrong_length_or_that_is_not_finite_is_refused_by_name(owner, name):
    # The compiled steps index without looking; arrays of the engine's own kind take a shorter way to them.
    state = ready(hard_scenes.silo(3))
    part = getattr(state, owner)
    array = getattr(part, name)
    wrong = [np.ascontiguousarray(array[:-1]), np.concatenate([array, array[-1:]])]
    if array.ndim == 2:
        wrong.append(np.ascontiguousarray(np.column_stack([array, array[:, 0]])))
    for value in (np.nan, np.inf, -np.inf) if array.dtype == float else ():
        if name == "mass" and value > 0:
            continue  # of a fixed circle
        wrong.append(array.copy())
        wrong[-1].flat[-1] = value
    for values in wrong:
        exactly = name if values.shape == array.shape else r"\w+"
        with pytest.raises(ValueError, match=rf"{owner}(\.{exactly}.*)?: expected "):
            ready(state.replace(**{owner: part._replace(**{name: values})}))


def test_the_inertia_of_the_lightest_and_largest_circle_is_a_number():
    # Half of the smallest float is 0, and 0 · ∞ is NaN: the order of the factors matters.
    bodies = dc.make_bodies([[0.0, 0.0]], mass=5e-324, radius=1e200)
    with np.errstate(over="ignore"):
        assert bodies.inertia[0] == np.inf
    assert dc.make_bodies([[0.0, 0.0]], mass=3.0, radius=2.0).inertia[0] == 6.0


@pytest.mark.parametrize(
    ("ratio", "solver", "seconds", "slops"), [(1.0, TEN, 60, (0.0, 1.1)), (1000.0, ACCURATE, 5, (0.0, 2.0)),
                                              (1000.0, TEN, 5, (2.0, np.inf))],
)  # fmt: skip
def test_a_column_of_50_in_a_silo_rests_and_ten_sweeps_do_not_carry_a_thousandfold_mass(ratio, solver, seconds, slops):
    # The limit that the README states: information travels one contact a sweep, and the light ones give way.
    scene = hard_scenes.loaded_silo(50, ratio)
    rest = measure(Trial(scene=scene, steps=100 * seconds, solver=solver, recognised=False))
    assert slops[0] < rest["settled"] < slops[1]
    assert rest["speed"] < 1e-6 or (ratio > 1 and solver is TEN)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 1.0])
def test_overlapping_circles_part_without_speed(share):
    # "Bounded as in Box2D": a pair moves by at most max_correction a sweep of position correction, without a velocity.
    state = hard_scenes.overlapping(share)
    for _ in range(5):
        moved = dc.step(state, solver=TEN)
        gap = np.diff(moved.bodies.position[:, 0]) - np.diff(state.bodies.position[:, 0])
        assert 0 <= gap[0] <= dc.BOX2D.max_correction * TEN.position_sweeps * (1 + 1e-12)
        np.testing.assert_array_equal(moved.bodies.velocity, 0.0)
        state = moved
    assert -state.contacts.separation.min(initial=0.0) <= 3 * LINEAR_SLOP


@pytest.mark.parametrize("kind", ["huge", "pulling", "outside"])
def test_a_misleading_start_leaves_nothing_behind(kind):
    # Half of what gravity gives in a step, 0.1 m/s.
    state = ready(hard_scenes.pyramid(5))
    start = extremes.misleading_start(kind, 1e3)
    for _ in range(10):
        state = dc.step(state, solver=ACCURATE, warm_start=start)
    assert np.hypot(*state.bodies.velocity.T).max() < 0.05
    assert -state.contacts.separation.min() < 2 * LINEAR_SLOP


@pytest.mark.parametrize("kind", ["huge", "pulling", "outside"])
def test_a_start_beyond_what_the_sweeps_take_back_leaves_a_state_that_goes_on(kind):
    state = ready(hard_scenes.pyramid(5))
    state = dc.step(state, solver=ACCURATE, warm_start=extremes.misleading_start(kind, 1e12))
    after = dc.simulate(state, steps=10, solver=ACCURATE).state
    assert is_valid(after.bodies, after.contacts)
    box, position = np.array(after.world.box), after.bodies.position
    assert (position >= box[:2]).all()
    assert (position <= box[2:]).all()


def test_what_is_not_a_number_has_no_contacts_and_does_not_end_the_process():
    # NaN has no cell: the broad phase would write outside of its arrays.
    scene = hard_scenes.silo(3)
    position = scene.bodies.position.copy()
    position[1] = np.nan
    assert contacts_of(scene.replace(bodies=scene.bodies._replace(position=position))).count == 0


@pytest.mark.parametrize("solver", [dc.PGS(), dc.BatchedPGS()])
def test_a_solver_that_diverges_beyond_all_numbers_says_so(solver, monkeypatch):
    # Without the limit on a start the sweeps end in NaN, and that is said at once.
    monkeypatch.setattr(classical, "LARGEST_START", 1.7e308)
    state = ready(hard_scenes.silo(3))
    huge = lambda state, solver: (np.full(state.contacts.count, 1.7e308),) * 2  # noqa: E731
    with pytest.raises(FloatingPointError, match=r"up to step 1: circle 0 \(mass .*the solver diverged; try PGS"):
        dc.simulate(state, steps=5, solver=solver, warm_start=huge)


@pytest.mark.parametrize("sweeps", [1, 3, 20])
@pytest.mark.parametrize("start", ["none", "builtin"])
def test_sweeps_without_friction_never_add_kinetic_energy_to_what_the_start_left(frictionless_states, sweeps, start):
    # A row's relaxation minimises the dual objective, which is the kinetic energy gained, over that row.
    for state in frictionless_states:
        impulses = STARTS[start]()(state, None)
        by_start, after = (
            kinetic_energy(state.bodies._replace(velocity=found.velocities, spin=found.angular_velocities))
            for found in (solve(state, dc.PGS(sweeps=k, tolerance=None), *impulses) for k in (0, sweeps))
        )
        assert after <= by_start * (1 + 1e-12)


CHECKED = """
import sys
import deep_contact as dc
from deep_contact.studies import hard_scenes
from deep_contact.solvers import METHODS
sys.path.insert(0, sys.argv[2])
import figure_6_6_stability as extremes
solver = METHODS[sys.argv[1]](sweeps=20)
for scene in (hard_scenes.overlapping(1.0, 50), extremes.cornered(5.0), extremes.shifted(hard_scenes.silo(5), 1e6),
              extremes.bed_under(1e3), hard_scenes.channel(1e6), dc.lattice_in_box(200, radius=(1e-3, 1.0)),
              dc.single_body(height=3.0), extremes.small_pile(friction=1e6, restitution=1.0)):
    dc.simulate(scene, steps=60, solver=solver)
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_no_index_leaves_its_array(method, tmp_path):
    # Compiled code does not look at its indices; here it does, in a cache of its own.
    run_python("-c", CHECKED, method, SCRIPTS, environment={"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)})


# ---- what `measure` says of a scene ----


def push(state, solver):
    return np.full(state.contacts.count, 500.0), np.zeros(state.contacts.count)


NOTHING = dc.PGS(sweeps=0, tolerance=None, position_sweeps=0)
OUTCOMES = [
    (Trial(scene=hard_scenes.silo(2).replace(dt=2.0), steps=5), REFUSED, "dt: expected"),
    # 2 m a step, each: more than a diameter between two looks. Continuous collision is not modelled.
    (Trial(scene=hard_scenes.channel(20.0), steps=100, solver=NOTHING, ordered=0), FAILED, "passed through another"),
    (Trial(scene=hard_scenes.silo(2), steps=3, solver=NOTHING, warm_start=push), FAILED, "the energy rose by"),
    (Trial(scene=hard_scenes.loaded_silo(5, 1e4), steps=50, solver=TEN, recognised=False), DEGRADED, ""),
    *((Trial(scene=extremes.cornered(depth), steps=100), SAFE, "") for depth in (0.0, 0.1, 1.0, 5.0)),
]


@pytest.mark.parametrize(("trial", "verdict", "message"), OUTCOMES)
def test_a_scene_is_safe_degraded_failed_or_refused(trial, verdict, message):
    outcome = measure(trial)
    assert (outcome["verdict"], outcome["finite"]) == (verdict, True)
    assert message in outcome["message"]
    assert outcome["speed"] == 0.0 or verdict != SAFE
    assert verdict == REFUSED or outcome["us"] > 0


@pytest.mark.parametrize(
    ("quantity", "values", "steps"),
    [
        ("speed", (400.0, 1e6), 300),
        ("gravity", (1e6,), 100),
        ("radius", (1e-4, 1e10), 100),
        ("coinciding circles", (50,), 100),
        ("mass ratio, heavy on light", (1e4, 1e6), 100),
        ("column height", (200,), 20),
        ("coordinate", (1e-6, 9e8, 1e10), 100),
        ("friction", (1e12,), 150),
    ],
)
def test_what_others_do_not_survive_is_safe(quantity, values, steps):
    for value in values:
        outcome = extremes.run_case({"quantity": quantity, "value": value, "engine": "ours", "steps": steps})
        assert outcome["verdict"] == SAFE, (value, outcome["message"])


def test_lifting_by_position_correction_is_counted_apart():
    # Two circles above one another, half overlapping, at rest: what lifts them is correction, the sweeps only brake.
    scene = circles_at([[1.01, 1.01], [1.01, 2.01]], box=(0, 0, 2.02, 9))
    outcome = measure(Trial(scene=scene, steps=50, solver=dc.PGS(sweeps=500, tolerance=1e-12)))
    assert outcome["correction"] > 0.2


@pytest.mark.peers
def test_chipmunk_is_not_asked_for_what_ends_the_process():
    pytest.importorskip("pymunk")
    trial = Trial(scene=hard_scenes.silo(2), steps=1, solver=dc.PGS(sweeps=0))
    assert measure(trial, "pymunk")["verdict"] == REFUSED


def test_the_figure_holds_its_claims_on_a_few_quantities(tmp_path):
    options = {"quantities": ["mass", "overlap", "time step"], "few": True, "steps": 60}
    found = figures.produce(extremes.FIGURE, options=options, out=tmp_path)
    assert [claim["text"] for claim in found["claims"] if not claim["holds"]] == []
    (mass,) = (row for row in extremes.table(found["data"]) if row[0] == "mass")
    assert (mass[2], mass[5]) == ("1e-20 to 1e+20", "1e-40; 1e+40")
