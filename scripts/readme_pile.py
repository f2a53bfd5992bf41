"""python scripts/readme_pile.py: make the film in README.md, docs/pile.gif, of a pile and its contact forces."""

from pathlib import Path

import deep_contact as dc
from deep_contact.plot import film_file

STEPS = 400
"""Number of time steps of the run."""

EVERY = 8
"""Number of time steps from one image to the next."""


def main():
    scene = dc.lattice_in_box(150, columns=12, radius=(0.6, 1.4), seed=2)
    run = dc.simulate(scene, steps=STEPS, record=EVERY, forces=True, accuracy="accurate")
    # The largest width of a line is for forces of a pile at rest, so that the lines of an impact do not fill the
    # picture.
    at_rest = 25.0 * float(scene.bodies.mass.mean()) * 9.81
    canvas = film_file.Canvas(scene.world, size=352, strongest=at_rest, forces=True)
    out = Path(__file__).resolve().parent.parent / "docs" / "pile.gif"
    film_file.write_film(out, run.solved, canvas, fps=12)  # `run.solved` has the mean forces of each step


if __name__ == "__main__":
    main()
