"""Cost of a step from ten circles to a hundred thousand: time, its stages, memory, and the floor that the machine sets.

Times are minima of several runs, engines taking turns on the same pile. A step of k sweeps over m contacts is taken
to cost overhead + cost · k · m, whose two unknowns follow from two budgets of sweeps.
"""

from __future__ import annotations

import math
import multiprocessing
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from numba import njit

from deep_contact.compiled.simd import WIDTH, lane, spread
from deep_contact.constants import WALL_SKIN
from deep_contact.physics import collision, colours, contact_solver, engine, metrics
from deep_contact.physics.solvers import PGS, BatchedPGS
from deep_contact.reporting.results import replacing
from deep_contact.simulation import simulate, solve_contacts
from deep_contact.state import Bodies, State, World, make_bodies
from deep_contact.studies import peers, tradeoff

FEW, MANY = 10, 40
"""Budgets of velocity sweeps that the two unknowns follow from."""

POSITION_SWEEPS = 3

OURS = {
    "sequential": (PGS, {}),
    "levels": (BatchedPGS, {"order": "levels"}),
    "colours": (BatchedPGS, {"order": "colours"}),
    "colours, single": (BatchedPGS, {"order": "colours", "precision": "single"}),
    "colours, 2 threads": (BatchedPGS, {"order": "colours", "threads": 2}),
}
"""Name -> method and its options."""

PEERS = {adapter.name: adapter for adapter in (peers.Box2D23, peers.Pymunk, peers.Box2D3)}

BYTES = {"double": 8 + 7 * 8 + 4 * 8, "single": 8 + 7 * 4 + 4 * 4}
"""Memory that a sweep has to move for a contact: which circles, its row, and its impulses, read and written."""

BYTES_OF_CIRCLE = {"double": 64, "single": 32}
"""And for a circle: four numbers, read and written, once a sweep."""

OPERATIONS = 51
"""Additions, multiplications, minima and maxima in `colours.sweep_tiles` for a contact; a fused one counts twice."""


def packed_pile(n_bodies: int, *, seed: int = 0, steps: int = 200) -> State:
    """A pile that has not to fall first: unlike circles close to a hexagonal packing, given `steps` steps to settle.

    Radii are uniform in 0.8 to 1 m, so that no crystal comes of it and there are about as many contacts as in a pile
    that was dropped.
    """
    rng = np.random.default_rng(seed)
    columns = math.ceil(math.sqrt(n_bodies))
    pitch, jitter = 1.85, 0.02
    row, column = np.divmod(np.arange(n_bodies), columns)
    centres = np.column_stack([(column + 0.5 * (row % 2)) * pitch, row * pitch * math.sqrt(0.75)])
    centres += 1.0 + WALL_SKIN + jitter * rng.uniform(-0.5, 0.5, centres.shape)
    size = centres.max(axis=0) + np.array([1.0 + WALL_SKIN, 20.0])
    bodies = make_bodies(centres, radius=rng.uniform(0.8, 1.0, n_bodies))
    scene = State(name=f"packed_{n_bodies}", world=World(box=(0, 0, *size)), bodies=bodies)
    solver = BatchedPGS(sweeps=FEW, tolerance=None, position_sweeps=POSITION_SWEEPS)
    return simulate(scene, steps=steps, solver=solver).state


def stored_pile(folder: Path, n_bodies: int, *, seed: int, steps: int) -> Path:
    """The file of `packed_pile` in the folder, made if it is not there."""
    path = Path(folder) / f"packed_{n_bodies}_seed_{seed}_steps_{steps}.npz"
    if not path.exists():
        state = packed_pile(n_bodies, seed=seed, steps=steps)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            np.savez(temporary, box=state.world.box, **state.bodies._asdict())
    return path


def read_pile(path: Path) -> State:
    """A stored pile, gone on by two steps so that its contacts carry impulses."""
    with np.load(path) as stored:
        fields = {name: stored[name] for name in ("radius", "velocity", "angle", "spin", "mass")}
        bodies = make_bodies(stored["position"], **fields)
        state = State(name=Path(path).stem, world=World(box=tuple(stored["box"])), bodies=bodies)
    return simulate(state, steps=2, solver=solver_of("sequential", FEW)).state


def solver_of(name: str, sweeps: int):
    """Options of one of ours with a budget."""
    method, options = OURS[name]
    return method(sweeps=sweeps, tolerance=None, position_sweeps=POSITION_SWEEPS, **options)


def available_peers() -> list[str]:
    """Names of the engines whose packages are installed."""
    found = []
    for name, adapter in PEERS.items():
        try:
            adapter(State(name="empty", world=World(), bodies=make_bodies([[15.0, 15.0]])))
        except ImportError:
            continue
        found.append(name)
    return found


