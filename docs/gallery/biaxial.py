"""Press and shear a packing between walls that carry a load: a biaxial test.

For users of granular media: 400 discs lie without gravity between two walls of the box and two segments. Each segment
presses on the discs, and keeps a given pressure. The speed of a segment has two parts. The first part is proportional
to the pressure that is missing, as in YADE's stress controller. The second part learns the speed at which the segment
travels steadily. Five pressures compress the packing, one after the other. Then the packing is sheared: the upper
segment comes down at a constant strain rate, and the right segment keeps its pressure.
"""

import numpy as np

import deep_contact as dc

DT, GAIN, LEARNS = 0.01, 4.0, 0.02
rng = np.random.default_rng(1)
grid = np.stack(np.meshgrid(np.arange(20), np.arange(20)), -1).reshape(-1, 2)
places = 1.2 + 2.25 * grid + rng.uniform(-0.02, 0.02, (400, 2))
discs = dc.make_bodies(places, radius=rng.uniform(0.7, 1.1, 400))
area, mass = np.pi * (discs.radius**2).sum(), discs.mass.sum()


class Press:
    """A packing, and the two segments that press it: the right one, and the upper one."""

    def __init__(self, bodies, size):
        self.size, self.steady = np.array([size, size]), np.zeros(2)  # m, m/s
        ends = [((size, -9.0), (size, 99.0)), ((-9.0, size), (99.0, size))]
        moving = {"segments": ends, "segment_velocities": inwards((1.0, 1.0))}
        world = dc.World(box=(0, 0, 99, 99), gravity=(0, 0), friction=0.3, **moving)
        scene = dc.State(name="biaxial", world=world, bodies=bodies, dt=DT)
        self.live = dc.Simulator(scene, solver=dc.PGS(sweeps=10), forces=True)

    def step(self, speed):
        """Do a step in which the segments move inwards at these speeds, m/s. Returns the pressures on them, N/m."""
        self.live.set(segment_velocities=inwards(speed))
        self.live.step()
        self.size -= DT * np.array(speed)
        right, top = (self.live.force_on("segment", k)[k] for k in (0, 1))
        return np.array([right, top]) / self.size[::-1]

    def hold(self, pressure, steps, strain_rate=None):
        """Keep a pressure, N/m, or let the upper segment come down, 1/s. Returns the pressures of all steps."""
        found, missing = np.zeros((steps, 2)), np.zeros(2)
        for k in range(steps):
            # the speed that some steps of this pressure would give to all discs
            most = GAIN * pressure * self.size[::-1] * DT / mass
            speed = self.steady + most * missing
            if strain_rate is not None:
                speed[1] = strain_rate * self.size[1]
            found[k] = self.step(speed)
            missing = np.clip(1.0 - found[k] / pressure, -1.0, 1.0)
            self.steady += LEARNS * most * np.where(np.abs(missing) < 0.5, missing, 0.0)
        return found

    @property
    def packing(self):
        """Solid fraction, and contacts of each disc with two or more of them: the others rattle."""
        touching = dc.coordination(self.live.solved)
        return area / self.size.prod(), touching[touching > 1].mean()


def inwards(speed):
    """Velocities of the ends of both segments, m/s."""
    x, y = speed
    return [((-x, 0.0), (-x, 0.0)), ((0.0, -y), (0.0, -y))]


press = Press(discs, 45.2)
while area / press.size.prod() < 0.74:  # the segments come in, and meet no resistance
    press.step((0.5, 0.5))
pressures, packings, kept = np.array([50.0, 100.0, 200.0, 400.0, 800.0]), [], []
for pressure in pressures:
    while abs(press.hold(pressure, 500).mean() / pressure - 1.0) > 0.001:
        pass
    found = press.hold(pressure, 1000)[-500:] / pressure
    packings.append(press.packing)
    kept.append(found)
    print(
        f"{pressure:g} N/m: kept to {abs(found.mean() - 1):.1e}, swings by {found.std():.1e}; "
        "solid fraction {:.3f}, {:.2f} contacts a disc".format(*packings[-1])
    )

height, strains, ratios = press.size[1], [], []
for _ in range(12):
    found = press.hold(pressures[-1], 200, strain_rate=0.002)
    (side, top), strain = found.mean(axis=0), 1.0 - press.size[1] / height
    strains.append(strain)
    ratios.append((top - side) / (top + side))
    kept.append(found[:, :1] / pressures[-1])
print(f"sheared by {strain:.1%}: {max(ratios):.2f} is the largest ratio of stresses")

figure, (ax, beside) = dc.plotting.subplots(1, 2)
fractions, touching = zip(*packings)
ax.plot(pressures, fractions, "o-")
dc.plotting.label_axes(ax, "pressure", "solid fraction", x_unit="N/m")
beside.plot(pressures, touching, "s-")
dc.plotting.label_axes(beside, "pressure", "contacts of a disc", x_unit="N/m")
dc.plotting.save(figure, "biaxial.png")
figure, (ax, beside) = dc.plotting.subplots(1, 2)
dc.plotting.draw_contact_forces(ax, press.live.solved)
ax.set(xlim=(-1, 1.1 * press.size[0]), ylim=(-1, 1.1 * press.size[1]))
beside.plot(strains, ratios, "o-")
dc.plotting.label_axes(beside, "axial strain", "(σ_y − σ_x) / (σ_y + σ_x)")
dc.plotting.save(figure, "biaxial_sheared.png")
