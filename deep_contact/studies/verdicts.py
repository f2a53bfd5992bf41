"""Verdicts on claims about starts, by the thesis's own measure: the mean θ after each sweep (Eq 2.30).

A claim says that one start's θ over another's lies within a range. It is judged by the ratio at all stored numbers of
sweeps and its band over scenes (`band`). With 95 % probability the whole curve lies within the band, so that all
sweeps may be judged at once. The resamplings draw the same scenes for both starts, so that what is common to both
cancels. A verdict rests on a stretch of sweeps that takes at least `LEAST` of the logarithmic axis (`ranges`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from deep_contact.figures.results import Claim
from deep_contact.measure.errors import interval

FEWEST = 10
"""Least number of scenes with which a claim is judged."""

SMALLEST = 1e-15
"""θ below which a solve has come to rest, N·s: the rounding of impulses of some N·s in float64."""

LEAST = 0.1
"""Shortest stretch of sweeps that is judged, as a share of the logarithmic axis of sweeps."""

SHOWN = (1, 10, 100, 1000)
"""Numbers of sweeps after which `measured` shows a ratio."""

FASTER = (0.0, 1.0)
"""Range of the ratio of θ for a start that is faster than another."""

MUCH_FASTER = (0.0, 0.5)
"""Range of the ratio for a start that leaves at most half of the other's θ."""

SLOWER = (1.0, np.inf)
"""Range of the ratio for a start that is slower."""

ALIKE = (0.8, 1.25)
"""Range of the ratio for a start whose θ equals the other's within a quarter."""

NAMED = {FASTER: "below 1", MUCH_FASTER: "below 0.5", SLOWER: "above 1", ALIKE: "0.8 to 1.25"}

RATIO = "ratio and its interval"
"""Entry of `measured` that decides a claim on one number: [ratio, low, high]."""

BY_SWEEP = "θ ratio and its band, by sweep"
"""Entry of `measured` that decides a claim on curves: number of sweeps -> [ratio, low, high]."""

Names = str | Sequence[str]


def scenes_of(part: Mapping) -> int:
    """Number of scenes in one mode of `starts.compare_starts`' data."""
    return len(next(iter(part.values()))["scenes"]["states"])


def intervals(part: Mapping, first: Names, second: Names, *, of: Callable | None = None) -> np.ndarray:
    """[ratio, low, high], (3, k), by `band`: largest mean θ of the first starts over smallest of the second.

    part: one mode of `starts.compare_starts`' data. of: function that takes one number from each curve before the
    ratio, (rows, k) -> (rows,), such as `rise`; the result is then (3, 1), by `interval`.
    """
    count = scenes_of(part)

    def means(names, drawn):
        """Mean θ of each start over the states of the scenes drawn, (starts, rows, k). drawn: (rows, scenes)."""
        times, curves = (drawn[:, :, None] == np.arange(count)).sum(axis=1), []
        for scenes in (part[name]["scenes"] for name in ([names] if isinstance(names, str) else names)):
            weights = times * np.asarray(scenes["states"])
            theta = np.maximum(weights @ np.asarray(scenes["theta"]) / weights.sum(axis=1, keepdims=True), SMALLEST)
            curves.append(theta if of is None else of(theta)[:, None])
        return np.array(curves)

    method = band if of is None else interval
    return method(lambda drawn: means(first, drawn).max(axis=0) / means(second, drawn).min(axis=0), count)


def band(ratios: Callable[[np.ndarray], np.ndarray], count: int, *, resamples: int = 2000) -> np.ndarray:
    """[ratios, low, high], (3, k): k positive ratios, and the band within which all of them lie with 95 %.

    ratios: function from the scenes drawn, (rows, count), one row for each resampling, to (rows, k). count: number of
    scenes; a single scene has no band. The bootstrap deviations of the logarithms are divided by their standard
    deviation at each k, and the largest over all k counts (the single-step max-t of Westfall and Young 1993).
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
    """The stretches of `sweeps` in which `where` is true, "1 to 180, 240 to 3000"; "" for none.

    Left out are stretches shorter than `LEAST` of the logarithmic axis from the first to the last of all sweeps.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], where.astype(int), [0]])))
    pairs = ((sweeps[a], sweeps[b - 1]) for a, b in zip(edges[::2], edges[1::2]))
    least = LEAST * np.log(sweeps[-1] / sweeps[0])
    return ", ".join(f"{a} to {b}" for a, b in pairs if a < b and np.log(b / a) >= least)


def verdict(ratios: np.ndarray, within: tuple[float, float], sweeps: Sequence[int] | None = None) -> tuple:
    """(holds, verdict) of a band by sweep: "holds, sweeps 1 to 180; does not hold, sweeps 250 to 3000".

    A claim holds at the sweeps at which the whole band lies within the range `within`, and does not hold where the
    whole band lies outside; `ranges` of such sweeps count. holds: True where the claim holds in some range and fails in
    none, False where it fails in some and holds in none, else None. ratios: the band, or the interval of one number.
    sweeps: those of the band; None for the interval of one number.
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
    """The claim that θ of the first start over that of the second lies within a range, by sweep.

    data: result of `starts.compare_starts`. first, second: names of starts; of several first starts the largest θ
    counts, of several second ones the smallest. of: see `intervals`; the claim is then on one number. mode: the mode
    whose curves decide, by default independent runs, as in the thesis; `measured` also has the verdict of the other
    mode, if the data have it.
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
    """The claim that the ratio of two means over scenes lies within a range.

    first, second: one number >= 0 for each scene, (scenes,). also: further entries of `measured`.
    """
    first, second = (np.asarray(values, dtype=float) for values in (first, second))

    def ratio(drawn):
        return np.maximum(first[drawn].mean(axis=1), SMALLEST) / np.maximum(second[drawn].mean(axis=1), SMALLEST)

    ratios = interval(ratio, len(first))
    measured = {RATIO: ratios.tolist()} | dict(also or {})
    return _claim(text, thesis, len(first), within, measured, verdict(ratios[:, None], within))


def _claim(text: str, thesis: str | None, count: int, within: tuple, measured: dict, judged: tuple) -> Claim:
    """The claim with the result `judged` of `verdict`; open with fewer than `FEWEST` scenes."""
    holds, says = judged if count >= FEWEST else (None, f"open: {count} scene{'s' * (count > 1)}")
    low, high = within
    measured = {"scenes": count, **measured, "range": NAMED.get(within) or f"{low:g} to {high:g}"}
    return Claim(text, thesis, holds, measured, says)


def rise(theta: np.ndarray) -> np.ndarray:
    """Sum of all rises of curves of θ by sweep, (rows, k) -> (rows,), decades, at least 1e-6: a start's instability."""
    return np.maximum(np.maximum(np.diff(np.log10(theta), axis=1), 0).sum(axis=1), 1e-6)


def level(theta: np.ndarray) -> np.ndarray:
    """Geometric mean of curves of θ over the stored sweeps, which lie evenly on a logarithmic axis, N·s."""
    return np.exp(np.log(theta).mean(axis=1))
