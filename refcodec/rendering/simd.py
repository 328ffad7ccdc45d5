"""Eight float32 lanes as a numba type, for the inner loops of the rasteriser. Most calls are one machine instruction.

A compiler does not always turn a loop over single floats into such instructions, and falls back silently. Here the
width is explicit. Every operation is IEEE 754 binary32 in each lane, and fma rounds once. So the result does not depend
on the machine's own width. The functions can be called only inside numba.njit functions. A value of lanes never reaches
Python. All of it is numba's public interface for extensions (numba.extending) and llvmlite's builder.
"""

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, njit, types
from numba.extending import lower_builtin, models, register_model, type_callable

# A function that it decorates is called with one argument less than it has. Any keeps type checkers from objecting.
intrinsic: Any = extending.intrinsic

# The number of lanes of a value.
WIDTH = 8

_FLOATS = ir.VectorType(ir.FloatType(), WIDTH)
_INTEGERS = ir.VectorType(ir.IntType(32), WIDTH)

# The polynomial of 2^f on [-0.5, 0.5] with the constant term one and the least relative error, 9.1e-8 before rounding.
_C1, _C2, _C3 = np.float32(0.693147), np.float32(0.24022242), np.float32(0.055507336)
_C4, _C5 = np.float32(0.009671513), np.float32(0.0013264727)
# 1.5 * 2^23. Its sum with a float32 of magnitude below 2^22 has the nearest integer in its low bits.
_ROUNDER = np.float32(12582912.0)


class LanesType(types.Type):
    """The numba type of eight float32 lanes."""


class MaskType(types.Type):
    """The numba type of eight booleans."""


LANES, MASK = LanesType("Lanes"), MaskType("Mask")


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _FLOATS)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.VectorType(ir.IntType(1), WIDTH))


def _emitter(emit: Callable[..., Any]) -> Callable[..., Any]:
    """Returns what numba calls to emit an operation. emit: receives LLVM's builder and the operands."""
    return lambda _context, builder, _signature, operands: emit(builder, *operands)


def _integers(value: int | list[int]) -> ir.Constant:
    return ir.Constant(_INTEGERS, value if isinstance(value, list) else [value] * WIDTH)


# --- memory -----------------------------------------------------------------------------------------------------------


def _address(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
    """Returns a pointer to eight floats at an index of a contiguous float32 array. No bounds are checked."""
    array = context.make_array(signature.args[0])(context, builder, operands[0])
    return builder.bitcast(builder.gep(array.data, [operands[1]]), _FLOATS.as_pointer())


@intrinsic
def load(_: Any, array: Any, index: Any) -> Any:
    """Returns array[index : index + 8] of a contiguous float32 array.

    The index counts over the flat array. It is not checked.
    """

    def emit(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        return builder.load(_address(context, builder, signature, operands), align=4)

    return LANES(array, types.intp), emit


@intrinsic
def store(_: Any, array: Any, index: Any, value: Any) -> Any:
    """Sets array[index : index + 8] to the lanes of a value, with the index of `load`."""

    def emit(context: Any, builder: Any, signature: Any, operands: Any) -> Any:
        builder.store(operands[2], _address(context, builder, signature, operands), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, LANES), emit


@intrinsic
def splat(_: Any, scalar: Any) -> Any:
    """Returns eight copies of a float32."""

    def emit(builder: Any, scalar: Any) -> Any:
        one = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(one, one, _integers(0))

    return LANES(types.float32), _emitter(emit)


@intrinsic
def count_up(_: Any) -> Any:
    """Returns the lanes 0, 1, ..., 7."""
    return LANES(), _emitter(lambda _builder: ir.Constant(_FLOATS, [float(i) for i in range(WIDTH)]))


# --- arithmetic -------------------------------------------------------------------------------------------------------


def _call(builder: Any, name: str, *operands: Any) -> Any:
    """Emits a call of LLVM's function of this name for vectors of eight floats."""
    module, name = builder.module, f"llvm.{name}.v{WIDTH}f32"
    known = module.globals.get(name)
    kind = ir.FunctionType(_FLOATS, [_FLOATS] * len(operands))
    return builder.call(known or ir.Function(module, kind, name), operands)


@intrinsic
def square_root(_: Any, value: Any) -> Any:
    """Returns the square root of each lane, correctly rounded. It is NaN below 0."""
    return LANES(LANES), _emitter(lambda builder, x: _call(builder, "sqrt", x))


@intrinsic
def round_down(_: Any, value: Any) -> Any:
    """Returns the greatest integer that is not above each lane."""
    return LANES(LANES), _emitter(lambda builder, x: _call(builder, "floor", x))


@intrinsic
def round_up(_: Any, value: Any) -> Any:
    """Returns the least integer that is not below each lane."""
    return LANES(LANES), _emitter(lambda builder, x: _call(builder, "ceil", x))


@intrinsic
def fma(_: Any, x: Any, y: Any, z: Any) -> Any:
    """Returns x * y + z, rounded once."""
    return LANES(LANES, LANES, LANES), _emitter(lambda builder, x, y, z: _call(builder, "fma", x, y, z))


@intrinsic
def fnma(_: Any, x: Any, y: Any, z: Any) -> Any:
    """Returns z - x * y, rounded once."""
    return LANES(LANES, LANES, LANES), _emitter(lambda builder, x, y, z: _call(builder, "fma", builder.fneg(x), y, z))


@intrinsic
def select(_: Any, mask: Any, x: Any, y: Any) -> Any:
    """Returns the lanes of x where the mask is set, and those of y elsewhere."""
    return LANES(MASK, LANES, LANES), _emitter(lambda builder, *operands: builder.select(*operands))


@intrinsic
def _times_power(_: Any, value: Any, rounded: Any) -> Any:
    """Returns value * 2^n, for `rounded` = n + _ROUNDER. Overflow is not checked."""

    def emit(builder: Any, *operands: Any) -> Any:
        bits, power = (builder.bitcast(operand, _INTEGERS) for operand in operands)
        return builder.bitcast(builder.add(bits, builder.shl(power, _integers(23))), _FLOATS)

    return LANES(LANES, LANES), _emitter(emit)


# --- across lanes -----------------------------------------------------------------------------------------------------


@intrinsic
def bits(_: Any, mask: Any) -> Any:
    """Returns the mask as a uint64, with lane 0 in the lowest bit."""

    def emit(builder: Any, mask: Any) -> Any:
        return builder.zext(builder.bitcast(mask, ir.IntType(WIDTH)), ir.IntType(64))

    return types.uint64(MASK), _emitter(emit)


@intrinsic
def runs(_: Any, first: Any, end: Any) -> Any:
    """Returns a uint64 in whose byte j the bits first[j], ..., end[j] - 1 are set.

    The lanes have to be integers with 0 <= first <= end <= 8.
    """

    def emit(builder: Any, *operands: Any) -> Any:
        low, high = (builder.shl(_integers(1), builder.fptosi(a, _INTEGERS)) for a in operands)
        octets = builder.trunc(builder.sub(high, low), ir.VectorType(ir.IntType(8), WIDTH))
        return builder.bitcast(octets, ir.IntType(64))

    return types.uint64(LANES, LANES), _emitter(emit)


@intrinsic
def lowest(_: Any, value: Any) -> Any:
    """Returns the number of the lowest set bit of a uint64 that is not 0."""
    return types.intp(types.uint64), _emitter(lambda builder, x: builder.cttz(x, ir.Constant(ir.IntType(1), 1)))


@intrinsic
def total(_: Any, value: Any) -> Any:
    """Returns the sum of the lanes, added as a balanced tree."""

    def emit(builder: Any, value: Any) -> Any:
        half = WIDTH // 2
        while half:
            picks = _integers([(i + half) % WIDTH for i in range(WIDTH)])
            value = builder.fadd(value, builder.shuffle_vector(value, value, picks))
            half //= 2
        return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))

    return types.float32(LANES), _emitter(emit)


