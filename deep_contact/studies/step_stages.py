"""What a step is made of: the time of each stage inside the running step.

Functions called one by one from Python meet warm caches, and each call costs microseconds. So the source of the step
is compiled once more with the processor's cycle counter read before and after each stage; nothing else in it changes,
and it computes the same bits.
"""

from __future__ import annotations

import ast
import inspect
import platform
import textwrap
import time
from collections.abc import Callable

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from deep_contact.compiled.crew import ALONE
from deep_contact.physics import collision, engine
from deep_contact.physics.solvers import PGS, BatchedPGS, batched
from deep_contact.physics.solvers.registry import for_state
from deep_contact.physics.step import StepWorkspace, make_log
from deep_contact.state import Bodies, Contacts, State
from deep_contact.studies import timing

ENGINES = {"sequential": PGS, "colours": BatchedPGS}
"""Name -> method whose step is timed."""

STAGES = {
    "integrate_velocities": (72, 0),
    "contact_rows": (40, 136),
    "apply_impulses": (64, 80),
    "plan_batches": (16, 24),
    "write_blocks": (64, 216),
    "relax": (64, 96),
    "relax_tiles": (64, 96),
    "store_impulses": (0, 32),
    "store_blocks": (0, 40),
    "integrate_positions": (112, 0),
    "move": (112, 0),
    "correct_positions": (48, 16),
    "correct_positions_in_batches": (48, 16),
    "write_pairs": (24, 16),
    "has_list": (32, 0),
    "write_near_pairs": (24, 16),
    "write_geometry": (24, 56),
    "carry_impulses": (0, 80),
}
"""Stage -> bytes that it has to move for a circle and for a contact, in float64; of loops, in one sweep."""

SWEPT = ("relax", "relax_tiles")
"""Stages that go over the contacts once a sweep. Position correction stops when it likes: its floor is one sweep."""


def timed_step(advance: Callable) -> tuple[Callable, dict[str, int], np.ndarray]:
    """A step that times its stages: (function, stage -> number, cycles spent in each, which add up).

    advance: `engine.advance` or `batched.advance_together`. The function takes the arguments of the first.
    Raises RuntimeError on processors whose cycles a program may not read.
    """
    if platform.machine() not in ("x86_64", "AMD64"):
        raise RuntimeError(f"machine: expected x86_64, whose cycles a program may read, got {platform.machine()}")
    numbers: dict[str, int] = {}
    cycles = np.zeros(len(STAGES), np.int64)
    tick = _ticker(cycles.ctypes.data)
    inner: dict[str, Callable] = {"_tick": tick}
    by_a_crew = advance is batched.advance_together
    chain = (
        (batched.find_touching, batched.describe_touching)
        if by_a_crew
        else (collision.next_contacts, engine.advance_with)
    )
    for function in (collision.contacts_at, collision.find_contacts, *chain, advance):
        inner[function.py_func.__name__] = timed = _with_ticks(function.py_func, inner, numbers)
    if not by_a_crew:
        return timed, numbers, cycles

    def alone(given, options, workspace, log):
        shared = batched.make_shared(given.bodies.count, given.contacts, workspace.solver_bodies.dtype, 1)
        return timed(given, options, workspace, log, shared, ALONE)

    return alone, numbers, cycles


def _ticker(address: int) -> Callable:
    """A function (k, sign) that adds the cycle counter times the sign to the k-th number at the address."""

    @intrinsic
    def tick(context, k, sign):
        def emit(context, builder, signature, values):
            whole, name = ir.IntType(64), "llvm.readcyclecounter"
            counter = builder.module.globals.get(name)
            if counter is None:
                counter = ir.Function(builder.module, ir.FunctionType(whole, []), name)
            place = builder.inttoptr(builder.add(whole(address), builder.mul(values[0], whole(8))), whole.as_pointer())
            spent = builder.mul(builder.call(counter, []), values[1])
            builder.store(builder.add(builder.load(place), spent), place)
            return context.get_dummy_value()

        return types.void(types.int64, types.int64), emit

    return tick


