"""python scripts/figure_5_6_kernels.py: convergence from SPH starts with the kernels poly6 and spiky.

The grid spacing d and the support radius h are 0.5 m for poly6 and 0.25 m for spiky. Each image is read back in two
ways, as the thesis prints it and as its authors programmed it.
"""

from deep_contact import figures
from deep_contact.studies import starts, verdicts

BEST = {"poly6": 0.5, "spiky": 0.25}
"""Kernel -> the best d = h in Figures 5.4 and 5.5 according to the thesis, m."""


def named(kernel, start):
    return f"{kernel}, {starts.grid_of(BEST[kernel], BEST[kernel], start)}"


STARTS = {
    named(kernel, start): {"kernel": kernel, "spacing": size, "transfer": transfer}
    for start, transfer in starts.TRANSFERS.items()
    for kernel, size in BEST.items()
}


def claims(data):
    for start, way in starts.READ.items():
        poly6, spiky = named("poly6", start), named("spiky", start)
        yield verdicts.judged(data, poly6, spiky, f"poly6, {way}, performs better", "section 5.1.3, Figure 5.6")


FIGURE = starts.convergence_figure(
    id="5.6", title="Does poly6 converge faster than spiky?", starts=STARTS, claims=claims, sweeps=5000,
    over=named("spiky", "sph"),
)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
