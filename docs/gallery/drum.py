"""Turn a drum.

For users of granular media: the drum is a polygon of segments. The segments stay in place, and their surfaces move. The
program prints an angle: that between straight down and the line from the drum's axis to the centre of all circles. The
surface of the heap is tilted by the same angle. The angle follows the Froude number ω² R / g, with the angular velocity
ω and the radius R of the drum.
"""

import math

import deep_contact as dc

figure, axes = dc.plotting.subplots(1, 3)
for ax, froude in zip(axes, (0.01, 0.1, 0.5)):
    scene = dc.drum(200, froude=froude, radius=(0.8, 1.0), seed=1)
    run = dc.simulate(scene, steps=1200, record=10)
    assert run.trajectory is not None
    x, y = run.trajectory.positions[-40:].mean(axis=(0, 1)) - 0.5 * scene.world.box[2]
    angle = math.degrees(math.atan2(x, -y))
    print(f"Froude number {froude:g}: the heap leans by {angle:.0f}°")
    run.trajectory.film(f"drum_{froude:g}.html")
    dc.plotting.draw_state(ax, run.state, contacts=False)
    ax.set_title(f"Froude number {froude:g}: {angle:.0f}°")
dc.plotting.save(figure, "drum.png")
