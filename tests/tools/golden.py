"""python tests/tools/golden.py: small runs of everything that computes, compared with what they gave before.

    python tests/tools/golden.py [NAME …]         # a line for each run that differs from the file
    python tests/tools/golden.py --sensitivity    # by how much positions that differ by 1e-15 change each run
    python tests/tools/golden.py --write          # make the file anew, after a change of results that is meant

`data/reference/golden.json` has the digest and the solver of each run, and the machine that made them; golden.npz has
the numbers. On that processor, with these versions, a run gives the same bits; elsewhere the same numbers to 1e-9. That
holds because runs are short: those whose sensitivity is above 1e-10 do not belong here.
"""

import argparse
import hashlib
import json
import sys
import tempfile
import warnings
from collections.abc import Callable
from functools import cache, partial
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import NamedTuple

import llvmlite
import numba
import numpy as np
import scipy
from numba import config
from numba.core.registry import cpu_target

import deep_contact as dc
from deep_contact import sph
from deep_contact.accuracy.presets import PRESETS, PresetWarning
from deep_contact.analysis.lcp import contact_problem
from deep_contact.analysis.matrix_solvers import solve_problem
from deep_contact.figures import staleness
from deep_contact.io.files import write_bytes, write_json
from deep_contact.io.provenance import provenance
from deep_contact.solvers import METHODS, describe
from deep_contact.sph.start import TRANSFERS, Sph
from deep_contact.starts.names import STARTS

FILE = Path(__file__).resolve().parents[2] / "data" / "reference" / "golden.json"

TOLERANCE, OF_NETWORKS = 1e-9, 1e-4
"""Largest deviation on another processor. Networks are float32: their sums, in another order, differ by 1e-6."""


# ---- ways to compute: state -> (the solver in words, name -> array) ----


def simulated(state, lengths=(40,), between=lambda state: state, many=False, **options):
    """A run, in one call or in parts.

    lengths: steps of each part. between: changes the state after each part. many: whether an equal run goes beside it.
    """
    runs = []
    for steps in lengths:
        options["steps"] = steps
        runs.append(dc.simulate_many([state] * 2, threads=2, **options)[1] if many else dc.simulate(state, **options))
        state = between(runs[-1].state)
    arrays = {name: getattr(state.bodies, name) for name in ("position", "velocity", "angle", "spin")}
    names = "body_a", "body_b", "separation", "normal_start", "tangent_start"
    arrays |= {name: getattr(state.contacts, name) for name in names}
    names = "contacts", "sweeps", "theta", "relaxations", "substeps"
    arrays |= {name: np.concatenate([getattr(run, name) for run in runs]) for name in names}
    return describe(state.solver), arrays | {"theta": np.nan_to_num(arrays["theta"], posinf=0.0)}


def watched(state, solver):
    """The contacts and θ of every step or substep."""
    seen = []

    def keep(state, record):
        seen.append(state.contacts._asdict() | {"theta": record.theta})

    dc.simulate(state, steps=20, solver=solver, on_step=keep)
    return describe(solver), {name: np.concatenate([one[name] for one in seen]) for name in seen[0]}


def solved(state, solver):
    solution = dc.solve_contacts(state, solver=solver)
    return describe(solver), dict(zip(solution._fields, solution[:4])) | {"theta": solution.record.theta}


def solved_exactly(state, of=lambda state: state):
    """The exact solution from zero impulses, so that there are many pivots. of: changes the state first."""
    none = np.zeros(state.contacts.count)
    solution = dc.solve_exactly(of(state), none, none).solution
    return "solve_exactly", dict(zip(solution._fields, solution[:4]))


def matrices(state):
    return contact_problem(state)._replace(jacobian=None, inverse_mass=None, free_velocity=None)


def swept_by_matrices(state, solver):
    impulse, record = solve_problem(matrices(state), solver)
    return describe(solver), {"impulse": impulse, "theta": record.theta}


def started(state, start):
    """The impulses of a start, and a run with it."""
    name, arrays = simulated(state, lengths=(20,), solver=SOLVERS["PGS"], warm_start=start)
    normal, tangent = STARTS[start]()(state, SOLVERS["PGS"])
    return name, arrays | {"normal": normal, "tangent": tangent}