@intrinsic
def column_sums(_: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any) -> Any:
    """Returns the sums of the lanes of a, of b, ..., of h, each added as a balanced tree."""

    def emit(builder: Any, *operands: Any) -> Any:
        rows, size = list(operands), WIDTH
        # A round adds the two halves of each row's part. A vector then holds shorter parts of twice as many rows, in
        # order.
        while len(rows) > 1:
            half = size // 2
            low = [i for i in range(2 * WIDTH) if i % size < half]
            picks = [_integers(low), _integers([i + half for i in low])]
            rows = [
                builder.fadd(*(builder.shuffle_vector(x, y, p) for p in picks))
                for x, y in zip(rows[0::2], rows[1::2], strict=True)
            ]
            size = half
        return rows[0]

    return LANES(*[LANES] * WIDTH), _emitter(emit)


# --- operators --------------------------------------------------------------------------------------------------------


def _operator(function: Any, kind: types.Type, result: types.Type, emit: Callable[[Any, Any, Any], Any]) -> None:
    """Defines a Python operator for two values of the type `kind`."""
    type_callable(function)(lambda _context: lambda x, y: result if x == y == kind else None)
    lower_builtin(function, kind, kind)(_emitter(emit))


_operator(operator.add, LANES, LANES, lambda builder, x, y: builder.fadd(x, y))
_operator(operator.sub, LANES, LANES, lambda builder, x, y: builder.fsub(x, y))
_operator(operator.mul, LANES, LANES, lambda builder, x, y: builder.fmul(x, y))
_operator(operator.truediv, LANES, LANES, lambda builder, x, y: builder.fdiv(x, y))
_operator(operator.ge, LANES, MASK, lambda builder, x, y: builder.fcmp_ordered(">=", x, y))
_operator(operator.le, LANES, MASK, lambda builder, x, y: builder.fcmp_ordered("<=", x, y))
_operator(operator.lt, LANES, MASK, lambda builder, x, y: builder.fcmp_ordered("<", x, y))
_operator(operator.and_, MASK, MASK, lambda builder, x, y: builder.and_(x, y))


@njit(inline="always")
def minimum(x: Any, y: Any) -> Any:
    """Returns the smaller of x and y in each lane, and y where x is NaN."""
    return select(x < y, x, y)


@njit(inline="always")
def maximum(x: Any, y: Any) -> Any:
    """Returns the larger of x and y in each lane, and y where x is NaN."""
    return select(y < x, x, y)


@njit(inline="always")
def exp2(x: Any) -> Any:
    """Returns 2^x for x in [-126, 127], with a relative error of at most 1.7e-7. It is undefined elsewhere."""
    rounded = x + splat(_ROUNDER)
    f = x - (rounded - splat(_ROUNDER))
    p = fma(f, splat(_C5), splat(_C4))
    p = fma(f, p, splat(_C3))
    p = fma(f, p, splat(_C2))
    p = fma(f, p, splat(_C1))
    p = fma(f, p, splat(np.float32(1)))
    return _times_power(p, rounded)
