"""States as images for a network, and a network's image back as impulses: `input_image`, `label_image`, `read_back`.

An image is a splat by `deep_contact.sph`: (n_y, n_x, channels), row 0 at y_min, float32. An `ImageSpec` defines it
completely and is stored with the model as JSON. Bodies and contacts are splatted with the same kernel and support
radius; a channel of contacts is 0 where there are none.

The channels, by name (`CHANNELS`); the solver knows those of contacts before its first sweep:

| name                      | of      | meaning                                                            | unit  |
|---------------------------|---------|--------------------------------------------------------------------|-------|
| mass                      | bodies  | m                                                                  | kg    |
| velocity_x, velocity_y    | bodies  | v, before gravity                                                  | m/s   |
| spin                      | bodies  | ω                                                                  | rad/s |
| normal_x, normal_y        | contacts| n, whose sign depends on the numbers of the bodies                 | –     |
| normal_xx, normal_xy      | contacts| n_x² − n_y², 2 n_x n_y, which do not                               | –     |
| contact_density           | contacts| 1: the density D of the consistent transfer                        | –     |
| approach                  | contacts| v_n after Δt of gravity, less its target by restitution (row of b)  | m/s   |
| slip                      | contacts| v_t of the surfaces after Δt of gravity (row of b)                 | m/s   |
| effective_mass            | contacts| 1 / (J M⁻¹ Jᵀ) of the normal row                                   | kg    |
| builtin_normal, builtin_tangent | contacts | impulses carried over from the step before                  | N·s   |

Symmetries (`augment`): a state may be turned by quarter turns and mirrored, and its solution goes along. v and n turn
as vectors, (n_x² − n_y², 2 n_x n_y) by twice the angle; ω, slip and λ_t change their sign in a mirror. The sign of n
does not matter to λ: n, t and the relative velocity flip together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from deep_contact.cnn.rows import row_velocities
from deep_contact.physics.contact_solver import NORMAL_MASS, V_X, V_Y
from deep_contact.physics.engine import StepProblem, step_problem
from deep_contact.sph import KERNELS, Grid, gather, splat
from deep_contact.sph.grid import ROUNDING
from deep_contact.state import State, World, check_contacts, native
from deep_contact.validation import flag, integer, number, one_of

# Every particle is mapped. Where h < d / √2 some particles have no node within h: they go to the nearest node, since
# an impulse on no node would become a start of zero. A contact with a wall lies outside the grid by a part of its
# penetration, as does a body that was pushed out of the box: both act from the edge of the grid.
_REACH = {"unreached": "nearest", "outside": "clamp"}


class View:
    """A state; quantities that several channels need are computed once."""

    def __init__(self, state: State):
        if state.contacts is None:
            raise ValueError("state.contacts: expected contacts, got None; `dc.simulate(state, steps=0)` finds them")
        self.state = state = native(state)
        self.bodies = state.bodies
        self.contacts = state.contacts

    @cached_property
    def problem(self) -> StepProblem:
        return step_problem(self.state)

    @cached_property
    def rows(self) -> np.ndarray:
        """(m, 3): right-hand sides of the normal row (v_n − target) and the friction row, m/s; normal mass, kg."""
        rows, free, _ = self.problem
        return np.column_stack([row_velocities(rows, free), rows.data[:, NORMAL_MASS]])

    @cached_property
    def scale(self) -> float:
        c, (rhs, mass) = self.contacts, np.split(self.rows, [2], axis=1)
        carried = np.stack([c.normal_start, c.tangent_start], axis=1) / mass
        s = math.sqrt(np.mean(rhs * rhs) + np.mean(carried * carried)) if rhs.size else 0.0
        # Division by a subnormal scale would overflow.
        return s if s > 1e-150 else 1.0


class Channel(NamedTuple):
    """One line of `CHANNELS`.

    | field   | meaning                                                                                |
    |---------|----------------------------------------------------------------------------------------|
    | of      | "bodies" or "contacts": what is splatted                                               |
    | value   | function of a view of the state -> (k,) values                                         |
    | degree  | 1 if it scales with the velocities, else 0                                             |
    | kind    | how it turns: "scalar", "pseudo" (flips in a mirror), "x", "y" (parts of a vector),    |
    |         | "xx", "xy" (parts of a symmetric tensor without trace)                                 |
    | partner | the other part of the vector, or None                                                  |
    """

    of: str
    value: Callable
    degree: int
    kind: str
    partner: str | None = None


CHANNELS: dict[str, Channel] = {
    "mass": Channel("bodies", lambda v: v.bodies.mass, 0, "scalar"),
    "velocity_x": Channel("bodies", lambda v: v.bodies.velocity[:, V_X], 1, "x", "velocity_y"),
    "velocity_y": Channel("bodies", lambda v: v.bodies.velocity[:, V_Y], 1, "y", "velocity_x"),
    "spin": Channel("bodies", lambda v: v.bodies.spin, 1, "pseudo"),
    "normal_x": Channel("contacts", lambda v: v.contacts.normal[:, 0], 0, "x", "normal_y"),
    "normal_y": Channel("contacts", lambda v: v.contacts.normal[:, 1], 0, "y", "normal_x"),
    "normal_xx": Channel("contacts", lambda v: v.contacts.normal[:, 0] ** 2 - v.contacts.normal[:, 1] ** 2, 0, "xx"),
    "normal_xy": Channel("contacts", lambda v: 2 * v.contacts.normal[:, 0] * v.contacts.normal[:, 1], 0, "xy"),
    "contact_density": Channel("contacts", lambda v: np.ones(v.contacts.count), 0, "scalar"),
    "approach": Channel("contacts", lambda v: v.rows[:, 0], 1, "scalar"),
    "slip": Channel("contacts", lambda v: v.rows[:, 1], 1, "pseudo"),
    "effective_mass": Channel("contacts", lambda v: v.rows[:, 2], 0, "scalar"),
    "builtin_normal": Channel("contacts", lambda v: v.contacts.normal_start, 1, "scalar"),
    "builtin_tangent": Channel("contacts", lambda v: v.contacts.tangent_start, 1, "pseudo"),
}
"""Name of an input channel -> what it is. See the module's table."""

