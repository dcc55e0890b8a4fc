"""Compiled parts: 16 of a pose's features at a time."""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from hfb.vector_code import LANES, address, fma, load, positions, splat

FEATURES = 208  # of a pose: SMPL's 23 x 9 and a zero, a number that 16 divides
BLOCK = 16


@intrinsic
def add_block(typingctx, features, to, directions, at, asked):
    """Add to a block of the `features` (LANES, FEATURES) of every lane that of three rows of `directions`, which follow
    one another, times what the lane asks of them: `asked` (3 x LANES)."""
    signature = types.void(features, to, directions, at, asked)

    def codegen(context, builder, signature, arguments):
        to, at = positions(context, builder, signature, arguments, (1, 3))

        def ahead(position, count):
            return builder.add(position, ir.Constant(position.type, count))

        _, block, _ = address(context, builder, signature.args[0], arguments[0], to, BLOCK)
        rows = [
            load(context, builder, signature.args[2], arguments[2], ahead(at, row * FEATURES), BLOCK)
            for row in range(3)
        ]
        if isinstance(signature.args[2].dtype, types.Integer):
            rows = [builder.sitofp(row, block) for row in rows]
        weights = context.make_array(signature.args[4])(context, builder, arguments[4]).data
        for lane in range(LANES):
            position = ahead(to, lane * FEATURES)
            pointer, _, align = address(context, builder, signature.args[0], arguments[0], position, BLOCK)
            total = builder.load(pointer)
            total.align = align
            for number, row in enumerate(rows):
                weight = builder.load(builder.gep(weights, [ir.Constant(at.type, number * LANES + lane)]))
                total = fma(builder, splat(builder, weight, block), row, total)
            builder.store(total, pointer).align = align
        return context.get_dummy_value()

    return signature, codegen
