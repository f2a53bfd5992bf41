"""Verdicts on claims about starts, by the thesis's own measure: the mean convergence rate θ after each sweep (Eq 2.30).

A start is the impulses from which the solver begins. A claim says that the ratio of two starts' θ lies within a range.
It is judged by the ratio after each stored number of sweeps, and by a confidence band of this curve over scenes
(`band`). The whole curve lies within the band with a probability of 95 %, so that all numbers of sweeps may be judged
at once. The bootstrap draws the same scenes for both starts, so that the variation that both share cancels. A verdict
counts only if it is the same over a range of sweeps that takes at least `LEAST` of the logarithmic axis (`ranges`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from deep_contact.figures.results import Claim
from deep_contact.measure.errors import interval

FEWEST = 10
"""Smallest number of scenes with which a claim is judged."""

SMALLEST = 1e-15
"""Smaller θ are replaced by this value, N·s, the rounding error of impulses of a few N·s in float64."""

LEAST = 0.1
"""Length of the shortest range of sweeps that is judged, as a share of the logarithmic axis of sweeps."""

SHOWN = (1, 10, 100, 1000)
"""Numbers of sweeps after which a claim's `measured` shows the ratio."""

FASTER = (0.0, 1.0)
"""Range of the ratio of a start's θ to another start's θ, if the first is faster."""

MUCH_FASTER = (0.0, 0.5)
"""Range of the ratio, if the first start's θ is at most half of the other's."""

SLOWER = (1.0, np.inf)
"""Range of the ratio, if the first start is slower."""

ALIKE = (0.8, 1.25)
"""Range of the ratio, if the larger θ is at most 1.25 times the smaller one."""

NAMED = {FASTER: "below 1", MUCH_FASTER: "below 0.5", SLOWER: "above 1", ALIKE: "0.8 to 1.25"}
"""Range of the ratio -> its name in `measured`."""

RATIO = "ratio and its interval"
"""Name of the entry of `measured` that decides a claim on one number. The entry is [ratio, low, high]."""

BY_SWEEP = "θ ratio and its band, by sweep"
"""Name of the entry of `measured` for a claim on curves. The entry is number of sweeps -> [ratio, low, high]."""

Names = str | Sequence[str]


def scenes_of(part: Mapping) -> int:
    """Return the number of scenes. part: the data of one mode in the result of `starts.compare_starts`."""
    return len(next(iter(part.values()))["scenes"]["states"])


def intervals(part: Mapping, first: Names, second: Names, *, of: Callable | None = None) -> np.ndarray:
    """Return the ratio of two starts' mean θ after each number of sweeps, with its band: [ratio, low, high], (3, k).

    The ratio is θ of the first start over θ of the second. If there are several first starts, the largest of their θ is
    taken. If there are several second starts, the smallest of their θ is taken. The band is that of `band`.
    part: the data of one mode in the result of `starts.compare_starts`. first, second: names of starts. of: function
    that reduces each curve to one number before the ratio is taken, (rows, k) -> (rows,), such as `rise`. The result is
    then (3, 1), with the bounds of `interval`.
    """
    count = scenes_of(part)

    def means(names, drawn):
        """Return the mean θ of each start over the states of the scenes drawn, (starts, rows, k), N·s.

        names: names of starts. drawn: numbers of the scenes in each resampling, (rows, scenes).
        """
        times, curves = (drawn[:, :, None] == np.arange(count)).sum(axis=1), []
        for scenes in (part[name]["scenes"] for name in ([names] if isinstance(names, str) else names)):
            weights = times * np.asarray(scenes["states"])
            theta = np.maximum(weights @ np.asarray(scenes["theta"]) / weights.sum(axis=1, keepdims=True), SMALLEST)
            curves.append(theta if of is None else of(theta)[:, None])
        return np.array(curves)

    method = band if of is None else interval
    return method(lambda drawn: means(first, drawn).max(axis=0) / means(second, drawn).min(axis=0), count)


def band(ratios: Callable[[np.ndarray], np.ndarray], count: int, *, resamples: int = 2000) -> np.ndarray:
    """Return k positive ratios and their confidence band, [ratios, low, high], (3, k).

    All k ratios lie within the band with a probability of 95 %. The band is made by bootstrap over scenes, on the
    logarithms of the ratios. In each resampling, the deviation of each ratio is divided by this ratio's standard
    deviation, and the largest of the k absolute values is taken. The 95 % quantile of these largest values, times the
    standard deviation of a ratio, is half the width of the band there (the single-step max-t of Westfall and Young
    1993).
    ratios: function from numbers of scenes, (rows, count), a row for each resampling, to ratios, (rows, k). count:
    number of scenes; with one scene, low and high equal the ratios. resamples: number of resamplings.
    """
    middle = np.log(ratios(np.arange(count)[None])[0])
    if count == 1:
        return np.exp([middle] * 3)
    off = np.log(ratios(np.random.default_rng(0).integers(count, size=(resamples, count)))) - middle
    spread = off.std(axis=0)
    largest = np.divide(np.abs(off), spread, out=np.zeros_like(off), where=spread > 0).max(axis=1)
    reach = np.quantile(largest, 0.95) * spread
    return np.exp([middle, middle - reach, middle + reach])


