"""Sixteen floats as one value inside numba functions: one AVX-512 register, two of AVX2, four of NEON.

LLVM does not vectorise the loops that matter here by itself (short, with many accumulators); with a vector type they
are written as they should run.  +, −, · and / work through operators.

Offsets count floats from the beginning of a C-contiguous array and are not checked.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.extending import intrinsic, overload, register_model

LANES = 16

FLOAT, _INT = ir.FloatType(), ir.IntType(32)
VECTOR, _INTS = ir.VectorType(FLOAT, LANES), ir.VectorType(_INT, LANES)


class Float32x16(types.Type):
    """numba's type of sixteen floats."""

    def __init__(self) -> None:
        super().__init__(name="Float32x16")


float32x16 = Float32x16()


@register_model(Float32x16)
class _Float32x16Model(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, VECTOR)


def element(context: Any, builder: Any, kind: Any, array: Any, offset: Any) -> Any:
    """LLVM pointer to a float of an array."""
    return builder.gep(context.make_array(kind)(context, builder, array).data, [offset])


def _address(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return builder.bitcast(element(context, builder, signature.args[0], *arguments[:2]), VECTOR.as_pointer())


def _constant(value: float) -> ir.Constant:
    return ir.Constant(VECTOR, [value] * LANES)


def spread(builder: Any, scalar: Any) -> Any:
    """LLVM code for one float in all lanes."""
    undefined = ir.Constant(VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(_INT, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(_INTS, [0] * LANES))


def call_lanes(builder: Any, name: str, arguments: Any) -> Any:
    """LLVM code for one of its functions on vectors."""
    kind = ir.FunctionType(VECTOR, [VECTOR] * len(arguments))
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v16f32"), arguments)


@intrinsic
def load(typingctx: Any, array: Any, offset: Any) -> Any:
    """Sixteen floats of ``array`` from ``offset``; no alignment needed."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_address(context, builder, signature, arguments), align=4)

    return float32x16(array, types.intp), code


@intrinsic
def store(typingctx: Any, array: Any, offset: Any, value: Any) -> Any:
    """Writes sixteen floats to ``array`` from ``offset``."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _address(context, builder, signature, arguments), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, float32x16), code


@intrinsic
def splat(typingctx: Any, scalar: Any) -> Any:
    """One float in all lanes."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return spread(builder, arguments[0])

    return float32x16(types.float32), code


@intrinsic
def splat_at(typingctx: Any, array: Any, offset: Any) -> Any:
    """One float of ``array`` in all lanes."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return spread(builder, builder.load(element(context, builder, signature.args[0], *arguments), align=4))

    return float32x16(array, types.intp), code


@intrinsic
def fma(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
    """a · b + c, rounded once."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_lanes(builder, "fma", arguments)

    return float32x16(float32x16, float32x16, float32x16), code


@intrinsic
def maximum(typingctx: Any, a: Any, b: Any) -> Any:
    """The greater of each lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_lanes(builder, "maxnum", arguments)

    return float32x16(float32x16, float32x16), code


@intrinsic
def minimum(typingctx: Any, a: Any, b: Any) -> Any:
    """The smaller of each lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_lanes(builder, "minnum", arguments)

    return float32x16(float32x16, float32x16), code


@intrinsic
def where_positive(typingctx: Any, condition: Any, value: Any) -> Any:
    """``value`` in lanes whose ``condition`` is above 0, else 0."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        positive = builder.fcmp_ordered(">", arguments[0], _constant(0.0))
        return builder.select(positive, arguments[1], _constant(0.0))

    return float32x16(float32x16, float32x16), code


@intrinsic
def _round(typingctx: Any, value: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_lanes(builder, "rint", arguments)

    return float32x16(float32x16), code


@intrinsic
def _power_of_two(typingctx: Any, exponent: Any) -> Any:
    """2 to whole exponents in −126…127."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        whole = builder.fptosi(arguments[0], _INTS)
        biased = builder.add(whole, ir.Constant(_INTS, [127] * LANES))
        return builder.bitcast(builder.shl(biased, ir.Constant(_INTS, [23] * LANES)), VECTOR)

    return float32x16(float32x16), code


def _arithmetic(operation: Callable[..., Any], instruction: str) -> None:
    @intrinsic
    def lanes(typingctx: Any, a: Any, b: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, instruction)(*arguments)

        return float32x16(float32x16, float32x16), code

    @overload(operation)
    def choose(a, b):
        if isinstance(a, Float32x16) and isinstance(b, Float32x16):
            return lambda a, b: lanes(a, b)  # noqa: PLW0108 - numba compiles the function it gets
        return None


for _operation, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _arithmetic(_operation, _instruction)


@njit
def exp(x):
    """eˣ within 2 units in the last place; arguments beyond ±87 are taken as ±87."""
    x = minimum(maximum(x, splat(np.float32(-87.0))), splat(np.float32(87.0)))
    whole = _round(x * splat(np.float32(1.44269504)))
    rest = fma(whole, splat(np.float32(-0.693359375)), x)  # ln 2 in two parts, the first exact
    rest = fma(whole, splat(np.float32(2.12194440e-4)), rest)
    series = splat(np.float32(1.0 / 5040.0))
    series = fma(series, rest, splat(np.float32(1.0 / 720.0)))
    series = fma(series, rest, splat(np.float32(1.0 / 120.0)))
    series = fma(series, rest, splat(np.float32(1.0 / 24.0)))
    series = fma(series, rest, splat(np.float32(1.0 / 6.0)))
    series = fma(series, rest, splat(np.float32(0.5)))
    series = fma(series, rest, splat(np.float32(1.0)))
    series = fma(series, rest, splat(np.float32(1.0)))
    return series * _power_of_two(whole)


@njit
def sigmoid(x):
    """1 / (1 + e⁻ˣ)."""
    one = splat(np.float32(1.0))
    return one / (one + exp(splat(np.float32(0.0)) - x))


@njit
def softplus(x):
    """ln(1 + eˣ), without overflow; by 2 artanh(u / (2 + u)) for the small part u = e^−|x|."""
    zero, two = splat(np.float32(0.0)), splat(np.float32(2.0))
    u = exp(zero - maximum(x, zero - x))
    t = u / (two + u)
    square = t * t
    series = splat(np.float32(1.0 / 13.0))
    series = fma(series, square, splat(np.float32(1.0 / 11.0)))
    series = fma(series, square, splat(np.float32(1.0 / 9.0)))
    series = fma(series, square, splat(np.float32(1.0 / 7.0)))
    series = fma(series, square, splat(np.float32(1.0 / 5.0)))
    series = fma(series, square, splat(np.float32(1.0 / 3.0)))
    series = fma(series, square, splat(np.float32(1.0)))
    return fma(two * t, series, maximum(x, zero))
