"""What nobody calls is not compiled; and what somebody calls is there, whoever compiled it, in whatever order."""

import gc
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numba
import numpy as np
import pytest
from conftest import ROOT, run_python
from llvmlite import ir
from numba import types
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.registry import cpu_target
from numba.core.runtime.context import NRTContext

from deep_contact.compiled import lean, njit
from deep_contact.compiled.structures import Structure, StructureType, define

if numba.config.DISABLE_JIT:
    pytest.skip("nothing is compiled", allow_module_level=True)

FUNCTIONS = """
import numba
from deep_contact.compiled import njit

@njit(cache=True)
def root(x):
    if x < 0:
        raise ValueError("negative", x)
    return x**0.5

@njit(cache=True)
def plus_one(x):
    return root(x) + 1

@njit(cache=True)
def plus_two(x):
    return root(x) + 2

@njit(cache=True)
def says(x):
    print("said", x)  # Python's constant "said" lies in the function's environment
    return x

@njit(cache=True)
def says_one(x):
    return says(x) + 1

@njit(cache=True)
def says_two(x):
    return says(x) + 2

@numba.njit
def of_a_user(x):
    return x**0.5

@njit
def calls_a_user(x):
    return of_a_user(x) + 1

@numba.njit
def user_calls(x):
    return plus_one(x) + 1

def has_wrapper(function):
    (compiled,) = function.overloads.values()
    code, names = compiled[compiled._fields.index("library")], compiled.fndesc
    return code.get_pointer_to_function(names.llvm_cpython_wrapper_name) != 0

def has_machine_code(function):
    (compiled,) = function.overloads.values()
    return compiled[compiled._fields.index("library")]._is_loaded

def error_of(function):
    try:
        function(-1.0)
    except ValueError as error:
        return error.args
"""


@pytest.fixture
def run(tmp_path):
    """A function: what a new process prints of expressions of `FUNCTIONS`, whose cache the test begins without."""
    (tmp_path / "functions.py").write_text(FUNCTIONS)
    environment = {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)]), "NUMBA_CACHE_DIR": str(tmp_path)}

    def printed(*expressions):
        code = "\n".join(["from functions import *", *(f"print({one})" for one in expressions)])
        return run_python("-c", code, environment=environment).stdout.split("\n")[:-1]

    return printed


def test_a_function_gets_its_wrapper_when_python_calls_it(run):
    expressions = "plus_one(4.0)", "has_wrapper(root)", "root(4.0)", "has_wrapper(root)", "plus_one(9.0)", "root(9.0)"
    assert run(*expressions) == ["3.0", "False", "2.0", "True", "4.0", "3.0"]


def test_compiled_callers_take_the_version_that_python_has_called(run):
    again = "root.compile((numba.float64,)) is root.compile((numba.float64,))"
    expressions = "root(4.0)", "plus_one(4.0)", "has_wrapper(root)", again, "len(root._replaced)"
    assert run(*expressions) == ["2.0", "3.0", "True", "True", "0"]


def test_what_the_cache_has_without_a_wrapper_is_not_handed_to_python(run):
    """It would be a call of the address 0."""
    assert run("plus_one(4.0)") == ["3.0"]
    for _ in range(2):
        assert run("root(4.0)", "plus_one(4.0)", "error_of(root)") == ["2.0", "3.0", "('negative', -1.0)"]


def test_a_new_caller_takes_what_the_cache_has_without_a_wrapper(run):
    expressions = "plus_two(4.0)", "sum(root.inner.stats.cache_hits.values())", "error_of(plus_two)", "root(4.0)"
    assert run("plus_one(4.0)", "error_of(plus_one)") == ["3.0", "('negative', -1.0)"]
    assert run(*expressions) == ["4.0", "1", "('negative', -1.0)", "2.0"]
    assert run(*expressions) == ["4.0", "0", "('negative', -1.0)", "2.0"]  # now the caller's own code has it


