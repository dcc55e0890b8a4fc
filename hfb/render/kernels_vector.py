"""Compiled parts: four channels of a picture or a texture at a time, in one register.

The compiler that numba brings does not pack four neighbouring numbers by itself, so these few steps are written for it.
Positions are counted in numbers from the beginning of an array without gaps.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

_LANES = range(4)
BATCH = 64  # columns of the tables of `kernels_shading`


def _address(context, builder, array_type, array, position):
    """Pointer to four numbers of an array, and their type."""
    data = context.make_array(array_type)(context, builder, array).data
    four = ir.VectorType(context.get_value_type(array_type.dtype), 4)
    return builder.bitcast(builder.gep(data, [position]), four.as_pointer()), four, array_type.dtype.bitwidth // 8


def _load(context, builder, array_type, array, position):
    pointer, _, align = _address(context, builder, array_type, array, position)
    value = builder.load(pointer)
    value.align = align
    return value


def _splat(builder, scalar, four):
    first = builder.insert_element(ir.Constant(four, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(ir.IntType(32), 4), [0, 0, 0, 0]))


def _shuffle(builder, left, right, order):
    return builder.shuffle_vector(left, right, ir.Constant(ir.VectorType(ir.IntType(32), 4), list(order)))


def _fma(builder, a, b, c):
    """a b + c, rounded once where the processor can."""
    return builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",))


def _convert(context, builder, value, target):
    """A vector of real numbers in another type."""
    wide = context.get_abi_sizeof(value.type.element) > context.get_abi_sizeof(target)
    kind = ir.VectorType(target, value.type.count)
    return value if value.type == kind else (builder.fptrunc if wide else builder.fpext)(value, kind)


def _positions(context, builder, signature, arguments, wanted):
    return [context.cast(builder, arguments[k], signature.args[k], types.intp) for k in wanted]


@intrinsic
def dots(typingctx, picture, pixel, texture, a, b, c, d):
    """Inner products of the four channels at `pixel` with the texels at a, b, c and d."""
    signature = types.UniTuple(texture.dtype, 4)(picture, pixel, texture, a, b, c, d)

    def codegen(context, builder, signature, arguments):
        at, *corners = _positions(context, builder, signature, arguments, (1, 3, 4, 5, 6))
        given = _load(context, builder, signature.args[0], arguments[0], at)
        p, q, r, s = (
            builder.fmul(given, _load(context, builder, signature.args[2], arguments[2], corner)) for corner in corners
        )
        # Sums along four registers as one register of four sums: transposed by halves.
        pq = builder.fadd(_shuffle(builder, p, q, (0, 2, 4, 6)), _shuffle(builder, p, q, (1, 3, 5, 7)))
        rs = builder.fadd(_shuffle(builder, r, s, (0, 2, 4, 6)), _shuffle(builder, r, s, (1, 3, 5, 7)))
        sums = builder.fadd(_shuffle(builder, pq, rs, (0, 2, 4, 6)), _shuffle(builder, pq, rs, (1, 3, 5, 7)))
        values = [builder.extract_element(sums, ir.Constant(ir.IntType(32), lane)) for lane in _LANES]
        return cgutils.pack_array(builder, values)

    return signature, codegen


@intrinsic
def add_to_texels(typingctx, texture, a, b, c, d, weight_a, weight_b, weight_c, weight_d, picture, pixel):
    """Add the four channels at `pixel`, times a weight each, to the texels at a, b, c and d (which may coincide)."""
    signature = types.void(texture, a, b, c, d, weight_a, weight_b, weight_c, weight_d, picture, pixel)

    def codegen(context, builder, signature, arguments):
        *corners, at = _positions(context, builder, signature, arguments, (1, 2, 3, 4, 10))
        given = _load(context, builder, signature.args[9], arguments[9], at)
        for corner, weight in zip(corners, arguments[5:9], strict=True):
            pointer, four, align = _address(context, builder, signature.args[0], arguments[0], corner)
            held = builder.load(pointer)
            held.align = align
            builder.store(_fma(builder, _splat(builder, weight, four), given, held), pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def mix_texels(typingctx, texture, a, b, c, d, weight_a, weight_b, weight_c, weight_d, colours, at):
    """Write the weighted sum of the texels at a, b, c and d to `colours`."""
    signature = types.void(texture, a, b, c, d, weight_a, weight_b, weight_c, weight_d, colours, at)

    def codegen(context, builder, signature, arguments):
        *corners, at = _positions(context, builder, signature, arguments, (1, 2, 3, 4, 10))
        total = None
        for corner, weight in zip(corners, arguments[5:9], strict=True):
            texel = _load(context, builder, signature.args[0], arguments[0], corner)
            share = _splat(builder, weight, texel.type)
            total = builder.fmul(share, texel) if total is None else _fma(builder, share, texel, total)
        pointer, _, align = _address(context, builder, signature.args[9], arguments[9], at)
        builder.store(total, pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def add_scaled(typingctx, picture, pixel, colours, at, scale):
    """Add `scale` times four channels of `colours` to those of `picture`."""
    signature = types.void(picture, pixel, colours, at, scale)

    def codegen(context, builder, signature, arguments):
        to, source = _positions(context, builder, signature, arguments, (1, 3))
        given = _load(context, builder, signature.args[2], arguments[2], source)
        pointer, four, align = _address(context, builder, signature.args[0], arguments[0], to)
        held = builder.load(pointer)
        held.align = align
        builder.store(_fma(builder, _splat(builder, arguments[4], four), given, held), pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def add_corner(typingctx, gradient, at, weight, x, y, z):
    """Add weight times (x, y, z, 0) to four numbers of `gradient`."""
    signature = types.void(gradient, at, weight, x, y, z)

    def codegen(context, builder, signature, arguments):
        (to,) = _positions(context, builder, signature, arguments, (1,))
        pointer, four, align = _address(context, builder, signature.args[0], arguments[0], to)
        held = builder.load(pointer)
        held.align = align
        asked = ir.Constant(four, [0.0, 0.0, 0.0, 0.0])
        for lane, number in enumerate(arguments[3:6]):
            asked = builder.insert_element(asked, number, ir.Constant(ir.IntType(32), lane))
        builder.store(_fma(builder, _splat(builder, arguments[2], four), asked, held), pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def gather_face(typingctx, table, to, projected, i, j, k, pixel_x, pixel_y, alpha):
    """Write 12 numbers of a face to number `to` of the table on: its second and third corner as seen from the first
    (x, y, 1/z, 0), and (pixel_x, pixel_y, 0, alpha) as seen from there.

    projected: (V, 4), the last one 0; i, j, k: positions of the three corners in it.
    """
    signature = types.void(table, to, projected, i, j, k, pixel_x, pixel_y, alpha)

    def codegen(context, builder, signature, arguments):
        at, *corners = _positions(context, builder, signature, arguments, (1, 3, 4, 5))
        first, second, third = (_load(context, builder, signature.args[2], arguments[2], corner) for corner in corners)
        seen = ir.Constant(first.type, [0.0, 0.0, 0.0, 0.0])
        for lane, number in ((0, arguments[6]), (1, arguments[7]), (3, arguments[8])):
            seen = builder.insert_element(seen, number, ir.Constant(ir.IntType(32), lane))
        for number, vector in enumerate((second, third, seen)):
            position = builder.add(at, ir.Constant(at.type, 4 * number * BATCH))
            pointer, four, align = _address(context, builder, signature.args[0], arguments[0], position)
            value = _convert(context, builder, builder.fsub(vector, first), four.element)
            builder.store(value, pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def gather_four(typingctx, table, to, source, at):
    """Copy four numbers of `source`."""
    signature = types.void(table, to, source, at)

    def codegen(context, builder, signature, arguments):
        here, there = _positions(context, builder, signature, arguments, (1, 3))
        value = _load(context, builder, signature.args[2], arguments[2], there)
        pointer, four, align = _address(context, builder, signature.args[0], arguments[0], here)
        builder.store(_convert(context, builder, value, four.element), pointer).align = align
        return context.get_dummy_value()

    return signature, codegen
