"""Piles of each kind, and the references of their states."""

import deep_contact as dc
from deep_contact.physics import metrics
from deep_contact.studies import piles


def test_references_solve_the_problem_and_differ():
    state = piles.states_of(piles.pile("settling", 150, 2), count=1)[0]
    ends = [dc.solve_contacts(state, solver=solver(sweeps=300)) for solver in (dc.PGS, dc.NNCG, dc.NesterovPGS)]
    assert max(metrics.residual(state, end) for end in ends) > 1e-6
    found = piles.references_from(state, ends, exact=True)
    assert 1 <= len(found) <= 3
    assert max(metrics.residual(state, solution) for solution in found) <= 1e-8
    assert len(piles.references_from(state, [found[0], found[0]], exact=True)) == 1


def test_ends_that_are_not_solved_are_no_references():
    state = piles.states_of(piles.pile("falling", 40, 2), count=1)[0]
    ends = [dc.solve_contacts(state, solver=dc.PGS(sweeps=k, tolerance=None)) for k in (1, 5000)]
    assert metrics.residual(state, ends[0]) > piles.ENOUGH
    found = piles.references_from(state, ends, exact=False)
    assert [solution is ends[1] for solution in found] == [True]
