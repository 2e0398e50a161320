"""Sixteen (or four) floats as one value inside numba functions: one AVX-512 register, two of AVX2, four of NEON.

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
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.extending import intrinsic, overload, register_model

from chona_model.kernels.cpu.jit import inlined

LANES = 16
"""Lanes of the wide vector."""

FLOAT, _INT = ir.FloatType(), ir.IntType(32)
VECTOR = ir.VectorType(FLOAT, LANES)


class FloatVector(types.Type):
    """numba's type of a few floats."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Float32x{lanes}")


wide, short = FloatVector(LANES), FloatVector(4)


@register_model(FloatVector)
class _FloatVectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, ir.VectorType(FLOAT, fe_type.lanes))


def element(context: Any, builder: Any, kind: Any, array: Any, offset: Any) -> Any:
    """LLVM pointer to a float of an array."""
    return builder.gep(context.make_array(kind)(context, builder, array).data, [offset])


def _constant(kind: Any, value: Any) -> ir.Constant:
    return ir.Constant(kind, [value] * kind.count)


def spread(builder: Any, scalar: Any, lanes: int = LANES) -> Any:
    """LLVM code for one float in all lanes."""
    undefined = ir.Constant(ir.VectorType(FLOAT, lanes), ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(_INT, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(_INT, lanes), [0] * lanes))


def call_lanes(builder: Any, name: str, arguments: Any) -> Any:
    """LLVM code for one of its functions on vectors."""
    vector = arguments[0].type
    kind = ir.FunctionType(vector, [vector] * len(arguments))
    name = f"llvm.{name}.v{vector.count}f32"
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), arguments)


def _loader(vector: FloatVector, once: bool) -> Any:
    """An intrinsic that reads a vector, or (``once``) one float into all lanes."""

    @intrinsic
    def read(typingctx: Any, array: Any, offset: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            place = element(context, builder, signature.args[0], *arguments)
            if once:
                return spread(builder, builder.load(place, align=4), vector.lanes)
            return builder.load(builder.bitcast(place, ir.VectorType(FLOAT, vector.lanes).as_pointer()), align=4)

        return vector(array, types.intp), code

    return read


load, load4 = _loader(wide, once=False), _loader(short, once=False)
"""Sixteen or four floats of an array from an offset; no alignment needed."""

splat_at = _loader(wide, once=True)
"""One float of an array in sixteen lanes."""


@intrinsic
def store(typingctx: Any, array: Any, offset: Any, value: Any) -> Any:
    """Writes a vector to ``array`` from ``offset``."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = element(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], builder.bitcast(place, arguments[2].type.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), code


def _splatter(vector: FloatVector) -> Any:
    @intrinsic
    def fill(typingctx: Any, scalar: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return spread(builder, arguments[0], vector.lanes)

        return vector(types.float32), code

    return fill


splat, splat4 = _splatter(wide), _splatter(short)
"""One float in sixteen or four lanes."""


@intrinsic
def fma(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
    """a · b + c, rounded once."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_lanes(builder, "fma", arguments)

    return a(a, a, a), code


@intrinsic
def maximum(typingctx: Any, a: Any, b: Any) -> Any:
    """The greater of each lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_lanes(builder, "maxnum", arguments)

    return a(a, a), code


@intrinsic
def minimum(typingctx: Any, a: Any, b: Any) -> Any:
    """The smaller of each lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_lanes(builder, "minnum", arguments)

    return a(a, a), code


@intrinsic
def where_positive(typingctx: Any, condition: Any, value: Any) -> Any:
    """``value`` in lanes whose ``condition`` is above 0, else 0."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        positive = builder.fcmp_ordered(">", arguments[0], _constant(VECTOR, 0.0))
        return builder.select(positive, arguments[1], _constant(VECTOR, 0.0))

    return wide(wide, wide), code


@intrinsic
def _round(typingctx: Any, value: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_lanes(builder, "rint", arguments)

    return wide(wide), code


@intrinsic
def _power_of_two(typingctx: Any, exponent: Any) -> Any:
    """2 to whole exponents in −126…127."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        integers = ir.VectorType(_INT, LANES)
        whole = builder.fptosi(arguments[0], integers)
        biased = builder.add(whole, _constant(integers, 127))
        return builder.bitcast(builder.shl(biased, _constant(integers, 23)), VECTOR)

    return wide(wide), code


def _arithmetic(operation: Callable[..., Any], instruction: str) -> None:
    @intrinsic
    def lanes(typingctx: Any, a: Any, b: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, instruction)(*arguments)

        return a(a, a), code

    @overload(operation)
    def choose(a, b):
        if isinstance(a, FloatVector) and isinstance(b, FloatVector):
            return lambda a, b: lanes(a, b)  # noqa: PLW0108 - numba compiles the function it gets
        return None


for _operation, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _arithmetic(_operation, _instruction)


@inlined
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


@inlined
def sigmoid(x):
    """1 / (1 + e⁻ˣ)."""
    one = splat(np.float32(1.0))
    return one / (one + exp(splat(np.float32(0.0)) - x))


@inlined
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
