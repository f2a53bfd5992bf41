"""Cost of a step from ten circles to a hundred thousand: time, its stages, memory, and the limits of the machine.

Times are minima of interleaved runs on the same pile; the cost of a step has the two unknowns of `engines`.
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from numba import njit

from deep_contact.compiled.simd import WIDTH, lane, spread
from deep_contact.constants import WALL_SKIN
from deep_contact.physics import batches, collision, contact_solver, engine, metrics, position_correction
from deep_contact.physics.solvers import PGS, BatchedPGS, batched
from deep_contact.recommendation.steps import weight_impulse
from deep_contact.simulation import simulate, solve_contacts
from deep_contact.state import Bodies, State, World, make_bodies
from deep_contact.studies import engines, timing, tradeoff
from deep_contact.studies.engines import FEW

OURS = {
    "sequential": {"method": PGS},
    "levels": {"method": BatchedPGS, "order": "levels"},
    "colours": {"method": BatchedPGS, "order": "colours"},
    "colours, single": {"method": BatchedPGS, "order": "colours", "precision": "single"},
    "colours, 2 threads": {"method": BatchedPGS, "order": "colours", "threads": 2},
}
"""Name -> method and its options."""

BYTES = {"double": 8 + 7 * 8 + 4 * 8, "single": 8 + 7 * 4 + 4 * 4}
"""Memory that a sweep has to move for a contact: its two circles, its row, and its impulses, read and written."""

BYTES_OF_CIRCLE = {"double": 64, "single": 32}
"""The same for a circle: four numbers, read and written, once per sweep."""

OPERATIONS = 51
"""Additions, multiplications, minima and maxima in `batched.sweep_tiles` for a contact; a fused one counts twice."""


def packed_pile(n_bodies: int, *, seed: int = 0, steps: int = 200) -> State:
    """A pile that does not have to fall first: unequal circles close to a hexagonal packing settle for `steps` steps.

    Radii are uniform in 0.8 to 1 m, so that no crystal forms and there are about as many contacts as in a pile
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
    return simulate(scene, steps=steps, solver=engines.solver_of(FEW, BatchedPGS)).state


def stored_pile(folder: Path, n_bodies: int, *, seed: int, steps: int) -> Path:
    """The file of `packed_pile` in the folder, made if it does not exist."""
    path = Path(folder) / f"packed_{n_bodies}_seed_{seed}_steps_{steps}.npz"
    return engines.stored_pile(path, lambda: packed_pile(n_bodies, seed=seed, steps=steps))


def read_pile(path: Path) -> State:
    """A stored pile two steps later: its contacts carry impulses."""
    return simulate(engines.read_pile(path), steps=2, solver=solver_of("sequential", FEW)).state


def solver_of(name: str, sweeps: int):
    """Options of one of ours with a fixed number of sweeps."""
    return engines.solver_of(sweeps, **OURS[name])


def step_costs(state: State, names: Sequence[str], *, steps: int, repeats: int) -> list[dict]:
    """Rows: of each engine on the pile, contacts, time of a step of ten sweeps, and the two unknowns."""
    ours = {name: partial(engines.Ours, **options) for name, options in OURS.items()}
    chosen = {name: (ours | engines.PEERS)[name] for name in names}
    measured = engines.measure(state, chosen, steps=steps, repeats=repeats)
    return [{"engine": name, "n_bodies": state.bodies.count, **costs} for name, costs in measured.items()]


def exponent(rows: Sequence[dict], least: int = 1000) -> float:
    """p of step time ~ contacts^p, fitted to the rows of one engine of at least so many circles."""
    rows = [row for row in rows if row["n_bodies"] >= least]
    return float(np.polyfit(np.log([row["contacts"] for row in rows]), np.log([row["step_us"] for row in rows]), 1)[0])


