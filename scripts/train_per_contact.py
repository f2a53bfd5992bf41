"""python scripts/train_per_contact.py: train the perceptron of `warm_start="learned"`, from nothing to models/.

`--seeds 5` trains five, one after the other, and keeps that of the middle ratio on held-out states of its own runs.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import deep_contact as dc
from deep_contact.cnn.per_contact import save
from deep_contact.cnn.training.per_contact_run import FRICTION_OMEGA, OMEGA, PerContactConfig, train

ROOT = Path(__file__).resolve().parent.parent


def main(arguments=None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "models" / "per_contact.json")
    parser.add_argument("--seeds", type=int, default=5)
    for name in ("rounds", "scenes", "states", "largest", "sweeps", "epochs"):
        parser.add_argument(f"--{name}", type=int, default=getattr(PerContactConfig, name))
    options = vars(parser.parse_args(arguments))
    out, seeds = options.pop("out"), options.pop("seeds")
    found = []
    for seed in range(seeds):
        config = PerContactConfig(seed=seed, **options)
        network, history = train(dc.simulate, config, tell=lambda text, seed=seed: print(f"seed {seed}, {text}"))
        found.append((history["rounds"][-1]["own_held_out"], network, history, config))
    spread = sorted(ratio for ratio, *_ in found)
    middle = spread[len(spread) // 2]
    _, network, history, config = next(one for one in found if one[0] == middle)
    card = {
        "command": "python scripts/train_per_contact.py",
        "solver": f"PSOR(omega={OMEGA}, friction_omega={FRICTION_OMEGA})",
        "config": asdict(config),
        "rounds": history["rounds"],
        "own_held_out_of_all_seeds": spread,
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    save(out, network, card)
    print(json.dumps({"seed": config.seed, "own_held_out": spread}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
