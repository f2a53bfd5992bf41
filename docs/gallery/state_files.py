"""Write a state, read it back, and go on bit for bit.

For engine builders: a state file holds the bodies, the contacts and the impulses. It is XML, so any tool can read it. A
run that goes on from a file gives the same bits as a run that never stopped.
"""

from pathlib import Path

import numpy as np

import deep_contact as dc

scene = dc.circles_in_box(n_bodies=30, size=16.0, seed=2)
halfway = dc.simulate(scene, steps=100).state
dc.write_state("halfway.xml", halfway)
print(f"halfway.xml has {Path('halfway.xml').stat().st_size:,} bytes and begins with")
print("\n".join(Path("halfway.xml").read_text().splitlines()[:5]))

resumed = dc.simulate(dc.read_state("halfway.xml"), steps=100).state
straight = dc.simulate(scene, steps=200).state
same = np.array_equal(resumed.bodies.position, straight.bodies.position)
print(
    f"after 200 steps the resumed run and the uninterrupted run have the same bits: {same}"
)
assert same

# A file that is damaged is refused, with the line, the element and the value.
Path("damaged.xml").write_text(
    Path("halfway.xml").read_text().replace('radius="1.0"', 'radius="-1.0"', 1)
)
try:
    dc.read_state("damaged.xml")
except ValueError as error:
    print("refused:", error)
