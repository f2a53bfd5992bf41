"""Write a warm start of your own.

For solver researchers: a start is any function of a state and the solver's options that returns two impulses for each
contact. The start of this program damps Builtin: it multiplies the impulses of the step before by a number α. Of all
numbers from 0 to 1, α leaves the least kinetic energy. Finding α is an exact line search, which costs about one sweep.
Judge a start in two ways: on given states, and along a run of its own.
"""

import numpy as np

import deep_contact as dc
from deep_contact.analysis import contact_problem


def line_search(state, solver):
    """α Builtin with α = −b·λ / λ·A λ, cut to 0 … 1 (A and b of Eq 2.27, rows in pairs: normal, tangent)."""
    problem = contact_problem(state)
    carried = np.column_stack(
        [state.contacts.normal_start, state.contacts.tangent_start]
    ).ravel()
    curvature = carried @ (problem.A @ carried)
    alpha = (
        np.clip(-(problem.b @ carried) / curvature, 0.0, 1.0) if curvature > 0 else 0.0
    )
    return alpha * carried[0::2], alpha * carried[1::2]


scene = dc.circles_in_box(n_bodies=50, size=22.0, seed=6)
starts: dict[str, dc.warm_start.Start] = {
    "none": None,
    "builtin": "builtin",
    "line search": line_search,
}
states = dc.experiments.solved_states(scene, steps=200, every=10)
given = {name: dc.warm_start.warm_start_of(start) for name, start in starts.items()}
paired = dc.experiments.paired(states, given, sweeps=300, velocity_sweeps=(3, 10, 30))
print(
    "median velocity error after 3, 10, 30 sweeps; θ along a run of its own with 10 sweeps a step, N·s"
)
for name, start in starts.items():
    errors = np.median(paired[name]["velocity"], axis=0)
    run = dc.simulate(
        scene, steps=200, solver=dc.PGS(sweeps=10, tolerance=None), warm_start=start
    )
    theta = run.theta[run.contacts > 0].mean()
    print(
        f"{name:12s}", "  ".join(f"{error:.3f}" for error in errors), f"  {theta:.4f}"
    )
