"""Wrong calls that users made: the message has the name, the value, and what to do."""

import inspect
import re

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.cnn import ImageSpec, LearnedModel
from deep_contact.measure.trade import Trade
from deep_contact.sph import Grid
from deep_contact.state.validation import OWNERS

SCENE = dc.column(3)
RUN = dc.simulate(SCENE, steps=3, record=1, forces=True)
STATE, BODIES = RUN.state, SCENE.bodies


class Layered:
    """What a `keras.Model` is to this package, without TensorFlow."""

    def __call__(self, image):
        return image


Layered.__module__ = "keras.src.models"
KERAS = Layered()


HELD = dc.State(name="held", world=dc.World(), bodies=dc.make_bodies([[5, 5], [9, 9]], fixed=[True, False]))
TWO, THREE = np.full((2, 2), 0.3), np.full((3, 3), 0.3)
SKEW = [[0.3, 0.1], [0.2, 0.3]]
TABLE = r"expected a number, or a symmetric table \(k, k\) of numbers with k up to 64"
FLAGS = r"expected True, or a symmetric table \(k, k\) of True and False with k up to 64"
ROUGH = dc.find_contacts(SCENE.replace(world=dc.World(rolling_friction=0.1)))


def live(**options):
    return dc.Simulator(SCENE, **options)


def assign(name, value):
    """Assign to an attribute of a live run, as `live.gravity = (0, 0)`."""
    setattr(live(), name, value)


def of_materials(count, **tables):
    """Three circles of the materials 0 to 2 in a world with tables of `count` materials."""
    world = dc.World(friction=np.full((count, count), 0.3), **tables)
    return dc.find_contacts(SCENE.replace(world=world, bodies=BODIES._replace(material=np.arange(3))))


