"""Static segments against edge shapes of the real Box2D 2.3: contacts, impulses, and runs without chaos."""

import numpy as np
import pytest
from box2d_recorder import RecordingBox2D, solved_in_order
from conftest import circles_at

import deep_contact as dc
from deep_contact.stepping.problem import contacts_of

pytest.importorskip("Box2D")
pytestmark = pytest.mark.peers

# No two share an end: Box2D feels the joints of edges.
SEGMENTS = [((2, 24), (13, 14)), ((28, 24), (17, 14.5)), ((8, 9), (22, 6)), ((3, 3), (9, 5)), ((15, 2), (15, 3))]
WORLD = {"box": (0, 0, 30, 40), "scales": dc.BOX2D, "segments": SEGMENTS}


def test_contacts_and_impulses_equal_box2d():
    # As in test_box2d_oracle: same start, same order, same sweeps; velocities round to float32. Whether there is a
    # contact may differ only where the circle just touches.
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(4.0 + 2.2 * np.arange(11), 25.6 + 2.2 * np.arange(5))
    position = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.05, 0.05, (55, 2))
    scene = circles_at(position, radius=rng.uniform(0.6, 1.0, 55), friction=0.3, **WORLD)
    peer, on_segments, on_ends = RecordingBox2D(scene), 0, 0
    for step in range(500):
        if step % 10:
            peer.step(scene.dt, 60, 10)
            continue
        recorded = peer.record_step(scene.dt, 60, 10)
        state = recorded.state
        if state.contacts.count == 0:
            continue
        found, theirs = contacts_of(state), state.contacts
        pairs, other = ({pair: i for i, pair in enumerate(zip(c.body_a, c.body_b))} for c in (found, theirs))
        for pair in pairs.keys() ^ other.keys():
            gap = found.separation[pairs[pair]] if pair in pairs else theirs.separation[other[pair]]
            assert abs(gap) < 1e-4
        mine, their = np.array([(pairs[pair], other[pair]) for pair in pairs.keys() & other.keys()]).T
        np.testing.assert_allclose(found.normal[mine], theirs.normal[their], atol=2e-4)
        np.testing.assert_allclose(found.position[mine], theirs.position[their], atol=1e-4)
        contacts, ours = solved_in_order(recorded, sweeps=60)
        momentum = state.bodies.mass * np.hypot(*state.bodies.velocity.T)
        largest = max(contacts.normal_impulse.max(), momentum.max())
        np.testing.assert_allclose(ours.normal_impulses, contacts.normal_impulse, atol=3e-5 * largest)
        np.testing.assert_allclose(ours.tangent_impulses, contacts.tangent_impulse, atol=3e-5 * largest)
        segment = contacts.body_b - 59
        on_segments += (segment >= 0).sum()
        for k in np.flatnonzero(segment >= 0):
            along = np.subtract(*SEGMENTS[segment[k]])
            on_ends += abs(contacts.normal[k] @ along) > 1e-3 * np.hypot(*along)
    assert on_segments > 300
    assert on_ends > 20


@pytest.mark.parametrize(
    ("position", "velocity"),
    [
        ((4.0, 25.0), (0.0, 0.0)),  # rolls down a slope, off its end, onto the next
        ((8.6, 20.5), (2.0, -3.0)),
        ((15.3, 6.0), (0.0, 0.0)),  # falls beside the tip of a needle
        ((8.0, 12.0), (1.0, 0.0)),
        ((6.0, 8.0), (0.5, -2.0)),
    ],
)
def test_one_circle_moves_as_in_box2d(position, velocity):
    scene = circles_at([position], velocity=velocity, friction=0.2, **WORLD)
    solver = dc.PGS(sweeps=30, tolerance=None, position_sweeps=10)
    ours = dc.simulate(scene, steps=250, solver=solver, record=1).trajectory
    peer, theirs = RecordingBox2D(scene), []
    for _ in range(250):
        peer.step(scene.dt, 30, 10)
        theirs.append(peer.bodies().position[0])
    assert (ours.pairs[:, 1] >= 5).any()
    np.testing.assert_allclose(ours.positions[1:, 0], theirs, atol=0.01)
