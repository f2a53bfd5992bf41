"""python scripts/figure_5_6_kernels.py: poly6 at d = h = 0.5 against spiky at d = h = 0.25."""

from deep_contact.reporting import figures
from deep_contact.studies import starts, verdicts

POLY6, SPIKY = "poly6, d = h = 0.5 m", "spiky, d = h = 0.25 m"


def compared(transfer):
    """The best settings of Figures 5.4 and 5.5."""
    return {
        POLY6: {"kernel": "poly6", "spacing": 0.5, "transfer": transfer},
        SPIKY: {"kernel": "spiky", "spacing": 0.25, "transfer": transfer},
    }


def claims(data):
    return [verdicts.judged(data, POLY6, SPIKY, "poly6 performs better", "section 5.1.3, Figure 5.6")]


FIGURE = starts.convergence_figure(
    id="5.6", title="Convergence with poly6 and spiky", starts=compared, claims=claims, sweeps=5000, transfer="thesis"
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