WRONG = {
    # of another kind, or one in place of several
    "a state for several": (lambda: dc.simulate_many(SCENE), "states: expected several State objects, such as a list"),
    "a number for a state": (lambda: dc.simulate_many([SCENE, 3]), r"states\[1\]: expected a State, got 3"),
    "a state to a film": (lambda: dc.film(SCENE, "x.gif"), "states: expected several State objects"),
    "bodies to a film": (lambda: dc.film([BODIES], "x.gif"), r"states\[0\]: expected a State, got Bodies"),
    "a state to paired": (
        lambda: dc.experiments.paired(SCENE, ["none"], sweeps=1),
        "states: expected several State objects",
    ),
    "bodies to simulate": (lambda: dc.simulate(BODIES), r"state: expected a State, as of .*, got Bodies"),
    "bodies to forces": (lambda: dc.forces(BODIES), r"state: expected a State, as of .*, got Bodies"),
    "bodies to predict": (lambda: dc.load_model().predict(BODIES), r"state\[0\]: expected a State, got array"),
    "a path to simulate": (lambda: dc.simulate("scene.xml"), r"state: expected a State, as of .*, got 'scene.xml'"),
    "an array for bodies": (
        lambda: dc.State(name="a", world=dc.World(), bodies=np.zeros((2, 2))),
        "bodies: expected Bodies, as dc.make_bodies",
    ),
    "a run for a state": (lambda: dc.simulate(RUN), r"state: expected a State, as of .*, got Simulation"),
    "a number for a name": (lambda: dc.simulate(SCENE.replace(name=3)), "name: expected a text, got 3"),
    "a trade of a name": (lambda: dc.measure_trade("hopper"), "scene: expected a State or a function of a seed"),
    # indices and names
    "no segments": (lambda: RUN.force_on("segment", 0), "index: expected none, since there are none, got 0"),
    "no such circle": (
        lambda: RUN.force_on("circle", 3),
        "index: expected different numbers, 0 to 2, or 3 flags, got 3",
    ),
    "a side by number": (lambda: RUN.force_on("floor", 0), "index: expected none of the floor, got 0"),
    "a bottom": (lambda: RUN.force_on("bottom"), "part: expected one of floor, .*, got 'bottom'"),
    "no neighbour": (lambda: dc.neighbours(STATE, 7), "circle: expected an integer <= 2, got 7"),
    "remove what is not": (lambda: live().remove([9]), r"remove: expected different numbers, 0 to 2, .*, got \[9\]"),
    "no forces recorded": (
        lambda: dc.simulate(SCENE, steps=2, record=1).force_on("floor"),
        "forces: expected a run of simulate.*forces=True",
    ),
    "no states recorded": (lambda: dc.simulate(SCENE, steps=1).trajectory, r"trajectory: expected a run of .*record=…"),
    "no such accuracy": (
        lambda: dc.simulate(SCENE, accuracy="fasr"),
        "accuracy: expected one of .*did you mean 'fast'",
    ),
    "no such start": (lambda: dc.step(STATE, warm_start="buildin"), "warm_start: .*did you mean 'builtin'"),
    "no such kernel": (
        lambda: dc.sph.density(Grid.over_box((0, 0, 1, 1), 0.5), [[0.5, 0.5]], h=1.0, kernel="poly"),
        "kernel: expected one of .*did you mean 'poly6'",
    ),
    "no such sample": (lambda: dc.sample_file("rest"), "rest"),
    "no such part of a plan": (lambda: dc.plan(STATE)["sleep"], "part: expected one of .*did you mean 'sleeping'"),
    # numbers
    "two numbers for a box": (
        lambda: dc.World(box=(10, 10)),
        r"box: expected 4 finite numbers, \(x_min, y_min, x_max, y_max\), got \(10, 10\)",
    ),
    "a box inside out": (lambda: dc.World(box=(0, 0, -1, 1)), r"box: expected \(x_min, .*of positive extent"),
    "a number for gravity": (lambda: dc.World(gravity=-9.81), r"gravity: expected 2 .*such as \(0, -9.81\), got -9.81"),
    "seconds to step": (
        lambda: live().step(0.01),
        "steps: expected an integer >= 0, got 0.01; seconds are steps of Δt",
    ),
    "seconds to simulate": (
        lambda: dc.simulate(SCENE, steps=0.5),
        "steps: expected an integer >= 0, got 0.5; Δt is dt=…",
    ),
    "steps without end": (lambda: dc.simulate(SCENE, steps=10**30), "steps: expected an integer <= 1000000000000"),
    "cells without end": (
        lambda: dc.mean_stress(STATE, 1e-300),
        "spacing: expected at most 10,000,000 cells in the box",
    ),
    "restitution of 2": (lambda: dc.World(restitution=2), "restitution: expected a finite number >= 0 and <= 1, got 2"),
    "friction of nan": (lambda: dc.World(friction=np.nan), "friction: expected a finite number >= 0, got nan"),
    "radius of 0": (lambda: dc.make_bodies([[1, 1]], radius=0), "radius.*expected a number > 0, got 0"),
    "no time step": (lambda: dc.simulate(SCENE, dt=0), "dt: expected a finite number > 0, got 0"),
    "a record of 0": (lambda: dc.simulate(SCENE, record=0), "record: expected an integer >= 1, got 0"),
    "sweeps below 0": (lambda: dc.PGS(sweeps=-1), "sweeps: expected an integer >= 0, got -1"),
    "a text for sweeps": (lambda: dc.PGS(sweeps="many"), "sweeps: expected an integer >= 0, got 'many'"),
    "positions of three": (
        lambda: dc.make_bodies([[0, 0, 0]]),
        r"position: expected numbers of shape \(n, 2\), x and y",
    ),
    "two radii for three": (
        lambda: dc.make_bodies(np.zeros((3, 2)), radius=[1, 2]),
        r"radius: expected one value .*each of the 3, got \[1, 2\]",
    ),
    "a segment of one point": (
        lambda: dc.World(segments=[((0, 0), (0, 0))]),
        r"segments\[0\]: expected two different points, \(\(x, y\), \(x, y\)\)",
    ),
    "one segment for several": (
        lambda: dc.World(segments=((0, 0), (1, 1))),
        r"segments\[0\]: expected two different points",
    ),
    "speeds of no segments": (
        lambda: dc.World(surface_speeds=[1.0]),
        "surface_speeds: expected 0 finite numbers.*one a segment",
    ),
    "a push for two": (
        lambda: dc.simulate(SCENE, steps=1, push=np.zeros((2, 2))),
        r"push: expected forces \(3, 2\), N, or a tuple",
    ),
    "far segments": (
        lambda: live().set(segments=[((1e300, 0), (0, 1))]),
        r"world.segments\[0, 0\]: expected -1e\+12 to 1e\+12 m, got 1e\+300",
    ),
    "forces without record": (
        lambda: dc.simulate(SCENE, forces=True),
        "forces: expected False without record=…, got True",
    ),
    "a solver and an accuracy": (
        lambda: dc.simulate(SCENE, accuracy="fast", solver=dc.PGS()),
        "accuracy: expected no solver beside it",
    ),
    "a solver's class": (
        lambda: dc.simulate(SCENE, solver=dc.PGS),
        r"solver: expected options such as PGS\(sweeps=…\)",
    ),
    # materials and tables
    "a row for a table": (lambda: dc.World(friction=[0.1, 0.2]), rf"friction: {TABLE}, got \[0.1, 0.2\]"),
    "a table that is no square": (lambda: dc.World(restitution=np.zeros((2, 3))), rf"restitution: {TABLE}, got array"),
    "rows of unequal length": (lambda: dc.World(friction=[[0.1, 0.2], [0.3]]), rf"friction: {TABLE}, got \[\[0.1, 0.2"),
    "a table of words": (lambda: dc.World(friction=[["a", "b"], ["b", "a"]]), rf"friction: {TABLE}, got \[\['a'"),
    "a dictionary for a table": (
        lambda: dc.World(friction={(0, 1): 0.1}),
        rf"friction: {TABLE}, got {{\(0, 1\): 0.1}}",
    ),
    "a name for a property": (lambda: dc.World(rolling_friction="much"), rf"rolling_friction: {TABLE}, got 'much'"),
    "no property": (lambda: dc.World(friction=None), rf"friction: {TABLE}, got None"),
    "a table of too many": (lambda: dc.World(friction=np.ones((65, 65))), rf"friction: {TABLE}, got array"),
    "an asymmetric table": (
        lambda: dc.World(friction=SKEW),
        r"friction\[1\]\[0\]: expected 0.1, as in \[0\]\[1\], got 0.2",
    ),
    "an asymmetric table of a live run": (
        lambda: live().set(friction=SKEW),
        r"friction\[1\]\[0\]: expected 0.1, as in \[0\]\[1\], got 0.2",
    ),
    "restitution of 2 in a table": (
        lambda: dc.World(restitution=[[0.1, 2], [2, 0.1]]),
        r"restitution\[0\]\[1\]: expected a finite number >= 0 and <= 1, got 2.0",
    ),
    "nan in a table": (
        lambda: dc.World(rolling_friction=[[0.1, np.nan], [np.nan, 0.1]]),
        r"rolling_friction\[0\]\[1\]: expected a finite number >= 0, got nan",
    ),
    "tables of two sizes": (
        lambda: dc.World(friction=TWO, rolling_friction=THREE),
        "rolling_friction: expected a table of 2 materials, as friction has, got 3",
    ),
    "rolling below 0": (
        lambda: dc.World(rolling_friction=-0.1),
        "rolling_friction: expected a finite number >= 0, got -0.1",
    ),
    "touches of numbers": (lambda: dc.World(touches=[[1, 0], [0, 1]]), rf"touches: {FLAGS}, got \[\[1, 0\]"),
    "touches nothing": (lambda: dc.World(touches=False), f"touches: {FLAGS}, got False"),
    "touches on one side": (
        lambda: dc.World(touches=[[True, False], [True, True]]),
        r"touches\[1\]\[0\]: expected False, as in \[0\]\[1\], got True",
    ),
    "a material of three walls": (
        lambda: dc.World(wall_materials=[0, 0, 0]),
        r"wall_materials: expected 4 integers from 0 to 63, floor, right, ceiling, left, got \[0, 0, 0\]",
    ),
    "one material of all walls": (lambda: dc.World(wall_materials=1), "wall_materials: expected 4 integers .*, got 1"),
    "a wall's material by name": (
        lambda: dc.World(wall_materials=["steel"] * 4),
        r"wall_materials: expected 4 integers .*, got \['steel'",
    ),
    "a wall's material that no table has": (
        lambda: dc.World(friction=TWO, wall_materials=[2, 0, 0, 0]),
        "wall_materials: expected materials from 0 to 1, as the world's tables have, got 2",
    ),
    "a material of no segments": (
        lambda: dc.World(segment_materials=[1]),
        r"segment_materials: expected 0 integers from 0 to 63, one a segment, got \[1\]",
    ),
    "a circle's material that no table has": (
        lambda: of_materials(2),
        "bodies.material: expected materials from 0 to 1, as the world's tables have, got 2",
    ),
    "a circle's material by name": (
        lambda: dc.make_bodies([[0, 0]], material="steel"),
        "material: expected an integer from 0 on for all circles, or for each of the 1, got 'steel'",
    ),
    "two materials of a circle": (lambda: dc.make_bodies([[0, 0]], material=[0, 1]), r"material: .*, got \[0, 1\]"),
    "a share of a material": (lambda: dc.make_bodies([[0, 0]], material=0.5), "material: .*, got 0.5"),
    "ragged materials": (lambda: dc.make_bodies([[0, 0]], material=[[0], [0, 1]]), r"material: .*, got \[\[0\]"),
    "a negative material": (
        lambda: dc.make_bodies([[0, 0]], material=-1),
        r"bodies.material\[0\]: expected an integer from 0 to 63, got -1",
    ),
    "fixed by number": (
        lambda: dc.make_bodies([[0, 0]], fixed=1),
        "fixed: expected True or False for all circles, or for each of the 1, got 1",
    ),
    "an added circle of another material": (
        lambda: dc.Simulator(SCENE.replace(world=dc.World(friction=TWO))).add(dc.make_bodies([[9, 9]], material=5)),
        "bodies.material: expected materials from 0 to 1, as the world's tables have, got 5",
    ),
    "rolling by another solver": (
        lambda: live(solver=dc.NNCG()).set(rolling_friction=0.1),
        "rolling_friction: expected 0 for NNCG, since only PGS, BatchedPGS, PSOR have rolling resistance, got 0.1",
    ),
    "rolling, solved exactly": (
        lambda: dc.solve_exactly(ROUGH),
        "rolling_friction: expected 0 for exact solutions, which have no rolling resistance, got 0.1",
    ),
    # a live run
    "a number to call": (lambda: live(on_step=3), "on_step: expected a function, or None, got 3"),
    "a name to call": (
        lambda: dc.simulate(SCENE, on_step="print"),
        "on_step: expected a function, or None, got 'print'",
    ),
    "until a time": (lambda: dc.simulate(SCENE, until=1.5), "until: expected a function, or None, got 1.5"),
    "forces on a part": (lambda: live(forces="floor"), "forces: expected True or False, got 'floor'"),
    "no forces summed": (
        lambda: live().force_on("floor"),
        r"forces: expected a Simulator\(…, forces=True\), got one without",
    ),
    "no step seen": (
        lambda: live().solved,
        r"solved: expected a Simulator\(…, forces=True\), or with on_step=…, got one without",
    ),
    "no step yet": (
        lambda: live(forces=True).solved,
        "solved: expected a call of step that was completed before, got none",
    ),
    "a part of a live run": (
        lambda: live(forces=True).force_on("flor"),
        "part: expected one of floor, .*, got 'flor'; did you mean 'floor'",
    ),
    "a segment of a live run": (
        lambda: live(forces=True).force_on("segment", 0),
        "index: expected none, since there are none, got 0",
    ),
    "no fixed circles": (
        lambda: live().set(fixed_velocities=(1, 0)),
        r"fixed_velocities: expected None, since no circle is fixed, got \(1, 0\)",
    ),
    "two velocities of one": (
        lambda: dc.Simulator(HELD).set(fixed_velocities=[(1, 0), (2, 0)]),
        r"fixed_velocities: expected a finite pair, m/s, for all fixed circles, or one for each of the 1, got \[\(1, 0",
    ),
    "a spin of words": (
        lambda: dc.Simulator(HELD).set(fixed_spins="fast"),
        "fixed_spins: expected a finite number, rad/s, for all fixed circles, or one for each of the 1, got 'fast'",
    ),
    "remove by name": (lambda: live().remove("first"), "remove: expected different numbers, 0 to 2, .*, got 'first'"),
    "remove in rows": (lambda: live().remove([[0], [1, 2]]), r"remove: expected different numbers, .*, got \[\[0\]"),
    # paths
    "a state for a path": (
        lambda: dc.write_state(SCENE, "scene.xml"),
        "path: expected the path of a file, as a text or a Path, got State",
    ),
    "a number for a path": (lambda: dc.read_state(3), "path: expected the path of a file, .*, got 3"),
    "a run for a path": (lambda: dc.load_trajectory(RUN), "path: expected the path of a file, .*, got Simulation"),
    "a run to a table": (
        lambda: RUN.trajectory.save("run.csv"),
        r"path: expected a name that ends in .h5 or .hdf5, got 'run.csv'; pandas.DataFrame\(trajectory.table",
    ),
    "a trade to a picture": (
        lambda: Trade.save(None, "trade.png"),
        r"path: expected a name that ends in .json, got 'trade.png'; trade.plot\(\) makes a figure",
    ),
    "a film for ParaView": (
        lambda: RUN.trajectory.film("run.vtu"),
        "path: expected a name that ends in .html, .gif or .mp4, got 'run.vtu'",
    ),
    "a file of states for a state": (
        lambda: dc.write_state("run.h5", STATE),
        "run.h5: not written: .* .xml or .xml.gz",
    ),
    "no path": (lambda: RUN.trajectory.film(None), "path: expected the path of a file, .*, got None"),
    # networks
    "a network of Keras as a start": (
        lambda: dc.simulate(STATE, steps=1, warm_start=KERAS),
        r"warm_start: .*Layered of Keras; LearnedModel\(source=…",
    ),
    "a network of Keras to one solve": (
        lambda: dc.solve_contacts(STATE, start=KERAS),
        r"warm_start: .*Layered of Keras; LearnedModel\(source=…",
    ),
    "a file of Keras as a start": (
        lambda: dc.simulate(STATE, steps=1, warm_start="own.keras"),
        "model: expected a file of this package, ….h5, got own.keras; LearnedModel",
    ),
    "a start's class": (
        lambda: dc.step(STATE, warm_start=dc.warm_start.Sph),
        r"warm_start: expected an instance, such as Sph\(\)",
    ),
    "a network to load": (lambda: dc.load_model(KERAS), "model: expected a name or the path of a file.*LearnedModel"),
    "a file of Keras to load": (lambda: dc.load_model("own.keras"), "model: .*got own.keras; LearnedModel"),
    "a path for a network": (
        lambda: LearnedModel(source="own.keras", spec=ImageSpec()),
        "source: expected a keras.Model, got 'own.keras'; keras",
    ),
    "no spec": (
        lambda: LearnedModel(source=dc.load_model().source, spec=None),
        r"spec: .*such as ImageSpec\(\), got None",
    ),
    "impulses of others": (
        lambda: dc.solve_contacts(STATE, start=(np.zeros(9), np.zeros(9))),
        r"start: expected normal impulses of shape \(3,\)",
    ),
    "one array as a start": (lambda: dc.solve_contacts(STATE, start=3), "start: expected two arrays of impulses"),
}
"""What is wrong -> the call, and the message of its ValueError."""

