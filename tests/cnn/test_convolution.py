"""The far-field network in Numba against the same network in Keras, and its splat against `sph.splat`."""

import numpy as np
import pytest
from conftest import run_python

from deep_contact import sph
from deep_contact.cnn import architectures, far_field
from deep_contact.cnn.convolution import Program
from deep_contact.cnn.model_file import weights_of
from deep_contact.stepping.problem import step_problem


def network(width):
    """A far-field network none of whose weights is zero."""
    model = architectures.far_field(width=width)
    rng = np.random.default_rng(width)
    model.set_weights([rng.normal(0.0, 0.1, w.shape) for w in model.get_weights()])
    return model


def image(shape):
    return np.random.default_rng(1).normal(size=(*shape, 29)).astype(np.float32)


# Features: fewer than a vector has, one vector, and what takes both widths of vector at a time.
@pytest.mark.parametrize("width", [3, 8, 16, 24])
@pytest.mark.parametrize("shape", [(9, 9), (9, 17), (25, 33), (49, 9)])
def test_the_program_computes_what_keras_computes(width, shape):
    model, given = network(width), image(shape)
    expected = np.asarray(model(given[None], training=False))[0]
    found = Program(weights_of(model), shape)(given)
    # Sums of some thousand products in another order, in single precision.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * np.abs(expected).max())


PLAIN = """
import numpy as np
from deep_contact.cnn.convolution import Program, layer_shapes
rng = np.random.default_rng(1)
def normal(shape, scale):
    return rng.normal(0.0, scale, shape).astype(np.float32)
weights = {name: [normal(one, 0.1) for one in shapes] for name, shapes in layer_shapes(3).items()}
print(*Program(weights, (9, 9))(normal((9, 9, 29), 1.0)).ravel())
"""


def test_the_program_computes_the_same_without_the_compiler():
    outputs = [run_python("-c", PLAIN, environment={"NUMBA_DISABLE_JIT": off}).stdout for off in ("0", "1")]
    one, two = (np.array(output.split(), float) for output in outputs)
    np.testing.assert_allclose(one, two, rtol=0, atol=2e-5 * np.abs(one).max())  # single precision, other fusions


def test_a_second_image_finds_nothing_of_the_first():
    model, given = network(8), image((17, 9))
    program = Program(weights_of(model), (17, 9))
    first = program(given)
    program(100.0 * given[::-1])
    np.testing.assert_array_equal(program(given), first)


def test_a_network_of_other_layers_is_refused():
    weights = weights_of(network(8))
    weights["to_second"][0] = weights["to_second"][0][:2]
    with pytest.raises(ValueError, match="network: expected"):
        Program(weights, (9, 9))


@pytest.mark.parametrize("support", [0.4, 1.0, 1.7])
def test_the_image_is_the_splat_of_the_contacts_and_of_the_circles(support, falling_states):
    spec, state = far_field.FarFieldSpec(support=support), falling_states[3]
    found = far_field.description_of(state, spec)
    measured = far_field._measure(
        state.bodies, state.contacts, *step_problem(state)[:2], state.world.box, state.world.friction, False, 0
    )
    options = {"h": support * found.grid.spacing[0], "normalization": "particle", "unreached": "nearest"}
    first = len(far_field.CONTACT_CHANNELS)
    walls = state.contacts.body_b >= state.bodies.count
    expected = sph.splat(found.grid, found.point, np.column_stack([np.ones(len(walls)), walls]), **options)
    np.testing.assert_allclose(found.image[:, :, [0, first - 1]], expected, atol=1e-6)
    spin = np.arcsinh(measured.body_sizes[:, 5])
    low, high = np.reshape(found.grid.box, (2, 2))
    seen = ((measured.centre >= low) & (measured.centre <= high)).all(axis=1)
    expected = sph.splat(found.grid, measured.centre[seen], spin[seen], **options)
    np.testing.assert_allclose(found.image[:, :, -1], expected, atol=1e-6 * max(1.0, np.abs(expected).max()))
    # The tensors n ⊗ n and t ⊗ n, t = (n_y, −n_x): the difference of the diagonal, and the sum beside it.
    n_x, n_y = measured.normal.T
    one, difference, product = np.ones_like(n_x), n_x**2 - n_y**2, 2.0 * n_x * n_y
    normal, tangent = np.stack([one, difference, product]), np.stack([one, product, -difference])
    sizes, residual = np.arcsinh(measured.contact_sizes).T, measured.residual.T
    painted = {
        "approach": sizes[0] * normal, "slip": sizes[1] * tangent,
        "normal_residual": residual[0] * normal, "tangent_residual": residual[1] * tangent,
        "builtin_normal": sizes[2] * normal, "builtin_tangent": sizes[3] * tangent,
    }  # fmt: skip
    for name, values in painted.items():
        at = far_field.CONTACT_CHANNELS.index(f"{name}_1")
        expected = sph.splat(found.grid, found.point, values.T, **options)
        limit = 1e-5 * max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(found.image[:, :, at : at + 3], expected, atol=limit, err_msg=name)
