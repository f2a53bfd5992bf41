"""python scripts/figure_6_3_transfer.py: loss of impulses in the transfer to a grid image and back.

The loss depends on the kernel, the grid spacing d, the support radius h and the radii of the circles.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np

import deep_contact as dc
from deep_contact import figures, parallel, sph
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.sph.start import Sph
from deep_contact.state.fields import make_bodies
from deep_contact.state.state import State
from deep_contact.state.world import World
from deep_contact.stepping.prepare import ready
from deep_contact.studies import starts, verdicts

SIBLING = {
    f"d = {d:g}, h = {h:g}": loss
    for d, losses in {0.125: (0.0, 0.0, 0.0191), 0.25: (0.0480, 0.0, 0.0195), 0.5: (0.2349, 0.0589, 0.0237)}.items()
    for h, loss in zip((0.125, 0.25, 0.5), losses)
}
"""Mean loss of a contact impulse, N·s, in L. Engedal's thesis of 2018 (p. 39), by d and h, m.

The thesis has another method of transfer and other piles.
"""

WAYS = {
    "thesis": ("thesis", "bilinear", plotting.SKY, "^", "--"),
    "SPH gather": ("thesis", "sph", plotting.GREY, "x", ":"),
    "consistent": ("consistent", "bilinear", plotting.BLUE, "v", "-"),
    "authors' spline": ("spline", "bilinear", plotting.SKY, "s", "-"),
    "authors' sharing": ("shared", "bilinear", plotting.SHARING, "D", "-."),
}
"""Name of a way through the grid -> (transfer of `Sph`, method of `sph.gather`, colour, marker, line style)."""

OPTIONS = {
    "n_bodies": 100, "every": 60, "scenes": 12, "isolated": 100,
    "kernels": ["poly6", "spiky", "cubic_spline", "wendland_c2", "gaussian"], "spacings": [0.125, 0.25, 0.5],
    "supports": [0.125, 0.25, 0.5], "charted": [0.125, 0.25, 0.375, 0.5, 0.75, 1.0, 1.5, 2.0],
}  # fmt: skip
QUICK = {"every": 40, "scenes": 1, "isolated": 20}


# ---- losses of one way through the grid ----


def transfer_loss(states: Sequence[State], start: Sph, *, method: str = "bilinear") -> float:
    """Return the mean over states of ‖λ' − λ‖ / ‖λ‖, where λ' are the solved impulses λ after the way through the grid.

    states: solved states. start: the transfer. method: method of `sph.gather`, which only the thesis's transfer uses.
    """
    errors = []
    for state in states:
        impulses = np.column_stack([state.contacts.normal_impulse, state.contacts.tangent_impulse])
        if impulses.any():
            back = np.column_stack(start.round_trip(state, impulses, method=method))
            errors.append(np.linalg.norm(back - impulses) / np.linalg.norm(impulses))
    return float(np.mean(errors))


def motion_loss(states: Sequence[State], start: Sph) -> dict[str, float]:
    """Return the relative losses if the circles' motion is splatted to an image (Algorithm 2), means over the states.

    "velocities of circles" is ‖u' − u‖ / ‖u‖ with u = (v_x, v_y, ω). u' is read from the image at the circles. It is
    then multiplied by the known mass of the circle over the mass that is read from the image.

    "mass and momentum", "angular momentum" and "energy" compare the sum of a quantity over the nodes with its sum over
    the circles. The difference is divided by the sum of the quantity's absolute values over the circles. The spin is
    left out. "mass and momentum" is the largest of the losses of mass and of both components of momentum.
    """
    errors = []
    h = start.spacing if start.support is None else start.support
    reach = {"h": h, "kernel": start.kernel, "outside": "clamp", "unreached": "nearest"}
    for state in states:
        mass, places = state.bodies.mass[:, None], state.bodies.position
        motion = np.column_stack([state.bodies.velocity, state.bodies.spin])
        grid = sph.Grid.over_box(state.world.box, start.spacing)
        values = np.column_stack([mass, motion, mass * state.bodies.velocity])
        image = sph.splat(grid, places, values, normalization="particle", **reach)
        back = sph.gather(grid, image, places, outside="clamp")
        change = back[:, 1:4] * (mass / back[:, :1]) - motion
        nodes = np.stack(np.meshgrid(*grid.nodes), axis=-1)[image[..., 0] > 0]
        before, after = _sums(places, values), _sums(nodes, image[image[..., 0] > 0])
        # If a quantity is 0 for all circles, such as the momentum along x before the first contact, its loss is 0.
        size, least = np.abs(before).sum(axis=0), np.finfo(float).tiny
        kept = np.abs(after.sum(axis=0) - before.sum(axis=0)) / np.maximum(size, least)
        errors.append([np.linalg.norm(change) / max(np.linalg.norm(motion), least), kept[:3].max(), *kept[3:]])
    names = ("velocities of circles", "mass and momentum", "angular momentum", "energy")
    return dict(zip(names, np.mean(errors, axis=0).tolist()))


def _sums(places: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return mass, momentum (x, y), angular momentum and energy of each particle, (n, 5).

    places: positions, (n, 2), m. values: the first column is the mass m, kg, and the last two are m v, kg m/s.
    """
    mass, (x, y), (p_x, p_y) = values[:, 0], places.T, values[:, -2:].T
    return np.column_stack([mass, p_x, p_y, x * p_y - y * p_x, (p_x**2 + p_y**2) / (2 * mass)])


