"""Trade the time step for penetration.

For engine builders: the same pile falls for two seconds with each of four time steps, with 10 sweeps a step. A smaller
time step costs more steps and leaves less overlap. The unit of the overlap is the slop, here 5 mm. The slop is the
overlap that position correction leaves on purpose.
"""

import time

import numpy as np

import deep_contact as dc

scene = dc.circles_in_box(n_bodies=80, size=26.0, seed=4)
solver = dc.PGS(sweeps=10, tolerance=None)
dc.simulate(scene, steps=1, solver=solver)  # compile
rows = []
for dt in (0.02, 0.01, 0.005, 0.0025):
    depth: list[float] = []

    def measure(state, record, depth=depth):
        """Keep the deepest overlap."""
        depth.append(-min(state.contacts.separation.min(initial=0.0), 0.0) / 0.005)

    begin = time.perf_counter()
    dc.simulate(scene, steps=round(2.0 / dt), dt=dt, solver=solver, on_step=measure)
    rows.append((dt, max(depth), np.mean(depth), 1e3 * (time.perf_counter() - begin)))
    print(
        "Δt {:6.4f} s: deepest {:6.1f} slops, mean of steps {:5.2f}, {:4.0f} ms".format(
            *rows[-1]
        )
    )

steps, deepest, mean, _ = zip(*rows)
figure, ax = dc.plotting.subplots()
ax.loglog(steps, deepest, "o-", label="deepest of the run")
ax.loglog(steps, mean, "s-", label="deepest of a step, mean")
dc.plotting.label_axes(ax, "Δt", "overlap", x_unit="s", y_unit="slops")
ax.legend()
dc.plotting.save(figure, "time_step.png")
