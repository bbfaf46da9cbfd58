# mypy: disallow-untyped-defs=False
"""Vectors of eight float32 for Numba: the layers of one pixel, moved and computed as one value.

LLVM turns plain loops into vector code only where it can prove it safe; a recursion along a row whose lanes are
layers is not such a loop. Here the vector is a type of its own and every function is one or two LLVM instructions.
Nothing names a processor: on narrower machines LLVM splits the vectors, without fused multiply-add it multiplies and
adds.

Indices count elements from the start of a contiguous array and are not checked.
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

from chromaperture.matching.integer_light import LOGARITHM

LANES = 8

_FLOAT = ir.FloatType()
_I32 = ir.IntType(32)
_FLOATS = ir.VectorType(_FLOAT, LANES)
_INTS = ir.VectorType(_I32, LANES)
_SHORTS = ir.VectorType(ir.IntType(16), LANES)
# Chebyshev interpolation of 2^t, |t| <= 1/2, highest power first; good to 2e-7.
_POWER = (
    np.polynomial.chebyshev.Chebyshev.interpolate(np.exp2, 5, domain=[-0.5, 0.5])
    .convert(kind=np.polynomial.Polynomial)
    .coef[::-1]
    .tolist()
)
_LEAST_EXPONENT = -126.0  # of a normal float
_ROUNDER = 1.5 * 2**23  # added to a small float it leaves the rounded integer in the low bits


class Float8(types.Type):
    """Eight float32 in one register."""

    def __init__(self) -> None:
        super().__init__(name="Float8")


float8 = Float8()


@register_model(Float8)
class _Float8Model(models.PrimitiveModel):
    def __init__(self, manager, numba_type):
        super().__init__(manager, numba_type, _FLOATS)


def _constant(value: float) -> ir.Constant:
    return ir.Constant(_FLOATS, [value] * LANES)


def _shuffle(builder, a, b, lanes):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_I32, len(lanes)), lanes))


def _broadcast(builder, scalar):
    first = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), scalar, ir.Constant(_I32, 0))
    return _shuffle(builder, first, first, [0] * LANES)


def _pointer(context, builder, array_type, array, index, element=None):
    """Address of an element, as a pointer to ``element`` (a vector) or to the array's own type."""
    data = context.make_array(array_type)(context, builder, array).data
    pointer = builder.gep(data, [index])
    return pointer if element is None else builder.bitcast(pointer, element.as_pointer())


def _operation(count, emit):
    """Make a function of ``count`` vectors to a vector, whose code ``emit(builder, *vectors)`` writes."""

    def lowered(context, builder, signature, arguments):
        return emit(builder, *arguments)

    if count == 1:
        return intrinsic(lambda typing, a: (float8(float8), lowered))
    if count == 2:
        return intrinsic(lambda typing, a, b: (float8(float8, float8), lowered))
    return intrinsic(lambda typing, a, b, c: (float8(float8, float8, float8), lowered))


def _multiply_add(builder, a, b, c):
    fused = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(_FLOATS, [_FLOATS] * 3), f"llvm.fmuladd.v{LANES}f32"
    )
    return builder.call(fused, [a, b, c])


def _smaller(builder, a, b):
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


def _larger(builder, a, b):
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _tagged(builder, value, keep, tag):
    bits = builder.and_(builder.bitcast(value, _INTS), builder.bitcast(keep, _INTS))
    return builder.bitcast(builder.or_(bits, builder.bitcast(tag, _INTS)), _FLOATS)


def _halves_larger(builder, a, b):
    low = _shuffle(builder, a, b, [0, 1, 2, 3, 8, 9, 10, 11])
    high = _shuffle(builder, a, b, [4, 5, 6, 7, 12, 13, 14, 15])
    return _larger(builder, low, high)


def _quarters_larger(builder, a, b):
    low = _shuffle(builder, a, b, [0, 1, 4, 5, 8, 9, 12, 13])
    high = _shuffle(builder, a, b, [2, 3, 6, 7, 10, 11, 14, 15])
    return _larger(builder, low, high)


def _eighths_larger(builder, a, b):
    low = _shuffle(builder, a, b, [0, 2, 4, 6, 8, 10, 12, 14])
    high = _shuffle(builder, a, b, [1, 3, 5, 7, 9, 11, 13, 15])
    return _larger(builder, low, high)


def _root_function(builder):
    return cgutils.get_or_insert_function(builder.module, ir.FunctionType(_FLOATS, [_FLOATS]), f"llvm.sqrt.v{LANES}f32")


def _inverse_root(builder, a):
    root = _root_function(builder)
    # "fast": an estimate and a Newton step, good to a few 1e-7, where the processor has one.
    return builder.fdiv(_constant(1.0), builder.call(root, [a], fastmath=("fast",)), flags=("fast",))


