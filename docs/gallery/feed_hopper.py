"""Measure a hopper that feeds a belt.

For users of granular media: circles of mixed radii fall through a funnel of 40 segments onto a belt. This program has
in one place what the recipes have. It writes a page that plays the run, and reads forces, neighbours, and the load on
the belt over time. It adds circles, and stops a run by a condition. It writes a state to a file, and a run goes on from
this file. Runs with several seeds give the load its standard error.
"""

import numpy as np

import deep_contact as dc

x, y = np.linspace(0.0, 13.0, 21), np.linspace(24.0, 12.0, 21)
left, right = np.column_stack([x, y]), np.column_stack([30.0 - x, y])
funnel = [segment for side in (left, right) for segment in zip(side, side[1:])]
belt, speeds = ((4.0, 2.0), (26.0, 2.0)), [0.0] * 40 + [3.0]
world = dc.World(box=(0, 0, 30, 50), segments=[*funnel, belt], surface_speeds=speeds)


def filled(seed):
    """500 circles above the funnel."""
    grid = np.stack(np.meshgrid(np.linspace(1, 29, 25), np.linspace(25, 47, 20)), -1)
    radius = np.random.default_rng(seed).uniform(0.3, 0.5, 500)
    bodies = dc.make_bodies(grid.reshape(-1, 2), radius=radius)
    return dc.State(name="feeder", world=world, bodies=bodies)


run = dc.simulate(filled(0), steps=600, record=10, forces=True)
run.trajectory.film("feed_hopper.html")
load = -run.force_on("segment", 40)[:, 1]  # on the belt, N
print("touching circle 0:", dc.neighbours(run.state, 0))
print("pressure on the floor, N/m:", -run.force_on("floor")[-1, 1] / 30.0)
print("largest contact force, N:", np.hypot(*dc.forces(run.state).contact.T).max())
more = run.state.with_bodies(add=dc.make_bodies([[10.0, 40.0], [20.0, 40.0]]))
run = dc.simulate(
    more, until=lambda state: (state.bodies.position[:, 1] > 12).sum() < 300
)
print(f"fewer than 300 above the hole after {run.state.time:g} s")
dc.write_state("feeder.xml", run.state)
again = dc.simulate(dc.read_state("feeder.xml"), steps=100)
scenes = [filled(seed) for seed in range(50)]
runs = dc.simulate_many(scenes, steps=300, record=100, forces=True)
last = np.array([-one.force_on("segment", 40)[-1, 1] for one in runs])
print(
    f"on the belt from 2 to 3 s: {last.mean():.0f} ± {last.std(ddof=1) / 50**0.5:.0f} N"
)
figure, (ax, scene) = dc.plotting.subplots(1, 2)
ax.plot(0.1 * np.arange(1, 61), load)
dc.plotting.label_axes(ax, "time", "load on the belt", x_unit="s", y_unit="N")
dc.plotting.draw_state(scene, again.state)
dc.plotting.save(figure, "feed_hopper.png")
