"""What training minimises: the thesis's loss on images, and ours on the velocities that the impulses cause.

An image loss pays for every node alike. What a start is for is the velocities: λ itself is not even unique (a
frictional packing is hyperstatic). `velocity_loss` therefore reads the image back at the contacts, as the solver will,
and measures √(δλᵀ A δλ), A = J M⁻¹ Jᵀ: the velocity error M⁻¹ Jᵀ δλ in the norm of kinetic energy, in shares of what
the solution changes. Impulses in the null space of A cost nothing.

A loss at the contacts is a function of (impulses, batch), the impulses (K, 2) as read back and the `ContactBatch` they
were read at, and has its line in `CONTACT_LOSSES`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from deep_contact import sph
from deep_contact.cnn.backend import keras
from deep_contact.cnn.images import ImageSpec, state_scale
from deep_contact.physics.contact_solver import contact_rows, integrate_velocities, make_rows
from deep_contact.physics.engine import world_arguments
from deep_contact.state import State

ops = keras.ops

IMPULSE_SHARE = 0.1
"""Weight of the impulses' own error beside the velocities': it decides where the velocities do not."""

_ROUND = 0.02
"""Relative error below which errors count by their squares."""

_FLOOR = 0.01
"""Share of the energy of approach and slip that is added to the solution's: contacts that part have a solution of 0."""


# ---- on images ----


def masked_squared_error(y_true, y_pred):
    """Loss of Appendix B (Eq 5.3): mean of (y_pred − y_true)² over the last axis, where y_true ≠ 0, else 0.

    The mask is on the label. Nodes without a label count in the mean, and the network may put there what it likes.
    """
    flags = ops.cast(ops.not_equal(y_true, 0.0), y_pred.dtype)
    return ops.mean(ops.square((y_pred - y_true) * flags), axis=-1)


def masked_absolute_error(y_true, y_pred):
    """The same with the absolute value in place of the square; a metric."""
    flags = ops.cast(ops.not_equal(y_true, 0.0), y_pred.dtype)
    return ops.mean(ops.abs((y_pred - y_true) * flags), axis=-1)


# ---- at the contacts ----


class ContactBatch(NamedTuple):
    """The K contacts and N bodies of a batch of B states, as a loss needs them; float32 and int32.

    Impulses and velocities are in shares of each state's scale if the spec is scale-free. Bodies are numbered through
    the batch; the last one stands for all walls, with neither weight nor inverse mass.

    | field          | meaning                                                                    | shape  |
    |----------------|----------------------------------------------------------------------------|--------|
    | node           | the nodes around the contact, as numbers in the batch's (B · n_y · n_x)    | (K, 4) |
    | node_weight    | what `read_back` gives each of them                                        | (K, 4) |
    | impulse        | λ*_n, λ*_t, solved                                                         | (K, 2) |
    | start          | λ_n, λ_t of Builtin                                                        | (K, 2) |
    | impulse_weight | 1 / effective mass, over the state's Σ λ*² / effective mass                | (K, 2) |
    | body           | a, b                                                                       | (K, 2) |
    | inverse_mass   | of a, of b                                                                 | (K, 2) |
    | arm            | of a, of b, over the radius                                                | (K, 2) |
    | normal         | n                                                                          | (K, 2) |
    | friction       | μ                                                                          | (K,)   |
    | state          | which of the B states the contact belongs to                               | (K,)   |
    | body_weight    | mass, over the state's energy of v* − v⁻                                   | (N,)   |
    | body_state     | which of the B states the body belongs to                                  | (N,)   |
    | share          | 1 / B for each state                                                       | (B,)   |
    | unit           | what turns the network's numbers into impulses: the targets' scales and, for |  (K, 2) |
    |                | a mirrored image, the sign of λ_t                                          |        |
    """

    node: np.ndarray
    node_weight: np.ndarray
    impulse: np.ndarray
    start: np.ndarray
    impulse_weight: np.ndarray
    body: np.ndarray
    inverse_mass: np.ndarray
    arm: np.ndarray
    normal: np.ndarray
    friction: np.ndarray
    state: np.ndarray
    body_weight: np.ndarray
    body_state: np.ndarray
    share: np.ndarray
    unit: np.ndarray