def transferred(state, **options):
    """The solved impulses after the way to an image and back."""
    start = Sph(spacing=2.0, support=4.0, **options)
    image = start.splat(state, np.column_stack([state.contacts.normal_impulse, state.contacts.tangent_impulse]))
    return repr(start), dict(zip(("image", "normal", "tangent"), (image, *start.gather(state, image))))


def through_file(state):
    with tempfile.TemporaryDirectory() as folder:
        dc.write_state(path := Path(folder) / "state.xml", state)
        return dc.read_state(path)


# ---- the runs ----


def falling(scene, speed=2.0):
    """The scene with circles that fall, the last ones twice as fast, and sideways."""
    velocity = speed * np.linspace((0.3, -1.0), (-0.1, -2.0), scene.bodies.count)
    return scene.replace(bodies=scene.bodies._replace(velocity=velocity))


def touching(scene):
    """The scene with circles grown into their neighbours: more contacts than a block of a batch has."""
    return scene.replace(bodies=scene.bodies._replace(radius=1.004 * scene.bodies.radius))


def row():
    """Circles on the floor, half a slop deep; the first rolls towards the others, which it reaches after 0.65 s."""
    centres = [[4.7, 1.0075], [8.0, 1.0075], [10.01, 1.0075], [12.02, 1.0075]]
    bodies = dc.make_bodies(centres, velocity=[[2.0, 0.0], *[[0.0, 0.0]] * 3], spin=[-2.0, 0.0, 0.0, 0.0])
    return dc.single_body().replace(bodies=bodies, dt=0.02)


PILE = {"gap": 0.02, "radius": (0.9, 1.0), "seed": 1}
SCENES = {
    "pile": lambda: falling(dc.lattice_in_box(20, **PILE)),
    "frictionless": lambda: falling(dc.lattice_in_box(20, friction=0.0, **PILE)),
    "elastic": lambda: falling(dc.lattice_in_box(20, restitution=0.5, **PILE), 4.0),
    "gas": lambda: dc.drifting_circles(24, size=14.0, sigma_coef=2.0, restitution=0.9, seed=2),
    "drum": lambda: falling(dc.drum(24, froude=0.5, **PILE)),
    "hopper": lambda: falling(dc.hopper(24, opening=4.0, **PILE)),
    "terrain": lambda: falling(dc.terrain(20, bumps=6, **PILE)),
    "tilted": lambda: dc.lattice_in_box(20, gravity=(3.0, -9.0), **PILE),
    "small": lambda: dc.lattice_in_box(20, **PILE | {"radius": (9e-4, 1e-3)}).replace(dt=3e-4),
    "tower": lambda: dc.lattice_in_box(17, columns=1, **PILE),
    "row": row,
    "barrel": lambda: falling(dc.barrel(5, columns=5, **PILE)),
    "fast": lambda: falling(dc.lattice_in_box(12, **PILE), 150.0),
    "blocks": lambda: falling(touching(dc.lattice_in_box(700, gap=1e-3, seed=1))),
    "impact": lambda: dc.read_state(dc.sample_file("impact_154")),
    "settling": lambda: dc.read_state(dc.sample_file("settling_349")),
    "rest": lambda: dc.read_state(dc.sample_file("rest_362")),
    "no past": lambda: SCENES["rest"]().replace(contacts=None, step=0),
}

FEW = {"sweeps": 15, "tolerance": None}
MOTION = {"sweeps": 5, "tolerance": None, "most_substeps": 16, "approach": 0.02, "slop": 0.5}
SOLVERS = {name: METHODS[name](**FEW) for name in METHODS}
SOLVERS |= {"islands": dc.PGS(sweeps=200, islands=True), "motion": dc.PGS(**MOTION)}
OTHERS = {
    "to the scene's tolerance": dc.PGS(),
    "two ω": dc.PSOR(**FEW, omega=1.75, friction_omega=1.45),
    "substeps": dc.PGS(**FEW, substeps=4),
    "motion of substeps": dc.NNCG(**MOTION | {"most_substeps": 8}, substeps=2),
    "no position correction": dc.PGS(**FEW, position_sweeps=0),
}


