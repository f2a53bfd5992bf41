"""python scripts/readme_pile.py: the moving picture of README.md, docs/pile.gif: a pile and the forces in it."""

from pathlib import Path

import deep_contact as dc
from deep_contact.reporting import plotting

STEPS, EVERY = 400, 8


def draw(axes, state):
    """A frame; impulses of a step are cut to those of the pile at rest, so that an impact does not fill it."""
    axes[0].set_axis_off()
    largest = 25.0 * float(state.bodies.mass.mean()) * 9.81 * state.dt
    contacts = state.contacts._replace(normal_impulse=state.contacts.normal_impulse.clip(max=largest))
    state = state.replace(contacts=contacts)
    plotting.draw_state(axes[0], state, colour_by=None, largest_impulse=largest)


def main():
    scene = dc.lattice_in_box(150, columns=12, radius=(0.6, 1.4), seed=2)
    run = dc.simulate(scene, steps=STEPS, record=EVERY, accuracy="accurate")
    out = Path(__file__).resolve().parent.parent / "docs" / "pile.gif"
    plotting.animate(run.trajectory, out, draw=draw, panels=[1.0], fps=12, size=4.4)


if __name__ == "__main__":
    main()
