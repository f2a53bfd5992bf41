"""python scripts/figure_5_4_poly6.py: poly6, support h at d = 0.25 and spacing d at h = d."""

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim
from deep_contact.studies import starts, verdicts

EQUAL, BEST = "h = 0.25 m", "d = h = 0.5 m"
PLACE = "section 5.1.3, Figure 5.4"


def claims(data):
    by_h, by_d = data["h"], data["d"]
    slow, twice = "h = 0.1 m", "h = 0.5 m"
    others = [name for name in by_d["independent"] if name != BEST]
    good = "h = d is a good choice: its θ is within a tenth of the best other h's"
    rest = [name for name in by_h["independent"] if name != EQUAL]
    for name, times in ((slow, "0.4"), (twice, "2")):
        text = f"h = {times} d converges more slowly than h = d"
        yield verdicts.judged(by_h, name, EQUAL, text, PLACE, within=verdicts.SLOWER)
    for name, times in ((slow, "0.4"), (twice, "2")):
        text = f"h = {times} d is unstable: its θ rises more between sweeps than at h = d"
        yield verdicts.judged_by(verdicts.rise, by_h, name, EQUAL, text, PLACE, within=verdicts.SLOWER)
    yield verdicts.judged(by_h, EQUAL, rest, good, PLACE, within=(0.0, 1.1))
    yield verdicts.judged(by_d, BEST, others, "d = 0.5 m converges most rapidly", PLACE)
    if data["numbers"]:
        yield best_by_number(data)


def best_by_number(data):
    """Whether d = 0.5 m is beaten for some number of circles, by the level of θ over the sweeps (`verdicts.level`)."""
    text = "d = h = 0.5 m is not always the best: for other numbers of circles another d converges more rapidly"
    beaten, scenes = {}, set()
    for n, found in data["numbers"].items():
        part = found["independent"]
        others = [name for name in part if name != BEST]
        beaten[f"{n} circles: level of θ over the best other's, and its interval"] = verdicts.intervals(
            part, BEST, others, of=verdicts.level
        )[:, 0].tolist()
        scenes.add(verdicts.scenes_of(part))
    if min(scenes) < verdicts.FEWEST:
        return Claim(text, PLACE, None, beaten, f"open: {min(scenes)} scenes")
    somewhere = any(low > 1 for _, low, _ in beaten.values())
    if somewhere or all(high < 1 for *_, high in beaten.values()):
        return Claim(text, PLACE, somewhere, beaten)
    return Claim(text, PLACE, None, beaten, "within the noise")


FIGURE = starts.study_figure(id="5.4", kernel="poly6", claims=claims, numbers=(50, 110))

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