INTEGER_FIELDS = ("node", "body", "state", "body_state")
"""Fields of a `ContactBatch` that are int32."""

FIELD_WIDTHS = {name: 2 for name in ContactBatch._fields} | {"node": 4, "node_weight": 4}
FIELD_WIDTHS |= {"friction": None, "state": None, "body_weight": None, "body_state": None, "share": None}
"""Second dimension of each field of a `ContactBatch`, None where there is none."""


def read_at_contacts(images, batch: ContactBatch):
    """Impulses (K, 2) that images (B, n_y, n_x, 2) give back at the contacts: `read_back`, differentiable."""
    nodes = ops.reshape(images, (-1, images.shape[-1]))
    corners = ops.take(nodes, batch.node, axis=0)
    return ops.sum(corners * ops.expand_dims(batch.node_weight, -1), axis=1) * batch.unit


def velocity_errors(impulses, batch: ContactBatch):
    """‖v − v*‖² / ‖v* − v⁻‖² of each state, (B,), before any sweep, in kinetic energy."""
    change = impulses - batch.impulse
    normal, tangent = change[:, :1], change[:, 1:]
    n_x, n_y = batch.normal[:, :1], batch.normal[:, 1:]
    turn = 2.0 * tangent
    push = ops.concatenate([normal * n_x + tangent * n_y, normal * n_y - tangent * n_x], axis=-1)
    on_a = batch.inverse_mass[:, :1] * ops.concatenate([-push, turn * batch.arm[:, :1]], axis=-1)
    on_b = batch.inverse_mass[:, 1:] * ops.concatenate([push, turn * batch.arm[:, 1:]], axis=-1)
    both = ops.concatenate([on_a, on_b], axis=0)
    body = ops.concatenate([batch.body[:, 0], batch.body[:, 1]], axis=0)
    velocity = ops.segment_sum(both, body, num_segments=ops.shape(batch.body_weight)[0])
    # The third is s = ω r, whose inertia is half the mass.
    energy = ops.sum(ops.square(velocity) * ops.convert_to_tensor([1.0, 1.0, 0.5], velocity.dtype), axis=-1)
    return ops.segment_sum(batch.body_weight * energy, batch.body_state, num_segments=ops.shape(batch.share)[0])


def impulse_errors(impulses, batch: ContactBatch):
    """Σ (λ − λ*)² / k over Σ λ*² / k of each state, (B,), k the row's effective mass: the diagonal of A alone."""
    each = ops.sum(batch.impulse_weight * ops.square(impulses - batch.impulse), axis=-1)
    return ops.segment_sum(each, batch.state, num_segments=ops.shape(batch.share)[0])


def velocity_loss(impulses, batch: ContactBatch):
    """Mean over states of the relative velocity error, plus a share of that of the impulses.

    Errors, not their squares: of a state that is nearly solved the rest still counts.
    """
    velocity = ops.sum(batch.share * _root(velocity_errors(impulses, batch)))
    return velocity + IMPULSE_SHARE * impulse_loss(impulses, batch)


def squared_velocity_loss(impulses, batch: ContactBatch):
    """The same with the squares of both errors: the states that go most wrong decide."""
    errors = velocity_errors(impulses, batch) + IMPULSE_SHARE * impulse_errors(impulses, batch)
    return ops.sum(batch.share * errors)


def impulse_loss(impulses, batch: ContactBatch):
    """Mean over states of the relative error of the impulses."""
    return ops.sum(batch.share * _root(impulse_errors(impulses, batch)))


def _root(squares):
    """√, rounded off at the bottom, where it would pull at errors of nothing without end."""
    return ops.sqrt(squares + _ROUND**2) - _ROUND


CONTACT_LOSSES: dict[str, Callable] = {
    "velocity": velocity_loss,
    "squared velocity": squared_velocity_loss,
    "impulse": impulse_loss,
}
"""Name -> function of (impulses, batch)."""


