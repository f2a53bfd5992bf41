"""Haff's law: a gas with e = 0.9 between elastic walls, by events (`tests/tools/cooling_gas.py`) and by steps."""

import math

import numba
import numpy as np
import pytest
from conftest import load_script

import deep_contact as dc

gas = load_script("cooling_gas")


@pytest.mark.skipif(not numba.config.DISABLE_JIT, reason="test_without_compiler.py runs it interpreted")
def test_the_witness_finds_collisions_at_their_times_and_keeps_energy_and_distances():
    """Two discs that meet after 1.5 s with e = 1/2; and 16 discs with e = 1."""
    times = np.array([0.0, 1.499, 1.501, 2.0])
    position, velocity = np.array([[2.0, 4.0], [6.0, 4.0]]), np.array([[1.0, 0.0], [-1.0, 0.0]])
    heat, hits = gas.cool_by_events(position, velocity, 8.0, 0.5, 0.5, times)
    np.testing.assert_allclose(heat, [0.5, 0.5, 0.125, 0.125], rtol=1e-12)
    assert hits.tolist() == [0, 0, 1, 1]
    position, velocity = gas.gas(16, 8.0, 0)
    before = 0.5 * (velocity**2).sum() / 16
    heat, hits = gas.cool_by_events(position, velocity, 8.0, 0.5, 1.0, np.linspace(0.0, 3.0, 5))
    np.testing.assert_allclose(heat, before, rtol=1e-12)
    assert hits[-1] > 10


def test_pairs_in_a_box_are_those_of_random_places():
    """Monte Carlo: second centres at distance d in a random direction, over the density without walls."""
    rng, side = np.random.default_rng(1), 6.0
    places = rng.uniform(0.5, side - 0.5, (200_000, 2))
    angle = rng.uniform(0.0, 2.0 * math.pi, len(places))
    second = places + np.column_stack([np.cos(angle), np.sin(angle)])
    inside = ((second > 0.5) & (second < side - 0.5)).all(axis=1).mean()
    assert gas.pairs_in_box(side) == pytest.approx(inside * (side / (side - 1.0)) ** 2, rel=0.005)


@pytest.mark.slow
def test_a_gas_cools_as_by_events_and_as_haffs_law_with_its_corrections():
    """The rate of the engine falls short of that of events in proportion to Δt, since it finds a collision late."""
    times, side, count, e, seeds = np.linspace(0.0, 80.0, 41), 128.0, 1024, 0.9, 8
    ratios, of_events = {0.02: [], 0.005: []}, []
    for seed in range(seeds):
        position, velocity = gas.gas(count, side, seed)
        law = gas.theory(count, side, e, 0.5 * (velocity**2).sum() / count)
        heat, _ = gas.cool_by_events(position.copy(), velocity.copy(), side, 0.5, e, times)
        rate = gas.rate_of(times, heat)
        of_events.append(rate / (law["plain"] * law["cumulant"] * law["walls"]))
        for dt, found in ratios.items():
            solver = dc.PGS(sweeps=4, tolerance=None)
            found.append(gas.rate_of(times, gas.cool_by_steps(position, velocity, side, e, dt, times, solver)) / rate)
    assert np.mean(of_events) == pytest.approx(1.0, abs=0.01)
    assert np.mean(ratios[0.005]) == pytest.approx(1.0, abs=0.01)
    assert np.mean(ratios[0.02]) < np.mean(ratios[0.005])
