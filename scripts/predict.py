"""python scripts/predict.py STATE.xml… [--model model] [--out predictions]: predict the impulses of states.

Three files are written for each state file. <out>/<name>.csv has the predicted impulses at the contacts, and, if the
state file has them, the impulses of the step before (called Builtin) and the solved impulses. <out>/<name>.npy has the
network's output image, of impulses or of the coefficients that correct a start. <out>/<name>.png shows the impulses in
the scene.

The default model is "model", our copy of the thesis's network. It takes boxes of 30 m × 30 m, and needs Keras. "far
field" takes any box, and corrects the impulses of the step before. "far field, no past" is for files without such
impulses, and corrects the start "support". Predictions are projected on the friction cone. If the file has the
solution, the velocity errors after some sweeps of the solver are printed, from the prediction and from the uncorrected
start.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import numpy as np

import deep_contact as dc
from deep_contact.__main__ import status_of
from deep_contact.cnn.backend import one_thread
from deep_contact.cnn.evaluation import SWEEPS, velocity_errors
from deep_contact.cnn.inference import FarFieldModel, load_model
from deep_contact.io.argument_parser import Parser
from deep_contact.io.files import replacing
from deep_contact.plot import plotting


def contact_table(state, predicted, file) -> None:
    """Write a CSV with a row for each contact: its bodies, point, normal and impulses.

    The impulses are the predicted ones and, if the state has them, those of the step before ("builtin") and the solved
    ones. predicted: (λ_n, λ_t), (m,) each, N·s. file: open text file.
    """
    c = state.contacts
    columns = dict(zip("body_a body_b x y n_x n_y".split(), [c.body_a, c.body_b, *c.position.T, *c.normal.T]))
    columns |= dict(zip(("predicted_n", "predicted_t"), predicted))
    if c.have_past:
        columns |= {"builtin_n": c.normal_start, "builtin_t": c.tangent_start}
    if state.solved:
        columns |= {"solved_n": c.normal_impulse, "solved_t": c.tangent_impulse}
    writer = csv.writer(file, lineterminator="\n")
    writer.writerows([[*columns], *zip(*(column.tolist() for column in columns.values()))])


def picture(state, predicted):
    """Draw a state with its predicted impulses and, in a second panel, with its solved ones if it has them."""
    drawn = state.contacts._replace(normal_impulse=np.maximum(predicted[0], 0.0), tangent_impulse=predicted[1])
    shown = {"predicted": state.replace(contacts=drawn)} | ({"solved": state} if state.solved else {})
    largest = max(float(one.contacts.normal_impulse.max(initial=0.0)) for one in shown.values())
    figure, axes = plotting.subplots(1, len(shown), size=(4.2 * len(shown), 3.9), squeeze=False)
    for (name, one), ax in zip(shown.items(), axes[0]):
        plotting.draw_state(ax, one, largest_impulse=largest)
        ax.set_title(f"{name}: impulses at the contacts")
    return figure


def report(state, predicted, builtin: str) -> list[str]:
    """Return lines of text on a state: the range of its predicted impulses, and errors of its velocities.

    The errors are those after some sweeps from the predicted impulses, and from the start that the state carries.
    predicted: (λ_n, λ_t), (m,) each, N·s. builtin: name of the start that the state carries.
    """
    contacts = state.contacts
    lines = [f"{state.name}, step {state.step}: {state.bodies.count} circles, {contacts.count} contacts"]
    lines.append(f"  predicted λ_n from {predicted[0].min():.4g} to {predicted[0].max():.4g} N·s")
    if state.solved:
        lines.append(f"  error of the velocities after {', '.join(map(str, SWEEPS))} sweeps of PGS, relative")
        starts = {"from the network": predicted, builtin: (contacts.normal_start, contacts.tangent_start)}
        for name, start in starts.items():
            lines.append(f"    {name:18s}" + "".join(f"{e:9.4f}" for e in velocity_errors(state, start)))
    return lines


def predict_file(path: Path, model, out: Path, *, pictures: bool = True) -> list[str]:
    """Predict the impulses of the state in a file, write the results, and return the lines to print.

    path: path of the state file. model: a `LearnedModel`. out: folder of the results. pictures: whether to draw.
    """
    state = dc.read_state(path)
    if state.contacts is None:
        state = dc.find_contacts(state)
    if state.contacts.count == 0:
        return [f"{path}: no contacts, nothing to predict"]
    seen, builtin, lines = state, "from the last step", []
    if isinstance(model, FarFieldModel) and not state.contacts.have_past:
        # As in `warm_start.FarFieldNoPast`: a network for contacts without a past corrects the start `Support`.
        impulses = dict(zip(("normal_start", "tangent_start"), dc.warm_start.Support()(state, None)))
        seen, builtin = state.replace(contacts=state.contacts._replace(**impulses)), "from the support"
        lines = ["  no impulses of a step before: the network corrects the start support"]
    predicted = model.predict(seen)
    name = path.name.removesuffix(".gz").removesuffix(".xml")
    with replacing(out / f"{name}.csv") as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        contact_table(state, predicted, file)
    with replacing(out / f"{name}.npy") as temporary:
        np.save(temporary, model.predict_image(seen), allow_pickle=False)
    if pictures:
        with plotting.style():
            plotting.save(picture(state, predicted), out / f"{name}.png")
    return [*report(seen, predicted, builtin), *lines, f"  {out / name}.csv, .npy{', .png' if pictures else ''}"]


def main(argv=None) -> int:
    """Run the command line. Returns the exit status. The error of a faulty file does not stop the other predictions."""
    about = (__doc__ or "").partition(": ")[2]
    parser = Parser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("states", nargs="+", type=Path, metavar="STATE.xml", help="state files")
    add("--model", default=None, help='a file, "model" (the default), "far field" or "far field, no past"')
    add("--out", type=Path, default=Path("predictions"), help="folder for the results")
    add("--no-pictures", action="store_true", help="numbers only")
    args = parser.parse_args(argv)
    try:
        one_thread()
        model = load_model(args.model)
        args.out.mkdir(parents=True, exist_ok=True)
    except (ModuleNotFoundError, OSError, ValueError) as error:
        parser.exit(status_of(error), f"{parser.prog}: {error}\n")
    status = 0
    for path in args.states:
        try:
            print("\n".join(predict_file(path, model, args.out, pictures=not args.no_pictures)))
        except (OSError, ValueError) as error:
            status = status_of(error)
            print(f"{parser.prog}: {error}", file=sys.stderr)
    return status


if __name__ == "__main__":
    raise SystemExit(main())
