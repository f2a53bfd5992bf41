"""Starts: the impulses from which a solve begins. A start is a function `start(state, solver) -> (normal, tangent)`.

`normal` and `tangent` are the starting impulses λ_n and λ_t of the contacts, (m,) each, N·s. `names` finds a start by
its name. Starts from images and networks are in `sph.start` and `cnn.start`.
"""