KEYWORDS = {
    "radii": (lambda: dc.make_bodies([[0, 0]], radii=1.0), "radius"),
    "mu": (lambda: dc.World(mu=0.3), "friction"),
    "gravitiy": (lambda: dc.World(gravitiy=(0, -1)), "gravity"),
    "raduis": (lambda: dc.circles_in_box(5, raduis=1.0), "radius"),
    "restitutoin": (lambda: dc.hopper(restitutoin=0.1), "restitution"),
    "nsteps": (lambda: dc.simulate(SCENE, nsteps=5), "steps"),
    "timestep": (lambda: dc.simulate(SCENE, timestep=0.1), "dt"),
    "iterations": (lambda: dc.PGS(iterations=5), "sweeps"),
    "omga": (lambda: dc.PSOR(omga=1.5), "omega"),
    "body": (lambda: dc.State(name="a", world=dc.World(), body=BODIES), "bodies"),
    "warmstart": (lambda: dc.step(STATE, warmstart="none"), "warm_start"),
    "starts": (lambda: dc.solve_contacts(STATE, starts="none"), "start"),
    "acuracy": (lambda: dc.Simulator(SCENE, acuracy="fast"), "accuracy"),
    "segment_velocity": (lambda: live().set(segment_velocity=[]), "segment_velocities"),
    "workers": (lambda: dc.simulate_many([SCENE], workers=2), "jobs"),
    "budget": (lambda: dc.recommend(SCENE, budget=1.0), "budget_ms"),
    "quantity": (lambda: dc.measure_trade(SCENE, quantity={}), "quantities"),
    "materials": (lambda: dc.make_bodies([[0, 0]], materials=1), "material"),
    "wall_material": (lambda: dc.World(wall_material=[0] * 4), "wall_materials"),
    "rolling_resistance": (lambda: dc.World(rolling_resistance=0.1), "rolling_friction"),
    "collisions": (lambda: dc.World(collisions=[[True]]), "touches"),
    "mask": (lambda: dc.World(mask=1), "touches"),
    "callback": (lambda: live(callback=print), "on_step"),
    "every": (lambda: dc.simulate(SCENE, every=10), "record"),
    "fixed_velocity": (lambda: live().set(fixed_velocity=(1, 0)), "fixed_velocities"),
    "velocity": (lambda: live().set(velocity=(1, 0)), "fixed_velocities"),
    "n": (lambda: dc.circles_in_box(n=5), "n_bodies"),
}
"""Keyword that there is not -> a call, and the keyword that was meant."""