def stages(state: State, name: str, *, repeats: int) -> dict[str, float]:
    """Time of each stage of a step of one of ours on one thread, µs: the compiled functions, without Python.

    This function calls the internals of `physics`; nothing else in the study of scaling does.
    """
    bodies, contacts, n = state.bodies, state.contacts, state.bodies.count
    box, gravity, friction, restitution = engine.world_arguments(state)
    scales = state.scales
    solver = solver_of(name, FEW)
    settings, position_sweeps = engine.settings_of(solver), solver.position_sweeps
    rows, solver_bodies, _ = engine.step_problem(state, solver)
    buffer, cells = collision.make_contacts(4 * n + 64), collision.make_cells(n)
    moved = Bodies(*(field.copy() for field in bodies))
    crawling = engine.step_input(state, settings)._replace(dt=1e-9)

    def prepare():
        contact_solver.integrate_velocities(bodies, gravity, state.dt, solver_bodies)
        threshold = scales.restitution_threshold
        contact_solver.contact_rows(bodies, contacts, solver_bodies, restitution, threshold, rows)
        contact_solver.apply_impulses(rows, solver_bodies)

    def move():
        contact_solver.store_impulses(rows, contacts)
        contact_solver.integrate_positions(moved, solver_bodies, crawling)

    prepare()
    calls = {"velocities and rows": prepare}
    if isinstance(solver, BatchedPGS):
        plan = batches.plan_batches(rows.body, n, settings.colours, batches.make_plan(n, contacts.count))
        tiles = batches.fill_tiles(rows, solver_bodies, plan, batches.make_tiles(n, 1, 1, solver_bodies.dtype))

        def batch():
            batches.plan_batches(rows.body, n, settings.colours, plan)
            batches.fill_tiles(rows, solver_bodies, plan, tiles)
            batches.empty_tiles(plan, tiles, rows, solver_bodies)

        calls["batches"] = batch
        calls["sweeps"] = lambda: batched.sweep_all(settings, plan, tiles, friction)
        calls["position correction"] = lambda: batched.correct_positions_in_batches(
            settings, plan, tiles, moved, box, scales, position_sweeps
        )
    else:
        calls["sweeps"] = lambda: contact_solver.sweep(rows, friction, solver_bodies)
        room = position_correction.make_correction_room(n, 4 * n + 64)
        calls["position correction"] = lambda: position_correction.correct_positions(
            moved, contacts, box, scales, position_sweeps, room
        )
    calls["new positions"] = move
    calls["contacts"] = lambda: collision.next_contacts(bodies, box, scales.wall_skin, cells, contacts, True, buffer)
    found = {"batches": 0.0} | {stage: 1e6 * timing.fastest(call, repeats) for stage, call in calls.items()}
    return found | {"sweeps": FEW * found["sweeps"]}


def peak_memory(path: Path, name: str) -> int:
    """Peak resident memory of a fresh process that reads a pile and does three steps, bytes."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_peak_memory, path, name).result()


def _peak_memory(path: Path, name: str) -> int:
    simulate(read_pile(path), steps=3, solver=solver_of(name, FEW))
    try:
        # Not `getrusage`: a child's peak there starts from that of its parent.
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
    """Bytes per second that one core moves in a ← b + s c over three arrays of `size` bytes together (McCalpin's STREAM
    triad): from the cache that they fit into."""
    a, b, c = np.zeros(max(size // 24, 64)), np.ones(max(size // 24, 64)), np.ones(max(size // 24, 64))
    times = max(1, 20_000_000 // a.nbytes)
    return times * 3 * a.nbytes / timing.fastest(lambda: _triad(a, b, c, times), repeats)


def arithmetic(repeats: int = 5) -> float:
    """Operations per second of one core in fused multiplications and additions in float64, each counted as two."""
    times = 200_000
    return times * 12 * 2 * WIDTH / timing.fastest(lambda: _fused(times), repeats)


def floor(contacts: int, n_bodies: int, operations: float, precision: str = "double") -> dict[str, float]:
    """Least time for a contact and sweep, ns, from moving its memory once and from its operations.

    operations: per second, of `arithmetic`; single precision does twice as many.
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
    """Rows: convergence by order of relaxation on states of a falling pile, from Builtin.

    Velocity errors after so many sweeps, against the nearest of the solutions that the orders find with `past_need`
    sweeps, and sweeps until θ is a thousandth of a circle's impulse of weight.
    """
    found = []
    orders = {name: OURS[name] for name in ("sequential", "levels", "colours")}
    pile = tradeoff.pile("falling", n_bodies, seed)
    for number, state in enumerate(tradeoff.states_of(pile, count=states)):
        weight = weight_impulse(state)

        def solved(method, state=state, **options):
            return solve_contacts(state, solver=method(**options))

        solutions = {
            name: solved(**options, sweeps=past_need, tolerance=1e-6 * weight) for name, options in orders.items()
        }
        references = list(solutions.values())
        for name, options in orders.items():
            row = {"order": name, "state": number, "contacts": state.contacts.count}
            for k in sweeps:
                solution = solved(**options, sweeps=k, tolerance=None)
                row[f"error_{k}"] = metrics.nearest_velocity_error(state, solution, references)
            below = np.flatnonzero(solutions[name].record.theta <= 1e-3 * weight)
            row["sweeps"] = int(below[0]) + 1 if below.size else past_need
            found.append(row)
    return found
