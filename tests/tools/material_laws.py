"""python tests/tools/material_laws.py janssen|collapse|ramps|rolling [--out FILE]: laws of the page Materials.

* janssen: silos of 50 to 400 disc diameters, whose floor sinks until the friction of the walls is mobilised at all
  heights, by some 5 % of the height. Janssen's K follows from the load on the floor. Walls of a material of their own,
  and walls of glued discs.
* collapse: columns that collapse, with and without rolling resistance: run-out by aspect ratio.
* ramps: loads that change by little in every step, for 300 or 500 steps, under five presets. Each run is compared with
  a run whose impulses are solved well in every step, both four times, shaken by 1e-7 m.
* rolling: errors of a solve whose rolling impulses λ_r start from 0, as they do, and from those of the step before.
"""

from __future__ import annotations

import argparse
import json
import math
import warnings
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import deep_contact as dc
from deep_contact.accuracy.presets import PRESETS
from deep_contact.io.files import write_json
from deep_contact.io.provenance import provenance
from deep_contact.stepping import rows as contact_rows
from deep_contact.stepping.interface import describe
from deep_contact.stepping.problem import step_problem

G = 9.81
SMALLEST, LARGEST = 0.4, 0.5
"""Radii of the discs, m."""
PITCH = 0.95
"""Distance of neighbours on the hexagonal lattice of the start, m."""


