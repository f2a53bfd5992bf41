"""Random scenes of all features (`tests/tools/random_scenes.py`), and one scene that has all of them on purpose.

The tool was run over 300 scenes; a few of them are run here.
"""

from dataclasses import replace

import numba
import numpy as np
import pytest
from conftest import assert_same_bits, load_script

import deep_contact as dc
from deep_contact.analysis.contact_forces import forces
from deep_contact.state.materials import at_contacts

if not numba.config.DISABLE_JIT:
    pytestmark = pytest.mark.slow  # three kinds of steps to compile; test_without_compiler.py runs some interpreted

tool = load_script("random_scenes")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(6))
def test_a_random_scene_is_the_same_in_parts_from_files_live_among_others_and_with_other_labels(seed, tmp_path):
    found, gained = tool.findings(seed, tmp_path, has_all=not numba.config.DISABLE_JIT)
    assert found == {}
    assert gained < tool.ENERGY


def test_differences_are_seen():
    one = dc.simulate(dc.column(2), steps=2, solver=dc.PGS()).state
    other = one.bodies._replace(spin=one.bodies.spin + 1e-15)
    assert tool.difference(one, one) == ""
    assert tool.difference(one, one.replace(bodies=other)) == "bodies.spin"
    assert tool.difference(one, one.replace(world=replace(one.world, friction=0.4))) == "world"
    cold, hot = (one.replace(bodies=one.bodies._replace(velocity=one.bodies.velocity + v)) for v in (0.0, 5.0))
    made = type("Run", (), {"trajectory": dc.Trajectory.from_states([cold, hot])})
    assert tool.gained(made, one) > 0.1


# ---- all features in one scene ----

SAND, RUBBER, GHOST = range(3)
SETTLED = [8, 9]
"""Two circles that rest on the floor, where nothing reaches them. They fall asleep."""
ROLLER = 7


def everything():
    """Three materials with all tables, a wall that pushes, a roller, a shelf, a push, bounces, and two that sleep.

    Returns (scene, push).
    """
    world = dc.World(
        box=(0.0, 0.0, 40.0, 30.0),
        friction=[[0.6, 0.3, 0.2], [0.3, 0.8, 0.0], [0.2, 0.0, 0.1]],
        restitution=[[0.0, 0.5, 0.3], [0.5, 0.9, 0.0], [0.3, 0.0, 0.2]],
        rolling_friction=[[0.05, 0.02, 0.0], [0.02, 0.0, 0.0], [0.0, 0.0, 0.0]],
        touches=[[True, True, True], [True, True, False], [True, False, True]],
        wall_materials=[SAND, SAND, SAND, SAND],
        segments=[((1.0, 0.0), (1.0, 12.0)), ((14.0, 4.0), (22.0, 3.0))], segment_materials=[RUBBER, SAND],
        segment_velocities=[((2.0, 0.0), (2.5, 0.0)), ((0.0, 0.0), (0.0, 0.0))],
    )  # fmt: skip
    places = [(2.2, 1.01), (4.3, 1.01), (6.4, 1.01), (3.2, 2.8), (5.4, 2.8), (16.0, 8.0), (16.2, 12.0)]
    places += [(19.0, 7.0), (30.0, 1.005), (33.0, 1.005)]
    bodies = dc.make_bodies(
        places, radius=1.0, material=[SAND, RUBBER, SAND, GHOST, RUBBER, RUBBER, SAND, SAND, SAND, SAND],
        velocity=[(0.0, 0.0)] * 5 + [(0.0, -14.0), (0.0, -3.0)] + [(0.0, 0.0)] * 3,
        spin=[0.0] * 7 + [-6.0, 0.0, 0.0], fixed=np.arange(10) == ROLLER,
    )  # fmt: skip
    push = np.zeros((10, 2)), np.zeros(10)
    push[0][2], push[1][4] = (-5.0, 3.0), 2.0
    return dc.State(name="everything", world=world, bodies=bodies), push


@pytest.mark.filterwarnings("ignore")
def test_all_features_in_one_scene_keep_their_laws_and_their_bits():
    """Materials, a moving wall, a push, bounces, divided steps, sleep and a preset: momentum, cones, energy, bits."""
    scene, push = everything()
    options, steps, n = {"accuracy": "fast", "sleep": True, "push": push}, 120, scene.bodies.count
    gained, pairs, margins = np.zeros((n, 2)), set(), []

    def on_step(state, record):
        contacts, on = state.contacts, forces(state).net * state.dt
        gained[:] += on + (0.0 if record.shifts is None else record.shifts)
        material = state.bodies.material
        inside = contacts.body_b < n
        pairs.update(zip(material[contacts.body_a[inside]], material[contacts.body_b[inside]]))
        # |λ_t| <= μ λ_n of the pair at contacts that hardly move, whose normals stay in the step. A sweep changes λ_n
        # after λ_t, so that impulses after four sweeps may lie outside by a little: 5 % of a weight.
        mu, speed = at_contacts(state, state.world.friction), np.hypot(*state.bodies.velocity.T)
        slow = (speed[contacts.body_a] < 0.5) & (speed[np.minimum(contacts.body_b, n - 1)] < 0.5)
        cone = mu * contacts.normal_impulse - np.abs(contacts.tangent_impulse)
        margins.extend((cone / (9.81 * state.dt * np.pi))[slow])

    watched = dc.simulate(scene, steps=steps, on_step=on_step, **options)
    run = dc.simulate(scene, steps=steps, record=1, forces=True, **options)
    live = dc.Simulator(scene, **options)
    for _ in range(steps):
        live.step()
    assert_same_bits(watched.state, run.state)
    assert_same_bits(live.state, run.state)
    # Features that are there: divided steps, and circles that sleep.
    assert run.substeps.max() > run.substeps.min()
    assert (run.trajectory.velocities[-1, SETTLED] == 0.0).all()
    assert (GHOST, RUBBER) not in pairs
    assert (RUBBER, GHOST) not in pairs
    assert len(pairs) >= 3
    # Laws: momentum of what is awake, Coulomb's cone, energy, the wall's work.
    bodies, end = scene.bodies, run.state.bodies
    awake = np.setdiff1d(np.arange(n), [ROLLER, *SETTLED])
    acted = gained + steps * scene.dt * (bodies.free_mass[:, None] * scene.world.gravity + push[0])
    change = bodies.free_mass[:, None] * (end.velocity - bodies.velocity)
    np.testing.assert_allclose(change[awake], acted[awake], rtol=0, atol=1e-9 * np.abs(acted).max())
    assert len(margins) > steps
    assert min(margins) > -0.05
    assert tool.gained(run, scene) < tool.ENERGY
    assert run.trajectory.work[-1] > 0.0
    # Labels: the same bits under other numbers of the materials.
    other = tool.relabelled(scene, [2, 0, 1])
    again = dc.simulate(other, steps=steps, **options).state
    assert tool.difference(again, run.state, labels=False) == ""
