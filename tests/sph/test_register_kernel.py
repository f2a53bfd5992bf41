"""`sph.register_kernel`: a kernel of one's own in all that takes a kernel, compiled or not."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import deep_contact as dc
from deep_contact import sph
from deep_contact.sph import kernels
from deep_contact.sph.neighbours import splat_by_tree

GRID = sph.Grid.over_box((0, 0, 6, 4), 0.5)
POSITION = np.random.default_rng(1).uniform((0, 0), (6, 4), (9, 2))


def wendland_c4(q, dim):
    """Wendland 1995."""
    c = 9.0 / math.pi if dim == 2 else 495.0 / (32.0 * math.pi)
    p = 1.0 - q
    return (
        c * p**6 * (1.0 + 6.0 * q + 35.0 / 3.0 * q**2),
        -56.0 / 3.0 * c * q * (1.0 + 5.0 * q) * p**5,
        56.0 / 3.0 * c * p**4 * (35.0 * q**2 - 4.0 * q - 1.0),
    )


@pytest.fixture(scope="module")
def registered():
    """Registered, and compiled into a transfer, once."""
    sph.register_kernel(wendland_c4)
    yield "wendland_c4"
    sph.KERNELS.remove("wendland_c4")
    del kernels._registered["wendland_c4"]


def test_a_registered_kernel_is_evaluated_and_transfers(registered):
    assert sph.value(registered, 2.0, 2.0) == 0
    for dim in (2, 3):
        w, first, second = wendland_c4(0.25, dim)
        assert sph.value(registered, 0.5, 2.0, dim) == pytest.approx(w / 2**dim, rel=1e-15)
        laplacian = (second + (dim - 1) * first / 0.25) / 2 ** (dim + 2)
        assert sph.laplacian(registered, 0.5, 2.0, dim) == pytest.approx(laplacian, rel=1e-14)
    values = np.arange(9.0)
    for normalization in ("raw", "particle"):
        options = {"h": 1.1, "kernel": registered, "normalization": normalization}
        expected = splat_by_tree(GRID, POSITION, values[:, None], **options)[:, :, 0]
        np.testing.assert_allclose(sph.splat(GRID, POSITION, values, **options), expected, rtol=1e-12, atol=1e-15)
    options = {"h": 1.1, "kernel": registered, "normalization": "consistent"}
    image = sph.splat(GRID, POSITION, np.full(9, 3.0), **options)
    np.testing.assert_allclose(sph.gather(GRID, image, POSITION, **options), 3.0, rtol=1e-14)
    np.testing.assert_allclose(sph.gather(GRID, image, POSITION, method="sph", **options), 3.0, rtol=1e-14)


def test_a_registered_kernel_starts_the_solver(registered):
    state = dc.simulate(dc.column(3), steps=3, solver=dc.PGS()).state
    found = dc.step(state, warm_start=dc.warm_start.Sph(kernel=registered)).bodies.velocity
    np.testing.assert_allclose(found, dc.step(state).bodies.velocity, atol=1e-3)  # both solve to the same tolerance


def test_what_is_no_kernel_is_refused():
    def poly6(q, dim):
        return 1.0, 0.0, 0.0

    def broken(q, dim):
        return math.nan, 0.0, 0.0

    def short(q, dim):
        return 1.0, 0.0

    with pytest.raises(ValueError, match=r"kernel: expected a name other than poly6, .*got 'poly6'"):
        sph.register_kernel(poly6)
    for function in (broken, short):
        with pytest.raises(ValueError, match=rf"kernel: expected {function.__name__}\(q, 2\) to return W > 0"):
            sph.register_kernel(function)
    assert "broken" not in sph.KERNELS


def transferred():
    """What every kernel gives, by its name: a transfer there and back, its value and its Laplacian."""
    found = {}
    for kernel in sph.KERNELS:
        options = {"h": 1.1, "kernel": kernel, "normalization": "consistent"}
        image = sph.splat(GRID, POSITION, np.arange(9.0), **options)
        back = sph.gather(GRID, image, POSITION, **options)
        mean = sph.gather(GRID, image, POSITION, method="sph", **options)
        of_kernel = [sph.value(kernel, 0.5, 2.0), sph.laplacian(kernel, 0.5, 2.0, 3)]
        found[kernel] = [*image.ravel().tolist(), *back.tolist(), *mean.tolist(), *of_kernel]
    return found


def test_uncompiled_functions_compute_the_same(registered):
    """With NUMBA_DISABLE_JIT=1, as debuggers and coverage need it; fused operations may differ in the last bits."""
    code = f"import json, sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import test_register_kernel as t; "
    code += "t.sph.register_kernel(t.wendland_c4); print(json.dumps(t.transferred()))"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    plain, compiled = json.loads(run.stdout), transferred()
    assert plain.keys() == compiled.keys() == {*sph.KERNELS}
    for kernel, numbers in compiled.items():
        np.testing.assert_allclose(plain[kernel], numbers, rtol=1e-12, err_msg=kernel)


def test_a_kernel_may_be_registered_again_and_those_that_there_are_stay(registered):
    before = sph.value("poly6", 0.3, 1.0)

    def twice(q, dim):
        w, first, second = 2.0, 0.0, 0.0
        return w, first, second

    twice.__name__ = registered
    assert sph.value(registered, 0.0, 1.0) == pytest.approx(9 / math.pi)
    assert sph.register_kernel(twice) is twice
    assert sph.value(registered, 0.0, 1.0) == 2.0
    assert sph.value("poly6", 0.3, 1.0) == before
