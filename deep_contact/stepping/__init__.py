"""One time step (chapter 2 of the thesis): `algorithm.advance` is the algorithm."""
