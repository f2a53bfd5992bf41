"""A scene that lives: its bits are those of runs, and nothing that happens between two steps is lost."""

import pickle
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.compiled.direct import OFTEN, Direct
from deep_contact.starts.changed_load import with_time_step
from deep_contact.state.arrays import no_contacts
from deep_contact.stepping.log import FINITE
from deep_contact.stepping.problem import contacts_of

WAYS = {
    "fast": ({}, {"accuracy": "fast"}),
    "no start": ({}, {"solver": dc.PGS(sweeps=8), "warm_start": None}),
    "support": ({}, {"solver": dc.PGS(sweeps=8), "warm_start": "support"}),
    "asleep": ({}, {"solver": dc.PGS(sweeps=8), "sleep": True}),
    "frictionless": ({"friction": 0.0}, {"solver": dc.PGS(sweeps=8)}),
    "rebounds": ({"restitution": 0.5}, {"solver": dc.PGS(sweeps=8, substeps=2, most_substeps=8)}),
    "batches": ({}, {"solver": dc.BatchedPGS(sweeps=8, substeps=3)}),
}


@pytest.fixture
def pile():
    """Circles that fall onto one another, and the options of a run."""
    return dc.column(4, friction=0.4), {"solver": dc.PGS(sweeps=8)}


@pytest.mark.parametrize("way", WAYS)
def test_step_by_step_in_parts_and_in_one_call_are_the_same_bits(way):
    world, how = WAYS[way]
    scene = dc.lattice_in_box(12, seed=1, **world)
    scene = scene.replace(bodies=scene.bodies._replace(velocity=np.full((12, 2), [3.0, -12.0])))
    whole = dc.simulate(scene, steps=60, **how)
    assert whole.contacts.max() > 8
    for parts in ([1] * 60, [7, 0, 13, 40], [60]):
        run = dc.Simulator(scene, **how)
        for steps in parts:
            run.step(steps)
        assert run.state == whole.state
        assert run.time == whole.state.time


def test_contacts_that_do_not_fit_into_the_memory_of_a_run_are_handed_over_too():
    # 40 circles in one place have more pairs than the memory has room for, and lose them while they part.
    position = 15.0 + 0.2 * np.random.default_rng(0).normal(size=(40, 2))
    scene, counts = circles_at(position, radius=0.5).replace(contacts=no_contacts()), set()
    run = dc.Simulator(scene, solver=dc.PGS(sweeps=8))
    capacity = run._steps.memory(run._inputs).rows.body.shape[0]
    for _ in range(60):
        run.step()
        contacts, expected = run.state.contacts, contacts_of(run.state)
        for one, other in zip(contacts[:5], expected[:5]):
            np.testing.assert_array_equal(one, other)
        counts.add(contacts.count)
    assert len(counts) > 5
    assert max(counts) > capacity > min(counts)


@pytest.mark.parametrize("how", [{}, {"accuracy": "fast"}])
def test_a_preset_decides_anew_for_other_circles(how):
    """The default does so, too: an empty cup that is filled is no empty cup any more."""
    run = dc.Simulator(dc.column(1), **how)
    run.add(dc.make_bodies([[4.0, 5.0], [8.0, 5.0]], velocity=[0.0, -100.0]))
    assert run.state.solver == dc.simulate(run.state.replace(solver=None), steps=0, **how).state.solver
    assert run.state.solver != dc.simulate(dc.column(1), steps=0, **how).state.solver
    kept = dc.Simulator(dc.column(1).replace(solver=dc.PGS(sweeps=7)))
    kept.set(friction=0.1)
    assert kept.state.solver == dc.simulate(dc.column(1), steps=0, solver=dc.PGS(sweeps=7)).state.solver


def test_views_follow_the_steps_and_states_have_arrays_of_their_own(pile):
    run = dc.Simulator(pile[0], **pile[1])
    positions, before = run.positions, run.state
    run.step(20)
    assert positions is run.positions
    np.testing.assert_array_equal(positions, run.state.bodies.position)
    np.testing.assert_array_equal(run.velocities, run.state.bodies.velocity)
    assert before == pile[0].replace(contacts=before.contacts, solver=before.solver)
    for view in (run.positions, run.velocities):
        with pytest.raises(ValueError, match="read-only"):
            view[:] = 0.0
    kept = run.state
    kept.bodies.velocity[:] = kept.contacts.normal_start[:] = 1e3
    run.step(5)
    assert run.state == dc.simulate(*pile[:1], steps=25, **pile[1]).state