def packing(columns: int, rows: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Centres, (k, 2), on a jittered hexagonal lattice that begins at (0, 0), and radii, (k,), m."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    centres = np.column_stack([(column + 0.5 * (row % 2)) * PITCH, row * PITCH * math.sqrt(0.75)])
    return centres + rng.uniform(-0.01, 0.01, centres.shape), rng.uniform(SMALLEST, LARGEST, len(centres))


def begun(args, *keys: str) -> tuple[list[dict], set]:
    """The rows that the file of results has already, and the values of these keys in each, so that a run goes on."""
    rows = []
    if args.out and args.out.exists():
        rows = json.loads(args.out.read_text())["laws"].get(args.law, {"rows": []})["rows"]
    return rows, {tuple(row.get(key) for key in keys) for row in rows}


def add(args, rows: list[dict], row: dict) -> None:
    """Append a row, print it, and store all rows."""
    rows.append(row)
    print(row, flush=True)
    if args.out:
        store(args.out, args.law, rows)


# ---- Janssen ----

COLUMNS, SINKS, MU = 9, 0.2, 0.5
WIDTH = (COLUMNS - 0.5) * PITCH + 2.0 * LARGEST
"""Distance of the walls, m."""


def silo(height: int, walls: str, friction: float, seed: int) -> dc.State:
    """A silo of this height in mean diameters. walls: "material" with this friction, or "glued" discs."""
    rng = np.random.default_rng((5, seed))
    rows = round(height * (SMALLEST + LARGEST) / (PITCH * math.sqrt(0.75)))
    centres, radii = packing(COLUMNS, rows, rng)
    top = 1.1 * rows * PITCH * math.sqrt(0.75) + 5.0
    grains = dc.make_bodies(centres + LARGEST, radius=radii)
    box = (0.0, -20.0, WIDTH, top)
    if walls == "glued":
        y = np.arange(-19.0, top - 1.0, SMALLEST + LARGEST)
        of_walls = [np.column_stack([np.full(len(y), x), y]) for x in (-LARGEST, WIDTH + LARGEST)]
        glued = dc.make_bodies(np.concatenate(of_walls), radius=LARGEST, fixed=True)
        box = (-2.0, -20.0, WIDTH + 2.0, top)
    world = dc.World(
        box=box, friction=[[MU, friction], [friction, MU]], wall_materials=(1, 1, 1, 1),
        segments=[((box[0], 0.0), (box[2], 0.0))], segment_materials=[1],
        segment_velocities=[((0.0, -SINKS), (0.0, -SINKS))],
    )  # fmt: skip
    state = dc.State(name="silo", world=world, bodies=grains, dt=0.007)
    return state.with_bodies(add=glued) if walls == "glued" else state


def janssen_k(load: float, weight: float, height: float, friction: float) -> float:
    """K at which the floor carries `load`: load = λ w (1 − exp(−h / λ)), λ = D / (2 μ K), w = weight / height.

    NaN if no K does, since the walls carry nothing, or more than the weight.
    """
    if not (0.0 < load < weight and friction > 0.0):
        return math.nan

    def excess(k):
        length = WIDTH / (2.0 * friction * k)
        return length * weight / height * -math.expm1(-height / length) - load

    return brentq(excess, 1e-4, 50.0)


def known(value) -> float | None:
    """The number, or None in place of NaN."""
    return None if np.isnan(value) else float(value)


def one_silo(height: int, walls: str, friction: float, seed: int, settle: int, steps: int) -> dict:
    """K and the numbers that it follows from: means over the last `steps` steps, in four parts."""
    state = silo(height, walls, friction, seed)
    is_glued = state.bodies.is_fixed
    solver = dc.PGS(sweeps=40, tolerance=None)
    run = dc.simulate(state, steps=settle, solver=solver)
    run = dc.simulate(run.state, steps=steps, solver=solver, record=steps // 4, forces=True)
    floor = -run.force_on("segment", 0)[:, 1]
    if is_glued.any():
        left = is_glued & (state.bodies.position[:, 0] < 0.0)
        on_left, on_right = (-run.force_on("circle", side) for side in (left, is_glued & ~left))
    else:
        on_left, on_right = run.force_on("left"), run.force_on("right")
    mobilised = (np.abs(on_left[:, 1]) + np.abs(on_right[:, 1])) / (np.abs(on_left[:, 0]) + np.abs(on_right[:, 0]))
    end = run.state.bodies
    weight = G * end.free_mass.sum()
    bottom = run.state.world.segments[0][1]
    h = 2.0 * float((end.position[~is_glued, 1] - bottom) @ end.mass[~is_glued] / end.mass[~is_glued].sum())
    ks = [janssen_k(load, weight, h, mu) for load, mu in zip(floor, mobilised)]
    speed = np.hypot(*(end.velocity[~is_glued] - (0.0, -SINKS)).T)
    return {
        "height": height, "walls": walls, "friction": friction, "seed": seed, "discs": int((~is_glued).sum()),
        "filled": h, "floor over weight": float(floor.mean() / weight), "mobilised": known(mobilised.mean()),
        "K": known(np.mean(ks)), "K of parts": [*map(known, ks)], "median speed": float(np.median(speed)),
    }  # fmt: skip


def janssen(args) -> None:
    rows, done = begun(args, "walls", "friction", "height", "seed")
    for height in args.heights:
        for walls, friction in (("material", 0.3), ("material", 0.5), ("glued", 0.5)):
            for seed in range(args.seeds):
                if (walls, friction, height, seed) not in done:
                    add(args, rows, one_silo(height, walls, friction, seed, 1200 + 20 * height, 800))


# ---- collapse ----


def collapse_scene(width: int, aspect: float, rho: float, seed: int) -> tuple[dc.State, float]:
    """A column that nothing holds, `width` discs wide, of height `aspect` times half its width; that half, m."""
    rng = np.random.default_rng((6, seed))
    half = 0.5 * width * PITCH
    centres, radii = packing(width, round(aspect * half / (PITCH * math.sqrt(0.75))), rng)
    room = half * (4.0 + 4.0 * aspect)
    box = (0.0, 0.0, 2.0 * room, 1.2 * centres[:, 1].max() + 4.0)
    bodies = dc.make_bodies(centres + np.array([room - half, LARGEST]), radius=radii)
    world = dc.World(box=box, friction=MU, rolling_friction=rho)
    return dc.State(name="collapse", world=world, bodies=bodies, dt=0.007), half


def heap_of(state: dc.State, gap: float = 0.05) -> np.ndarray:
    """Which circles belong to the largest group whose members are nearer than `gap` m to each other, (n,)."""
    contacts, n = state.contacts, state.bodies.count
    near = contacts.body_b < n
    graph = coo_array((np.ones(near.sum()), (contacts.body_a[near], contacts.body_b[near])), shape=(n, n))
    label = connected_components(graph, directed=False)[1]
    return label == np.bincount(label).argmax()


def one_collapse(width: int, aspect: float, rho: float, seed: int) -> dict:
    """Run-out (L∞ − L₀) / L₀, and the height over L₀, of the heap that is left."""
    state, half = collapse_scene(width, aspect, rho, seed)
    steps = round((5.0 * math.sqrt(2.0 * aspect * half / G) + 4.0) / state.dt)
    end = dc.simulate(state, steps=steps, solver=dc.PGS(sweeps=20, tolerance=None)).state
    heap, x = heap_of(end), end.bodies.position[:, 0]
    mine = x[heap]
    length = 0.5 * (mine.max() - mine.min()) + 0.5 * (SMALLEST + LARGEST)
    quantile = 0.5 * float(np.subtract(*np.quantile(x, [0.99, 0.01])))
    return {
        "width": width, "aspect": aspect, "rho": rho, "seed": seed,
        "discs": state.bodies.count, "in heap": int(heap.sum()),
        "run-out": float(length / half - 1.0), "run-out of 98 %": quantile / half - 1.0,
        "height": float(end.bodies.position[heap, 1].max() / half),
        "rms speed": float(np.sqrt((end.bodies.velocity[heap] ** 2).sum(axis=1).mean())),
    }  # fmt: skip


def collapse(args) -> None:
    rows, done = begun(args, "width", "rho", "aspect", "seed")
    for width, aspect, rho, seed in product(args.widths, args.aspects, args.rho, range(args.seeds)):
        if (width, rho, aspect, seed) not in done:
            add(args, rows, one_collapse(width, aspect, rho, seed))


# ---- ramps ----

STRONGEST = 300.0
"""Largest force of the ramp of a push, N."""


def turned(angle: float) -> tuple[float, float]:
    """Gravity, m/s², turned by an angle, rad."""
    return G * math.sin(angle), -G * math.cos(angle)


RAMPS = {
    "gravity turned by 1e-5 rad a step": (300, lambda k: {"gravity": turned(1e-5 * k)}),
    "gravity turned by 1e-3 rad a step": (300, lambda k: {"gravity": turned(1e-3 * k)}),
    "gravity turned by 1e-2 rad a step": (300, lambda k: {"gravity": turned(1e-2 * k)}),
    "gravity to 0": (500, lambda k: {"gravity": (0.0, -G * (1.0 - k / 500))}),
    "friction 0.5 to 0.1": (500, lambda k: {"friction": 0.5 - 0.4 * k / 500}),
    "push to 300 N and back": (500, lambda k: {"push": STRONGEST * (1.0 - abs(k / 250 - 1.0))}),
}
"""Name of a ramp -> (number of steps, change before step k = 1, 2, …)."""
SHAKEN = 4


def pushed(state: dc.State, newtons: float) -> np.ndarray:
    """A force on the circle in the middle of the pile, N, (n, 2)."""
    force = np.zeros((state.bodies.count, 2))
    force[state.bodies.count // 2, 0] = newtons
    return force


def shaken(state: dc.State, k: int) -> dc.State:
    """The pile with its circles moved at random by up to 1e-7 m; as it is if k is 0."""
    if k == 0:
        return state
    chance = np.random.default_rng((8, k)).uniform(-1e-7, 1e-7, state.bodies.position.shape)
    return state.replace(bodies=state.bodies._replace(position=state.bodies.position + chance), load=None)


def numbers_of(state: dc.State, fastest: list[float]) -> dict[str, float]:
    """Mean height, m, and energy per m g r̄, at the end of a ramp, and the largest speed in it, m/s."""
    bodies = state.bodies
    turn, mass = 0.5 * bodies.mass * bodies.radius**2, bodies.mass
    kinetic = 0.5 * float(mass @ (bodies.velocity**2).sum(axis=1) + turn @ bodies.spin**2)
    energy = kinetic - float(mass @ (bodies.position @ np.array(state.world.gravity)))
    return {
        "height": float(bodies.position[:, 1].mean()), "top speed": max(fastest),
        "energy": energy / (G * float(mass @ bodies.radius)),
    }  # fmt: skip


def ramp_live(state: dc.State, preset: str, steps: int, change) -> dict[str, float]:
    """A ramp as users do it, by `Simulator.set`."""
    first = change(1)
    push = pushed(state, 0.0) if "push" in first else None
    live, fastest = dc.Simulator(state, accuracy=preset, push=push), []
    for k in range(1, steps + 1):
        now = change(k)
        live.set(**now if "push" not in now else {"push": pushed(state, now["push"])})
        live.step()
        fastest.append(float(np.hypot(*live.velocities.T).max()))
    return numbers_of(live.state, fastest)


def ramp_resolved(state: dc.State, preset: str, steps: int, change) -> dict[str, float]:
    """The same ramp; each step starts from impulses that NesterovPGS has solved well for its load."""
    fastest, well = [], dc.NesterovPGS(sweeps=1000, tolerance=1e-7)
    for k in range(1, steps + 1):
        now, push = change(k), None
        if "push" in now:
            push = pushed(state, now["push"])
            state = state.replace(push=(push, np.zeros(len(push))))
        else:
            state = state.replace(world=replace(state.world, **now))
        solved = dc.solve_contacts(state, solver=well)
        contacts = state.contacts._replace(
            normal_start=solved.normal_impulses, tangent_start=solved.tangent_impulses,
            normal_impulse=solved.normal_impulses, tangent_impulse=solved.tangent_impulses,
        )  # fmt: skip
        state = state.replace(contacts=contacts, load=None)  # no load: nothing is tested or sought
        state = dc.simulate(state, steps=1, accuracy=preset, push=push).state
        fastest.append(float(np.hypot(*state.bodies.velocity.T).max()))
    return numbers_of(state, fastest)


def one_ramp(pile: dc.State, preset: str, name: str) -> dict:
    """A ramp, live and solved well in every step: numbers of all runs, and by quantity [difference, noise, within]."""
    steps, change = RAMPS[name]
    row = {"preset": preset, "ramp": name, "solver": describe(pile.solver)}
    for how, ramp in (("live", ramp_live), ("resolved", ramp_resolved)):
        runs = [ramp(shaken(pile, k), preset, steps, change) for k in range(SHAKEN)]
        row[how] = {key: [run[key] for run in runs] for key in runs[0]}
    row["verdicts"] = {}
    for key, ours in row["live"].items():
        theirs = row["resolved"][key]
        noise, apart = float(max(np.ptp(ours), np.ptp(theirs))), float(np.mean(ours) - np.mean(theirs))
        row["verdicts"][key] = [apart, noise, bool(abs(apart) <= noise)]
    return row


def ramps(args) -> None:
    rows, done = begun(args, "preset", "ramp")
    for preset in args.presets:
        left = [name for name in RAMPS if args.only in name and (preset, name) not in done]
        if not left:
            continue
        scene = dc.circles_in_box(args.circles, size=(16.0, 40.0), seed=3)
        pile = dc.simulate(scene, steps=1000, accuracy=preset).state
        for name in left:
            add(args, rows, one_ramp(pile, preset, name))


# ---- rolling impulses, carried or not ----


def relaxed(problem, v, sweeps: int) -> None:
    for _ in range(sweeps):
        contact_rows.sweep(problem.rows, problem.friction, v)


def start_of(problem, rolling=None) -> np.ndarray:
    """Velocities after the starting impulses of a problem, whose λ_r are 0, or these, (m,), N·m·s."""
    v, rows = problem.solver_bodies.copy(), problem.rows
    if rolling is None:
        contact_rows.apply_impulses(rows, v, problem.friction)
        return v
    for i in range(len(rows.body)):
        a, b = rows.body[i]
        normal, arms = tuple(rows.data[i, :2]), tuple(rows.data[i, 4:6])
        contact_rows.apply_impulse(v, a, b, normal, arms, tuple(rows.impulse[i, :2]))
        rows.impulse[i, contact_rows.ROLL] = p = rolling[i]
        v[a, contact_rows.V_S] -= 2.0 * v[a, contact_rows.INVERSE_MASS] * rows.data[i, contact_rows.TURN_A] * p
        v[b, contact_rows.V_S] += 2.0 * v[b, contact_rows.INVERSE_MASS] * rows.data[i, contact_rows.TURN_B] * p
    return v


def rolling_of(state, problem) -> dict:
    """Pair of bodies -> λ_r of the rows of a problem of this state, N·m·s."""
    c = state.contacts
    return dict(zip(zip(c.body_a.tolist(), c.body_b.tolist()), problem.rows.impulse[:, contact_rows.ROLL].tolist()))


def error_of(v, exact, n: int) -> float:
    """Rms difference of the velocities (v_x, v_y, ω r), m/s."""
    return float(np.sqrt(np.mean((v[:n, :3] - exact[:n, :3]) ** 2)))


def rolling(args) -> None:
    """Errors after 5 to 40 sweeps, in m/s, medians over states of a pile that settles, and of one at rest."""
    solver, rows = dc.PGS(sweeps=20, tolerance=None), []
    scene, _ = collapse_scene(2.0, 0.1, 0)
    for name, first in (("collapsing", 150), ("at rest", 3000)):
        state = dc.simulate(scene, steps=first, solver=solver).state
        errors = {}
        for _ in range(10):
            before = step_problem(state, solver=solver)
            relaxed(before, start_of(before), 20)
            carried = rolling_of(state, before)
            state = dc.simulate(state, steps=1, solver=solver).state
            exact = step_problem(state, solver=solver)
            v_exact = start_of(exact)
            relaxed(exact, v_exact, 20_000)
            c, n = state.contacts, state.bodies.count
            known = np.array([carried.get(pair, 0.0) for pair in zip(c.body_a.tolist(), c.body_b.tolist())])
            for sweeps in (5, 10, 20, 40):
                for how in ("from 0", "from 0, no sweeps of their own", "carried"):
                    problem = step_problem(state, solver=solver)
                    start = None if how == "from 0" else known if how == "carried" else np.zeros_like(known)
                    v = start_of(problem, start)
                    relaxed(problem, v, sweeps)
                    errors.setdefault((how, sweeps), []).append(error_of(v, v_exact, n))
        for (how, sweeps), values in errors.items():
            add(args, rows, {"pile": name, "start": how, "sweeps": sweeps, "error": float(np.median(values))})


def store(path: Path, law: str, rows) -> None:
    """Write what was found on a law to a results file, beside what the file has on other laws."""
    record = json.loads(path.read_text()) if path.exists() else {"laws": {}}
    record["laws"][law] = {"rows": rows, "provenance": provenance()}
    write_json(path, record)


LAWS = {"janssen": janssen, "collapse": collapse, "ramps": ramps, "rolling": rolling}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("law", choices=LAWS)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--heights", type=int, nargs="*", default=[50, 100, 200, 400], help="of silos, in diameters")
    parser.add_argument("--widths", type=int, nargs="*", default=[20], help="of columns, in discs")
    parser.add_argument("--aspects", type=float, nargs="*", default=[1.0, 2.0, 4.0, 8.0, 16.0])
    parser.add_argument("--rho", type=float, nargs="*", default=[0.0, 0.045, 0.09], help="rolling resistance, m")
    parser.add_argument("--presets", nargs="*", default=list(PRESETS))
    parser.add_argument("--circles", type=int, default=120, help="of the piles of the ramps")
    parser.add_argument("--only", default="", help="part of the names of the ramps")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    LAWS[args.law](args)


if __name__ == "__main__":
    main()
