"""The losses: the thesis's on images, and ours on the velocities that the impulses cause.

A loss on images weights all nodes alike. But a start only serves the velocities, and λ itself is not unique: a packing
with friction is hyperstatic. `velocity_loss` reads the image at the contacts, as the solver will, and measures
√(δλᵀ A δλ), A = J M⁻¹ Jᵀ: the velocity error M⁻¹ Jᵀ δλ in the norm of kinetic energy, relative to the change of
velocity by the solution. Impulses in the null space of A cost nothing.

A loss at the contacts is a function of (impulses, batch), with the impulses (K, 2) read at the contacts of the
`ContactBatch`, and is listed in `CONTACT_LOSSES`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from deep_contact import sph
from deep_contact.cnn.backend import keras
from deep_contact.cnn.images import ImageSpec, View
from deep_contact.cnn.rows import bilinear_nodes, row_velocities
from deep_contact.physics.contact_solver import (
    ARM_A,
    ARM_B,
    INVERSE_MASS,
    NORMAL_MASS,
    TANGENT_MASS,
    Rows,
    apply_impulses,
)
from deep_contact.state import State

ops = keras.ops

IMPULSE_SHARE = 0.1
"""Weight of the error of the impulses: it selects among impulses that cause the same velocities."""

_ROUND = 0.02
"""Relative error below which the loss is quadratic in the error."""

_FLOOR = 0.01
"""Share of the energy of approach and slip that is added to the solution's: separating contacts have λ* = 0."""


# ---- on images ----


def masked_squared_error(y_true, y_pred):
    """Loss of Appendix B (Eq 5.3): mean of (y_pred − y_true)² over the last axis, where y_true ≠ 0, else 0.

    The mask is on the label: nodes without a label count in the mean, with an error of 0 for any prediction.
    """
    flags = ops.cast(ops.not_equal(y_true, 0.0), y_pred.dtype)
    return ops.mean(ops.square((y_pred - y_true) * flags), axis=-1)


def masked_absolute_error(y_true, y_pred):
    """`masked_squared_error` with the absolute value in place of the square; a metric."""
    flags = ops.cast(ops.not_equal(y_true, 0.0), y_pred.dtype)
    return ops.mean(ops.abs((y_pred - y_true) * flags), axis=-1)


# ---- at the contacts ----


class ContactBatch(NamedTuple):
    """The K contacts and N bodies of a batch of B states, for the losses; float32 and int32.

    Impulses and velocities are relative to each state's scale if the spec is scale-free. Bodies are numbered through
    the batch; the last one stands for all walls, with weight and inverse mass 0.

    | field          | meaning                                                                    | shape  |
    |----------------|----------------------------------------------------------------------------|--------|
    | node           | the nodes around the contact, as numbers in the batch's (B · n_y · n_x)    | (K, 4) |
    | node_weight    | their weights in `read_back`                                               | (K, 4) |
    | impulse        | λ*_n, λ*_t, solved                                                         | (K, 2) |
    | impulse_weight | 1 / effective mass, over the state's Σ λ*² / effective mass                | (K, 2) |
    | body           | a, b                                                                       | (K, 2) |
    | inverse_mass   | of a, of b                                                                 | (K, 2) |
    | arm            | of a, of b, over the radius                                                | (K, 2) |
    | normal         | n                                                                          | (K, 2) |
    | friction       | μ                                                                          | (K,)   |
    | state          | the number of the contact's state, 0 … B − 1                               | (K,)   |
    | body_weight    | mass, over the state's energy of v* − v⁻                                   | (N,)   |
    | body_state     | the number of the body's state, 0 … B − 1                                  | (N,)   |
    | share          | 1 / B for each state                                                       | (B,)   |
    | unit           | impulse per number of the network: the scales of the targets, with the     | (K, 2) |
    |                | sign of λ_t in a mirrored image                                            |        |
    """

    node: np.ndarray
    node_weight: np.ndarray
    impulse: np.ndarray
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


def read_at_contacts(images, batch: ContactBatch):
    """Impulses (K, 2) at the contacts from images (B, n_y, n_x, 2): `images.read_back`, differentiable."""
    nodes = ops.reshape(images, (-1, images.shape[-1]))
    corners = ops.take(nodes, batch.node, axis=0)
    return ops.sum(corners * ops.expand_dims(batch.node_weight, -1), axis=1) * batch.unit


def velocity_errors(impulses, batch: ContactBatch):
    """‖v − v*‖² / ‖v* − v⁻‖² of each state, (B,), before any sweep: `metrics.velocity_error`², differentiable."""
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
    # The third component is s = ω r, whose inertia is half the mass.
    energy = ops.sum(ops.square(velocity) * ops.convert_to_tensor([1.0, 1.0, 0.5], velocity.dtype), axis=-1)
    return ops.segment_sum(batch.body_weight * energy, batch.body_state, num_segments=ops.shape(batch.share)[0])


def impulse_errors(impulses, batch: ContactBatch):
    """Σ (λ − λ*)² / k over Σ λ*² / k of each state, (B,), k the row's effective mass: the diagonal of A alone."""
    each = ops.sum(batch.impulse_weight * ops.square(impulses - batch.impulse), axis=-1)
    return ops.segment_sum(each, batch.state, num_segments=ops.shape(batch.share)[0])


def velocity_loss(impulses, batch: ContactBatch):
    """Mean over states of the relative velocity error, plus a share of the relative error of the impulses.

    It is linear in the errors, so that the error left in nearly solved states still counts.
    """
    velocity = ops.sum(batch.share * _root(velocity_errors(impulses, batch)))
    return velocity + IMPULSE_SHARE * impulse_loss(impulses, batch)


