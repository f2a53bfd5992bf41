"""SIMD vectors as a Numba type: a kernel for eight contacts at once reads like a kernel for one contact.

The operators `+ - * /` and the functions below act on each lane (element) of a vector separately. LLVM distributes the
lanes over the vector registers of the processor, so that nothing here depends on their width. The operators carry the
fast-math flag "contract": the compiler may fuse a * b + c into one operation, as in the scalar sweep. `times` does not
carry it.

All functions are for compiled callers. Without the compiler (NUMBA_DISABLE_JIT=1), each is replaced by the function on
NumPy arrays of eight numbers that its decorator contains.

Tests: tests/solvers/test_batched.py
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

WIDTH = 8
"""Number of lanes of a vector, unless its type `Lanes` states another number."""

_INT32, _INT64 = ir.IntType(32), ir.IntType(64)


class Lanes(types.Type):
    """Numba's type of a SIMD vector. dtype: Numba's type of a lane. width: number of lanes."""

    def __init__(self, dtype, width=WIDTH):
        self.dtype, self.width = dtype, width
        super().__init__(name=f"Lanes({dtype}, {width})")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, lanes):
        super().__init__(manager, lanes, ir.VectorType(manager.lookup(lanes.dtype).get_value_type(), lanes.width))


def _lanewise(on_arrays):
    """Return a decorator that makes a Numba intrinsic, or replaces the function by `on_arrays` without the compiler.

    on_arrays: function that does the same with NumPy arrays.
    """
    return (lambda _: on_arrays) if config.DISABLE_JIT else intrinsic


def _built(build):
    """Return the code generator of an intrinsic. build: function (LLVM's builder, *values) -> value."""
    return lambda context, builder, signature, values: build(builder, *values)


def _arithmetic(symbol, instruction):
    @intrinsic
    def apply(context, x, y):
        return x(x, y), _built(lambda builder, x, y: getattr(builder, instruction)(x, y, flags=("contract",)))

    @overload(symbol)
    def apply_to_lanes(x, y):
        if isinstance(x, Lanes) and x == y:
            return lambda x, y: apply(x, y)


_arithmetic(operator.add, "fadd")
_arithmetic(operator.sub, "fsub")
_arithmetic(operator.mul, "fmul")
_arithmetic(operator.truediv, "fdiv")


@_lanewise(np.multiply)
def times(context, x, y):
    """Return x * y, rounded before anything is added to it, as in NumPy. The operator `*` may be fused with a sum."""
    return x(x, y), _built(lambda builder, x, y: builder.fmul(x, y))


@_lanewise(lambda x, y, then, otherwise: np.where(x < y, then, otherwise))
def where_less(context, x, y, then, otherwise):
    """Return `then` in the lanes in which x < y, and `otherwise` in the other lanes."""
    signature = then(x, y, then, otherwise)
    return signature, _built(lambda builder, x, y, *two: builder.select(builder.fcmp_ordered("<", x, y), *two))


@_lanewise(lambda x, y: bool((x < y).any()))
def any_less(context, x, y):
    """Return whether x < y in any lane."""

    def build(builder, x, y):
        mask = builder.fcmp_ordered("<", x, y)
        bits = builder.bitcast(mask, ir.IntType(mask.type.count))
        return builder.icmp_unsigned("!=", bits, bits.type(0))

    return types.boolean(x, y), _built(build)


def _choice(sign, holds):
    """Return a function (x, y) that chooses, in each lane, y if "y sign x" holds, and otherwise x.

    It chooses x also where x or y is NaN. sign: "<" or ">". holds: the same comparison as a function of NumPy.
    """

    @_lanewise(lambda x, y: np.where(holds(y, x), y, x))
    def choose(context, x, y):
        return x(x, y), _built(lambda builder, x, y: builder.select(builder.fcmp_ordered(sign, y, x), y, x))

    return choose


least, most = _choice("<", np.less), _choice(">", np.greater)


@_lanewise(np.sqrt)
def root(context, x):
    """Return the square root of each lane."""
    name = f"llvm.sqrt.v{x.width}f{x.dtype.bitwidth}"

    def build(builder, x):
        kind = ir.FunctionType(x.type, [x.type])
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [x])

    return x(x), _built(build)


@_lanewise(lambda number: np.full(WIDTH, number))
def spread(context, number):
    """Return a vector with the same number in all lanes."""
    return Lanes(number)(number), _emit_spread


@_lanewise(lambda like, number: np.full_like(like, number))
def spread_like(context, like, number):
    """Return a vector with the same number in all lanes, and as many lanes as `like`."""
    return like(like, number), _emit_spread


@_lanewise(lambda x: np.concatenate([x, x]))
def doubled(context, x):
    """Return a vector of twice as many lanes, whose first and second half both contain the lanes of x."""
    both = [*range(x.width)] * 2
    return Lanes(x.dtype, 2 * x.width)(x), _built(lambda builder, x: _shuffle(builder, x, x, both))


@_lanewise(lambda x, i: x[i])
def lane(context, x, i):
    """Return the number in lane i of x."""
    return x.dtype(x, types.int64), _built(lambda builder, x, i: builder.extract_element(x, builder.trunc(i, _INT32)))


@_lanewise(lambda array, i: array.reshape(-1)[WIDTH * i : WIDTH * (i + 1)].copy())
def load(context, array, i):
    """Return the numbers 8 i to 8 i + 7 of a contiguous array as a vector."""
    return Lanes(array.dtype)(array, types.int64), _emit_load


# `int`, since NumPy 1 makes a float of WIDTH * uint64.
@_lanewise(lambda like, array, i: array.reshape(-1)[WIDTH * int(i) :][: like.size].copy())
def load_like(context, like, array, i):
    """Return a vector of as many lanes as `like`, with the numbers of a contiguous array from number 8 i on."""
    return like(like, array, types.int64), _emit_load


