"""Let a hopper run out.

For users of granular media: the funnel is two segments that stand still in the box. The wider the hole, the faster the
hopper runs out. A narrow hole is blocked by an arch of circles. (By Beverloo's law there is no flow through a hole
below a few diameters.)
"""

import deep_contact as dc

figure, axes = dc.plotting.subplots(1, 3)
for ax, opening in zip(axes, (3.0, 6.0, 10.0)):
    scene = dc.hopper(150, opening=opening, seed=1)  # opening in largest radii
    run = dc.simulate(scene, steps=600, record=10)
    assert run.trajectory is not None
    foot = min(y for segment in scene.world.segments for y in segment[1::2])
    left = [int((y > foot).sum()) for y in run.trajectory.positions[::10, :, 1]]
    print(f"hole of {opening:g} radii: circles above it each second: {left}")
    run.trajectory.film(f"hopper_{opening:g}.html")
    dc.plotting.draw_state(ax, run.state, contacts=False)
    ax.set_title(f"hole of {opening:g} radii")
dc.plotting.save(figure, "hopper.png")
