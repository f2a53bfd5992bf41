"""The interface of the engine: a changed time step, and what callers may hand over."""

import gc
import re
import threading
import tracemalloc
import warnings
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from conftest import assert_same_bits, circles_at

import deep_contact as dc
from deep_contact.run import last_run, simulator
from deep_contact.starts.changed_load import with_time_step

MOTION = dc.PGS(sweeps=8, substeps=2, most_substeps=8)


@pytest.fixture(scope="module")
def pile():
    """A pile at rest."""
    return dc.simulate(dc.lattice_in_box(36, seed=1), steps=400, solver=dc.PGS(sweeps=50, tolerance=None)).state


@pytest.mark.parametrize("dt", [0.05, 0.001])
def test_a_change_of_the_time_step_does_not_kick_a_pile_at_rest(pile, dt):
    # Box2D scales carried impulses by dtRatio: m g Δt has another Δt. Unscaled, this pile jumps at 0.09 to 2 m/s.
    solver = dc.PGS(sweeps=10, tolerance=None)
    after = dc.simulate(pile, steps=1, dt=dt, solver=solver).state.bodies
    kicked = dc.simulate(pile.replace(dt=dt, load=None), steps=1, solver=solver).state.bodies
    before = np.abs(pile.bodies.velocity).max()
    assert np.abs(after.velocity).max() < before + 0.005
    assert np.abs(kicked.velocity).max() > before + 0.05


def test_a_scaled_start_carries_the_weight_of_the_new_step():
    # λ_n = m g Δt under a resting circle (Eq 2.29), so the start has to be right before any sweep.
    state = dc.simulate(dc.single_body(), steps=20).state
    start = with_time_step(state, 0.03).contacts.normal_start
    np.testing.assert_allclose(start, np.pi * 9.81 * 0.03, rtol=1e-9)
    assert with_time_step(state, state.dt).contacts is state.contacts


@pytest.mark.parametrize(("n", "options"), [(150, {"sigma_coef": 0.5}), (400, {"sigma_coef": 9.0})])
def test_the_suggested_size_has_room(n, options):
    with pytest.raises(ValueError, match="has room for all") as refusal:
        dc.circles_in_box(n, size=20, **options)
    size = float(re.search("size=([0-9.]+)", str(refusal.value))[1])
    assert dc.circles_in_box(n, size=size, **options).bodies.count == n


