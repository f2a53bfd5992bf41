"""The study of runs: motions with known answers, which a good setting gets right."""

import pytest
from conftest import load_script

import deep_contact as dc
from deep_contact.accuracy.presets import PRESETS
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


def study_row(sweeps, us, kind, **share):
    """A row of 100 circles whose errors are shares of the tolerances of "reference", 0.1 of those that have no name."""
    errors = {name: [share.get(name, 0.1) * most] * 3 for name, most in PRESETS["reference"].items()}
    setting = {"method": "PGS", "sweeps": sweeps, "dt": 0.01}
    return {"kind": kind, "n_bodies": 100, "setting": setting, "us": us, "errors": errors}


def test_tolerances_that_nobody_uses_are_made_smaller_at_no_price():
    """All settings have 0.5 of the forces; "a" could have 0.2 of the creep for ten times the price, "b" could not."""
    rows = [
        study_row(1, 1.0, "a", forces=0.5, creep=0.6), study_row(9, 10.0, "a", forces=0.5, creep=0.2),
        study_row(1, 1.0, "b", forces=0.5, creep=0.6), {"us": 0.1} | study_row(1, None, "b"),
    ]  # fmt: skip
    found = study.tighter(rows)
    before = PRESETS["reference"]
    # The errors, 0.5 of 10 and 0.6 of 1.5, are within 85 % of the proposals.
    assert (found["reference"]["forces"], found["reference"]["creep"]) == (6.0, 1.2)
    assert found["reference"]["energy"] == before["energy"]  # used, and not named
    for preset, tolerances in found.items():
        assert all(tolerances[name] <= most for name, most in PRESETS[preset].items())
    names = list(PRESETS)
    for tight, loose in zip(names[1:], names):
        assert all(found[tight][name] <= found[loose][name] for name in study.UNUSED)


def test_a_price_buys_smaller_tolerances():
    rows = [study_row(1, 1.0, "a", forces=0.5), study_row(9, 1.02, "a", forces=0.2)]
    free, dear = (study.tighter(rows, price=price, names=["forces"])["reference"]["forces"] for price in (1.0, 1.03))
    assert (free, dear) == (6.0, 2.5)
    listed = study.tolerance_rows(rows)
    assert [row[-1] for row in listed if row[0] == "forces"] == ["10", "6", "6"]  # 1 % is too little