@pytest.mark.parametrize(
    "changes",
    [{"gravity": (3.0, -5.0)}, {"friction": 0.1}, {"restitution": 0.5}, {"gravity": (0.0, 9.81), "friction": 0}],
)
def test_what_is_set_holds_from_there_on(changes, pile):
    run = dc.Simulator(pile[0], **pile[1])
    run.step(40)
    state = run.state
    run.set(**changes)
    run.step(10)
    world = dc.World(**{name: getattr(state.world, name) for name in ("box", "gravity", "friction")} | changes)
    assert run.state == dc.simulate(state.replace(world=world), steps=10, **pile[1]).state
    with pytest.raises(ValueError, match="friction: expected"):
        run.set(friction=-1.0)
    assert run.state.world == world


def turned(angle, strength=9.81):
    return strength * np.sin(angle), -strength * np.cos(angle)


def forces(newtons):
    return np.array([[newtons, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, newtons]])


SMALL = {
    "gravity turned": lambda k: {"gravity": turned(1e-3 * k)},
    "gravity stronger": lambda k: {"gravity": turned(0.0, 9.81 + 0.02 * k)},
    "gravity weaker": lambda k: {"gravity": turned(0.0, 9.81 - 0.02 * k)},
    "friction": lambda k: {"friction": 0.4 - 5e-4 * k},
    "restitution": lambda k: {"restitution": 0.1 + 5e-4 * k},
    "push": lambda k: {"push": forces(0.03 * k)},
    "push with torques": lambda k: {"push": (forces(0.02 * k), np.full(4, -0.01 * k))},
    "all": lambda k: {"push": forces(0.01 * k), "gravity": turned(1e-4 * k), "friction": 0.4 - 1e-4 * k},
}
"""What changes by little -> the k-th change."""


def slow_if_pushed(**how):
    """All small changes with a way to solve. Pushes are slow tests, for no other test compiles them with it."""
    return [pytest.param(name, how, marks=[pytest.mark.slow] * ("push" in SMALL[name](0))) for name in SMALL]


@pytest.mark.parametrize(
    ("name", "how"),
    [(name, {"solver": dc.PGS()}) for name in SMALL]
    + slow_if_pushed(solver=dc.BatchedPGS(sweeps=8))
    + slow_if_pushed(accuracy="fast"),
)
def test_small_changes_are_set_in_place_with_the_bits_of_changed_states(name, how):
    """PGS() ends its sweeps at a tolerance that follows gravity."""
    scene = dc.column(4, friction=0.4)
    scene = scene.replace(world=replace(scene.world, restitution=0.1 * (name == "restitution")))
    if name == "friction":  # discs that slide on a slope, with λ_t at its bound
        centres = [[5.0, 1.0], [10.0, 1.0], [15.0, 1.0], [20.0, 1.0]]
        scene = circles_at(centres, box=(0, 0, 99, 30), friction=0.4, gravity=turned(1.1))
    nothing = forces(0.0) if "push" in SMALL[name](0) else None
    state = dc.simulate(scene, steps=40, push=nothing, **how).state
    run, made = dc.Simulator(state, push=nothing, **how), []
    run._change = lambda *_: made.append(0)
    for k in range(1, 9):
        changes = SMALL[name](k)
        run.set(**changes)
        run.step()
        push = changes.pop("push", None)
        state = state.replace(world=replace(state.world, **changes))
        state = dc.simulate(state, steps=1, push=push, **how).state
    assert not made
    assert run.state == state
    assert run.state.load == state.load
    assert (run.state.load.anchor.spent > 0.0) == (name == "friction")
    assert (run.state.solver, run.state.preset) == (state.solver, state.preset)
    assert run._inputs.scales.sleep_speed == run.state.scales.sleep_speed


