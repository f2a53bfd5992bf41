"""python scripts/figure_5_9_cnn.py: the CNN start beside all others, on scenes that no network was trained on."""

from deep_contact.reporting import figures, plotting
from deep_contact.reporting.figures import Figure
from deep_contact.studies import chapter_5, starts


def compute(options, seed, jobs, progress):
    """The starts on scenes of a random number of circles each, and what the model files say about themselves."""
    networks = options.pop("networks")
    about = chapter_5.networks_info(networks)
    chosen = chapter_5.STARTS | {name: {"model": path} for name, path in networks.items()} | {"copy": "copy"}
    after = [sweeps for sweeps in chapter_5.AFTER if sweeps < options["sweeps"]] + [options["sweeps"]]
    data = starts.compare_starts(chosen, seed=seed, jobs=jobs, progress=progress, velocity_sweeps=after, **options)
    return data | {"networks": about}


def claims(data):
    for name in data["networks"]:
        yield from chapter_5.claims_of_network(data, name, chapter_5.LABELS.get(name, name))


def table(data):
    return starts.table_of_starts(data, chapter_5.AFTER) + chapter_5.table_of_velocity(data)


def draw(data, options):
    """θ paired and independent, as in the thesis, and the remaining velocity error."""
    figure, (same, own, velocity) = plotting.subplots(1, 3, size=(13.5, 4.0))
    for ax, (mode, title) in zip((same, own), starts.MODES.items()):
        starts.draw_convergence(ax, data, mode, floor=1e-9, title=title)
        ax.get_legend().remove()
    own.sharey(same)
    for name, errors in data["velocity"]["mean"].items():
        shown = [max(error, 1e-7) for error in errors]
        velocity.plot(data["velocity"]["sweeps"], shown, **plotting.style_of(name), marker="o", markersize=4)
    velocity.set(xscale="log", yscale="log")
    plotting.label_axes(velocity, "sweep", "mean relative velocity error", title=starts.MODES["paired"])
    velocity.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), title="bands: quartiles of the scenes")
    return figure


# The data set's seeds are SeedSequence(0, spawn_key=(i,)); these scenes come from other random numbers.
OPTIONS = {
    "n_bodies": [51, 99], "size": 30.0, "steps": 600, "sweeps": 3000, "scenes": 12, "networks": chapter_5.NETWORKS,
}  # fmt: skip
QUICK = {"steps": 250, "sweeps": 1000, "scenes": 1, "networks": {"cnn": chapter_5.NETWORKS["cnn"]}}
FIGURE = Figure("5.9", "Convergence with the CNN start", compute, table, draw, claims, options=OPTIONS, quick=QUICK,
                seed=59)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
