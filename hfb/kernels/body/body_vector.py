"""Compiled products of all instants' pose features with a vertex's pose blend shapes, and their gradients.

The code is written block by block, so that every number stays in a register; compiled loops would load most of them
again and again.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from hfb.kernels.simd import LANES, address, fma, lanes_of, load, positions, shuffle

FEATURES = 208  # of a pose: SMPL's 23 x 9 and a zero, a number that 16 divides
BLOCK = 16


def _ahead(builder, position, count):
    return builder.add(position, ir.Constant(position.type, count))


def _directions(context, builder, array_type, array, at, kind):
    """Load a block of a vertex's three rows of directions, as real numbers."""
    rows = [load(context, builder, array_type, array, _ahead(builder, at, row * FEATURES), BLOCK) for row in range(3)]
    block = ir.VectorType(kind, BLOCK)
    return [builder.sitofp(row, block) for row in rows] if isinstance(array_type.dtype, types.Integer) else rows


def _sums(builder, blocks):
    """Return the sum of each of LANES blocks, side by side: halves, then neighbours of two at a time."""
    half = BLOCK // 2
    blocks = [
        builder.fadd(shuffle(builder, one, one, range(half)), shuffle(builder, one, one, range(half, BLOCK)))
        for one in blocks
    ]
    while len(blocks) > 1:
        pairs = list(zip(blocks[::2], blocks[1::2], strict=True))
        blocks = [
            builder.fadd(shuffle(builder, *pair, range(0, BLOCK, 2)), shuffle(builder, *pair, range(1, BLOCK, 2)))
            for pair in pairs
        ]
    return blocks[0]


@intrinsic
def displacements(typingctx, features, directions, at):
    """Return, for every instant, the inner products of its features with three rows: three times LANES numbers.

    Args:
        typingctx: numba's typing context.
        features: (LANES, FEATURES).
        directions: (V, 3, FEATURES).
        at: position of three rows in `directions`.
    """
    kind = lanes_of(features.dtype)
    signature = types.UniTuple(kind, 3)(features, directions, at)

    def codegen(context, builder, signature, arguments):
        (at,) = positions(context, builder, signature, arguments, (2,))
        totals = [[None] * LANES for _ in range(3)]
        for first in range(0, FEATURES, BLOCK):
            there = _ahead(builder, at, first)
            rows = _directions(context, builder, signature.args[1], arguments[1], there, kind.vector.element)
            for lane in range(LANES):
                place = ir.Constant(at.type, lane * FEATURES + first)
                feature = load(context, builder, signature.args[0], arguments[0], place, BLOCK)
                for row, total in zip(rows, totals, strict=True):
                    so_far = total[lane]
                    total[lane] = builder.fmul(row, feature) if so_far is None else fma(builder, row, feature, so_far)
        return cgutils.pack_array(builder, [_sums(builder, total) for total in totals])

    return signature, codegen


@intrinsic
def add_features(typingctx, features, directions, at, x, y, z):
    """Add the gradient of `displacements` by the features.

    Args:
        typingctx: numba's typing context.
        features: (LANES, FEATURES), gradient, added to.
        directions: (V, 3, FEATURES).
        at: position of three rows in `directions`.
        x: gradient by the first product, LANES numbers.
        y: gradient by the second product.
        z: gradient by the third product.
    """
    signature = types.void(features, directions, at, x, y, z)

    def codegen(context, builder, signature, arguments):
        (at,) = positions(context, builder, signature, arguments, (2,))
        shares = [[shuffle(builder, one, one, [lane] * BLOCK) for one in arguments[3:]] for lane in range(LANES)]
        for first in range(0, FEATURES, BLOCK):
            there = _ahead(builder, at, first)
            rows = _directions(
                context, builder, signature.args[1], arguments[1], there, signature.args[3].vector.element
            )
            for lane in range(LANES):
                place = ir.Constant(at.type, lane * FEATURES + first)
                pointer, _, align = address(context, builder, signature.args[0], arguments[0], place, BLOCK)
                total = builder.load(pointer)
                total.align = align
                for weight, row in zip(shares[lane], rows, strict=True):
                    total = fma(builder, weight, row, total)
                builder.store(total, pointer).align = align
        return context.get_dummy_value()

    return signature, codegen
