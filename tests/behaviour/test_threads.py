"""Any public function from any number of threads gives the bits that it gives alone."""

import inspect
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, is_dataclass
from functools import cache

import numpy as np
import pytest

import deep_contact as dc
from deep_contact import sph
from deep_contact.accuracy import presets
from deep_contact.cnn.dataset import Store, simulation_path
from deep_contact.io.simulation_h5 import write_simulation
from deep_contact.starts.names import STARTS
from deep_contact.state.arrays import SIDES
from deep_contact.studies.starts import solved_states

THREADS, SCENES, PGS = 8, 4, dc.PGS(sweeps=5)
WORLD = dc.World(box=(0.0, 0.0, 12.0, 12.0), segments=[((0, 3), (6, 1)), ((6, 1), (12, 3))], friction=0.4)


def scene(i):
    """Circles of their own radius, in one world for all threads."""
    place = np.random.default_rng(i).permutation(36)[: 14 + i]
    centres = np.column_stack([1.2 + 1.9 * (place % 6), 3.8 + 1.4 * (place // 6)])
    bodies = dc.make_bodies(centres, radius=0.5 + 0.05 * i, velocity=(1.0, -2.0))
    return dc.State(name=f"scene {i}", world=WORLD, bodies=bodies, solver=PGS)


@cache
def states():
    return [dc.simulate(scene(i), steps=60).state for i in range(SCENES)]


@cache
def boxes():
    boxes = [dc.circles_in_box(20 + i, size=30.0, seed=i) for i in range(SCENES)]
    return [dc.simulate(box, steps=150, solver=PGS).state for box in boxes]


@cache
def models():
    return {name: dc.load_model(name) for name in ("far field", "far field, no past", "models/model.h5")}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A state, a run and its solved states of each scene, and a trade."""
    folder = tmp_path_factory.mktemp("threads")
    for i in range(SCENES):
        dc.write_state(folder / f"{i}.xml", states()[i])
        dc.simulate(scene(i), steps=30, record=10).trajectory.save(folder / f"{i}.h5")
        write_simulation(simulation_path(folder, i), solved_states(scene(i), steps=60, solver=PGS, every=10))
    dc.measure_trade(dc.column(2), steps=20, seeds=1, settings=[]).save(folder / "trade.json")
    return folder


@pytest.fixture(scope="module")
def calls(folder):
    """What is called -> a function of the number of a scene."""
    grid, store, one = sph.Grid.over_box(WORLD.box, 0.5), Store(folder, cache_bytes=0), folder / "one.xml"
    places = [state.bodies.position for state in states()]

    def of(name, *arguments, **options):
        return lambda i: getattr(dc, name)(*(each[i] for each in arguments), **options)

    calls = {f"simulate, {start}": of("simulate", boxes(), steps=3, warm_start=start) for start in STARTS}
    for name, model in models().items():
        calls[f"solve_contacts, {name}"] = of("solve_contacts", boxes(), start=model)
        calls[f"predict, {name}"] = lambda i, model=model: model.predict(boxes()[i])
    scenes, several, few = list(map(scene, range(SCENES))), range(8, 8 + SCENES), {"steps": 20, "seeds": 1}
    calls |= {name: of(name, several) for name in ("barrel", "column", "drum", "hopper", "terrain", "drifting_circles")}
    calls |= {name: of(name, several) for name in ("circles_in_box", "lattice_in_box")}
    calls |= {name: of(name) for name in ("single_body", "two_bodies", "sample_file")}
    calls |= {
        name: of(name, states()) for name in ("forces", "stress", "coordination", "contact_table", "solve_exactly")
    }
    calls |= {name: of(name, scenes) for name in ("find_contacts", "plan", "recommend")}
    return calls | {
        "simulate": of("simulate", scenes, steps=10, record=2, forces=True, accuracy="accurate"),
        "BatchedPGS": of("simulate", states(), steps=5, solver=dc.BatchedPGS()),
        "simulate_many": lambda i: dc.simulate_many(states()[i:], steps=3),
        "solve_contacts": of("solve_contacts", states(), start="copy"),
        "step": of("step", states()),
        "force_bounds": of("force_bounds", states(), contacts=[0, 1]),
        "decide": lambda i: presets.decide(scenes[i], None),
        "measure_trade": lambda i: [row["errors"] for row in dc.measure_trade(scenes[i], settings=[], **few).rows],
        "load_trade": lambda i: str(dc.load_trade(folder / "trade.json")),
        "load_model": lambda i: dc.load_model("far field, no past").predict(boxes()[i]),
        "read_state": lambda i: dc.read_state(folder / f"{i}.xml"),
        "write_state": lambda i: [dc.write_state(one, states()[0]), dc.read_state(one)][1],
        "load_trajectory": lambda i: dc.load_trajectory(folder / f"{i}.h5")[1],
        "Store": lambda i: store.state(i, 0),
        "mean_stress": of("mean_stress", states(), spacing=2.0),
        "neighbours": of("neighbours", states(), range(SCENES)),
        "force_on": lambda i: dc.simulate(scenes[i], steps=9, record=3, forces=True).force_on(SIDES[i]),
        "transfer": lambda i: sph.gather(grid, sph.splat(grid, places[i], places[i], h=0.7), places[i]),
        "make_bodies": of("make_bodies", places),
        "film": lambda i: dc.film([states()[i]], folder / f"{i}.gif", size=64).read_bytes(),
    }


def bits(value):
    """All that a result holds, arrays by their bytes."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if is_dataclass(value):
        return [bits(getattr(value, field.name)) for field in fields(value)]
    if isinstance(value, (tuple, list)):
        return [bits(one) for one in value]
    return {name: bits(one) for name, one in value.items()} if isinstance(value, dict) else repr(value)


def differing(calls, count, least):
    """Functions that give other bits, or fail, in one of so many calls from 8 threads; `least` of the dear one."""
    names, before = [], sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(THREADS) as pool:
            for name, call in calls.items():
                alone = [bits(call(i)) for i in range(SCENES)]
                several = least if name == "measure_trade" else count
                tasks = [pool.submit(lambda i=k % SCENES, call=call: bits(call(i))) for k in range(several)]
                seen = [task.exception() or task.result() == alone[k % SCENES] for k, task in enumerate(tasks)]
                names += [(name, one) for one in seen if one is not True][:1]
    finally:
        sys.setswitchinterval(before)
    return names


def test_every_function_gives_in_8_threads_what_it_gives_alone(calls):
    assert differing(calls, THREADS, least=2) == []
    public = {name for name in dc.__all__ if inspect.isfunction(getattr(dc, name))}
    assert public - calls.keys() == set()


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_200_calls_of_every_function_in_each_of_8_threads_give_what_they_give_alone(calls):
    assert differing(calls, 200 * THREADS, least=THREADS) == []
