"""python scripts/table_5_2_hyperparameters.py: settings as printed, as built, and of the training that was run."""

from deep_contact.reporting import Claim, Figure, figures
from deep_contact.studies import chapter_5

KNOWN = {
    "Kernel size": "Appendix B: 3 × 3 in the first four convolutions, 2 × 2 in all others; its weights are 64,498,866"
}
"""Settings in which the network cannot follow Table 5.2, and the reason."""


def compute(options, seed, jobs, progress):
    """The columns, by the name of the setting."""
    built = chapter_5.thesis_hyperparameters()
    shipped = built | chapter_5.hyperparameters_of(options["model"])
    return {"printed": chapter_5.PRINTED_HYPERPARAMETERS, "built": built, "shipped": shipped}


def claims(data):
    printed, built = data["printed"], data["built"]
    differing = {name: [value, built.get(name)] for name, value in printed.items() if value != built.get(name)}
    return [
        Claim("the training's settings are those of Table 5.2", "Table 5.2", not differing, differing),
        Claim("they are, but for the sizes of the kernels", "Table 5.2", set(differing) == set(KNOWN), differing),
    ]


def table(data):
    rows = [["hyperparameter", "thesis", "here", "equal", "training of the shipped network"]]
    for name, printed in data["printed"].items():
        built = data["built"][name]
        rows.append([name, printed, built, printed == built, data["shipped"][name]])
    return [*rows, ["States shown", f"{chapter_5.THESIS_VISITS:,}", None, None, data["shipped"]["States shown"]]]


OPTIONS = {"model": chapter_5.NETWORKS["cnn thesis"]}
FIGURE = Figure("T 5.2", "Hyperparameters of the thesis's training", compute, table, claims=claims, options=OPTIONS)
figures.run_as_script(FIGURE, __name__)
