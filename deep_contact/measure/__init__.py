"""Measurement of the cost and the errors of settings on a scene, against a reference and other engines."""
