"""python scripts/figure_5_5_spiky.py: spiky, support h at d = 0.25 and spacing d at h = d."""

from deep_contact import experiments, figures
from deep_contact.figures import Claim, Figure

KERNEL = "spiky"


def compute(options, seed, jobs, progress):
    """Every h and every d on the thesis's falling pile."""
    return experiments.study_of_kernel(KERNEL, seed=seed, jobs=jobs, progress=progress, **options)


def claims(data):
    """What the thesis concludes from Figure 5.5, in runs of each start's own, as it did."""
    by_h = {name: experiments.mean_sweeps(data["h"], name, "independent") for name in data["h"]["independent"]}
    by_d = {name: experiments.mean_sweeps(data["d"], name, "independent") for name in data["d"]["independent"]}
    return [
        Claim(
            "h = d is a good choice: no other h needs fewer sweeps",
            "L1129",
            by_h["h = 0.25"] <= min(by_h.values()),
            by_h,
        ),
        Claim(
            "d = 0.25 is a bit faster than any other d",
            "L1129",
            min(by_d, key=by_d.get) == "d = h = 0.25",
            by_d,
        ),
    ]


FIGURE = Figure(
    id="5.5",
    title="Convergence with the kernel spiky by support and spacing",
    options={
        "n_bodies": 100,
        "size": 30.0,
        "steps": 600,
        "sweeps": 3000,
        "scenes": 3,
        "d": 0.25,
        "h": [0.1, 0.2, 0.25, 0.5],
        "spacings": [0.25, 0.5, 0.75, 1.0],
        "transfer": "thesis",
    },
    quick={"scenes": 1, "steps": 250, "sweeps": 1500},
    compute=compute,
    claims=claims,
    table=experiments.table_of_study,
    draw=lambda data, options: experiments.draw_study(data, d=options["d"]),
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
