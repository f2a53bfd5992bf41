"""The numbers of a scene by hand: of its free circles, its walls, and all that moves."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import circles_at

import deep_contact as dc
from deep_contact.accuracy.presets import parts_for
from deep_contact.accuracy.scene_numbers import scene_numbers

BAR = {"segments": [((0.0, 5.0), (9.0, 5.0)), ((0.0, 9.0), (9.0, 9.0))]}


def scene(**options):
    """Three circles of which the middle one is the largest, heaviest and fastest of 5 m/s."""
    bodies = {"radius": [0.5, 2.0, 1.0], "mass": [1.0, 8.0, 3.0], "velocity": [[1.0, 0.0], [-3.0, 4.0], [0.0, 0.0]]}
    options = {"box": (0.0, 0.0, 20.0, 30.0)} | options
    return circles_at([[2.0, 1.0], [8.0, 7.0], [5.0, 3.0]], **bodies | options)


def test_numbers_of_three_circles_by_hand():
    found = scene_numbers(scene(friction=0.3, restitution=0.2, dt=0.02))
    assert found[:9] == (3, 0.02, 9.81, 0.3, 0.3, 0.2, 0.2, 0.0, False)
    assert (found.still, found.moving) == (0, 0)
    assert found.radius == pytest.approx(3.5 / 3.0)
    assert (found.radius_ratio, found.lightest, found.mass_ratio) == (4.0, 1.0, 8.0)
    assert found.density_ratio == pytest.approx(2.0)  # 4, 2 and 3 kg over r²
    assert found.fastest == pytest.approx(5.0)
    assert found.squares == pytest.approx(0.25 + 4.0 + 1.0)
    assert (found.height, found.width, found.box_width) == (6.0, 6.0, 20.0)
    # Denser than the geometric mean, 2.83: those at 1 and 3 m. The other is at 7 m: (2 − 7) / 6.
    assert found.layers == pytest.approx(-5.0 / 6.0)


@pytest.mark.parametrize("seed", [1, 15, 16])
def test_densities_that_differ_by_rounding_make_no_layers(seed):
    found = scene_numbers(dc.lattice_in_box(5, radius=(0.7, 1.0), seed=seed))
    assert found.density_ratio == pytest.approx(1.0, abs=1e-12)
    assert found.layers == 0.0


@pytest.mark.parametrize(
    ("gravity", "box_width"), [((9.81, 0.0), 30.0), ((-2.0, 1.0), 30.0), ((0.0, 9.81), 20.0), ((0.0, 0.0), 20.0)]
)
def test_heights_are_against_gravity_and_widths_across(gravity, box_width):
    found, place = scene_numbers(scene(gravity=gravity)), scene().bodies.position
    g = math.hypot(*gravity)
    up = -np.array(gravity) / g if g else np.zeros(2)
    assert found.gravity == pytest.approx(g)
    assert found.height == pytest.approx(np.ptp(place @ up), abs=1e-12)
    assert found.width == pytest.approx(np.ptp(place @ (up[1], -up[0])), abs=1e-12)
    assert found.box_width == box_width


MOVING = {
    "first end": [((0.0, -60.0), (0.0, 0.0)), ((0.0, 0.0), (0.0, 0.0))],
    "second end": [((0.0, 0.0), (0.0, 60.0)), ((0.0, 0.0), (0.0, 0.0))],
    "second segment": [((0.0, 0.0), (0.0, 0.0)), ((-36.0, 48.0), (1.0, 0.0))],
}


@pytest.mark.parametrize("name", MOVING)
def test_the_fastest_end_of_a_segment_counts(name):
    moving = scene(**BAR, segment_velocities=MOVING[name])
    found = scene_numbers(moving)
    assert found.fastest == pytest.approx(60.0)
    assert (found.still, found.moving) == (1, 1)
    assert parts_for(found, 0.01) > parts_for(scene_numbers(scene(**BAR)), 0.01)
    slow = scene(**BAR, segment_velocities=0.05 * np.array(MOVING[name]))
    assert scene_numbers(slow).fastest == pytest.approx(5.0)  # the circle's


@pytest.mark.parametrize("speeds", [(-7.0, 1.0), (0.0, 7.0)])
def test_a_surface_counts_where_it_drags(speeds):
    belts = scene(**BAR, surface_speeds=speeds, friction=0.5)
    found = scene_numbers(belts)
    assert (found.fastest, found.is_dragged, found.still, found.moving) == (7.0, True, 2, 0)
    smooth = belts.replace(world=replace(belts.world, friction=0.0))
    assert scene_numbers(smooth).fastest == pytest.approx(5.0)
    assert not scene_numbers(scene(**BAR)).is_dragged


@pytest.mark.parametrize("at", [0, 2])
def test_a_fixed_circle_is_counted_and_may_be_the_fastest_and_is_in_no_other_number(at):
    plain = scene(friction=0.3)
    order = np.insert(np.arange(3), at, 3)
    both = plain.with_bodies(add=dc.make_bodies([[15.0, 25.0]], radius=2.5, velocity=[6.0, -8.0], fixed=True))
    both = both.replace(bodies=dc.Bodies(*(values[order] for values in both.bodies)), contacts=None)
    found, alone = scene_numbers(both), scene_numbers(plain)
    changed = {name for name in found._fields if getattr(found, name) != getattr(alone, name)}
    assert changed == {"count", "radius", "fastest"}
    assert (found.count, found.radius, found.fastest) == (4, pytest.approx(1.5), pytest.approx(10.0))
    pegs = dc.make_bodies([[15.0, 25.0], [3.0, 20.0]], fixed=True)
    assert scene_numbers(plain.with_bodies(add=pegs)).fastest == pytest.approx(5.0)


def test_tables_give_the_range_of_the_pairs_that_can_form():
    table = np.array([[0.2, 0.3, 0.9], [0.3, 0.7, 0.8], [0.9, 0.8, 0.1]])
    found = scene_numbers(scene(friction=table, restitution=0.5 * table, material=[0, 0, 1]))
    assert (found.friction, found.most_friction) == (0.2, 0.7)
    assert (found.restitution, found.most_restitution) == (0.1, 0.35)
    walls = scene_numbers(scene(friction=table, rolling_friction=table, wall_materials=[2, 0, 0, 0]))
    assert (walls.friction, walls.most_friction, walls.rolling) == (0.2, 0.9, 0.9)


def test_no_circles_have_numbers():
    empty = scene_numbers(dc.State(name="empty", world=dc.World(), bodies=dc.make_bodies(np.zeros((0, 2)))))
    assert (empty.count, empty.radius, empty.radius_ratio, empty.mass_ratio, empty.density_ratio) == (
        0,
        1.0,
        1.0,
        1.0,
        1.0,
    )
    assert (empty.layers, empty.fastest, empty.squares, empty.height, empty.width) == (0.0,) * 5


@pytest.mark.parametrize(
    ("segments", "opening"),
    [
        ([], 0.0),
        ([((0, 3), (20, 9))], 0.0),
        ([((20, 1), (12, 5)), ((12, 5), (0, 3))], 0.0),  # in any order
        ([((0, 3), (20, 9)), ((6, 1), (9, 1))], 0.0),  # below the line
        ([((0, 9), (7, 5)), ((11, 5), (20, 9))], 4.0),
        ([((3, 5), (18, 5))], 3.0),  # at the left wall
        ([((0, 5), (18, 5)), ((18, 5), (18, 9))], 2.0),  # at the right wall, behind an upright segment
        ([((0, 9), (12, 7)), ((8, 2), (20, 4))], 7.0 - (2.0 + 2.0 / 3.0)),  # a chute: between two that overlap
        ([((0, 9), (8, 9)), ((11, 5), (20, 5))], 5.0),  # 3 across and 4 down
        ([((0, 5), (7, 5)), ((20, 1), (20, 8))], 13.0),  # to an upright segment
        ([((0, 5), (14, 5)), ((20, 13), (20, 18))], 10.0),  # 6 across and 8 up, to its lower end
    ],
)
def test_the_opening_is_the_widest_gap_in_the_ground(segments, opening):
    assert scene_numbers(scene(segments=segments)).opening == pytest.approx(opening, abs=1e-12)
    assert scene_numbers(scene(segments=segments, gravity=(0.0, 0.0))).opening == 0.0
    aside = [((y, x), (v, u)) for (x, y), (u, v) in segments]
    turned = scene(segments=aside, gravity=(9.81, 0.0), box=(0.0, 0.0, 30.0, 20.0))
    assert scene_numbers(turned).opening == pytest.approx(opening, abs=1e-12)


def test_what_moves_is_no_ground():
    line, up, still = [((0, 5), (12, 5)), ((12, 5), (20, 5))], ((0, 1), (0, 1)), ((0, 0), (0, 0))
    assert scene_numbers(scene(segments=line, segment_velocities=[still, up])).opening == pytest.approx(8.0)
    assert scene_numbers(scene(segments=line, segment_velocities=[up, up])).opening == 0.0
