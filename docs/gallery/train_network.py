"""Train a tiny network.

For those who train networks: the program makes four short simulations, and trains a network of a few thousand weights
for two epochs. The same call with the settings of `models/README.md` makes the networks that are shipped. If a training
is stopped, start the program again: the training then goes on.
"""

import deep_contact as dc
from deep_contact.cnn import Store, train, write_simulation
from deep_contact.cnn.training import TrainingConfig

for sim in range(4):
    scene = dc.circles_in_box(n_bodies=25, size=16.0, seed=10 + sim)
    write_simulation(
        f"sim_{sim:04d}.h5", dc.experiments.solved_states(scene, steps=150, every=2)
    )
print(f"{len(Store('.'))} states")

config = TrainingConfig(
    options={"width": 4},
    fractions=(0.5, 0.25, 0.25),
    epochs=2,
    states_per_epoch=48,
    validation_states=24,
)
done = train(config, ".", "run", held_out=24)
for line in done.history:
    print(
        f"epoch {line['epoch'] + 1}: loss {line['loss']:.3f}, validation {line['validation_loss']:.3f}"
    )

state = Store(".").state(3, 30)
normal, tangent = dc.load_model("run/model.h5").predict(state)
print(f"predicted for {normal.size} contacts; mean λ_n {normal.mean():.3f} N·s")
print(f"solved: mean λ_n {state.contacts.normal_impulse.mean():.3f} N·s")
