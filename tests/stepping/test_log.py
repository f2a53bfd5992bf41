"""What a watched step tells of its contacts."""

import numpy as np
import pytest

from deep_contact.stepping.contacts import make_contacts, some_contacts
from deep_contact.stepping.log import MOST_BODIES, write_step


@pytest.mark.parametrize("impulse", [(3.0, 1.0), (-0.2, 3.0), (-0.2, -3.0), (-1.0, 0.0), (0.0, 0.0), (0.0, -2.0)])
@pytest.mark.parametrize("angle", [0.0, 1.0, 2.5, -1.2])
def test_the_impulses_of_a_step_are_their_sum_also_if_it_pulls_along_the_first_normal(angle, impulse):
    """λ_n n + λ_t t = P, with λ_n ≥ 0, |n| = 1, and n as near to the first normal as that leaves it."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    first, total = turn @ [1.0, 0.0], turn @ impulse
    row = np.array([[2 * MOST_BODIES + 5, 1.0, 2.0, *first, -0.01, *total]])
    no_circles = np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0)
    pairs, numbers = np.zeros(2, np.int64), np.zeros(9)
    write_step(no_circles, some_contacts(make_contacts(4), 0, 0), row, pairs, numbers)
    assert (pairs.tolist(), numbers[4], numbers[:2].tolist()) == ([2, 5], -0.01, [1.0, 2.0])
    n, (p_n, p_t, *starts) = numbers[2:4], numbers[5:]
    assert starts == [0.0, 0.0]
    np.testing.assert_allclose(p_n * n + p_t * np.array([n[1], -n[0]]), total, atol=1e-14)
    assert p_n >= 0.0
    assert np.hypot(*n) == pytest.approx(1.0)
    size = np.hypot(*impulse)
    nearest = 1.0 if impulse[0] >= 0.0 else abs(impulse[1]) / size
    assert n @ first == pytest.approx(nearest, abs=1e-14)
