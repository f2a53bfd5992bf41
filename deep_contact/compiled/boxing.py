"""Make compiled code hand its results over without running Python code.

Numba turns a result into Python objects by machine code that calls Python. If Ctrl-C was pressed while the compiled
function ran, Python raises KeyboardInterrupt in this call. Numba does not check whether the call raised an error, so
that the process ends with a segmentation fault. With `safe_results` the classes of the result are constants, which
machine code reads without running Python code. KeyboardInterrupt is then raised after the call of the compiled
function. To achieve this, details of `numba.core.pythonapi` are replaced while a function of this package is compiled.

Tests: tests/behaviour/test_interrupts.py
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
    """Make functions that are compiled in this context return their results without running Python code.

    The caller has to have Numba's compiler lock.
    """
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
        return box_namedtuple(typ, val, c)  # the class has a `__new__` of its own
    parts = [c.pyapi.unserialize(c.pyapi.serialize_object(one)) for one in (_new_tuple, typ.instance_class)]
    parts.append(box_tuple(typ, val, c))
    made = c.pyapi.call_function_objargs(parts[0], parts[1:])
    for part in parts:
        c.pyapi.decref(part)
    return made