def test_a_preset_keeps_its_solver_while_the_load_is_near():
    """Circles that fell fast have got substeps, which they need no more when they rest."""
    scene = dc.column(3)
    scene = scene.replace(bodies=scene.bodies._replace(velocity=np.full((3, 2), [0.0, -60.0])))
    state = dc.simulate(scene, steps=60, accuracy="fast").state
    anew = dc.simulate(state.replace(solver=None), steps=0, accuracy="fast").state.solver
    assert anew.substeps < state.solver.substeps
    run = dc.Simulator(state, accuracy="fast")
    for gravity, solver in (((1e-3, -9.81), state.solver), ((1.0, -9.81), anew)):
        changed = state.replace(world=replace(state.world, gravity=gravity))
        run.set(gravity=gravity)
        assert run.state.solver == dc.simulate(changed, steps=0, accuracy="fast").state.solver == solver


def test_a_small_change_wakes_what_sleeps():
    run = dc.Simulator(dc.column(3, friction=0.4), solver=dc.PGS(sweeps=8), sleep=True)
    run.step(100)
    assert run._steps.sleep.still.max() > 0.0
    run.set(gravity=(1e-4, -9.81))
    assert run._steps.sleep.still.max() == 0.0


def test_changes_that_add_up_are_not_set_in_place():
    """Gravity turned by 1e-3 rad a step; 0.001 √(g r) is Δt g times 31.9e-3 rad."""
    run, made = dc.Simulator(dc.column(4, friction=0.4), solver=dc.PGS(sweeps=8)), []
    change = run._change
    run._change = lambda *arguments: made.append(k) or change(*arguments)
    run.step(40)
    for k in range(1, 100):
        run.set(gravity=turned(1e-3 * k))
        run.step()
    assert made == [32, 64, 96]


def test_a_change_in_place_refuses_what_a_world_refuses_and_leaves_all_as_it_was(pile):
    run = dc.Simulator(pile[0], **pile[1])
    run.step(40)
    before = run.state
    for bad in ({"friction": -1.0}, {"gravity": (0.0, 1e7)}, {"restitution": 2.0}, {"push": [[1.0, 2.0]]}):
        with pytest.raises(ValueError, match="expected"):
            run.set(**{"gravity": (1e-3, -9.81)} | bad)
        assert run.state == before
        assert run.state.load == before.load
    heavy = dc.Simulator(circles_at([[5.0, 5.0]], gravity=(0.0, -1e6)), **pile[1])
    with pytest.raises(ValueError, match=r"gravity.*expected"):
        heavy.set(gravity=(0.0, -1e6 - 10.0))


def test_a_solver_for_another_tolerance_is_not_taken_for_that_of_before(pile):
    """The tolerance follows gravity. It is that of the beginning when gravity and e are set, and e needs other code."""
    run = dc.Simulator(pile[0], solver=dc.PGS())
    run.step(40)
    for change in ({"gravity": (0.0, -9.83)}, {"gravity": (0.0, -9.81), "restitution": 0.5}):
        run.set(**change)
        expected = dc.PGS().for_state(run.state)
        assert run.state.solver == run._steps._solver == expected
        assert run._steps._options.settings.tolerance == expected.tolerance
        run.step(2)


def test_the_time_step_can_be_set_and_scales_what_is_carried(pile):
    run = dc.Simulator(pile[0], **pile[1])
    run.step(40)
    state = run.state
    run.set(dt=0.004)
    run.step(10)
    assert run.state == dc.simulate(with_time_step(state, 0.004), steps=10, **pile[1]).state


def test_segments_can_be_set_and_those_that_stay_keep_their_impulses():
    shelf, bar = ((0.0, 5.0), (30.0, 5.0)), ((0.0, 20.0), (30.0, 20.0))
    scene = circles_at([[5.0, 6.0], [5.0, 21.0]], segments=[shelf, bar])
    run = dc.Simulator(scene, solver=dc.PGS(sweeps=8))
    run.step(5)
    carried = run.state.contacts.normal_start[0]
    run.set(segments=[shelf])
    assert run.state.contacts.normal_start.tolist() == [carried]
    run.step(20)
    assert run.positions[0, 1] == pytest.approx(6.0, abs=0.02)
    assert run.positions[1, 1] < 20.8


