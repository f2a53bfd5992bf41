"""`deep_contact.cnn.images`: the channels, the two transfers, the scale and the symmetries."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.cnn.dataset import read_simulation, write_simulation
from deep_contact.cnn.images import (
    CHANNELS,
    SOLVER_CHANNELS,
    THESIS_CHANNELS,
    ImageSpec,
    augment,
    image_pair,
    input_image,
    label_image,
    read_back,
    state_scale,
    symmetries,
    transform_state,
)
from deep_contact.physics import metrics
from deep_contact.simulation import ready
from deep_contact.state import World, make_bodies

ALL = ImageSpec(channels=tuple(CHANNELS), transfer="consistent", scale_free=True)
FLOAT32 = 2.0**-23


@pytest.fixture(scope="module")
def states():
    """Solved states of a pile that falls, settles and nearly rests, radii 0.6 to 1, each wall touched."""
    scene = dc.circles_in_box(30, size=12, radius=(0.6, 1.0), seed=5)
    rng = np.random.default_rng(1)
    scene = scene.replace(bodies=scene.bodies._replace(spin=rng.normal(size=30), velocity=rng.normal(0, 4, (30, 2))))
    kept = []
    dc.simulate(scene, steps=150, solver=dc.PGS(sweeps=300), on_step=lambda state, record: kept.append(state))
    return kept[20:150:16]


def one_contact(position, impulse=(3.0, -1.0), **world):
    """Two circles one above the other whose contact point is at `position`, solved with that impulse."""
    x, y = position
    centres = [[x, y - 0.998], [x, y + 0.998]]
    state = ready(dc.State(name="pair", world=World(**world), bodies=make_bodies(centres)))
    assert state.contacts.count == 1
    n, t = (np.array([v]) for v in impulse)
    return state.replace(contacts=state.contacts._replace(normal_impulse=n, tangent_impulse=t), solved=True)


# ---- the spec ----


def test_a_spec_survives_json_to_the_last_bit():
    spec = ALL.replace(spacing=0.1 + 0.2, scales=np.linspace(0.1, 3, len(CHANNELS)) ** 3, target_scales=(1 / 3, 7))
    assert ImageSpec.from_dict(json.loads(json.dumps(spec.to_dict()))) == spec


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("spacing", 0),
        ("support", float("nan")),
        ("kernel", "cubic"),
        ("normalization", "consistent"),
        ("transfer", "raw"),
        ("channels", ("mass", "speed")),
        ("channels", ("mass", "mass")),
        ("channels", ()),
        ("targets", ("mass",)),
        ("scales", (1.0,)),
        ("target_scales", (1.0, -1.0)),
        ("scale_free", "yes"),
    ],
)
def test_a_bad_field_is_named(field, value):
    with pytest.raises(ValueError, match=field):
        ImageSpec(**{field: value})


def test_unknown_and_missing_fields_are_refused():
    with pytest.raises(ValueError, match="colour"):
        ImageSpec.from_dict(ImageSpec().to_dict() | {"colour": 1})
    with pytest.raises(ValueError, match="scale_free"):
        ImageSpec.from_dict({k: v for k, v in ImageSpec().to_dict().items() if k != "scale_free"})


def test_the_default_is_the_thesis_network_s_input():
    """61 x 61 x 5 in the order of its training: section 5.2.3 of the thesis, and n_x."""
    state = one_contact((15, 15))
    assert ImageSpec().channels == ("mass", "velocity_x", "velocity_y", "spin", "normal_x") == THESIS_CHANNELS
    assert input_image(state, ImageSpec()).shape == (61, 61, 5)
    assert label_image(state, ImageSpec()).shape == (61, 61, 2)
    assert input_image(state, ImageSpec()).dtype == label_image(state, ImageSpec()).dtype == np.float32


# ---- channels ----


def test_a_channel_sums_to_what_the_bodies_carry(states):
    """Appendix A: the weights of a particle sum to one."""
    bodies = states[-1].bodies
    sums = input_image(states[-1], ImageSpec()).astype(float).sum(axis=(0, 1))
    carried = [bodies.mass, *bodies.velocity.T, bodies.spin, states[-1].contacts.normal[:, 0]]
    for name, total, values in zip(THESIS_CHANNELS, sums, carried):
        assert total == pytest.approx(values.sum(), abs=4 * FLOAT32 * np.abs(values).sum()), name


def test_row_zero_is_the_floor_and_columns_go_right():
    image = input_image(one_contact((10, 7)), ImageSpec(channels=("contact_density",)))
    assert np.argwhere(image[:, :, 0] == 1).tolist() == [[14, 20]]  # y = 7, x = 10 at d = 0.5


def test_approach_and_slip_are_the_velocities_of_the_surfaces(states):
    """Witness: v + ω x (p - c) of both bodies at the contact point, with vectors, after Δt of gravity."""
    state = states[3]
    c, n = state.contacts, state.bodies.count
    padded = [np.concatenate([f, np.zeros((4, 2))]) for f in (state.bodies.position, state.bodies.velocity)]
    centre, velocity = padded[0], padded[1]
    velocity[:n] += state.dt * np.array(state.world.gravity)
    spin = np.append(state.bodies.spin, np.zeros(4))

    def surface(body):
        arm = c.position - centre[body]
        return velocity[body] + spin[body, None] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)

    relative = surface(c.body_b) - surface(c.body_a)
    tangent = np.stack([c.normal[:, 1], -c.normal[:, 0]], axis=1)
    view = type("View", (), {"rows": _rows(state)})
    for name, direction in (("approach", c.normal), ("slip", tangent)):
        expected = np.einsum("ij,ij->i", relative, direction)
        np.testing.assert_allclose(CHANNELS[name].value(view), expected, atol=1e-12)  # velocities up to 20


def _rows(state):
    from deep_contact.cnn.images import View

    return View(state).rows


def test_approach_holds_what_restitution_asks_for():
    """Row of b: v_n - (-e v_n) = (1 + e) v_n, above the threshold of 1 m/s."""
    state = dc.single_body(gravity=(0, 0), restitution=0.5)
    state = ready(state.replace(bodies=state.bodies._replace(velocity=np.array([[0.0, -3.0]]))))
    assert _rows(state)[0, 0] == pytest.approx(-4.5, abs=1e-14)


def test_effective_mass_of_two_discs_is_half_their_mass():
    image = input_image(one_contact((10, 7)), ImageSpec(channels=("effective_mass",)))
    assert image[14, 20, 0] == pytest.approx(np.pi / 2, rel=FLOAT32)


def test_the_solver_s_channels_do_not_depend_on_the_numbers_of_the_bodies(states):
    """The sign of n turns over with them; nothing the solver does may see it."""
    state = states[4]
    flipped = state.replace(bodies=type(state.bodies)(*(field[::-1].copy() for field in state.bodies)), contacts=None)
    flipped = ready(flipped)
    spec = ImageSpec(channels=SOLVER_CHANNELS[:-2])
    np.testing.assert_allclose(input_image(state, spec), input_image(flipped, spec), atol=2e-5)
    assert np.abs(input_image(state, ImageSpec())[..., 4] - input_image(flipped, ImageSpec())[..., 4]).max() > 0.1


def test_a_state_without_contacts_has_empty_contact_channels():
    state = ready(dc.single_body(height=5.0)).replace(solved=True)
    image, label, s = image_pair(state, ALL)
    assert image[..., 0].sum() == pytest.approx(np.pi)
    assert not image[..., 4:].any()
    assert not label.any()
    assert s == 1.0
    assert [values.shape for values in read_back(label, state, ALL)] == [(0,), (0,)]


def test_a_body_pushed_out_of_the_box_acts_from_its_edge():
    state = ready(dc.State(name="out", world=World(), bodies=make_bodies([[-0.2, 15.0]])))
    assert input_image(state, ImageSpec())[30, 0, 0] == pytest.approx(np.pi)


# ---- transfers ----


def test_thesis_transfer_returns_a_quarter_from_the_centre_of_a_cell():
    """Four equal weights that sum to one (Appendix A), read back with four of a quarter (Eq 3.16)."""
    state = one_contact((15.25, 15.25))
    normal, tangent = read_back(label_image(state, ImageSpec()), state, ImageSpec())
    np.testing.assert_allclose([normal[0], tangent[0]], [0.75, -0.25], rtol=4 * FLOAT32)


@pytest.mark.parametrize("support", [0.5, 1.2, 0.1])
def test_consistent_transfer_returns_a_lone_contact_wherever_it_lies(support):
    """λ Σ b w / Σ b w = λ; with h = 0.1 the contact is within reach of no node and goes to the nearest."""
    spec = ImageSpec(transfer="consistent", support=support, scale_free=True, target_scales=(3.0, 0.7))
    state = one_contact((15.21, 7.37))
    normal, tangent = read_back(label_image(state, spec), state, spec)
    np.testing.assert_allclose([normal[0], tangent[0]], [3.0, -1.0], rtol=8 * FLOAT32)


def test_scales_divide_the_inputs_and_are_undone_on_the_way_out(states):
    plain = ImageSpec(transfer="consistent")
    scaled = plain.replace(scales=(2, 4, 8, 0.5, 1), target_scales=(0.25, 16))
    ratio = input_image(states[5], scaled) * np.array([2, 4, 8, 0.5, 1], np.float32)
    np.testing.assert_array_equal(ratio, input_image(states[5], plain))
    for a, b in zip(*(read_back(label_image(states[5], spec), states[5], spec) for spec in (plain, scaled))):
        np.testing.assert_array_equal(a, b)  # powers of two


def test_targets_come_back_in_their_order():
    spec = ImageSpec(transfer="consistent", targets=("tangent_impulse",))
    state = one_contact((15, 15))
    (tangent,) = read_back(label_image(state, spec), state, spec)
    assert tangent[0] == -1.0


# ---- scale ----


def scaled_by(state, factor):
    """Everything that has a velocity in its unit, times a factor."""
    bodies, c, world = state.bodies, state.contacts, state.world
    impulses = {name: factor * getattr(c, name) for name in c._fields[5:]}
    bodies = bodies._replace(velocity=factor * bodies.velocity, spin=factor * bodies.spin)
    world = World(box=world.box, gravity=tuple(factor * g for g in world.gravity), friction=world.friction)
    return state.replace(bodies=bodies, world=world, contacts=c._replace(**impulses))


def test_scale_free_images_do_not_see_the_scale(states):
    """The contact problem is positively homogeneous. By a power of two, to the last bit."""
    state, larger = states[4], scaled_by(states[4], 8.0)
    (image, label, s), (image_8, label_8, s_8) = image_pair(state, ALL), image_pair(larger, ALL)
    np.testing.assert_array_equal(image, image_8)
    np.testing.assert_array_equal(label, label_8)
    assert s_8 == 8 * s != 8
    np.testing.assert_array_equal(8 * read_back(label, state, ALL)[0], read_back(label_8, larger, ALL)[0])


def test_homogeneity_is_the_engine_s_own(states):
    """Solving the state eight times as fast gives eight times the impulses: the premise of the test above."""
    solver = dc.PGS(sweeps=20, tolerance=None)
    slow, fast = (dc.solve_contacts(s, solver=solver) for s in (states[4], scaled_by(states[4], 8.0)))
    np.testing.assert_array_equal(8 * slow.normal_impulses, fast.normal_impulses)


def test_scale_of_a_resting_circle():
    """Right-hand sides (g Δt, 0) and the carried m g Δt over the effective mass m: s² = ((gΔt)² + (gΔt)²) / 2."""
    state = ready(dc.single_body())
    carried = np.array([np.pi * 9.81 * 0.01])
    state = state.replace(contacts=state.contacts._replace(normal_start=carried))
    assert state_scale(state) == pytest.approx(0.0981, rel=1e-12)


# ---- roads ----


def test_images_are_the_same_from_memory_from_xml_and_from_hdf5(states, tmp_path):
    """The same image on every road, to the last bit."""
    write_simulation(tmp_path / "sim.h5", states)
    stored = read_simulation(tmp_path / "sim.h5")
    for i, state in enumerate(states):
        dc.write_state(tmp_path / "state.xml.gz", state)
        for spec in (ALL, ImageSpec()):
            image, label, s = image_pair(state, spec)
            assert image.any()
            for road in (dc.read_state(tmp_path / "state.xml.gz"), stored.state(i)):
                other_image, other_label, other_s = image_pair(road, spec)
                assert image.tobytes() == other_image.tobytes()
                assert label.tobytes() == other_label.tobytes()
                assert s == other_s


# ---- symmetries ----


@pytest.mark.parametrize("k", range(8))
def test_turning_the_images_is_splatting_the_turned_state(states, k):
    """Eight-fold augmentation is exact, up to the rounding of positions (1e-15) and of float32."""
    spec = ALL.replace(scales=np.linspace(0.3, 2, len(CHANNELS)), target_scales=(0.5, 3.0))
    for state in states[::2]:
        turned = transform_state(state, k)
        for ours, theirs in zip(augment(*image_pair(state, spec)[:2], spec, k), image_pair(turned, spec)):
            np.testing.assert_allclose(ours, theirs, rtol=4 * FLOAT32, atol=1e-9)


@pytest.mark.parametrize("k", range(8))
def test_the_turned_state_is_solved_by_the_turned_solution(states, k):
    """The engine's own word on `transform_state`: velocities after the solve turn along. Witness: hand-made matrix."""
    state = states[2]
    mirror, turn = np.diag([-1.0, 1.0]), np.array([[0.0, -1.0], [1.0, 0.0]])
    m = np.linalg.matrix_power(turn, k % 4) @ (mirror if k >= 4 else np.eye(2))
    solver = dc.PGS(sweeps=20_000, tolerance=1e-11)
    here, there = (dc.solve_contacts(s, solver=solver) for s in (state, transform_state(state, k)))
    assert here.record.status == there.record.status == "converged"
    np.testing.assert_allclose(there.velocities, here.velocities @ m.T, atol=1e-8)  # θ to 1e-11, a thousand sweeps
    np.testing.assert_allclose(there.angular_velocities, np.linalg.det(m) * here.angular_velocities, atol=1e-8)


