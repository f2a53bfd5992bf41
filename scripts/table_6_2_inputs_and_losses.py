"""python scripts/table_6_2_inputs_and_losses.py: inputs and losses of the far-field network.

The networks of models/comparison were trained alike but for the one setting that names them; this needs no training.
"""

from deep_contact.cnn.inference import network_file
from deep_contact.cnn.model_file import read_metadata
from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies import learned_starts
from deep_contact.studies.learned_starts import CLASSICAL, FEW, cells_of, ratios_to_builtin

NETWORKS = {
    "width_24": ("bodies and contact rows", "velocities after 3, 10, 30 sweeps"),
    "contacts": ("contact rows", "velocities after 3, 10, 30 sweeps"),
    "bodies": ("bodies, as the thesis", "velocities after 3, 10, 30 sweeps"),
    "no_correction": ("bodies and contact rows", "the same, from zero instead of from Builtin"),
    "no_sweep": ("bodies and contact rows", "velocities before any sweep"),
    "impulses": ("bodies and contact rows", "λ"),
    "residual": ("bodies and contact rows", "residual after 3, 10, 30 sweeps, without labels"),
}
"""Name of the file -> inputs, and what the loss is on."""

PLAIN = "width_24"
"""The network that the others differ from, each in one setting."""


def compute(options, seed, jobs, progress):
    """Every network's start on the same states of held-out scenes."""
    paths = {name: f"{options['folder']}/{name}.h5" for name in NETWORKS}
    starts = dict(zip(CLASSICAL, CLASSICAL)) | {name: {"model": path} for name, path in paths.items()}
    settings = {"seed": seed + 40_000, "jobs": jobs, "progress": progress, "with_all": [*CLASSICAL, PLAIN]}
    (scenes,) = learned_starts.errors_on_scenes(starts, options, **settings)
    budget = {}
    for name, path in paths.items():
        card = read_metadata(network_file(path))["card"]
        budget[name] = {"parameters": card["parameters"], "epochs": len(card["history"])}
        budget[name] |= {"states_per_epoch": card["config"]["states_per_epoch"], "command": card["command"]}
    return {"after": options["after"], "scenes": scenes, "budget": budget}


def claims(data):
    few = [data["after"].index(k) for k in FEW]
    found = {name: ratios_to_builtin(data["scenes"], name, "off")[few, 0] for name in NETWORKS}
    goals = {
        "with contact rows the network is better than with the thesis's inputs, at 3, 10 and 30 sweeps": ("bodies",),
        "a correction of Builtin is better than λ from zero": ("no_correction",),
        "velocities after sweeps are a better loss than λ, or velocities before any": ("impulses", "no_sweep"),
        "labels are worth their price: the residual alone teaches less": ("residual",),
    }
    for text, others in goals.items():
        holds = all((found[PLAIN] < found[name]).all() for name in others)
        yield Claim(text, None, holds, {name: found[name].tolist() for name in (PLAIN, *others)})
    ratios = learned_starts.ratios_to_best(data["scenes"], PLAIN, "off")[few]
    measured = {f"after {k} sweeps": ratio for k, ratio in zip(FEW, ratios.tolist())}
    text = "the network leaves less error than the best classical setting (95 %), its price left out"
    yield Claim(text, None, bool(ratios[:, 2].max() < 1), measured)


def best_ratios(data, starts):
    """Errors of the best setting of some starts over those of PGS from Builtin, where that is off."""
    builtin = learned_starts.mean_errors(data["scenes"], "builtin", "off")
    return learned_starts.ratios_of(learned_starts.best_errors(data["scenes"], starts, "off"), builtin)


def table(data):
    rows = [["inputs", "loss on", "weights", *(f"after {k} sweeps" for k in data["after"])]]
    for name, (inputs, loss) in NETWORKS.items():
        cells = cells_of(ratios_to_builtin(data["scenes"], name, "off"))
        rows.append([inputs, loss, data["budget"][name]["parameters"], *cells])
    plain = data["budget"][PLAIN]["parameters"]
    rows.append(["the first, its best solver", "", plain, *cells_of(best_ratios(data, [PLAIN]))])
    rows.append(["best classical setting", "", 0, *cells_of(best_ratios(data, CLASSICAL))])
    rows.append(["which one", "", None, *learned_starts.best_settings(data["scenes"], CLASSICAL, "off")])
    return rows


OPTIONS = {"scenes": 20, "steps": 600, "every": 5, "after": [0, 3, 10, 30], "folder": "models/comparison"}
QUICK = {"scenes": 2, "every": 15, "steps": 300}
FIGURE = Figure("T 6.2", "Inputs and losses of the far-field network on equal budgets", compute, table, claims=claims,
                options=OPTIONS, quick=QUICK, digits=4)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
