"""Scenes: what they promise, and what they refuse."""

import numpy as np

import deep_contact as dc


def overlap(bodies):
    """Deepest overlap of any two circles, m."""
    offset = bodies.position[:, None] - bodies.position[None]
    gap = np.hypot(*np.moveaxis(offset, -1, 0)) - bodies.radius[:, None] - bodies.radius[None]
    return -gap[np.triu_indices(bodies.count, 1)].min()


def test_centres_scatter_as_the_thesis_says():
    # Few circles that hardly exclude each other: standard deviation 1.2 √15 = 4.65 about the middle.
    scenes = [dc.circles_in_box(4, seed=s) for s in range(300)]
    centres = np.concatenate([scene.bodies.position for scene in scenes])
    np.testing.assert_allclose(centres.mean(axis=0), 15, atol=0.4)
    np.testing.assert_allclose(centres.std(axis=0), 1.2 * np.sqrt(15), rtol=0.06)


def test_seed_and_generator_are_the_same():
    one = dc.circles_in_box(30, seed=4).bodies.position
    np.testing.assert_array_equal(one, dc.circles_in_box(30, seed=np.random.default_rng(4)).bodies.position)
    assert not np.array_equal(one, dc.circles_in_box(30, seed=5).bodies.position)


def test_column_touches_and_stands():
    scene = dc.column(20)
    assert scene.world.box == (0, 0, 30, 42)  # room for one more
    assert abs(overlap(scene.bodies)) < 1e-12
    bodies = dc.simulate(scene, steps=100, solver=dc.PGS(sweeps=2000)).state.bodies
    np.testing.assert_allclose(bodies.position[:, 0], 15.0, atol=1e-9)


def test_a_drum_of_few_sides_holds_the_lattice_of_mixed_radii():
    scene = dc.drum(4000, sides=12, filling=0.45, radius=(0.01, 1.0), seed=2)
    ends = np.reshape(scene.world.segments, (12, 2, 2))  # one faces a corner of the lattice
    middle = np.array(scene.world.box[2:]) / 2
    outwards = ends.mean(axis=1) - middle
    apothem = np.hypot(*outwards.T)
    out = (scene.bodies.position - middle) @ (outwards / apothem[:, None]).T + scene.bodies.radius[:, None]
    assert (out <= apothem).all()


def test_a_hopper_lets_circles_through_its_hole_alone():
    scene = dc.hopper(80, opening=9.0, seed=2)
    (x_0, foot), (x_1, _) = np.reshape(scene.world.segments, (-1, 2, 2))[[0, 1], [1, 0]]
    assert x_1 - x_0 == 9.0
    assert overlap(scene.bodies) < 0
    run = dc.simulate(scene, steps=500, record=1)
    y, x = run.trajectory.positions[..., 1], run.trajectory.positions[..., 0]
    falls = (y[:-1] > foot) & (y[1:] <= foot)
    assert falls.sum() > 40
    assert ((x[1:] > x_0) & (x[1:] < x_1))[falls].all()


def test_a_terrain_bears_its_circles():
    scene = dc.terrain(60, seed=3)
    line = np.reshape(scene.world.segments, (-1, 2, 2))
    np.testing.assert_array_equal(line[1:, 0], line[:-1, 1])
    end = dc.simulate(scene, steps=400).state
    ground = np.interp(end.bodies.position[:, 0], [*line[:, 0, 0], line[-1, 1, 0]], [*line[:, 0, 1], line[-1, 1, 1]])
    assert (end.bodies.position[:, 1] > ground).all()
    assert (end.contacts.body_b >= 64).sum() > 5
