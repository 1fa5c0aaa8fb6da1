"""Single instructions that Python cannot express, written in LLVM's terms.

Imported only where loops are compiled; it needs numba.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

import platform

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

# Bits of an exponent's bias, of the mantissa, and the type of an integer as wide as the number.
_LAYOUT = {
    types.float64: (1023, 52, ir.IntType(64)),
    types.float32: (127, 23, ir.IntType(32)),
}


@intrinsic
def muladd(context, a, b, c):
    """a b + c, rounded once.

    `llvm.fma` and not `llvm.fmuladd`, which the compiler may fuse in one place and not in another:
    the rest of a loop would then differ from its vectors in the last bit.
    """
    real = types.float32 if {a, b, c} == {types.float32} else types.float64

    def build(_, builder, signature, arguments):
        kind = arguments[0].type
        function = builder.module.declare_intrinsic(
            "llvm.fma", [kind], ir.FunctionType(kind, [kind] * 3)
        )
        return builder.call(function, arguments)

    return real(real, real, real), build


@intrinsic
def pow2(context, n):
    """2 to the power of a whole number n, by way of the bits of an exponent."""
    real = types.float32 if n == types.float32 else types.float64
    bias, mantissa, whole = _LAYOUT[real]

    def build(_, builder, signature, arguments):
        # n + 1.5 2^mantissa holds n in its lowest bits; all others are shifted out.
        (number,) = arguments
        rounder = ir.Constant(number.type, 1.5 * 2.0**mantissa)
        bits = builder.bitcast(builder.fadd(number, rounder), whole)
        exponent = builder.add(bits, ir.Constant(whole, bias))
        shifted = builder.shl(exponent, ir.Constant(whole, mantissa))
        return builder.bitcast(shifted, number.type)

    return real(real), build


@intrinsic
def align_stack(context):
    """Align the stack of the calling function to a multiple of 64 bytes.

    Loops with many constants keep some of them on the stack. Where these cross a cache line, which
    chance decides for each process, AVX-512 loses up to 40 per cent.
    """

    def build(context, builder, signature, arguments):
        if platform.machine() in ("x86_64", "AMD64"):
            attributes = builder.function.attributes
            # llvmlite writes no attributes unless there is a named one; nothing unwinds here.
            attributes.add("nounwind")
            attributes.alignstack = 64
        return context.get_dummy_value()

    return types.none(), build
