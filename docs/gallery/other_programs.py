"""Tables for pandas and CSV, extended xyz for OVITO and ASE, VTK for ParaView.

`table()` of bodies, contacts and trajectories is a dictionary of columns, which pandas and
polars take. (`DataFrame(bodies)` without `table()` raises an error.) A file without a column of
radii needs radii from elsewhere: without `radius=`, `make_bodies` gives each circle a radius of
1 m. Extended xyz keeps every bit.

A `.vtu` file has one state and no time. `run.pvd`, VTK's collection file, lists the files and
the time of each in s. Open `run.pvd` in ParaView, and its animation has these times. The filter
"Glyph" draws the circles: spheres scaled by `radius`, with the scale factor 2, since its sphere
has a radius of one half.
"""

from pathlib import Path

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


def write_vtu(path, bodies):
    points = np.pad(bodies.position, ((0, 0), (0, 1)))  # z = 0
    cells = [("vertex", np.arange(len(points))[:, None])]
    meshio.write(path, meshio.Mesh(points, cells, point_data=bodies.table()))


def write_pvd(path, files, times):
    entry = '<DataSet timestep="{!r}" part="0" file="{}"/>'
    entries = [entry.format(float(time), file) for file, time in zip(files, times)]
    head = '<VTKFile type="Collection" version="0.1"><Collection>'
    text = "\n".join([head, *entries, "</Collection></VTKFile>\n"])
    Path(path).write_text(text, encoding="utf-8")


files = [f"run_{k:03d}.vtu" for k in range(len(run.trajectory))]
for file, state in zip(files, run.trajectory):
    write_vtu(file, state.bodies)
write_pvd("run.pvd", files, run.trajectory.times)