@pytest.mark.parametrize("k", range(8))
def test_contacts_of_the_turned_state_are_those_found_there(states, k):
    """Walls are renumbered, n, t and the contact points turned: as collision detection has it."""
    turned = transform_state(states[2], k)
    found = ready(turned.replace(contacts=None)).contacts
    assert found.body_a.tolist() == turned.contacts.body_a.tolist()
    assert found.body_b.tolist() == turned.contacts.body_b.tolist()
    for name in ("position", "normal", "separation"):
        np.testing.assert_allclose(getattr(turned.contacts, name), getattr(found, name), atol=1e-13)


def test_four_quarter_turns_and_two_mirrors_are_none(states):
    image, label, _ = image_pair(states[3], ALL)
    for k, times in ((1, 4), (2, 2), (4, 2), (5, 2)):
        turned = image, label
        for _ in range(times):
            turned = augment(*turned, ALL, k)
        assert turned[0].tobytes() == image.tobytes()
        assert turned[1].tobytes() == label.tobytes()


def test_a_batch_turns_as_its_images_do(states):
    pairs = [image_pair(state, ALL)[:2] for state in states[:3]]
    batch = augment(np.stack([a for a, _ in pairs]), np.stack([b for _, b in pairs]), ALL, 7)
    for i, pair in enumerate(pairs):
        np.testing.assert_array_equal(batch[0][i], augment(*pair, ALL, 7)[0])


