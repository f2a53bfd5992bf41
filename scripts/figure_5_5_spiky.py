"""python scripts/figure_5_5_spiky.py: convergence from SPH starts with spiky, for several h and d.

The first part varies the support radius h at the grid spacing d = 0.25 m. The second part varies d at h = d.
"""

from deep_contact import figures
from deep_contact.studies import starts, verdicts
from deep_contact.studies.starts import grid_of

PLACE = "section 5.1.3, Figure 5.5"


def claims(data):
    for start, way in starts.READ.items():
        equal, *rest = (grid_of(0.25, h, start) for h in (0.25, 0.1, 0.2, 0.5))
        finest, *others = every = [grid_of(d, d, start) for d in (0.25, 0.5, 0.75, 1.0)]
        listed = {of: [grid_of(d, d, start) for d in spacings[1:]] for of, spacings in starts.SPACINGS.items()}
        good = f"h = d, {way}, is a good choice: its θ is within a tenth of the best other h's"
        alike = f"all d, {way}, perform similarly: the largest θ is at most 1.25 times the smallest"
        stable = f"d = 0.25 m, {way}, is the most stable: its θ rises least between sweeps"
        yield verdicts.judged(data, equal, rest, good, PLACE, within=(0.0, 1.1))
        yield verdicts.judged(data, every, every, alike, PLACE, within=(0.0, 1.25))
        for of, rest in listed.items():
            yield verdicts.judged(
                data, finest, rest, f"d = 0.25 m, {way}, is a bit faster than any other of {of}", PLACE
            )
        yield verdicts.judged(data, finest, others, stable, PLACE, of=verdicts.rise)


FIGURE = starts.study_figure(id="5.5", kernel="spiky", claims=claims)
figures.run_as_script(FIGURE, __name__)
