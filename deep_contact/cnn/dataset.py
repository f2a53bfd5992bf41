"""A store of many simulations' files (`deep_contact.io.simulation_h5`), and the batches of images that training takes.

What concerns a single file is imported from there and remains available here.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deep_contact.cnn.images import CHANNELS, ImageSpec, augment, image_pair, symmetries
from deep_contact.io.simulation_h5 import (  # noqa: F401
    PHASES,
    REST,
    SETTLING,
    DataFileError,
    SimulationInfo,
    StoredSimulation,
    pack_simulation,
    phase,
    read_simulation,
    simulation_file,
    simulation_info,
    start_error,
    write_simulation,
)
from deep_contact.state import State
from deep_contact.validation import integer, one_of

CACHE_BYTES = 8 * 2**30
"""Memory that a store keeps of simulations it has read, unpacked."""


def simulation_path(folder, sim: int) -> Path:
    """Where simulation `sim` of a folder lies."""
    return Path(folder) / f"sim_{sim:04d}.h5"


class Store:
    """The simulations of a folder: `sim_0000.h5`, `sim_0001.h5`, … Iterating over a store yields all states in order.

    A simulation is read and checked as a whole on the first access to one of its states. The last ones are kept in
    memory, up to `cache_bytes` (at least one). Raises DataFileError where there is none.
    """

    def __init__(self, folder, *, cache_bytes: int = CACHE_BYTES):
        self.folder = Path(folder)
        self.cache_bytes = integer("cache_bytes", cache_bytes)
        matches = (re.fullmatch(r"sim_(\d{4,9})\.h5", path.name) for path in self.folder.glob("sim_*.h5"))
        found = sorted(int(match[1]) for match in matches if match)
        self.simulations = tuple(sim for sim in found if simulation_path(self.folder, sim).exists())
        """Numbers of the simulations, rising."""
        if not self.simulations:
            raise DataFileError(f"{self.folder}: expected files sim_0000.h5, …; got none: scripts/generate_data.py")
        self._cache: OrderedDict[int, StoredSimulation] = OrderedDict()
        self._infos: dict[int, SimulationInfo] = {}

    def __len__(self) -> int:
        """Number of states in all."""
        return sum(self.info(sim).count for sim in self.simulations)

    def __iter__(self) -> Iterator[State]:
        """All states, one simulation after the other."""
        return (self.state(sim, index) for sim, index in self.states().tolist())

    def path(self, sim: int) -> Path:
        """The file of a simulation. Raises KeyError on an unknown one."""
        if sim not in self.simulations:
            raise KeyError(f"sim: expected a simulation of {self.folder}, got {sim!r}")
        return simulation_path(self.folder, sim)

    def info(self, sim: int) -> SimulationInfo:
        """Header and size of a simulation, read without its arrays."""
        if sim not in self._infos:
            self._infos[sim] = simulation_info(self.path(sim))
        return self._infos[sim]

    def simulation(self, sim: int) -> StoredSimulation:
        """All states of a simulation, from memory if it was among the last ones read."""
        sim = int(sim)
        if sim in self._cache:
            self._cache.move_to_end(sim)
            return self._cache[sim]
        needed = self.info(sim).bytes
        # Make room first, so that the bound holds while the file is read.
        while self._cache and needed + sum(kept.bytes for kept in self._cache.values()) > self.cache_bytes:
            self._cache.popitem(last=False)
        self._cache[sim] = read_simulation(self.path(sim))
        return self._cache[sim]

    def state(self, sim: int, index: int) -> State:
        """One state, to the last bit what was written."""
        return self.simulation(sim).state(index)

    def states(self, sims=None, *, phases=None, stride: int = 1) -> np.ndarray:
        """(k, 2) of (simulation, index): every stride-th state of some simulations (all by default), in order.

        phases: one of `PHASES` or several; then every stride-th state of these phases.
        """
        integer("stride", stride, 1)
        phases = (phases,) if isinstance(phases, str) else phases
        wanted = sorted({PHASES.index(one_of("phases", name, PHASES)) for name in phases or PHASES})
        found = []
        for sim in self.simulations if sims is None else sims:
            index = np.arange(self.info(sim).count)
            if len(wanted) < len(PHASES):
                index = index[np.isin(self.simulation(sim).phases(), wanted)]
            found.append(np.stack([np.full_like(index, sim), index], axis=1)[::stride])
        return np.concatenate(found) if found else np.empty((0, 2), np.int64)

    def data_hash(self, sims=None) -> str:
        """SHA-256 over the numbers and digests of some simulations (all by default), whatever their compression.

        The digests are those in the files; each is checked against the contents when the simulation is read.
        """
        lines = (f"{sim} {self.info(sim).digest}\n" for sim in (self.simulations if sims is None else sims))
        return hashlib.sha256("".join(lines).encode()).hexdigest()


class Split(NamedTuple):
    """Numbers of the simulations to train on, to choose the epoch by, and to report; increasing and disjoint."""

    train: tuple[int, ...]
    validation: tuple[int, ...]
    test: tuple[int, ...]


def split_by_simulation(store_or_ids, *, fractions=(0.8, 0.1, 0.1), seed: int = 0) -> Split:
    """Simulations assigned at random to three sides, each as a whole, since states of one simulation are similar.

    store_or_ids: a `Store`, or numbers of simulations. fractions: of train, validation and test, with the sum 1. A side
    with a fraction > 0 gets at least one simulation. The split depends on the seed and the numbers only.
    Raises ValueError for other fractions or too few simulations.
    """
    ids = store_or_ids.simulations if isinstance(store_or_ids, Store) else tuple(int(i) for i in store_or_ids)
    ids = np.array(sorted(set(ids)), dtype=np.int64)
    shares = np.array([float(f) for f in fractions])
    if shares.shape != (3,) or not (shares >= 0).all() or not abs(shares.sum() - 1) < 1e-9:
        raise ValueError(f"fractions: expected three numbers >= 0 that sum to 1, got {fractions}")
    if ids.size < np.count_nonzero(shares):
        raise ValueError(f"store_or_ids: expected a simulation for each side, got {ids.size} simulations")
    counts = np.floor(shares * ids.size).astype(int)
    counts[(shares > 0) & (counts == 0)] = 1
    # Rounding errors are settled on the side that is furthest from its share.
    while counts.sum() != ids.size:
        lack = shares * ids.size - counts
        if counts.sum() < ids.size:
            counts[np.argmax(lack)] += 1
        else:
            counts[np.argmin(np.where(counts > 1, lack, np.inf))] -= 1
    dealt = np.random.default_rng(integer("seed", seed)).permutation(ids)
    sides = np.split(dealt, np.cumsum(counts)[:2])
    return Split(*(tuple(sorted(side.tolist())) for side in sides))


class Batch(NamedTuple):
    """Some states as images.

    | field    | meaning                                                    | shape               |
    |----------|------------------------------------------------------------|---------------------|
    | inputs   | float32                                                    | (b, n_y, n_x, c)    |
    | labels   | float32, in the network's units                            | (b, n_y, n_x, t)    |
    | scales   | s by which both were divided; 1 if not scale-free          | (b,)                |
    | states   | (simulation, index) of each, for `Store.state`             | (b, 2)              |
    | symmetry | symmetry of each (`images.augment`); 0 is the identity     | (b,)                |
    """

    inputs: np.ndarray
    labels: np.ndarray
    scales: np.ndarray
    states: np.ndarray
    symmetry: np.ndarray


class ImageBatches:
    """Batches of images, splatted on access; the same for the same seed and epoch.

    store: a `Store`. sims: numbers of simulations (a side of a `Split`), or None for all. spec: an `ImageSpec`.
    states: (k, 2) of (simulation, index), instead of all states of `sims`. shuffle: in random order, by epoch.
    augment: apply one of the spec's `symmetries` to each state at random. drop_last: omit a last, smaller batch.

    Memory is limited to the store's cache: if it does not hold all simulations, random groups that fit are shuffled one
    after the other. Raises ValueError where two simulations have images of different shapes.
    """

    def __init__(
        self,
        store: Store,
        sims,
        spec: ImageSpec,
        *,
        batch_size: int = 32,
        seed: int = 0,
        shuffle: bool = True,
        augment: bool = False,
        states=None,
        drop_last: bool = False,
    ):
        integer("batch_size", batch_size, 1)
        if states is None:
            states = store.states(None if sims is None else sims)
        self.states = np.array(states, dtype=np.int64).reshape(-1, 2)
        sims = np.unique(self.states[:, 0]).tolist() if sims is None else [int(sim) for sim in sims]
        strange = sorted(set(self.states[:, 0].tolist()) - set(sims))
        if strange:
            raise ValueError(f"states: expected states of the simulations in sims, got {strange}")
        for sim, index in self.states[(self.states[:, 1] < 0)][:1]:
            raise ValueError(f"states: expected indices >= 0, got {index} of simulation {sim}")
        self.store, self.spec = store, spec
        self.batch_size, self.seed, self.shuffle, self.augment = batch_size, int(seed), shuffle, augment
        self.drop_last = drop_last
        self.shape = (0, 0)
        worlds = [store.info(sim).header["world"] for sim in np.unique(self.states[:, 0]).tolist()]
        for world in worlds:
            if spec.shape(world) != spec.shape(worlds[0]):
                raise ValueError(f"sims: expected boxes of one size, got {worlds[0].box} and {world.box}")
        if worlds:
            self.shape = spec.shape(worlds[0])
        turns = [set(symmetries(spec, world)) for world in worlds]
        self._symmetries = np.array(sorted(set.intersection(*turns))) if augment and turns else np.zeros(1, np.int64)

    def __len__(self) -> int:
        """Number of batches in an epoch."""
        full, rest = divmod(len(self.states), self.batch_size)
        return full + (1 if rest and not self.drop_last else 0)

    def order(self, epoch: int) -> tuple[np.ndarray, np.ndarray]:
        """States (k, 2) and symmetries (k,) of an epoch, in the order in which they come."""
        rng = np.random.default_rng((self.seed, int(epoch)))
        symmetry = rng.choice(self._symmetries, len(self.states))
        if not self.shuffle:
            return self.states, symmetry
        sims, which = np.unique(self.states[:, 0], return_inverse=True)
        dealt = rng.permutation(sims.size)
        size = np.array([self.store.info(sim).bytes for sim in sims.tolist()], dtype=np.int64)
        # Less than the cache holds: a group may exceed this by a part of one simulation.
        limit = max(1, self.store.cache_bytes - size.max(initial=0))
        group = np.empty_like(size)
        group[dealt] = np.cumsum(size[dealt]) // limit
        return self.states[np.lexsort((rng.random(len(self.states)), group[which]))], symmetry

    def epoch(self, epoch: int = 0) -> Iterator[Batch]:
        """The batches of an epoch."""
        states, symmetry = self.order(epoch)
        for k in range(len(self)):
            chosen = slice(k * self.batch_size, (k + 1) * self.batch_size)
            yield self.batch(states[chosen], symmetry[chosen])

    def __iter__(self) -> Iterator[Batch]:
        return self.epoch(0)

    def batch(self, states, symmetry=None) -> Batch:
        """The batch of given states, (b, 2), turned by `symmetry`, (b,)."""
        states = np.asarray(states, dtype=np.int64).reshape(-1, 2)
        b = len(states)
        symmetry = np.zeros(b, np.int64) if symmetry is None else np.asarray(symmetry, dtype=np.int64)
        inputs = np.empty((b, *self.shape, len(self.spec.channels)), np.float32)
        labels = np.empty((b, *self.shape, len(self.spec.targets)), np.float32)
        scales = np.empty(b)
        for i, (sim, index) in enumerate(states.tolist()):
            image, label, scales[i] = image_pair(self.store.state(sim, index), self.spec)
            if symmetry[i]:
                image, label = augment(image, label, self.spec, int(symmetry[i]))
            inputs[i], labels[i] = image, label
        return Batch(inputs, labels, scales, states, symmetry)


def fit_scales(store: Store, sims, spec: ImageSpec, *, count: int = 500, seed: int = 0, states=None) -> ImageSpec:
    """The spec with its scales measured: the root mean square of each channel over the nodes where it is not zero.

    count: states drawn by chance from the simulations (train on no others). The two parts of a vector share a scale,
    so that the symmetries stay. A channel that is zero throughout keeps 1.
    """
    integer("count", count, 1)
    plain = spec.replace(scales=None, target_scales=None)
    batches = ImageBatches(store, sims, plain, batch_size=1, seed=seed, states=states)
    chosen = np.random.default_rng(integer("seed", seed)).permutation(batches.states)[:count]
    chosen = chosen[np.lexsort(chosen.T[::-1])]  # by simulation, so that each is read once
    totals = np.zeros(len(spec.channels) + len(spec.targets))
    nodes = np.zeros_like(totals)
    for state in chosen:
        batch = batches.batch(state)
        image = np.concatenate([batch.inputs[0], batch.labels[0]], axis=-1).astype(np.float64)
        totals += np.sum(image**2, axis=(0, 1))
        nodes += np.count_nonzero(image, axis=(0, 1))
    for i, name in enumerate(spec.channels):
        partner = CHANNELS[name].partner
        if CHANNELS[name].kind in ("x", "xx") and (partner or "normal_xy") in spec.channels:
            pair = [i, spec.channels.index(partner or "normal_xy")]
            totals[pair], nodes[pair] = totals[pair].sum(), nodes[pair].sum()
    rms = [math.sqrt(total / many) if total > 0 else 1.0 for total, many in zip(totals.tolist(), nodes.tolist())]
    split = len(spec.channels)
    return spec.replace(scales=tuple(rms[:split]), target_scales=tuple(rms[split:]))