# ---- batches, in NumPy ----


class StateContacts(NamedTuple):
    """What one state contributes to a `ContactBatch`: see there. `node` and `body` count within the state."""

    node: np.ndarray
    node_weight: np.ndarray
    impulse: np.ndarray
    start: np.ndarray
    impulse_weight: np.ndarray
    body: np.ndarray
    inverse_mass: np.ndarray
    arm: np.ndarray
    normal: np.ndarray
    friction: np.ndarray
    body_weight: np.ndarray


def state_contacts(state: State, spec: ImageSpec) -> StateContacts:
    """What a loss has to know of a solved state's contacts. Raises ValueError on a state that is not solved."""
    if state.contacts is None or not state.solved:
        raise ValueError("state.solved: expected a state that holds its solution, got False")
    contacts = state.contacts
    scale = state_scale(state) if spec.scale_free else 1.0
    values, body, body_energy, energies = _contact_values(state.bodies, contacts, world_arguments(state), state.dt)
    impulse = np.stack([contacts.normal_impulse, contacts.tangent_impulse], axis=1) / scale
    start = np.stack([contacts.normal_start, contacts.tangent_start], axis=1) / scale
    floor = _FLOOR * energies[1]
    # Energies go by the square of the scale, as do those that they are to divide.
    inverse = 1.0 / values[:, :2]
    own = scale**2 / max(energies[2] + floor, 1e-300)
    node, weight = gather_weights(state, spec)
    return StateContacts(
        node,
        weight,
        impulse,
        start,
        inverse * own,
        body,
        values[:, 2:4],
        values[:, 4:6],
        contacts.normal,
        np.full(contacts.count, state.world.friction),
        body_energy * (scale**2 / max(energies[0] + floor, 1e-300)),
    )


def gather_weights(state: State, spec: ImageSpec) -> tuple[np.ndarray, np.ndarray]:
    """`read_back` as numbers: (m, 4) nodes of the flattened image and what each contributes to the contact.

    A point outside the grid reads its edge; where the nodes around hold no density, the nearest one counts.
    """
    grid = spec.grid(state.world)
    (x_0, y_0), (d_x, d_y), (n_y, n_x) = grid.origin, grid.spacing, grid.shape
    position = state.contacts.position
    u = np.clip((position[:, 0] - x_0) / d_x, 0.0, n_x - 1.0)
    v = np.clip((position[:, 1] - y_0) / d_y, 0.0, n_y - 1.0)
    i, j = np.minimum(u.astype(np.int64), n_x - 2), np.minimum(v.astype(np.int64), n_y - 2)
    s, t = u - i, v - j
    node = (j * n_x + i)[:, None] + np.array([0, 1, n_x, n_x + 1])
    weight = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)
    if spec.transfer != "consistent" or not len(position):
        return node, weight
    options = {"unreached": "nearest", "outside": "clamp"}
    density = sph.density(grid, position, h=spec.support, kernel=spec.kernel, **options).reshape(-1)
    total = np.sum(weight * density[node], axis=1)
    lost = total <= 0.0
    if lost.any():
        nearest = (np.floor(v + 0.5) * n_x + np.floor(u + 0.5)).astype(np.int64)[lost]
        node[lost] = nearest[:, None]
        weight[lost] = [1.0, 0.0, 0.0, 0.0]
        total[lost] = density[nearest]
    return node, weight / total[:, None]


