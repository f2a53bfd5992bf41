"""Make the training data: simulations of the thesis's scene with all solved states, or packed piles without a past.

data/README.md describes the files, <out>/sim_0000.h5, …. With --xml, every state is also written as
<out>/xml/sim_0000/sim_0000_<step>.xml. --quick makes four short simulations of few circles, in <out>/quick. --packings
makes the training data of the network "far field, no past". Each of its simulations has four states of a pile that
settles, and the start of their contacts is `Support`. Five eighths of these piles have 50 to 3,000 circles, and the
others 600 to 6,000.

Simulation i depends on the seed and on i only. So it has the same bits for any number of simulations or jobs. The
script can be stopped at any moment and started again. Finished simulations stay, and unfinished ones leave no files.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import deep_contact as dc
from deep_contact import parallel
from deep_contact.__main__ import BAD_FILE, INTERRUPTED, status_of
from deep_contact.cnn.dataset import PHASES, phase, simulation_path
from deep_contact.io import simulation_h5
from deep_contact.io.argument_parser import Parser
from deep_contact.io.simulation_h5 import DataFileError, simulation_info
from deep_contact.state import constants
from deep_contact.stepping import metrics
from deep_contact.studies.piles import SETTLE, packing, without_past

SOLVER = dc.PGS(sweeps=5000, tolerance=constants.THETA_TOLERANCE)
"""Solver of the simulations. A state that needs more than 5,000 sweeps is stored with the impulses after these."""

FULL = {"simulations": 150, "steps": 600, "bodies": (70, 110)}
QUICK = {"simulations": 4, "steps": 200, "bodies": (20, 30)}
PACKINGS = 640
"""Default number of simulations with --packings."""

SMALL = {"sizes": (50, 3000), "steps": (80, 80, 200, 300), "stream": 34}
LARGE = {"sizes": (600, 6000), "steps": (80, 120, 300, 400), "stream": 35}
"""Packings: range of the number of circles, time steps before each stored state, and number of the random stream."""
SMALLEST = 0.5, 0.8, 0.95
"""Smallest radii of packings, m, of which one is drawn. The largest radius is 1 m."""
FRICTION = 0.1, 0.3, 0.5, 0.5, 0.5, 0.8, 1.0
"""Friction coefficients μ of packings, of which one is drawn."""
UNSOLVED = 1e-2
"""Largest residual of the solution with which a state of a packing is stored, m/s."""

SAMPLE_SEED = 2019
"""Seed of the sample in the repository. Data sets with the default seed do not contain its simulations."""


@dataclass(frozen=True)
class Job:
    """The description of one simulation, which is sent to a worker process.

    number: number of the simulation. seed: seed of the data set. steps: number of time steps. bodies: smallest and
    largest number of circles. out: folder of the data set. gzip: whether XML files are compressed. packing: whether the
    simulation is a packing; steps and bodies are then unused.
    """

    number: int
    seed: int
    steps: int
    bodies: tuple[int, int]
    out: str
    gzip: bool = False
    packing: bool = False

    @property
    def path(self) -> Path:
        """The path of the simulation's file."""
        return simulation_path(self.out, self.number)

    @property
    def header(self) -> dict:
        """The fields of the file's header that determine the states. A packing's states depend on its number only."""
        if self.packing:
            return {"seed": None, "options": {}}
        options = {"steps": self.steps, "bodies": list(self.bodies)}
        return {"seed": {"entropy": self.seed, "spawn_key": [self.number]}, "options": options}


def make_simulation(job: Job) -> None:
    """Run one simulation, and write its file."""
    states, sweeps, theta = (packed_states(job.number), None, None) if job.packing else simulate(job)
    simulation_h5.write_simulation(job.path, states, sweeps=sweeps, theta=theta, **job.header)


def simulate(job: Job) -> tuple[list, list, list]:
    """Run a simulation of the thesis's scene.

    Returns three lists: the solved states that have contacts, their numbers of sweeps, and θ after their last sweep,
    N·s.
    """
    rng = np.random.default_rng(np.random.SeedSequence(job.seed, spawn_key=(job.number,)))
    n = int(rng.integers(*job.bodies, endpoint=True))
    scene = dc.circles_in_box(n, seed=rng).replace(name=f"sim_{job.number:04d}")
    solved = []

    def keep(state, record):
        if state.contacts.count:
            solved.append((state, record.sweeps, record.theta[-1]))

    dc.simulate(scene, steps=job.steps, solver=SOLVER, on_step=keep)
    if not solved:
        raise ValueError(f"steps: expected enough for {n} circles to touch something, got {job.steps}")
    return tuple(map(list, zip(*solved)))


def packed_states(number: int) -> Iterator[dc.State]:
    """Yield solved states of a packing that settles.

    The solutions are computed from the impulses of the step before. In the states that are yielded, the start `Support`
    replaces these impulses, because the network learns to correct it. States with a residual above `UNSOLVED` are left
    out. number: number of the simulation.
    """
    kind, k = (SMALL, number) if number < 400 else (LARGE, number - 400)
    rng = np.random.default_rng((kind["stream"], k))
    n = int(np.exp(rng.uniform(*np.log(kind["sizes"]))))
    smallest, friction = rng.choice(SMALLEST), float(rng.choice(FRICTION))
    state = packing(n, rng, width=rng.uniform(0.7, 1.3), smallest=smallest, friction=friction)
    tolerance = 1e-8 * float(state.bodies.mass.mean())
    for steps in kind["steps"]:
        state = dc.simulate(state, steps=steps, solver=SETTLE).state
        solution = dc.solve_contacts(state, solver=dc.NNCG(sweeps=10_000, tolerance=tolerance))
        if metrics.residual(state, solution) <= UNSOLVED:
            bare = without_past(state)
            normal, tangent = dc.warm_start.Support()(bare, None)
            solved = {"normal_impulse": solution.normal_impulses, "tangent_impulse": solution.tangent_impulses}
            contacts = bare.contacts._replace(normal_start=normal, tangent_start=tangent, **solved)
            yield bare.replace(contacts=contacts, solved=True)