@_lanewise(lambda array, i, x: operator.setitem(array.reshape(-1), slice(WIDTH * i, WIDTH * i + x.size), x))
def store(context, array, i, x):
    """Write the lanes of x into a contiguous array, from its number 8 i on."""

    def emit(context, builder, signature, values):
        _store(builder, values[2], _pointer(context, builder, array, *values[:2], WIDTH), array)
        return context.get_dummy_value()

    return types.void(array, types.int64, x), emit


@_lanewise(lambda rows, index, i: tuple(rows[load(index, i)].T.copy()))
def load_rows(context, rows, index, i):
    """Return the four columns of eight rows of an array, as four vectors of eight lanes.

    rows: array (n, 4), contiguous. index: array of uint32; its numbers 8 i to 8 i + 7 are the indices of the rows.
    """
    lanes = Lanes(rows.dtype)

    def emit(context, builder, signature, values):
        kind = ir.VectorType(context.get_value_type(rows.dtype), 4)
        pointers = _row_pointers(context, builder, rows, index, values)
        row = [_load(builder, pointer, kind, rows) for pointer in pointers]
        # Three shuffles: two rows side by side; two such pairs interleaved, which gives 0x 1x 0s 1s 2x 3x 2s 3s; the
        # numbers x apart from the numbers s. (Digits are rows, and x and s are the first and third column.) AVX-512
        # does each shuffle in one operation.
        pair = [_shuffle(builder, row[k], row[k + 2], range(8)) for k in (0, 1, 4, 5)]
        low = [_shuffle(builder, pair[k], pair[k + 1], (0, 8, 2, 10, 4, 12, 6, 14)) for k in (0, 2)]
        high = [_shuffle(builder, pair[k], pair[k + 1], (1, 9, 3, 11, 5, 13, 7, 15)) for k in (0, 2)]
        first, second = (0, 1, 4, 5, 8, 9, 12, 13), (2, 3, 6, 7, 10, 11, 14, 15)
        columns = [_shuffle(builder, *half, mask) for mask in (first, second) for half in (low, high)]
        return context.make_tuple(builder, signature.return_type, columns)

    return types.UniTuple(lanes, 4)(rows, index, types.int64), emit


@_lanewise(lambda rows, index, i, columns: operator.setitem(rows, load(index, i), np.stack(columns, axis=1)))
def store_rows(context, rows, index, i, columns):
    """Write four columns into eight rows of an array: the inverse of `load_rows`.

    columns: four vectors of eight lanes. The other arguments are those of `load_rows`.
    """

    def emit(context, builder, signature, values):
        x, y, s, w = (builder.extract_value(values[3], k) for k in range(4))
        first, second = (0, 1, 8, 9, 2, 3, 10, 11), (4, 5, 12, 13, 6, 7, 14, 15)
        low = [_shuffle(builder, x, s, mask) for mask in (first, second)]
        high = [_shuffle(builder, y, w, mask) for mask in (first, second)]
        even, odd = (0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15)
        pair = [_shuffle(builder, low[k], high[k], mask) for k in (0, 1) for mask in (even, odd)]
        halves = [(pair[k + j], half) for k in (0, 2) for half in (range(4), range(4, 8)) for j in (0, 1)]
        for (both, half), pointer in zip(halves, _row_pointers(context, builder, rows, index, values)):
            _store(builder, _shuffle(builder, both, both, half), pointer, rows)
        return context.get_dummy_value()

    return types.void(rows, index, types.int64, columns), emit


@_lanewise(lambda mask: next((bit for bit in range(64) if not int(mask) >> bit & 1), 64))
def lowest_zero(context, mask):
    """Return the number of the lowest bit of `mask` that is 0, or 64 if all bits are 1. mask: uint64."""
    return types.int64(types.uint64), _built(lambda builder, mask: builder.cttz(builder.not_(mask), ir.IntType(1)(0)))


def _emit_spread(context, builder, signature, values):
    undefined = ir.Constant(context.get_value_type(signature.return_type), ir.Undefined)
    first = builder.insert_element(undefined, values[-1], _INT32(0))
    return _shuffle(builder, first, first, [0] * signature.return_type.width)


def _emit_load(context, builder, signature, values):
    array, kind = signature.args[-2], context.get_value_type(signature.return_type)
    return _load(builder, _pointer(context, builder, array, *values[-2:], WIDTH), kind, array)


def _shuffle(builder, one, other, mask):
    return builder.shuffle_vector(one, other, ir.Constant(ir.VectorType(_INT32, len(mask)), list(mask)))


def _pointer(context, builder, array_type, array, i, size):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [builder.mul(i, _INT64(size))])


def _row_pointers(context, builder, rows_type, index_type, values):
    """Return pointers to the eight rows that `load_rows` reads. values: LLVM's values of rows, index and i."""
    first = _pointer(context, builder, index_type, values[1], values[2], WIDTH)
    places = [builder.load(builder.gep(first, [_INT64(k)])) for k in range(WIDTH)]
    return [_pointer(context, builder, rows_type, values[0], builder.zext(place, _INT64), 4) for place in places]


def _load(builder, pointer, kind, array_type):
    loaded = builder.load(builder.bitcast(pointer, kind.as_pointer()))
    # An array of Numba is aligned to the size of one number, not to that of a vector.
    loaded.align = array_type.dtype.bitwidth // 8
    return loaded


def _store(builder, value, pointer, array_type):
    builder.store(value, builder.bitcast(pointer, value.type.as_pointer())).align = array_type.dtype.bitwidth // 8
