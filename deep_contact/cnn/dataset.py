"""A store of the files of many simulations (`deep_contact.io.simulation_h5`), and their split for training."""

from __future__ import annotations

import hashlib
import re
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import numpy as np

from deep_contact.io.simulation_h5 import DataFileError, StoredSimulation, read_simulation, simulation_info
from deep_contact.state.state import StateWithContacts
from deep_contact.state.validation import integer, one_of

PHASES = ("impact", "settling", "rest")
SETTLING, REST = 0.5, 0.05
"""Relative errors of Builtin's start below which a state is settling, or at rest."""

_reading = Lock()
"""Lock of a store while it reads a file and changes its cache."""


def simulation_path(folder, sim: int) -> Path:
    """The path of simulation `sim` in a folder."""
    return Path(folder) / f"sim_{sim:04d}.h5"


class Store:
    """The simulations of a folder: `sim_0000.h5`, `sim_0001.h5`, …

    A simulation is read and checked as a whole on the first access to one of its states. The simulations read last are
    kept in memory, unpacked, up to `cache_bytes` (at least one). Raises DataFileError where the folder has none.
    """

    def __init__(self, folder, *, cache_bytes: int = 8 * 2**30):
        self.folder = Path(folder)
        self.cache_bytes = integer("cache_bytes", cache_bytes)
        matches = (re.fullmatch(r"sim_(\d{4}|[1-9]\d{4,8})\.h5", path.name) for path in self.folder.glob("sim_*.h5"))
        self.simulations = tuple(sorted(int(match[1]) for match in matches if match))
        """Numbers of the simulations, rising."""
        if not self.simulations:
            raise DataFileError(f"{self.folder}: expected files sim_0000.h5, …; got none: scripts/generate_data.py")
        self._cache: OrderedDict[int, StoredSimulation] = OrderedDict()
        self._infos = {}

    def __len__(self) -> int:
        """Number of states of all simulations together."""
        return sum(self.info(sim).count for sim in self.simulations)

    def _path(self, sim: int) -> Path:
        if sim not in self.simulations:
            raise KeyError(f"sim: expected a simulation of {self.folder}, got {sim!r}")
        return simulation_path(self.folder, sim)

    def info(self, sim: int):
        """The `SimulationInfo`, read without the arrays. Raises KeyError on an unknown simulation."""
        if sim not in self._infos:
            self._infos[sim] = simulation_info(self._path(sim))
        return self._infos[sim]

    def simulation(self, sim: int) -> StoredSimulation:
        """All states of a simulation, from memory if the store still has it there."""
        with _reading:
            if sim not in self._cache:
                self._cache[sim] = read_simulation(self._path(sim))
                while len(self._cache) > 1 and sum(kept.bytes for kept in self._cache.values()) > self.cache_bytes:
                    self._cache.popitem(last=False)
            self._cache.move_to_end(sim)
            return self._cache[sim]

    def state(self, sim: int, index: int) -> StateWithContacts:
        """One state, equal to the written one to the last bit."""
        return self.simulation(sim).state(index)

    def states(self, sims=None, *, phases=None) -> np.ndarray:
        """Pairs (simulation, index), (k, 2), of the states of some simulations (all by default), in order.

        phases: one of `PHASES`, the only phase whose states are returned; None: all phases.
        """
        pairs = [np.empty((0, 2), np.int64)]
        for sim in self.simulations if sims is None else sims:
            index = np.arange(self.info(sim).count)
            if phases is not None:
                index = index[phases_of(self.simulation(sim).arrays) == PHASES.index(one_of("phases", phases, PHASES))]
            pairs.append(np.stack([np.full_like(index, sim), index], axis=1))
        return np.concatenate(pairs)

    def data_hash(self, sims=None) -> str:
        """SHA-256 over the numbers and digests of some simulations (all by default), the same for every compression.

        The digests are those in the files; each is checked against the contents when the simulation is read.
        """
        lines = (f"{sim} {self.info(sim).digest}\n" for sim in (self.simulations if sims is None else sims))
        return hashlib.sha256("".join(lines).encode()).hexdigest()


def start_errors(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """‖λ₀ − λ‖ / ‖λ‖ of each state, (T,), λ₀ being its start; 0 where both are zero, infinite where only λ is.

    arrays: those of a `StoredSimulation`.
    """
    off = (arrays["normal_start"] - arrays["normal_impulse"]) ** 2
    off += (arrays["tangent_start"] - arrays["tangent_impulse"]) ** 2
    size = arrays["normal_impulse"] ** 2 + arrays["tangent_impulse"] ** 2
    counts = np.diff(arrays["contact_offset"])
    state = np.repeat(np.arange(counts.size), counts)
    off, size = (np.bincount(state, weights, counts.size) for weights in (off, size))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(off == 0, 0.0, np.sqrt(off / size))


def phases_of(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """The phase of each state as an index of `PHASES`, (T,), by the error of its start (`SETTLING`, `REST`).

    arrays: those of solved states of runs with Builtin's start, whose error is the change since the step before.
    """
    errors = start_errors(arrays)
    return (errors <= SETTLING).astype(np.int64) + (errors <= REST)


def phase(state: StateWithContacts) -> str:
    """The phase of a state, one of `PHASES`, by the rule of `phases_of`."""
    offsets = {"contact_offset": np.array([0, state.contacts.count])}
    return PHASES[phases_of(state.contacts._asdict() | offsets)[0]]


class Split(NamedTuple):
    """Numbers of the simulations for training, for the choice of the epoch, and for reports; increasing, disjoint."""

    train: tuple[int, ...]
    validation: tuple[int, ...]
    test: tuple[int, ...]


def split_by_simulation(sims, *, fractions=(0.8, 0.1, 0.1), seed: int = 0) -> Split:
    """Simulations assigned at random to three sides, each as a whole, since states of one simulation are similar.

    sims: numbers of the simulations. fractions: of train, validation and test, with the sum 1. A side with a positive
    fraction gets at least one simulation. The split depends on the seed and the numbers only.
    Raises ValueError for other fractions or too few simulations.
    """
    ids = np.unique(np.array(list(sims), np.int64))
    shares = np.array(fractions, float)
    if shares.shape != (3,) or not (shares >= 0).all() or not abs(shares.sum() - 1) < 1e-9:
        raise ValueError(f"fractions: expected three numbers >= 0 that sum to 1, got {fractions}")
    if ids.size < np.count_nonzero(shares):
        raise ValueError(f"sims: expected a simulation for each side, got {ids.size} simulations")
    counts = np.maximum(np.floor(shares * ids.size), shares > 0).astype(int)
    # Rounding errors are settled on the side that is furthest from its share.
    while left := ids.size - counts.sum():
        lack = shares * ids.size - counts
        counts[np.argmax(lack) if left > 0 else np.argmin(np.where(counts > 1, lack, np.inf))] += np.sign(left)
    dealt = np.random.default_rng(integer("seed", seed)).permutation(ids)
    return Split(*(tuple(sorted(side.tolist())) for side in np.split(dealt, np.cumsum(counts)[:2])))


def evenly(states: np.ndarray, count: int) -> np.ndarray:
    """About `count` of the states (k, 2), evenly spaced."""
    return states[:: max(1, len(states) // max(count, 1))]
