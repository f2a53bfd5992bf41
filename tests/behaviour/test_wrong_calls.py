"""Wrong calls that users made: the message has the name, the value, and what to do."""

import re

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.cnn import ImageSpec, LearnedModel
from deep_contact.sph import Grid

SCENE = dc.column(3)
RUN = dc.simulate(SCENE, steps=3, record=1, forces=True)
STATE, BODIES = RUN.state, SCENE.bodies


class Layered:
    """What a `keras.Model` is to this package, without TensorFlow."""

    def __call__(self, image):
        return image


Layered.__module__ = "keras.src.models"
KERAS = Layered()


def live():
    return dc.Simulator(SCENE)


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
    # networks
    "a network of Keras as a start": (
        lambda: dc.simulate(STATE, steps=1, warm_start=KERAS),
        r"warm_start: .*Layered of Keras; LearnedModel\(source=…",
    ),
    "a network of Keras to one solve": (
        lambda: dc.solve_contacts(STATE, start=KERAS),
        r"warm_start: .*Layered of Keras; LearnedModel\(source=…",
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
}
"""Keyword that there is not -> a call, and the keyword that was meant."""


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


def test_options_have_to_be_named_and_the_message_names_some():
    with pytest.raises(TypeError, match="name the options: steps=…, dt=…, solver=…"):
        dc.simulate(SCENE, 100)


def test_an_error_of_a_callback_stays_its_own():
    def on_step(state, record):
        dict().update(**{"steps": 1}, **{"a": 1})
        raise TypeError("on_step() got an unexpected keyword argument 'x'")

    with pytest.raises(TypeError, match=r"argument 'x'$"):
        dc.simulate(SCENE, steps=1, on_step=on_step)


def test_there_are_sixty_of_them():
    assert len(WRONG) + len(KEYWORDS) >= 60
