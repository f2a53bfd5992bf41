"""Put any Keras model between a state and its impulses.

For those who train networks of their own: a `LearnedModel` is a Keras model and the description of its images. `input`
makes the image of a state. Then the Keras model is called with this image, as any Keras model is. `impulses` reads the
output image of the model at the contacts, and returns the impulses.
"""

import deep_contact as dc
from deep_contact.cnn import ImageSpec, LearnedModel

# the same as `import keras`, without TensorFlow's log
from deep_contact.cnn.backend import keras

keras.utils.set_random_seed(0)
field = [
    keras.layers.Conv2D(8, 3, padding="same", activation="relu"),
    keras.layers.Conv2D(2, 3, padding="same"),
]
# 5 channels in, λ_n and λ_t out; not trained
mine = keras.Sequential([keras.Input((None, None, 5)), *field])

state = dc.read_state(dc.sample_file("impact_154"))
# the thesis's channels, d = h = 0.5 m
net = LearnedModel(source=mine, spec=ImageSpec())
x = net.input(state)  # (61, 61, 5)
y = mine(x[None])  # (1, 61, 61, 2)
# λ_n and λ_t of each contact, N·s, within the friction cone
normal, tangent = net.impulses(state, y)
print(f"image {x.shape}, output {tuple(y.shape)}, {normal.size} contacts")

thesis = dc.load_model()  # the thesis's network, which is shipped, goes the same way
y = thesis.network(thesis.input(state)[None])
normal, tangent = thesis.impulses(state, y)
solved = dc.solve_contacts(state, solver=dc.PGS(), start=(normal, tangent))
print(
    f"mean λ_n {normal.mean():.2f} N·s by the network, {solved.normal_impulses.mean():.2f} N·s solved"
)

try:
    thesis.impulses(state, y[:, :100])
except ValueError as error:
    print(error)
