"""python scripts/readme_pile.py: the moving picture of README.md, docs/pile.gif: a pile and the forces in it."""

from pathlib import Path

import deep_contact as dc
from deep_contact.reporting import film

STEPS = 400
"""Of the run."""

EVERY = 8
"""Steps from one image to the next."""


def main():
    scene = dc.lattice_in_box(150, columns=12, radius=(0.6, 1.4), seed=2)
    run = dc.simulate(scene, steps=STEPS, record=EVERY, accuracy="accurate")
    # Lines as wide as in the pile at rest, so that an impact does not fill the picture.
    at_rest = 25.0 * float(scene.bodies.mass.mean()) * 9.81 * scene.dt
    canvas = film.Canvas(scene.world, size=352, fastest=12.0, strongest=at_rest)
    out = Path(__file__).resolve().parent.parent / "docs" / "pile.gif"
    film.write_film(out, map(canvas, run.trajectory), fps=12)


if __name__ == "__main__":
    main()
