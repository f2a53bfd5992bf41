"""What is refused: every message names the argument, what was expected and what came."""

import math
from dataclasses import replace

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.physics.islands import islands_of

COLUMN = dc.column(2)
BELT, TWO = ((5.0, 10.0), (55.0, 10.0)), [((0, 0), (2, 0)), ((0, 0), (1, 1))]


def in_world(**fields):
    """One step of a circle in a world with these fields."""
    dc.simulate(COLUMN.replace(world=replace(COLUMN.world, **fields)), steps=1)


REFUSED = [
    # options of methods
    (lambda: dc.PGS(sweeps=10**12), "sweeps: expected an integer <= 10000000, got 1000000000000"),
    (lambda: dc.PGS(sweeps=2.5), "sweeps: expected an integer >= 0, got 2.5"),
    (lambda: dc.PGS(tolerance=math.nan), "tolerance: expected a finite number >= 0, got nan"),
    (lambda: dc.PGS(tolerance="screen"), "tolerance: expected a finite number >= 0, got 'screen'"),
    (lambda: dc.PGS(islands=2), "islands: expected True or False, got 2"),
    *((lambda n=n: dc.PGS(substeps=n), "substeps: expected an integer >= 1, got") for n in (0, 1.5, True)),
    (lambda: dc.PSOR(omega=2.0), "omega: expected a number above 0, below 2, got 2.0"),
    (lambda: dc.PSOR(omega=0), "omega: expected a number above 0, below 2, got 0"),
    (lambda: dc.PSOR(friction_omega=2), "friction_omega: expected a number above 0, below 2, got 2"),
    (lambda: dc.NNCG(precision="half"), "precision: expected one of double, single, got 'half'"),
    (lambda: dc.NNCG(sweeps=-1), "sweeps: expected an integer >= 0, got -1"),
    (lambda: dc.BatchedPGS(threads=0), "threads: expected an integer >= 1, got 0"),
    (lambda: dc.BatchedPGS(threads=1.5), "threads: expected an integer >= 1, got 1.5"),
    *(
        (lambda of=of: of(islands=True), f"islands: expected False, since {of.__name__} sweeps them together")
        for of in (dc.BatchedPGS, dc.PSOR, dc.NNCG)
    ),
    # a run
    (lambda: dc.simulate(COLUMN, steps=-1), "steps: expected an integer >= 0, got -1"),
    (lambda: dc.simulate(COLUMN, steps=1, dt=0.0), "dt: expected a finite number > 0, got 0.0"),
    (lambda: dc.simulate(COLUMN, steps=1, solver=10), "solver: expected options such as PGS"),
    (
        lambda: dc.simulate(COLUMN, steps=1, warm_start="magic"),
        "warm_start: expected one of none, builtin, .*copy.*got 'magic'",
    ),
    (lambda: dc.simulate(COLUMN, steps=1, sleep=1), "sleep: expected True or False, got 1"),
    (
        lambda: dc.simulate(COLUMN, steps=1, sleep=True, solver=dc.BatchedPGS()),
        "sleep: expected False with BatchedPGS, got True",
    ),
    (lambda: islands_of(COLUMN), "contacts: expected a state whose contacts have been found, got None"),
    # a world
    (
        lambda: dc.World(scales=0.005),
        r"scales: expected None or ContactScales, such as scales.BOX2D, got 0.005",
    ),
    (lambda: dc.World(scales=dc.BOX2D._replace(slop=-1.0)), r"scales.slop: expected a finite number >= 0, got -1.0"),
    (
        lambda: dc.World(scales=dc.BOX2D._replace(sleep_time=math.inf)),
        r"scales.sleep_time: expected a finite number >= 0, got inf",
    ),
    (
        lambda: dc.World(scales=dc.BOX2D._replace(max_translation=0.0)),
        r"scales.max_translation: expected a finite number > 0, got 0.0",
    ),
    (lambda: dc.World(segments=[((1, 1), (1, 1))]), r"segments\[0\]: expected two different points"),
    (
        lambda: dc.World(segments=[((0, 0), (1, 1)), ((0, 0), (1, math.inf))]),
        r"segments\[1\]: expected two different points.*inf",
    ),
    (
        lambda: dc.World(segments=((0, 0), (1, 1))),
        r"segments\[0\]: expected two different points, .*, got \(0, 0\)",
    ),
    (lambda: dc.World(segments=[((0, 0), "x")]), r"segments\[0\]: expected two different points"),
    (lambda: dc.World(segments=5), r"segments: expected a list of \(\(x, y\), \(x, y\)\), got 5"),
    (lambda: dc.World(segments="ab"), r"segments: expected a list"),
    (
        lambda: in_world(segments=(((0.0, 0.0), (1e13, 0.0)),)),
        r"world.segments\[0, 2\]: expected -1e\+12 to 1e\+12 m, got 10000000000000\.0",
    ),
    *(
        (lambda speeds=speeds: dc.World(segments=TWO, surface_speeds=speeds), "surface_speeds: expected")
        for speeds in (
            *("fast", 1.0, [1.0], [math.nan] * 2, [[1.0, 2.0], [3.0, 4.0]]),
            *([[1.0, 2.0]], ["1", "2"], [1j, 2]),
        )
    ),
    (
        lambda: in_world(segments=(BELT,), surface_speeds=(1e11,)),
        r"world.surface_speeds\[0\]: expected -1e\+10 to 1e\+10 m/s, got 1",
    ),
    # a scene
    (lambda: dc.circles_in_box(0), "n_bodies: expected an integer >= 1, got 0"),
    (lambda: dc.circles_in_box(5, radius=(2, 1)), "radius: expected finite 0 < smallest <= largest"),
    (lambda: dc.circles_in_box(5, size=-3), "size: expected finite numbers > 0, got -3"),
    (lambda: dc.circles_in_box(5, friction=-0.1), "friction: expected a finite number >= 0, got -0.1"),
    (lambda: dc.circles_in_box(5, restitution=1.5), "restitution: expected a number from 0 to 1, got 1.5"),
    (lambda: dc.circles_in_box(5, gravity=(0, math.nan)), "gravity: expected two finite numbers"),
    (lambda: dc.circles_in_box(50, size=5.0, seed=1), r"got 50; \d+ fitted in a box of 5 x 5 m"),
    (lambda: dc.column(3, width=1.0), "width: expected a finite number >= the diameter"),
    (lambda: dc.two_bodies(offset=3.0), "offset: expected less than the sum of the radii"),
    (
        lambda: dc.drum(10, gravity=(0.0, 0.0)),
        r"froude: expected 0 without gravity, which it is measured by, got 0\.05",
    ),
    (
        lambda: dc.make_bodies([[1.0, 1.0], [4.0, np.nan]]),
        r"bodies\.position\[1\]: expected a finite number, got .*nan",
    ),
    (
        lambda: dc.make_bodies([[1.0, 1.0], [4.0, 4.0]], radius=[1.0, np.nan]),
        r"bodies\.radius\[1\]: expected a finite number, got .*nan",
    ),
]


@pytest.mark.parametrize(("made", "message"), REFUSED, ids=lambda value: value if isinstance(value, str) else "")
def test_what_cannot_be_is_refused(made, message):
    with pytest.raises(ValueError, match=message):
        made()


def test_a_contact_with_a_segment_that_is_gone_is_refused():
    state = dc.simulate(dc.terrain(9, bumps=5, gap=0.01, seed=1), steps=60).state
    fewer = state.replace(world=replace(state.world, segments=state.world.segments[:1]))
    with pytest.raises(ValueError, match=r"contacts.body_b.*up to 13 \(walls, segments\), got"):
        dc.simulate(fewer, steps=1)
