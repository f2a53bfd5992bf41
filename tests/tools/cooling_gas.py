"""python tests/tools/cooling_gas.py [--circles 1024] [--seeds 16] [--out FILE]: Haff's law by events and by steps.

Smooth discs with e = 0.9 between elastic walls lose energy so that T = T₀ / (1 + t / τ)² (Haff 1983). From the same
positions and velocities, each gas cools twice: event by event, without any time step (`cool_by_events`), and by the
engine at several Δt. The rate 1 / τ is the slope of √(T₀ / T) over time. It is compared with

    1 / τ = (1 − e²) ω₀ / 4 · (1 + 3 a₂ / 16),   ω₀ = 2 n d χ √(π T₀ / m),

with Enskog's χ = (1 − 7 φ / 16) / (1 − φ)² (Henderson 1975) and the fourth cumulant a₂ of the velocities (van Noije and
Ernst, Granular Matter 1, 57, 1998). In a box of side L, centres lie in a square of side L − d. There the density is
higher, and discs near a wall lack neighbours on one side: `pairs_in_box`.

The energy lost until the end is compared seed by seed. With a short `--end`, both gases have had nearly the same
collisions, so that this ratio has little noise.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np
from numba import njit

import deep_contact as dc

DIAMETER, MASS = 1.0, 1.0
NEVER = 1e300


def gas(count: int, side: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres, (count, 2), on a lattice, and velocities, (count, 2), from Maxwell's distribution with T = 1."""
    rng = np.random.default_rng((3, seed))
    row = math.isqrt(count)
    pitch = side / row
    x, y = np.meshgrid((np.arange(row) + 0.5) * pitch, (np.arange(row) + 0.5) * pitch)
    centres = np.column_stack([x.ravel(), y.ravel()])[:count]
    centres += rng.uniform(-0.45, 0.45, centres.shape) * (pitch - DIAMETER)
    return centres, rng.normal(0.0, 1.0, centres.shape)


@njit(cache=True)
def next_of(i, position, velocity, local, now, inner, side):
    """The next event of disc i after `now`: (time, partner). Partners from count on are walls.

    position: at the times `local` of the discs. inner: radius of the discs.
    """
    count, best, partner = position.shape[0], NEVER, -1
    x = position[i, 0] + velocity[i, 0] * (now - local[i])
    y = position[i, 1] + velocity[i, 1] * (now - local[i])
    for axis in range(2):
        at, speed = (x, velocity[i, 0]) if axis == 0 else (y, velocity[i, 1])
        if speed > 0.0:
            when = now + (side - inner - at) / speed
        elif speed < 0.0:
            when = now + (inner - at) / speed
        else:
            continue
        if when < best:
            best, partner = max(when, now), count + axis
    square = 4.0 * inner * inner
    for j in range(count):
        if j == i:
            continue
        d_x = position[j, 0] + velocity[j, 0] * (now - local[j]) - x
        d_y = position[j, 1] + velocity[j, 1] * (now - local[j]) - y
        v_x, v_y = velocity[j, 0] - velocity[i, 0], velocity[j, 1] - velocity[i, 1]
        along = d_x * v_x + d_y * v_y
        if along >= 0.0:
            continue
        speed = v_x * v_x + v_y * v_y
        root = along * along - speed * (d_x * d_x + d_y * d_y - square)
        if root < 0.0:
            continue
        when = now + max(0.0, (-along - math.sqrt(root)) / speed)
        if when < best:
            best, partner = when, j
    return best, partner


@njit(cache=True)
def cool_by_events(position, velocity, side, inner, e, times):
    """Kinetic energies over the count, that is T / m, at these times, (k,), of discs with restitution e. In place.

    Walls have e = 1. Each disc has its next event. An event sets those of its two discs anew, and of all discs that
    would have met one of them. Returns (energies, collisions until each time).
    """
    count = position.shape[0]
    local, when, partner = np.zeros(count), np.empty(count), np.empty(count, np.int64)
    heat, hits, collisions, k = np.empty(times.shape[0]), np.zeros(times.shape[0], np.int64), 0, 0
    for i in range(count):
        when[i], partner[i] = next_of(i, position, velocity, local, 0.0, inner, side)
    while k < times.shape[0]:
        i = 0
        for j in range(1, count):
            if when[j] < when[i]:
                i = j
        now, other = when[i], partner[i]
        while k < times.shape[0] and times[k] <= now:
            heat[k], hits[k] = 0.5 * np.sum(velocity * velocity) / count, collisions
            k += 1
        position[i] += velocity[i] * (now - local[i])
        local[i] = now
        if other >= count:
            velocity[i, other - count] = -velocity[i, other - count]
        else:
            position[other] += velocity[other] * (now - local[other])
            local[other] = now
            n_x, n_y = position[other, 0] - position[i, 0], position[other, 1] - position[i, 1]
            size = math.hypot(n_x, n_y)
            n_x, n_y = n_x / size, n_y / size
            closing = (velocity[i, 0] - velocity[other, 0]) * n_x + (velocity[i, 1] - velocity[other, 1]) * n_y
            change = 0.5 * (1.0 + e) * closing
            velocity[i, 0] -= change * n_x
            velocity[i, 1] -= change * n_y
            velocity[other, 0] += change * n_x
            velocity[other, 1] += change * n_y
            collisions += 1
        for j in range(count):
            if j == i or j == other or partner[j] == i or (other < count and partner[j] == other):
                when[j], partner[j] = next_of(j, position, velocity, local, now, inner, side)
    return heat, hits


