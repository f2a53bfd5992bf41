"""python scripts/table_5_1_layers.py: layers and shapes of our copy of the thesis's network, and of its Table 5.1."""

from deep_contact import figures
from deep_contact.figures import Claim, Figure
from deep_contact.studies import chapter_5

MISPRINTS = {f"{kind}: printed, built" for kind in ("Input", "BatchNormalization")}
"""Names of the layers with a wrong shape in the thesis's table.

It has 4 channels instead of 5, and 4 × 4 × 512 instead of 4 × 4 × 256.
"""


PRINTED_LAYERS = chapter_5.PRINTED["layers"]
"""Table 5.1 as the thesis prints it, with its misprints: (name of the layer, output shape without the batch)."""


def compute(options, seed, jobs, progress):
    """Collect the layers of the built network and those of the thesis's table."""
    printed = [{"kind": kind, "shape": list(shape)} for kind, shape in PRINTED_LAYERS]
    return {"built": chapter_5.thesis_layers(), "printed": printed}


def equal(theirs, mine):
    """Return whether a printed layer has the kind and the shape of the built one. theirs: printed. mine: built."""
    return (theirs["kind"], theirs["shape"]) == (mine["kind"], mine["shape"])


def claims(data):
    same_length = len(data["built"]) == len(data["printed"])
    misprints = {}
    for theirs, mine in zip(data["printed"], data["built"]):
        if not equal(theirs, mine):
            kinds = dict.fromkeys([theirs["kind"], mine["kind"]])
            misprints[f"{' / '.join(kinds)}: printed, built"] = [text(theirs), text(mine)]
    count = {"layers, printed and built": [len(data["printed"]), len(data["built"])]}
    same = "the layers and shapes are those of Table 5.1"
    yield Claim(same, "Table 5.1", not misprints and same_length, count | misprints)
    known = "they are, but for its channels and its second batch normalisation"
    yield Claim(known, "Table 5.1", same_length and misprints.keys() == MISPRINTS, misprints)


def text(layer):
    """Return the shape of a layer as a text, such as "61 × 61 × 5"."""
    return " × ".join(map(str, layer["shape"]))


def table(data):
    rows = [["layer", "thesis's shape", "built", "kernel", "parameters", "equal"]]
    for theirs, mine in zip(data["printed"], data["built"]):
        kernel = " × ".join(map(str, mine["kernel"])) if mine["kernel"] else None
        rows.append([mine["kind"], text(theirs), text(mine), kernel, f"{mine['parameters']:,}", equal(theirs, mine)])
    total, trained = (sum(layer[of] for layer in data["built"]) for of in ("parameters", "trainable"))
    rows.append(["all", None, None, None, f"{total:,}", None])
    return [*rows, ["of these, trained", None, None, None, f"{trained:,}", None]]


FIGURE = Figure("T 5.1", "Layers of the thesis's network", compute, table, claims=claims)
figures.run_as_script(FIGURE, __name__)
