"""python scripts/figure_5_4_poly6.py: poly6, support h at d = 0.25 and spacing d at h = d."""

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim
from deep_contact.studies import comparison


def claims(data):
    """The conclusions of the thesis from Figure 5.4, by independent runs as in the thesis."""
    by_h, by_d = comparison.mean_sweeps(data["h"]), comparison.mean_sweeps(data["d"])
    equal = by_h["h = 0.25 m"]
    slower = min(by_h["h = 0.1 m"], by_h["h = 0.5 m"]) > equal
    best = "h = d is a good choice: no other h needs fewer sweeps"
    return [
        Claim("h = 0.4 d and h = 2 d converge more slowly than h = d", "L1106", slower, by_h),
        Claim(best, "L1118", equal <= min(by_h.values()), by_h),
        Claim("d = 0.5 converges most rapidly", "L1121", min(by_d, key=by_d.get) == "d = h = 0.5 m", by_d),
    ]


FIGURE = comparison.study_figure(id="5.4", kernel="poly6", claims=claims)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