def step_costs(state: State, names: Sequence[str], *, steps: int, repeats: int) -> list[dict]:
    """Rows: of each engine on the pile, contacts, time of a step of `FEW` sweeps, and the two unknowns."""
    runs = {name: _run_of(state, name) for name in names}
    least = {name: {FEW: math.inf, MANY: math.inf} for name in names}
    for name in names:
        runs[name](1, FEW)  # compiled and warm
    for _ in range(repeats):
        for name in names:
            for sweeps in (FEW, MANY):
                start = time.perf_counter()
                runs[name](steps, sweeps)
                seconds = (time.perf_counter() - start) / steps
                least[name][sweeps] = min(least[name][sweeps], seconds)
    found = []
    for name in names:
        few, many = least[name][FEW], least[name][MANY]
        m = runs[name].contacts()
        slope = (many - few) / ((MANY - FEW) * m)
        found.append(
            {
                "engine": name,
                "n_bodies": state.bodies.count,
                "contacts": m,
                "step_us": 1e6 * few,
                "sweep_ns": 1e9 * slope,
                "overhead_us": 1e6 * (few - slope * FEW * m),
            }
        )
    return found


class _OurRun:
    """Steps of ours, always from the same state."""

    def __init__(self, state: State, name: str):
        self.state, self.name = state, name

    def __call__(self, steps: int, sweeps: int) -> None:
        simulate(self.state, steps=steps, solver=solver_of(self.name, sweeps))

    def contacts(self) -> int:
        return self.state.contacts.count


class _PeerRun:
    """Steps of another engine, which go on: the pile is at rest."""

    def __init__(self, state: State, name: str):
        self.world = PEERS[name](state)

    def __call__(self, steps: int, sweeps: int) -> None:
        for _ in range(steps):
            self.world.step(0.01, sweeps, POSITION_SWEEPS)

    def contacts(self) -> int:
        return self.world.contact_count()


def _run_of(state: State, name: str) -> Callable:
    return (_OurRun if name in OURS else _PeerRun)(state, name)


def exponent(rows: Sequence[dict], least: int = 1000) -> float:
    """p of step time ~ contacts^p, fitted to the rows of one engine from so many circles on."""
    rows = [row for row in rows if row["n_bodies"] >= least]
    return float(np.polyfit(np.log([row["contacts"] for row in rows]), np.log([row["step_us"] for row in rows]), 1)[0])


def stages(state: State, name: str, *, repeats: int) -> dict[str, float]:
    """Time of each stage of a step of one of ours on one thread, µs: what is compiled, without Python around it."""
    bodies, contacts, n = state.bodies, state.contacts, state.bodies.count
    box, gravity, friction, restitution = engine.world_arguments(state)
    solver = solver_of(name, FEW)
    settings, position_sweeps = engine.settings_of(solver), solver.position_sweeps
    moving = engine.moving_room(n, solver)
    room, cells = collision.make_contacts(4 * n + 64), collision.make_cells(n)
    rows = contact_solver.make_rows(contacts.count, moving.dtype)

    def prepare():
        contact_solver.integrate_velocities(bodies, gravity, state.dt, moving)
        contact_solver.contact_rows(bodies, contacts, moving, restitution, rows)
        contact_solver.apply_impulses(rows, moving)

    def move():
        contact_solver.store_impulses(rows, contacts)
        engine.integrate_positions(moved, moving, 1e-9)

    def find():
        collision.next_contacts(bodies, box, cells, contacts, True, room)

    found = {"velocities and rows": fastest(prepare, repeats)}
    moved = Bodies(*(field.copy() for field in bodies))
    if isinstance(solver, BatchedPGS):
        plan = colours.plan_batches(rows.body, n, settings.colours, colours.make_plan(n, contacts.count))
        tiles = colours.fill_tiles(rows, moving, plan, colours.make_tiles(n, 1, 1, moving.dtype))

        def batch():
            colours.plan_batches(rows.body, n, settings.colours, plan)
            colours.fill_tiles(rows, moving, plan, tiles)
            colours.empty_tiles(plan, tiles, rows, moving)

        found["batches"] = fastest(batch, repeats)
        found["sweeps"] = FEW * fastest(lambda: colours.sweep_all(settings, plan, tiles, friction), repeats)

        def correct():
            colours.correct_positions_in_batches(settings, plan, tiles, moved, box, position_sweeps)
    else:
        found["batches"] = 0.0
        found["sweeps"] = FEW * fastest(lambda: contact_solver.sweep(rows, friction, moving), repeats)

        def correct():
            contact_solver.correct_positions(moved, contacts, box, position_sweeps)

    found["position correction"] = fastest(correct, repeats)
    found["new positions"] = fastest(move, repeats)
    found["contacts"] = fastest(find, repeats)
    return found


