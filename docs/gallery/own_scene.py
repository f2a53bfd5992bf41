"""Simulate circles of your own, from NumPy arrays.

For those who have positions from a program, a measurement or an idea: a state is a world and its bodies. Here 120
circles of three sizes fall in two jets onto a ramp. Each argument that is left out has a default. An argument with a
wrong value raises an error, whose message names the field and the value.
"""

import numpy as np

import deep_contact as dc

rng = np.random.default_rng(1)
n = 120
jet = np.arange(n) % 2  # 0: from the left, 1: from the right
# centres, m
position = np.column_stack([np.where(jet, 14.0, 6.0), 8.0 + 1.1 * (np.arange(n) // 2)])
position[:, 0] += rng.uniform(-0.2, 0.2, n)
velocity = np.column_stack([np.where(jet, -3.0, 3.0), np.full(n, -5.0)])  # m/s
bodies = dc.make_bodies(
    position, radius=rng.choice([0.25, 0.35, 0.45], n), velocity=velocity, density=2.0
)
world = dc.World(
    box=(0.0, 0.0, 20.0, 80.0), friction=0.3, segments=[((4.0, 6.0), (10.0, 3.0))]
)
scene = dc.State(name="two jets", world=world, bodies=bodies)

run = dc.simulate(scene, steps=400, accuracy="fast", record=5)
print(dc.recommend(scene, accuracy="fast"))
print(run)

run.trajectory.film("own_scene.html", colour=[jet] * len(run.trajectory))
# In a notebook, `run.trajectory` as the last line of a cell plays the run.
figure, axes = dc.plotting.subplots(1, 3)
for ax, i in zip(axes, (0, 25, -1)):
    state = run.trajectory[i]
    dc.plotting.draw_state(ax, state)
    ax.set(title=f"{state.time:.2f} s", ylim=(0.0, 30.0))
dc.plotting.save(figure, "own_scene.png")
