"""Images of states, as the input and the labels of a network, and impulses that are read from a network's image.

`input_image` and `label_image` make images, and `read_back` reads impulses from an image. An image is a splat by
`deep_contact.sph`: (n_y, n_x, channels), row 0 at y_min, float32. An `ImageSpec` defines it, and is stored with the
model as JSON. Bodies and contacts are splatted with the same kernel and support radius. A channel of contacts is 0 at
nodes to which no contact is splatted.
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

# Options of `splat` and `gather`. A particle with no node within h acts on the nearest node. A particle outside the box
# is moved to the box's edge: a contact point at a wall lies outside by half of the penetration, and its impulse could
# be lost otherwise.
_REACH = {"normalization": "particle", "unreached": "nearest", "outside": "clamp"}

CHANNELS = ("mass", "velocity_x", "velocity_y", "spin", "normal_x")
"""The five input channels of the thesis's network.

They are the bodies' mass, kg, velocity, m/s, and spin, rad/s, and the x component of the contacts' unit normal.
Velocity and spin are those before the step's gravity is applied.
"""

TARGETS = ("normal_impulse", "tangent_impulse")
"""The two output channels of the thesis's network: normal and tangent impulse of the contacts, N·s."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """The definition of a network's images, which model files store as JSON.

    spacing: distance of neighbouring nodes. support: support radius h of the splat, in the same unit. channels,
    targets: names of the input and output channels. Raises ValueError naming the field and the value.
    """

    spacing: float
    support: float

    channels: ClassVar[tuple[str, ...]]
    targets: ClassVar[tuple[str, ...]]
    multiple: ClassVar[int] = 1
    """The number of nodes along an edge of an image has to be one more than a multiple of this number."""
    constants: ClassVar[dict] = {}
    """Entries of the JSON object that are not fields of the dataclass: name -> the only allowed value."""
    removed: ClassVar[dict] = {}
    """Entries that files of earlier versions have: name -> the only value with which a file is still read."""

    def __post_init__(self):
        for name in ("spacing", "support"):
            object.__setattr__(self, name, number(name, getattr(self, name), above=0))

    def to_dict(self) -> dict:
        """Return all fields as a dict that JSON can hold. `from_dict` makes the same spec of it, bit by bit."""
        return self.constants | asdict(self)

    @classmethod
    def from_dict(cls, values: dict):
        """Return the spec for a dict of `to_dict`. Raises ValueError for missing, unknown, bad and outdated fields."""
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
    """The definition of an image: a splat with the kernel poly6, normalised by particle. The defaults are the thesis's.

    spacing: distance of neighbouring nodes, m. support: support radius h of the splat, m.
    """

    spacing: float = 0.5
    support: float = 0.5

    channels, targets = CHANNELS, TARGETS
    constants: ClassVar = {"channels": list(CHANNELS), "targets": list(TARGETS)}
    removed: ClassVar = {"kernel": "poly6", "transfer": "thesis", "normalization": "particle"}
    removed |= {"scale_free": False, "scales": [1.0] * len(CHANNELS), "target_scales": [1.0] * len(TARGETS)}

    def grid(self, world: World) -> Grid:
        """Return the grid that covers a world's box."""
        return _grid_over(tuple(world.box), self.spacing)

    def shape(self, world: World) -> tuple[int, int]:
        """Return (n_y, n_x), the nodes of an image of a state in this world."""
        return self.grid(world).shape

    def splat(self, world: World, places: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the image of some particles, (n_y, n_x, channels), float32.

        places: positions of the particles, (k, 2), m. values: (k, channels).
        """
        return splat(self.grid(world), places, values, h=self.support, **_REACH).astype(np.float32)


@lru_cache(maxsize=16)
def _grid_over(box: tuple[float, ...], spacing: float) -> Grid:
    """Return `Grid.over_box(box, spacing)` from a cache, because the checks of a new `Grid` take as long as a splat."""
    return Grid.over_box(box, spacing)


def input_image(state: State, spec: ImageSpec) -> np.ndarray:
    """Return the network's input image of a state, (n_y, n_x, 5), float32, with the channels `CHANNELS`.

    Raises ValueError if the state's contacts have not been searched, or if a number in the state is not finite.
    """
    state = with_contacts(state)
    bodies, contacts = state.bodies, state.contacts
    motion = np.column_stack([bodies.free_mass, bodies.velocity, bodies.spin])
    parts = (bodies.position, motion), (contacts.position, contacts.normal[:, :1])
    return np.concatenate([spec.splat(state.world, *part) for part in parts], axis=2)


def label_image(state: State, spec: ImageSpec) -> np.ndarray:
    """Return the image of the impulses of a solved state, (n_y, n_x, 2), float32, N·s.

    Raises ValueError if the state has not been solved.
    """
    check_solution(state)
    contacts = native(state).contacts
    impulses = np.column_stack([contacts.normal_impulse, contacts.tangent_impulse])
    return spec.splat(state.world, contacts.position, impulses)


def read_back(image, state: State, spec: ImageSpec) -> tuple[np.ndarray, np.ndarray]:
    """Return the impulses (λ_n, λ_t) at the contacts, (m,) each, N·s, read from a network's image.

    The image is read bilinearly (Algorithm 4). The impulses are not projected on the friction cone.
    image: (n_y, n_x, 2), N·s. Raises ValueError if the image does not have the shape of the spec, or is not finite
    around a contact.
    """
    state, pixels = with_contacts(state), np.asarray(image, dtype=np.float64)
    expected = (*spec.shape(state.world), len(spec.targets))
    if pixels.shape != expected:
        raise ValueError(f"image: expected shape {expected}, got {pixels.shape}")
    values = gather(spec.grid(state.world), pixels, state.contacts.position, **_REACH)
    normal, tangent = np.ascontiguousarray(values.T)
    return normal, tangent


def with_contacts(state: State) -> State:
    """Return the state, checked and with arrays for compiled code.

    Raises ValueError if its contacts have not been searched, or if the state is not valid.
    """
    if state.contacts is None:
        raise ValueError("state.contacts: expected contacts, got None; `dc.find_contacts(state)` finds them")
    return ready(state)
