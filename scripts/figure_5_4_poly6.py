"""python scripts/figure_5_4_poly6.py: poly6, support h at d = 0.25 and spacing d at h = d."""

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim
from deep_contact.studies import comparison


def claims(data):
    """What the thesis concludes from Figure 5.4, in runs of each start's own, as it did."""
    by_h = {name: comparison.mean_sweeps(data["h"], name, "independent") for name in data["h"]["independent"]}
    by_d = {name: comparison.mean_sweeps(data["d"], name, "independent") for name in data["d"]["independent"]}
    others = [by_h["h = 0.1 m"], by_h["h = 0.5 m"]]
    return [
        Claim("h = 0.4 d and h = 2 d converge more slowly than h = d", "L1106", min(others) > by_h["h = 0.25 m"], by_h),
        Claim(
            "h = d is a good choice: no other h needs fewer sweeps",
            "L1118",
            by_h["h = 0.25 m"] <= min(by_h.values()),
            by_h,
        ),
        Claim("d = 0.5 converges most rapidly", "L1121", min(by_d, key=by_d.get) == "d = h = 0.5 m", by_d),
    ]


FIGURE = comparison.study_figure(id="5.4", kernel="poly6", claims=claims)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
