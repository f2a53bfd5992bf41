"""Trade sweeps for accuracy: methods on one pile.

For solver researchers: the picture shows the velocity error of a step against the number of sweeps. All methods begin
from Builtin's start. The error is measured against an exact solution, which is found by pivoting. To compare a new
method, add one line to `solvers`.
"""

import numpy as np

import deep_contact as dc
from deep_contact.analysis import velocity_error

scene = dc.circles_in_box(n_bodies=60, size=24.0, seed=3)
state = dc.simulate(scene, steps=150, solver=dc.PGS()).state
exact = dc.solve_exactly(state)
print(f"exact solution: residual {exact.residual:.1e} m/s after {exact.pivots} pivots")

budgets = np.unique(np.geomspace(1, 300, 16).astype(int))
solvers = {
    "PGS": dc.PGS,
    "PSOR, ω = 1.3": dc.PSOR,
    "NNCG": dc.NNCG,
    "NesterovPGS": dc.NesterovPGS,
}
figure, ax = dc.plotting.subplots()
for name, method in solvers.items():
    solutions = [
        dc.solve_contacts(state, solver=method(sweeps=int(k), tolerance=None))
        for k in budgets
    ]
    errors = [velocity_error(state, solution, exact.solution) for solution in solutions]
    ax.loglog(budgets, errors, marker="o", markersize=3, label=name)
    print(f"{name:15s} error after {budgets[-1]} sweeps: {errors[-1]:.1e}")
dc.plotting.label_axes(ax, "sweeps", "velocity error")
ax.legend()
dc.plotting.save(figure, "sweeps_for_accuracy.png")