def ranges(sweeps: Sequence[int], where: np.ndarray) -> str:
    """Return a text with the ranges of sweeps in which `where` is true, such as "1 to 180, 240 to 3000", or "".

    sweeps: numbers of sweeps, ascending, (k,). where: flags, (k,). On the logarithmic axis from the first to the last
    of `sweeps`, ranges shorter than the share `LEAST` of the axis are left out.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], where.astype(int), [0]])))
    pairs = ((sweeps[a], sweeps[b - 1]) for a, b in zip(edges[::2], edges[1::2]))
    least = LEAST * np.log(sweeps[-1] / sweeps[0])
    return ", ".join(f"{a} to {b}" for a, b in pairs if a < b and np.log(b / a) >= least)


def verdict(ratios: np.ndarray, within: tuple[float, float], sweeps: Sequence[int] | None = None) -> tuple:
    """Judge the claim that a ratio lies within a range. Returns (holds, verdict).

    The verdict is a text such as "holds, sweeps 1 to 180; does not hold, sweeps 250 to 3000". The claim holds after a
    number of sweeps if low and high of the band there lie within the range. It does not hold if both lie below the
    range or both lie above. Only `ranges` of such numbers of sweeps count. `holds` is True if the claim holds in some
    of these and fails in none, False if it fails in some and holds in none, and None otherwise.
    ratios: [ratio, low, high], (3, k). within: (smallest, largest) ratio of the range. sweeps: numbers of sweeps of the
    band, (k,); None for the interval of a single number, k = 1.
    """
    (_, low, high), (least, most) = ratios, within
    where = {"holds": (low > least) & (high < most), "does not hold": (high < least) | (low > most)}
    if sweeps is None:
        says = {word: word for word, so in where.items() if so.all()}
    else:
        says = {word: f"{word}, sweeps {found}" for word, so in where.items() if (found := ranges(sweeps, so))}
    return (next(iter(says)) == "holds" if len(says) == 1 else None), "; ".join(says.values()) or "within the noise"


def judged(
    data: Mapping,
    first: Names,
    second: Names,
    text: str,
    thesis: str | None = None,
    *,
    within: tuple[float, float] = FASTER,
    of: Callable | None = None,
    mode: str = "independent",
) -> Claim:
    """Return the claim that the θ of the first start over the θ of the second lies within a range, judged by sweep.

    data: result of `starts.compare_starts`. first, second: names of starts, as for `intervals`. text, thesis: fields of
    the `Claim`. within: (smallest, largest) ratio of the range. of: function that reduces a curve to one number, as for
    `intervals`; the claim is then about the ratio of these numbers. mode: the mode whose curves decide, by default
    independent runs, as in the thesis. If the data have the other mode, its verdict is in `measured` as well.
    """
    ratios, count = intervals(data[mode], first, second, of=of), scenes_of(data[mode])
    if of is not None:
        return _claim(text, thesis, count, within, {RATIO: ratios[:, 0].tolist()}, verdict(ratios, within))
    sweeps = data["sweep"]
    at = {str(k): ratios[:, int(np.argmin(np.abs(np.asarray(sweeps) - k)))].tolist() for k in SHOWN if k <= sweeps[-1]}
    measured = {BY_SWEEP: at}
    for other in data.keys() & {"paired", "independent"} - {mode}:
        measured[f"verdict, {other}"] = verdict(intervals(data[other], first, second), within, sweeps)[1]
    return _claim(text, thesis, count, within, measured, verdict(ratios, within, sweeps))


def judged_values(
    first: Sequence[float],
    second: Sequence[float],
    text: str,
    thesis: str | None = None,
    *,
    within: tuple[float, float] = FASTER,
    also: Mapping | None = None,
) -> Claim:
    """Return the claim that the ratio of two means over scenes lies within a range.

    first, second: one number >= 0 for each scene, (scenes,). text, thesis: fields of the `Claim`. within: (smallest,
    largest) ratio of the range. also: further entries of `measured`.
    """
    first, second = (np.asarray(values, dtype=float) for values in (first, second))

    def ratio(drawn):
        return np.maximum(first[drawn].mean(axis=1), SMALLEST) / np.maximum(second[drawn].mean(axis=1), SMALLEST)

    ratios = interval(ratio, len(first))
    measured = {RATIO: ratios.tolist()} | dict(also or {})
    return _claim(text, thesis, len(first), within, measured, verdict(ratios[:, None], within))


def _claim(text: str, thesis: str | None, count: int, within: tuple, measured: dict, judged: tuple) -> Claim:
    """Return the `Claim` for a result of `verdict`. With fewer than `FEWEST` scenes the claim is left open.

    count: number of scenes. judged: the result of `verdict`. The other arguments are those of `judged_values`.
    """
    holds, says = judged if count >= FEWEST else (None, f"open: {count} scene{'s' * (count > 1)}")
    low, high = within
    measured = {"scenes": count, **measured, "range": NAMED.get(within) or f"{low:g} to {high:g}"}
    return Claim(text, thesis, holds, measured, says)


def rise(theta: np.ndarray) -> np.ndarray:
    """Return the sum of all increases of log10 θ from sweep to sweep, (rows,), decades, at least 1e-6.

    It measures how unstable the convergence from a start is. theta: curves of θ, (rows, k), N·s.
    """
    return np.maximum(np.maximum(np.diff(np.log10(theta), axis=1), 0).sum(axis=1), 1e-6)


def level(theta: np.ndarray) -> np.ndarray:
    """Return the geometric mean of each curve of θ over the stored numbers of sweeps, (rows,), N·s.

    The stored numbers of sweeps are evenly spaced on a logarithmic axis. theta: curves of θ, (rows, k), N·s.
    """
    return np.exp(np.log(theta).mean(axis=1))
