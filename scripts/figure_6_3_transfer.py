"""python scripts/figure_6_3_transfer.py: loss of the transfer to the grid and back, by kernel, d, h and radii."""

from itertools import product

import numpy as np

import deep_contact as dc
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import starts, verdicts
from deep_contact.warm_start import Sph

SIBLING = {
    f"d = {d:g}, h = {h:g}": loss
    for d, losses in {0.125: (0.0, 0.0, 0.0191), 0.25: (0.0480, 0.0, 0.0195), 0.5: (0.2349, 0.0589, 0.0237)}.items()
    for h, loss in zip((0.125, 0.25, 0.5), losses)
}
"""Mean loss of a contact impulse, N·s, in L. Engedal's thesis of 2018 (p. 39), for his own method and piles."""

WAYS = {
    "thesis": ("thesis", "bilinear"),
    "SPH gather": ("thesis", "sph"),
    "consistent": ("consistent", "bilinear"),
    "authors' spline": ("spline", "bilinear"),
    "authors' sharing": ("shared", "bilinear"),
}
"""Name -> transfer, and how the thesis's reads back."""

SUPPORTS = (0.125, 0.25, 0.5)
"""h at d = 0.25 m: half of it, d, and twice d."""

RADII = {"equal": (1.0, 1.0), "mixed": (0.5, 2.0)}


def compute(options, seed, jobs, progress):
    """Relative loss of isolated contacts and of piles for every kernel, d, h and way; and by d for mixed radii.

    "by scene" has the losses that the thesis speaks of, one a scene of equal circles.
    """
    isolated = starts.isolated_contacts(options["isolated"], seed=seed)
    scenes = {name: piles_of(options, radius, seed) for name, radius in RADII.items()}
    piles = {name: [state for pile in found for state in pile] for name, found in scenes.items()}

    def loss(states, method="bilinear", **start):
        return starts.transfer_loss(states, Sph(**start), method=method)["relative error"]

    rows = []
    for kernel in progress(options["kernels"], text="kernels"):
        for d, h in product(options["spacings"], options["supports"]):
            losses = {"kernel": kernel, "d": d, "h": h}
            for name, (transfer, method) in WAYS.items():
                start = {"spacing": d, "support": h, "kernel": kernel, "transfer": transfer}
                for what, states in (("isolated", isolated), ("pile", piles["equal"])):
                    losses[f"{what}, {name}"] = loss(states, method, **start)
            rows.append(losses)
    by_spacing = {
        radii: {
            name: [loss(states, by, spacing=d, transfer=way) for d in options["charted"]]
            for name, (way, by) in WAYS.items()
        }
        for radii, states in piles.items()
    }
    chosen = Sph(spacing=0.5)
    by_scene = {
        f"{name}, d = h = 0.5": [loss(s, by, spacing=0.5, transfer=way) for s in scenes["equal"]]
        for name, (way, by) in WAYS.items()
    }
    for h in SUPPORTS:
        by_scene[f"d = 0.25, h = {h:g}"] = [
            loss(s, spacing=0.25, support=h, transfer="thesis") for s in scenes["equal"]
        ]
    by_scene["velocities of circles"] = [starts.velocity_loss(states, chosen) for states in scenes["equal"]]
    found = {"rows": rows, "by scene": by_scene, "charted": options["charted"]}
    return found | {"by spacing": by_spacing, "sibling": SIBLING}


def piles_of(options, radius, seed):
    """Solved states of some falling and settling piles: the thesis's, and of radii mixed from 0.5 to 2."""
    count = options["n_bodies"] if radius == RADII["equal"] else options["n_bodies"] // 2
    scenes = [
        dc.circles_in_box(count, radius=radius, seed=s) for s in [seed, *figures.seeds(seed, options["scenes"] - 1)]
    ]
    return [starts.solved_states(scene, steps=600, every=options["every"]) for scene in scenes]


CLAIMS = [
    ("SPH makes an image of the state without losing much: read back, velocities change by under a tenth",
     "velocities of circles", None, "abstract", (0.0, 0.1)),
    ("linear interpolation loses information on the way back: read back by SPH weights, less is lost",
     "SPH gather", "thesis", "section 6.2.1", verdicts.FASTER),
    ("too small h loses information: at d = 0.25 m, h = d / 2 more than h = d",
     "h = 0.125", "h = 0.25", "section 3.2.3", verdicts.SLOWER),
    ("too big h loses information: at d = 0.25 m, h = 2 d more than h = d",
     "h = 0.5", "h = 0.25", "section 3.2.3", verdicts.SLOWER),
    ("SPH itself limits the start: with a way back that loses nothing, over a tenth of the error is left",
     "consistent", "thesis", "section 5.4", (0.1, np.inf)),
    ("under a tenth of the impulses is lost on the thesis's way through the image", "thesis", None, None, (0.0, 0.1)),
    ("the authors' code loses less than Algorithm 4: by a spline, for the SPH image",
     "authors' spline", "thesis", None, verdicts.FASTER),
    ("the authors' code loses less than Algorithm 4: each node shared out, for the network's image",
     "authors' sharing", "thesis", None, verdicts.FASTER),
    ("the authors' sharing loses less than our consistent transfer",
     "authors' sharing", "consistent", None, verdicts.FASTER),
]  # fmt: skip
"""Text, the loss that is judged and the one that it is divided by (None: none), where the thesis says so, the range."""