def isolated_contacts(count: int, *, seed: int) -> list[State]:
    """Return `count` states that have one contact each, at a random place in the thesis's box.

    The impulses of a contact are λ_n = 1 N·s and λ_t = 0.3 N·s.
    """
    rng = np.random.default_rng(seed)
    states = []
    for centre in rng.uniform(10.0, 20.0, (count, 2)):
        angle = rng.uniform(0, 2 * np.pi)
        reach = 0.999 * np.array([np.cos(angle), np.sin(angle)])
        bodies = make_bodies([centre - reach, centre + reach], radius=1.0)
        state = ready(State(name="isolated", world=World(), bodies=bodies))
        impulses = {"normal_impulse": np.array([1.0]), "tangent_impulse": np.array([0.3])}
        states.append(state.replace(contacts=state.contacts._replace(**impulses), solved=True))
    return states


# ---- the figure ----


def compute(options, seed, jobs, progress):
    """Measure the losses of isolated contacts and of piles for every kernel, d, h and way through the grid.

    The data's "by spacing" has the losses by d, also for mixed radii. "by scene" has the losses on which claims are
    made: name -> a loss for each scene of equal circles.
    """
    seeds, n = [seed, *parallel.seeds(seed, options["scenes"] - 1)], options["n_bodies"]

    def piles(count, radius):
        scenes = (dc.circles_in_box(count, radius=radius, seed=s) for s in seeds)
        return [starts.solved_states(scene, steps=600, every=options["every"]) for scene in scenes]

    def loss(states, way="thesis", **start):
        transfer, method, *_ = WAYS[way]
        return transfer_loss(states, Sph(**start, transfer=transfer), method=method)

    scenes = {"equal": piles(n, (1.0, 1.0)), "mixed": piles(n // 2, (0.5, 2.0))}
    states = {name: [state for pile in of_scenes for state in pile] for name, of_scenes in scenes.items()}
    kinds = {"isolated": isolated_contacts(options["isolated"], seed=seed), "pile": states["equal"]}
    rows = []
    for kernel in progress(options["kernels"], text="kernels"):
        for d, h in product(options["spacings"], options["supports"]):
            start = {"spacing": d, "support": h, "kernel": kernel}
            losses = {f"{what}, {way}": loss(of, way, **start) for way in WAYS for what, of in kinds.items()}
            rows.append({"kernel": kernel, "d": d, "h": h} | losses)
    by_scene = {f"{way}, d = h = 0.5": [loss(s, way, spacing=0.5) for s in scenes["equal"]] for way in WAYS}
    for h in (0.125, 0.25, 0.5):  # half of d, d, and twice d
        by_scene[f"d = 0.25, h = {h:g}"] = [loss(s, spacing=0.25, support=h) for s in scenes["equal"]]
    motion = [motion_loss(s, Sph(spacing=0.5)) for s in scenes["equal"]]
    by_scene |= {name: [of_scene[name] for of_scene in motion] for name in motion[0]}
    by_spacing = {
        radii: {way: [loss(of, way, spacing=d) for d in options["charted"]] for way in WAYS}
        for radii, of in states.items()
    }
    by = {"by scene": by_scene, "by spacing": by_spacing}
    return {"rows": rows, "charted": options["charted"], "sibling": SIBLING} | by


CLAIMS = [
    ("SPH makes an image of the state without losing much: read back, velocities change by under a tenth",
     "velocities of circles", None, "abstract", (0.0, 0.1)),
    ("linear interpolation loses information on the way back: read back by SPH weights, less is lost",
     "SPH gather", "thesis", "section 6.2.1", verdicts.FASTER),
    ("too small h loses information: at d = 0.25 m, h = d / 2 more than h = d",
     "h = 0.125", "h = 0.25", "section 3.2.3", verdicts.SLOWER),
    ("too big h loses information: at d = 0.25 m, h = 2 d more than h = d",
     "h = 0.5", "h = 0.25", "section 3.2.3", verdicts.SLOWER),
    *(
        (f"the SPH-based method, interpolation included, limits the start: {read}, over a tenth of λ is lost",
         way, None, "section 5.4", (0.1, np.inf))
        for way, read in {"thesis": starts.READ["sph"], "authors' spline": starts.READ["sph spline"],
                          "authors' sharing": "shared (authors' code for the network)"}.items()
    ),
    ("it is the way back that limits it: with one that loses nothing, under a tenth of the error is left",
     "consistent", "thesis", None, (0.0, 0.1)),
    *((f"SPH conserves: the image has the state's {of}", of, None, "section 3.2", (0.0, 0.01))
      for of in ("mass and momentum", "energy", "angular momentum")),
    ("the authors' code loses less than Algorithm 4: by a spline, for the SPH image",
     "authors' spline", "thesis", None, verdicts.FASTER),
    ("the authors' code loses less than Algorithm 4: each node shared out, for the network's image",
     "authors' sharing", "thesis", None, verdicts.FASTER),
    ("the authors' sharing loses less than our consistent transfer",
     "authors' sharing", "consistent", None, verdicts.FASTER),
]  # fmt: skip
"""Claims on the ratio of two losses, or on one loss if the second name is None.

A claim is (text, name of the loss, name of the loss that divides it or None, place in the thesis or None, range).
"""


def claims(data):
    losses = {name.replace(", d = h = 0.5", "").replace("d = 0.25, ", ""): of for name, of in data["by scene"].items()}
    losses[None] = [1.0] * len(losses["thesis"])
    for text, one, other, thesis, within in CLAIMS:
        yield verdicts.judged_values(losses[one], losses[other], text, thesis, within=within)
    isolated = max(row["isolated, consistent"] for row in data["rows"])
    text = "the consistent transfer returns an isolated contact exactly"
    yield Claim(text, None, isolated < 1e-12, {"worst": isolated})
    equal, mixed = (dict(zip(data["charted"], of["consistent"])) for of in data["by spacing"].values())
    text = "at d = h = 0.5 the consistent transfer changes the impulses of a pile of equal circles by under 1e-3"
    yield Claim(text, None, equal[0.5] < 1e-3, {"relative error": equal[0.5]})
    text = "for radii from 0.5 to 2 the consistent transfer's error grows with d"
    grows = bool(np.all(np.diff(np.maximum(list(mixed.values()), 1e-12)) >= 0))  # smaller errors are rounding errors
    yield Claim(text, None, grows, {f"d = {d:g}": error for d, error in mixed.items()})


def table(data):
    rows = [["kernel", "d (m)", "h (m)", *list(data["rows"][0])[3:], "sibling (N·s)"]]
    for row in data["rows"]:
        sibling = data["sibling"].get(f"d = {row['d']:g}, h = {row['h']:g}") if row["kernel"] == "poly6" else None
        rows.append([*row.values(), sibling])
    return rows


def draw(data, options):
    """Draw the relative error of the impulses against d = h for every way, for equal circles and for mixed radii.

    The axis of the error is linear. A loss above a tenth matters for a start, and the size of a small loss does not.
    The table has the small losses.
    """
    figure, panels = plotting.subplots(1, 2, size=(plotting.PAGE, 3.8), sharey=True)
    titles = {"equal": "circles of radius 1 m", "mixed": "radii from 0.5 to 2 m"}
    for ax, (radii, title) in zip(panels, titles.items()):
        for name, (*_, colour, marker, line) in WAYS.items():
            look = {"color": colour, "marker": marker, "linestyle": line, "markersize": 5, "markerfacecolor": "none"}
            ax.plot(data["charted"], data["by spacing"][radii][name], label=name, **look)
        ax.set_xscale("log", base=2)
        ax.xaxis.set_major_formatter("{x:g}")
        ax.set(xlabel="spacing d = support h (m)", title=title)
    panels[0].set_ylabel("relative error of λ")
    return plotting.legend_below(figure, panels[0], "How much of the impulses does the way through the grid lose?")


FIGURE = Figure("6.3", "Loss of the way through the grid", compute, table, draw, claims, options=OPTIONS, quick=QUICK)
figures.run_as_script(FIGURE, __name__)
