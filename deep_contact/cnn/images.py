"""States as images for a network, and a network's image back as impulses: `input_image`, `label_image`, `read_back`.

An image is a splat by `deep_contact.sph`: (n_y, n_x, channels), row 0 at y_min, float32. An `ImageSpec` defines it and
is stored with the model as JSON. Bodies and contacts are splatted with the same kernel and support radius; a channel of
contacts is 0 where there are none.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import ClassVar

import numpy as np

from deep_contact.sph import Grid, gather, splat
from deep_contact.state import State, World, native
from deep_contact.validation import number, one_of

# A particle that no node is within h of goes to the nearest node, and one outside the box to its edge. A contact with a
# wall lies outside by a part of its penetration; on no node, its impulse would become a start of zero.
_REACH = {"normalization": "particle", "unreached": "nearest", "outside": "clamp"}


CHANNELS = {
    "mass": ("bodies", lambda bodies: bodies.mass),
    "velocity_x": ("bodies", lambda bodies: bodies.velocity[:, 0]),
    "velocity_y": ("bodies", lambda bodies: bodies.velocity[:, 1]),
    "spin": ("bodies", lambda bodies: bodies.spin),
    "normal_x": ("contacts", lambda contacts: contacts.normal[:, 0]),
    "normal_y": ("contacts", lambda contacts: contacts.normal[:, 1]),
}
"""Name of an input channel -> what is splatted, and its values (k,): kg, m/s before gravity, rad/s, and the normal."""

TARGETS = {
    "normal_impulse": ("contacts", lambda contacts: contacts.normal_impulse),
    "tangent_impulse": ("contacts", lambda contacts: contacts.tangent_impulse),
}
"""The same of the output channels, N·s."""

THESIS_CHANNELS = ("mass", "velocity_x", "velocity_y", "spin", "normal_x")
"""The five inputs of the thesis's network, in its order."""


class Spec:
    """What the images of a network are: a dataclass that model files hold as JSON."""

    multiple: ClassVar[int] = 1
    """The network takes n = 1 (mod multiple) nodes along an edge."""
    constants: ClassVar[dict] = {}
    """Field of a file that is no field of the dataclass -> its value."""
    removed: ClassVar[dict] = {}
    """The same of files of earlier versions: name -> the only value that still has a meaning."""

    def to_dict(self) -> dict:
        """All fields as JSON knows them; `from_dict` gives the same spec to the last bit."""
        values = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
        return self.constants | values

    @classmethod
    def from_dict(cls, values: dict):
        """The spec of `to_dict`. Raises ValueError on missing, unknown or bad fields, also of earlier versions."""
        names, only = {field.name for field in fields(cls)}, cls.constants | cls.removed
        if not isinstance(values, dict) or set(values) - only.keys() != names:
            got = sorted(values) if isinstance(values, dict) else values
            raise ValueError(f"{cls.__name__}: expected the fields {', '.join(sorted(names))}, got {got!r}")
        for name in only.keys() & values:
            entries = values[name] if isinstance(values[name], list) else [values[name]]
            if any(value != only[name] for value in entries):
                raise ValueError(
                    f"{cls.__name__}: {name}: expected {only[name]!r}, the only one left, got {values[name]!r}"
                )
        return cls(**{name: values[name] for name in names})


@dataclass(frozen=True, kw_only=True)
class ImageSpec(Spec):
    """The definition of an image: a particle-normalised splat by poly6. The defaults are the thesis's.

    spacing: d of the grid, m. support: radius h of the kernel, m. channels: names of `CHANNELS`. targets: names of
    `TARGETS`. Raises ValueError naming the field and the value.
    """

    spacing: float = 0.5
    support: float = 0.5
    channels: tuple[str, ...] = THESIS_CHANNELS
    targets: tuple[str, ...] = tuple(TARGETS)

    removed: ClassVar = {"kernel": "poly6", "transfer": "thesis", "normalization": "particle"}
    removed |= {"scale_free": False, "scales": 1.0, "target_scales": 1.0}

    def __post_init__(self):
        for name in ("spacing", "support"):
            object.__setattr__(self, name, number(name, getattr(self, name), above=0))
        for name, table in (("channels", CHANNELS), ("targets", TARGETS)):
            object.__setattr__(self, name, _names(name, getattr(self, name), table))

    def grid(self, world: World) -> Grid:
        """The grid over a world's box."""
        return Grid.over_box(world.box, self.spacing)

    def shape(self, world: World) -> tuple[int, int]:
        """(n_y, n_x) of the images of this world's states."""
        return self.grid(world).shape


def _names(name: str, chosen, table) -> tuple[str, ...]:
    names = (chosen,) if isinstance(chosen, str) or not np.iterable(chosen) else tuple(chosen)
    for i, item in enumerate(names):
        one_of(f"{name}[{i}]", item, table)
    if not names or len(set(names)) != len(names):
        raise ValueError(f"{name}: expected one or more different names, got {chosen!r}")
    return names


def input_image(state: State, spec: ImageSpec) -> np.ndarray:
    """The network's input, float32, (n_y, n_x, channels).

    Raises ValueError where the state has no contacts yet, or holds what is not finite.
    """
    return _image(state, spec, [CHANNELS[name] for name in spec.channels])


def label_image(state: State, spec: ImageSpec) -> np.ndarray:
    """The image of the impulses that a solved state holds, float32, (n_y, n_x, targets), N·s.

    Raises ValueError where the state has not been solved.
    """
    if not state.solved:
        raise ValueError("state.solved: expected a state that holds its solution, got False")
    return _image(state, spec, [TARGETS[name] for name in spec.targets])


def read_back(image, state: State, spec: ImageSpec) -> tuple[np.ndarray, ...]:
    """Impulses at the contacts from a network's image: one array (m,) a target, N·s; by default (normal, tangent).

    image: (n_y, n_x, targets), N·s. Nothing is projected on the friction cone here.
    It reads bilinearly (Algorithm 4). Raises ValueError where the image does not fit the spec, or is not finite around
    a contact.
    """
    state, pixels = with_contacts(state), np.asarray(image, dtype=np.float64)
    expected = (*spec.shape(state.world), len(spec.targets))
    if pixels.shape != expected:
        raise ValueError(f"image: expected shape {expected}, got {pixels.shape}")
    values = gather(spec.grid(state.world), pixels, state.contacts.position, **_REACH)
    return tuple(np.ascontiguousarray(column) for column in values.T)


def _image(state: State, spec: ImageSpec, channels: list) -> np.ndarray:
    state, grid = with_contacts(state), spec.grid(state.world)
    image = np.empty((*grid.shape, len(channels)), np.float32)
    for name, particles in (("bodies", state.bodies), ("contacts", state.contacts)):
        chosen = [i for i, (of, _) in enumerate(channels) if of == name]
        if chosen:
            values = np.column_stack([channels[i][1](particles) for i in chosen])
            image[:, :, chosen] = splat(grid, particles.position, values, h=spec.support, **_REACH)
    return image


def with_contacts(state: State) -> State:
    """The state in this machine's byte order. Raises ValueError where its contacts have not been searched."""
    if state.contacts is None:
        raise ValueError("state.contacts: expected contacts, got None; `dc.find_contacts(state)` finds them")
    return native(state)
