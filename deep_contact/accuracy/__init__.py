"""How accurate: presets, and what they have to know of a scene."""
