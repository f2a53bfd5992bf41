"""Walls that keep a pressure, by `Simulator.force_on` and `segment_velocities`: the program of the gallery."""

import runpy

import numpy as np
import pytest
from conftest import ROOT


@pytest.mark.slow
def test_segments_keep_their_pressures_and_the_packing_is_one_of_rigid_discs(tmp_path, monkeypatch, capsys):
    """Pressures within 1 % in the mean, without swings, also while the sample is sheared.

    Frictional discs carry a load with 3 contacts each at least (isostatic), and without friction with 4. A loose random
    packing of discs fills some 0.77 to 0.84 of the plane.
    """
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(ROOT / "docs" / "gallery" / "biaxial.py"))
    count = len(names["pressures"])
    for found in names["kept"][:count]:
        np.testing.assert_allclose(found.mean(axis=0), 1.0, rtol=0, atol=0.01)
        assert found.std(axis=0).max() < 0.01
    sheared = np.concatenate(names["kept"][count:])
    np.testing.assert_allclose(sheared.mean(), 1.0, rtol=0, atol=0.01)
    assert sheared.std() < 0.05
    fractions, touching = np.transpose(names["packings"])
    assert ((fractions > 0.77) & (fractions < 0.84)).all()
    assert ((touching > 3.0) & (touching < 4.0)).all()
    assert (np.diff(fractions) > 0.0).all()
    assert touching[-1] > touching[0]
    assert 0.25 < max(names["ratios"]) < 0.6
    assert (tmp_path / "biaxial.png").stat().st_size > 10_000 < (tmp_path / "biaxial_sheared.png").stat().st_size
    assert "kept to" in capsys.readouterr().out
