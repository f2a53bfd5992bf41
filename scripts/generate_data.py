"""The data set: simulations of the thesis's scene with random numbers of circles, every solved state kept.

    python scripts/generate_data.py [--simulations 150] [--steps 600] [--bodies 70 110] [--seed 0]
                                    [--out data/generated] [--jobs 2] [--scheduler ADDRESS] [--xml] [--gzip] [--quick]
    python scripts/generate_data.py --sample [--out data/sample]

Writes <out>/sim_0000.h5, …, one file a simulation, as `deep_contact.cnn.dataset` describes it (data/README.md). States
without contacts are left out. --xml also writes every state as <out>/xml/sim_0000/sim_0000_<step>.xml, with --gzip as
.xml.gz. --quick is four short simulations of few circles, in <out>/quick. --sample writes the few states that are kept
with the source.

Simulation i depends on the seed and on i alone: the same bits whatever the number of simulations or jobs. It can be
stopped at any moment and started again: what is finished stays, what is not leaves nothing behind.

With --scheduler the workers of a Dask cluster simulate (`deep_contact.parallel`). They need no file system of this
machine: they return every simulation as the bytes of its file, which this process writes, and what a worker that dies
was at is done by another. XML files are made of these files afterwards, by processes of this machine.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import time
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import deep_contact as dc
from deep_contact import constants, parallel
from deep_contact.cnn.dataset import (
    PHASES,
    DataFileError,
    pack_simulation,
    phase,
    read_simulation,
    simulation_file,
    simulation_info,
    simulation_path,
)
from deep_contact.io.state_xml import state_path, write_state
from deep_contact.reporting import figures
from deep_contact.reporting.results import replacing

SWEEPS = 5000
"""The most sweeps a step is given, as in the thesis's generator; those that need more are kept as they are."""

FULL = {"simulations": 150, "steps": 600, "bodies": (70, 110)}
QUICK = {"simulations": 4, "steps": 200, "bodies": (20, 30)}

SAMPLE_SEED = 2019
"""Of the tracked sample, so that it is of no data set made with the default seed."""

SAMPLES_A_PHASE = 2


@dataclass(frozen=True, kw_only=True)
class Job:
    """What a worker needs to make one simulation."""

    number: int
    seed: int
    steps: int
    bodies: tuple[int, int]
    out: str
    xml: bool = False
    gzip: bool = False

    @property
    def settings(self) -> dict:
        """What decides the states, as it is kept in the file."""
        return {"steps": self.steps, "bodies": list(self.bodies)}

    @property
    def origin(self) -> dict:
        """Where the simulation's random numbers come from, as it is kept in the file."""
        return {"entropy": self.seed, "spawn_key": [self.number]}


def make_simulation(job: Job) -> bytes:
    """The file of one simulation. Nothing is written here: a worker may be on another machine."""
    states, sweeps, theta = simulate(job)
    packed = pack_simulation(states, sweeps=sweeps, theta=theta, seed=job.origin, options=job.settings)
    return simulation_file(packed)


def simulate(job: Job) -> tuple[list, list, list]:
    """Run the simulation. Returns its solved states that have contacts, and their sweeps and last θ."""
    rng = np.random.default_rng(np.random.SeedSequence(job.seed, spawn_key=(job.number,)))
    n = int(rng.integers(job.bodies[0], job.bodies[1], endpoint=True))
    scene = dc.circles_in_box(n, seed=rng).replace(name=f"sim_{job.number:04d}")
    states, sweeps, theta = [], [], []

    def keep(state, record):
        if state.contacts.count:
            states.append(state)
            sweeps.append(record.sweeps)
            theta.append(record.theta[-1])

    solver = dc.PGS(sweeps=SWEEPS, tolerance=constants.THETA_TOLERANCE)
    dc.simulate(scene, steps=job.steps, solver=solver, on_step=keep)
    if not states:
        raise ValueError(f"steps: expected enough for {n} circles to touch something, got {job.steps}")
    return states, sweeps, theta


def xml_folder(job: Job) -> Path:
    """The folder of one simulation's XML files."""
    return state_path(Path(job.out) / "xml", f"sim_{job.number:04d}", 0).parent


def write_xml(job: Job) -> None:
    """Write every state of the simulation's file as XML, under a name of its own until the folder is complete."""
    simulation = read_simulation(simulation_path(job.out, job.number))
    final = xml_folder(job)
    unfinished = final.with_name(f".{final.name}.{os.getpid()}")
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        for index in range(simulation.count):
            state = simulation.state(index)
            write_state(unfinished / state_path("", final.name, state.step, gz=job.gzip).name, state)
        os.replace(unfinished, final)
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise


