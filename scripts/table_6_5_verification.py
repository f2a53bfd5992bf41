"""python scripts/table_6_5_verification.py: errors of motions that have a formula, here and in other engines."""

from math import cos, radians, sin, sqrt

import deep_contact as dc
from deep_contact import peers
from deep_contact.constants import GRAVITY
from deep_contact.reporting import Claim, Figure, figures

G, OURS = -GRAVITY[1], "ours"


def scene(places, *, slope=0.0, gravity=G, friction=0.0, restitution=0.0, **bodies):
    """Circles of 1 m in a box of 400 m × 40 m whose floor is a slope, degrees, by a gravity that leans."""
    leaning = gravity * sin(radians(slope)), -gravity * cos(radians(slope))
    world = dc.World(box=(0.0, 0.0, 400.0, 40.0), gravity=leaning, friction=friction, restitution=restitution)
    return dc.State(name="case", world=world, bodies=dc.make_bodies(places, **bodies))


def cases():
    """Name -> (source, scene, seconds, what is measured of the bodies, its exact value)."""
    row, still = [[10.0, 20.0], [14.0, 20.0], [16.0, 20.0], [18.0, 20.0]], [0.0, 0.0]
    elastic = {"gravity": 0.0, "restitution": 1.0}
    disc, slip = "a = 2/3 g sin α (textbook)", "a = g (sin α − μ cos α) where tan α > 3 μ (textbook)"
    exchange = "one stops, one leaves (textbook)"

    def along(bodies):
        return bodies.velocity[0, 0]

    def last(bodies):
        return bodies.velocity[-1, 0]

    return {
        "free fall, way after 1 s": ("y = g t² / 2 (MFiX DEM-01)", scene([[10.0, 21.0]]), 1.0,
            lambda bodies: 21.0 - bodies.position[0, 1], G / 2),
        "bounce, speed 0.1 s after": ("e = v′ / v (Chung and Ooi 2011; MFiX DEM-02)",
            scene([[10.0, 3.0]], restitution=0.5), 0.1 + sqrt(4 / G),
            lambda bodies: bodies.velocity[0, 1], 0.5 * sqrt(4 * G) - 0.1 * G),
        "oblique impact, speed along the wall": ("v′ = v − μ (1 + e) v_n (Chung and Ooi 2011; MFiX DEM-05)",
            scene([[10.0, 3.0]], gravity=0.0, friction=0.1, restitution=0.5, velocity=[4.0, -2.0]), 2.0,
            along, 4.0 - 0.1 * 1.5 * 2.0),
        "slope without slip, speed after 2 s": (disc, scene([[10.0, 1.0]], slope=20.0, friction=0.5), 2.0,
            along, 4 / 3 * G * sin(radians(20))),
        "slope with slip, speed after 2 s": (slip, scene([[10.0, 1.0]], slope=45.0, friction=0.2), 2.0,
            along, 1.6 * G * sqrt(0.5)),
        "sliding to rolling, speed": ("rolls at 2/3 of its speed (Coriolis 1835; MFiX DEM-04)",
            scene([[10.0, 1.0]], friction=0.3, velocity=[4.0, 0.0]), 2.0, along, 8 / 3),
        "two equal circles, speed of the second": (exchange,
            scene(row[:2], velocity=[[4.0, 0.0], still], **elastic), 2.0, last, 4.0),
        "Newton's cradle, speed of the last": (exchange,
            scene(row, velocity=[[4.0, 0.0], still, still, still], **elastic), 2.0, last, 4.0),
    }  # fmt: skip


def compute(options, seed, jobs, progress):
    """The relative error of each case in each engine that is installed."""
    done, dt = {}, options["dt"]
    for name, (source, state, seconds, measured, exact) in cases().items():
        steps, errors = round(seconds / dt), {}
        solver = dc.PGS(sweeps=options["sweeps"], tolerance=None)
        errors[OURS] = measured(dc.simulate(state.replace(dt=dt), steps=steps, solver=solver).state.bodies)
        for engine, adapter in peers.ENGINES.items():
            try:
                world = adapter(state)
            except ImportError:  # not installed
                continue
            world.run(steps, dt, options["sweeps"], 10)
            errors[engine] = measured(world.bodies())
        done[name] = {"source": source, "errors": {who: abs(float(got) / exact - 1) for who, got in errors.items()}}
    return {"cases": done}


def claims(data):
    worst = max(case["errors"][OURS] for case in data["cases"].values())
    yield Claim("every case is within 1 % here", None, worst <= 0.01, {"largest error": worst})


def table(data):
    names = list(next(iter(data["cases"].values()))["errors"])
    rows = [["case", "by", *(f"{name}, error" for name in names)]]
    return rows + [[case, one["source"], *one["errors"].values()] for case, one in data["cases"].items()]


FIGURE = Figure("T 6.5", "Motions with a formula", compute, table, claims=claims, options={"dt": 0.002, "sweeps": 50})
figures.run_as_script(FIGURE, __name__)
