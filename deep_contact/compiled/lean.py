"""Less work for Numba's compiler, which a first run waits for: no wrappers that nobody calls, no garbage collection.

Python calls compiled code by a wrapper, which takes nested tuples of arrays apart: a fifth of all that is compiled.
Most functions are called by compiled code alone, and need none.
"""

from __future__ import annotations

import gc
from contextlib import contextmanager
from functools import cache

from numba.core import sigutils
from numba.core.registry import CPUDispatcher
from numba.core.runtime.context import NRTContext


@contextmanager
def uncollected():
    """Switch Python's search for reference cycles off within the block: nearly all objects of the compiler stay.

    The block has to hold Numba's lock. It takes up to 45 MB more memory.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@contextmanager
def counted_alone():
    """Within the block, code that counts references to a value reads only those members whose references are counted.

    Numba reads all members, down to the strides of every array: four fifths of the lines of a step. The block has to
    hold Numba's lock.
    """
    before, NRTContext.get_meminfos = NRTContext.get_meminfos, _get_meminfos
    try:
        yield
    finally:
        NRTContext.get_meminfos = before


def _get_meminfos(self, builder, ty, val):
    """The counted references in a value of this type: the list of (type, pointer) that Numba's own method returns."""
    model = self._context.data_model_manager[ty]
    found = [(ty, model.get_nrt_meminfo(builder, val))] if model.has_nrt_meminfo() else []
    for member, read in model.traverse(builder):
        if _is_counted(self._context.data_model_manager[member]):
            found += _get_meminfos(self, builder, member, read(val))
    return found


@cache
def _is_counted(model) -> bool:
    return model.contains_nrt_meminfo()


class _Recursion(Exception):
    """A function that is being compiled without a wrapper calls itself, directly or by other functions."""


class LeanDispatcher(CPUDispatcher):
    """A function whose wrapper for Python is compiled when Python calls it.

    For callers in compiled code `inner` compiles it without a wrapper, unless there is a version that has one. The two
    share `overloads`, where Numba looks for what compiled code calls. Python gets what this dispatcher has compiled, or
    found in its cache, which then takes the place of a version without a wrapper.
    """

    _depth, _all_whole = 0, False
    """Number of nested compilations, and whether all of them make wrappers. Both change under Numba's lock."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._inner = self._outer = None
        self._whole, self._replaced = set(), []

    @property
    def inner(self) -> LeanDispatcher:
        """The dispatcher that compiles the function for compiled callers. Python never calls it."""
        if self._inner is None:
            self._inner = self.make_inner(self.targetoptions | {"no_cpython_wrapper": True})
            self._inner.overloads, self._inner._outer = self.overloads, self
        return self._inner

    def make_inner(self, options: dict) -> LeanDispatcher:
        """A dispatcher of the same function, with these options of Numba."""
        return type(self)(self.py_func, targetoptions=options)

    def get_call_template(self, args, kws):
        return CPUDispatcher.get_call_template(self if self._all_whole else self.inner, args, kws)

    def add_overload(self, cres):
        super().add_overload(cres)
        self._whole.add(tuple(cres.signature.args))

    def compile(self, signature):
        types = tuple(sigutils.normalize_signature(signature)[0])
        if self._outer is None and types in self.overloads and types not in self._whole:
            self._replaced.append(self.overloads.pop(types))  # its callers refer to its constants
        LeanDispatcher._depth += 1
        try:
            return super().compile(signature)
        except _Recursion:
            if self._depth > 1:
                raise
        finally:
            LeanDispatcher._depth -= 1
        LeanDispatcher._all_whole = True
        try:
            return (self._outer or self).compile(signature)
        finally:
            LeanDispatcher._all_whole = False

    @property
    def is_compiling(self):
        """Whether a call of this function in the code that is compiled now is a recursion: `numba.core.typeinfer` asks.

        Such a call is by name, and Numba's names tell whether a function has a wrapper. So where a function calls
        itself, directly or not, all that is compiled with it has wrappers, as Numba does it.
        """
        found = bool(self._compiling_counter or (self._inner and self._inner._compiling_counter))
        if found and not self._all_whole:
            raise _Recursion
        return found
