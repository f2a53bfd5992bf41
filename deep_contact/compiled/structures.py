"""Structures that compiled code keeps: one object, which Python hands over in place of the arrays in it.

Numba looks at every array that it is handed. A step has some eighty of them.
"""

from __future__ import annotations

from numba import config, types
from numba.experimental import structref

if config.DISABLE_JIT:

    class Structure:
        """What is handed over."""

        def __init__(self, *values):
            vars(self).update(zip(self._fields, values))

    class StructureType:
        """Numba's type of a structure."""

    def define(structure: type, kind: type, fields: tuple[str, ...]) -> None:
        """Let a structure have these fields."""
        structure._fields = fields

else:
    Structure = structref.StructRefProxy

    class StructureType(types.StructRef):
        """Numba's type of a structure."""

        def preprocess_fields(self, fields):
            return tuple((name, types.unliteral(kind)) for name, kind in fields)

    def define(structure: type, kind: type, fields: tuple[str, ...]) -> None:
        """Let a structure have these fields."""
        structure._fields = fields
        structref.register(kind)
        structref.define_proxy(structure, kind, list(fields))