def test_a_function_gets_machine_code_when_python_calls_it(run):
    code = "has_machine_code(root)"
    assert run("plus_one(4.0)", code, "root(4.0)", code, "root(9.0)") == ["3.0", "False", "2.0", "True", "3.0"]


def test_what_the_cache_has_without_machine_code_gets_none_from_a_new_caller(run):
    assert run("plus_one(4.0)") == ["3.0"]
    assert run("plus_two(4.0)", "has_machine_code(root)") == ["4.0", "False"]


def test_constants_of_python_reach_the_code_into_which_they_are_linked(run):
    """Compiled at once, read from the cache, and under a caller that is new to what the cache has."""
    for _ in range(2):
        assert run("says_one(4.0)") == ["said 4.0", "5.0"]
    for _ in range(2):
        assert run("says_two(4.0)", "says_one(4.0)", "says(4.0)") == [
            "said 4.0",
            "6.0",
            "said 4.0",
            "5.0",
            "said 4.0",
            "4.0",
        ]


def test_a_users_functions_keep_their_code_inside_ours_and_around_them(run):
    expressions = "calls_a_user(4.0)", "has_wrapper(of_a_user)", "of_a_user(4.0)", "user_calls(4.0)", "plus_one(4.0)"
    assert run(*expressions) == ["3.0", "True", "2.0", "4.0", "3.0"]


# Functions that call themselves, whom Numba calls by a name that tells whether there is a wrapper.


def made():
    """Functions of no version: n!, the sum of two of them, evenness, one that calls it, and one of changing types."""

    @njit
    def factorial(n):
        return n * factorial(n - 1) if n > 1 else 1

    @njit
    def factorials(n):
        return factorial(n) + factorial(3)

    return factorial, factorials


@njit
def is_even(n):
    return True if n == 0 else is_odd(n - 1)


@njit
def is_odd(n):
    return False if n == 0 else is_even(n - 1)


@njit
def count(x, n):
    return 1.0 if n <= 0 else count(1.5, n - 1) + count(2, n - 2)


@njit
def count_by(n):
    return count(n, 4)


@pytest.mark.parametrize("caller_first", [False, True])
def test_a_function_that_calls_itself(caller_first):
    factorial, factorials = made()
    for _ in range(2):
        if caller_first:
            assert factorials(4) == 30
        assert factorial(5) == 120
        assert factorials(4) == 30


def test_functions_that_call_each_other():
    assert [is_even(4), is_odd(4), njit(lambda n: is_odd(n))(3)] == [True, False, True]


def test_a_function_that_calls_itself_with_other_types():
    assert [count_by(1), count(1, 4), count(1.0, 4)] == [8.0] * 3


# ---- garbage collection ----


@pytest.fixture
def collector():
    """Leaves the garbage collector as it was."""
    was_enabled = gc.isenabled()
    gc.enable()
    yield
    (gc.enable if was_enabled else gc.disable)()


@pytest.mark.parametrize("enabled", [True, False])
def test_nothing_is_collected_while_a_function_is_compiled_and_then_as_before(collector, enabled, monkeypatch):
    seen, compile_it = [], lean.CPUDispatcher.compile

    def look(dispatcher, signature):
        seen.append(gc.isenabled())
        return compile_it(dispatcher, signature)

    monkeypatch.setattr(lean.CPUDispatcher, "compile", look)
    (gc.enable if enabled else gc.disable)()
    factorial, factorials = made()
    assert factorials(4) == 30
    with pytest.raises(numba.TypingError):
        factorial("four")
    assert len(seen) >= 4
    assert not any(seen)
    assert gc.isenabled() is enabled


def test_an_interrupt_leaves_the_collector_as_it_was(collector, monkeypatch):
    def interrupt(dispatcher, signature):
        raise KeyboardInterrupt

    monkeypatch.setattr(lean.CPUDispatcher, "compile", interrupt)
    with pytest.raises(KeyboardInterrupt):
        made()[0](4)
    assert gc.isenabled()
    assert lean.LeanDispatcher._depth == 0
    assert NRTContext.get_meminfos is not lean._get_meminfos
    assert JITCPUCodegen._library_class is JITCodeLibrary
    assert JITCPUCodegen.set_env is lean._numbas_set_env