def make_sample(out: Path) -> None:
    """Two states of each phase of a full simulation as XML, and a short one of few circles as HDF5."""
    out.mkdir(parents=True, exist_ok=True)
    run([Job(number=0, seed=SAMPLE_SEED, steps=QUICK["steps"], bodies=QUICK["bodies"], out=str(out))], 1)
    full = Job(number=1, seed=SAMPLE_SEED, steps=FULL["steps"], bodies=FULL["bodies"], out=str(out))
    states, _, _ = simulate(full)
    for name in PHASES:
        of_phase = [state for state in states if phase(state) == name]
        for i in range(SAMPLES_A_PHASE):
            state = of_phase[len(of_phase) * (i + 1) // (SAMPLES_A_PHASE + 1)]
            write_state(out / f"{name}_{state.step}.xml.gz", state)


def remove_unfinished(out: Path) -> None:
    """Remove what killed processes left half written: names that begin with a dot and end with a process's number."""
    for path in [*out.glob(".sim_*"), *(out / "xml").glob(".sim_*")]:
        match = re.fullmatch(r"\.sim_\d+\.(\d+)(\.h5)?", path.name)
        if match and not is_running(int(match[1])):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def is_running(process: int) -> bool:
    """Whether a process of this number is running, as far as can be told without harm (on Windows, it cannot)."""
    if os.name == "nt":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def check_finished(jobs: list[Job]) -> int:
    """How many simulations are there already. Raises DataFileError where one was made with other options."""
    done = 0
    for job in jobs:
        path = simulation_path(job.out, job.number)
        if not path.exists():
            continue
        header = simulation_info(path).header
        for name, expected in (("seed", job.origin), ("options", job.settings)):
            if header[name] != expected:
                raise DataFileError(
                    f"{path}: {name}: expected {expected}, got {header[name]}: made with other options; "
                    "give another folder (--out) or remove it"
                )
        done += 1
    return done


def run(jobs: list[Job], workers: int | Executor) -> None:
    """Make the simulations that are missing, with a progress bar; every file is written here, as soon as it comes."""
    missing = [job for job in jobs if not simulation_path(job.out, job.number).exists()]
    with closing(parallel.finished(make_simulation, missing, jobs=workers)) as made:
        for i, data in figures.progress_bar(made, total=len(missing), text="simulations"):
            with replacing(simulation_path(missing[i].out, missing[i].number)) as temporary:
                temporary.write_bytes(data)


def export(jobs: list[Job], processes: int) -> None:
    """Write the XML files of simulations, with a progress bar."""
    with closing(parallel.finished(write_xml, jobs, jobs=processes)) as written:
        for _ in figures.progress_bar(written, total=len(jobs), text="XML"):
            pass


def parse(arguments=None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulations", type=int, metavar="N", help="how many (150)")
    parser.add_argument("--steps", type=int, metavar="N", help="time steps of each (600)")
    parser.add_argument("--bodies", type=int, nargs=2, metavar=("LOW", "HIGH"), help="circles, both included (70 110)")
    parser.add_argument("--seed", type=int, default=0, help="of the whole set (0)")
    parser.add_argument("--out", type=Path, help="folder (data/generated)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (2)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help=parallel.SCHEDULER_HELP)
    parser.add_argument("--xml", action="store_true", help="write every state as XML as well")
    parser.add_argument("--gzip", action="store_true", help="compress the XML files")
    parser.add_argument("--quick", action="store_true", help="a small set in <out>/quick, for a try")
    parser.add_argument("--sample", action="store_true", help="the states of data/sample; takes no option but --out")
    args = parser.parse_args(arguments)
    if args.sample and (args.quick or args.xml or args.simulations or args.steps or args.bodies or args.seed):
        parser.error("--sample: expected no other option but --out")
    if args.out is None:
        args.out = Path("data/sample" if args.sample else "data/generated")
    for name, value in (QUICK if args.quick else FULL).items():
        if getattr(args, name) is None:
            setattr(args, name, value)
    if args.quick:
        args.out = args.out / "quick"
    for name, least in (("simulations", 1), ("steps", 1), ("seed", 0), ("jobs", 1)):
        if getattr(args, name) < least:
            parser.error(f"--{name}: expected an integer >= {least}, got {getattr(args, name)}")
    if not 1 <= args.bodies[0] <= args.bodies[1]:
        parser.error(f"--bodies: expected 1 <= LOW <= HIGH, got {args.bodies[0]} {args.bodies[1]}")
    if args.gzip and not args.xml:
        parser.error("--gzip: expected --xml beside it")
    return args


def main(arguments=None) -> int:
    args = parse(arguments)
    shared = asdict(Job(number=0, seed=args.seed, steps=args.steps, bodies=tuple(args.bodies), out=str(args.out)))
    shared |= {"xml": args.xml, "gzip": args.gzip}
    jobs = [Job(**{**shared, "number": i}) for i in range(args.simulations)]
    if args.sample:
        make_sample(args.out)
        return 0
    begin = time.perf_counter()
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        remove_unfinished(args.out)
        done = check_finished(jobs)
        if done:
            print(f"{done} of {len(jobs)} simulations are there already")
        with parallel.opened(args.jobs, args.scheduler) as workers:
            run(jobs, workers)
        export([job for job in jobs if job.xml and not xml_folder(job).exists()], args.jobs)
    except KeyboardInterrupt:
        print("\nstopped; the same command goes on from here", file=sys.stderr)
        return 130
    except (OSError, RuntimeError, ValueError, parallel.ClusterError) as error:
        # A full disk is an OSError or, from within HDF5, a RuntimeError.
        print(f"{args.out}: {error}", file=sys.stderr)
        return 1
    paths = [simulation_path(job.out, job.number) for job in jobs]
    states = sum(simulation_info(path).count for path in paths)
    size = sum(path.stat().st_size for path in paths)
    seconds = time.perf_counter() - begin
    print(f"{args.out}: {len(jobs)} simulations, {states} states, {size / 1e6:.1f} MB, {seconds:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
