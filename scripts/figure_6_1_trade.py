"""python scripts/figure_6_1_trade.py: errors of a run against its wall time, ours and other engines'."""

from deep_contact.presets import PRESETS
from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import peers, runs

SHOWN = {"energy": "kinetic-energy curve", "penetration_max": "deepest penetration", "penetration": "mean penetration"}
OURS = {"PGS": plotting.VERMILION, "PSOR": plotting.ORANGE, "BatchedPGS": plotting.BLUE}
MARKERS = {"Box2D 2.3": "s", "pymunk": "^", "Box2D v3": "D"}


def compute(options, seed, jobs, progress):
    """The study's rows on plain piles, and its presets."""
    found = runs.read_study(options["results"])
    rows = [
        {key: row[key] for key in ("n_bodies", "name", "us", "errors")}
        | {"group": row["setting"].get("engine") or row["setting"]["method"]}
        for row in found["rows"]
        if row["kind"] == "plain" and row["errors"] and row["us"] is not None
    ]
    return {"rows": rows, "presets": found["presets"]}


def claims(data):
    for n in runs.sizes_of(data["rows"]):
        here = {row["preset"]: runs.cheaper_than_rivals(row) for row in data["presets"] if row["n_bodies"] == n}
        if ratios := {preset: ratio for preset, ratio in here.items() if ratio}:
            text = f"no preset is dearer than with the fastest rival, {n} circles"
            yield Claim(text, None, min(ratios.values()) >= 1, ratios)


def table(data):
    head = ["circles", "preset", "ours", "µs per 10 ms", "µs, plain piles"]
    rows = [head + [f"{engine}, µs" for engine in peers.ENGINES]]
    for row in data["presets"]:
        ours, plain = row["ours"], row["ours_plain"]
        cells = [row["n_bodies"], row["preset"], ours and ours["name"], ours and ours["us"], plain and plain["us"]]
        rows.append(cells + [peer and peer["us"] for peer in row["peers"].values()])
    return rows


def draw(data, options):
    """A row of panels for each size, a column for each error: every setting, the front of ours, the tolerances."""
    sizes = runs.sizes_of(data["rows"])
    figure, panels = plotting.subplots(len(sizes), len(SHOWN), size=(11.0, 3.2 * len(sizes)), squeeze=False)
    for line, n in zip(panels, sizes):
        rows = [row for row in data["rows"] if row["n_bodies"] == n]
        for ax, (name, text) in zip(line, SHOWN.items()):
            for row in rows:
                value, low, high = row["errors"][name]
                reach = [[max(0.0, value - low)], [max(0.0, high - value)]]  # an interval may lie beside its value
                ax.errorbar(row["us"], value, reach, linewidth=0.6, markersize=3.5, **look_of(row["group"]))
            ours = sorted((row["us"], row["errors"][name][0]) for row in rows if row["group"] not in MARKERS)
            front = [(us, error) for i, (us, error) in enumerate(ours) if all(error < before for _, before in ours[:i])]
            ax.plot(*zip(*front), color=plotting.BLACK, drawstyle="steps-post", linewidth=1.5)
            for preset in ("fast", "balanced", "accurate"):
                ax.axhline(PRESETS[preset][name], color=plotting.GREY, linewidth=0.6, linestyle=":")
                ax.annotate(preset, (1, PRESETS[preset][name]), xycoords=("axes fraction", "data"), fontsize=6,
                            ha="right", va="bottom", color=plotting.GREY)  # fmt: skip
            plotting.label_axes(ax, "wall time of 10 ms", text, x_unit="µs", y_unit="%", title=f"{n:,} circles")
            plotting.log_axes(ax)
    for group in dict.fromkeys(row["group"] for row in data["rows"]):
        panels[0, 0].plot([], [], linestyle="", markersize=4, label=group, **look_of(group))
    panels[0, 0].plot([], [], color=plotting.BLACK, label="front of ours")
    plotting.legend_below(figure, panels[0, 0])
    return figure


def look_of(group):
    """Colour and marker of a method, or of another engine."""
    if group in MARKERS:
        return {"color": plotting.GREY, "marker": MARKERS[group]}
    return {"color": OURS.get(group, plotting.SKY), "marker": "o"}


OPTIONS = {"results": "data/reference/run_tradeoff.json"}
FIGURE = Figure("6.1", "What a run costs and what it is worth", compute, table, draw, claims, options=OPTIONS)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