LINES = [((1.0, 1.0), (9.0, 1.0)), ((11.0, 1.0), (19.0, 2.0))]
SETS = {
    "gravity": {"gravity": (1.0, -5.0)},
    "friction": {"friction": 0.1},
    "restitution": {"restitution": 0.8},
    "segments that are elsewhere": {"segments": [((1.0, 0.9), (9.0, 0.9)), LINES[1]]},
    "one segment less": {"segments": LINES[:1]},
    "one segment more": {"segments": [*LINES, ((5.0, 9.0), (6.0, 9.0))]},
    "velocities": {"segment_velocities": [((0.0, 0.5), (0.0, 0.2)), ((0.0, 0.0), (0.0, 0.0))]},
    "segments and velocities": {"segments": LINES[:1], "segment_velocities": [((0.0, 0.5), (0.0, -0.3))]},
    "no velocities": {"segment_velocities": []},
}


@pytest.mark.filterwarnings("ignore:segments")
@pytest.mark.parametrize("start", ["belts", "moving"])
@pytest.mark.parametrize("name", SETS)
def test_a_world_of_which_a_field_is_set_keeps_the_others(name, start):
    """But for velocities and surface speeds where other segments come: they do not fit them."""
    own = {
        "belts": {"surface_speeds": (3.0, 0.0)},
        "moving": {"surface_speeds": (3.0, -1.0), "segment_velocities": [((0.0, 0.1), (0.0, 0.1)), ((0, 0), (0, 0))]},
    }[start]
    world = dc.World(gravity=(0.5, -9.0), friction=0.4, restitution=0.3, segments=LINES, scales=dc.BOX2D, **own)
    scene = dc.State(name="set", world=world, bodies=dc.make_bodies([[5.0, 1.4], [15.0, 2.0]], radius=0.4))
    run = dc.Simulator(scene, solver=dc.PGS(sweeps=8))
    run.step(5)
    before = run.state
    run.set(**SETS[name])
    expected = vars(before.world) | SETS[name]
    if len(expected["segments"]) != 2:
        expected["surface_speeds"] = ()
        if "segment_velocities" not in SETS[name]:
            expected["segment_velocities"] = ()
    fields = dc.World.__dataclass_fields__
    assert run.state.world == dc.World(**{field: expected[field] for field in fields})
    assert (run.state.dt, run.state.step, run.state.bodies) == (before.dt, before.step, before.bodies)
    run.step(3)
    assert run.state.world.surface_speeds == dc.World(**{field: expected[field] for field in fields}).surface_speeds


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("end", range(4))
def test_a_wall_that_becomes_fast_is_divided_whichever_of_its_ends_moves_and_whereto(end, sign):
    """A preset chose the substeps for a slower wall; velocities up to that are set in place."""
    velocity = np.zeros(4)
    velocity[end] = 0.1
    world = dc.World(box=(-9.0, -9.0, 9.0, 9.0), segments=[((0, -2), (0, 2))], segment_velocities=[velocity])
    scene = dc.State(name="wall", world=world, bodies=dc.make_bodies([[0.5, 0.0]], radius=0.1))
    run = dc.Simulator(scene, accuracy="fast")
    slow, inputs = run.state.solver.substeps, run._inputs
    run.set(segment_velocities=[-velocity])
    assert run._inputs is inputs
    run.set(segment_velocities=[sign * 400.0 * velocity])
    assert run.state.solver.substeps > slow
    assert run.state.world.segment_velocities == (tuple(sign * 400.0 * velocity),)


ROLLERS = np.array([True, False, True, False, False])


def rollers(**world):
    """Two fixed circles, 0 and 2, with discs on them."""
    places = [[5.0, 3.0], [4.0, 5.0], [8.0, 3.0], [6.5, 5.2], [8.5, 5.5]]
    return circles_at(places, fixed=ROLLERS, box=(-9.0, 0.0, 22.0, 20.0), friction=0.5, **world)


ASLEEP = pytest.param({"sleep": True}, marks=pytest.mark.slow)