TARGETS: dict[str, Channel] = {
    "normal_impulse": Channel("contacts", lambda v: v.contacts.normal_impulse, 1, "scalar"),
    "tangent_impulse": Channel("contacts", lambda v: v.contacts.tangent_impulse, 1, "pseudo"),
}
"""Name of an output channel -> what it is."""

THESIS_CHANNELS = ("mass", "velocity_x", "velocity_y", "spin", "normal_x")
"""The five inputs of the thesis's network, in its order."""

SOLVER_CHANNELS = tuple(
    "contact_density normal_xx normal_xy approach slip effective_mass builtin_normal builtin_tangent".split()
)
"""Contacts before the first sweep, independent of the arbitrary sign of n."""

CHANNEL_SETS = {
    "thesis": THESIS_CHANNELS,
    "solver": SOLVER_CHANNELS,
    "bodies and solver": ("mass", "velocity_x", "velocity_y", "spin", *SOLVER_CHANNELS),
}
"""Name -> input channels of a network in training."""

TRANSFERS = ("thesis", "consistent")
NORMALIZATIONS = ("particle", "raw")


@dataclass(frozen=True, kw_only=True)
class ImageSpec:
    """The definition of an image. The defaults are the thesis's.

    spacing: d of the grid, m. support: radius h of the kernel, m. kernel: one of `sph.KERNELS`.
    normalization: of the inputs: "particle" (the weights of a particle sum to one, Appendix A) or "raw" (Eq 3.6).
    transfer: of the impulses: "thesis" (particle-normalised splat, bilinear gather) or "consistent" (the same image,
    but the gather divides by the gathered density: see `sph.grid`).
    channels: names of `CHANNELS`. targets: names of `TARGETS`.
    scales, target_scales: each channel of the image is divided by its scale; `read_back` multiplies by target_scales.
    scale_free: divide velocities and impulses by the state's scale (`state_scale`); `read_back` multiplies by it.
    Raises ValueError naming the field and the value.
    """

    spacing: float = 0.5
    support: float = 0.5
    kernel: str = "poly6"
    normalization: str = "particle"
    transfer: str = "thesis"
    channels: tuple[str, ...] = THESIS_CHANNELS
    targets: tuple[str, ...] = ("normal_impulse", "tangent_impulse")
    scales: tuple[float, ...] | None = None
    target_scales: tuple[float, ...] | None = None
    scale_free: bool = False

    def __post_init__(self):
        for name, known in (("kernel", KERNELS), ("normalization", NORMALIZATIONS), ("transfer", TRANSFERS)):
            one_of(name, getattr(self, name), known)
        checked = {name: number(name, getattr(self, name), above=0) for name in ("spacing", "support")}
        checked["scale_free"] = flag("scale_free", self.scale_free)
        for name, table in (("channels", CHANNELS), ("targets", TARGETS)):
            checked[name] = _names(name, getattr(self, name), table)
        for name, count in (("scales", len(checked["channels"])), ("target_scales", len(checked["targets"]))):
            given = getattr(self, name)
            given = (1.0,) * count if given is None else given
            if isinstance(given, str) or not np.iterable(given) or len(given) != count:
                raise ValueError(f"{name}: expected {count} numbers, one for each channel, got {given!r}")
            checked[name] = tuple(number(f"{name}[{i}]", scale, above=0) for i, scale in enumerate(given))
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def grid(self, world: World) -> Grid:
        """The grid over a world's box."""
        return _grid(world.box, self.spacing)

    def shape(self, world: World) -> tuple[int, int]:
        """(n_y, n_x) of the images of this world's states."""
        return self.grid(world).shape

    def replace(self, **changes) -> ImageSpec:
        """A copy with some fields changed."""
        return replace(self, **changes)

    def to_dict(self) -> dict:
        """All fields as JSON knows them; `from_dict` gives the same spec to the last bit."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, values: dict) -> ImageSpec:
        """The spec of `to_dict`. Raises ValueError on missing, unknown or bad fields."""
        return cls(**check_fields("image spec", values, {field.name for field in fields(cls)}))


def check_fields(what: str, values, names: set[str]) -> dict:
    """`values`, which has to be a dict with these names. Raises ValueError otherwise."""
    if not isinstance(values, dict) or set(values) != names:
        got = sorted(values) if isinstance(values, dict) else values
        raise ValueError(f"{what}: expected the fields {', '.join(sorted(names))}, got {got!r}")
    return values


def _names(name: str, given, table) -> tuple[str, ...]:
    names = (given,) if isinstance(given, str) or not np.iterable(given) else tuple(given)
    for i, item in enumerate(names):
        one_of(f"{name}[{i}]", item, table)
    if not names or len(set(names)) != len(names):
        raise ValueError(f"{name}: expected one or more different names, got {given!r}")
    return names


@lru_cache(maxsize=64)
def _grid(box, spacing) -> Grid:
    return Grid.over_box(box, spacing)


# ---- images ----


def state_scale(state: State) -> float:
    """The velocity s by which a scale-free image is divided, m/s. It is known before the solver starts.

    s² is the mean over all rows of the squared right-hand sides (approach and slip velocity after Δt of gravity), plus
    the mean of the squared impulses carried over from the last step, each divided by the effective mass of its normal
    row. s = 1 without contacts, and where nothing moves. Scaling all velocities, gravity and the carried impulses by
    c > 0 scales s and the solution λ by c (except for the threshold of restitution).

    With the right-hand sides alone, a resting pile would have labels a hundred times larger than an impact: over 30
    simulations of the data set, the logarithm of ‖λ‖ / s has a standard deviation of 1.25 without the carried impulses
    and of 0.62 with them.
    """
    return View(state).scale


def input_image(state: State, spec: ImageSpec) -> np.ndarray:
    """The network's input, float32, (n_y, n_x, channels).

    Raises ValueError where the state has no contacts yet, or holds what is not finite.
    """
    return _image(View(state), spec, spec.channels, CHANNELS, spec.scales, spec.normalization)


def label_image(state: State, spec: ImageSpec) -> np.ndarray:
    """The image of the impulses that a solved state holds, float32, (n_y, n_x, targets), in the network's units.

    Raises ValueError where the state has not been solved.
    """
    return _label(View(state), spec)


def image_pair(state: State, spec: ImageSpec) -> tuple[np.ndarray, np.ndarray, float]:
    """`input_image`, `label_image` and the scale s that both were divided by (1 if the spec is not scale-free)."""
    view = View(state)
    image = _image(view, spec, spec.channels, CHANNELS, spec.scales, spec.normalization)
    return image, _label(view, spec), view.scale if spec.scale_free else 1.0


def read_back(image, state: State, spec: ImageSpec) -> tuple[np.ndarray, ...]:
    """Impulses at the contacts from a network's image: one array (m,) a target, N·s; by default (normal, tangent).

    image: (n_y, n_x, targets), in the network's units. Nothing is projected on the friction cone here.
    Raises ValueError where the image does not fit the spec, or is not finite around a contact.
    """
    view = View(state)
    given = np.asarray(image, dtype=np.float64)
    expected = (*spec.shape(state.world), len(spec.targets))
    if given.shape != expected:
        raise ValueError(f"image: expected shape {expected}, got {given.shape}")
    options = {"normalization": "particle", **_REACH}
    if spec.transfer == "consistent":
        options |= {"normalization": "consistent", "h": spec.support, "kernel": spec.kernel}
    values = gather(spec.grid(state.world), given, view.contacts.position, **options)
    values *= np.asarray(spec.target_scales) * (view.scale if spec.scale_free else 1.0)
    return tuple(np.ascontiguousarray(column) for column in values.T)


def _label(view: View, spec: ImageSpec) -> np.ndarray:
    if not view.state.solved:
        raise ValueError("state.solved: expected a state that holds its solution, got False")
    # "consistent" differs in the gather alone: its image is that of "particle".
    return _image(view, spec, spec.targets, TARGETS, spec.target_scales, "particle")


def _image(view: View, spec: ImageSpec, names, table, scales, normalization) -> np.ndarray:
    grid = spec.grid(view.state.world)
    image = np.empty((*grid.shape, len(names)), np.float32)
    for of, particles in (("bodies", view.bodies), ("contacts", view.contacts)):
        chosen = [i for i, name in enumerate(names) if table[name].of == of]
        if not chosen:
            continue
        values = np.empty((particles.position.shape[0], len(chosen)))
        for column, i in enumerate(chosen):
            channel = table[names[i]]
            scale = view.scale if spec.scale_free and channel.degree else 1.0
            values[:, column] = channel.value(view) / (scales[i] * scale)
        options = {"h": spec.support, "kernel": spec.kernel, "normalization": normalization, **_REACH}
        layers = splat(grid, particles.position, values, **options)
        if len(chosen) == len(names):
            return layers.astype(np.float32)
        image[:, :, chosen] = layers
    return image


# ---- symmetries: k = 0 … 7; k ≥ 4 mirrors x first, then k mod 4 quarter turns counter-clockwise ----

SYMMETRIES = tuple(range(8))


def symmetries(spec: ImageSpec, world: World) -> tuple[int, ...]:
    """The symmetries, of all eight, that `augment` can apply to this spec's images exactly.

    A quarter turn needs a square box and both parts of every vector among the channels: with the thesis's normal_x
    alone, two mirrors and the half turn are left. Where the spacing does not divide the box, the nodes do not lie
    symmetrically, and only 0 is left.
    """
    x_min, y_min, x_max, y_max = world.box
    cells = np.array([x_max - x_min, y_max - y_min]) / spec.spacing
    if (np.abs(cells - np.round(cells)) > ROUNDING).any():
        return (0,)
    partners = [CHANNELS[name].partner for name in spec.channels]
    square = abs(cells[0] - cells[1]) <= ROUNDING
    turns = square and all(partner is None or partner in spec.channels for partner in partners)
    return tuple(k for k in SYMMETRIES if turns or k % 2 == 0)


def augment(inputs, labels, spec: ImageSpec, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Input and label image, (…, n_y, n_x, channels), turned by symmetry k, one of `symmetries(spec, world)`.

    They equal the images of `transform_state(state, k)` up to rounding. Raises ValueError where the channels or the
    shape exclude k.
    """
    turned = _turn(inputs, spec.channels, CHANNELS, spec.scales, k)
    return turned, _turn(labels, spec.targets, TARGETS, spec.target_scales, k)