def squared_velocity_loss(impulses, batch: ContactBatch):
    """`velocity_loss` with the squares of both errors: dominated by the states with the largest errors."""
    errors = velocity_errors(impulses, batch) + IMPULSE_SHARE * impulse_errors(impulses, batch)
    return ops.sum(batch.share * errors)


def impulse_loss(impulses, batch: ContactBatch):
    """Mean over states of the relative error of the impulses."""
    return ops.sum(batch.share * _root(impulse_errors(impulses, batch)))


def _root(squares):
    """√, smoothed at 0, where its slope is infinite."""
    return ops.sqrt(squares + _ROUND**2) - _ROUND


CONTACT_LOSSES: dict[str, Callable] = {
    "velocity": velocity_loss,
    "squared velocity": squared_velocity_loss,
    "impulse": impulse_loss,
}
"""Name -> function of (impulses, batch)."""


# ---- batches, in NumPy ----


def state_contacts(state: State, spec: ImageSpec) -> dict[str, np.ndarray]:
    """Fields of a `ContactBatch` for one solved state, from `node` to `body_weight`, numbered within the state.

    Raises ValueError on a state that is not solved.
    """
    if state.contacts is None or not state.solved:
        raise ValueError("state.solved: expected a state that holds its solution, got False")
    contacts, mass, view = state.contacts, state.bodies.mass, View(state)
    rows, free, _ = view.problem
    effective_mass, inverse_mass = rows.data[:, NORMAL_MASS : TANGENT_MASS + 1], free[:, INVERSE_MASS][rows.body]
    impulse = np.stack([contacts.normal_impulse, contacts.tangent_impulse], axis=1)
    change = np.zeros_like(free)
    change[:, INVERSE_MASS] = free[:, INVERSE_MASS]
    apply_impulses(Rows(rows.body, rows.data, impulse), change)
    # Twice the energies, J, of v* − v⁻, and of the impulses row by row; s = ω r has half the inertia of the mass.
    body_energy = mass @ (change[: len(mass), :3] ** 2 @ [1.0, 1.0, 0.5])
    row_energy = np.sum(impulse**2 / effective_mass)
    floor = _FLOOR * np.sum(effective_mass * row_velocities(rows, free) ** 2)
    scale = view.scale if spec.scale_free else 1.0
    node, node_weight = gather_weights(state, spec)
    return {
        "node": node,
        "node_weight": node_weight,
        "impulse": impulse / scale,
        # Energies scale with the square of the scale.
        "impulse_weight": scale**2 / max(row_energy + floor, 1e-300) / effective_mass,
        "body": rows.body.astype(np.int64),
        "inverse_mass": inverse_mass,
        "arm": rows.data[:, ARM_A : ARM_B + 1],
        "normal": contacts.normal,
        "friction": np.full(contacts.count, state.world.friction),
        "body_weight": mass * (scale**2 / max(body_energy + floor, 1e-300)),
    }


def gather_weights(state: State, spec: ImageSpec) -> tuple[np.ndarray, np.ndarray]:
    """The weights of `read_back`: nodes of the flattened image, (m, 4), and what each contributes to the contact.

    A point outside the grid reads its edge; without density at the nodes around it, it reads the nearest node.
    """
    grid, position = spec.grid(state.world), state.contacts.position
    (n_y, n_x), geometry = grid.shape, (*grid.origin, *grid.spacing)
    node, weight = np.empty((len(position), 4), np.int64), np.empty((len(position), 4))
    bilinear_nodes(geometry, n_y, n_x, position, node, weight)
    if spec.transfer != "consistent" or not len(position):
        return node, weight
    options = {"unreached": "nearest", "outside": "clamp"}
    density = sph.density(grid, position, h=spec.support, kernel=spec.kernel, **options).reshape(-1)
    total = np.sum(weight * density[node], axis=1)
    lost = total <= 0.0
    if lost.any():
        steps = np.floor((position[lost] - geometry[:2]) / geometry[2:] + 0.5).astype(np.int64)
        i, j = np.clip(steps, 0, [n_x - 1, n_y - 1]).T
        node[lost] = (j * n_x + i)[:, None]
        weight[lost] = [1.0, 0.0, 0.0, 0.0]
        total[lost] = density[node[lost, 0]]
    return node, weight / total[:, None]


def contact_batch(parts: Sequence[dict], nodes: int, spec: ImageSpec, symmetries=None) -> ContactBatch:
    """The contacts of several states, of `state_contacts`, whose images have `nodes` nodes each, as one batch.

    symmetries: a pair for each state if the images were turned: (new number of each node or None, mirrored or not).
    The image is read at the turned contacts; all other fields stay as they are.
    """
    contacts, bodies = ([len(part[name]) for part in parts] for name in ("node", "body_weight"))
    first = np.cumsum([0, *bodies])
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    moved, sign = zip(*(symmetries or [(None, False)] * len(parts)))
    node = [part["node"] if goes is None else goes[part["node"]] for part, goes in zip(parts, moved)]
    body = [np.where(part["body"] < n, part["body"] + f, first[-1]) for part, n, f in zip(parts, bodies, first)]
    joined |= {
        "node": np.concatenate([own + k * nodes for k, own in enumerate(node)]),
        "body": np.concatenate(body),
        "state": np.repeat(np.arange(len(parts)), contacts),
        "body_weight": np.append(joined["body_weight"], 0.0),
        "body_state": np.append(np.repeat(np.arange(len(parts)), bodies), 0),
        "share": np.full(len(parts), 1.0 / len(parts)),
        "unit": np.repeat([[1.0, -1.0 if mirrored else 1.0] for mirrored in sign], contacts, axis=0)
        * np.asarray(spec.target_scales),
    }
    types = {"i": np.int32, "f": np.float32}
    return ContactBatch(**{name: array.astype(types[array.dtype.kind]) for name, array in joined.items()})
