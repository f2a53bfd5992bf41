"""The data set of a training: a folder of simulation files (`deep_contact.io.simulation_h5`), and their split."""

from __future__ import annotations

import hashlib
import re
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from threading import Lock
from typing import NamedTuple

import numpy as np

from deep_contact.io.simulation_h5 import DataFileError, StoredSimulation, read_simulation, simulation_info
from deep_contact.state.state import StateWithContacts
from deep_contact.state.validation import integer, one_of

PHASES = ("impact", "settling", "rest")
"""Phases of a run, by which states are sorted."""

SETTLING, REST = 0.5, 0.05
"""Largest relative error of a state's start (`start_errors`) with which the state is settling, and at rest."""

_reading = Lock()
"""Lock that a thread holds while a store reads a file and changes its cache."""


def simulation_path(folder, sim: int) -> Path:
    """Return the path of the file of simulation number `sim` in a folder."""
    return Path(folder) / f"sim_{sim:04d}.h5"


class Store:
    """The simulations of a folder: `sim_0000.h5`, `sim_0001.h5`, …

    The first access to a state reads and checks its whole simulation. The simulations that were used last stay in
    memory, decompressed.
    folder: path of the folder. cache_bytes: limit of this memory; the last simulation stays even if it is larger.
    Raises DataFileError if the folder has no simulation.
    """

    def __init__(self, folder, *, cache_bytes: int = 8 * 2**30):
        self.folder = Path(folder)
        self.cache_bytes = integer("cache_bytes", cache_bytes)
        matches = (re.fullmatch(r"sim_(\d{4}|[1-9]\d{4,8})\.h5", path.name) for path in self.folder.glob("sim_*.h5"))
        self.simulations = tuple(sorted(int(match[1]) for match in matches if match))
        """Numbers of the simulations in the folder, in ascending order."""
        if not self.simulations:
            raise DataFileError(f"{self.folder}: expected files sim_0000.h5, …; got none: scripts/generate_data.py")
        self._cache: OrderedDict[int, StoredSimulation] = OrderedDict()
        self._infos = {}

    def __len__(self) -> int:
        """Return the number of states in all simulations together."""
        return sum(self.info(sim).count for sim in self.simulations)

    def _path(self, sim: int) -> Path:
        if sim not in self.simulations:
            raise KeyError(f"sim: expected a simulation of {self.folder}, got {sim!r}")
        return simulation_path(self.folder, sim)

    def info(self, sim: int):
        """Return the `SimulationInfo` of simulation number `sim`, which is read without its arrays.

        Raises KeyError on an unknown simulation.
        """
        if sim not in self._infos:
            self._infos[sim] = simulation_info(self._path(sim))
        return self._infos[sim]

    def simulation(self, sim: int) -> StoredSimulation:
        """Return all states of simulation number `sim`, from memory if it is still there, otherwise from its file."""
        with _reading:
            if sim not in self._cache:
                self._cache[sim] = read_simulation(self._path(sim))
                while len(self._cache) > 1 and sum(kept.bytes for kept in self._cache.values()) > self.cache_bytes:
                    self._cache.popitem(last=False)
            self._cache.move_to_end(sim)
            return self._cache[sim]

    def state(self, sim: int, index: int) -> StateWithContacts:
        """Return state number `index` of simulation number `sim`. It equals the state that was written, bit by bit."""
        return self.simulation(sim).state(index)

    def states(self, sims=None, *, phases=None) -> np.ndarray:
        """Return pairs (number of the simulation, index of the state), (k, 2), in order.

        sims: numbers of the simulations; None: all of them. phases: one of `PHASES`, the phase whose states are
        returned; None: states of all phases.
        """
        pairs = [np.empty((0, 2), np.int64)]
        for sim in self.simulations if sims is None else sims:
            index = np.arange(self.info(sim).count)
            if phases is not None:
                index = index[phases_of(self.simulation(sim).arrays) == PHASES.index(one_of("phases", phases, PHASES))]
            pairs.append(np.stack([np.full_like(index, sim), index], axis=1))
        return np.concatenate(pairs)

    def data_hash(self, sims=None) -> str:
        """Return the SHA-256 of the numbers and digests of some simulations.

        It does not depend on the compression of the files.
        sims: numbers of the simulations; None: all of them. The digests are read from the files. A digest is checked
        against the contents of its file only when the simulation is read.
        """
        lines = (f"{sim} {self.info(sim).digest}\n" for sim in (self.simulations if sims is None else sims))
        return hashlib.sha256("".join(lines).encode()).hexdigest()


