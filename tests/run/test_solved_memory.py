"""Memory of watched steps: it is used again where nobody has an array of it any more, and never before."""

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.run.solved_memory import MOST_BLOCKS, SolvedMemory

RNG = np.random.default_rng(1)
CIRCLES = RNG.normal(size=(5, 2)), RNG.normal(size=(5, 2)), RNG.normal(size=5), RNG.normal(size=5)
NO_ROWS = np.zeros((0, 8))
HOLDS = {
    "an array": lambda moved, contacts: moved[3],
    "contacts": lambda moved, contacts: contacts,
    "a column": lambda moved, contacts: contacts.position[:, 1],
    "a part of a part": lambda moved, contacts: moved[0][1:, 0][::2].T,
    "other numbers": lambda moved, contacts: contacts.body_b.view(np.float64),
    "a buffer": lambda moved, contacts: memoryview(contacts.normal_start),
}
"""What a caller may keep of a step -> function of the arrays."""


@pytest.fixture(scope="module")
def contacts():
    """Those of a column."""
    return dc.simulate(dc.column(5), steps=120, solver=dc.PGS()).state.contacts


def copies(memory, contacts, shift=0.0):
    """Copies of the circles, shifted by a number, and of the contacts."""
    shifted = contacts._replace(normal_start=contacts.normal_start + shift)
    return memory.copy(tuple(array + shift for array in CIRCLES), shifted, NO_ROWS)


def test_copies_are_read_only_contiguous_and_the_arrays_that_they_are_of(contacts):
    moved, of_step = copies(SolvedMemory(), contacts)
    assert contacts.count > 3
    for copy, array in zip((*moved, *of_step), (*CIRCLES, *contacts)):
        np.testing.assert_array_equal(copy, array)
        assert (copy.dtype, copy.flags.c_contiguous, copy.flags.aligned) == (array.dtype, True, True)
        assert not np.shares_memory(copy, array)
        with pytest.raises(ValueError, match="read-only"):
            copy[:] = 0


def test_memory_that_nobody_has_is_used_again(contacts):
    memory = SolvedMemory()
    places = {copies(memory, contacts, shift)[0][0].ctypes.data for shift in range(10)}
    assert len(places) == 1


@pytest.mark.parametrize("name", HOLDS)
def test_what_somebody_has_stays_as_it_is(name, contacts):
    memory = SolvedMemory()
    kept = [HOLDS[name](*copies(memory, contacts, shift)) for shift in range(8)]
    for shift, mine in enumerate(kept):
        alone = HOLDS[name](*copies(SolvedMemory(), contacts, shift))
        for one, other in zip(mine, alone):
            np.testing.assert_array_equal(one, other)
    assert len(memory._blocks) == MOST_BLOCKS


def test_states_of_on_step_that_are_kept_are_those_that_are_not():
    """Every third state is kept; the others' memory is used again meanwhile."""
    scene, kept, heights = dc.lattice_in_box(30, seed=2), [], []

    def see(solved, record):
        heights.append((solved.bodies.position.sum(), solved.contacts.normal_impulse.sum(), solved.contacts.count))
        if solved.step % 3 == 0:
            kept.append(solved)

    for solver in (dc.PGS(sweeps=8), dc.PGS(sweeps=8, substeps=3)):
        kept.clear(), heights.clear()
        dc.simulate(scene, steps=60, solver=solver, on_step=see)
        assert max(count for *_, count in heights) > 20
        for solved, (place, impulse, count) in zip(kept, heights[::3]):
            c = solved.contacts
            assert (solved.bodies.position.sum(), c.normal_impulse.sum(), c.count) == (place, impulse, count)
