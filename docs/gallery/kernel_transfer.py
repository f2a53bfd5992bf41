"""Send impulses through a grid image and read them back.

For kernel researchers: `splat` spreads the values of points over the nodes of a grid, and `gather` reads an image at
points. A splat and a gather together are a round trip. Three of them are compared. "bilinear" interpolates between the
four nodes around a point (equation 3.16), and loses a part of the impulses. "SPH weights" reads the image back with the
weights of the splat. "consistent" divides the bilinear round trip by the same round trip of a field of ones
(`density`). It returns the impulse of an isolated contact exactly.
"""

from typing import Any

import numpy as np

import deep_contact as dc

state = dc.experiments.solved_states(
    dc.circles_in_box(n_bodies=60, size=24.0, seed=5), steps=201
)[-1]
points, impulses = state.contacts.position, state.contacts.normal_impulse
at_edge: dict[str, Any] = {"outside": "clamp", "unreached": "zero"}

print("kernel        d (m)  bilinear   SPH weights  consistent    (‖λ_back − λ‖ / ‖λ‖)")
for kernel in dc.sph.KERNELS:
    for d in (0.25, 0.5):
        grid = dc.sph.Grid.over_box(state.world.box, d)
        shape: dict[str, Any] = {"h": d, "kernel": kernel}
        image = dc.sph.splat(
            grid, points, impulses, normalization="particle", **shape, **at_edge
        )
        ones = dc.sph.density(grid, points, **shape, **at_edge)
        ways = (
            dc.sph.gather(grid, image, points, **at_edge),
            dc.sph.gather(grid, image, points, method="sph", **shape, **at_edge),
            dc.sph.gather(
                grid, image, points, normalization="consistent", density=ones, **at_edge
            ),
        )
        losses = [
            np.linalg.norm(back - impulses) / np.linalg.norm(impulses) for back in ways
        ]
        print(
            f"{kernel:13s} {d:5.2f}  {losses[0]:8.3f}  {losses[1]:12.3f}  {losses[2]:10.1e}"
        )

figure, ax = dc.plotting.subplots()
q = np.linspace(0, 1, 200)
for kernel in dc.sph.KERNELS:
    ax.plot(q, dc.sph.value(kernel, q, h=1.0), label=kernel)
dc.plotting.label_axes(ax, "r / h", "W on the plane", y_unit="1/m²")
ax.legend()
dc.plotting.save(figure, "kernel_transfer.png")
