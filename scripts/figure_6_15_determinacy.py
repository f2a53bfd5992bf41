"""python scripts/figure_6_15_determinacy.py: intervals of λ_n that give the same motion, and the labels' place in them.

The contact impulses of a pile are not unique. So the normal impulse λ_n of a contact may lie in an interval without any
change of the velocities. A label is the solution on which a network is trained.
"""

from itertools import chain

import numpy as np

from deep_contact import figures, parallel
from deep_contact.analysis.bounds import force_bounds
from deep_contact.analysis.exact import solve_exactly
from deep_contact.cnn.start import Cnn, FarFieldNoPast
from deep_contact.figures import Claim, Figure
from deep_contact.plot import plotting
from deep_contact.run.one_scene import simulate, solve_contacts
from deep_contact.scenes import circles_in_box
from deep_contact.solvers import NNCG, PGS
from deep_contact.starts.classical import Support
from deep_contact.state.state import StateWithContacts
from deep_contact.stepping import metrics, problem
from deep_contact.studies import piles

SHARES = {"median contact": 50, "90th percentile": 90}
"""Name of a curve -> percentile over the contacts of a pile."""

PILE = "kind", "n_bodies", "friction", "smallest"
"""Names of the properties of a pile, the arguments of `packed`."""

SWEEPS = 20_000
"""Number of sweeps with which solvers compute answers."""


def packed(kind: str, n_bodies: int, friction: float, smallest: float, seed: int) -> StateWithContacts:
    """Return a state of a pile.

    kind: "settling" is a packing after 51 steps, "resting" a packing at rest, and "thesis" the thesis's scene at rest.
    A pile counts as at rest if its root mean square speed is below 1e-3 m/s, or at the latest after 1,050 steps (1,600
    for "thesis"). friction: Coulomb's μ. smallest: smallest radius of a packing, m; the largest is 1 m. All circles of
    the thesis's scene have the same radius.
    """
    if kind == "thesis":
        scene, first = circles_in_box(n_bodies=n_bodies, friction=friction, seed=seed), 600
    else:
        scene, first = piles.packing(n_bodies, np.random.default_rng(seed), smallest=smallest, friction=friction), 50
    state, well = simulate(scene, steps=first, solver=piles.SETTLE).state, NNCG(sweeps=200)
    if kind == "settling":
        return simulate(state, steps=1, solver=well).state
    for _ in range(20):
        state = simulate(state, steps=50, solver=well).state
        if piles.rms_speed_of_state(state) < 1e-3:
            break
    return state


def measure(past: StateWithContacts, contacts: int, seed: int, models: list[str]) -> dict:
    """Measure the intervals of λ_n in a state of a pile, and the errors of other solutions, the answers.

    past: the state, whose contacts carry the impulses of the step before. contacts: number of contacts, drawn at
    random, whose intervals are computed. models: names of networks. The last of them corrects the start `Support`, and
    the others correct the impulses of the step before. Returns a dict:

    * "exact": whether an exact solution was found; if not, there are no other entries;
    * "fastest": largest velocity component in the exact solution, m/s;
    * "widths": widths of the intervals over the mean λ_n of the exact solution;
    * "errors", if there are models: name of the answer → [median over the contacts of the distance of λ_n from the
      exact solution, over the mean λ_n; velocity error, which is 0 for any impulses that give the exact velocities].
    """
    exact = solve_exactly(past)
    if not exact.converged:
        return {"exact": False}
    normal, tangent = exact.solution.normal_impulses, exact.solution.tangent_impulses
    solved = past.contacts._replace(normal_impulse=normal, tangent_impulse=tangent)
    drawn = np.random.default_rng(seed).choice(normal.size, min(contacts, normal.size), replace=False)
    bounds = force_bounds(past.replace(contacts=solved, solved=True), np.sort(drawn))
    measured = {"exact": True, "fastest": np.abs(exact.solution.velocities).max(),
                "widths": np.ptp(bounds.normal, axis=1) / normal.mean()}  # fmt: skip
    if not models:
        return measured
    state, pgs, nncg = piles.without_past(past), PGS(sweeps=SWEEPS, tolerance=None), NNCG(sweeps=SWEEPS, tolerance=None)
    answers = {
        "Builtin": solve_contacts(past, solver=pgs),
        "PGS from zero": solve_contacts(state, solver=pgs, start="none"),
        "NNCG from zero": solve_contacts(state, solver=nncg, start="none"),
        "PGS from support": solve_contacts(state, solver=pgs, start=Support()),
    }
    starts = {f"network, {name}": Cnn(name)(past, pgs) for name in models[:-1]}
    starts |= {f"network, {name}": FarFieldNoPast(name)(state, pgs) for name in models[-1:]}
    answers |= {name: problem.solve(past, PGS(sweeps=0), *start) for name, start in starts.items()}
    errors = {
        name: [
            float(np.median(np.abs(answer.normal_impulses - normal)) / normal.mean()),
            metrics.velocity_error(past, answer, exact.solution),
        ]
        for name, answer in answers.items()
    }
    return measured | {"errors": errors}


