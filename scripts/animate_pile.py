"""python scripts/animate_pile.py [--no-gravity]: the pile as an animation, GIF and, where ffmpeg is found, MP4."""

import argparse
from pathlib import Path

import deep_contact as dc
from deep_contact.reporting import plotting
from deep_contact.reporting.figures import progress_bar
from deep_contact.studies import starts


def main() -> None:
    """Run the scene and write its animation."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-gravity", action="store_true", help="circles that drift and collide instead of falling")
    parser.add_argument("--bodies", type=int, default=100)
    parser.add_argument("--steps", type=int, default=400, help="of 0.01 s (default: %(default)s)")
    parser.add_argument("--every", type=int, default=4, help="steps a frame (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="figures", metavar="FOLDER")
    given = parser.parse_args()
    make = dc.drifting_circles if given.no_gravity else dc.circles_in_box
    scene = make(given.bodies, seed=given.seed)
    states = starts.solved_states(scene, steps=given.steps, every=given.every, contacts_only=False)
    name = "animation_no_gravity" if given.no_gravity else "animation"
    fps = round(1 / (given.every * scene.dt))
    for path in plotting.animate(progress_bar(states, text="frames"), Path(given.out) / name, fps=fps):
        print(path)


if __name__ == "__main__":
    main()
