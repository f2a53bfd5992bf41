"""python scripts/table_5_1_layers.py: layers and shapes of the built thesis network beside the thesis's table."""

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import chapter_5

MISPRINTS = ["Input", "BatchNormalization"]
"""Layers that the thesis's table gives wrongly: 4 channels for 5, and 4 × 4 × 512 for 4 × 4 × 256."""


def compute(options, seed, jobs, progress):
    """Both tables, layer by layer."""
    printed = [{"kind": kind, "shape": list(shape)} for kind, shape in chapter_5.PRINTED_LAYERS]
    return {"built": chapter_5.thesis_layers(), "printed": printed}


def differences(data):
    """(layer, printed, built) wherever the two differ."""
    return [
        (mine["kind"] if mine["kind"] == theirs["kind"] else f"{theirs['kind']} / {mine['kind']}", theirs, mine)
        for theirs, mine in zip(data["printed"], data["built"])
        if (theirs["kind"], theirs["shape"]) != (mine["kind"], mine["shape"])
    ]


def claims(data):
    same_length, found = len(data["built"]) == len(data["printed"]), differences(data)
    measured = {f"{kind}: printed, built": [text(theirs), text(mine)] for kind, theirs, mine in found}
    count = {"layers, printed and built": [len(data["printed"]), len(data["built"])]}
    equal = "the layers and shapes are those of Table 5.1"
    yield Claim(equal, "Table 5.1", not found and same_length, count | measured)
    known = "they are, but for its channels and its second batch normalisation"
    yield Claim(known, "Table 5.1", same_length and [kind for kind, *_ in found] == MISPRINTS, measured)
    trainable = sum(layer["trainable"] for layer in data["built"])
    holds, weights = trainable == 64_498_866, {"trainable parameters": trainable}
    yield Claim("its weights number 64,498,866", "section 5.3.1", holds, weights)


def text(layer):
    """61 × 61 × 5."""
    return " × ".join(map(str, layer["shape"]))


def table(data):
    rows = [["layer", "thesis's shape", "built", "kernel", "parameters", "equal"]]
    for theirs, mine in zip(data["printed"], data["built"]):
        equal = (theirs["kind"], theirs["shape"]) == (mine["kind"], mine["shape"])
        kernel = " × ".join(map(str, mine["kernel"])) if mine["kernel"] else None
        rows.append([mine["kind"], text(theirs), text(mine), kernel, f"{mine['parameters']:,}", equal])
    total = sum(layer["parameters"] for layer in data["built"])
    return [*rows, ["all", None, None, None, f"{total:,}", None]]


FIGURE = Figure("T 5.1", "Layers of the thesis's network", compute, table, claims=claims)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
