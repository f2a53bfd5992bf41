"""Verdicts on claims about starts: ranges of sweeps and intervals over scenes, on curves whose ratio is known."""

import numpy as np
import pytest
from conftest import load_script

from deep_contact.figures import results
from deep_contact.studies import starts, verdicts

SWEEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000]


def part(states=None, **thetas):
    """One mode of `compare_starts`' data: θ of each scene by sweep."""
    found = {}
    for name, theta in thetas.items():
        theta = np.asarray(theta, dtype=float)
        scenes = {"theta": theta.tolist(), "states": states or [1] * len(theta)}
        found[name] = {"theta": theta.mean(axis=0).tolist(), "scenes": scenes}
    return found


def data(**thetas):
    both = part(**thetas)
    return {"sweep": SWEEPS, "threshold": 6e-5, "independent": both, "paired": both}


def curves(scenes=12, spread=0.5, seed=0):
    """Falling curves whose scenes differ by a common factor each."""
    size = np.exp(np.random.default_rng(seed).normal(0, spread, (scenes, 1)))
    return size / np.array(SWEEPS)


def test_a_claim_says_over_which_sweeps_it_holds_and_over_which_not():
    base = curves()
    cross = np.where(np.array(SWEEPS) <= 100, 0.5, 2.0)
    claim = verdicts.judged(data(a=base * cross, b=base), "a", "b", "a is faster", "section 3.4.2")
    assert claim.verdict == "holds, sweeps 1 to 100; does not hold, sweeps 200 to 1000"
    assert claim.holds is None
    assert claim.measured["verdict, paired"] == claim.verdict
    ratio = claim.measured[verdicts.BY_SWEEP]
    assert ratio["100"] == pytest.approx([0.5] * 3)  # what scenes have in common falls out


@pytest.mark.parametrize(
    ("factor", "within", "holds", "verdict"),
    [
        (0.9, verdicts.FASTER, True, "holds, sweeps 1 to 1000"),
        (1.1, verdicts.FASTER, False, "does not hold, sweeps 1 to 1000"),
        (0.9, verdicts.ALIKE, True, "holds, sweeps 1 to 1000"),
        (0.7, verdicts.ALIKE, False, "does not hold, sweeps 1 to 1000"),
        (0.6, verdicts.MUCH_FASTER, False, "does not hold, sweeps 1 to 1000"),
        (1.1, verdicts.SLOWER, True, "holds, sweeps 1 to 1000"),
    ],
)
def test_a_range_decides(factor, within, holds, verdict):
    base = curves()
    claim = verdicts.judged(data(a=factor * base, b=base), "a", "b", "any", within=within)
    assert (claim.holds, claim.verdict) == (holds, verdict)


def test_nine_scenes_leave_a_claim_open_however_clear_it_is():
    base = curves(scenes=9)
    claim = verdicts.judged(data(a=0.01 * base, b=base), "a", "b", "any")
    assert (claim.holds, claim.verdict) == (None, "open: 9 scenes")
    assert verdicts.judged_values([1.0], [2.0], "any").verdict == "open: 1 scene"


def test_starts_that_do_not_differ_are_within_the_noise():
    """Of 100 pairs from one distribution, an interval of 95 % misses few; of twelve scenes it is a little too short."""
    rng = np.random.default_rng(5)
    wrong = 0
    for _ in range(100):
        first, second = rng.lognormal(0, 0.5, (2, 12))
        found = verdicts.judged_values(first, second, "any")
        wrong += found.holds is not None
        assert (found.holds is None) == (found.verdict == "within the noise")
    assert wrong <= 15


def test_states_weigh_alike_not_scenes():
    found = verdicts.intervals(part(states=[30, 10], a=[[1.0], [5.0]], b=[[1.0], [1.0]]), "a", "b")
    assert found[0, 0] == pytest.approx((30 * 1 + 10 * 5) / 40)


def test_of_several_starts_the_worst_first_and_the_best_second_count():
    base = curves()
    several = part(a=2 * base, b=3 * base, c=base, d=4 * base)
    assert verdicts.intervals(several, ["a", "b"], ["c", "d"])[0] == pytest.approx(3.0)
    assert verdicts.intervals(several, list("abcd"), list("abcd"))[0] == pytest.approx(4.0)


def test_the_interval_is_that_of_the_mean_over_scenes():
    """Against the normal distribution: 1.96 standard errors on both sides of the mean of many scenes."""
    values = np.random.default_rng(3).normal(10.0, 1.0, 400)
    ratio, low, high = verdicts.judged_values(values, np.ones(400), "any").measured[verdicts.RATIO]
    error = 1.96 * values.std() / np.sqrt(400)
    assert ratio == pytest.approx(values.mean())
    assert (ratio - low, high - ratio) == (pytest.approx(error, rel=0.15), pytest.approx(error, rel=0.15))