def _over_lanes(join):
    """Join all lanes with each other, the result in each of them."""

    def emit(builder, a):
        for lanes in ([4, 5, 6, 7, 0, 1, 2, 3], [2, 3, 0, 1, 6, 7, 4, 5], [1, 0, 3, 2, 5, 4, 7, 6]):
            a = join(builder, a, _shuffle(builder, a, a, lanes))
        return a

    return emit


def _logarithm(builder, a):
    """Natural logarithm of normal positive floats: the exponent, and a polynomial for the mantissa in [1, 2)."""
    bits = builder.bitcast(a, _INTS)
    whole = [ir.Constant(_INTS, [value] * LANES) for value in (23, 127, 0x7FFFFF, 0x3F800000)]
    exponent = builder.sitofp(builder.sub(builder.lshr(bits, whole[0]), whole[1]), _FLOATS)
    mantissa = builder.bitcast(builder.or_(builder.and_(bits, whole[2]), whole[3]), _FLOATS)
    t = builder.fsub(mantissa, _constant(1.5))
    value = _constant(LOGARITHM[0])
    for coefficient in LOGARITHM[1:]:
        value = _multiply_add(builder, value, t, _constant(coefficient))
    return _multiply_add(builder, exponent, _constant(math.log(2)), value)


def _exponential(builder, a):
    """E to the power of floats of at most 0; what is below the least normal float becomes it."""
    power = _larger(builder, builder.fmul(a, _constant(1 / math.log(2))), _constant(_LEAST_EXPONENT))
    # Not by adding a large number: kernels that may reassociate would take it off again.
    rint = cgutils.get_or_insert_function(builder.module, ir.FunctionType(_FLOATS, [_FLOATS]), f"llvm.rint.v{LANES}f32")
    whole = builder.call(rint, [power])
    t = builder.fsub(power, whole)
    value = _constant(_POWER[0])
    for coefficient in _POWER[1:]:
        value = _multiply_add(builder, value, t, _constant(coefficient))
    exponent = builder.shl(builder.fptosi(whole, _INTS), ir.Constant(_INTS, [23] * LANES))
    return builder.bitcast(builder.add(builder.bitcast(value, _INTS), exponent), _FLOATS)


def _interleaved(lanes):
    return _operation(2, lambda builder, a, b: _shuffle(builder, a, b, lanes))


add = _operation(2, lambda builder, a, b: builder.fadd(a, b))
sub = _operation(2, lambda builder, a, b: builder.fsub(a, b))
mul = _operation(2, lambda builder, a, b: builder.fmul(a, b))
fma = _operation(3, _multiply_add)  # a b + c
fnma = _operation(3, lambda builder, a, b, c: _multiply_add(builder, builder.fsub(_constant(-0.0), a), b, c))  # c - a b
div = _operation(2, lambda builder, a, b: builder.fdiv(a, b))
root = _operation(1, lambda builder, a: builder.call(_root_function(builder), [a]))
inverse_root = _operation(1, _inverse_root)
swapped = _operation(1, lambda builder, a: _shuffle(builder, a, a, [4, 5, 6, 7, 0, 1, 2, 3]))  # halves exchanged
least_lane = _operation(1, _over_lanes(_smaller))  # to all lanes
sum_lanes = _operation(1, _over_lanes(lambda builder, a, b: builder.fadd(a, b)))  # to all lanes
logarithm = _operation(1, _logarithm)
exponential = _operation(1, _exponential)  # of numbers of at most 0
smaller = _operation(2, _smaller)
larger = _operation(2, _larger)
tagged = _operation(3, _tagged)  # (value's bits & keep) | tag
# The largest lane of four vectors at once: two calls of the first, one of the second, one of the third with itself.
halves_larger = _operation(2, _halves_larger)
quarters_larger = _operation(2, _quarters_larger)
eighths_larger = _operation(2, _eighths_larger)
# Steps of a transposition of 8 x 8: neighbours in pairs, pairs of pairs, halves.
singles_low = _interleaved([0, 8, 1, 9, 4, 12, 5, 13])
singles_high = _interleaved([2, 10, 3, 11, 6, 14, 7, 15])
pairs_low = _interleaved([0, 1, 8, 9, 4, 5, 12, 13])
pairs_high = _interleaved([2, 3, 10, 11, 6, 7, 14, 15])
halves_low = _interleaved([0, 1, 2, 3, 8, 9, 10, 11])
halves_high = _interleaved([4, 5, 6, 7, 12, 13, 14, 15])
# Two vectors shuffled like cards: what comes first, and the rest.
shuffled_low = _interleaved([0, 8, 1, 9, 2, 10, 3, 11])
shuffled_high = _interleaved([4, 12, 5, 13, 6, 14, 7, 15])


@intrinsic
def load(typing, array, index):
    """Eight neighbours from ``array[index]`` on."""

    def lowered(context, builder, signature, arguments):
        pointer = _pointer(context, builder, signature.args[0], *arguments, _FLOATS)
        return builder.load(pointer, align=4)

    return float8(array, types.int64), lowered