@pytest.mark.parametrize("how", [{"solver": dc.PGS(sweeps=8)}, {"solver": dc.BatchedPGS(sweeps=8)}, ASLEEP])
@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_motions_of_fixed_circles_that_are_set_are_those_of_a_state_that_has_them(how, restitution):
    state = rollers(restitution=restitution)
    live = dc.Simulator(state, **({"solver": dc.PGS(sweeps=8)} | how))
    for k in range(60):
        velocity, spin = np.array([[0.02 * k, 0.1], [-0.3, 0.0]]), np.array([-0.3 * k, 2.0])
        live.set(fixed_velocities=velocity, fixed_spins=spin)
        before = live.state
        np.testing.assert_array_equal(before.bodies.velocity[ROLLERS], velocity)
        np.testing.assert_array_equal(before.bodies.spin[ROLLERS], spin)
        live.step()
        if "sleep" not in how:
            state_velocity, state_spin = state.bodies.velocity.copy(), state.bodies.spin.copy()
            state_velocity[ROLLERS], state_spin[ROLLERS] = velocity, spin
            bodies = state.bodies._replace(velocity=state_velocity, spin=state_spin)
            state = dc.simulate(state.replace(bodies=bodies), steps=1, **how).state
            assert live.state == state
    assert np.abs(live.state.bodies.spin[~ROLLERS]).max() > 0.5  # they turn what lies on them


def test_one_value_is_for_all_fixed_circles_and_the_other_stays():
    live = dc.Simulator(rollers(), solver=dc.PGS(sweeps=8))
    live.set(fixed_velocities=(1.0, 0.5))
    live.set(fixed_spins=3.0)
    assert live.velocities[ROLLERS].tolist() == [[1.0, 0.5]] * 2
    assert live.state.bodies.spin[ROLLERS].tolist() == [3.0, 3.0]
    live.set(fixed_spins=[1.0, -1.0], gravity=(0.0, -5.0))
    assert live.velocities[ROLLERS].tolist() == [[1.0, 0.5]] * 2
    assert live.state.bodies.spin.tolist()[::2][:2] == [1.0, -1.0]
    assert live.state.world.gravity == (0.0, -5.0)
    live.step(10)
    np.testing.assert_allclose(live.positions[0], [5.1, 3.05])


def test_a_disc_between_two_rollers_turns_with_their_surfaces():
    """ω r = −Ω R, from any spin before."""
    live = dc.Simulator(circles_at([[5.0, 3.0], [8.0, 3.0], [6.5, 4.4]], fixed=np.arange(3) < 2, friction=0.5))
    for spin in (2.0, -3.0):
        live.set(fixed_spins=spin)
        live.step(400)
        assert live.state.bodies.spin[2] == pytest.approx(-spin, rel=1e-6)
        np.testing.assert_allclose(live.positions[2], [6.5, 3.0 + np.sqrt(4.0 - 1.5**2)], atol=0.02)


def test_a_preset_decides_anew_for_a_fixed_circle_that_becomes_fast_and_not_for_a_slower_one():
    start = rollers()
    bodies = start.bodies._replace(velocity=np.where(ROLLERS[:, None], [0.5, 0.0], 0.0))
    live = dc.Simulator(start.replace(bodies=bodies), accuracy="fast")
    slow, inputs = live.state.solver.substeps, live._inputs
    live.set(fixed_velocities=[[-0.3, 0.4], [0.0, 0.0]])
    assert live._inputs is inputs
    live.set(fixed_velocities=(100.0, 0.0))
    assert live.state.solver.substeps > slow
    assert live.velocities[ROLLERS].tolist() == [[100.0, 0.0]] * 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"fixed_velocities": 1.0},
            r"fixed_velocities: expected a finite pair, m/s, for all .* each of the 2, got 1.0",
        ),
        ({"fixed_velocities": [[1.0, 2.0]] * 3}, "fixed_velocities: expected"),
        ({"fixed_spins": [1.0, np.nan]}, "fixed_spins: expected a finite number, rad/s"),
        ({"fixed_spins": "fast"}, "fixed_spins: expected"),
        ({"fixed_velocities": (1e11, 0.0)}, r"bodies\.velocity\[0, 0\]: expected -1e\+10 to 1e\+10 m/s"),
        ({"fixed_spins": 1e11, "gravity": (0.0, 0.0)}, r"bodies\.spin\[0\]: expected"),
    ],
)
def test_motions_of_fixed_circles_that_cannot_be_are_refused(change, message):
    live = dc.Simulator(rollers(), solver=dc.PGS(sweeps=8))
    before = live.state
    with pytest.raises(ValueError, match=message):
        live.set(**change)
    assert live.state == before
    with pytest.raises(ValueError, match="fixed_spins: expected"):
        dc.Simulator(dc.column(1)).set(fixed_spins=1.0)  # none is fixed


