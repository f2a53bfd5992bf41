"""python scripts/figure_5_5_spiky.py: spiky, support h at d = 0.25 and spacing d at h = d."""

import numpy as np

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim
from deep_contact.studies import comparison

FINEST = "d = h = 0.25 m"


def claims(data):
    """The conclusions of the thesis from Figure 5.5, by independent runs as in the thesis."""
    by_h, by_d = comparison.mean_sweeps(data["h"]), comparison.mean_sweeps(data["d"])
    rises = {name: rise(found["theta"]) for name, found in data["d"]["independent"].items()}
    measured = {f"rise in all, decades, {name}": found for name, found in rises.items()}
    best = "h = d is a good choice: no other h needs fewer sweeps"
    alike = "all d perform similarly: mean sweeps within a quarter of each other"
    stable = "d = 0.25 is the most stable: its θ rises least between sweeps"
    return [
        Claim(best, "L1129", by_h["h = 0.25 m"] <= min(by_h.values()), by_h),
        Claim(alike, "L1129", max(by_d.values()) < 1.25 * min(by_d.values()), by_d),
        Claim("d = 0.25 is a bit faster than any other d", "L1129", min(by_d, key=by_d.get) == FINEST, by_d),
        Claim(stable, "L1129", min(rises, key=rises.get) == FINEST, measured),
    ]


def rise(theta):
    """Sum of the rises of a curve of θ by sweep, decades."""
    return float(np.maximum(np.diff(np.log10(theta)), 0).sum())


FIGURE = comparison.study_figure(id="5.5", kernel="spiky", claims=claims)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
