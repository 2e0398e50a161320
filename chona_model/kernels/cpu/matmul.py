"""Products of small matrices that stay in the cache: C += A · B, the core of every perceptron here.

A tile of C stays in registers: ``ROWS`` rows by two vectors.  A is read through two strides, so that its transpose
costs nothing; rows of B and C are contiguous.  The loops are written out as LLVM code, in one function that is never
inlined: compiling it into each of its many callers would take minutes.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from chona_model.kernels.cpu.simd import FLOAT, LANES, VECTOR, call_lanes, element, spread

ROWS = 4
"""C's rows must be a multiple of this."""

_NAME = "chona_add_product"
_INDEX, _POINTER = ir.IntType(64), FLOAT.as_pointer()


def _index(value: int) -> ir.Constant:
    return ir.Constant(_INDEX, value)


def _tile(builder: Any, vectors: int, a: Any, b: Any, c: Any, strides: tuple[Any, Any, Any, Any], depth: Any) -> None:
    """C[ROWS × vectors] += A · B, whose first elements the pointers name."""
    a_row, a_depth, b_row, c_row = strides
    places, sums = [], []
    for row in range(ROWS):
        begin = builder.gep(c, [builder.mul(_index(row), c_row)])
        for vector in range(vectors):
            place = builder.bitcast(builder.gep(begin, [_index(vector * LANES)]), VECTOR.as_pointer())
            total = cgutils.alloca_once(builder, VECTOR)
            builder.store(builder.load(place, align=4), total)
            places.append(place)
            sums.append(total)
    with cgutils.for_range(builder, depth) as loop:
        begin = builder.gep(b, [builder.mul(loop.index, b_row)])
        right = [
            builder.load(builder.bitcast(builder.gep(begin, [_index(v * LANES)]), VECTOR.as_pointer()), align=4)
            for v in range(vectors)
        ]
        column = builder.gep(a, [builder.mul(loop.index, a_depth)])
        for row in range(ROWS):
            left = spread(builder, builder.load(builder.gep(column, [builder.mul(_index(row), a_row)]), align=4))
            for vector in range(vectors):
                total = sums[row * vectors + vector]
                builder.store(call_lanes(builder, "fma", [left, right[vector], builder.load(total)]), total)
    for place, total in zip(places, sums, strict=True):
        builder.store(builder.load(total), place, align=4)


def _function(module: Any) -> Any:
    """The function in an LLVM module, written there when first asked for."""
    if _NAME in module.globals:
        return module.globals[_NAME]
    kind = ir.FunctionType(
        ir.VoidType(),
        [_POINTER, _INDEX, _INDEX, _POINTER, _INDEX, _POINTER, _INDEX, _INDEX, _INDEX, _INDEX],
    )
    function = ir.Function(module, kind, _NAME)
    function.linkage = "linkonce_odr"
    function.attributes.add("noinline")
    a, a_row, a_depth, b, b_row, c, c_row, rows, columns, depth = function.args
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    pairs = builder.udiv(columns, _index(2 * LANES))
    strides = (a_row, a_depth, b_row, c_row)
    with cgutils.for_range(builder, builder.udiv(rows, _index(ROWS))) as down:
        row = builder.mul(down.index, _index(ROWS))
        a_tile = builder.gep(a, [builder.mul(row, a_row)])
        c_tile = builder.gep(c, [builder.mul(row, c_row)])
        with cgutils.for_range(builder, pairs) as along:
            shift = builder.mul(along.index, _index(2 * LANES))
            _tile(builder, 2, a_tile, builder.gep(b, [shift]), builder.gep(c_tile, [shift]), strides, depth)
        rest = builder.mul(pairs, _index(2 * LANES))
        with builder.if_then(builder.icmp_unsigned("<", rest, columns)):
            _tile(builder, 1, a_tile, builder.gep(b, [rest]), builder.gep(c_tile, [rest]), strides, depth)
    builder.ret_void()
    return function


@intrinsic
def add_product(
    typingctx: Any, a: Any, a0: Any, a_row: Any, a_depth: Any, b: Any, b0: Any, b_row: Any, c: Any, c0: Any,
    c_row: Any, rows: Any, columns: Any, depth: Any,
) -> Any:  # fmt: skip
    """C += A · B on C-contiguous float32 arrays; nothing is checked.

    Args:
        a, a0: A's array and the index of its first element in it; a_row, a_depth: elements to the next row and column.
        b, b0, b_row: B's array, first element and elements to its next row; c, c0, c_row: C's.
        rows: of A and C, a multiple of ``ROWS``; columns: of B and C, a multiple of 16; depth: columns of A.
    """

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def place(which: int) -> Any:
            return element(context, builder, signature.args[which], arguments[which], arguments[which + 1])

        builder.call(
            _function(builder.module),
            [place(0), *arguments[2:4], place(4), arguments[6], place(7), *arguments[9:]],
        )
        return context.get_dummy_value()

    index = types.intp
    return types.void(a, index, index, index, b, index, index, c, index, index, index, index, index), code
