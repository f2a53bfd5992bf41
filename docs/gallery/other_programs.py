"""Tables for pandas and CSV, extended xyz for OVITO and ASE, VTK for ParaView.

`table()` of bodies, contacts and trajectories is a dictionary of columns, which pandas and
polars take. Extended xyz keeps every bit. ParaView opens the `.vtu` files, one a state, as
an animation; its filter "Glyph" draws the circles: spheres scaled by `radius`, with the scale
factor 2, since its sphere has a radius of one half.
"""

import meshio
import numpy as np
import pandas

import deep_contact as dc

COLUMNS = "species:S:1:pos:R:3:velo:R:3:radius:R:1:mass:R:1"


def write_xyz(path, states):
    with open(path, "w", encoding="utf-8") as file:
        for one in states:
            b, (x, y, right, top) = one.bodies, one.world.box
            box = f'Lattice="{right - x} 0 0 0 {top - y} 0 0 0 1" Origin="{x} {y} 0"'
            head = f'{box} Properties={COLUMNS} Time={one.time!r} pbc="F F F"'
            print(b.count, head, sep="\n", file=file)
            z = np.zeros((b.count, 1))
            both = b.position, z, b.velocity, z, b.radius[:, None], b.mass[:, None]
            for row in np.hstack(both).tolist():
                print("C", *map(repr, row), file=file)


def read_xyz(path):
    table = np.loadtxt(path, skiprows=2, max_rows=40, usecols=range(1, 9))
    place, velocity, (radius, mass) = table[:, :2], table[:, 3:5], table[:, 6:].T
    return dc.make_bodies(place, velocity=velocity, radius=radius, mass=mass)


run = dc.simulate(dc.circles_in_box(40, size=20, seed=1), steps=200, record=20)
frame = pandas.DataFrame(run.trajectory.table())  # a row for each circle and time
print(frame.groupby("time")["y"].max().tail(3))
pandas.DataFrame(run.state.bodies.table()).to_csv("circles.csv", index=False)
table = pandas.read_csv("circles.csv")
bodies = dc.make_bodies(table[["x", "y"]], radius=table["radius"], mass=table["mass"])
print("the same positions:", np.allclose(bodies.position, run.state.bodies.position))

write_xyz("run.xyz", run.trajectory)
first = run.trajectory[0].bodies
print("the same bodies:", read_xyz("run.xyz") == first._replace(angle=first.angle * 0))

for k, state in enumerate(run.trajectory):
    points = np.pad(state.bodies.position, ((0, 0), (0, 1)))  # z = 0
    cells = [("vertex", np.arange(len(points))[:, None])]
    mesh = meshio.Mesh(points, cells, point_data=state.bodies.table())
    meshio.write(f"run_{k:03d}.vtu", mesh)
