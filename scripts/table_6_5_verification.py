"""python scripts/table_6_5_verification.py: errors of motions and loads with a known formula, here and elsewhere."""

from dataclasses import replace
from functools import partial
from math import asin, cos, pi, radians, sin, sqrt

import numpy as np
from scipy.optimize import bisect, minimize_scalar

import deep_contact as dc
from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.measure import peers
from deep_contact.state.constants import WALL_SKIN
from deep_contact.studies.known import G, end, known_scene

OURS = "ours"
SILO = "Janssen's silo, floor load over weight"


def cases():
    """Return the cases: name -> (source of the formula, function that measures a value, exact value).

    The argument of the function that measures is itself a function: run(scene, seconds) -> state after the simulation.
    """
    row, still = [[10.0, 20.0], [14.0, 20.0], [16.0, 20.0], [18.0, 20.0]], [0.0, 0.0]
    elastic = {"gravity": 0.0, "restitution": 1.0}
    disc, slip = "a = 2/3 g sin α (textbook)", "a = g (sin α − μ cos α) where tan α > 3 μ (textbook)"
    exchange = "one stops, one leaves (textbook)"
    drop, swing = known_scene([[10.0, 3.0]], restitution=0.5), 20.0 - 1.0 - WALL_SKIN
    graze = known_scene([[10.0, 3.0]], gravity=0.0, friction=0.1, restitution=0.5, velocity=[4.0, -2.0])
    press = known_scene([[10.0, 1.01], [10.0, 3.01], [10.0, 5.01]], mass=[1.0, 1.0, 100.0])

    def speed(state, circle=0):
        return lambda run: run(state, 2.0).bodies.velocity[circle, 0]

    def phase(friction, seconds):
        bowl = bowl_of(swing, friction)
        return lambda run: 2.5 * pi - asin((run(bowl, seconds).bodies.position[0, 0] - 50.0) / (swing * sin(0.05)))

    def squeeze(run):  # contact 0 is that of circles 0 and 1; for other engines the contacts are empty
        state = run(press, 2.0)
        return state.contacts.normal_impulse[:1].sum() / state.dt or None

    return {
        "free fall, way after 1 s": ("y = g t² / 2 (MFiX DEM-01)",
            lambda run: 21.0 - run(known_scene([[10.0, 21.0]]), 1.0).bodies.position[0, 1], G / 2),
        "bounce, speed 0.1 s after": ("e = v′ / v (Chung and Ooi 2011; MFiX DEM-02)",
            lambda run: run(drop, 0.1 + sqrt(4 / G)).bodies.velocity[0, 1], 0.5 * sqrt(4 * G) - 0.1 * G),
        "oblique impact, speed along the wall": ("v′ = v − μ (1 + e) v_n (Chung and Ooi 2011; MFiX DEM-05)",
            speed(graze), 4.0 - 0.1 * 1.5 * 2.0),
        "slope without slip, speed after 2 s": (disc, speed(known_scene([[10.0, 1.0]], slope=20.0, friction=0.5)),
            4 / 3 * G * sin(radians(20))),
        "slope with slip, speed after 2 s": (slip, speed(known_scene([[10.0, 1.0]], slope=45.0, friction=0.2)),
            1.6 * G * sqrt(0.5)),
        "sliding to rolling, speed": ("rolls at 2/3 of its speed (Coriolis 1835; MFiX DEM-04)",
            speed(known_scene([[10.0, 1.0]], friction=0.3, velocity=[4.0, 0.0])), 8 / 3),
        "two equal circles, speed of the second": (exchange,
            speed(known_scene(row[:2], velocity=[[4.0, 0.0], still], **elastic), -1), 4.0),
        "Newton's cradle, speed of the last": (exchange,
            speed(known_scene(row, velocity=[[4.0, 0.0], still, still, still], **elastic), -1), 4.0),
        "two circles crushed by 100 times their mass, height": ("rigid: 5 r (after MFiX DEM-03)",
            lambda run: run(press, 2.0).bodies.position[2, 1] - WALL_SKIN, 5.0),
        "two circles crushed, force between them": ("what lies above (after MFiX DEM-03)",
            squeeze, 101.0 * G),
        "sliding in a bowl, phase after 1 1/4 periods": ("T = 2π √((R − r) / g) (textbook)",
            phase(0.0, 11.0), 11.0 * sqrt(G / swing)),
        "rolling in a bowl, phase after 1 1/4 periods": ("T = 2π √(3 (R − r) / 2 g) (textbook)",
            phase(1.0, 13.4), 13.4 * sqrt(G / swing / 1.5)),
        "heap of three, least friction it stands by": ("μ = tan 15° (statics)", least_friction, 2.0 - sqrt(3.0)),
    }  # fmt: skip


