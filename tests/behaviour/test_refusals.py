"""Refusals: every message names the argument, what was expected and what came."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from conftest import load_script
from scipy import sparse

import deep_contact as dc
from deep_contact import sph
from deep_contact.analysis.lcp import check_problem, contact_problem
from deep_contact.analysis.matrix_solvers import solve_problem
from deep_contact.cnn.far_field import FarFieldSpec, description_of
from deep_contact.cnn.images import ImageSpec, input_image, label_image, read_back
from deep_contact.cnn.through_solver import solved_problem
from deep_contact.state.checks import check_state

COLUMN, TOUCHING = dc.column(2), dc.find_contacts(dc.single_body(friction=0.3))
window_products = load_script("figure_4_2").window_products
PROBLEM = contact_problem(TOUCHING)
GRID = sph.Grid.over_box((0, 0, 4, 3), 0.5)
TWO = [((0, 0), (2, 0)), ((0, 0), (1, 1))]


def run(**options):
    """A step of two circles."""
    dc.simulate(COLUMN, **({"steps": 1} | options))


def scaled(**scales):
    """A world with these scales."""
    dc.World(scales=dc.BOX2D._replace(**scales))


def with_contact(**fields):
    """A state whose only contact has these fields."""
    contacts = TOUCHING.contacts._replace(**{name: np.array([value]) for name, value in fields.items()})
    check_state(TOUCHING.replace(contacts=contacts))


def run_many(scenes=(COLUMN, COLUMN), **options):
    """A step of several scenes."""
    dc.simulate_many(scenes, **{"steps": 1} | options)


def forces_on(part, index=None, **options):
    """Forces of a recorded run."""
    dc.simulate(COLUMN, steps=2, **options).force_on(part, index)


def exactly(normal=None, tangent=None, **options):
    """A circle on the floor solved exactly."""
    dc.solve_exactly(TOUCHING, normal, tangent, **options)


def swept(solver, **options):
    """The same by matrices."""
    solve_problem(PROBLEM, solver, **options)


def problem(**changes):
    """Its matrices, changed."""
    check_problem(PROBLEM._replace(**changes))


def splat(**changes):
    """Two particles on a grid."""
    sph.splat(**({"grid": GRID, "position": [[1.0, 1.0], [2.0, 2.0]], "values": [1.0, 2.0], "h": 0.5} | changes))


def gather(**changes):
    """What one of them gets back."""
    sph.gather(**({"grid": GRID, "image": np.zeros(GRID.shape), "position": [[1.0, 1.0]]} | changes))


def grid(**changes):
    """A grid by its nodes."""
    sph.Grid(**({"origin": (0, 0), "spacing": 0.5, "shape": (4, 4)} | changes))


def grid_over(box=(0, 0, 1, 1), spacing=0.5):
    """A grid over a box."""
    sph.Grid.over_box(box, spacing)


def kernel(kernel="poly6", r=0.5, h=1.0, dim=2):
    """A value of a kernel."""
    sph.value(kernel, r, h, dim)


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
    # a run
    (run, {"steps": -1}, "steps: expected"),
    (run, {"steps": 2, "record": 0}, "record: expected"),
    (run, {"dt": 0.0}, "dt: expected"),
    (run, {"solver": 10}, "solver: expected"),
    (run, {"warm_start": "magic"}, "warm_start: expected"),
    (run, {"warm_start": "model"}, r"warm_start: .*: a network is passed as dc.load_model\('model'"),
    (run, {"warm_start": "learned support"}, "warm_start: 'learned support' is called 'far field, no past' now"),
    (run, {"sleep": 1}, "sleep: expected"),
    (run, {"sleep": True, "solver": dc.BatchedPGS()}, "sleep: expected"),
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
    (dc.make_bodies, {"position": []}, r"position: expected numbers of shape \(n, 2\), x and y, got \[\]"),
    (dc.make_bodies, {"position": [[1, 2, 3]]}, r"position: expected numbers of shape \(n, 2\)"),
    (dc.make_bodies, {"position": [[1, 1]] * 2, "density": [1, -1]}, r"^density\[1\]: expected a number > 0, got -1.0"),
    (COLUMN.with_bodies, {"add": [(1, 1)]}, r"bodies: expected Bodies, as dc.make_bodies makes them, got \[\(1, 1\)\]"),
    (lambda: dc.Simulator(COLUMN).add([(1, 1)]), {}, "bodies: expected Bodies, as dc.make_bodies makes them"),
    (dc.make_bodies, {"position": [[1, 1]] * 2, "radius": [1] * 3}, "radius: expected"),
    (dc.make_bodies, {"position": [[1, 1]] * 2, "velocity": [1, 2, 3]}, "velocity: expected"),
    (dc.make_bodies, {"position": [[1, 1]] * 2, "mass": "heavy"}, "mass: expected"),
    (dc.make_bodies, {"position": [[1, 1], [4, np.nan]]}, r"bodies\.position\[1, 1\]: expected"),
    # many scenes, presets, plans, forces, trajectories
    (run_many, {"warm_start": "sph"}, "warm_start: expected"),
    (run_many, {"threads": 0}, "threads: expected"),
    (run_many, {"steps": -1}, r"states\[0\]: steps: expected"),
    (run_many, {"scenes": [COLUMN, "pile"]}, r"states\[1\]: expected a State"),
    (run_many, {"scenes": [COLUMN, COLUMN.replace(dt=-1.0)]}, r"^states\[1\]: dt: expected"),
    (run, {"accuracy": "fast", "solver": dc.PGS()}, "accuracy: expected"),
    (dc.recommend, {"scene": COLUMN, "accuracy": "best"}, "accuracy: expected"),
    (dc.recommend, {"scene": COLUMN, "accuracy": "fast", "budget_ms": 1}, "accuracy, budget_ms"),
    (dc.recommend, {"scene": COLUMN, "budget_ms": 0}, "budget_ms: expected"),
    (dc.plan, {"scene": COLUMN, "sleep": True, "solver": dc.BatchedPGS()}, "sleep: expected"),
    (run, {"solver": object()}, "solver: expected"),
    (run, {"forces": True}, "forces: expected"),
    (forces_on, {"part": "floor", "index": 3, "record": 1, "forces": True}, "index: expected none of the floor, got 3"),
    (forces_on, {"part": "floor"}, "trajectory: expected"),
    (forces_on, {"part": "floor", "record": 1}, "forces: expected"),
    (forces_on, {"part": "roof", "record": 1}, "part: expected"),
    (forces_on, {"part": "circle", "index": 2, "record": 1}, "index: expected"),
    (dc.Trajectory.from_states, {"states": []}, "at least one state"),
    (dc.Trajectory.from_states, {"states": [TOUCHING, TOUCHING.replace(name="other")]}, r"states\[1\]\.name"),
    # starts and states with contacts
    (dc.solve_contacts, {"state": TOUCHING, "start": ([], [])}, "one a contact, got"),
    (dc.solve_contacts, {"state": TOUCHING, "start": "magic"}, "expected one of"),
    (dc.solve_contacts, {"state": TOUCHING, "start": 3.0}, "expected two arrays"),
    (dc.solve_contacts, {"state": TOUCHING, "start": lambda *_: 2 * [np.array([math.nan])]}, "got nan at contact 0"),
    (dc.solve_contacts, {"state": TOUCHING, "start": ([-1e51], [0.0])}, r"normal impulses of at most 1e\+50"),
    (dc.solve_contacts, {"state": TOUCHING, "start": ([0.0], [-1e51])}, r"tangent impulses of at most 1e\+50"),
    (with_contact, {"body_a": -1}, r"contacts\.body_a\[0\]: expected"),
    (with_contact, {"body_b": 999}, r"contacts\.body_b\[0\]: expected"),
    (with_contact, {"normal": [3.0, 0.0]}, r"contacts\.normal\[0\]: expected"),
    (with_contact, {"normal_impulse": -1.0}, r"contacts\.normal_impulse\[0\]: expected"),
    (dc.make_bodies, {"position": [[1, 1], [4, 1]], "mass": [1.0, 0.0]}, r"bodies\.mass\[1\]: expected"),
    # images and descriptions
    (ImageSpec, {"spacing": 0}, "spacing: expected"),
    (ImageSpec, {"support": math.nan}, "support: expected"),
    (input_image, {"state": COLUMN, "spec": ImageSpec()}, "contacts"),
    (label_image, {"state": TOUCHING, "spec": ImageSpec()}, "solved"),
    (read_back, {"image": np.zeros((61, 61, 1)), "state": TOUCHING, "spec": ImageSpec()}, r"\(61, 61, 2\)"),
    (read_back, {"image": np.full((61, 61, 2), math.nan), "state": TOUCHING, "spec": ImageSpec()}, "finite"),
    (description_of, {"state": COLUMN, "spec": FarFieldSpec()}, r"state\.contacts: expected"),
    (description_of, {"state": dc.find_contacts(dc.single_body(height=5.0)), "spec": FarFieldSpec()}, "contacts: exp"),
    # contact problems
    (dc.solve_exactly, {"state": None}, "state: expected"),
    (dc.solve_exactly, {"state": COLUMN}, r"state\.contacts: expected"),
    (exactly, {"residual": 0.0}, "residual: expected"),
    (exactly, {"normal": [0.0]}, "tangent_start: expected"),
    (exactly, {"normal": [0.0, 1.0], "tangent": [0.0]}, "normal_start: expected"),
    (exactly, {"normal": [1e300], "tangent": [0.0]}, "normal_start: expected"),
    (problem, {"b": np.array([0.0, np.nan])}, r"b\[1\]: expected"),
    (problem, {"friction": np.array([-0.5])}, r"friction\[0\]: expected"),
    (problem, {"A": sparse.csr_array(np.ones((2, 4)))}, "A: expected"),
    (problem, {"A": sparse.csr_array([[1.0, np.inf], [0, 1]])}, "A: expected"),
    (problem, {"inverse_mass": np.array([-1.0, 1.0, 1.0])}, "inverse_mass: expected"),
    (problem, {"jacobian": sparse.csr_array(np.ones((2, 4)))}, "jacobian: expected"),
    (swept, {"solver": dc.PGS(islands=True)}, "solver: expected"),
    (swept, {"solver": dc.PGS()}, "tolerance: expected"),
    (swept, {"solver": dc.PGS(tolerance=None), "start": np.zeros(3)}, "start: expected"),
    (solved_problem, {"state": TOUCHING}, r"state\.solved: expected"),
    # kernels, grids and transfers
    (kernel, {"kernel": "poly7"}, "kernel: expected"),
    *((kernel, {"h": h}, "h: expected") for h in (0.0, 9e-51, 1.1e50, "1")),
    (kernel, {"dim": 1}, "dim: expected"),
    (kernel, {"r": [0.5, math.nan]}, r"r\[1\]: .*nan"),
    (kernel, {"r": [[0.5], [-0.1]]}, r"r\[1, 0\]: .*-0.1"),
    (kernel, {"r": math.inf}, "r: .*inf"),
    (kernel, {"r": [0.5j]}, "r: expected"),
    (sph.gradient, {"kernel": "poly6", "displacement": [1.0, 2.0, 3.0], "h": 1.0}, r"shape \(..., 2\)"),
    (sph.gradient, {"kernel": "poly6", "displacement": [[0.0, math.nan]], "h": 1.0}, r"\[0, 1\].*nan"),
    (grid, {"origin": (0, math.nan)}, "origin: expected"),
    (grid, {"spacing": (0.5, 0)}, "spacing: expected"),
    (grid, {"origin": (1e20, 0)}, "spacing: expected"),
    (grid, {"shape": (1, 5)}, "shape: expected"),
    (grid_over, {"box": (0, 0, 0, 1)}, "box"),
    (grid_over, {"box": (-1e308, 0, 1e308, 1)}, "box: expected"),
    (grid_over, {"box": (0, -1e308, 1, 1e308)}, "box: expected"),
    (grid_over, {"spacing": 0}, "spacing.*0"),
    (grid_over, {"spacing": 1e-12}, "spacing: expected"),
    (splat, {"position": [[1.0, 1.0], [math.nan, 1.0]]}, r"position\[1, 0\]: expected"),
    (splat, {"position": [1.0, 1.0]}, "position: expected"),
    (splat, {"values": [1.0, math.nan]}, r"values\[1\].*nan"),
    (splat, {"h": 0.0}, "h: expected"),
    (splat, {"kernel": "cubic"}, "kernel: expected"),
    (splat, {"normalization": "none"}, "normalization: expected"),
    (splat, {"unreached": None}, "unreached: expected"),
    (splat, {"outside": "wrap"}, "outside: expected"),
    (gather, {"image": np.zeros((7, 8))}, "image: expected"),
    (gather, {"image": np.full(GRID.shape, np.nan)}, "image, density: expected"),
    (gather, {"normalization": "consistent"}, "h: expected"),
    (gather, {"normalization": "consistent", "density": np.zeros((3, 3))}, "density: expected"),
    (gather, {"normalization": "consistent", "density": np.full(GRID.shape, np.nan)}, "density: expected"),
    (gather, {"density": np.ones(GRID.shape)}, "density: only for"),
    (gather, {"method": "cubic"}, "method: expected"),
    *(
        (read, {"grid": GRID, "image": np.zeros((7, 9, 1)), "position": [[0.5, 0.5]]} | changes, message)
        for read in (sph.read_by_spline, partial(sph.share_out, h=0.5))
        for changes, message in (
            ({"image": np.zeros((7, 9))}, "image: expected"),
            ({"image": np.full((7, 9, 1), np.nan)}, r"image\[0, 0, 0\]: expected"),
            ({"position": [0.5, 0.5]}, "position: expected"),
            ({"position": [[0.5, np.inf]]}, r"position\[0, 1\]: expected"),
        )
    ),
    (sph.read_by_spline, {"grid": sph.Grid.over_box((0, 0, 1, 3), 0.5), "image": np.zeros((7, 3, 1)),
                          "position": [[0.5, 0.5]]}, r"4 × 4 nodes .* got \(7, 3\)"),
    *(
        (window_products, {"image": np.ones((6, 6)), "kernel": np.ones((2, 2)), "row": 0, "column": 0} | bad, "kernel")
        for bad in ({"row": 5}, {"column": -1}, {"kernel": np.ones((2, 2, 3))})
    ),
]  # fmt: skip


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
