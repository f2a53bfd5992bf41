"""Many scenes at once: each as if it ran alone."""

import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.run import many_scenes, method

SCENES = [dc.lattice_in_box(20 + 7 * k, seed=k, gap=0.05) for k in range(6)] + [dc.column(4), dc.single_body()]


@pytest.mark.parametrize(
    ("threads", "options"),
    [
        *((threads, {"solver": dc.PGS(sweeps=15)}) for threads in (1, 2, 5)),
        (None, {}),
        (None, {"accuracy": "preview"}),
        (None, {"dt": 0.005, "warm_start": None}),
        (None, {"sleep": True, "record": 10, "solver": dc.PGS(sweeps=10)}),
        (None, {"solver": dc.BatchedPGS(sweeps=10)}),
    ],
)
def test_each_run_is_what_it_is_alone(threads, options):
    assert dc.simulate_many([], steps=60, threads=threads, **options) == []
    for scene, many in zip(SCENES, dc.simulate_many(iter(SCENES), steps=60, threads=threads, **options), strict=True):
        one = dc.simulate(scene, steps=60, **options)
        assert one.state == many.state
        for name in ("contacts", "sweeps", "theta", "relaxations"):
            np.testing.assert_array_equal(getattr(one, name), getattr(many, name))
        assert (many.recorded is None) == ("record" not in options)
        if many.recorded is not None:
            np.testing.assert_array_equal(one.trajectory.positions, many.trajectory.positions)


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_an_executor_runs_them_to_the_same_bits_and_its_errors_name_the_state(kind):
    with kind(2) as executor:
        runs = dc.simulate_many(SCENES[:3], steps=20, jobs=executor)
        assert [run.state for run in runs] == [dc.simulate(scene, steps=20).state for scene in SCENES[:3]]
        broken = SCENES[1].replace(bodies=SCENES[1].bodies._replace(mass=-SCENES[1].bodies.mass))
        with pytest.raises(ValueError, match=r"states\[1\]: bodies.mass"):
            dc.simulate_many([SCENES[0], broken], steps=20, jobs=executor)
    with pytest.raises(ValueError, match="threads: expected none beside jobs, got 2"):
        dc.simulate_many(SCENES, threads=2, jobs=2)


def test_scenes_run_on_so_many_threads_at_a_time(monkeypatch):
    both = threading.Barrier(2, timeout=30)
    monkeypatch.setattr(many_scenes, "_simulate", lambda *_, **__: (both.wait(), threading.get_ident())[1])
    assert len(set(dc.simulate_many(SCENES[:2], threads=2))) == 2
    monkeypatch.setattr(many_scenes, "_simulate", lambda *_, **__: threading.get_ident())
    assert len(set(dc.simulate_many(SCENES, threads=1))) == 1


def test_the_others_stop_where_one_fails(monkeypatch):
    begun, ended = threading.Event(), []

    def run(state, options, stopped):
        if state is SCENES[0]:
            begun.wait(30)
            raise ValueError("bad")
        begun.set()
        ended.append(stopped.wait(30))

    monkeypatch.setattr(many_scenes, "_simulate", run)
    with pytest.raises(ValueError, match=r"states\[0\]: bad"):
        dc.simulate_many(SCENES[:2], threads=2)
    assert ended == [True]


def test_a_stopped_run_ends():
    stopped = threading.Event()
    stopped.set()
    with pytest.raises(KeyboardInterrupt):
        many_scenes._simulate(SCENES[0], method.RunOptions(steps=5), stopped)
