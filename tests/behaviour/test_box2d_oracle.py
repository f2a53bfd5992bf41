"""The engine against the real Box2D 2.3: one solve at a time, and whole runs in the mean."""

from dataclasses import replace

import numpy as np
import pytest
from box2d_recorder import RecordingBox2D, solved_in_order

import deep_contact as dc

pytest.importorskip("Box2D")
pytestmark = pytest.mark.peers


def recorded_steps(seed, radius, sweeps):
    """Every 12th step of a Box2D run, from the first contacts to the settled pile."""
    scene = dc.circles_in_box(80, radius=radius, seed=seed)
    # Box2D's lengths are absolute, whatever the mean radius.
    scene = scene.replace(world=replace(scene.world, scales=dc.BOX2D))
    peer = RecordingBox2D(scene)
    for step in range(600):
        if step % 12 == 0:
            recorded = peer.record_step(scene.dt, sweeps, 10)
            if recorded.state.contacts.count:
                yield recorded
        else:
            peer.step(scene.dt, sweeps, 10)


@pytest.mark.parametrize("radius", [(1.0, 1.0), (0.5, 1.2)])
def test_impulses_equal_box2d(radius):
    # Same start, same order, same number of sweeps; Box2D works in float32, hence 1e-4 of the largest impulse.
    compared = 0
    for seed in range(3):
        for recorded in recorded_steps(seed, radius, sweeps=60):
            contacts, ours = solved_in_order(recorded, sweeps=60)
            largest = contacts.normal_impulse.max()
            np.testing.assert_allclose(ours.normal_impulses, contacts.normal_impulse, atol=1e-4 * largest)
            np.testing.assert_allclose(ours.tangent_impulses, contacts.tangent_impulse, atol=1e-4 * largest)
            compared += 1
    assert compared >= 100  # for each of the two radii


def test_ten_seconds_of_the_thesis_scene_end_as_in_box2d():
    # Chaos parts the two runs after the first impacts; what they settle to agrees in the mean over ten seeds.
    heights, counts = [], []
    for seed in range(10):
        scene = dc.circles_in_box(seed=seed)
        run = dc.simulate(scene, steps=1000, solver=dc.PGS(sweeps=50, tolerance=None, position_sweeps=10))
        peer = RecordingBox2D(scene)
        for _ in range(1000):
            peer.step(scene.dt, 50, 10)
        heights.append((run.state.bodies.position[:, 1].mean(), peer.bodies().position[:, 1].mean()))
        counts.append((run.contacts[-1], peer.contact_count()))
    ours, box2d = np.mean(heights, axis=0)
    assert abs(ours / box2d - 1) < 0.01
    ours, box2d = np.mean(counts, axis=0)
    assert abs(ours / box2d - 1) < 0.03