def cells(options):
    """Return the piles of each panel of the figure: name of the panel → piles (kind, circles, μ, smallest radius, m).

    The piles of a panel differ in one property.
    """
    n, mu, radius = options["sizes"][0], options["friction"], options["smallest"][0]
    return {
        "friction μ": [("resting", n, other, radius) for other in sorted(options["frictions"])],
        "friction μ, settling": [("settling", n, other, radius) for other in sorted(options["frictions"])],
        "circles": [("resting", other, mu, radius) for other in sorted(options["sizes"])],
        "smallest radius (m), largest 1 m": [("resting", n, mu, other) for other in sorted(options["smallest"])],
        "answers": [("thesis", options["circles"], mu, 1)],
    }


def compute(options, seed, jobs, progress):
    """Measure the intervals of all piles, and the errors of answers for piles of the thesis's scene."""
    tasks = [
        (pile, options["contacts"], s, options["models"] if pile[0] == "thesis" else [])
        for pile in dict.fromkeys(chain(*cells(options).values()))
        for s in parallel.seeds(seed, options["scenes"])
    ]
    return {"piles": parallel.parallel_map(_measured, tasks, jobs=jobs, progress=progress, text="piles")}


def _measured(task):
    pile, contacts, seed, models = task
    return dict(zip(PILE, pile)) | measure(packed(*pile, seed), contacts, seed, models)


def widths(data, pile):
    """Return the percentiles `SHARES` of the intervals' widths over the mean λ_n, (piles, shares).

    pile: properties (kind, circles, μ, smallest radius) of the piles that are selected.
    """
    exact = (one["widths"] for one in data["piles"] if one["exact"] and one | dict(zip(PILE, pile)) == one)
    open_ended = ([np.inf if width is None else width for width in one] for one in exact)
    return np.array([np.percentile(one, [*SHARES.values()], method="nearest") for one in open_ended])


def errors(data):
    """Return the errors of each answer: name of the answer → errors of λ_n and of the velocities, (piles, 2)."""
    by_pile = [pile["errors"] for pile in data["piles"] if pile.get("errors")]
    return {name: np.array([one[name] for one in by_pile]) for name in by_pile[0]} if by_pile else {}


def name_of(pile):
    return f"{pile[1]} circles, {pile[0]}, μ = {pile[2]:g}, radii from {pile[3]:g} m"


def claims(data):
    """Yield claims: with friction many impulses λ give the same motion.

    Without friction, this is so only in piles with more than two contacts per circle, where some contacts are within
    the slop.
    """
    piles = dict.fromkeys(tuple(pile[key] for key in PILE) for pile in data["piles"] if pile["exact"])
    medians = {pile: np.median(widths(data, pile), axis=0) for pile in piles}
    smooth = [row.max() for pile, row in medians.items() if pile[2] == 0]
    if smooth:
        yield Claim("without friction the motion determines λ", None, max(smooth) < 1e-6, {"width": max(smooth)})
    text = "with friction the interval of the median contact at rest is at least half of the mean λ_n wide"
    at_rest = [row[0] for pile, row in medians.items() if pile[2] > 0 and pile[0] != "settling"]
    yield Claim(text, None, min(at_rest) >= 0.5, {name_of(pile): row[0] for pile, row in medians.items()})
    middle = {name: np.median(both, axis=0).tolist() for name, both in errors(data).items()}
    text = "solvers and starts that know no past lie at least a tenth of the mean λ_n from the label of the run"
    yield Claim(text, None, min(both[0] for name, both in middle.items() if "from" in name) >= 0.1, middle)


