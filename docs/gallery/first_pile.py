"""Drop a pile and watch the solver work.

For engine builders: this is the smallest useful program. It drops 60 circles into a box, solves 200 steps, and reads
how many sweeps each step took. `on_step` is called after every step, with the solved state and the record of its
sweeps.
"""

import numpy as np

import deep_contact as dc

scene = dc.circles_in_box(n_bodies=60, size=24.0, seed=1)
speed: list[float] = []  # m/s


def measure(state, record):
    """Keep the mean speed of the circles."""
    speed.append(np.linalg.norm(state.bodies.velocity, axis=1).mean())


run = dc.simulate(scene, steps=200, dt=0.01, solver=dc.PGS(sweeps=100), on_step=measure)
print(
    f"{run.state.bodies.count} circles, {run.state.contacts.count} contacts at t = {run.state.time:.2f} s"
)
print(f"sweeps a step: mean {run.sweeps.mean():.0f}, largest {run.sweeps.max()}")
for reason, count in zip(*np.unique(run.status, return_counts=True)):
    print(f"{count} steps ended with {reason}")

figure, (left, right) = dc.plotting.subplots(1, 2)
dc.plotting.draw_state(left, run.state)
right.plot(0.01 * np.arange(200), speed)
dc.plotting.label_axes(right, "time", "mean speed", x_unit="s", y_unit="m/s")
dc.plotting.save(figure, "first_pile.png")