ELSEWHERE = {
    "gravity": (lambda: dc.simulate(SCENE, gravity=(0, 0)), "dc.World has 'gravity'"),
    "friction": (lambda: dc.make_bodies([[0, 0]], friction=0.3), "dc.World has 'friction'"),
    "restitution": (lambda: SCENE.replace(restitution=0.3), "dc.World has 'restitution'"),
    "mu": (lambda: live(mu=0.3), "dc.World has 'friction'"),
    "touches": (lambda: live().set(touches=True), "dc.World has 'touches'"),
    "material": (lambda: dc.World(material=1), "dc.make_bodies has 'material'"),
    "dt": (lambda: live(dt=0.01), "dc.State has 'dt'"),
    "steps": (lambda: live(steps=10), "dc.simulate has 'steps'"),
    "seed": (lambda: dc.simulate(SCENE, seed=1), "dc.circles_in_box has 'seed'"),
    "substeps": (lambda: dc.simulate(SCENE, substeps=2), "dc.PGS has 'substeps'"),
    "on_step": (lambda: dc.simulate_many([SCENE], on_step=print), "dc.simulate has 'on_step'"),
    "radius": (lambda: dc.World(radius=1.0), "dc.make_bodies has 'radius'"),
    "bodies": (lambda: dc.hopper(bodies=5), "dc.State has 'bodies'"),
}
"""Keyword of something else -> a call, and what has the keyword."""

