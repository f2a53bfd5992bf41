"""python scripts/figure_5_9_cnn.py: convergence from the CNN start and from others, on scenes outside the training."""

from collections.abc import Iterator, Mapping

from deep_contact import figures
from deep_contact.figures import Figure
from deep_contact.figures.results import Claim
from deep_contact.studies import chapter_5, starts, verdicts
from deep_contact.studies.chapter_5 import ReadBySharing
from deep_contact.studies.starts import READ

TITLE = "Does a network's start converge like SPH's?"


CLOSE = (0.5, 2.0)
"""Range of the ratio of two starts' θ in which the starts count as similar."""


PLACE = "section 5.4, Figure 5.9"


def claims_of_network(data: Mapping, name: str) -> Iterator[Claim]:
    """Yield the thesis's claims on Figure 5.9 for one network.

    data: result of `starts.compare_starts` for the starts "none", "builtin", those of `READ`, "copy" and this network.
    The entry "networks" of the data is the result of `chapter_5.networks_info`. name: name of the network's start.
    """
    network = data["networks"][name]

    def judged(*names, **keywords):
        return verdicts.judged(data, *names, PLACE, **keywords)

    for read, how in chapter_5.READ_NETWORK.items():
        if name + read in data["independent"]:
            start, label = name + read, chapter_5.label_of(network) + how
            for sph, way in READ.items():
                similar = f"{label} performs similarly to SPH, {way}: θ from half to twice of it"
                yield judged(start, sph, similar, within=CLOSE)
                yield judged(sph, start, f"{label} is not as good as SPH, {way}")
            yield judged(start, "builtin", f"{label} converges faster than Builtin")
            small = f"{label} is just a small improvement to Builtin: θ from half of Builtin's to Builtin's"
            yield judged(start, "builtin", small, within=(0.5, 1.0))
            yield judged("copy", start, f"{label} does not converge as rapidly as Copy")
            useful = f"{label} is a start: its θ is at most half of None's"
            yield verdicts.judged(data, start, "none", useful, within=verdicts.MUCH_FASTER)


def compute(options, seed, jobs, progress):
    """Compare the starts on scenes with random numbers of circles, and collect the facts in the model files."""
    networks, size = options.pop("networks"), {"spacing": options.pop("spacing")}
    about = chapter_5.networks_info(networks)
    shared = [name for name, card in about.items() if card["architecture"] == "thesis"]
    chosen = {"none": "none", "builtin": "builtin"} | {name: of | size for name, of in starts.CHOSEN.items()}
    chosen |= {name: {"model": path} for name, path in networks.items()}
    chosen |= {f"{name}, shared": ReadBySharing(networks[name]) for name in shared} | {"copy": "copy"}
    own = {"modes": ["independent"], "seed": seed, "jobs": jobs, "progress": progress}
    return starts.compare_starts(chosen, **own, **options) | {"networks": about}


def claims(data):
    for name in data["networks"]:
        yield from claims_of_network(data, name)


def draw(data, options):
    shown = {name: runs for name, runs in data["independent"].items() if not name.endswith("shared")}
    return starts.draw_comparison(data | {"independent": shown}, TITLE, hidden=["sph spline"])


# The training data have the seeds SeedSequence(0, spawn_key=(i,)). The scenes of this figure have other seeds.
OPTIONS = starts.THESIS_SETTINGS | {"n_bodies": [51, 99], "spacing": starts.SPACING, "networks": chapter_5.NETWORKS}
QUICK = {"steps": 250, "sweeps": 1000, "scenes": 1}
FIGURE = Figure("5.9", TITLE, compute, starts.table_of_starts, draw, claims, options=OPTIONS, quick=QUICK, seed=59)
figures.run_as_script(FIGURE, __name__)