def start_errors(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the relative error ‖λ₀ − λ‖ / ‖λ‖ of the start of each state, (T,).

    λ are the solved impulses of a state, and λ₀ the impulses from which its solution began. The error is 0 if both are
    zero, and infinite if only λ is zero. arrays: the arrays of a `StoredSimulation`.
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
    """Return the phase of each state as an index of `PHASES`, (T,).

    The relative error of a state's start decides its phase, by the thresholds `SETTLING` and `REST`. The states have to
    be solved, and their start has to be "builtin", the impulses of the step before. The error is then the change of the
    impulses in a step. arrays: the arrays of a `StoredSimulation`.
    """
    errors = start_errors(arrays)
    return (errors <= SETTLING).astype(np.int64) + (errors <= REST)


def phase(state: StateWithContacts) -> str:
    """Return the phase of a solved state, one of `PHASES`, by the rule of `phases_of`."""
    offsets = {"contact_offset": np.array([0, state.contacts.count])}
    return PHASES[phases_of(state.contacts._asdict() | offsets)[0]]


class Split(NamedTuple):
    """A split of simulations into three disjoint sets. Each field has the numbers of its simulations, ascending.

    train: simulations to train on. validation: simulations by which the best epoch is chosen. test: simulations for the
    reported errors.
    """

    train: tuple[int, ...]
    validation: tuple[int, ...]
    test: tuple[int, ...]


def split_by_simulation(sims: Iterable[int], *, fractions: Sequence[float] = (0.8, 0.1, 0.1), seed: int = 0) -> Split:
    """Split simulations at random into training, validation and test sets.

    All states of a simulation go to the same set, because they are similar. sims: numbers of the simulations.
    fractions: shares of the simulations for the training, validation and test sets, with the sum 1. A set with a
    positive share gets at least one simulation. seed: seed of the random numbers; the split depends on the seed and the
    numbers only. Raises ValueError for other fractions or too few simulations.
    """
    ids = np.unique(np.array(list(sims), np.int64))
    shares = np.array(fractions, float)
    if shares.shape != (3,) or not (shares >= 0).all() or not abs(shares.sum() - 1) < 1e-9:
        raise ValueError(f"fractions: expected three numbers >= 0 that sum to 1, got {fractions}")
    if ids.size < np.count_nonzero(shares):
        raise ValueError(f"sims: expected a simulation for each side, got {ids.size} simulations")
    counts = np.maximum(np.floor(shares * ids.size), shares > 0).astype(int)
    # Simulations that rounding left over go to the set that is furthest below its share. Those in excess are taken from
    # the set that is furthest above its share.
    while left := ids.size - counts.sum():
        lack = shares * ids.size - counts
        counts[np.argmax(lack) if left > 0 else np.argmin(np.where(counts > 1, lack, np.inf))] += np.sign(left)
    dealt = np.random.default_rng(integer("seed", seed)).permutation(ids)
    return Split(*(tuple(sorted(side.tolist())) for side in np.split(dealt, np.cumsum(counts)[:2])))


def evenly(states: np.ndarray, count: int) -> np.ndarray:
    """Return about `count` of the states, evenly spaced. states: pairs (simulation, index), (k, 2)."""
    return states[:: max(1, len(states) // max(count, 1))]