ASSIGNED = {
    "gravity": ((0, 0), r"gravity: expected live.set\(gravity=…\) to change it, live.state to read it, got .*\(0, 0\)"),
    "dt": (0.1, r"dt: expected live.set\(dt=…\) to change it, live.state to read it, got an assignment of 0.1"),
    "push": (None, r"push: expected live.set\(push=…\) to change it"),
    "bodies": (BODIES, "bodies: expected live.state.bodies; set, add and remove change the scene, got .* Bodies"),
    "world": (SCENE.world, "world: expected live.state.world; set, add and remove change the scene, got .* World"),
    "solver": (dc.PGS(), r"solver: expected dc.Simulator\(live.state, solver=…\), a new simulator, got .* PGS"),
    "on_step": (print, r"on_step: expected dc.Simulator\(live.state, on_step=…\), a new simulator, got"),
}
"""Name that a `Simulator` does not store under this name -> a value, and the message of its AttributeError."""


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_call_says_what_to_do(name):
    call, message = WRONG[name]
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        call()
    said = str(caught.value)
    assert re.search(message, said), said
    assert "\n" not in said
    assert len(said) < 400


@pytest.mark.parametrize("name", KEYWORDS)
def test_a_misspelt_keyword_gets_the_nearest(name):
    call, meant = KEYWORDS[name]
    with pytest.raises(TypeError, match=rf"unexpected keyword argument '{name}'; did you mean '{meant}'\?"):
        call()


