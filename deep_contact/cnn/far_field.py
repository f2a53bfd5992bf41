"""The far-field network: it predicts a coarse image of stress, by which the solver's initial impulses are corrected.

The impulses that are corrected are those of the step before, which is called Builtin's start. Projected Gauss-Seidel
removes differences of the error between neighbouring contacts in a few sweeps. It removes errors that vary over long
distances, the far field, in many sweeps. The far field is smooth, so a coarse image can represent it. The network
predicts coefficients c_j (`COEFFICIENTS`) at the nodes of a coarse grid. At a contact, the coefficients are read
bilinearly, and multiplied by features F_j of the contact. The features are made of quantities that the solver knows:
normal, effective mass, residual and last impulses. The corrected impulses of the contact are

    λ = λ_Builtin + Σ_j c_j F_j

The first four coefficients are a stress tensor S, antisymmetric part included: λ_n = n·S·n, λ_t = t·S·n. The other
coefficients are factors of Builtin's impulses and of the residuals of the rows.

The inputs describe the contact problem. A contact has two rows, a normal and a tangential one. For each row there are
inputs of three quantities: its velocity without impulses, Builtin's impulse, and its residual. The residual is the
change of the row's velocity that one relaxation would make after Builtin's impulses. These quantities are multiplied by
tensors of the normals, which do not depend on the arbitrary sign of a normal. Further inputs are the velocities of the
circles. The contact problem is positively homogeneous, so all inputs are divided by a scale of the state, mainly its
root mean square residual. Unbounded quantities are compressed by arsinh. If a state is rotated by quarter turns or
mirrored, its inputs are rotated or mirrored exactly.

An image covers a window, which is the extent of the contacts and a margin of one node. So the network can be used in
any box. Lengths are in mean radii: a node spacing of 1 is 1 m in the thesis's scene. The network is trained through the
solver (`through_solver`).
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from deep_contact.cnn.images import Spec, with_contacts
from deep_contact.compiled import njit
from deep_contact.compiled.simd import WIDTH, load, spread, store
from deep_contact.sph import Grid
from deep_contact.sph.grid import ROUNDING, bilinear_weights
from deep_contact.state.state import State
from deep_contact.stepping.problem import StepProblem, step_problem
from deep_contact.stepping.rows import (
    BODY_B,
    N_X,
    N_Y,
    NORMAL,
    NORMAL_MASS,
    TANGENT,
    TANGENT_MASS,
    V_S,
    V_X,
    V_Y,
    apply_impulses,
    friction_of,
    relative_velocity,
)

CONTACT_CHANNELS = (
    "density",
    "normal_xx",
    "normal_xy",
    *(
        f"{row}_{part}"
        for row in ("approach", "slip", "normal_residual", "tangent_residual", "builtin_normal", "builtin_tangent")
        for part in ("1", "xx", "xy")
    ),
    "wall",
)
"""Names of the channels that are splatted at the contacts. The suffix of a quantity's name tells what is splatted.

"1" is the quantity itself. "xx" is the quantity times n_x² − n_y², and "xy" is the quantity times 2 n_x n_y. For slip
and for tangent quantities, the factors are the components of the symmetric part of t ⊗ n instead.
"""

BODY_CHANNELS = (
    "bodies",
    *(f"{name}_{when}" for when in ("free", "builtin") for name in ("velocity_x", "velocity_y", "spin")),
)
"""Names of the channels that are splatted at the circles' centres.

They are a density and two sets of velocities, both after Δt of gravity: without impulses ("free") and with Builtin's
impulses ("builtin").
"""

COEFFICIENTS = tuple(
    "stress_trace stress_xx stress_xy stress_turn builtin_normal_1 builtin_normal_xx builtin_normal_xy builtin_tangent "
    "normal_residual_1 normal_residual_xx normal_residual_xy tangent_residual".split()
)
"""Names of the coefficients c_j that the network predicts at a node. "turn" is the antisymmetric part of the stress."""

COARSENING = 2
"""Spacing of the output's nodes over the spacing of the input's nodes."""

_SMALL = 1e-2
"""Factor of the root mean square of Builtin's impulses in the scale by which a state's inputs are divided.

The other term of the scale is the residual, which is tiny in a pile at rest. A division by it alone would magnify
rounding errors.
"""

_ROOM = -(-len(CONTACT_CHANNELS + BODY_CHANNELS) // WIDTH) * WIDTH
"""Number of channels that are allocated for an image, a multiple of `WIDTH`. Channels without a name stay zero."""

WINDOW_SIDES = (9, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025)
"""Numbers of nodes that an edge of a window may have. Each is one more than a multiple of 8.