def _with_ticks(function: Callable, inner: dict[str, Callable], numbers: dict[str, int]) -> Callable:
    """The function compiled with a tick before and after every statement that calls a stage."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    definition = tree.body[0]
    definition.decorator_list = []

    def ticked(body: list) -> list:
        found = []
        for statement in body:
            if isinstance(statement, (ast.For, ast.If, ast.While)):
                statement.body, statement.orelse = ticked(statement.body), ticked(statement.orelse)
            calls = {
                node.func.id for node in ast.walk(statement) if isinstance(node, ast.Call) and hasattr(node.func, "id")
            }
            stage = next((name for name in STAGES if name in calls), None)
            if stage is None or not isinstance(statement, (ast.Expr, ast.Assign)):
                found.append(statement)
                continue
            k = numbers.setdefault(stage, len(numbers))
            found += [*ast.parse(f"_tick({k}, -1)").body, statement, *ast.parse(f"_tick({k}, 1)").body]
        return found

    definition.body = ticked(definition.body)
    names = {**function.__globals__, **inner}
    exec(compile(ast.fix_missing_locations(tree), f"<{function.__name__} with ticks>", "exec"), names)
    return njit(error_model="numpy")(names[function.__name__])


@njit(cache=True, fastmath={"contract"})
def _triad(a, b, c, times):
    for k in range(times):
        share = 1.0 + k
        for i in range(a.shape[0]):
            a[i] = b[i] + share * c[i]


def bandwidth(size: int, repeats: int = 5) -> float:
    """Bytes per second that one core moves in a ← b + s c over three arrays of `size` bytes together (McCalpin's STREAM
    triad): from the cache that they fit into."""
    a, b, c = np.zeros(max(size // 24, 64)), np.ones(max(size // 24, 64)), np.ones(max(size // 24, 64))
    times = max(1, 20_000_000 // a.nbytes)
    return times * 3 * a.nbytes / timing.fastest(lambda: _triad(a, b, c, times), repeats)


def measure(state: State, solver, timed, *, steps: int, repeats: int) -> dict:
    """Nanoseconds a circle and step: of each stage that was reached with its floor, of all stages, and of the fastest
    whole run.

    The time of a stage is its least of the repeats, since other programs disturb one stage or another in every run.
    state: with contacts. timed: of `timed_step`. floor: from the bytes of `STAGES` at the bandwidth of the cache that
    they fit into (`bandwidth`), with the contacts and sweeps of the run.
    """
    function, numbers, cycles = timed
    solver = for_state(solver, state)
    _, options = engine.advance_of(solver)
    least, shortest = None, np.full(cycles.size, np.iinfo(np.int64).max)
    for _ in range(repeats + 1):
        copied = state.replace(
            bodies=Bodies(*(field.copy() for field in state.bodies)),
            contacts=Contacts(*(field.copy() for field in state.contacts)),
        )
        problem, log = engine.step_problem(copied, solver), make_log(steps)
        given = engine.step_input(copied, options.settings)._replace(friction=problem.friction)
        workspace = StepWorkspace(problem.solver_bodies, np.empty(solver.sweeps), np.empty(0))
        cycles[:] = 0
        start = time.perf_counter()
        function(given, options, workspace, log)
        seconds = time.perf_counter() - start
        shortest = np.minimum(shortest, cycles)
        if least is None or seconds < least[0]:
            least = seconds, int(cycles.sum()), log
    seconds, spent, log = least
    n, contacts, sweeps = state.bodies.count, float(log.contacts.mean()), float(log.sweeps.mean())
    per_circle = 1e9 * seconds / (steps * n)
    rate = bandwidth(int(sum(n * of_n + contacts * of_m for of_n, of_m in STAGES.values())))
    stages = {}
    for stage, k in numbers.items():
        if shortest[k] == 0:
            continue
        of_n, of_m = STAGES[stage]
        times = sweeps if stage in SWEPT else 1.0
        stages[stage] = {
            "ns": per_circle * float(shortest[k] / spent),
            "floor_ns": 1e9 * times * (of_n + of_m * contacts / n) / rate,
        }
    total = sum(cost["ns"] for cost in stages.values())
    return {"contacts": contacts, "sweeps": sweeps, "ns": total, "run_ns": per_circle, "stages": stages}


def timed_steps() -> dict[str, tuple]:
    """Name of one of `ENGINES` -> its timed step, sequential and by colours."""
    return {"sequential": timed_step(engine.advance), "colours": timed_step(batched.advance_together)}
