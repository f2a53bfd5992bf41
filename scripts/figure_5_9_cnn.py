"""python scripts/figure_5_9_cnn.py: the CNN start beside all others, on scenes that no network was trained on."""

from deep_contact.reporting import Figure, figures
from deep_contact.studies import chapter_5, starts

TITLE = "Does a network's start converge like SPH's?"


def compute(options, seed, jobs, progress):
    """The starts on scenes of a random number of circles each, and what the model files say about themselves."""
    networks, size = options.pop("networks"), {"spacing": options.pop("spacing")}
    about = chapter_5.networks_info(networks)
    shared = [name for name, card in about.items() if card["architecture"] == "thesis"]
    chosen = {"none": "none", "builtin": "builtin"} | {name: of | size for name, of in starts.CHOSEN.items()}
    chosen |= {name: {"model": path} for name, path in networks.items()}
    chosen |= {f"{name}, shared": chapter_5.ReadBySharing(networks[name]) for name in shared} | {"copy": "copy"}
    own = {"modes": ["independent"], "seed": seed, "jobs": jobs, "progress": progress}
    return starts.compare_starts(chosen, **own, **options) | {"networks": about}


def claims(data):
    for name in data["networks"]:
        yield from chapter_5.claims_of_network(data, name)


def draw(data, options):
    shown = {name: runs for name, runs in data["independent"].items() if not name.endswith("shared")}
    return starts.draw_comparison(data | {"independent": shown}, TITLE, hidden=["sph spline"])


# The data set's seeds are SeedSequence(0, spawn_key=(i,)); these scenes come from other random numbers.
OPTIONS = starts.THESIS_SETTINGS | {"n_bodies": [51, 99], "spacing": starts.SPACING, "networks": chapter_5.NETWORKS}
QUICK = {"steps": 250, "sweeps": 1000, "scenes": 1, "networks": {"cnn": chapter_5.NETWORKS["cnn"]}}
FIGURE = Figure("5.9", TITLE, compute, starts.table_of_starts, draw, claims, options=OPTIONS, quick=QUICK, seed=59)
figures.run_as_script(FIGURE, __name__)