def write_xml(job: Job) -> None:
    """Write every state in the simulation's file as an XML file, unless this file exists already."""
    simulation, name = simulation_h5.read_simulation(job.path), job.path.stem
    for state in map(simulation.state, range(simulation.count)):
        path = Path(job.out) / "xml" / name / f"{name}_{state.step}.xml{'.gz' if job.gzip else ''}"
        if not path.exists():
            dc.write_state(path, state)


def make_sample(out: Path) -> None:
    """Write the sample: two states of each phase of a full simulation as XML, and a short small simulation as HDF5."""
    make_simulation(Job(0, SAMPLE_SEED, QUICK["steps"], QUICK["bodies"], str(out)))
    states, _, _ = simulate(Job(1, SAMPLE_SEED, FULL["steps"], FULL["bodies"], str(out)))
    for name in PHASES:
        of_phase = [state for state in states if phase(state) == name]
        for state in (of_phase[len(of_phase) // 3], of_phase[len(of_phase) * 2 // 3]):
            dc.write_state(out / f"{name}_{state.step}.xml.gz", state)


def missing(jobs: list[Job]) -> list[Job]:
    """Return the simulations whose files do not exist. Raises DataFileError if a file was made with other options."""
    for job in jobs:
        header = simulation_info(job.path).header if job.path.exists() else job.header
        for name, expected in job.header.items():
            if header[name] != expected:
                raise DataFileError(
                    f"{job.path}: {name}: expected {expected}, got {header[name]}: made with other options; "
                    "give another folder (--out) or remove it"
                )
    return [job for job in jobs if not job.path.exists()]


def positive(text: str, least: int = 1) -> int:
    """Return the integer in an option's text. Raises argparse.ArgumentTypeError if it is below `least`."""
    if int(text) < least:
        raise argparse.ArgumentTypeError(f"expected an integer >= {least}, got {text}")
    return int(text)


def parse(arguments=None) -> argparse.Namespace:
    parser = Parser(description=(__doc__ or "").split("\n")[0])
    add = parser.add_argument
    add("--simulations", type=positive, metavar="N", help="how many (150; 640 packings)")
    add("--steps", type=positive, metavar="N", help="time steps of each (600)")
    add("--bodies", type=int, nargs=2, metavar=("LOW", "HIGH"), help="circles, both included (70 110)")
    add("--seed", type=partial(positive, least=0), default=0, help="of the whole set (0)")
    add("--out", type=Path, help="folder (data/generated)")
    add("--jobs", type=positive, default=2, metavar="N", help="processes (2)")
    add("--xml", action="store_true", help="write every state as XML as well")
    add("--gzip", action="store_true", help="compress the XML files")
    add = parser.add_mutually_exclusive_group().add_argument
    add("--quick", action="store_true", help="a small set in <out>/quick, for a try")
    add("--packings", action="store_true", help="packed piles without a past")
    add("--sample", action="store_true", help="the states of data/sample; takes no option but --out")
    args = parser.parse_args(arguments)
    of_scene = args.xml or args.steps or args.bodies or args.seed
    if args.sample and (of_scene or args.simulations):
        parser.error("--sample: expected no other option but --out")
    if args.packings and of_scene:
        parser.error("--packings: expected no --steps, --bodies, --seed or --xml beside it")
    folder = "data/sample" if args.sample else "data/generated/packings" if args.packings else "data/generated"
    args.out = (args.out or Path(folder)) / ("quick" if args.quick else "")
    for name, value in (QUICK if args.quick else FULL).items():
        if getattr(args, name) is None:
            setattr(args, name, PACKINGS if args.packings and name == "simulations" else value)
    if not 1 <= args.bodies[0] <= args.bodies[1]:
        parser.error(f"--bodies: expected 1 <= LOW <= HIGH, got {args.bodies[0]} {args.bodies[1]}")
    if args.gzip and not args.xml:
        parser.error("--gzip: expected --xml beside it")
    return args


def main(arguments=None, jobs: int | Executor | None = None) -> int:
    """Run the command line. Returns the exit status.

    jobs: number of processes, or an executor whose workers have access to the folder of --out; None: the option --jobs.
    """
    args = parse(arguments)
    if args.sample:
        make_sample(args.out)
        return 0
    first = Job(0, args.seed, args.steps, tuple(args.bodies), str(args.out), args.gzip, args.packings)
    simulations = [replace(first, number=i) for i in range(args.simulations)]
    begin = time.perf_counter()
    try:
        wanted = missing(simulations)
        print(f"{args.out}: {len(simulations)} simulations, {len(simulations) - len(wanted)} are there already")
        spread = {"jobs": jobs or args.jobs, "progress": parallel.progress_bar}
        parallel.parallel_map(make_simulation, wanted, text="simulations", **spread)
        if args.xml:
            parallel.parallel_map(write_xml, simulations, text="XML", **spread)
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return INTERRUPTED
    except (OSError, RuntimeError, ValueError) as error:
        print(f"{args.out}: {error}", file=sys.stderr)
        return BAD_FILE if isinstance(error, RuntimeError) else status_of(error)  # from HDF5, on a full disk
    states = sum(simulation_info(job.path).count for job in simulations)
    size = sum(job.path.stat().st_size for job in simulations)
    seconds = time.perf_counter() - begin
    print(f"{args.out}: {len(simulations)} simulations, {states} states, {size / 1e6:.1f} MB, {seconds:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
