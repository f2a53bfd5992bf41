"""Make a data set, read it, and look at its images.

For those who train networks: `write_simulation` writes a simulation as one HDF5 file, which has every state with its
solved impulses. A `Store` reads a folder of such files. `input_image` makes the image that enters a network, and
`label_image` makes the image that the network should predict.
"""

import deep_contact as dc
from deep_contact.cnn import (
    ImageSpec,
    Store,
    input_image,
    label_image,
    phase,
    write_simulation,
)

for sim in range(2):
    scene = dc.circles_in_box(n_bodies=25, size=16.0, seed=sim)
    write_simulation(
        f"sim_{sim:04d}.h5", dc.experiments.solved_states(scene, steps=150)
    )

store = Store(".")
print(
    f"simulations {store.simulations}, {len(store)} states, hash {store.data_hash()[:12]}…"
)
for name in ("impact", "settling", "rest"):
    print(f"{name}: {len(store.states(phases=name))} states")

state = store.state(1, 40)  # to the last bit the state that was written
spec = ImageSpec()  # the thesis's channels, d = h = 0.5 m
inputs, labels = input_image(state, spec), label_image(state, spec)
print(
    f"a state of phase {phase(state)!r}: input {inputs.shape}, label {labels.shape}, {inputs.dtype}"
)

figure, axes = dc.plotting.subplots(1, 3)
names = [*spec.channels[:2], "λ_n"]
for ax, name, image in zip(
    axes, names, (inputs[..., 0], inputs[..., 1], labels[..., 0])
):
    ax.imshow(image, origin="lower")
    ax.set_title(name)
    ax.grid(False)
dc.plotting.save(figure, "data_set.png")