def test_only_exact_symmetries_are_offered():
    square, oblong = World(), World(box=(0, 0, 20, 10))
    assert symmetries(ALL, square) == tuple(range(8))
    assert symmetries(ImageSpec(), square) == (0, 2, 4, 6)  # normal_x without normal_y
    assert symmetries(ALL, oblong) == (0, 2, 4, 6)
    assert symmetries(ALL.replace(spacing=0.7), square) == (0,)


def test_a_turn_that_the_channels_cannot_follow_is_refused():
    image, label, _ = image_pair(one_contact((15, 15)), ImageSpec())
    with pytest.raises(ValueError, match="normal_x"):
        augment(image, label, ImageSpec(), 1)
    with pytest.raises(ValueError, match="square"):
        augment(image[:-1], label[:-1], ImageSpec(channels=THESIS_CHANNELS[:4]), 1)
    with pytest.raises(ValueError, match="k: expected an integer <= 7, got 8"):
        augment(image, label, ImageSpec(), 8)


# ---- refusals ----


def test_states_and_images_that_do_not_fit_are_refused(states):
    with pytest.raises(ValueError, match="contacts"):
        input_image(dc.single_body(), ImageSpec())
    with pytest.raises(ValueError, match="solved"):
        label_image(ready(dc.single_body()), ImageSpec())
    with pytest.raises(ValueError, match=r"\(25, 25, 2\)"):
        read_back(np.zeros((25, 25, 1)), states[0], ImageSpec())
    with pytest.raises(ValueError, match="finite"):
        read_back(np.full((25, 25, 2), np.nan), states[-1], ImageSpec())


def test_neither_images_nor_data_load_tensorflow():
    """TensorFlow is imported only where a network is."""
    code = (
        "import sys, deep_contact.cnn.images, deep_contact.cnn.dataset, deep_contact.cnn as c; c.ImageSpec(); c.Store;"
        "sys.exit(sorted({'tensorflow', 'keras'} & set(sys.modules)) != [])"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_a_state_in_the_other_byte_order_gives_the_same_images_and_impulses(states):
    def swapped(part):
        return type(part)(*(array.astype(array.dtype.newbyteorder(">")) for array in part))

    state, spec = states[3], ALL
    foreign = state.replace(bodies=swapped(state.bodies), contacts=swapped(state.contacts))
    for one, other in zip(image_pair(foreign, spec), image_pair(state, spec)):
        np.testing.assert_array_equal(one, other)
    image = label_image(state, spec)
    np.testing.assert_array_equal(read_back(image.astype(">f4"), foreign, spec), read_back(image, state, spec))
    assert metrics.penetration(foreign) == metrics.penetration(state)
