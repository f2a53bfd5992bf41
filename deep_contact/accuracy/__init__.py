"""Presets of accuracy, and the numbers of a scene by which they choose a solver."""
