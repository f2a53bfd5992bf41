"""The rows of a state's contact problem, as the images, the losses and the far-field network read them."""

from __future__ import annotations

import numpy as np
from numba import njit

from deep_contact.physics.contact_solver import contact_rows, integrate_velocities, make_rows
from deep_contact.sph.grid import _bilinear_weights


@njit(cache=True, error_model="numpy")
def contact_problem(bodies, contacts, world, dt):
    """(`Rows` of the contacts, velocities after Δt of gravity without impulses, packed as the solver does, (n + 4, 4)).

    world: of `engine.world_arguments`. The rows hold the impulses that the contacts start from.
    """
    _, gravity, _, restitution = world
    free = np.empty((bodies.mass.shape[0] + 4, 4))
    integrate_velocities(bodies, gravity, dt, free)
    rows, _ = contact_rows(bodies, contacts, free, restitution, make_rows(contacts.body_a.shape[0], free.dtype))
    return rows, free


@njit(cache=True, error_model="numpy")
def row_velocity(rows, velocity, i):
    """Normal relative velocity less its target, and tangential relative velocity, of contact i, m/s."""
    a, b = rows.body[i, 0], rows.body[i, 1]
    n_x, n_y = rows.data[i, 0], rows.data[i, 1]
    v_x, v_y = velocity[b, 0] - velocity[a, 0], velocity[b, 1] - velocity[a, 1]
    turn = rows.data[i, 4] * velocity[a, 2] + rows.data[i, 5] * velocity[b, 2]
    return v_x * n_x + v_y * n_y - rows.data[i, 6], v_x * n_y - v_y * n_x + turn


@njit(cache=True, error_model="numpy")
def row_velocities(rows, velocity):
    """`row_velocity` of all contacts, (m, 2), m/s."""
    found = np.empty((rows.body.shape[0], 2))
    for i in range(found.shape[0]):
        found[i, 0], found[i, 1] = row_velocity(rows, velocity, i)
    return found


@njit(cache=True, error_model="numpy")
def bilinear_nodes(geometry, n_y, n_x, point, node, weight):
    """Fill node and weight, (m, 4) each: the nodes of a flattened image around points (m, 2), weighted as by `gather`.

    geometry: (x_0, y_0, d_x, d_y) of the grid, m. A point outside reads the edge of the grid.
    """
    for k in range(point.shape[0]):
        i, _, j, _, _ = _bilinear_weights(geometry, n_y, n_x, point[k, 0], point[k, 1], weight[k])
        node[k, 0] = j * n_x + i
        node[k, 1] = node[k, 0] + 1
        node[k, 2] = node[k, 0] + n_x
        node[k, 3] = node[k, 2] + 1
