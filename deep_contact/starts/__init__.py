"""Where a solve starts. Every start has one signature: `start(state, solver) -> (normal, tangent)`.

`names` finds a start by its name; those from images and networks are in `sph.start` and `cnn.start`.
"""
