"""What Numba needs and nobody has to read for the physics: the cache of compiled code, vector instructions, threads."""
