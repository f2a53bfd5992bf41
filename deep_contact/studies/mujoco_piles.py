"""Our piles in MuJoCo: what a step costs there, and how far what comes out is from an exact solution.

MuJoCo is for soft contacts in space. Here every body is a sphere with the inertia of a disc on two slides and a hinge,
and the walls are planes, so that it has our bodies, contacts and unknowns. Its elliptic cones and its solvers' own
limits are kept; its Jacobian is sparse.
"""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np

import deep_contact as dc
from deep_contact.physics import metrics
from deep_contact.physics.exact import solve_exactly
from deep_contact.reporting.figures import seeds
from deep_contact.simulation import ready
from deep_contact.state import Bodies, State
from deep_contact.studies.piles import pile, states_of

OURS = {"ours, PGS, 20 sweeps": dc.PGS(sweeps=20, tolerance=None), "ours, NNCG, 300 sweeps": dc.NNCG(sweeps=300)}

DEFAULT = {"solimp": "0.9 0.95 0.001", "solref": "0.02 1"}
"""MuJoCo's own: a contact meets 0.9 of its acceleration at its touch and 0.95 when 1 mm deep, and is damped critically
with a time constant of 0.02 s. No shorter one is admitted at Δt = 0.01 s."""

STIFF = DEFAULT | {"solimp": "0.9999 0.9999 0.001"}

NO_SPRING = STIFF | {"solref": "-1e-9 -100"}
"""Damping alone, which ends an approach in a step of 0.01 s, as in our problem. Nothing pushes apart what overlaps."""

MUJOCO = {
    "MuJoCo, Newton": {"solver": "Newton"} | DEFAULT,
    "MuJoCo, PGS": {"solver": "PGS"} | DEFAULT,
    "MuJoCo, Newton, stiff": {"solver": "Newton"} | STIFF,
    "MuJoCo, Newton, no spring": {"solver": "Newton"} | NO_SPRING,
}


class MuJoCoPile:
    """The bodies of a state in its box, without segments, in MuJoCo. Raises ImportError where that is missing."""

    def __init__(self, state: State, *, solver: str, solimp: str, solref: str):
        import mujoco

        self._mujoco, self._bodies = mujoco, state.bodies
        self._model = mujoco.MjModel.from_xml_string(_xml(state, solver, solimp, solref))
        self._data = mujoco.MjData(self._model)
        self._data.qvel[:] = np.column_stack([state.bodies.velocity, state.bodies.spin]).ravel()

    def step(self, steps: int = 1) -> None:
        """So many steps of the state's Δt."""
        self._mujoco.mj_step(self._model, self._data, steps)

    def bodies(self) -> Bodies:
        """The bodies now."""
        moved, velocity = self._data.qpos.reshape(-1, 3), self._data.qvel.reshape(-1, 3)
        return self._bodies._replace(
            position=self._bodies.position + moved[:, :2],
            angle=self._bodies.angle + moved[:, 2],
            velocity=velocity[:, :2].copy(),
            spin=velocity[:, 2].copy(),
        )


def _xml(state: State, solver: str, solimp: str, solref: str) -> str:
    """The model: our x and y are its x and z, and our turns are those about −y."""
    world, bodies, skin = state.world, state.bodies, state.scales.wall_skin
    x_min, y_min, x_max, y_max = world.box
    walls = (
        (0, y_min + skin, "0 0 1"), (x_max - skin, 0, "-1 0 0"),
        (0, y_max - skin, "0 0 -1"), (x_min + skin, 0, "1 0 0"),
    )  # fmt: skip
    planes = "".join(f'<geom type="plane" size="0 0 1" pos="{x!r} 0 {z!r}" zaxis="{up}"/>' for x, z, up in walls)
    columns = (bodies.position, bodies.mass, 0.5 * bodies.mass * bodies.radius**2, bodies.radius)
    spheres = "".join(
        f'<body pos="{x!r} 0 {z!r}"><inertial pos="0 0 0" mass="{mass!r}" diaginertia="{turn!r} {turn!r} {turn!r}"/>'
        f'<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint axis="0 -1 0"/>'
        f'<geom size="{radius!r}"/></body>'
        for (x, z), mass, turn, radius in zip(*(column.tolist() for column in columns))
    )
    g_x, g_y = world.gravity
    return (
        f'<mujoco><option timestep="{state.dt!r}" gravity="{g_x!r} 0 {g_y!r}" solver="{solver}" cone="elliptic" '
        f'jacobian="sparse"/><size memory="1G"/><default><geom friction="{world.friction!r}" '
        f'solimp="{solimp}" solref="{solref}"/></default><worldbody>{planes}{spheres}</worldbody></mujoco>'
    )


