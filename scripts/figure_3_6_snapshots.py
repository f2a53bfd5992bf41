"""python scripts/figure_3_6_snapshots.py: snapshots of the falling pile, coloured by speed."""

import deep_contact as dc
from deep_contact import experiments, figures, plotting
from deep_contact.figures import Figure


def compute(options, seed, jobs, progress):
    """The thesis's scene at some times."""
    scene = dc.circles_in_box(options["n_bodies"], size=options["size"], seed=seed)
    return {"snapshots": [plotting.state_data(state) for state in experiments.snapshots(scene, options["times"])]}


def table(data):
    """Rows: what the panels show."""
    rows = [["time (s)", "contacts", "mean height (m)", "largest speed (m/s)", "largest λ_n (N·s)"]]
    for state in map(plotting.state_of, data["snapshots"]):
        height, speed = state.bodies.position[:, 1].mean(), plotting.body_values(state, "speed")[0].max()
        rows.append([state.time, state.contacts.count, height, speed, state.contacts.normal_impulse.max(initial=0.0)])
    return rows


FIGURE = Figure(
    id="3.6",
    title="Snapshots of the falling pile",
    options={"n_bodies": 100, "size": 30.0, "times": [0.0, 1.0, 2.0, 6.0]},
    compute=compute,
    table=table,
    draw=lambda data, options: experiments.draw_snapshots(data, colour_by="speed"),
)

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