def transform_state(state: State, k: int) -> State:
    """The state turned and mirrored with its box, segments and gravity, by symmetry k (0 … 7).

    k ≥ 4 mirrors x, then k mod 4 quarter turns counter-clockwise follow. The box keeps its lower left corner.
    """
    mirrored, turns = _symmetry(k)
    x_min, y_min, x_max, y_max = state.world.box
    width, height = x_max - x_min, y_max - y_min
    m = _matrix(k)

    def moved(points):
        # As distances from the walls: x_max - x is exact near the wall.
        x, y = points[:, 0] - x_min, points[:, 1] - y_min
        x = width - x if mirrored else x
        for turn in range(turns):
            x, y = (height, width)[turn % 2] - y, x
        return np.stack([x + x_min, y + y_min], axis=1)

    sign = -1.0 if mirrored else 1.0
    box = (x_min, y_min, x_min + height, y_min + width) if turns % 2 else state.world.box
    bodies = state.bodies._replace(
        position=moved(state.bodies.position),
        velocity=state.bodies.velocity @ m.T,
        angle=sign * state.bodies.angle + turns * (math.pi / 2),
        spin=sign * state.bodies.spin,
    )
    gravity = tuple(m @ np.array(state.world.gravity))
    segments = moved(np.reshape(state.world.segments, (-1, 2))).reshape(-1, 4)
    world = replace(state.world, box=box, gravity=gravity, segments=segments)
    if state.contacts is None:
        return state.replace(world=world, bodies=bodies)
    contacts, n = state.contacts, state.bodies.count
    # Walls are numbered counter-clockwise from the bottom; the mirror swaps right and left.
    wall = ((-1 if mirrored else 1) * (contacts.body_b - n) + turns) % 4
    found = contacts._replace(
        body_b=np.where((contacts.body_b < n) | (contacts.body_b >= n + 4), contacts.body_b, n + wall),
        position=moved(contacts.position),
        normal=contacts.normal @ m.T,
        tangent_impulse=sign * contacts.tangent_impulse,
        tangent_start=sign * contacts.tangent_start,
    )
    return state.replace(world=world, bodies=bodies, contacts=check_contacts(found, bodies, len(segments)))