def claims(data):
    """How much the transfer loses, which part of it does, and how exact the consistent transfer is."""
    losses = {
        name.removesuffix(", d = h = 0.5").removeprefix("d = 0.25, "): of for name, of in data["by scene"].items()
    }
    losses[None] = [1.0] * len(losses["thesis"])
    found = [
        verdicts.judged_values(losses[one], losses[other], text, thesis, within=within)
        for text, one, other, thesis, within in CLAIMS
    ]
    isolated = max(row["isolated, consistent"] for row in data["rows"])
    equal, mixed = (data["by spacing"][name]["consistent"] for name in ("equal", "mixed"))
    at = data["charted"].index(0.5)
    text = "the consistent transfer returns an isolated contact exactly"
    found.append(Claim(text, None, isolated < 1e-12, {"worst": isolated}))
    text = "at d = h = 0.5 the consistent transfer changes the impulses of a pile of equal circles by under 1e-3"
    found.append(Claim(text, None, equal[at] < 1e-3, {"relative error": equal[at]}))
    text = "for radii from 0.5 to 2 the consistent transfer's error grows with d"
    grows = bool(np.all(np.diff(np.maximum(mixed, 1e-12)) >= 0))  # below lies rounding
    measured = {f"d = {d:g}": error for d, error in zip(data["charted"], mixed)}
    return [*found, Claim(text, None, grows, measured)]


def table(data):
    """Rows: relative errors for poly6; the results file has the other kernels."""
    names = [name for name in data["rows"][0] if ", " in name]
    rows = [["kernel", "d (m)", "h (m)", *names, "sibling (N·s)"]]
    for row in data["rows"]:
        sibling = data["sibling"].get(f"d = {row['d']:g}, h = {row['h']:g}") if row["kernel"] == "poly6" else None
        rows.append([row["kernel"], row["d"], row["h"], *(row[name] for name in names), sibling])
    return rows


def draw(data, options):
    """Left: relative error by h / d in a pile, for each way and spacing. Right: by d = h for equal and mixed radii."""
    from matplotlib.lines import Line2D

    figure, (left, right) = plotting.subplots(1, 2, size=(10.0, 4.4))
    colours = (plotting.SKY, plotting.ORANGE, plotting.BLUE, plotting.GREEN, plotting.VERMILION)
    looks = dict(zip(WAYS, colours))
    lines = dict(zip(options["spacings"], (":", "--", "-")))
    floor = 1e-6
    for name, colour in looks.items():
        for d, line in lines.items():
            found = [row for row in data["rows"] if row["kernel"] == "poly6" and row["d"] == d]
            error = np.maximum([row[f"pile, {name}"] for row in found], floor)
            left.plot([row["h"] for row in found], error, line, color=colour, marker="o")
    plotting.label_axes(left, "h", "relative error of λ", x_unit="m", title="a) pile of equal circles, poly6")
    left.legend(handles=[Line2D([], [], color="#222222", ls=line, label=f"d = {d:g} m") for d, line in lines.items()])
    kinds = {"equal": {"marker": "o", "ls": "-"}, "mixed": {"marker": "s", "ls": "--"}}
    for radii, look in kinds.items():
        for name, error in data["by spacing"][radii].items():
            right.plot(data["charted"], np.maximum(error, floor), color=looks[name], **look)
    plotting.label_axes(right, "d = h", "relative error of λ", x_unit="m", title="b) radii 1, and 0.5 to 2 mixed")
    keys = [Line2D([], [], color="#222222", label=f"{radii} radii", **look) for radii, look in kinds.items()]
    right.legend(handles=keys, loc="lower right")
    for ax in (left, right):
        ax.set_xscale("log", base=2)
        ax.set(yscale="log", ylim=(floor / 2, 2))
        ax.xaxis.set_major_formatter("{x:g}")
    left.text(0.01, 0.01, "errors below 1e-6 are drawn there", transform=left.transAxes, fontsize=7, va="bottom")
    ways = [Line2D([], [], color=colour, label=name) for name, colour in looks.items()]
    figure.legend(handles=ways, loc="outside lower center", ncols=len(ways))
    return figure


FIGURE = Figure(
    id="6.3",
    title="Loss of the way through the grid",
    options={
        "n_bodies": 100,
        "every": 60,
        "scenes": 12,
        "isolated": 100,
        "kernels": ["poly6", "spiky", "cubic_spline", "wendland_c2", "gaussian"],
        "spacings": [0.125, 0.25, 0.5],
        "supports": [0.125, 0.25, 0.5],
        "charted": [0.125, 0.25, 0.375, 0.5, 0.75, 1.0, 1.5, 2.0],
    },
    quick={"every": 40, "scenes": 1, "isolated": 20},
    compute=compute,
    claims=claims,
    table=table,
    draw=draw,
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
