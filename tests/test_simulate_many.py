"""Many scenes at once: each as if it ran alone."""

import threading

import numpy as np
import pytest

import deep_contact as dc
from deep_contact import simulation

SCENES = [dc.lattice_in_box(20 + 7 * k, seed=k, gap=0.05) for k in range(6)] + [dc.column(4), dc.single_body()]


@pytest.mark.parametrize("threads", [1, 2, 5, None])
def test_each_run_is_what_it_is_alone(threads):
    options = {"steps": 60, "solver": dc.PGS(sweeps=15)}
    assert dc.simulate_many([], threads=threads, **options) == []
    for scene, many in zip(SCENES, dc.simulate_many(SCENES, threads=threads, **options), strict=True):
        one = dc.simulate(scene, **options)
        assert one.state == many.state
        assert one.contacts.max() > 0
        for name in ("contacts", "sweeps", "theta", "relaxations"):
            np.testing.assert_array_equal(getattr(one, name), getattr(many, name))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"accuracy": "preview"},
        {"dt": 0.005, "warm_start": None},
        {"sleep": True, "record": 10, "solver": dc.PGS(sweeps=10)},
        {"solver": dc.BatchedPGS(sweeps=10)},
    ],
)
def test_options_are_those_of_simulate(options):
    many = dc.simulate_many(iter(SCENES[:3]), steps=25, **options)
    for scene, run in zip(SCENES[:3], many, strict=True):
        one = dc.simulate(scene, steps=25, **options)
        assert one.state == run.state
        assert (run.recorded is None) == ("record" not in options)
        if run.recorded is not None:
            np.testing.assert_array_equal(one.trajectory.positions, run.trajectory.positions)


@pytest.mark.parametrize(
    ("scenes", "options", "message"),
    [
        (SCENES[:2], {"warm_start": "sph"}, "warm_start: expected"),
        (SCENES[:2], {"threads": 0}, "threads: expected"),
        (SCENES[:2], {"steps": -1}, r"states\[0\]: steps: expected"),
        (SCENES[:2], {"solver": dc.BatchedPGS(threads=2)}, "solver: expected"),
        ([SCENES[0], "pile"], {}, "state: expected"),
        ([SCENES[0], SCENES[1].replace(dt=-1.0)], {}, r"^states\[1\]: dt: expected"),
    ],
)
def test_what_cannot_run_many_times_at_once_is_refused(scenes, options, message):
    with pytest.raises(ValueError, match=message):
        dc.simulate_many(scenes, **{"steps": 1} | options)


def test_scenes_run_on_so_many_threads_at_a_time(monkeypatch):
    both = threading.Barrier(2, timeout=30)
    monkeypatch.setattr(simulation, "_simulate", lambda *_, **__: (both.wait(), threading.get_ident())[1])
    assert len(set(dc.simulate_many(SCENES[:2], threads=2))) == 2
    monkeypatch.setattr(simulation, "_simulate", lambda *_, **__: threading.get_ident())
    assert len(set(dc.simulate_many(SCENES, threads=1))) == 1


def test_the_others_stop_where_one_fails(monkeypatch):
    begun, ended = threading.Event(), []

    def run(state, *_, stopped):
        if state is SCENES[0]:
            begun.wait(30)
            raise ValueError("bad")
        begun.set()
        ended.append(stopped.wait(30))

    monkeypatch.setattr(simulation, "_simulate", run)
    with pytest.raises(ValueError, match=r"states\[0\]: bad"):
        dc.simulate_many(SCENES[:2], threads=2)
    assert ended == [True]


def test_a_stopped_run_ends():
    stopped = threading.Event()
    stopped.set()
    with pytest.raises(KeyboardInterrupt):
        simulation._simulate(SCENES[0], 5, None, None, "builtin", None, False, None, stopped=stopped)