def pairs_in_box(side: float, diameter: float = DIAMETER) -> float:
    """Pairs of discs in contact in a box over those in a periodic square of the same side, at low density.

    Centres lie in a square of side l = L − d. A second centre at distance d in the direction θ lies there too for a
    share (l − d |cos θ|) (l − d |sin θ|) / l² of the places; the mean over θ is 1 − 4 d / (π l) + d² / (π l²).
    """
    inner = side - diameter
    share = diameter / inner
    return (side / inner) ** 2 * (1.0 - 4.0 * share / math.pi + share**2 / math.pi)


def theory(count: int, side: float, e: float, heat: float) -> dict[str, float]:
    """1 / τ, 1/s, by Haff's law with the corrections one by one. heat: T₀ / m, m²/s²."""
    phi = count * math.pi * (0.5 * DIAMETER) ** 2 / side**2
    chi = (1.0 - 7.0 * phi / 16.0) / (1.0 - phi) ** 2
    plain = (1.0 - e * e) / 4.0 * 2.0 * count / side**2 * DIAMETER * chi * math.sqrt(math.pi * heat)
    a_2 = 16.0 * (1.0 - e) * (1.0 - 2.0 * e * e) / (57.0 - 25.0 * e + 30.0 * e * e * (1.0 - e))
    walls = pairs_in_box(side) * (1.0 - 1.0 / count)  # and no disc meets itself
    return {"plain": plain, "cumulant": 1.0 + 3.0 * a_2 / 16.0, "walls": walls, "phi": phi, "chi": chi}


def rate_of(times, heat, first=0.0) -> float:
    """Slope of √(T₀ / T) over time, 1/s, from the time `first` on."""
    part = times >= first
    return float(np.polyfit(times[part], np.sqrt(heat[0] / heat[part]), 1)[0])


def cool_by_steps(position, velocity, side: float, e: float, dt: float, times, solver) -> np.ndarray:
    """T / m at these times of the engine's gas."""
    bodies = dc.make_bodies(position, radius=0.5 * DIAMETER, mass=MASS, velocity=velocity)
    world = dc.World(
        box=(0.0, 0.0, side, side), gravity=(0.0, 0.0), friction=0.0, restitution=[[e, 1.0], [1.0, 1.0]],
        wall_materials=(1, 1, 1, 1),
    )  # fmt: skip
    scene = dc.State(name="gas", world=world, bodies=bodies, dt=dt)
    every = round(float(times[1] - times[0]) / dt)
    run = dc.simulate(scene, steps=every * (len(times) - 1), solver=solver, record=every)
    return 0.5 * (run.trajectory.velocities**2).sum(axis=2).mean(axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--circles", type=int, default=1024)
    parser.add_argument("--side", type=float, default=128.0)
    parser.add_argument("--restitution", type=float, default=0.9)
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--end", type=float, default=80.0, help="time of the last state, s")
    steps = [0.02, 0.01, 0.005, 0.0025]
    parser.add_argument("--steps", type=float, nargs="*", default=steps, help="Δt of the engine, s")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    e, times, name = args.restitution, np.linspace(0.0, args.end, 41), f"haff, side {args.side:g}, {args.end:g} s"
    kinds = ["events", *map(str, args.steps)]
    rows = []
    if args.out and args.out.exists():
        rows = json.loads(args.out.read_text())["laws"].get(name, {"rows": []})["rows"]
    for seed in range(args.seeds):
        for kind in kinds:
            if any((row["seed"], row["by"]) == (seed, kind) for row in rows):
                continue
            position, velocity = gas(args.circles, args.side, seed)
            law = theory(args.circles, args.side, e, 0.5 * (velocity**2).sum() / args.circles)
            if kind == "events":
                heat, _ = cool_by_events(position, velocity, args.side, 0.5 * DIAMETER, e, times)
            else:
                solver = dc.PGS(sweeps=4, tolerance=None)
                heat = cool_by_steps(position, velocity, args.side, e, float(kind), times, solver)
            ratio = rate_of(times, heat) / (law["plain"] * law["cumulant"] * law["walls"])
            lost = float(heat[0] - heat[-1])
            rows.append({"by": kind, "seed": seed, "covered": law["phi"], "rate over theory": ratio, "lost": lost})
            if args.out:
                from material_laws import store  # which lies in this folder

                store(args.out, name, rows)
    lost = {(row["seed"], row["by"]): row["lost"] for row in rows}
    for kind in kinds:
        rates = [row["rate over theory"] for row in rows if row["by"] == kind]
        losses = [lost[seed, kind] / lost[seed, "events"] for seed in range(args.seeds)]
        print(f"{kind:8} rate over theory {within(rates)}, energy lost over that of events {within(losses)}")


def within(values: list[float]) -> str:
    """Mean and its standard error."""
    return f"{np.mean(values):.4f} ± {np.std(values, ddof=1) / math.sqrt(len(values)):.4f}"


if __name__ == "__main__":
    main()