def contact_batch(parts: Sequence[StateContacts], nodes: int, spec: ImageSpec, symmetries=None) -> ContactBatch:
    """The contacts of several states, whose images have `nodes` nodes each, as one batch.

    symmetries: one a state, a pair (where each node goes, whether it is mirrored), if the images have been turned:
    the image is read where the contact went, and everything else stays as it was.
    """
    count = len(parts)
    contacts = [part.node.shape[0] for part in parts]
    bodies = [part.body_weight.shape[0] for part in parts]
    first = np.concatenate([[0], np.cumsum(bodies)])
    wall = first[-1]
    node, unit = [], []
    for k, part in enumerate(parts):
        goes, mirrored = (None, False) if symmetries is None else symmetries[k]
        node.append((part.node if goes is None else goes[part.node]) + k * nodes)
        unit.append(np.broadcast_to([1.0, -1.0 if mirrored else 1.0], (contacts[k], 2)))
    body = [np.where(part.body < n, part.body + f, wall) for part, n, f in zip(parts, bodies, first)]

    def joined(name):
        return np.concatenate([getattr(part, name) for part in parts]).astype(np.float32)

    return ContactBatch(
        node=np.concatenate(node).astype(np.int32),
        node_weight=joined("node_weight"),
        impulse=joined("impulse"),
        start=joined("start"),
        impulse_weight=joined("impulse_weight"),
        body=np.concatenate(body).astype(np.int32),
        inverse_mass=joined("inverse_mass"),
        arm=joined("arm"),
        normal=joined("normal"),
        friction=joined("friction"),
        state=np.repeat(np.arange(count, dtype=np.int32), contacts),
        body_weight=np.append(joined("body_weight"), np.float32(0.0)),
        body_state=np.append(np.repeat(np.arange(count), bodies), 0).astype(np.int32),
        share=np.full(count, 1.0 / count, np.float32),
        unit=(np.concatenate(unit) * np.asarray(spec.target_scales)).astype(np.float32),
    )


@njit(cache=True, error_model="numpy")
def _contact_values(bodies, contacts, world, dt):
    """Effective masses, inverse masses and arms (m, 6), bodies (m, 2), masses (n,), and three energies.

    The energies, in J · 2: of the solution's v* − v⁻; of the rows' approach and slip, Σ k b²; of the solution row
    by row, Σ λ² / k.
    """
    _, gravity, _, restitution = world
    n, m = bodies.mass.shape[0], contacts.body_a.shape[0]
    moving = np.empty((n + 4, 4))
    integrate_velocities(bodies, gravity, dt, moving)
    rows, _ = contact_rows(bodies, contacts, moving, restitution, make_rows(m, moving.dtype))
    values, body = np.empty((m, 6)), np.empty((m, 2), np.int64)
    change = np.zeros((n + 4, 3))
    energies = np.zeros(3)
    for i in range(m):
        a, b = rows.body[i, 0], rows.body[i, 1]
        n_x, n_y, k_n, k_t = rows.data[i, 0], rows.data[i, 1], rows.data[i, 2], rows.data[i, 3]
        arm_a, arm_b = rows.data[i, 4], rows.data[i, 5]
        w_a, w_b = moving[a, 3], moving[b, 3]
        body[i, 0], body[i, 1] = a, b
        values[i, 0], values[i, 1], values[i, 2], values[i, 3] = k_n, k_t, w_a, w_b
        values[i, 4], values[i, 5] = arm_a, arm_b
        v_x, v_y = moving[b, 0] - moving[a, 0], moving[b, 1] - moving[a, 1]
        b_n = n_x * v_x + n_y * v_y - rows.data[i, 6]
        b_t = n_y * v_x - n_x * v_y + arm_a * moving[a, 2] + arm_b * moving[b, 2]
        energies[1] += k_n * b_n * b_n + k_t * b_t * b_t
        p_n, p_t = contacts.normal_impulse[i], contacts.tangent_impulse[i]
        energies[2] += p_n * p_n / k_n + p_t * p_t / k_t
        p_x, p_y = p_n * n_x + p_t * n_y, p_n * n_y - p_t * n_x
        change[a, 0] -= w_a * p_x
        change[a, 1] -= w_a * p_y
        change[a, 2] += 2.0 * w_a * arm_a * p_t
        change[b, 0] += w_b * p_x
        change[b, 1] += w_b * p_y
        change[b, 2] += 2.0 * w_b * arm_b * p_t
    for i in range(n):
        speed = change[i, 0] ** 2 + change[i, 1] ** 2 + 0.5 * change[i, 2] ** 2
        energies[0] += bodies.mass[i] * speed
    return values, body, bodies.mass, energies
