"""The study of runs: motions with known answers, which a good setting gets right."""

import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact.measure.settings import setting_of
from deep_contact.studies import known

study = load_script("run_tradeoff")


@pytest.mark.parametrize("number", range(8))
def test_a_good_setting_makes_every_known_motion(number):
    scene, seconds, wrong = list(study.motions())[number]
    setting = setting_of(dc.PGS(sweeps=20, tolerance=None), 0.0025)
    assert wrong(known.end(setting, scene, seconds).bodies) < 2e-3  # first order in Δt


@pytest.mark.slow  # a kind of step of its own
def test_over_relaxed_sweeps_that_are_few_are_found():
    good, bad = dc.PGS(sweeps=4, tolerance=None), dc.PSOR(omega=1.3, sweeps=2, tolerance=None)
    assert study.error(setting_of(good, 0.01)) < 1.0 < study.error(setting_of(bad, 0.01))
