"""What does a setting make of the angle of a drum's surface?

For users of granular media: a setting is a solver with its options. The angle is that between straight down and the
line from the drum's axis to the centre of all circles. The error "angle" is the error of the mean curve over seeds. The
error "angle spread" is the distance between two distributions over seeds: that of the setting, and that of the
reference.
"""

import math

import deep_contact as dc


def scene(seed):
    return dc.drum(100, froude=0.05, sides=24, seed=seed)


def angle(state):
    x, y = state.bodies.position.mean(axis=0) - 0.5 * state.world.box[2]
    return math.degrees(math.atan2(x, -y))


trade = dc.measure_trade(scene, steps=400, seeds=4, quantities={"angle": angle})
print(trade)
for name, runs in trade.values("angle").items():
    print(f"{runs[:, -40:].mean():5.1f}° at the end, {name}")
dc.plotting.save(trade.plot(), "drum_trade.png")
