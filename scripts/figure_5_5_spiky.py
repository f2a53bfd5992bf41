"""python scripts/figure_5_5_spiky.py: spiky, support h at d = 0.25 and spacing d at h = d."""

from deep_contact.reporting import figures
from deep_contact.studies import starts, verdicts

EQUAL, FINEST = "h = 0.25 m", "d = h = 0.25 m"
PLACE = "section 5.1.3, Figure 5.5"


def claims(data):
    by_h, by_d = data["h"], data["d"]
    every = list(by_d["independent"])
    rest, others = [name for name in by_h["independent"] if name != EQUAL], [name for name in every if name != FINEST]
    good = "h = d is a good choice: its θ is within a tenth of the best other h's"
    alike = "all d perform similarly: the largest θ is at most 1.25 times the smallest"
    stable = "d = 0.25 m is the most stable: its θ rises least between sweeps"
    return [
        verdicts.judged(by_h, EQUAL, rest, good, PLACE, within=(0.0, 1.1)),
        verdicts.judged(by_d, every, every, alike, PLACE, within=(0.0, 1.25)),
        verdicts.judged(by_d, FINEST, others, "d = 0.25 m is a bit faster than any other d", PLACE),
        verdicts.judged_by(verdicts.rise, by_d, FINEST, others, stable, PLACE),
    ]


FIGURE = starts.study_figure(id="5.5", kernel="spiky", claims=claims)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
