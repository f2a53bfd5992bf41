"""Let compiled code hand its results over without running Python.

Numba turns a result into Python objects by code that calls Python, where a Ctrl-C that came while the compiled code
ran is raised, and looks at no error: the process ends with a segmentation fault. Here the classes are constants that C
reads, and Ctrl-C is raised behind the call. This replaces details of `numba.core.pythonapi` while a function of this
package is compiled.
"""

from __future__ import annotations

from contextlib import contextmanager
from functools import wraps

from numba.core import types
from numba.core.boxing import box_namedtuple, box_tuple
from numba.core.pythonapi import PythonAPI, _boxers

_new_tuple = tuple.__new__


_unpickling = PythonAPI.from_native_value
_NAMED = (types.NamedTuple, types.NamedUniTuple)


@contextmanager
def safe_results():
    """Make the results of functions that are compiled within safe. To be used under Numba's compiler lock."""
    before = PythonAPI.from_native_value, [_boxers.functions[kind] for kind in _NAMED]
    PythonAPI.from_native_value = _from_native_value
    _boxers.functions.update(dict.fromkeys(_NAMED, _box_named_tuple))
    try:
        yield
    finally:
        PythonAPI.from_native_value = before[0]
        _boxers.functions.update(zip(_NAMED, before[1]))


@wraps(_unpickling)
def _from_native_value(self, typ, val, env_manager=None):
    if env_manager is None or "unserialize" in vars(self):
        return _unpickling(self, typ, val, env_manager)

    def constant(value):
        pointer = env_manager.read_const(env_manager.add_const(value))
        self.incref(pointer)
        return pointer

    self.serialize_object, self.unserialize = lambda value: value, constant
    try:
        return _unpickling(self, typ, val, env_manager)
    finally:
        del self.serialize_object, self.unserialize


def _box_named_tuple(typ, val, c):
    if not (typ.instance_class.__new__.__doc__ or "").startswith("Create new instance of"):
        return box_namedtuple(typ, val, c)  # a class that makes its instances itself
    parts = [c.pyapi.unserialize(c.pyapi.serialize_object(one)) for one in (_new_tuple, typ.instance_class)]
    parts.append(box_tuple(typ, val, c))
    made = c.pyapi.call_function_objargs(parts[0], parts[1:])
    for part in parts:
        c.pyapi.decref(part)
    return made
