"""Leave out what a scene does not need.

For engine builders: `dc.plan` says which parts of the model a run uses, which parts it leaves out, and why. With
`sleep=True`, heaps that rest are not solved. With `islands=True`, the sweeps of each heap stop on their own, when this
heap is solved.
"""

import time

import deep_contact as dc

# falls into many heaps
scene = dc.circles_in_box(n_bodies=80, size=(200.0, 30.0), sigma_coef=5.0, seed=1)
print(dc.plan(scene, sleep=True), end="\n\n")

ways = [
    ("as it comes", dc.PGS(), False),
    ("islands", dc.PGS(islands=True), False),
    ("sleep", dc.PGS(), True),
]
for name, solver, sleep in ways:
    dc.simulate(scene, steps=1, solver=solver, sleep=sleep)  # compile
    begin = time.perf_counter()
    run = dc.simulate(scene, steps=800, solver=solver, sleep=sleep)
    took = time.perf_counter() - begin
    print(
        f"{name:12s} {run.relaxations.sum():12,} relaxations of contacts, {1e3 * took:6.0f} ms"
    )

figure, ax = dc.plotting.subplots()
dc.plotting.draw_state(ax, run.state)
dc.plotting.save(figure, "plan_and_sleep.png")