def test_threads_that_compile_and_call_at_once():
    functions = [made() for _ in range(4)]
    with ThreadPoolExecutor(8) as pool:
        calls = [pool.submit(one, kind(4)) for pair in functions for one in pair for kind in (int, float)]
        assert [call.result() for call in calls] == [24, 24, 30, 30] * 4


# ---- counted references ----


class Pair(NamedTuple):
    """Two fields."""

    one: object
    other: object


class Kept(Structure):
    """An array."""


class KeptType(StructureType):
    """Numba's type of it."""


define(Kept, KeptType, ("array",))

ARRAY = types.Array(types.float64, 2, "C")
RECORD = numba.from_dtype(np.dtype([("x", np.float64), ("n", np.int64)]))
KINDS = [
    types.float64, types.none, types.unicode_type, ARRAY, types.Optional(ARRAY), types.Array(RECORD, 1, "C"),
    types.Tuple([ARRAY, types.int64, types.UniTuple(ARRAY, 3)]), types.UniTuple(types.float64, 2), types.List(ARRAY),
    types.NamedTuple([types.NamedUniTuple(ARRAY, 2, Pair), types.Optional(types.int64)], Pair), types.ListType(ARRAY),
    KeptType([("array", ARRAY)]), types.Tuple([types.complex128, KeptType([("array", ARRAY)])]),
    types.DictType(types.int64, ARRAY), types.Tuple([types.literal("name"), types.Optional(types.float64)]),
]  # fmt: skip


def references(method, kind):
    """The types of the references that a method finds in a value of a kind, and how many instructions read them."""
    context = cpu_target.target_context
    context.refresh()
    module, value = ir.Module(), context.get_value_type(kind)
    block = ir.Function(module, ir.FunctionType(ir.VoidType(), [value]), "f").append_basic_block()
    builder = ir.IRBuilder(block)
    found = method(NRTContext(context, True), builder, kind, block.function.args[0])
    return [one for one, _ in found], [str(pointer.type) for _, pointer in found], len(block.instructions)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_the_counted_references_in_a_value_are_those_that_numba_counts(kind):
    """In the same order. Where this fails, Numba counts others than it did: see `lean.counted_alone`."""
    *ours, few = references(lean._get_meminfos, kind)
    *numbas, many = references(NRTContext.get_meminfos, kind)
    assert ours == numbas
    assert few <= many


def test_members_that_are_not_counted_are_not_read():
    kind = types.Tuple([ARRAY, types.int64])
    *_, few = references(lean._get_meminfos, kind)
    assert few == 2  # the array, and the reference in it


def test_as_many_references_are_given_back_as_are_taken():
    @njit
    def mixed(arrays, n):
        kept = Pair(arrays[0], (n, arrays[1]))
        for _ in range(n):
            kept = Pair(kept.other[1], (n, kept.one))
        return (kept.one, 1), kept

    arrays = np.ones(5), np.ones(5)
    before = [sys.getrefcount(one) for one in arrays]
    for n in range(4):
        (one, _), kept = mixed(arrays, n)
        one[n] += kept.other[1][n]
    del one, kept, _
    assert [one.tolist() for one in arrays] == [[2.0, 1.0, 2.0, 1.0, 1.0], [1.0, 2.0, 1.0, 2.0, 1.0]]
    assert [sys.getrefcount(one) for one in arrays] == before


def test_a_function_counts_references_although_its_first_caller_counts_none():
    @njit
    def numbers(n):
        return np.arange(n)

    @njit(_nrt=False)
    def first_caller(n):
        return numbers(n).shape[0]

    assert first_caller(3) == 3
    kept = [numbers(1000) for _ in range(200)]
    assert all((array == np.arange(1000)).all() for array in kept)
