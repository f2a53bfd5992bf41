"""Reduce the work of Numba's compiler, for which a first run waits.

Python calls a compiled function through a wrapper, which unpacks nested tuples of arrays. The wrappers are a fifth of
all code that is compiled. Most functions are called only by other compiled functions, and need no wrapper. They need no
machine code of their own either, because LLVM links their code, in its own language, into that of their callers.
"""

from __future__ import annotations

import gc
from contextlib import contextmanager
from functools import cache

from numba.core import sigutils
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.environment import lookup_environment
from numba.core.registry import CPUDispatcher
from numba.core.runtime.context import NRTContext


@contextmanager
def uncollected():
    """Switch off Python's search for reference cycles in this context, because the compiler leaves hardly any garbage.

    The caller has to have Numba's compiler lock. The process needs up to 45 MB more memory.
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
    """Make Numba, in this context, count references only to those members of a value that have a reference count.

    Numba's own code reads all members of a value to count references, down to the strides of every array. This is four
    fifths of the lines of code of a step. The caller has to have Numba's compiler lock.
    """
    before, NRTContext.get_meminfos = NRTContext.get_meminfos, _get_meminfos
    try:
        yield
    finally:
        NRTContext.get_meminfos = before


def _get_meminfos(self, builder, ty, val):
    """Return the reference counts in a value as a list of (type, pointer), as Numba's method of this name does.

    builder: LLVM's builder. ty: Numba's type of the value. val: the value.
    """
    model = self._context.data_model_manager[ty]
    found = [(ty, model.get_nrt_meminfo(builder, val))] if model.has_nrt_meminfo() else []
    for member, read in model.traverse(builder):
        if _is_counted(self._context.data_model_manager[member]):
            found += _get_meminfos(self, builder, member, read(val))
    return found


class _LazyLibrary(JITCodeLibrary):
    """Code in LLVM's language. LLVM makes its machine code when Numba first asks for the address of a function in it.

    Numba asks for the address of the wrapper of each function. The code of a function without a wrapper gets no machine
    code, and the cache keeps it in LLVM's language.
    """

    _is_loaded = False

    def _finalize_final_module(self):
        # Numba's runtime has to be there before any function is. The cache may have the machine code of a function.
        if self.name == "nrt" or (self._object_caching_enabled and self._compiled_object):
            self._load()
            return
        self._verify_declare_only_symbols()
        self._finalize_dynamic_globals()
        self._finalized = True

    def _load(self) -> None:
        """Make the machine code, unless the cache has it, and add it to the code of the process."""
        self._is_loaded = True
        self._dynamic_globals.clear()  # Numba finds them again
        super()._finalize_final_module()
        # The code of other functions is linked into this code. It may need constants of Python, such as texts to print.
        for variable in self._final_module.global_variables:
            environment = lookup_environment(variable.name)
            if environment is not None:
                self._codegen.set_env(variable.name, environment)

    def get_pointer_to_function(self, name):
        self._ensure_finalized()
        if not self._is_loaded and any(f.name == name and not f.is_declaration for f in self._final_module.functions):
            self._load()
        return super().get_pointer_to_function(name)

    def serialize_using_object_code(self):
        return super().serialize_using_object_code() if self._is_loaded else self.serialize_using_bitcode()


@contextmanager
def lazy_machine_code():
    """Make Numba, in this context, emit machine code only for functions whose address is asked for.

    The caller has to have Numba's compiler lock.
    """
    before = JITCPUCodegen._library_class, JITCPUCodegen.set_env
    JITCPUCodegen._library_class, JITCPUCodegen.set_env = _LazyLibrary, _set_env
    try:
        yield
    finally:
        JITCPUCodegen._library_class, JITCPUCodegen.set_env = before


_numbas_set_env = JITCPUCodegen.set_env


def _set_env(self, name, environment):
    """Write the address of a function's constants of Python into the variable `name`, if any machine code has it."""
    if self._engine.is_symbol_defined(name):
        _numbas_set_env(self, name, environment)


@cache
def _is_counted(model) -> bool:
    return model.contains_nrt_meminfo()


class _Recursion(Exception):
    """A function that is being compiled without a wrapper calls itself, directly or through other functions."""


class LeanDispatcher(CPUDispatcher):
    """A compiled function. Its wrapper, through which Python calls it, is compiled only when Python calls it.

    For a compiled caller, `inner` compiles a version without a wrapper, unless a version with a wrapper exists. Both
    dispatchers share the dictionary `overloads`, in which Numba looks for the versions that compiled code calls. If
    Python calls the function, this dispatcher compiles a version with a wrapper, or reads it from its cache. That
    version replaces the one without a wrapper.
    """

    _depth, _all_whole = 0, False
    """Number of nested compilations, and whether all of them make wrappers. Both change under Numba's compiler lock."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._inner = self._outer = None
        self._whole, self._replaced = set(), []

    @property
    def inner(self) -> LeanDispatcher:
        """The dispatcher that compiles the function for compiled callers, without a wrapper. Python never calls it."""
        if self._inner is None:
            self._inner = self.make_inner(self.targetoptions | {"no_cpython_wrapper": True})
            self._inner.overloads, self._inner._outer = self.overloads, self
        return self._inner

    def make_inner(self, options: dict) -> LeanDispatcher:
        """Return a dispatcher of the same function. options: options of Numba, name -> value."""
        return type(self)(self.py_func, targetoptions=options)

    def get_call_template(self, args, kws):
        return CPUDispatcher.get_call_template(self if self._all_whole else self.inner, args, kws)

    def add_overload(self, cres):
        super().add_overload(cres)
        self._whole.add(tuple(cres.signature.args))

    def compile(self, signature):
        types = tuple(sigutils.normalize_signature(signature)[0])
        if self._outer is None and types in self.overloads and types not in self._whole:
            self._replaced.append(self.overloads.pop(types))  # stays alive, since its callers refer to its constants
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
        """Whether this function is being compiled: then a call of it, in the code that is compiled now, is a recursion.

        `numba.core.typeinfer` reads this property. A recursive call refers to the function by its name in machine code,
        and the name depends on whether the function has a wrapper. Therefore, if a function calls itself, directly or
        not, everything that is compiled with it gets wrappers, as in Numba itself: `_Recursion` ends a compilation
        without wrappers, and `compile` begins again.
        """
        found = bool(self._compiling_counter or (self._inner and self._inner._compiling_counter))
        if found and not self._all_whole:
            raise _Recursion
        return found