def test_circles_that_nearly_coincide_are_said_once():
    positions = [[5.0, 5.0], [5.05, 5.0], [8.0, 5.0], [8.0, 5.09], [9.5, 5.0]]
    with pytest.warns(UserWarning, match=r"circles 0 and 1 nearly coincide, .* 0.05 m apart \(2 pairs do\)") as said:
        run = dc.simulate(circles_at(positions), steps=3)
    assert len(said) == 1
    assert said[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dc.step(run.state)
        dc.step(dc.circles_in_box(20, seed=1))


def test_circles_outside_of_the_box_are_said_once_and_come_in():
    scene = circles_at([[5.0, 5.0], [35.0, 5.0], [5.0, 31.0]])
    with pytest.warns(
        UserWarning, match=r"circle 1 lies outside of the box .*, at \(35, 5\) m \(2 circles do\)"
    ) as said:
        run = dc.simulate(scene, steps=1)
    assert len(said) == 1
    assert said[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # what is still outside in a run that goes on was said
        x, y = dc.simulate(run.state, steps=20).state.bodies.position.T
    assert x.max() < 30
    assert y.max() < 30


@pytest.mark.parametrize("options", [{}, {"warm_start": "sph"}, {"sleep": True}])
def test_a_recorded_run_keeps_one_state_in_so_many_steps_and_the_last_and_changes_no_bit(options):
    scene = dc.circles_in_box(12, size=10.0, seed=2)
    plain, run = dc.simulate(scene, steps=65, **options), dc.simulate(scene, steps=65, record=10, **options)
    np.testing.assert_allclose(run.trajectory.times, [*np.arange(0.0, 0.64, 0.1), 0.65], atol=1e-12)
    assert run.trajectory[-1] == run.state == plain.state
    assert run.trajectory[5].bodies == dc.simulate(scene, steps=50, **options).state.bodies
    with pytest.raises(ValueError, match="trajectory: expected"):
        plain.trajectory  # noqa: B018


def test_a_recorded_state_costs_a_copy_and_no_digest(monkeypatch):
    scene = dc.simulate(dc.lattice_in_box(400, seed=1), steps=100).state
    dc.simulate(scene, steps=1, record=1)  # so that all is compiled, for whose cache Numba makes digests
    monkeypatch.setattr("hashlib.sha256", None)
    tracemalloc.start()
    run = dc.simulate(scene, steps=50, record=1)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    state = sum(array.nbytes for part in (run.state.bodies, run.state.contacts) for array in part)
    assert 25 * state < held < 60 * state


def test_ctrl_c_is_answered_between_short_runs_of_steps(monkeypatch):
    # Compiled code is not interrupted, so no call of it may do more than `_WORK` relaxations and one step.
    scene, calls = dc.simulate(dc.lattice_in_box(400, seed=1), steps=30).state, []
    solver = dc.PGS(sweeps=100, tolerance=None)

    class Watched(simulator.Steps):
        def __call__(self, given, contacts, log, problem=None):
            found = super().__call__(given, contacts, log, problem)
            calls.append(log.relaxations[: log.progress[0]])
            return found

    monkeypatch.setattr(simulator, "Steps", Watched)
    dc.simulate(scene, steps=1200, solver=solver)
    assert sum(call.size for call in calls) == 1200
    assert max(call[:-1].sum() for call in calls) < simulator.MOST_WORK


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_memory_kept_between_calls_changes_no_bit(monkeypatch, friction):
    # From the second call on, a run without friction has no tangents left to sweep, and other memory.
    scene = dc.simulate(dc.lattice_in_box(60, seed=1), steps=60, solver=dc.PGS(sweeps=10)).state
    scene = scene.replace(world=dc.World(box=scene.world.box, friction=friction))
    monkeypatch.setattr(simulator, "MOST_WORK", 0)  # every step is a call
    found = dc.simulate(scene, steps=12)
    for theta in found.theta:
        run = dc.simulate(scene, steps=1)
        scene = run.state
        assert run.theta[0] == theta
    assert found.state == scene


WATCHES = {
    "record": {"record": 3},
    "forces": {"record": 3, "forces": True},
    "on_step": {"on_step": lambda state, record: None},
    "until": {"until": lambda state: False},
    "all": {"record": 3, "forces": True, "on_step": lambda state, record: None, "until": lambda state: False},
}


@pytest.mark.parametrize("watch", WATCHES)
@pytest.mark.parametrize("solver", [dc.PGS(sweeps=8), dc.BatchedPGS(sweeps=8), MOTION], ids=str)
def test_watching_changes_nothing(watch, solver):
    scenes = dc.drum(20), dc.lattice_in_box(20, restitution=0.4, seed=2), dc.hopper(30)
    for scene, start in product(scenes, ("builtin", None, "scaled", "support", "copy")):
        plain = dc.simulate(scene, steps=80, dt=0.03, solver=solver, warm_start=start)
        watched = dc.simulate(scene, steps=80, dt=0.03, solver=solver, warm_start=start, **WATCHES[watch])
        assert_same_bits(plain.state, watched.state)
        np.testing.assert_array_equal(plain.theta, watched.theta)


def test_what_is_not_the_runs_cannot_be_written_into():
    shown = []
    see = lambda state, *record: shown.append(state)  # noqa: E731
    options = {"record": 5, "forces": True, "on_step": see, "until": see}
    run = dc.simulate(dc.column(3), steps=20, solver=dc.PGS(), **options)
    for state in (*shown, *run.trajectory, *run.solved):
        for array in (*state.bodies, *state.contacts):
            with pytest.raises(ValueError, match="read-only"):
                array[:] = 0
    run.state.bodies.velocity[:] = 0.0  # it is the caller's


def test_a_run_without_warm_start_leaves_impulses_that_are_kept():
    state = dc.simulate(dc.lattice_in_box(20, seed=1), steps=200, solver=dc.PGS(), warm_start=None).state
    carried = state.contacts.normal_impulse
    assert carried.max() > 0.1
    np.testing.assert_array_equal(dc.find_contacts(state).contacts.normal_impulse, carried)
    kept = state.with_bodies(add=dc.make_bodies([[15.0, 29.0]])).contacts
    np.testing.assert_array_equal(kept.normal_impulse[: len(carried)], carried)


def test_a_run_ends_where_it_is_told_to_and_is_called_once_a_step_whatever_divides_it():
    scene, solver, called = dc.column(2, friction=0.3), dc.PGS(sweeps=5, substeps=4), []
    on_step = lambda *solved: called.append(solved[0].time)  # noqa: E731
    run = dc.simulate(scene, solver=solver, until=lambda state: state.step == 7, record=5, on_step=on_step)
    assert run.state == dc.simulate(scene, steps=7, solver=solver).state
    assert run.sweeps.shape == run.theta.shape == (7,)
    assert [round(time, 6) for time in run.trajectory.times] == [0.0, 0.05, 0.07]
    assert [round(time, 6) for time in called] == [0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06]


def test_impulses_that_were_found_for_other_contacts_are_those_that_push():
    """Where a contact goes, a solved state is one no more: its impulses are its starts, of which none pulls."""
    state = dc.find_contacts(circles_at([[5.0, 1.0], [9.0, 1.0], [9.0, 2.9]], dt=0.01))
    starts = np.array([-1.0, 2.0, 3.0])
    contacts = state.contacts._replace(normal_start=starts, normal_impulse=np.full(3, 7.0))
    solved = state.replace(contacts=contacts, solved=True)
    pairs = list(zip(contacts.body_a, contacts.body_b))
    gone = dc.find_contacts(solved.replace(bodies=dc.make_bodies([[5.0, 1.0], [9.0, 1.0], [9.0, 9.0]]))).contacts
    kept = [k for k, pair in enumerate(pairs) if pair in set(zip(gone.body_a, gone.body_b))]
    assert len(kept) == 2
    np.testing.assert_array_equal(gone.normal_start, starts[kept])
    np.testing.assert_array_equal(gone.normal_impulse, np.maximum(starts[kept], 0.0))
    np.testing.assert_array_equal(dc.find_contacts(solved).contacts.normal_impulse, 7.0)


PAST = {
    "positions": (lambda scene: scene, True),
    "contacts at step 0": (lambda scene: dc.find_contacts(scene), True),
    "positions of a later step": (lambda scene: scene.replace(step=5), True),
    "contacts of a later step": (lambda scene: dc.find_contacts(scene).replace(step=5), False),
}
"""What a run may begin from -> the state, and whether it has no past."""


@pytest.mark.parametrize("name", PAST)
def test_a_state_without_a_past_gets_one(name, monkeypatch):
    made, (change, has_none) = [], PAST[name]
    monkeypatch.setattr(simulator, "with_a_past", lambda state: made.append(state) or state)
    state = change(dc.column(2))
    for options in ({"accuracy": "fast"}, {"solver": dc.PGS()}, {"accuracy": "fast"} | {"steps": 0}):
        dc.simulate(state, **{"steps": 0} | options)
    assert len(made) == 2 * has_none  # not where the solver is the caller's
    if has_none and state.contacts is not None:
        start = np.ones(state.contacts.count)
        dc.simulate(state.replace(contacts=state.contacts._replace(normal_start=start)), steps=0)
        assert len(made) == 2


# ---- a call that goes on from the state of the call before ----


def nothing(state):
    return {}


def faster(state):
    state.bodies.velocity[0] += 1.0
    return {}


def without_impulses(state):
    state.contacts.normal_start[:] = 0.0
    return {}


GOES_ON = {
    "as it was": (nothing, True),
    "a circle that is faster": (faster, False),
    "no impulses": (without_impulses, False),
    "another solver": (lambda state: {"accuracy": None, "solver": dc.PGS(sweeps=3, tolerance=None)}, False),
    "another preset": (lambda state: {"accuracy": "reference"}, False),
    "the solver of the state": (lambda state: {"accuracy": None}, False),
    "from zero": (lambda state: {"warm_start": None, "accuracy": None}, False),
    "another step": (lambda state: {"dt": 0.005}, False),
    "another world": (lambda state: {"state": state.replace(world=replace(state.world, gravity=(0.0, -5.0)))}, False),
    "a push": (lambda state: {"push": np.ones((state.bodies.count, 2))}, False),
    "asleep": (lambda state: {"sleep": True}, False),
}
"""What a caller does between two calls -> changes a state in place, and returns arguments; whether the run goes on."""


@pytest.mark.parametrize("name", GOES_ON)
def test_a_call_that_takes_over_the_run_before_it_gives_the_bits_of_one_that_does_not(name):
    """It compares arrays, since they can be written into."""
    change, goes_on = GOES_ON[name]
    pile = dc.simulate(dc.circles_in_box(12, size=10.0, seed=1), steps=60, accuracy="fast").state
    how = {"state": pile, "steps": 3, "accuracy": "fast"} | change(pile)
    reference, _, before = last_run._last_run.kept
    assert reference() is pile
    run = dc.simulate(**how)
    assert (before.time > pile.time) == goes_on
    last_run._last_run.kept = None
    again = dc.simulate(**how)
    assert_same_bits(run.state, again.state)
    assert (run.state.time, run.state.preset, run.state.load) == (
        again.state.time,
        again.state.preset,
        again.state.load,
    )
    np.testing.assert_array_equal(run.sweeps, again.sweeps)


def test_a_run_that_is_taken_over_starts_awake():
    """As from a state: who sleeps is known within a call only."""
    state = dc.simulate(dc.column(2), steps=200, solver=dc.PGS(), sleep=True).state
    assert dc.simulate(state, steps=1, solver=dc.PGS(), sleep=True).contacts[0] == 2


def test_a_loop_of_calls_takes_over_one_run_and_lets_it_go_with_its_state():
    state = dc.simulate(dc.column(3), steps=1, solver=dc.PGS()).state
    run = last_run._last_run.kept[2]
    for _ in range(5):
        state = dc.step(state, solver=dc.PGS())
        assert last_run._last_run.kept[2] is run
    other = dc.simulate(dc.column(2), steps=1).state  # the state of before is of no call's run now
    assert last_run._last_run.kept[0]() is other
    assert_same_bits(dc.simulate(dc.column(3), steps=8, solver=dc.PGS()).state, dc.simulate(state, steps=2).state)
    other = None
    assert dc.simulate(dc.column(2), steps=1).sweeps.size == 1  # whose state nobody keeps
    gc.collect()
    assert last_run._last_run.kept is None


def test_two_threads_take_over_their_own_runs():
    state, ends, kept = dc.simulate(dc.column(3), steps=20, solver=dc.PGS()).state, {}, {}

    def go_on(name):
        kept[name] = last_run._last_run.kept
        ends[name] = dc.simulate(state, steps=20, solver=dc.PGS()).state

    threads = [threading.Thread(target=go_on, args=(name,)) for name in range(2)]
    for thread in threads:
        thread.start()
    go_on("here")
    for thread in threads:
        thread.join()
    assert [name for name in kept if kept[name]] == ["here"]
    for end in ends.values():
        assert_same_bits(end, ends["here"])
