"""python scripts/model_cards.py: write models/README.md, registry.json and learning curves from the model files."""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

MODELS = Path(__file__).resolve().parent.parent / "models"


def about(path: Path, stored: dict) -> dict:
    """What the page says of a model beside its card. Draws its learning curve beside the file."""
    from deep_contact.cnn.inference import ends
    from deep_contact.cnn.model_file import spec_of
    from deep_contact.cnn.training.curve import learning_curve

    curve = learning_curve(stored["card"]["history"], path.with_name(f"{path.stem}_history.png"))
    card = {"card": stored["card"], "size": path.stat().st_size, "curve": curve.name}
    return card | ends(spec_of(stored), stored["box"])


def main(arguments=None) -> None:
    """Write the page, by models/README.md.j2, and the registry."""
    argparse.ArgumentParser(description=__doc__).parse_args(arguments)
    import jinja2

    from deep_contact.cnn.model_file import read_metadata
    from deep_contact.io.files import write_bytes
    from deep_contact.studies.chapter_5 import THESIS_VISITS

    models, registry = {}, {}
    for path in sorted(MODELS.glob("*.h5")):
        stored = read_metadata(path)
        registry[path.stem] = {
            "file": path.name,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            "command": stored["card"]["command"],
            "data": stored["card"]["data_hash"],
        }
        models[path.name] = about(path, stored)
    options = {"trim_blocks": True, "keep_trailing_newline": True, "undefined": jinja2.StrictUndefined}
    template = jinja2.Environment(**options).from_string((MODELS / "README.md.j2").read_text(encoding="utf-8"))
    write_bytes(MODELS / "README.md", template.render(models=models, thesis_visits=THESIS_VISITS).encode())
    write_bytes(MODELS / "registry.json", (json.dumps(registry, indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