class Run(NamedTuple):
    """A scene, and the function that computes with it. same_as: a run that gives the same bits."""

    scene: str
    way: Callable
    tolerance: float = TOLERANCE
    same_as: str = ""

    def result(self, change=lambda scene: scene):
        """(The solver in words, name -> array). change: changes the scene first."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PresetWarning)
            return self.way(change(SCENES[self.scene]()))


def runs():
    """Name -> `Run`."""
    pgs = SOLVERS["PGS"]
    for scene, name in product(("pile", "frictionless", "elastic", "gas", "drum", "hopper"), SOLVERS):
        yield f"{scene}, {name}", Run(scene, partial(simulated, solver=SOLVERS[name]))
    for name, solver in OTHERS.items():
        yield f"pile, {name}", Run("pile", partial(simulated, solver=solver))
    for scene in ("terrain", "tilted", "small", "row", "barrel", "fast", "impact", "rest"):
        yield f"{scene}, PGS", Run(scene, partial(simulated, solver=pgs))
    yield "rest, half a time step", Run("rest", partial(simulated, solver=pgs, dt=0.005))
    for scene, name in [
        *product(("pile", "elastic", "drum"), PRESETS),
        *product(("gas", "small", "rest", "no past"), ["fast"]),
    ]:
        yield f"{scene}, {name}", Run(scene, partial(simulated, accuracy=name))
    yield "tower, fast", Run("tower", partial(simulated, accuracy="fast", lengths=(20,)))
    for name in ("PGS", "islands"):
        yield f"row, {name}, sleep", Run("row", partial(simulated, solver=SOLVERS[name], sleep=True))
    for name, solver in SOLVERS.items():
        yield f"solve, {name}", Run("impact", partial(solved, solver=solver))
    for name in ("PGS", "motion"):
        yield f"each step, {name}", Run("pile", partial(watched, solver=SOLVERS[name]))
    # The network of "cnn" is Keras's: tests/cnn/test_stored_predictions.py has what it predicts.
    for name in (name for name in STARTS if name != "cnn"):
        tolerance = OF_NETWORKS if name.startswith("far field") else TOLERANCE
        yield f"start, {name}", Run("impact", partial(started, start=name), tolerance)
    for name in ("PGS", "NesterovPGS"):
        yield f"matrices, {name}", Run("rest", partial(swept_by_matrices, solver=SOLVERS[name]))
    yield "exact", Run("settling", solved_exactly)
    yield "exact, matrices", Run("settling", partial(solved_exactly, of=matrices))
    for transfer, kernel in [*product(TRANSFERS, ["poly6"]), *product(["consistent"], sph.KERNELS[1:])]:
        yield f"transfer, {transfer}, {kernel}", Run("rest", partial(transferred, transfer=transfer, kernel=kernel))
    # What divides, watches or shares out a run changes no bit of it.
    same = {
        "in steps": {"lengths": (1,) * 40},
        "through a file": {"lengths": (25, 15), "between": through_file},
        "recorded": {"record": 7},
        "called each step": {"on_step": lambda state, record: None},
        "one of many": {"many": True},
    }
    for (scene, solver), name in product((("pile", "PGS"), ("elastic", "motion")), same):
        way = partial(simulated, solver=SOLVERS[solver], **same[name])
        yield f"{scene}, {solver}, {name}", Run(scene, way, same_as=f"{scene}, {solver}")
    way = partial(simulated, solver=dc.PGS(**FEW, islands=True))
    yield "rest, PGS, island by island", Run("rest", way, same_as="rest, PGS")
    way = partial(simulated, lengths=(4,))
    yield "blocks", Run("blocks", partial(way, solver=dc.BatchedPGS(**FEW)))


RUNS = dict(runs())


# ---- the file ----


def machine():
    """The properties on which bits depend: the processor as Numba compiles for it, and versions."""
    _, processor, features = cpu_target.target_context.codegen().magic_tuple()
    processor = "Python's" if config.DISABLE_JIT else processor  # where the compiler may fuse, Python rounds twice
    versions = {package.__name__: package.__version__ for package in (numba, llvmlite, np, scipy)}
    return {"processor": processor, "features": hashlib.sha256(features.encode()).hexdigest()[:16]} | versions


def digest(arrays):
    """SHA-256 of the bytes of all arrays."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays.values())).hexdigest()