def _symmetry(k) -> tuple[bool, int]:
    k = integer("k", k, 0, 7)
    return k >= 4, k % 4


def _matrix(k: int) -> np.ndarray:
    mirrored, turns = _symmetry(k)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    return np.linalg.matrix_power(turn, turns) @ np.diag([-1.0 if mirrored else 1.0, 1.0])


def _signed(names, table, scales, k: int) -> tuple[list[int], np.ndarray]:
    """The old channel from which each new channel comes, and the factor between them."""
    mirrored, turns = _symmetry(k)
    m = _matrix(k)
    source, factor = [], []
    for i, name in enumerate(names):
        channel = table[name]
        j, sign = i, 1.0
        if channel.kind in ("x", "y"):
            row = "xy".index(channel.kind)
            sign = m[row, row]
            if turns % 2:
                if channel.partner not in names:
                    raise ValueError(f"k: expected no quarter turn, since {name} is there without {channel.partner}")
                j, sign = names.index(channel.partner), m[row, 1 - row]
        elif channel.kind in ("xx", "xy"):
            sign = (-1.0 if turns % 2 else 1.0) * (-1.0 if mirrored and channel.kind == "xy" else 1.0)
        elif channel.kind == "pseudo" and mirrored:
            sign = -1.0
        source.append(j)
        factor.append(sign * scales[j] / scales[i])
    return source, np.array(factor, dtype=np.float32)


def _turn(image, names, table, scales, k: int) -> np.ndarray:
    source, factor = _signed(names, table, scales, k)
    mirrored, turns = _symmetry(k)
    image = np.asarray(image)
    if turns % 2 and image.shape[-3] != image.shape[-2]:
        raise ValueError(f"k: expected no quarter turn of images that are not square, {image.shape[-3:-1]}, got {k}")
    if mirrored:
        image = image[..., :, ::-1, :]
    # Rows count upwards here and downwards in rot90, whose turns are therefore the other way round.
    image = np.rot90(image, -turns, axes=(-3, -2))
    return np.ascontiguousarray(image[..., source] * factor)