def test_time_goes_on_by_each_step_of_its_own():
    run = dc.Simulator(dc.column(2), solver=dc.PGS(sweeps=8))
    run.step(10)
    run.set(dt=0.02)
    run.step(5)
    assert run.time == run.state.time == pytest.approx(0.2)
    run.set(dt=0.004)
    run.step(5)
    assert run.time == pytest.approx(0.22)
    assert dc.simulate(run.state, steps=5, dt=0.01).state.time == pytest.approx(0.27)
    late = dc.simulate(dc.column(2).replace(time=3.0), steps=7, solver=dc.PGS(sweeps=8)).state
    assert (late.time, late.step) == (pytest.approx(3.07), 7)


def test_a_push_ends_where_its_caller_drops_it_and_another_takes_its_place():
    """m Δv = F Δt of a ball in flight, whatever call or set comes between."""
    scene = circles_at([[5.0, 50.0]], radius=0.5, box=(-99, 0, 99, 99), gravity=(0, 0)).replace(solver=dc.PGS(sweeps=8))
    east, north = np.array([[3.0, 0.0]]), np.array([[0.0, 2.0]])
    mass, gained = scene.bodies.mass[0], np.zeros(2)
    state = scene
    for push, force in ((east, east), (None, 0 * east), (lambda state: north, north), (None, 0 * east), (east, east)):
        state = dc.simulate(state, steps=10, push=push).state
        gained = gained + 0.1 * np.ravel(force)
        np.testing.assert_allclose(mass * state.bodies.velocity[0], gained, atol=1e-12)
        assert (state.push is None) == (push is None or callable(push))
    run, gained = dc.Simulator(scene, push=east), np.zeros(2)
    for change, force in (
        ({}, east),
        ({"push": north}, north),
        ({"gravity": (0.0, 0.0)}, north),
        ({"push": 0 * east}, 0 * east),
    ):
        run.set(**change)
        run.step(10)
        gained = gained + 0.1 * np.ravel(force)
        np.testing.assert_allclose(mass * run.velocities[0], gained, atol=1e-12)


def test_circles_come_and_go(pile):
    run, more = dc.Simulator(pile[0], **pile[1]), dc.make_bodies([[8.0, 9.0], [22.0, 9.0]], radius=0.5)
    run.step(40)
    state = run.state.with_bodies(add=more).with_bodies(remove=[0])
    run.add(more)
    run.remove([0])
    assert run.positions.shape == (5, 2)
    run.step(10)
    assert run.state == dc.simulate(state, steps=10, **pile[1]).state


def test_it_pickles_by_its_state(pile):
    run = dc.Simulator(pile[0], **pile[1])
    run.step(30)
    again = pickle.loads(pickle.dumps(run))
    for one in (run, again):
        one.step(10)
    assert again.state == run.state


def test_a_start_that_fails_leaves_the_last_whole_step(pile):
    def start(state, solver):
        if state.step == 30 and not failed:
            failed.append(state.step)
            raise RuntimeError("no start")
        return np.zeros(state.contacts.count), np.zeros(state.contacts.count)

    failed: list = []
    run = dc.Simulator(pile[0], **pile[1], warm_start=start)
    with pytest.raises(RuntimeError, match="no start"):
        run.step(50)
    assert run.state.step == 30
    run.step(20)
    assert run.state == dc.simulate(pile[0], steps=50, **pile[1], warm_start=start).state


