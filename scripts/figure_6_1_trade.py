"""python scripts/figure_6_1_trade.py: errors of a run against its computing time, here and in other engines."""

from itertools import product

import numpy as np

from deep_contact import figures
from deep_contact.accuracy.presets import PRESETS
from deep_contact.figures import Claim, Figure
from deep_contact.measure import peers, settings, trade
from deep_contact.plot import plotting
from deep_contact.studies import runs

SHOWN = {"energy": "kinetic energy", "penetration_max": "deepest penetration"}


def compute(options, seed, jobs, progress):
    """Read the study's rows for plain piles, and its settings of the presets."""
    study = runs.read_study(options["results"])
    rows = [
        {key: row[key] for key in ("n_bodies", "name", "us", "errors")} | {"group": settings.group_of(row["setting"])}
        for row in study["plain"]
        if row["us"] is not None
    ]
    return {"rows": rows, "presets": study["presets"]}


def claims(data):
    for n in runs.sizes_of(data["rows"]):
        here = {row["preset"]: row["ratio"] for row in data["presets"] if row["n_bodies"] == n}
        if ratios := {preset: ratio for preset, ratio in here.items() if ratio[0]}:
            text = f"no preset is dearer than with the fastest rival, {n} circles"
            yield Claim(text, None, min(ratio[0] for ratio in ratios.values()) >= 1, ratios)
    powers = {}
    for preset in PRESETS:
        rows = [row for row in data["presets"] if row["preset"] == preset and row["n_bodies"] >= 1000]
        large = [(row["n_bodies"], row["kinds"]["plain"]["us"]) for row in rows if row["kinds"]["plain"]]
        if len(large) > 1:
            powers[preset] = float(np.polyfit(*np.log(large).T, 1)[0])
    if powers:
        text = "a preset's cost grows with circles to the power of at most 1.15, from 1,000 circles on"
        yield Claim(text, None, max(powers.values()) <= 1.15, powers)


def table(data):
    rows = [["circles", "preset", "ours, plain piles", "ours, µs", *(f"{name}, µs" for name in peers.ENGINES)]]
    for row in data["presets"]:
        ours = row["kinds"]["plain"]
        costs = [cost and cost["us"] for cost in (ours, *row["peers"].values())]
        rows.append([row["n_bodies"], row["preset"], ours and ours["name"], *costs])
    return rows


def draw(data, options):
    """Draw errors against times, with a column of panels for each size and a row for each error.

    The panels have every setting, the best settings of this package, and the tolerances of the presets.
    """
    from matplotlib.ticker import LogLocator

    sizes = runs.sizes_of(data["rows"])
    size = (plotting.PAGE, 2.9 * len(SHOWN) + 0.6)
    figure, panels = plotting.subplots(len(SHOWN), len(sizes), size=size, squeeze=False, sharey="row")
    for ax, (name, n) in zip(panels.flat, product(SHOWN, sizes)):
        trade.draw_plane(ax, [row for row in data["rows"] if row["n_bodies"] == n], name, names=n == sizes[-1])
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0) if n < 1000 else (1.0,)))
    for top, bottom, n in zip(panels[0], panels[-1], sizes):
        top.set_title(f"{n:,} circles")
        bottom.set_xlabel("computing time\nof 10 ms (µs)")
    for ax, text in zip(panels[:, 0], ("error of the kinetic energy (%)", "deepest penetration (% of a radius)")):
        ax.set_ylabel(text)
    key = panels[0, 0]
    key.plot([], [], "o", color=plotting.BLUE, markersize=4, label="ours, every setting")
    key.plot([], [], color=plotting.BLACK, linewidth=1.2, label="best of ours")
    for name, marker in plotting.ENGINE_MARKER.items():
        key.plot([], [], marker, color=plotting.GREY, markersize=4, label=name)
    key.plot([], [], color=plotting.BLACK, linewidth=0.7, linestyle=":", label="what a preset tolerates")
    return plotting.legend_below(figure, key, "What does an error of a run cost, with ours and with other engines?")


FIGURE = Figure("6.1", "What a run costs and what it is worth", compute, table, draw, claims, options=runs.RESULTS)
figures.run_as_script(FIGURE, __name__)
