"""python scripts/model_cards.py: write models/README.md, registry.json and learning curves from the model files."""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

MODELS = Path(__file__).resolve().parent.parent / "models"

NAMES = {"model": "model", "far_field": "far field", "far_field_no_past": "far field, no past"}
"""Name of a model file without .h5 -> name of the network for `dc.load_model`, in the order of models/README.md."""

SOURCES = {
    "architecture": ("Table 5.1", "Appendix B"),
    "spacing": ("d of the images, m: section 5.1.3", "the same"),
    "support": ("h of the images, m: section 5.1.3", "the same"),
    "optimizer": ("SGD: Table 5.2", "SGD with Nesterov's momentum 0.9: `cnn_training.py`"),
    "schedule": ("Algorithm 6, its gaps closed, over the epochs that are run", "Appendix B, likewise"),
    "rate": ("the first: Table 5.2", "the first: Appendix B"),
    "dropout": ("after each stack: Tables 5.1, 5.2", "before the last layer: Appendix B; its rate: `cnn_model.py`"),
    "weight_decay": ("as the code: the thesis prints no number", "`cnn_model.py`"),
    "rank": ("ours: whole, the last layer's matrix has 244 MB", "the same"),
    "batch_size": ("Table 5.2", "`cnn_training.py`"),
    "epochs": ("Table 5.2; the command of a card may say fewer", "`cnn_training.py`; likewise"),
    "states_per_epoch": ("ours: 18,208 (section 5.3.3) but for the last 8, which fill no batch", "the same"),
    "fractions": (
        "training, choice of the epoch, card: a fifth to choose, Table 5.2",
        "the same: their log; the code has 0.1",
    ),
    "validation_states": ("ours: about so many of that fifth", "the same"),
}
"""Setting in the recipes "thesis" and "authors' code" -> (source of its value in the first, source in the second)."""


def recipes() -> list[tuple]:
    """Return rows (setting, value in the recipe "thesis", its source, value in "authors' code", its source)."""
    from deep_contact.cnn.training.config import RECIPES

    flat = {name: {**settings, **settings["options"]} for name, settings in RECIPES.items() if "options" in settings}
    thesis, code = flat["thesis"], flat["authors' code"]
    return [
        (name, thesis[name], SOURCES[name][0], code[name], SOURCES[name][1]) for name in thesis if name != "options"
    ]


def main(arguments=None) -> None:
    """Write the learning curves, models/README.md by its template models/README.md.j2, and registry.json."""
    argparse.ArgumentParser(description=__doc__).parse_args(arguments)
    import jinja2

    from deep_contact.cnn.inference import ends
    from deep_contact.cnn.model_file import read_metadata, spec_of
    from deep_contact.cnn.training.curve import learning_curve
    from deep_contact.io.files import write_bytes
    from deep_contact.studies.chapter_5 import THESIS_VISITS, thesis_layers

    models, registry = {}, {}
    for stem, name in NAMES.items():
        path = MODELS / f"{stem}.h5"
        stored = read_metadata(path)
        card = stored["card"]
        registry[name] = {
            "file": path.name,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            "command": card["command"],
            "data": card["data_hash"],
        }
        curve = learning_curve(card["history"], path.with_name(f"{stem}_history.png"))
        about = {"name": name, "card": card, "sha256": registry[name]["sha256"], "size": path.stat().st_size}
        models[path.name] = about | {"curve": curve.name} | ends(spec_of(stored), stored["box"])
    thesis = {"visits": THESIS_VISITS, "weights": sum(layer["trainable"] for layer in thesis_layers())}
    options = {"trim_blocks": True, "keep_trailing_newline": True, "undefined": jinja2.StrictUndefined}
    template = jinja2.Environment(**options).from_string((MODELS / "README.md.j2").read_text(encoding="utf-8"))
    page = template.render(models=models, thesis=thesis, recipes=recipes())
    write_bytes(MODELS / "README.md", page.encode())
    write_bytes(MODELS / "registry.json", (json.dumps(registry, indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
