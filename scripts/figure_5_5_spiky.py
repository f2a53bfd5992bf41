"""python scripts/figure_5_5_spiky.py: spiky, support h at d = 0.25 and spacing d at h = d."""

import numpy as np

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim
from deep_contact.studies import comparison


def claims(data):
    """What the thesis concludes from Figure 5.5, in runs of each start's own, as it did."""
    by_h = {name: comparison.mean_sweeps(data["h"], name, "independent") for name in data["h"]["independent"]}
    by_d = {name: comparison.mean_sweeps(data["d"], name, "independent") for name in data["d"]["independent"]}
    rises = {name: rise(found["theta"]) for name, found in data["d"]["independent"].items()}
    return [
        Claim(
            "h = d is a good choice: no other h needs fewer sweeps",
            "L1129",
            by_h["h = 0.25 m"] <= min(by_h.values()),
            by_h,
        ),
        Claim(
            "all d perform similarly: mean sweeps within a quarter of each other",
            "L1129",
            max(by_d.values()) < 1.25 * min(by_d.values()),
            by_d,
        ),
        Claim(
            "d = 0.25 is a bit faster than any other d",
            "L1129",
            min(by_d, key=by_d.get) == "d = h = 0.25 m",
            by_d,
        ),
        Claim(
            "d = 0.25 is the most stable: its θ rises least between sweeps",
            "L1129",
            min(rises, key=rises.get) == "d = h = 0.25 m",
            {f"rise in all, decades, {name}": found for name, found in rises.items()},
        ),
    ]


def rise(theta):
    """How much a curve of θ by sweep rises in all where it does not fall, in decades."""
    return float(np.maximum(np.diff(np.log10(theta)), 0).sum())


FIGURE = comparison.study_figure(id="5.5", kernel="spiky", claims=claims)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
