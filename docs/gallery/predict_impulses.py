"""Load model.h5 and predict the impulses of a state.

For those who want the network: `dc.load_model()` reads the file `models/model.h5`, which is shipped. No code in this
file is run. `predict` returns one normal and one tangent impulse for each contact, within the friction cone. The solver
then starts from these impulses.
"""

import deep_contact as dc
from deep_contact.cnn.evaluation import velocity_errors

# a solved state of a simulation that no training has seen
state = dc.read_state(dc.sample_file("impact_253"))
contacts = state.contacts
assert contacts is not None  # the file of an unsolved scene may have none
model = dc.load_model()
normal, tangent = model.predict(state)
print(
    f"{contacts.count} contacts; the network was trained on {model.card['training_states']:,} states"
)

builtin = contacts.normal_start, contacts.tangent_start
for name, start in (("builtin", builtin), ("network", (normal, tangent))):
    errors = ", ".join(
        f"{error:.3f}" for error in velocity_errors(state, start, (3, 10, 30))
    )
    print(f"{name}: velocity error after 3, 10 and 30 sweeps {errors}")

figure, ax = dc.plotting.subplots(size=(4.5, 4.5))
ax.plot(
    contacts.normal_impulse,
    contacts.normal_start,
    "s",
    label="Builtin",
    markersize=4,
    color=dc.plotting.VERMILION,
)
ax.plot(
    contacts.normal_impulse,
    normal,
    "o",
    label="network",
    markersize=4,
    color=dc.plotting.PURPLE,
)
ax.axline((0, 0), slope=1, color=dc.plotting.GREY, linewidth=1)
dc.plotting.label_axes(ax, "solved λ_n", "start", x_unit="N·s", y_unit="N·s")
ax.legend()
dc.plotting.save(figure, "predict_impulses.png")