def bowl_of(swing, friction):
    """Return a circle in a bowl with a radius of 20 m, 0.05 rad from the lowest point.

    The bowl consists of segments that are so short that their corners do not slow the circle. swing: distance of the
    circle's centre from the bowl's centre, m.
    """
    angle = np.radians(np.linspace(-6.0, 6.0, 401))
    line = np.stack([50.0 + 20.0 * np.sin(angle), 21.0 - 20.0 * np.cos(angle)], axis=1)
    place = 50.0 + swing * sin(0.05), 21.0 - swing * cos(0.05)
    return known_scene([place], friction=friction, segments=np.stack([line[:-1], line[1:]], axis=1))


def least_friction(run):
    """Return the least friction coefficient with which a circle stays on two touching circles for 5 s.

    With less friction the two circles move apart. run: function (scene, seconds) -> state.
    """

    def rise(friction):
        heap = known_scene([[10.0, 1.01], [12.0, 1.01], [11.0, 1.01 + sqrt(3.0)]], friction=friction)
        return run(heap, 5.0).bodies.position[2, 1] - 2.7

    return bisect(rise, 0.2, 0.4, xtol=1e-4)


def silo(seeds=3, friction=0.5, columns=10):
    """Measure the floor load over the weight in silos of four heights, and fit Janssen's law with one K.

    The silos are about 1 to 8 times as high as wide. Janssen's law assumes that friction pushes the circles up at every
    contact with a wall. Therefore the walls move up at 0.5 m/s, as in Bertho and others. Circles that are poured
    between walls at rest can load the floor with more than their weight. Loads are means over 10 s and over seeds.
    seeds: number of seeds. friction: Coulomb's μ. columns: number of circles side by side. Returns {"K", "depth":
    height over width, "load": floor load over weight, "error": largest relative error of the fit}.
    """
    depth, load = np.zeros((2, 4, seeds))
    for (i, seed), _ in np.ndenumerate(load):
        state = dc.lattice_in_box(columns**2 * 2**i, columns=columns, radius=(0.8, 1.0), seed=seed, friction=friction)
        _, _, width, height = state.world.box
        sides = [((0.0, height), (0.0, 0.0)), ((width, 0.0), (width, height))]
        world = replace(state.world, box=(-5, 0, width + 5, height), segments=sides, surface_speeds=(-0.5, 0.5))
        state, solver = state.replace(world=world, dt=0.005), dc.PGS(sweeps=50, tolerance=None)
        done = dc.simulate(state, steps=4000, record=2000, forces=True, solver=solver)
        depth[i, seed] = 2 * done.state.bodies.position[:, 1].mean() / width
        load[i, seed] = -done.force_on("floor")[-1, 1] / (G * state.bodies.mass.sum())
    depth, load = depth.mean(axis=1), load.mean(axis=1)

    def errors(ratio):
        x = 2 * friction * ratio * depth
        return (1 - np.exp(-x)) / x / load - 1

    ratio = minimize_scalar(lambda ratio: (errors(ratio) ** 2).sum(), bounds=(0.01, 3), method="bounded").x
    return {"K": ratio, "depth": depth, "load": load, "error": abs(errors(ratio)).max()}


def compute(options, seed, jobs, progress):
    """Measure the relative error of each case in each installed engine."""
    done, settings = {}, {OURS: {"method": "PGS"}} | {name: {"engine": name} for name in peers.ENGINES}
    for name, (source, measured, exact) in cases().items():
        errors = {}
        for engine, setting in settings.items():
            try:
                value = measured(partial(end, setting | options))
            except ImportError:  # the engine is not installed
                continue
            errors[engine] = None if value is None else abs(float(value) / exact - 1)
        done[name] = {"source": source, "errors": errors}
    heap = silo()
    source = "(1 − exp(−x)) / x, x = 2 μ K H / W (Janssen 1895; Bertho and others 2003)"
    done[SILO] = {"source": source, "errors": dict.fromkeys(errors) | {OURS: heap["error"]}}
    return {"cases": done, "silo": heap}


def claims(data):
    worst = max(case["errors"][OURS] for name, case in data["cases"].items() if name != SILO)
    yield Claim(
        "every motion and force with a formula is within 1 % here", None, worst <= 0.01, {"largest error": worst}
    )
    silo = data["silo"]
    fits = silo["error"] <= 0.05 and silo["load"][-1] <= 0.5
    yield Claim("floor loads of silos follow Janssen's law with one K within 5 %", None, fits, silo)


def table(data):
    names = list(next(iter(data["cases"].values()))["errors"])
    rows = [["case", "by", *(f"{name}, error" for name in names)]]
    return rows + [[case, one["source"], *one["errors"].values()] for case, one in data["cases"].items()]


FIGURE = Figure(
    "T 6.5", "Motions and loads with a formula", compute, table, claims=claims, options={"dt": 0.002, "sweeps": 50}
)
figures.run_as_script(FIGURE, __name__)
