"""Compare warm starts on the same states.

For readers of the thesis: this is the experiment of the thesis in short. First, a run is solved well. Then its states
are solved again from every start. Builtin takes the impulses of the step before. Copy takes the solution itself. Sph
sends the solution through a grid image. Copy and Sph know the solution, so they show what a perfect prediction could
give. In practice the solution is not known beforehand, so Copy and Sph are no rivals of Builtin.
"""

import numpy as np

import deep_contact as dc

scene = dc.circles_in_box(n_bodies=50, size=22.0, seed=1)
states = dc.experiments.solved_states(scene, steps=240, every=12)
starts: dict[str, dc.warm_start.WarmStart] = {
    "none": dc.warm_start.NoStart(),
    "builtin": dc.warm_start.Builtin(),
    "sph": dc.warm_start.Sph(spacing=0.5),
    "sph consistent": dc.warm_start.Sph(spacing=0.5, transfer="consistent"),
    "copy": dc.warm_start.Copy(),
}
found = dc.experiments.paired(states, starts, sweeps=1000)
for name, one in found.items():
    print(
        f"{name:15s} mean {one['sweeps'].mean():6.1f} sweeps to 6e-5 N·s, median {np.median(one['sweeps']):5.0f}"
    )

figure, ax = dc.plotting.subplots()
for name, one in found.items():
    ax.loglog(np.arange(1, 1001), one["theta"], **dc.plotting.style_of(name))
dc.plotting.label_axes(ax, "sweep", "θ, mean over states", y_unit="N·s")
ax.legend()
dc.plotting.save(figure, "compare_starts.png")