def test_a_rise_is_summed_in_decades_and_a_level_is_a_geometric_mean():
    theta = np.array([[1.0, 0.1, 1.0, 0.01], [1.0, 0.1, 0.01, 0.001]])
    assert verdicts.rise(theta) == pytest.approx([1.0, 1e-6])
    assert verdicts.level(theta) == pytest.approx([10**-0.75, 10**-1.5])


def test_a_range_takes_a_tenth_of_the_logarithmic_axis():
    where = np.isin(SWEEPS, [1, 5, 10, 20, 50, 200])
    assert verdicts.ranges(SWEEPS, where) == "5 to 50"
    assert verdicts.ranges(SWEEPS, np.isin(SWEEPS, [200, 500])) == "200 to 500"  # 0.13 of three decades
    assert verdicts.ranges([1, 100, 199, 1000], np.array([False, True, True, False])) == ""  # 0.0996
    assert verdicts.ranges([1, 100, 200, 1000], np.array([False, True, True, False])) == "100 to 200"  # 0.1003


def test_a_single_sweep_decides_nothing_however_clear_it_is():
    base = curves()
    ahead = np.where(np.array(SWEEPS) == 50, 0.01, 1.0)
    claim = verdicts.judged(data(a=base * ahead, b=base), "a", "b", "a is faster")
    assert (claim.holds, claim.verdict) == (None, "within the noise")


def test_a_band_has_all_numbers_together_with_95_percent():
    """Ten independent means of 100 lognormal numbers each, whose true ratio to their mean is 1."""
    rng, outside = np.random.default_rng(3), 0
    for _ in range(200):
        values = rng.lognormal(0, 0.3, (100, 10)) / np.exp(0.3**2 / 2)
        _, low, high = verdicts.band(lambda drawn, values=values: values[drawn].mean(axis=1), 100, resamples=500)
        outside += ((low > 1) | (high < 1)).any()
    assert 2 <= outside <= 20  # 10 are expected; with an interval at each number 80


def test_curves_that_were_exchanged_by_chance_rarely_have_a_verdict():
    """Starts of Figure 5.4, exchanged in random scenes: neither is faster. By single sweeps 44 of 100 have one."""
    found = results.reference("figure_5_4")["data"]
    scenes, rng, wrong = found["independent"], np.random.default_rng(1), 0
    for _ in range(100):
        one, other = (scenes[name]["scenes"] for name in rng.choice(list(scenes), 2, replace=False))
        swapped = rng.integers(2, size=(len(one["theta"]), 1)) == 1
        first, second = (np.where(swapped, a["theta"], b["theta"]) for a, b in ((one, other), (other, one)))
        band = verdicts.intervals(part(a=first, b=second), "a", "b")
        wrong += verdicts.verdict(band, verdicts.FASTER, found["sweep"])[1] != "within the noise"
    assert wrong <= 12


@pytest.mark.parametrize(
    ("factors", "scenes", "holds", "verdict"),
    [
        ({"50": 1.2, "110": 0.8}, 12, True, None),  # another d is better for 50 circles
        ({"50": 0.8, "110": 0.8}, 12, False, None),
        ({"50": 1.0, "110": 0.8}, 12, None, "within the noise"),
        ({"50": 2.0}, 3, None, "open: 3 scenes"),
    ],
)
def test_figure_5_4_asks_whether_the_best_spacing_depends_on_the_number_of_circles(factors, scenes, holds, verdict):
    script = load_script("figure_5_4")
    base, noise = curves(scenes), np.exp(np.random.default_rng(1).normal(0, 0.1, (scenes, 1)))
    numbers = {n: {"independent": part(best=factor * base * noise, other=base)} for n, factor in factors.items()}
    claim = script.best_by_number(numbers, "best", ["other"], "read bilinearly")
    assert (claim.holds, claim.verdict) == (holds, verdict)


def test_theta_of_zero_is_drawn_at_the_floor_and_said_so():
    found = part(builtin=[[1.0, 0.1]], copy=[[1e-3, 0.0]])
    left, _ = starts.draw_comparison({"sweep": [1, 10], "threshold": 6e-5, "independent": found}, "title").axes
    np.testing.assert_allclose(left.lines[1].get_ydata(), [1e-3, 1e-9])
    assert [text.get_text() for text in left.texts] == ["θ below 1e-09, zero included, is drawn there"]