@pytest.mark.parametrize("name", ELSEWHERE)
def test_a_keyword_of_something_else_says_whose_it_is(name):
    call, owner = ELSEWHERE[name]
    with pytest.raises(TypeError, match=rf"unexpected keyword argument '{name}'; {owner}$"):
        call()


def test_a_keyword_that_resembles_none_gets_no_suggestion():
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'save'$"):
        dc.simulate(SCENE, save="run.h5")


@pytest.mark.parametrize("name", OWNERS)
def test_the_owners_of_keywords_have_them(name):
    owner = dc
    for part in OWNERS[name].split(".")[1:]:
        owner = getattr(owner, part)
    assert name in inspect.signature(owner).parameters


@pytest.mark.parametrize("name", ASSIGNED)
def test_an_assignment_that_would_change_nothing_is_refused(name):
    value, message = ASSIGNED[name]
    with pytest.raises(AttributeError, match=message):
        assign(name, value)
    with pytest.raises(AttributeError, match=f"^{name}: expected "):
        getattr(live(), name)


def test_options_have_to_be_named_and_the_message_names_some():
    with pytest.raises(TypeError, match="name the options: steps=…, dt=…, solver=…"):
        dc.simulate(SCENE, 100)


def test_an_error_of_a_callback_stays_its_own():
    def on_step(state, record):
        dict().update(**{"steps": 1}, **{"a": 1})
        raise TypeError("on_step() got an unexpected keyword argument 'x'")

    with pytest.raises(TypeError, match=r"argument 'x'$"):
        dc.simulate(SCENE, steps=1, on_step=on_step)


def test_there_are_more_than_sixty_of_them():
    assert len(WRONG) + len(KEYWORDS) + len(ELSEWHERE) + len(ASSIGNED) >= 150
