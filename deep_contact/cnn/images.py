"""States as images for a network, and a network's image back as impulses: `input_image`, `label_image`, `read_back`.

An image is a splat by `deep_contact.sph`: (n_y, n_x, channels), row 0 at y_min, float32. An `ImageSpec` defines it and
is stored with the model as JSON. Bodies and contacts are splatted with the same kernel and support radius; a channel of
contacts is 0 where there are none.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from typing import ClassVar

import numpy as np

from deep_contact.sph import Grid, gather, splat
from deep_contact.state.checks import check_solution
from deep_contact.state.state import State, native
from deep_contact.state.validation import number
from deep_contact.state.world import World
from deep_contact.stepping.prepare import ready

# A particle without a node within h goes to the nearest node, and a particle outside the box to the edge of the box.
# The contact with a wall lies outside by a part of its penetration: without a node its impulse would be lost.
_REACH = {"normalization": "particle", "unreached": "nearest", "outside": "clamp"}

CHANNELS = ("mass", "velocity_x", "velocity_y", "spin", "normal_x")
"""The five inputs of the thesis's network: mass, velocity before gravity and spin of the bodies, kg, m/s, rad/s; n_x of
the contacts."""

TARGETS = ("normal_impulse", "tangent_impulse")
"""The two outputs of the thesis's network, N·s."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """The definition of a network's images; model files hold it as JSON.

    spacing: distance of neighbouring nodes. support: h of the splat, in the unit of the spacing. Raises ValueError
    naming the field and the value.
    """

    spacing: float
    support: float

    channels: ClassVar[tuple[str, ...]]
    targets: ClassVar[tuple[str, ...]]
    multiple: ClassVar[int] = 1
    """The network takes n = 1 (mod multiple) nodes along an edge."""
    constants: ClassVar[dict] = {}
    """Field of a file that is no field of the dataclass -> its value."""
    removed: ClassVar[dict] = {}
    """Field of files of earlier versions -> the only value that is still read."""

    def __post_init__(self):
        for name in ("spacing", "support"):
            object.__setattr__(self, name, number(name, getattr(self, name), above=0))

    def to_dict(self) -> dict:
        """All fields as JSON knows them; `from_dict` gives the same spec to the last bit."""
        return self.constants | asdict(self)

    @classmethod
    def from_dict(cls, values: dict):
        """The spec with the fields of `to_dict`. Raises ValueError for missing, unknown, bad and outdated fields."""
        names, only = {field.name for field in fields(cls)}, cls.constants | cls.removed
        if not isinstance(values, dict) or set(values) - only.keys() != names:
            got = sorted(values) if isinstance(values, dict) else values
            raise ValueError(f"spec: {cls.__name__}: expected the fields {', '.join(sorted(names))}, got {got!r}")
        for name in only.keys() & values:
            if values[name] != only[name]:
                expected = f"expected {only[name]!r}, the only one left"
                raise ValueError(f"spec: {cls.__name__}: {name}: {expected}, got {values[name]!r}")
        return cls(**{name: values[name] for name in names})


@dataclass(frozen=True, kw_only=True)
class ImageSpec(Spec):
    """The definition of an image: a particle-normalised splat by poly6. Lengths are in m, by default the thesis's."""

    spacing: float = 0.5
    support: float = 0.5

    channels, targets = CHANNELS, TARGETS
    constants: ClassVar = {"channels": list(CHANNELS), "targets": list(TARGETS)}
    removed: ClassVar = {"kernel": "poly6", "transfer": "thesis", "normalization": "particle"}
    removed |= {"scale_free": False, "scales": [1.0] * len(CHANNELS), "target_scales": [1.0] * len(TARGETS)}

    def grid(self, world: World) -> Grid:
        """The grid over a world's box."""
        return _grid_over(tuple(world.box), self.spacing)

    def shape(self, world: World) -> tuple[int, int]:
        """(n_y, n_x) of the images of this world's states."""
        return self.grid(world).shape

    def splat(self, world: World, places: np.ndarray, values: np.ndarray) -> np.ndarray:
        """The image of particles at places (k, 2) with values (k, channels), float32."""
        return splat(self.grid(world), places, values, h=self.support, **_REACH).astype(np.float32)


@lru_cache(maxsize=16)
def _grid_over(box: tuple[float, ...], spacing: float) -> Grid:
    """`Grid.over_box`, computed once for each box: its checks take as long as the splat."""
    return Grid.over_box(box, spacing)


def input_image(state: State, spec: ImageSpec) -> np.ndarray:
    """The network's input, float32, (n_y, n_x, 5): see `CHANNELS`.

    Raises ValueError where the state has no contacts yet, or holds what is not finite.
    """
    state = with_contacts(state)
    bodies, contacts = state.bodies, state.contacts
    motion = np.column_stack([bodies.free_mass, bodies.velocity, bodies.spin])
    parts = (bodies.position, motion), (contacts.position, contacts.normal[:, :1])
    return np.concatenate([spec.splat(state.world, *part) for part in parts], axis=2)


def label_image(state: State, spec: ImageSpec) -> np.ndarray:
    """The image of the impulses that a solved state holds, float32, (n_y, n_x, 2), N·s.

    Raises ValueError where the state has not been solved.
    """
    check_solution(state)
    contacts = native(state).contacts
    impulses = np.column_stack([contacts.normal_impulse, contacts.tangent_impulse])
    return spec.splat(state.world, contacts.position, impulses)


def read_back(image, state: State, spec: ImageSpec) -> tuple[np.ndarray, np.ndarray]:
    """Impulses (normal, tangent) at the contacts from a network's image, (m,) each, N·s.

    image: (n_y, n_x, 2), N·s, which is read bilinearly (Algorithm 4). Nothing is projected on the friction cone here.
    Raises ValueError where the image does not fit the spec, or is not finite around a contact.
    """
    state, pixels = with_contacts(state), np.asarray(image, dtype=np.float64)
    expected = (*spec.shape(state.world), len(spec.targets))
    if pixels.shape != expected:
        raise ValueError(f"image: expected shape {expected}, got {pixels.shape}")
    values = gather(spec.grid(state.world), pixels, state.contacts.position, **_REACH)
    normal, tangent = np.ascontiguousarray(values.T)
    return normal, tangent


def with_contacts(state: State) -> State:
    """The state, checked. Raises ValueError where its contacts have not been searched, or it is not valid."""
    if state.contacts is None:
        raise ValueError("state.contacts: expected contacts, got None; `dc.find_contacts(state)` finds them")
    return ready(state)