def draw(data, options):
    """Draw four panels.

    Three have the widths of the intervals against friction, number of circles and radii, with the median and range of
    the piles. The fourth has the errors of the answers.
    """
    figure, panels = plotting.subplots(2, 2, size=(plotting.PAGE, 6.0))
    axes = [panels[0, 0], panels[0, 0], panels[0, 1], panels[1, 0]]
    for ax, (name, chosen), column in zip(axes, cells(options).items(), (2, 2, 1, 3)):
        chosen = [pile for pile in chosen if len(widths(data, pile))]
        by_pile = [widths(data, pile) for pile in chosen]
        for k, (label, colour) in enumerate(zip(SHARES, (plotting.BLUE, plotting.VERMILION))):
            middle, low, high = (np.array([f(one[:, k]) for one in by_pile]) for f in (np.median, np.min, np.max))
            style = {"color": colour, "marker": "o", "markersize": 4, "label": label}
            if "settling" in name:
                style |= {"linestyle": "--", "marker": "s", "label": f"{label}, settling"}
            plotting.band(ax, [pile[column] for pile in chosen], middle, low, high, **style)
        plotting.label_axes(ax, name.removesuffix(", settling"), "interval of λ_n / mean λ_n")
        ax.set_yscale("symlog", linthresh=1)
        ax.set_ylim(bottom=0)
    panels[0, 0].set_title(f"{options['sizes'][0]} circles")
    panels[0, 1].set_title(f"μ = {options['friction']:g}, resting")
    panels[0, 1].set(xscale="log", xticks=options["sizes"], xticklabels=options["sizes"])
    panels[0, 1].minorticks_off()
    panels[1, 0].set_title(f"{options['sizes'][0]} circles, resting")
    ax, both = panels[1, 1], errors(data)
    for y, values in enumerate(both.values()):
        for k, (label, marker) in enumerate((("λ_n, over its mean", "o"), ("velocities", "D"))):
            shown = np.maximum(values[:, k], options["least"])
            colour = plotting.BLACK if k == 0 else plotting.PURPLE
            ax.plot([shown.min(), shown.max()], [y + 0.15 * k] * 2, color=colour, linewidth=1)
            ax.plot(np.median(shown), y + 0.15 * k, marker, color=colour, label=label if y == 0 else None)
    half = np.median(widths(data, cells(options)["answers"][0])[:, 0]) / 2
    ax.axvline(half, color=plotting.BLUE, linestyle="--", linewidth=1)
    plotting.name_bars(ax, list(both))
    ax.set(xscale="log", xlim=(0.8 * options["least"], None))
    ax.legend(fontsize=8, loc="upper left", bbox_to_anchor=(0.06, 1.0))
    ax.set_title("The thesis's scene, resting")
    ax.set_xlabel("error of an answer\n(dashed: half of the interval)")
    return plotting.legend_below(figure, panels[0, 0], "How much of λ do the positions determine?")


OPTIONS = {"sizes": [100, 30, 300, 1000], "frictions": [0, 0.1, 0.3, 0.5, 1], "friction": 0.5, "circles": 100,
           "smallest": [0.8, 0.2, 0.5, 1], "contacts": 16, "scenes": 5, "least": 1e-4,
           "models": ["model", "far field", "far field, no past"]}  # fmt: skip
QUICK = {"sizes": [30, 60], "frictions": [0, 0.5, 1], "smallest": [0.8, 0.4], "contacts": 8, "scenes": 2,
         "models": ["far field", "far field, no past"]}  # fmt: skip
FIGURE = Figure("6.15", "How much of λ the positions determine", compute, None, draw, claims, options=OPTIONS,
                quick=QUICK, digits=5)  # fmt: skip
figures.run_as_script(FIGURE, __name__)
