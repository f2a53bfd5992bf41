"""Velocities of rows, and nodes of images around points, as the images, losses and the far-field network read them."""

from __future__ import annotations

import numpy as np
from numba import njit

from deep_contact.physics.contact_solver import ARM_A, ARM_B, BODY_A, BODY_B, N_X, N_Y, TARGET, V_S, V_X, V_Y
from deep_contact.sph.grid import bilinear_weights


@njit(cache=True, error_model="numpy")
def row_velocity(rows, velocity, i):
    """Normal relative velocity less its target, and tangential relative velocity, of contact i, m/s."""
    a, b = rows.body[i, BODY_A], rows.body[i, BODY_B]
    n_x, n_y = rows.data[i, N_X], rows.data[i, N_Y]
    v_x, v_y = velocity[b, V_X] - velocity[a, V_X], velocity[b, V_Y] - velocity[a, V_Y]
    turn = rows.data[i, ARM_A] * velocity[a, V_S] + rows.data[i, ARM_B] * velocity[b, V_S]
    return v_x * n_x + v_y * n_y - rows.data[i, TARGET], v_x * n_y - v_y * n_x + turn


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
        i, _, j, _, _ = bilinear_weights(geometry, n_y, n_x, point[k, 0], point[k, 1], weight[k])
        node[k, 0] = j * n_x + i
        node[k, 1] = node[k, 0] + 1
        node[k, 2] = node[k, 0] + n_x
        node[k, 3] = node[k, 2] + 1
