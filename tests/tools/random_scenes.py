"""python tests/tools/random_scenes.py [--scenes 300] [--first 0] [--compiled] [--out FILE]: scenes of all features.

Scene `seed` has 5 to 11 circles of one to four materials, with tables of friction, restitution up to 1, rolling
resistance and touches, and at random moving segments, pegs and rollers, pushes, belts, sleep, no gravity, one of ten
solvers, or a preset. It is run for 30 steps in several ways (`findings`), which have to agree in all bits:

* in two calls of 10 and 20 steps, also through an XML and an HDF5 file;
* by a `Simulator`, step by step, and with `forces=True`;
* by `simulate_many`, between other scenes;
* with the materials relabelled by a permutation.

Islands that sleep wake where a run is divided. With sleep, runs through files are therefore compared with a run in two
calls. Furthermore, contacts must not make energy: between no two states may it be more than 0.5 % of the scene's
energies (`gained`), without belts and without carried impulses.

By default Numba's compiler is switched off, since the scenes need dozens of kinds of steps. --compiled: take two kinds
of steps alone, with all features, and compile them.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

if __name__ == "__main__" and "--compiled" not in sys.argv:
    os.environ["NUMBA_DISABLE_JIT"] = "1"  # before Numba is imported

import numba
import numpy as np

import deep_contact as dc
from deep_contact.io.files import write_json
from deep_contact.io.provenance import provenance
from deep_contact.io.simulation_h5 import write_simulation
from deep_contact.stepping import impacts
from deep_contact.stepping.interface import entry_of

STEPS = 30
FIRST = 10
"""Number of steps of the first of two calls."""

FEW = {"sweeps": 6, "tolerance": None}
SOLVERS = (
    dc.PGS(**FEW), dc.PGS(**FEW, substeps=2), dc.PGS(**FEW, most_substeps=4), dc.PGS(**FEW, islands=True),
    dc.PSOR(**FEW), dc.BatchedPGS(**FEW), dc.BatchedPGS(**FEW, substeps=2, most_substeps=4), dc.NNCG(**FEW),
    dc.NesterovPGS(**FEW), dc.PSOR(**FEW, most_substeps=4, slop=0.25),
)  # fmt: skip
WITH_ALL = dc.PGS(**FEW, most_substeps=4), dc.BatchedPGS(**FEW, most_substeps=4)
PRESETS = "preview", "fast", "balanced"
TABLES = "friction", "restitution", "rolling_friction", "touches"
ENERGY = 0.005
"""Largest share of a scene's energies (`gained`) by which contacts may increase its energy. Position correction lifts
circles, and in a divided step velocities at a rebound belong to another time than `Trajectory.dissipated` takes."""
INTERPRETED_STRIKES = 1000
"""`impacts.ALWAYS_STRIKES` in interpreted steps. Where a moving segment squeezes a circle against a peg at e near 1,
and friction holds it there, rebounds never end, and a step does all that it may: 3 ms compiled, seconds interpreted."""


MOST_SECONDS = 30.0
"""Largest processor time of a scene, s. A preset that solves a stiff scene to a tolerance takes longer interpreted."""


class TooSlow(Exception):
    """A scene has taken `MOST_SECONDS`."""


def end_scene(*_) -> None:
    """Handle the signal after `MOST_SECONDS`."""
    raise TooSlow


def symmetric(rng, k: int, low: float, high: float) -> np.ndarray:
    """A symmetric table (k, k) of numbers between two limits, at random with zeros."""
    table = rng.uniform(low, high, (k, k)) * (rng.random((k, k)) < 0.8)
    return np.triu(table) + np.triu(table, 1).T


def random_tables(rng, k: int, *, rolls: bool, has_all: bool) -> dict:
    """The tables of a world of k materials. rolls: whether it may have rolling resistance. has_all: leave none out."""
    tables = {
        "friction": symmetric(rng, k, 0.0, 1.0), "restitution": symmetric(rng, k, 0.0, 1.0),
        "rolling_friction": symmetric(rng, k, 0.0, 0.2), "touches": symmetric(rng, k, 0.0, 1.0) > 0.0,
    }  # fmt: skip
    if has_all:
        for name in ("friction", "restitution", "rolling_friction"):
            tables[name][0, -1] = tables[name][-1, 0] = 0.5 if name != "rolling_friction" else 0.1
        tables["touches"][:], tables["touches"][0, 1], tables["touches"][1, 0] = True, False, False
        return tables
    if rng.random() < 0.5:
        tables["touches"] = True
    if rng.random() < 0.3:
        tables["restitution"] = one_of(rng, (0.0, 0.5, 1.0))
    elif rng.random() < 0.2:
        tables["restitution"][:] = 1.0
    if rng.random() < 0.2:
        tables["friction"] = one_of(rng, (0.0, 0.5))
    if not rolls or rng.random() < 0.4:
        tables["rolling_friction"] = 0.0
    return tables


def one_of(rng, values):
    """One of the values, drawn at random."""
    return values[rng.integers(0, len(values))]


def random_scene(seed: int, *, has_all: bool = False) -> tuple[dc.State, dict]:
    """Scene number `seed`, and the options of its run. has_all: whether it has every feature that steps may have."""
    rng = np.random.default_rng((77, seed))
    solver = one_of(rng, WITH_ALL if has_all else SOLVERS)
    options = {"solver": solver}
    if not has_all and rng.random() < 0.2:
        options = {"accuracy": one_of(rng, PRESETS)}
    if not has_all and rng.random() < 0.3 and ("accuracy" in options or entry_of(solver).can_sleep):
        options["sleep"] = True
    rolls = "accuracy" in options or entry_of(solver).rolls
    k = int(rng.integers(2, 5) if has_all else rng.integers(1, 5))
    world = random_tables(rng, k, rolls=rolls, has_all=has_all)
    n = int(rng.integers(5, 12))
    lattice = dc.lattice_in_box(n, gap=0.1, radius=(0.7, 1.0), seed=seed)
    width, height = lattice.world.box[2:]
    shelves = [[(0.0, 2.5), (0.4 * width, 1.6)], [(0.6 * width, 1.4), (width, 1.2)]]
    if has_all or rng.random() < 0.7:
        world["segments"] = shelves
        world["segment_materials"] = rng.integers(0, k, 2)
        if has_all or rng.random() < 0.7:
            ends = rng.uniform(-1.0, 1.0, (2, 2, 2)) * (np.arange(2) < rng.integers(1, 3))[:, None, None]
            world["segment_velocities"] = ends
        if has_all or rng.random() < 0.3:
            world["surface_speeds"] = rng.uniform(-2.0, 2.0, 2)
    if rng.random() < 0.2:
        world["gravity"] = (0.0, 0.0)
    if options.get("sleep"):  # that circles sleep within the run
        world["scales"] = dc.BOX2D._replace(sleep_speed=0.5, sleep_spin=1.0, sleep_time=0.05)
    is_fixed = rng.random(n) < (0.2 if has_all or rng.random() < 0.6 else 0.0)
    is_fixed[0] = False
    velocity, spin = rng.normal(0.0, 3.0, (n, 2)), rng.normal(0.0, 3.0, n)
    if rng.random() < 0.5:  # pegs, and otherwise rollers
        velocity[is_fixed] = 0.0
        spin[is_fixed] = 0.0
    bodies = dc.make_bodies(
        lattice.bodies.position + np.array([0.0, 3.2]), radius=lattice.bodies.radius, velocity=velocity, spin=spin,
        material=rng.integers(0, k, n), fixed=is_fixed, density=rng.uniform(0.5, 2.0),
    )  # fmt: skip
    if has_all or rng.random() < 0.4:
        options["push"] = rng.normal(0.0, 10.0, (n, 2)), rng.normal(0.0, 3.0, n)
    box = (0.0, 0.0, width, height + 6.0)
    world = dc.World(box=box, wall_materials=rng.integers(0, k, 4), **world)
    return dc.State(name=f"random {seed}", world=world, bodies=bodies, dt=one_of(rng, (0.005, 0.01, 0.02))), options


def relabelled(state: dc.State, order) -> dc.State:
    """The scene with other numbers for its materials: material p becomes order[p]."""
    order, world = np.asarray(order), state.world
    back = np.argsort(order)
    tables = {name: np.array(getattr(world, name)) for name in TABLES}
    tables = {name: table[np.ix_(back, back)] if table.ndim else table.item() for name, table in tables.items()}
    of_segments = world.segment_materials or np.zeros(len(world.segments), int)  # () stands for 0
    found = {"wall_materials": world.wall_materials, "segment_materials": of_segments}
    materials = {name: order[np.array(values, int)] for name, values in found.items()}
    bodies = state.bodies._replace(material=order[state.bodies.material])
    return state.replace(world=replace(world, **tables, **materials), bodies=bodies)


def difference(one: dc.State, other: dc.State, *, labels: bool = True) -> str:
    """Name of the first array in which two states differ, or ""; and of the world. labels: whether materials count."""
    for part in ("bodies", "contacts"):
        first, second = getattr(one, part), getattr(other, part)
        for name in first._fields:
            mine, theirs = getattr(first, name), getattr(second, name)
            if (labels or name != "material") and not np.array_equal(mine, theirs, equal_nan=True):
                return f"{part}.{name}"
    if labels and one.world != other.world:
        return "world"
    return "" if one.world.segments == other.world.segments and one.step == other.step else "segments or step"


def gained(run, scene: dc.State) -> float:
    """Most energy that contacts have made between two states of a recorded run, over the energies of the scene.

    These are the largest kinetic energy, the size of the work, and the weight of the circles times their mean radius.
    """
    path, bodies = run.trajectory, scene.bodies
    weight = np.hypot(*scene.world.gravity) * bodies.free_mass.sum() * bodies.radius.mean()
    scale = path.energies[:, 0].max() + np.abs(path.work).max() + weight
    taken = np.concatenate([[0.0], np.cumsum(path.dissipated)])
    return float((np.maximum.accumulate(taken) - taken).max() / scale)


def findings(seed: int, folder: Path, *, has_all: bool = False) -> tuple[dict[str, str], float]:
    """What is wrong with scene number `seed`: name of a check -> what differs; and `gained` of its run.

    folder: for the files.
    """
    if numba.config.DISABLE_JIT:
        impacts.ALWAYS_STRIKES = INTERPRETED_STRIKES
    scene, options = random_scene(seed, has_all=has_all)
    found, sleeps = {}, options.get("sleep", False)

    def run(state, steps=STEPS, **more):
        return dc.simulate(state, steps=steps, **options | more)

    def check(name, one, other, **how):
        if what := difference(one, other, **how):
            found[name] = what

    whole = run(scene).state
    half = run(scene, FIRST).state
    parts = run(half.replace(), STEPS - FIRST).state  # a copy, which no kept run knows
    if not sleeps:
        check("parts", parts, whole)
    dc.write_state(folder / "half.xml", half)
    check("xml", run(dc.read_state(folder / "half.xml"), STEPS - FIRST).state, parts)
    write_simulation(folder / "half.h5", [half])
    check("hdf5", run(dc.load_trajectory(folder / "half.h5")[0], STEPS - FIRST).state, parts)
    live = dc.Simulator(scene, **options)
    for _ in range(STEPS):
        live.step()
    check("Simulator", live.state, whole)
    seen = dc.Simulator(scene, **options, forces=True)
    seen.step(FIRST)
    seen.step(STEPS - FIRST)
    check("Simulator, forces", seen.state, whole)
    if "push" not in options:
        others = [random_scene(seed + 1000, has_all=has_all)[0].replace(contacts=None) for _ in range(2)]
        others = [one.replace(world=replace(one.world, rolling_friction=0.0)) for one in others]
        many = dc.simulate_many([others[0], scene, others[1]], steps=STEPS, threads=2, **options)
        check("simulate_many", many[1].state, whole)
    order = np.random.default_rng(seed).permutation(scene.world.materials or 4)
    check("labels", run(relabelled(scene, order)).state, whole, labels=False)
    recorded = run(scene, record=1, forces=True)
    check("recorded", recorded.state, whole)
    # The work of belts is not counted, and six sweeps leave a part of the impulses that a jam carried to the next step.
    still = scene.replace(world=replace(scene.world, surface_speeds=()))
    return found, gained(run(still, record=1, warm_start=None), scene)


def told(scene: dc.State, options: dict) -> str:
    """One line on a scene and the options of its run."""
    world, bodies = scene.world, scene.bodies
    tables = [f"{name} {'table' if isinstance(value, tuple) else value}" for name in TABLES
              if (value := getattr(world, name)) is not True]  # fmt: skip
    parts = [
        f"{bodies.count} circles, {bodies.is_fixed.sum()} fixed", *tables, f"{len(world.segments)} segments",
        "moving" * bool(world.segment_velocities), "belts" * bool(world.surface_speeds), f"g {world.gravity[1]}",
        f"dt {scene.dt}", *(f"{name} {value if name != 'push' else ''}" for name, value in options.items()),
    ]  # fmt: skip
    return ", ".join(filter(None, parts))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--compiled", action="store_true")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no new scene begins after this time")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGPROF, end_scene)
    begun, energies, wrong, seed = time.monotonic(), {}, {}, args.first
    with tempfile.TemporaryDirectory() as folder:
        while seed < args.first + args.scenes and time.monotonic() - begun < args.seconds:
            signal.setitimer(signal.ITIMER_PROF, MOST_SECONDS)
            try:
                found, energies[seed] = findings(seed, Path(folder), has_all=args.compiled)
            except Exception as error:
                found, energies[seed] = {"error": f"{type(error).__name__}: {error}"}, 0.0
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
            if energies[seed] > ENERGY:
                found["energy"] = f"{energies[seed]:.3g}"
            if found:
                wrong[seed] = found
                print(seed, found, told(*random_scene(seed, has_all=args.compiled)), flush=True)
            seed += 1
    largest = sorted(energies, key=energies.get)[-5:]
    print(f"{len(energies)} scenes to {seed - 1}, {len(wrong)} with findings, {time.monotonic() - begun:.0f} s")
    print("most energy made, of the scene's:", [(one, float(f"{energies[one]:.2g}")) for one in largest])
    if args.out:
        kind = "compiled" if args.compiled else "interpreted"
        found = {"findings": {str(key): value for key, value in wrong.items()}, "energy": list(energies.values())}
        record = {"kind": kind, "first": args.first, "scenes": len(energies)} | found
        write_json(args.out, record | {"provenance": provenance(wall_s=time.monotonic() - begun)})


if __name__ == "__main__":
    main()
