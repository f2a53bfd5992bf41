"""python scripts/figure_5_4_poly6.py: convergence from SPH starts with poly6, for several h and d.

The first part varies the support radius h at the grid spacing d = 0.25 m. The second part varies d at h = d.
"""

from deep_contact import figures
from deep_contact.figures import Claim
from deep_contact.studies import starts, verdicts
from deep_contact.studies.starts import grid_of

D = 0.25
"""Spacing d of the grid in the first part of the figure, in which h varies, m."""

SUPPORTS = (0.1, 0.2, 0.25, 0.5)
"""Support radii h in the first part of the figure, m."""

PLACE = "section 5.1.3, Figure 5.4"


def claims(data):
    for start, way in starts.READ.items():
        by_h = {h: grid_of(D, h, start) for h in SUPPORTS}
        *rest, equal = by_h[0.1], by_h[0.2], by_h[0.5], by_h[D]
        for h, times in ((0.1, "0.4"), (0.5, "2")):
            slower = f"h = {times} d, {way}, converges more slowly than h = d"
            rises = f"h = {times} d, {way}, is unstable: its θ rises more between sweeps than at h = d"
            yield verdicts.judged(data, by_h[h], equal, slower, PLACE, within=verdicts.SLOWER)
            yield verdicts.judged(data, by_h[h], equal, rises, PLACE, within=verdicts.SLOWER, of=verdicts.rise)
        good = f"h = d, {way}, is a good choice: its θ is within a tenth of the best other h's"
        yield verdicts.judged(data, equal, rest, good, PLACE, within=(0.0, 1.1))
        best = grid_of(0.5, 0.5, start)
        for of, spacings in starts.SPACINGS.items():
            others = [grid_of(d, d, start) for d in spacings if d != 0.5]
            yield verdicts.judged(data, best, others, f"d = 0.5 m, {way}, converges most rapidly of {of}", PLACE)
        if start == "sph" and data["numbers"]:
            yield best_by_number(data["numbers"], best, others, way)


def best_by_number(numbers, best, others, way):
    """Return the claim that for some number of circles another d converges faster than d = h = 0.5 m.

    The starts are compared by the mean level of θ over the sweeps (`verdicts.level`). numbers: number of circles ->
    data of `compare_starts`. best: name of the start with d = 0.5 m. others: names of the others. way: words for the
    way in which the image is read back.
    """
    text = f"d = h = 0.5 m, {way}, is not always the best: for another number of circles another d converges faster"
    parts = {n: runs["independent"] for n, runs in numbers.items()}
    fewest = min(map(verdicts.scenes_of, parts.values()))
    levels = {n: verdicts.intervals(part, best, others, of=verdicts.level)[:, 0].tolist() for n, part in parts.items()}
    beaten = {f"{n} circles: level of θ over the best other's, and its interval": of for n, of in levels.items()}
    if fewest < verdicts.FEWEST:
        return Claim(text, PLACE, None, beaten, f"open: {fewest} scenes")
    somewhere = any(low > 1 for _, low, _ in beaten.values())
    if somewhere or all(high < 1 for *_, high in beaten.values()):
        return Claim(text, PLACE, somewhere, beaten)
    return Claim(text, PLACE, None, beaten, "within the noise")


FIGURE = starts.study_figure(id="5.4", kernel="poly6", claims=claims, numbers=(50, 110))
figures.run_as_script(FIGURE, __name__)
