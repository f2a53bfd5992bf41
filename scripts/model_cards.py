"""python scripts/model_cards.py: write models/README.md, registry.json and learning curves from the model files."""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

MODELS = Path(__file__).resolve().parent.parent / "models"
ABOUT = {
    "model.h5": "The model that `dc.load_model()` gives, the far-field network: it corrects Builtin's start by a "
    "coarse image of stress (`deep_contact/cnn/far_field.py`), in a box of any size, and was trained through the "
    "solver.",
    "no_past.h5": "The network of the start `learned support`, for piles whose contacts carry no impulses: it corrects "
    "`warm_start.Support`, which the table below calls builtin. Data: `python scripts/generate_data.py --packings`.",
    "thesis_factored.h5": "The thesis's network, its last layer factored to fit into the repository.",
}
HEAD = """# Models

Made by `python scripts/model_cards.py` from the files themselves. `dc.load_model(name)` or `dc.load_model(path)` opens
each with every Keras from 3.4 on, checks it, and never runs code from it; the far-field networks need no Keras at all.
Plain `keras.models.load_model(path, compile=False)` opens them as well (thesis_factored.h5 from Keras 3.15 on).
`registry.json` has the SHA-256 of every file and the command that made it. The environment variable
`DEEP_CONTACT_MODELS` names another folder with the same files.

Errors are ‖v − v*‖ / ‖v* − v⁻‖ in the norm of kinetic energy, in the mean over states of simulations that were used
neither for training nor for choosing the epoch; phases as in `data/README.md`.

thesis_factored.h5 was trained in half precision, and the matrix of its last layer (244 MB) was replaced by a product of
rank 170 that changes the outputs on 2,000 training states least (`factor_thesis_network.py`). Commit 3b4f18f is the
last to have both; the network's command without `--precision` trains it in float32. Its data are those of
`scripts/generate_data.py` before the engine's sweep changed its order of operations: the same command now gives runs
that part from them by rounding, with another hash. Those of the far-field networks are
`python scripts/generate_data.py --simulations 400 --out data/generated/large`.

`comparison/` holds networks that were trained on a small budget, alike but for their width: Figure 6.4.
"""


def card(path: Path) -> str:
    """One model's section. Draws its learning curve beside the file."""
    from deep_contact.cnn.inference import ends
    from deep_contact.cnn.model_file import read_metadata, spec_of
    from deep_contact.cnn.training.curve import learning_curve

    stored = read_metadata(path)
    found, spec = stored["card"], spec_of(stored, path)
    history, best, errors = found["history"], found["best_epoch"], found["held_out"]
    rows = {
        "architecture": found["architecture"],
        "weights": found["parameters"],
        **ends(spec, stored["box"]),
        "size": f"{path.stat().st_size / 1e6:.1f} MB",
        "command": f"`{found['command']}`",
        "trained on": f"{found['training_states']:,} states",
        "data": f"`{found['data_hash']}`",
        "seed": found["seed"],
        "time": f"{found['seconds'] / 60:.0f} minutes on {found['cpu']}",
        "epochs": f"{len(history)}, the best is {best + 1}",
        "loss": f"{history[best]['validation_loss']:.4g}",
        "states shown": visits(found),
        "rank": found.get("factored", {}).get("rank"),
    }
    curve = learning_curve(history, path.with_name(f"{path.stem}_history.png"))
    lines = [f"## {path.name}", "", ABOUT[path.name], "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in rows.items() if value is not None]
    after = " | ".join(f"after {k} sweeps" for k in errors["sweeps"])
    lines += ["", f"![learning curve]({curve.name})", "", f"| phase | states | start | {after} |"]
    lines += ["|---" * (3 + len(errors["sweeps"])) + "|"]
    for phase, by_start in errors["phases"].items():
        for start in (name for name in by_start if name != "states"):
            cells = " | ".join(f"{value:.3f}" for value in by_start[start]["mean"])
            lines.append(f"| {phase} | {by_start['states']} | {start} | {cells} |")
    return "\n".join([*lines, ""])


def visits(found: dict) -> str | None:
    """States shown in training, each as often as it was; for the thesis's network beside those of the thesis."""
    from deep_contact.studies.chapter_5 import THESIS_VISITS

    count = (found["config"]["states_per_epoch"] or 0) * len(found["history"])
    share = f", 1/{THESIS_VISITS / count:.2g} of the thesis's training" if found["architecture"] == "thesis" else ""
    return f"{count:,}{share}" if count else None


def entry(path: Path) -> dict:
    """One model's entry in the registry."""
    from deep_contact.cnn.model_file import read_metadata

    found = read_metadata(path)["card"]
    return {
        "file": path.relative_to(MODELS).as_posix(),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "command": found["command"],
        "data": found["data_hash"],
    }


def main(arguments=None) -> None:
    """Write the page and the registry."""
    argparse.ArgumentParser(description=__doc__).parse_args(arguments)
    from deep_contact.io.files import write_bytes

    cards = [card(MODELS / name) for name in ABOUT if (MODELS / name).exists()]
    files = sorted(MODELS.rglob("*.h5"), key=lambda path: (path.parent != MODELS, path.name))
    entries = {path.relative_to(MODELS).with_suffix("").as_posix(): entry(path) for path in files}
    texts = {"README.md": "\n".join([HEAD, *cards]), "registry.json": json.dumps(entries, indent=1) + "\n"}
    for name, text in texts.items():
        write_bytes(MODELS / name, text.encode())


if __name__ == "__main__":
    main()
