"""Draw the forces of a packing from the positions of its circles.

For those who have a photograph of discs, or positions from another program: no impulses of a step before are known. The
start "far field, no past" estimates the impulses from the positions. Sweeps of the solver then correct them. Noise in
the positions opens contacts, so all radii are enlarged by twice the noise before contacts are looked for.

With friction, many sets of contact forces are admissible in a packing. So even exact positions do not give back the
forces that the history of the packing has left. The last column of the table says how much is open: it is the length of
the interval that is open to the force of the median contact, over the mean force. `dc.force_bounds` computes these
intervals, here for every 25th contact.
"""

import numpy as np

import deep_contact as dc
from deep_contact.state import StateWithContacts

pile = dc.simulate(dc.lattice_in_box(300, seed=2), steps=1200, solver=dc.NNCG()).state
carried = pile.contacts.normal_start / pile.dt
true = dict(zip(zip(pile.contacts.body_a, pile.contacts.body_b), carried))
solver, rng = dc.NesterovPGS(sweeps=1000, tolerance=None), np.random.default_rng(1)
solved: list[StateWithContacts] = []
figure, axes = dc.plotting.subplots(1, 3, size=(9.0, 3.2))
print("noise, % of r   contacts   of the true ones   correlation of forces   interval")
for ax, noise in zip(axes, (0.0, 0.1, 1.0)):  # % of a radius
    sigma = 0.01 * noise * pile.bodies.radius.mean()
    seen = dc.make_bodies(
        pile.bodies.position + sigma * rng.standard_normal((300, 2)),
        radius=pile.bodies.radius + 2 * sigma,
    )
    dc.simulate(
        dc.State(name="photo", world=pile.world, bodies=seen),
        steps=1,
        solver=solver,
        warm_start="far field, no past",
        on_step=lambda state, record: solved.append(state),
    )
    contacts = solved[-1].contacts
    forces = contacts.normal_impulse / pile.dt
    pairs = list(zip(contacts.body_a, contacts.body_b))
    both = [(forces[k], true[pair]) for k, pair in enumerate(pairs) if pair in true]
    agree = np.corrcoef(np.array(both).T)[0, 1]
    bounds = dc.force_bounds(solved[-1], range(0, len(pairs), 25)).normal
    width = np.median(np.ptp(bounds, axis=1)) / contacts.normal_impulse.mean()
    print(
        f"{noise:13g} {len(pairs):10d} {len(both):8d} of {len(true)} {agree:16.2f} {width:18.2f}"
    )
    dc.plotting.draw_state(ax, solved[-1], colour_by=None)
    ax.set_title(f"noise {noise:g} % of r")
dc.plotting.save(figure, "photographed_packing.png")
