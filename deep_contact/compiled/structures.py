"""Structures: objects with several fields, which Python passes to compiled code as one argument.

Numba determines the type of every array that is passed to it, which takes time. A step has about eighty arrays, and a
structure contains them.

Tests: tests/compiled/test_lean.py
"""

from __future__ import annotations

from numba import config, types
from numba.experimental import structref

if config.DISABLE_JIT:

    class Structure:
        """Base class of structures. values: one for each field, in the order of `define`."""

        def __init__(self, *values):
            vars(self).update(zip(self._fields, values))

    class StructureType:
        """Base class of the Numba types of structures."""

    def define(structure: type, kind: type, fields: tuple[str, ...]) -> None:
        """Define the fields of a structure. kind: Numba's type of the structure, a subclass of `StructureType`."""
        structure._fields = fields

else:
    Structure = structref.StructRefProxy

    class StructureType(types.StructRef):
        """Base class of the Numba types of structures."""

        def preprocess_fields(self, fields):
            return tuple((name, types.unliteral(kind)) for name, kind in fields)

    def define(structure: type, kind: type, fields: tuple[str, ...]) -> None:
        """Define the fields of a structure, and register the structure with Numba.

        kind: Numba's type of the structure, a subclass of `StructureType`.
        """
        structure._fields = fields
        structref.register(kind)
        structref.define_proxy(structure, kind, list(fields))
