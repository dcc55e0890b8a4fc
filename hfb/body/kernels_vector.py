"""Compiled parts: 16 of a pose's features at a time."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from hfb.vector_code import address, fma, load, positions, splat

FEATURES = 208  # of a pose: SMPL's 23 x 9 and a zero, a number that 16 divides
BLOCK = 16


@intrinsic
def add_block(typingctx, features, to, directions, at, x, y, z):
    """Add to a block of `features` that of three rows of `directions`, which follow one another, times x, y and z."""
    signature = types.void(features, to, directions, at, x, y, z)

    def codegen(context, builder, signature, arguments):
        to, at = positions(context, builder, signature, arguments, (1, 3))
        pointer, block, align = address(context, builder, signature.args[0], arguments[0], to, BLOCK)
        total = builder.load(pointer)
        total.align = align
        for row, weight in enumerate(arguments[4:7]):
            position = builder.add(at, ir.Constant(at.type, row * FEATURES))
            along = load(context, builder, signature.args[2], arguments[2], position, BLOCK)
            total = fma(builder, splat(builder, weight, block), along, total)
        builder.store(total, pointer).align = align
        return context.get_dummy_value()

    return signature, codegen