def fastest(function: Callable[[], object], repeats: int) -> float:
    """Least time of several calls, µs, after one that is not timed."""
    function()
    best = math.inf
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - start)
    return 1e6 * best


def peak_memory(path: Path, name: str) -> int:
    """Peak resident memory of a fresh process that reads a pile and does three steps, bytes."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_peak_memory, path, name).result()


def _peak_memory(path: Path, name: str) -> int:
    simulate(read_pile(path), steps=3, solver=solver_of(name, FEW))
    try:
        # Not `getrusage`: what it tells starts from the peak of the parent.
        status = Path("/proc/self/status").read_text()
        return 1024 * int(status.partition("VmHWM:")[2].split()[0])
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@njit(cache=True, fastmath={"contract"})
def _triad(a, b, c, times):
    for k in range(times):
        share = 1.0 + k
        for i in range(a.shape[0]):
            a[i] = b[i] + share * c[i]


@njit(cache=True, fastmath={"contract"})
def _fused(times):
    share, a = spread(0.5), spread(1.0)
    b, c, d, e, f, g, h = a + a, a + share, a - share, a, a + a, a + share, a - share
    i, j, k, m = a + a, a + share, a - share, a
    for _ in range(times):
        a, b, c, d, e, f = a * share + a, b * share + b, c * share + c, d * share + d, e * share + e, f * share + f
        g, h, i, j, k, m = g * share + g, h * share + h, i * share + i, j * share + j, k * share + k, m * share + m
    return lane(a + b + c + d + e + f + g + h + i + j + k + m, 0)


def bandwidth(size: int, repeats: int = 5) -> float:
    """Bytes a second that one core moves in a ← b + s c over three arrays of so many bytes together (McCalpin's STREAM
    triad): from the cache that they fit into."""
    a, b, c = np.zeros(max(size // 24, 64)), np.ones(max(size // 24, 64)), np.ones(max(size // 24, 64))
    times = max(1, 20_000_000 // a.nbytes)
    return times * 3 * a.nbytes / (1e-6 * fastest(lambda: _triad(a, b, c, times), repeats))


def arithmetic(repeats: int = 5) -> float:
    """Operations a second of one core in fused multiplications and additions in float64, each counted as two."""
    times = 200_000
    return times * 12 * 2 * WIDTH / (1e-6 * fastest(lambda: _fused(times), repeats))


def floor(contacts: int, n_bodies: int, operations: float, precision: str = "double") -> dict[str, float]:
    """Least time for a contact and sweep, ns, from moving its memory once and from its operations.

    operations: a second, of `arithmetic`; single precision does twice as many.
    """
    size = BYTES[precision] * contacts + BYTES_OF_CIRCLE[precision] * n_bodies
    rate = bandwidth(size)
    operations *= 2 if precision == "single" else 1
    return {
        "bytes": size / contacts,
        "bandwidth": rate,
        "memory_ns": 1e9 * size / contacts / rate,
        "arithmetic_ns": 1e9 * OPERATIONS / operations,
    }


def convergence(n_bodies: int, seed: int, *, states: int, sweeps: Sequence[int], past_need: int) -> list[dict]:
    """Rows: what the order of relaxation does to convergence on states of a falling pile, from Builtin.

    Velocity errors after so many sweeps, against the nearest of the solutions that the orders find with `past_need`
    sweeps, and sweeps until θ is a thousandth of a circle's impulse of weight.
    """
    found = []
    pile = tradeoff.pile("falling", n_bodies, seed)
    for number, state in enumerate(tradeoff.states_of(pile, count=states)):
        weight = float(state.bodies.mass.mean() * np.hypot(*state.world.gravity) * state.dt)
        orders = {name: OURS[name] for name in ("sequential", "levels", "colours")}
        solved = {
            name: solve_contacts(state, solver=method(sweeps=past_need, tolerance=1e-6 * weight, **options))
            for name, (method, options) in orders.items()
        }
        references = list(solved.values())
        for name, (method, options) in orders.items():
            row = {"order": name, "state": number, "contacts": state.contacts.count}
            for k in sweeps:
                solution = solve_contacts(state, solver=method(sweeps=k, tolerance=None, **options))
                row[f"error_{k}"] = metrics.nearest_velocity_error(state, solution, references)
            below = np.flatnonzero(solved[name].record.theta <= 1e-3 * weight)
            row["sweeps"] = int(below[0]) + 1 if below.size else past_need
            found.append(row)
    return found