The list is short, because the network is compiled once for each shape of a window.
"""


@dataclass(frozen=True, kw_only=True)
class FarFieldSpec(Spec):
    """The definition of a far-field network's images.

    spacing: distance of neighbouring nodes of the input, in mean radii. support: support radius h of the splat, in mean
    radii.
    """

    spacing: float = 1.0
    support: float = 1.0

    channels, targets = CONTACT_CHANNELS + BODY_CHANNELS, COEFFICIENTS
    multiple = 8
    constants: ClassVar = {"kind": "far field", "coarsening": COARSENING}
    removed: ClassVar = {"inputs": "all", "correction": True}

    def window(self, low: np.ndarray, high: np.ndarray, radius: float) -> Grid:
        """Return the grid of the input image that covers all contacts of a state.

        low, high: smallest and largest coordinates of the contact points, (x, y), m. radius: mean radius of the
        circles, m. If the contacts extend beyond the largest window, the grid's spacing is increased until they fit.
        """
        extent = float(max(high[0] - low[0], high[1] - low[1]))
        spacing = max(self.spacing * radius, extent / (WINDOW_SIDES[-1] - 3))
        shape = tuple(window_side((high[k] - low[k]) / spacing) for k in (1, 0))
        return Grid(origin=(low[0] - spacing, low[1] - spacing), spacing=spacing, shape=shape)


def window_side(cells: float) -> int:
    """Return the number of nodes along an edge of a window, one of `WINDOW_SIDES`.

    cells: extent of the contacts along the edge over the spacing. A margin of one cell is added on each side.
    """
    return WINDOW_SIDES[min(bisect_left(WINDOW_SIDES, cells + 3.0 - ROUNDING), len(WINDOW_SIDES) - 1)]


class Description(NamedTuple):
    """A state as the far-field network takes it. For training it may be rotated and mirrored (`description_of`)."""

    image: np.ndarray  # the network's input, rotated and mirrored, float32, (n_y, n_x, c)
    grid: Grid  # the grid of the input image
    point: np.ndarray  # contact points, rotated and mirrored, (m, 2), m
    features: np.ndarray  # F: λ_n and λ_t per unit of each coefficient, in the original frame, (m, 12, 2), N·s
    start: np.ndarray  # the impulses to correct, Builtin's, in the original frame, (m, 2), N·s


def description_of(
    state: State, spec: FarFieldSpec, symmetry: int = 0, problem: StepProblem | None = None
) -> Description:
    """Return the network's description of a state with contacts.

    symmetry: number of the symmetry of the square that is applied to the state, 0 to 7, for training. If it is 4 or
    more, x is mirrored first. Then the state is rotated by `symmetry` mod 4 quarter turns. problem: the contact problem
    in float64 with tangent rows, if it has been built; its rows hold the impulses to correct.
    Raises ValueError if there is no contact, contacts have not been searched, or the state is not valid.
    """
    state = with_contacts(state) if problem is None else state
    if state.contacts.count == 0:
        raise ValueError("state.contacts: expected at least one contact, got 0")
    rows, free, friction, _ = step_problem(state) if problem is None else problem
    box = state.world.box
    measured = _measure(state.bodies, state.contacts, rows, free, box, friction, symmetry >= 4, symmetry % 4)
    # NumPy's arsinh is faster than that of compiled code in `_measure`, because it is vectorised.
    np.arcsinh(measured.contact_sizes, out=measured.contact_sizes)
    np.arcsinh(measured.body_sizes, out=measured.body_sizes)
    grid = spec.window(measured.low, measured.high, measured.mean_radius)
    image = np.zeros((*grid.shape, _ROOM), np.float32)
    _paint(image, (*grid.origin, grid.spacing[0]), spec.support * grid.spacing[0] / spec.spacing, measured)
    return Description(image[:, :, : len(spec.channels)], grid, measured.point, measured.features, rows.impulse.copy())


def correct(image: np.ndarray, description: Description) -> np.ndarray:
    """Return the corrected impulses λ = λ_Builtin + Σ_j c_j F_j, (m, 2), N·s, not projected on the friction cone.

    image: the network's output, from which the coefficients c are read bilinearly, (rows, columns, 12).
    """
    node, weight = nodes_of(description, image.shape[:2])
    return _correct(image.reshape(-1, image.shape[2]), node, weight, description.features, description.start)


@njit(cache=True)
def _correct(image, node, weight, features, start):
    impulses = start.copy()
    for i in range(node.shape[0]):
        for j in range(features.shape[1]):
            coefficient = 0.0
            for k in range(4):
                coefficient += weight[i, k] * image[node[i, k], j]
            impulses[i, 0] += coefficient * features[i, j, 0]
            impulses[i, 1] += coefficient * features[i, j, 1]
    return impulses


def corrected(description: Description, coefficients: np.ndarray) -> np.ndarray:
    """Return the corrected impulses λ = λ_Builtin + Σ_j c_j F_j, (m, 2), N·s, not projected on the friction cone.

    coefficients: c at the contacts, (m, 12). Training reads them from the network's output in TensorFlow.
    """
    return description.start + np.einsum("ij,ijk->ik", coefficients, description.features)


def nodes_of(description: Description, shape: tuple[int, int]):
    """Return the indices of the four nodes of the output around each contact, (m, 4), and their weights, (m, 4).

    The indices are those of the output image flattened to (rows · columns, 12). The weights are the bilinear ones of
    `sph.gather`. For a contact outside the grid, the nearest point of the grid is taken. shape: (rows, columns) of the
    output.
    """
    grid = description.grid
    return _nodes(description.point, (*grid.origin, COARSENING * grid.spacing[0]), shape)


@njit(cache=True, error_model="numpy")
def _nodes(point, geometry, shape):
    """Return the nodes and weights of `nodes_of`.

    point: contact points, (m, 2), m. geometry: x and y of the output grid's first node, and the grid's spacing, m.
    """
    (x0, y0, d), (n_y, n_x), m = geometry, shape, point.shape[0]
    node, weight = np.empty((m, 4), np.int32), np.empty((m, 4), np.float32)
    for k in range(m):
        i, _, j, _, _ = bilinear_weights((x0, y0, d, d), n_y, n_x, point[k, 0], point[k, 1], weight[k])
        first = j * n_x + i
        node[k, 0], node[k, 1], node[k, 2], node[k, 3] = first, first + 1, first + n_x, first + n_x + 1
    return node, weight


class _Measured(NamedTuple):
    """The quantities of which `description_of` makes an image, rotated and mirrored, before the compression by arsinh.

    "Scaled" velocities are divided by the state's scale, m/s, and "scaled" impulses by the scale times the effective
    mass of their normal row.
    """

    point: np.ndarray  # contact points, (m, 2), m
    normal: np.ndarray  # unit normals, (m, 2)
    contact_sizes: np.ndarray  # normal and tangent velocity without impulses, and λ_n, λ_t, all scaled, (m, 4)
    residual: np.ndarray  # scaled change of velocity by one relaxation of the normal and of the tangent row, (m, 2)
    wall: np.ndarray  # 1 for a contact with a wall or a segment, else 0, (m,)
    centre: np.ndarray  # centres of the circles, (n, 2), m
    body_sizes: np.ndarray  # scaled velocity and spin without impulses, then with Builtin's impulses, (n, 6)
    features: np.ndarray  # `Description.features`, (m, 12, 2), N·s
    low: tuple[float, float]  # smallest x and y of the contact points, m
    high: tuple[float, float]  # largest x and y of the contact points, m
    mean_radius: float  # mean radius of the circles, m


@njit(cache=True, error_model="numpy")
def _measure(bodies, contacts, rows, free, box, friction, mirrored, turns):
    """Return the `_Measured` of a state with contacts.

    rows: the rows of the contacts, with Builtin's impulses. free: the circles' velocities after Δt of gravity without
    impulses, as `step_problem` returns them. box: (x_min, y_min, x_max, y_max), m. friction: as in `StepInput`.
    mirrored: whether x is mirrored. turns: number of quarter turns after the mirroring.
    """
    n, m = bodies.mass.shape[0], contacts.body_a.shape[0]
    after = free.copy()
    apply_impulses(rows, after, friction)

    # The residual of a row: the change of its velocity by one relaxation, m/s. It is 0 if the row is satisfied.
    residual = np.empty((m, 2))
    unsolved, carried = 0.0, 0.0
    for i in range(m):
        k_n, k_t = rows.data[i, NORMAL_MASS], rows.data[i, TANGENT_MASS]
        p_n, p_t = rows.impulse[i, NORMAL], rows.impulse[i, TANGENT]
        v_n, v_t = relative_velocity(rows, after, i)
        largest = friction_of(friction, rows.data, i) * p_n
        residual[i, 0] = max(-v_n, -p_n / k_n)
        residual[i, 1] = (max(-largest, min(p_t - k_t * v_t, largest)) - p_t) / k_t
        unsolved += residual[i, 0] ** 2 + residual[i, 1] ** 2
        carried += (p_n / k_n) ** 2
    unsolved, carried = math.sqrt(unsolved / max(m, 1)), math.sqrt(carried / max(m, 1))
    scale = math.sqrt(unsolved**2 + (_SMALL * carried) ** 2)
    if not scale > 1e-150:
        scale = 1.0
    share = unsolved / (unsolved + carried) if unsolved > 0.0 else 0.0

    c, s = 1.0, 0.0
    for _ in range(turns):
        c, s = -s, c
    sign = -1.0 if mirrored else 1.0
    x_m, y_m = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
    point, normal, sizes, wall = np.empty((m, 2)), np.empty((m, 2)), np.empty((m, 4)), np.empty(m)
    features = np.zeros((m, 12, 2))
    x_low, x_high, y_low, y_high = np.inf, -np.inf, np.inf, -np.inf
    for i in range(m):
        n_x, n_y = _turned(c, s, sign * rows.data[i, N_X], rows.data[i, N_Y])
        x, y = _turned(c, s, sign * (contacts.position[i, 0] - x_m), contacts.position[i, 1] - y_m)
        x, y = x_m + x, y_m + y
        x_low, x_high, y_low, y_high = min(x_low, x), max(x_high, x), min(y_low, y), max(y_high, y)
        point[i, 0], point[i, 1] = x, y
        normal[i, 0], normal[i, 1] = n_x, n_y
        k_n, k_t = rows.data[i, NORMAL_MASS], rows.data[i, TANGENT_MASS]
        v_n, v_t = relative_velocity(rows, free, i)
        p_n, p_t = rows.impulse[i, NORMAL], sign * rows.impulse[i, TANGENT]
        unit = k_n * scale
        sizes[i, 0], sizes[i, 1] = v_n / scale, sign * v_t / scale
        sizes[i, 2], sizes[i, 3] = p_n / unit, p_t / unit
        r_n, r_t = residual[i, 0] / scale, sign * residual[i, 1] / scale
        residual[i, 0], residual[i, 1] = r_n, r_t
        wall[i] = 1.0 if rows.body[i, BODY_B] >= n else 0.0
        xx, xy = n_x * n_x - n_y * n_y, 2.0 * n_x * n_y
        F = features[i]
        F[0, 0] = unit
        F[1, 0], F[1, 1] = unit * xx, unit * xy
        F[2, 0], F[2, 1] = unit * xy, -unit * xx
        F[3, 1] = unit
        F[4, 0], F[5, 0], F[6, 0] = share * p_n, share * p_n * xx, share * p_n * xy
        F[7, 1] = share * p_t
        F[8, 0], F[9, 0], F[10, 0] = unit * r_n, unit * r_n * xx, unit * r_n * xy
        F[11, 1] = k_t * scale * r_t
        # λ_t has the opposite sign in the mirrored state, and F belongs to the original frame.
        F[:, 1] *= sign

    centre, moving = np.empty((n, 2)), np.empty((n, 6))
    radius = 0.0
    for i in range(n):
        radius += bodies.radius[i] / n
        x, y = _turned(c, s, sign * (bodies.position[i, 0] - x_m), bodies.position[i, 1] - y_m)
        centre[i, 0], centre[i, 1] = x_m + x, y_m + y
        for j, velocity in enumerate((free, after)):
            v_x, v_y = _turned(c, s, sign * velocity[i, V_X], velocity[i, V_Y])
            moving[i, 3 * j], moving[i, 1 + 3 * j] = v_x / scale, v_y / scale
            moving[i, 2 + 3 * j] = sign * velocity[i, V_S] / scale
    low, high = (x_low, y_low), (x_high, y_high)
    return _Measured(point, normal, sizes, residual, wall, centre, moving, features, low, high, radius)


@njit(cache=True, error_model="numpy")
def _turned(c, s, x, y):
    """Return the vector (x, y) rotated by the angle whose cosine is c and whose sine is s."""
    return c * x - s * y, s * x + c * y


@njit(cache=True, error_model="numpy")
def _paint(image, geometry, h, measured):
    """Add the splats of all `CONTACT_CHANNELS` and `BODY_CHANNELS` to an image, in place.

    The splat is that of `sph.splat` with poly6 and the normalization "particle". A particle with no node within h acts
    on the nearest node. A circle outside the image has no contact and is left out. image: (n_y, n_x, `_ROOM`), float32.
    geometry: x and y of the image's first node, and the spacing of its nodes, m. h: support radius, m. measured: a
    `_Measured` whose sizes have been compressed by arsinh.
    """
    n_y, n_x, _ = image.shape
    first = len(CONTACT_CHANNELS)
    values = np.zeros(_ROOM, np.float32)
    sizes, residual = measured.contact_sizes, measured.residual
    for k in range(measured.point.shape[0]):
        x, y = measured.normal[k, 0], measured.normal[k, 1]
        xx, xy = x * x - y * y, 2.0 * x * y
        values[0], values[1], values[2] = 1.0, xx, xy
        rows = (sizes[k, 0], sizes[k, 1]), (residual[k, 0], residual[k, 1]), (sizes[k, 2], sizes[k, 3])
        for j, (along, across) in enumerate(rows):
            values[3 + 6 * j], values[4 + 6 * j], values[5 + 6 * j] = along, along * xx, along * xy
            # The factors are the symmetric part of t ⊗ n with t = (n_y, −n_x): xx = 2 n_x n_y, xy = n_y² − n_x².
            values[6 + 6 * j], values[7 + 6 * j], values[8 + 6 * j] = across, across * xy, -across * xx
        values[first - 1] = measured.wall[k]
        _add(image, geometry, h, measured.point[k], values, 0, (first - 1) // WIDTH + 1)
    values[:] = 0.0
    x_last, y_last = geometry[0] + geometry[2] * (n_x - 1), geometry[1] + geometry[2] * (n_y - 1)
    values[first] = 1.0
    for k in range(measured.centre.shape[0]):
        x, y = measured.centre[k, 0], measured.centre[k, 1]
        if geometry[0] <= x <= x_last and geometry[1] <= y <= y_last:
            for j in range(6):
                values[first + 1 + j] = measured.body_sizes[k, j]
            _add(image, geometry, h, measured.centre[k], values, first // WIDTH, _ROOM // WIDTH)


@njit(cache=True, error_model="numpy")
def _add(image, geometry, h, point, values, begin, end):
    """Add the splat of one particle's values to `image`, in place.

    `sph.splat` would take many times as long: it writes float64, knows all kernels and checks its arguments.
    geometry, h: as for `_paint`. point: position of the particle, (x, y), m. values: one number for each of the `_ROOM`
    channels. begin, end: half-open range of the vectors of `WIDTH` channels that are added.
    """
    (x0, y0, d), (n_y, n_x, _) = geometry, image.shape
    x, y = point[0] - x0, point[1] - y0
    i0, i1 = max(math.ceil((x - h) / d), 0), min(math.floor((x + h) / d) + 1, n_x)
    j0, j1 = max(math.ceil((y - h) / d), 0), min(math.floor((y + h) / d) + 1, n_y)
    total = 0.0
    for j in range(j0, j1):
        for i in range(i0, i1):
            total += _weight(x - i * d, y - j * d, h)
    if not total > 0.0:
        i0 = int(min(max(math.floor(x / d + 0.5), 0.0), n_x - 1.0))
        j0 = int(min(max(math.floor(y / d + 0.5), 0.0), n_y - 1.0))
        i1, j1 = i0 + 1, j0 + 1
    for j in range(j0, j1):
        for i in range(i0, i1):
            w = _weight(x - i * d, y - j * d, h) / total if total > 0.0 else 1.0
            if w > 0.0:
                first = (j * n_x + i) * (_ROOM // WIDTH)
                share = spread(np.float32(w))
                for c in range(begin, end):
                    store(image, first + c, load(image, first + c) + share * load(values, c))


@njit(cache=True, error_model="numpy")
def _weight(x, y, h):
    """Return (1 − (r / h)²)³ at the vector (x, y) of length r, or 0 for r >= h.

    This is poly6 without its constant factor, which the normalisation by particle cancels.
    """
    q = 1.0 - (x * x + y * y) / (h * h)
    return q * q * q if q > 0.0 else 0.0