@intrinsic
def store(typing, array, index, value):
    """Put eight neighbours to ``array[index]`` and on."""

    def lowered(context, builder, signature, arguments):
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2], _FLOATS)
        builder.store(arguments[2], pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.int64, float8), lowered


@intrinsic
def load_shorts(typing, array, index):
    """Eight int16 as float32."""

    def lowered(context, builder, signature, arguments):
        pointer = _pointer(context, builder, signature.args[0], *arguments, _SHORTS)
        return builder.sitofp(builder.load(pointer, align=2), _FLOATS)

    return float8(array, types.int64), lowered


@intrinsic
def store_kept(typing, array, index, value):
    """Put eight float32 past the caches: they are not read again soon; rounded where the array is of int16.

    What is rounded must be less than 2^15. The address must be a multiple of a vector's bytes. Call `fence` before
    another thread may read them.
    """
    rounded = array.dtype == types.int16

    def lowered(context, builder, signature, arguments):
        kept = arguments[2]
        if rounded:
            bits = builder.bitcast(builder.fadd(kept, _constant(_ROUNDER)), _INTS)
            kept = builder.trunc(bits, _SHORTS)
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2], kept.type)
        stored = builder.store(kept, pointer, align=16 if rounded else 32)
        stored.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(_I32, 1)]))
        return context.get_dummy_value()

    return types.void(array, types.int64, float8), lowered


@intrinsic
def put_shorts(typing, array, index, value):
    """Round eight float32 of less than 2^15 to int16, as `store_kept`, to be read again soon."""

    def lowered(context, builder, signature, arguments):
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2], _SHORTS)
        bits = builder.bitcast(builder.fadd(arguments[2], _constant(_ROUNDER)), _INTS)
        builder.store(builder.trunc(bits, _SHORTS), pointer, align=2)
        return context.get_dummy_value()

    return types.void(array, types.int64, float8), lowered


@intrinsic
def fence(typing):
    """Finish all stores before anything that follows."""

    def lowered(context, builder, signature, arguments):
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), lowered


@intrinsic
def broadcast(typing, value):
    """Copy a float32 to all lanes."""

    def lowered(context, builder, signature, arguments):
        return _broadcast(builder, arguments[0])

    return float8(types.float32), lowered


@intrinsic
def broadcast_at(typing, array, index):
    """Copy ``array[index]`` to all lanes."""

    def lowered(context, builder, signature, arguments):
        return _broadcast(builder, builder.load(_pointer(context, builder, signature.args[0], *arguments)))

    return float8(array, types.int64), lowered


@intrinsic
def lane(typing, value, index):
    """One lane as float32."""

    def lowered(context, builder, signature, arguments):
        return builder.extract_element(arguments[0], builder.trunc(arguments[1], _I32))

    return types.float32(float8, types.int64), lowered


@intrinsic
def get(typing, array, index):
    """Return ``array[index]``, without the test for a negative index."""

    def lowered(context, builder, signature, arguments):
        return builder.load(_pointer(context, builder, signature.args[0], *arguments))

    return array.dtype(array, types.int64), lowered


@intrinsic
def put(typing, array, index, value):
    """``array[index] = value``, without the test for a negative index."""

    def lowered(context, builder, signature, arguments):
        builder.store(arguments[2], _pointer(context, builder, signature.args[0], *arguments[:2]))
        return context.get_dummy_value()

    return types.void(array, types.int64, types.float32), lowered


@intrinsic
def put_lane(typing, array, index, value, lane):
    """Put one lane to ``array[index]``."""

    def lowered(context, builder, signature, arguments):
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store(builder.extract_element(arguments[2], builder.trunc(arguments[3], _I32)), pointer)
        return context.get_dummy_value()

    return types.void(array, types.int64, float8, types.int64), lowered


@intrinsic
def four_and_squares(typing, array, i0, i1, i2, i3):
    """Four elements of an array in lanes 0 to 3, their squares in lanes 4 to 7."""

    def lowered(context, builder, signature, arguments):
        four = ir.Constant(ir.VectorType(_FLOAT, 4), ir.Undefined)
        for i, index in enumerate(arguments[1:]):
            element = builder.load(_pointer(context, builder, signature.args[0], arguments[0], index))
            four = builder.insert_element(four, element, ir.Constant(_I32, i))
        return _shuffle(builder, four, builder.fmul(four, four), list(range(8)))

    return float8(array, types.int64, types.int64, types.int64, types.int64), lowered


@intrinsic
def prefetch(typing, array, index):
    """Prefetch the cache line of ``array[index]``; a hint, never an error."""

    def lowered(context, builder, signature, arguments):
        pointer = builder.bitcast(_pointer(context, builder, signature.args[0], *arguments), ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(8).as_pointer()] + [_I32] * 3)
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [pointer, *(ir.Constant(_I32, v) for v in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, types.int64), lowered
