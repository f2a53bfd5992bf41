"""python scripts/model_cards.py: write models/README.md, registry.json and learning curves from the model files."""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

MODELS = Path(__file__).resolve().parent.parent / "models"


def main(arguments=None) -> None:
    """Write the page, by models/README.md.j2, and the registry."""
    argparse.ArgumentParser(description=__doc__).parse_args(arguments)
    import jinja2

    from deep_contact.cnn.inference import ends
    from deep_contact.cnn.model_file import read_metadata, spec_of
    from deep_contact.cnn.training.curve import learning_curve
    from deep_contact.io.files import write_bytes
    from deep_contact.studies.chapter_5 import THESIS_VISITS

    models, registry = {}, {}
    for path in sorted(MODELS.glob("*.h5")):
        stored = read_metadata(path)
        card = stored["card"]
        registry[path.stem] = {
            "file": path.name,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
            "command": card["command"],
            "data": card["data_hash"],
        }
        curve = learning_curve(card["history"], path.with_name(f"{path.stem}_history.png"))
        about = {"card": card, "size": path.stat().st_size, "curve": curve.name}
        models[path.name] = about | ends(spec_of(stored), stored["box"])
    options = {"trim_blocks": True, "keep_trailing_newline": True, "undefined": jinja2.StrictUndefined}
    template = jinja2.Environment(**options).from_string((MODELS / "README.md.j2").read_text(encoding="utf-8"))
    write_bytes(MODELS / "README.md", template.render(models=models, thesis_visits=THESIS_VISITS).encode())
    write_bytes(MODELS / "registry.json", (json.dumps(registry, indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