@pytest.mark.parametrize("error", [KeyboardInterrupt, FloatingPointError])
@pytest.mark.parametrize("way", ["fast", "no start", "asleep", "rebounds", "batches"])
def test_a_step_that_is_interrupted_or_diverges_leaves_the_last_whole_step(way, error, monkeypatch):
    world, how = WAYS[way]
    # Two discs that rub on a slope, beside two that come to rest on one another.
    centres, slope = [[4.0, 4.3], [6.2, 3.8], [12.0, 1.0], [12.0, 3.0]], [((0.0, 4.5), (10.0, 0.0))]
    scene = circles_at(centres, **{"friction": 0.6, "segments": slope} | world)
    run = dc.Simulator(scene, **how)
    run.step(45)
    before, steps = run.state, run._steps
    still = steps.sleep and steps.sleep.still.copy()
    assert way == "rebounds" or np.abs(before.contacts.tangent_impulse).max() > 1e-3

    def broken(*arguments):
        """Steps that are done, and then lost."""
        result = type(steps).__call__(steps, *arguments)
        if error is KeyboardInterrupt:
            raise error
        run._scene.bodies.position[1], arguments[2].progress[FINITE] = np.nan, False
        return result

    broken.sleep = steps.sleep
    monkeypatch.setattr(run, "_steps", broken)
    with pytest.raises(error):
        run.step(20)  # in which the two that rest have been still for long enough
    monkeypatch.setattr(run, "_steps", steps)
    assert run.state == before
    if steps.sleep:
        np.testing.assert_array_equal(steps.sleep.still, still)
    run.step(15)
    assert run.state == dc.simulate(scene, steps=60, **how).state


def test_a_first_step_that_is_interrupted_leaves_impulses_that_are_not_those_from_which_it_starts(pile, monkeypatch):
    # Later steps start from the impulses of the last one, so that only the first step has to copy both.
    state = dc.simulate(pile[0], steps=30, **pile[1]).state
    contacts = state.contacts._replace(normal_start=0.5 * state.contacts.normal_start)
    run = dc.Simulator(state.replace(contacts=contacts), **pile[1])
    before, steps = run.state, run._steps
    assert (before.contacts.normal_start < before.contacts.normal_impulse).any()

    def broken(*arguments):
        type(steps).__call__(steps, *arguments)
        raise KeyboardInterrupt

    broken.sleep = steps.sleep
    monkeypatch.setattr(run, "_steps", broken)
    with pytest.raises(KeyboardInterrupt):
        run.step()
    assert run.state == before


def test_a_run_that_is_interrupted_falls_asleep_as_one_that_is_not(monkeypatch):
    scene, how = dc.column(3, friction=0.4), WAYS["asleep"][1]
    run = dc.Simulator(scene, **how)
    run.step(45)
    steps = run._steps

    def broken(*arguments):
        type(steps).__call__(steps, *arguments)
        raise KeyboardInterrupt

    broken.sleep = steps.sleep
    monkeypatch.setattr(run, "_steps", broken)
    with pytest.raises(KeyboardInterrupt):
        run.step(30)
    monkeypatch.setattr(run, "_steps", steps)
    whole = dc.Simulator(scene, **how)
    whole.step(45)
    for _ in range(80):
        run.step()
        whole.step()
        np.testing.assert_array_equal(steps.sleep.still, whole._steps.sleep.still)


def test_a_step_takes_few_calls_of_python(pile):
    # Some hundred, with states and types made anew, are what a step of ten circles took twenty times as long by.
    run, calls = dc.Simulator(pile[0], **pile[1]), []
    for _ in range(OFTEN + 1):  # until types are known
        run.step()
    sys.setprofile(lambda frame, event, argument: calls.append(event) if event == "call" else None)
    try:
        run.step()
    finally:
        sys.setprofile(None)
    assert len(calls) < 25


def test_types_are_looked_at_once_and_only_of_what_is_called_often():
    # It takes longer than all else of `dc.step`, whose functions are called once.
    class Function:
        looks, overloads = 0, {("int",): SimpleNamespace(entry_point=lambda x: -x)}

        def __call__(self, x):
            return x

        def typeof_pyval(self, x):
            self.looks += 1
            return type(x).__name__

    function = Function()
    direct = Direct(function)
    assert [direct(k) for k in range(OFTEN - 1)] == list(range(OFTEN - 1))
    assert function.looks == 0
    assert [direct(3), direct(4), direct(5)] == [3, -4, -5]
    assert function.looks == 1