def compare(
    counts: Iterable[int], *, repeats: int = 5, steps: int = 10, settled: int = 300, seed: int = 0
) -> list[dict]:
    """A settling pile of each number of circles, in ours and in MuJoCo. Raises ImportError where that is missing.

    Rows with circles, contacts, engine; seconds: of the processor for a step, over `steps` steps from that state, the
    least of `repeats` in turns; velocity_error: of one step against an exact solution (`metrics.velocity_error`), None
    where there is none; deepest: of the contacts after `settled` more steps, m.
    """
    counts, rows = list(counts), []
    for count, own in zip(counts, seeds(seed, len(counts))):
        state = ready(states_of(pile("settling", count, own), count=1)[0])
        exact = solve_exactly(state, state.contacts.normal_impulse, state.contacts.tangent_impulse)
        engines = OURS | MUJOCO
        seconds = dict.fromkeys(engines, np.inf)
        for turn in range(repeats + 1):  # the first compiles
            for name, setting in engines.items():
                taken = _timed(state, setting, steps)
                seconds[name] = min(seconds[name], taken if turn else np.inf)
        for name, setting in engines.items():
            error = None
            if exact.converged:
                after = _after(state, setting, 1)
                moved = exact.solution._replace(velocities=after.velocity, angular_velocities=after.spin)
                error = metrics.velocity_error(state, moved, exact.solution)
            end = ready(state.replace(bodies=_after(state, setting, settled), contacts=None))
            rows.append(
                {
                    "circles": count, "contacts": state.contacts.count, "engine": name, "seconds": seconds[name],
                    "velocity_error": error, "deepest": float(max(0.0, -end.contacts.separation.min(initial=0.0))),
                }
            )  # fmt: skip
    return rows


def _timed(state: State, setting, steps: int) -> float:
    """Seconds of the processor for a step, without building a world."""
    world = MuJoCoPile(state, **setting) if isinstance(setting, dict) else None
    begin = time.process_time()
    if world:
        world.step(steps)
    else:
        dc.simulate(state, steps=steps, solver=setting)
    return (time.process_time() - begin) / steps


def _after(state: State, setting, steps: int) -> Bodies:
    """The bodies after so many steps of ours, or of MuJoCo."""
    if not isinstance(setting, dict):
        return dc.simulate(state, steps=steps, solver=setting).state.bodies
    world = MuJoCoPile(state, **setting)
    world.step(steps)
    return world.bodies()


def table(rows: list[dict]) -> list[list[str]]:
    """The rows by engine, head first: time of a step, velocity error and deepest contact for each pile."""
    sizes = {row["circles"]: row["contacts"] for row in rows}
    cells = {(row["engine"], row["circles"]): row for row in rows}
    found = [["engine", *(f"{count:,} circles, {contacts:,} contacts" for count, contacts in sizes.items())]]
    for engine in dict.fromkeys(row["engine"] for row in rows):
        line = [engine]
        for count in sizes:
            row = cells[engine, count]
            error = "–" if row["velocity_error"] is None else f"{row['velocity_error']:.2g}"
            line.append(f"{1e3 * row['seconds']:.3g} ms, error {error}, {1e3 * row['deepest']:.2g} mm")
        found.append(line)
    return found
