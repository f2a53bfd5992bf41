"""What is refused: every message names the argument, what was expected and what came."""

import math
from dataclasses import replace

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.physics.islands import islands_of

COLUMN = dc.column(2)
TWO = [((0, 0), (2, 0)), ((0, 0), (1, 1))]


def run(**options):
    """A step of two circles."""
    dc.simulate(COLUMN, **({"steps": 1} | options))


def scaled(**scales):
    """A world with these scales."""
    dc.World(scales=dc.BOX2D._replace(**scales))


REFUSED = [
    # options of methods
    (dc.PGS, {"sweeps": 10**12}, "sweeps: expected"),
    (dc.PGS, {"tolerance": math.nan}, "tolerance: expected"),
    (dc.PGS, {"islands": 2}, "islands: expected"),
    (dc.PGS, {"substeps": 0}, "substeps: expected"),
    (dc.PGS, {"substeps": 2, "most_substeps": 1}, "most_substeps: expected"),
    (dc.PGS, {"substeps": 2, "most_substeps": 12}, "most_substeps: expected"),
    (dc.PGS, {"approach": 0.0}, "approach: expected"),
    (dc.PGS, {"slop": -1.0}, "slop: expected"),
    (dc.PSOR, {"omega": 2.0}, "omega: expected"),
    (dc.PSOR, {"friction_omega": 2}, "friction_omega: expected"),
    (dc.NNCG, {"sweeps": -1}, "sweeps: expected"),
    (dc.BatchedPGS, {"threads": 0}, "threads: expected"),
    (dc.BatchedPGS, {"islands": True}, "islands: expected"),
    # a run
    (run, {"steps": -1}, "steps: expected"),
    (run, {"steps": 2, "record": 0}, "record: expected"),
    (run, {"dt": 0.0}, "dt: expected"),
    (run, {"solver": 10}, "solver: expected"),
    (run, {"warm_start": "magic"}, "warm_start: expected"),
    (run, {"sleep": 1}, "sleep: expected"),
    (run, {"sleep": True, "solver": dc.BatchedPGS()}, "sleep: expected"),
    (islands_of, {"state": COLUMN}, "contacts: expected"),
    (dc.simulate, {"state": "scene.xml"}, "state: expected"),
    *(
        (dc.step, {"state": COLUMN.replace(bodies=COLUMN.bodies._replace(**field))}, f"bodies.{next(iter(field))}: exp")
        for field in ({"mass": 1j}, {"position": [[1], [1, 2]]}, {"spin": np.zeros(3)})
    ),
    (COLUMN.replace, {"bodies": [[1.0, 1.0]]}, "bodies: expected"),
    (dc.find_contacts(COLUMN).replace, {"bodies": COLUMN.bodies._replace(mass=1j)}, "bodies: expected"),
    (dc.make_bodies, {"position": [[1.0, 1.0]], "radius": 0.0}, r"bodies.radius\[0\]: expected"),
    (dc.plotting.save, {"figure": None, "path": "x.foo"}, "path: expected"),
    (dc.step, {"state": COLUMN.replace(solved=1j)}, "solved: expected"),
    # a world
    (dc.World, {"gravity": -9.81}, "gravity: expected"),
    (dc.World, {"box": "wide"}, "box: expected"),
    (dc.World, {"scales": 0.005}, "scales: expected"),
    (scaled, {"slop": -1.0}, "scales.slop: expected"),
    (scaled, {"max_translation": 0.0}, "scales.max_translation: expected"),
    (dc.World, {"segments": [((1, 1), (1, 1))]}, r"segments\[0\]: expected"),
    (dc.World, {"segments": [TWO[0], ((0, 0), (1, math.inf))]}, r"segments\[1\]: expected"),
    (dc.World, {"segments": 5}, "segments: expected"),
    *(
        (dc.World, {"segments": TWO, "surface_speeds": speeds}, "surface_speeds: expected")
        for speeds in ("fast", 1.0, [1.0], [math.nan] * 2, [[1.0, 2.0]], [1j, 2])
    ),
    # a scene
    *(
        (dc.circles_in_box, {"n_bodies": 5, **wrong}, f"{next(iter(wrong))}: expected")
        for wrong in ({"radius": 1j}, {"radius": object()}, {"size": "x"}, {"seed": [1.5]}, {"size": [1, 2, 3]})
    ),
    (dc.circles_in_box, {"n_bodies": 0}, "n_bodies: expected"),
    (dc.circles_in_box, {"radius": (2, 1)}, "radius: expected"),
    (dc.circles_in_box, {"size": -3}, "size: expected"),
    (dc.circles_in_box, {"friction": -0.1}, "friction: expected"),
    (dc.circles_in_box, {"restitution": 1.5}, "restitution: expected"),
    (dc.circles_in_box, {"gravity": (0, math.nan)}, "gravity: expected"),
    (dc.circles_in_box, {"n_bodies": 50, "size": 5.0}, r"got 50; \d+ fitted in a box of 5 x 5 m"),
    (dc.circles_in_box, {"n_bodies": 5, "radius": 1.0}, "radius: expected"),
    (dc.circles_in_box, {"n_bodies": 400}, r"n_bodies: .* size=93 has room for all, and dc.lattice_in_box"),
    # A matrix has no first element that is not a matrix; NumPy's generators end the process on it.
    (lambda: dc.circles_in_box(5, seed=np.matrix([[1, 2]])), {}, "seed: expected"),
    (dc.terrain, {"n_bodies": 5, "seed": [1, 2]}, "seed: expected"),
    (dc.column, {"width": 1.0}, "width: expected"),
    (dc.drum, {"gravity": (0.0, 0.0)}, "froude: expected"),
    (dc.make_bodies, {"position": [[1, 1], [2]]}, "position: expected"),
    (dc.make_bodies, {"position": [[1, 1]] * 2, "radius": [1] * 3}, "radius: expected"),
    (dc.make_bodies, {"position": [[1, 1]] * 2, "velocity": [1, 2, 3]}, "velocity: expected"),
    (dc.make_bodies, {"position": [[1, 1]] * 2, "mass": "heavy"}, "mass: expected"),
    (dc.make_bodies, {"position": [[1, 1], [4, np.nan]]}, r"bodies\.position\[1\]: expected"),
]


@pytest.mark.filterwarnings("ignore:the matrix subclass:PendingDeprecationWarning")
@pytest.mark.parametrize(("made", "arguments", "message"), REFUSED)
def test_what_cannot_be_is_refused(made, arguments, message):
    with pytest.raises(ValueError, match=message):
        made(**arguments)


def test_a_contact_with_a_segment_that_is_gone_is_refused():
    state = dc.simulate(dc.terrain(9, bumps=5, gap=0.01, seed=1), steps=60).state
    world = replace(state.world, segments=state.world.segments[:1])
    with pytest.raises(ValueError, match=r"segments\[1\]: expected"):
        state.replace(world=world)
    with pytest.raises(ValueError, match=r"contacts.body_b.*up to 13 \(walls, segments\), got"):
        dc.simulate(replace(state, world=world), steps=1)