def deviation(arrays, stored):
    """The largest difference from the stored values, as a share of the largest value of its array; the array's name.

    θ is a difference of impulses, so its differences are shares of these.
    """
    if {name: array.shape for name, array in arrays.items()} != {name: array.shape for name, array in stored.items()}:
        return np.inf, "number of contacts or steps"
    shares = {}
    for name, array in arrays.items():
        alike = stored[name], stored.get("normal_start" if name == "theta" else name, 0.0)
        size = max(np.max(np.abs(values), initial=0.0) for values in alike) or 1.0
        shares[name] = np.nan_to_num(np.abs(array - stored[name]).max(initial=0.0) / size, nan=np.inf)
    worst = max(shares, key=shares.get)
    return shares[worst], worst


@cache
def stored():
    """The record of golden.json, and name of a run -> name -> array."""
    arrays = {}
    with np.load(FILE.with_suffix(".npz")) as file:
        for key in file.files:
            run, _, name = key.partition("/")
            arrays.setdefault(run, {})[name] = file[key]
    return json.loads(FILE.read_text(encoding="utf-8")), arrays


def difference(name, change=lambda scene: scene):
    """How a run differs from the file, in words; "" where it does not. change: changes its scene first."""
    run, (record, numbers) = RUNS[name], stored()
    solver, arrays = run.result(change)
    entry = record["runs"][name]
    if digest(arrays) == entry["sha256"]:
        return ""
    share, worst = deviation(arrays, numbers[run.same_as or name])
    if share <= run.tolerance and record["machine"] != machine():
        return ""
    settings = "" if solver == entry["solver"] else f"; the solver was {entry['solver']}, is {solver}"
    return f"{name}: {worst} by {share:.2g}{settings}" if np.isfinite(share) else f"{name}: another {worst}{settings}"


def write():
    """Make the file from all runs."""
    results = {name: run.result() for name, run in RUNS.items()}
    entries = {name: {"solver": solver, "sha256": digest(arrays)} for name, (solver, arrays) in results.items()}
    named = {}
    for name, run in RUNS.items():
        if not run.same_as:
            named |= {f"{name}/{array}": values for array, values in results[name][1].items()}
        elif entries[name]["sha256"] != entries[run.same_as]["sha256"]:
            raise SystemExit(f"{name}: expected the bits of {run.same_as}")
    packed = BytesIO()
    np.savez_compressed(packed, **named)
    write_bytes(FILE.with_suffix(".npz"), packed.getvalue())
    before, of = json.loads(FILE.read_text(encoding="utf-8")), staleness.digest_of_runs
    # A run that a preset gives another solver is another run: it says nothing of the code.
    same = [(entries[name], was) for name, was in before["runs"].items() if name in entries]
    is_kept = all(now["sha256"] == was["sha256"] for now, was in same if now["solver"] == was["solver"])
    extends = dict.fromkeys([*before.get("extends", ()), of(before["runs"])]) if is_kept else {}
    extends.pop(of(entries), None)
    record = {"machine": machine(), "provenance": provenance(), "extends": [*extends], "runs": entries}
    write_json(FILE, record)


def moved(scene, share=1e-15, seed=0):
    """The scene with positions changed by this share."""
    change = share * np.random.default_rng(seed).uniform(-1.0, 1.0, scene.bodies.position.shape)
    return scene.replace(bodies=scene.bodies._replace(position=scene.bodies.position * (1.0 + change)))


def sensitivity(name):
    """The largest deviation of a run from runs with moved positions, and its quantity."""
    _, arrays = RUNS[name].result()
    return max(deviation(RUNS[name].result(partial(moved, seed=seed))[1], arrays) for seed in range(3))


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="of runs; by default all")
    parser.add_argument("--write", action="store_true", help="make the file anew")
    parser.add_argument("--sensitivity", action="store_true", help="to positions that differ by 1e-15")
    given = parser.parse_args(arguments)
    if unknown := set(given.names) - set(RUNS):
        parser.error(f"expected names of runs, got {', '.join(unknown)}")
    names = given.names or list(RUNS)
    if given.write:
        return write()
    if given.sensitivity:
        print(*(f"{name}: {' of '.join(map(str, sensitivity(name)))}" for name in names), sep="\n")
        return 0
    found = [line for name in names if (line := difference(name))]
    print(*found, f"{len(found)} of {len(names)} runs differ", sep="\n")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
