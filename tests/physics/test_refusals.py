"""What is refused: every message names the argument, what was expected and what came."""

import math
from dataclasses import replace

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.physics.islands import islands_of

COLUMN = dc.column(2)
BELT, TWO = ((5.0, 10.0), (55.0, 10.0)), [((0, 0), (2, 0)), ((0, 0), (1, 1))]


def run(**options):
    """A step of two circles."""
    dc.simulate(COLUMN, **({"steps": 1} | options))


def in_world(**fields):
    """A step of them in a world with these fields."""
    dc.simulate(COLUMN.replace(world=replace(COLUMN.world, **fields)), steps=1)


def scaled(**scales):
    """A world with these scales."""
    dc.World(scales=dc.BOX2D._replace(**scales))


REFUSED = [
    # options of methods
    (dc.PGS, {"sweeps": 10**12}, "sweeps: expected an integer <= 10000000, got 1000000000000"),
    (dc.PGS, {"tolerance": math.nan}, "tolerance: expected a finite number >= 0, got nan"),
    (dc.PGS, {"islands": 2}, "islands: expected True or False, got 2"),
    (dc.PGS, {"substeps": 0}, "substeps: expected an integer >= 1, got"),
    (dc.PGS, {"substeps": 2, "most_substeps": 1}, "most_substeps: expected an integer >= 2"),
    (dc.PGS, {"substeps": 2, "most_substeps": 12}, "most_substeps: expected 2 times a power of two, got 12"),
    (dc.PGS, {"approach": 0.0}, "approach: expected a finite number > 0"),
    (dc.PGS, {"slop": -1.0}, "slop: expected a number from 0 to 100"),
    (dc.PSOR, {"omega": 2.0}, "omega: expected a number above 0, below 2, got 2.0"),
    (dc.PSOR, {"friction_omega": 2}, "friction_omega: expected a number above 0, below 2, got 2"),
    (dc.NNCG, {"sweeps": -1}, "sweeps: expected an integer >= 0, got -1"),
    (dc.BatchedPGS, {"threads": 0}, "threads: expected an integer >= 1, got 0"),
    (dc.BatchedPGS, {"islands": True}, "islands: expected False, since BatchedPGS sweeps them together"),
    # a run
    (run, {"steps": -1}, "steps: expected an integer >= 0, got -1"),
    (run, {"steps": 2, "record": 0}, "record: expected an integer >= 1, got 0"),
    (run, {"dt": 0.0}, "dt: expected a finite number > 0, got 0.0"),
    (run, {"solver": 10}, "solver: expected options such as PGS"),
    (run, {"warm_start": "magic"}, "warm_start: expected one of none, builtin, .*copy.*got 'magic'"),
    (run, {"sleep": 1}, "sleep: expected True or False, got 1"),
    (run, {"sleep": True, "solver": dc.BatchedPGS()}, "sleep: expected False with BatchedPGS, got True"),
    (islands_of, {"state": COLUMN}, "contacts: expected a state whose contacts have been found, got None"),
    (dc.simulate, {"state": "scene.xml"}, "state: expected a State, .* dc.read_state .* got 'scene.xml'"),
    *(
        (dc.step, {"state": COLUMN.replace(bodies=COLUMN.bodies._replace(**field))}, f"bodies.{next(iter(field))}: exp")
        for field in ({"mass": 1j}, {"position": [[1], [1, 2]]}, {"spin": np.zeros(3)})
    ),
    (COLUMN.replace, {"bodies": [[1.0, 1.0]]}, "bodies: expected Bodies, as dc.make_bodies makes them, got list"),
    (dc.make_bodies, {"position": [[1.0, 1.0]], "radius": 0.0}, r"bodies.radius\[0\]: expected a number > 0, got 0.0"),
    (dc.plotting.save, {"figure": None, "path": "x.foo"}, "path: expected a name that ends in .png, got 'x.foo'"),
    (dc.step, {"state": COLUMN.replace(solved=1j)}, "solved: expected True or False, got 1j"),
    # a world
    (dc.World, {"gravity": -9.81}, r"gravity: expected two finite numbers, such as \(0, -9.81\), got -9.81"),
    (dc.World, {"box": "wide"}, "box: expected finite .* got wide"),
    (dc.World, {"scales": 0.005}, "scales: expected None or ContactScales, such as scales.BOX2D, got 0.005"),
    (scaled, {"slop": -1.0}, r"scales.slop: expected a finite number >= 0, got -1.0"),
    (scaled, {"max_translation": 0.0}, r"scales.max_translation: expected a finite number > 0, got 0.0"),
    (dc.World, {"segments": [((1, 1), (1, 1))]}, r"segments\[0\]: expected two different points"),
    (dc.World, {"segments": [TWO[0], ((0, 0), (1, math.inf))]}, r"segments\[1\]: expected two different points.*inf"),
    (dc.World, {"segments": 5}, r"segments: expected a list of \(\(x, y\), \(x, y\)\), got 5"),
    (in_world, {"segments": [((0, 0), (1e13, 0))]}, r"world.segments\[0, 2\]: expected -1e\+12 to 1e\+12 m, got 10"),
    *(
        (dc.World, {"segments": TWO, "surface_speeds": speeds}, "surface_speeds: expected")
        for speeds in ("fast", 1.0, [1.0], [math.nan] * 2, [[1.0, 2.0]], [1j, 2])
    ),
    (in_world, {"segments": [BELT], "surface_speeds": [1e11]}, r"surface_speeds\[0\]: expected -1e\+10 to 1e\+10 m/s"),
    # a scene
    *(
        (dc.circles_in_box, {"n_bodies": 5, **wrong}, f"{next(iter(wrong))}: expected")
        for wrong in ({"radius": 1j}, {"radius": object()}, {"size": "x"}, {"seed": [1.5]}, {"size": [1, 2, 3]})
    ),
    (dc.circles_in_box, {"n_bodies": 0}, "n_bodies: expected an integer >= 1, got 0"),
    (dc.circles_in_box, {"radius": (2, 1)}, "radius: expected finite 0 < smallest <= largest"),
    (dc.circles_in_box, {"size": -3}, "size: expected finite numbers > 0, got -3"),
    (dc.circles_in_box, {"friction": -0.1}, "friction: expected a finite number >= 0, got -0.1"),
    (dc.circles_in_box, {"restitution": 1.5}, "restitution: expected a number from 0 to 1, got 1.5"),
    (dc.circles_in_box, {"gravity": (0, math.nan)}, "gravity: expected two finite numbers"),
    (dc.circles_in_box, {"n_bodies": 50, "size": 5.0}, r"got 50; \d+ fitted in a box of 5 x 5 m"),
    (dc.circles_in_box, {"n_bodies": 5, "radius": 1.0}, "radius: expected finite 0 < smallest <= largest, .* got 1.0"),
    (dc.circles_in_box, {"n_bodies": 400}, r"n_bodies: .* size=93 has room for all, and dc.lattice_in_box"),
    # A matrix has no first element that is not a matrix; NumPy's generators end the process on it.
    (lambda: dc.circles_in_box(5, seed=np.matrix([[1, 2]])), {}, "seed: expected an integer >= 0 or a numpy"),
    (dc.terrain, {"n_bodies": 5, "seed": [1, 2]}, r"seed: expected an integer >= 0 or a numpy.*, got \[1, 2"),
    (dc.column, {"width": 1.0}, "width: expected a finite number >= the diameter"),
    (dc.drum, {"gravity": (0.0, 0.0)}, r"froude: expected 0 without gravity, which it is measured by, got 0\.05"),
    (dc.make_bodies, {"position": [[1, 1], [2]]}, r"position: expected numbers of shape \(n, 2\)"),
    (
        dc.make_bodies,
        {"position": [[1, 1]] * 2, "radius": [1] * 3},
        r"radius: expected one .* of the 2, got \[1, 1",
    ),
    (dc.make_bodies, {"position": [[1, 1]] * 2, "velocity": [1, 2, 3]}, "velocity: expected one pair for all circles"),
    (dc.make_bodies, {"position": [[1, 1]] * 2, "mass": "heavy"}, "mass: expected one value .* got 'heavy'"),
    (dc.make_bodies, {"position": [[1, 1], [4, np.nan]]}, r"bodies\.position\[1\]: expected a finite number, got"),
]


@pytest.mark.parametrize(("made", "arguments", "message"), REFUSED)
def test_what_cannot_be_is_refused(made, arguments, message):
    with pytest.raises(ValueError, match=message):
        made(**arguments)


def test_a_contact_with_a_segment_that_is_gone_is_refused():
    state = dc.simulate(dc.terrain(9, bumps=5, gap=0.01, seed=1), steps=60).state
    fewer = state.replace(world=replace(state.world, segments=state.world.segments[:1]))
    with pytest.raises(ValueError, match=r"contacts.body_b.*up to 13 \(walls, segments\), got"):
        dc.simulate(fewer, steps=1)
