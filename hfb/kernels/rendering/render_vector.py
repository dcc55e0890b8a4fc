"""SIMD operations on four channels of an image or a texture.

Positions as in `hfb.kernels.simd`.
"""
# mypy: ignore-errors
# (numba compiles these: its types are not mypy's)

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from hfb.kernels.simd import LANES, address, fma, load, positions, shuffle, splat

_LANES = range(4)
ON_EDGE = -1e-9  # barycentric slack: a centre exactly on a shared edge must not fall between its two faces
BATCH = 64  # columns of the tables of `render_shading`


def _convert(context, builder, value, target):
    """Return a vector of real numbers in another type."""
    wide = context.get_abi_sizeof(value.type.element) > context.get_abi_sizeof(target)
    kind = ir.VectorType(target, value.type.count)
    return value if value.type == kind else (builder.fptrunc if wide else builder.fpext)(value, kind)


@intrinsic
def dots(typingctx, picture, pixel, texture, a, b, c, d):
    """Return the inner products of the four channels of a pixel with those of four texels.

    Args:
        typingctx: numba's typing context.
        picture: four channels per pixel.
        pixel: position in `picture`.
        texture: four channels per texel.
        a: position of a texel.
        b: position of a texel.
        c: position of a texel.
        d: position of a texel.
    """
    signature = types.UniTuple(texture.dtype, 4)(picture, pixel, texture, a, b, c, d)

    def codegen(context, builder, signature, arguments):
        at, *corners = positions(context, builder, signature, arguments, (1, 3, 4, 5, 6))
        grad_pixel = load(context, builder, signature.args[0], arguments[0], at, 4)
        texels = (load(context, builder, signature.args[2], arguments[2], corner, 4) for corner in corners)
        p, q, r, s = (builder.fmul(grad_pixel, texel) for texel in texels)
        # Sums along four registers as one register of four sums: transposed by halves.
        pq = builder.fadd(shuffle(builder, p, q, (0, 2, 4, 6)), shuffle(builder, p, q, (1, 3, 5, 7)))
        rs = builder.fadd(shuffle(builder, r, s, (0, 2, 4, 6)), shuffle(builder, r, s, (1, 3, 5, 7)))
        sums = builder.fadd(shuffle(builder, pq, rs, (0, 2, 4, 6)), shuffle(builder, pq, rs, (1, 3, 5, 7)))
        values = [builder.extract_element(sums, ir.Constant(ir.IntType(32), lane)) for lane in _LANES]
        return cgutils.pack_array(builder, values)

    return signature, codegen


@intrinsic
def add_to_texels(typingctx, texture, a, b, c, d, weight_a, weight_b, weight_c, weight_d, picture, pixel):
    """Add the four channels of a pixel, times a weight each, to four texels (which may coincide).

    Args:
        typingctx: numba's typing context.
        texture: four channels per texel.
        a: position of a texel.
        b: position of a texel.
        c: position of a texel.
        d: position of a texel.
        weight_a: weight of texel a.
        weight_b: weight of texel b.
        weight_c: weight of texel c.
        weight_d: weight of texel d.
        picture: four channels per pixel.
        pixel: position in `picture`.
    """
    signature = types.void(texture, a, b, c, d, weight_a, weight_b, weight_c, weight_d, picture, pixel)

    def codegen(context, builder, signature, arguments):
        *corners, at = positions(context, builder, signature, arguments, (1, 2, 3, 4, 10))
        grad_pixel = load(context, builder, signature.args[9], arguments[9], at, 4)
        for corner, weight in zip(corners, arguments[5:9], strict=True):
            pointer, four, align = address(context, builder, signature.args[0], arguments[0], corner, 4)
            held = builder.load(pointer)
            held.align = align
            builder.store(fma(builder, splat(builder, weight, four), grad_pixel, held), pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def mix_texels(typingctx, texture, a, b, c, d, weight_a, weight_b, weight_c, weight_d, colours, at):
    """Write the weighted sum of four texels.

    Args:
        typingctx: numba's typing context.
        texture: four channels per texel.
        a: position of a texel.
        b: position of a texel.
        c: position of a texel.
        d: position of a texel.
        weight_a: weight of texel a.
        weight_b: weight of texel b.
        weight_c: weight of texel c.
        weight_d: weight of texel d.
        colours: written to.
        at: position in `colours`.
    """
    signature = types.void(texture, a, b, c, d, weight_a, weight_b, weight_c, weight_d, colours, at)

    def codegen(context, builder, signature, arguments):
        *corners, at = positions(context, builder, signature, arguments, (1, 2, 3, 4, 10))
        total = None
        for corner, weight in zip(corners, arguments[5:9], strict=True):
            texel = load(context, builder, signature.args[0], arguments[0], corner, 4)
            share = splat(builder, weight, texel.type)
            total = builder.fmul(share, texel) if total is None else fma(builder, share, texel, total)
        pointer, _, align = address(context, builder, signature.args[9], arguments[9], at, 4)
        builder.store(total, pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def add_scaled(typingctx, picture, pixel, colours, at, scale):
    """Add `scale` times four channels of `colours` to those of `picture`.

    Args:
        typingctx: numba's typing context.
        picture: four channels per pixel.
        pixel: position in `picture`.
        colours: four channels per pixel.
        at: position in `colours`.
        scale: factor.
    """
    signature = types.void(picture, pixel, colours, at, scale)

    def codegen(context, builder, signature, arguments):
        to, source = positions(context, builder, signature, arguments, (1, 3))
        grad_pixel = load(context, builder, signature.args[2], arguments[2], source, 4)
        pointer, four, align = address(context, builder, signature.args[0], arguments[0], to, 4)
        held = builder.load(pointer)
        held.align = align
        builder.store(fma(builder, splat(builder, arguments[4], four), grad_pixel, held), pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def add_corner(typingctx, gradient, at, weight, x, y, z):
    """Add weight times (x, y, z, 0) to four numbers.

    Args:
        typingctx: numba's typing context.
        gradient: added to.
        at: position in `gradient`.
        weight: factor.
        x: number.
        y: number.
        z: number.
    """
    signature = types.void(gradient, at, *[gradient.dtype] * 4)

    def codegen(context, builder, signature, arguments):
        (to,) = positions(context, builder, signature, arguments, (1,))
        pointer, four, align = address(context, builder, signature.args[0], arguments[0], to, 4)
        held = builder.load(pointer)
        held.align = align
        added = ir.Constant(four, [0.0, 0.0, 0.0, 0.0])
        for lane, number in enumerate(arguments[3:6]):
            added = builder.insert_element(added, number, ir.Constant(ir.IntType(32), lane))
        builder.store(fma(builder, splat(builder, arguments[2], four), added, held), pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def gather_face(typingctx, table, to, projected, i, j, k, pixel_x, pixel_y, alpha, u, v):
    """Write 12 numbers of a face to the table.

    They are its second and third corner relative to the first, (x, y, 1/z, u) and (x, y, 1/z, v), and
    (pixel_x, pixel_y, 0, alpha) relative to it.

    Args:
        typingctx: numba's typing context.
        table: work space.
        to: position in `table`.
        projected: (V, 4), the last one 0.
        i: position of the first corner in `projected`.
        j: position of the second corner.
        k: position of the third corner.
        pixel_x: x of the pixel [px].
        pixel_y: y of the pixel [px].
        alpha: alpha of the pixel.
        u: u of the second corner relative to the first.
        v: v of the third corner relative to the first.
    """
    signature = types.void(table, to, projected, i, j, k, pixel_x, pixel_y, alpha, u, v)

    def codegen(context, builder, signature, arguments):
        at, *corners = positions(context, builder, signature, arguments, (1, 3, 4, 5))
        first, second, third = (
            load(context, builder, signature.args[2], arguments[2], corner, 4) for corner in corners
        )
        seen = ir.Constant(first.type, [0.0, 0.0, 0.0, 0.0])
        for lane, number in ((0, arguments[6]), (1, arguments[7]), (3, arguments[8])):
            seen = builder.insert_element(seen, number, ir.Constant(ir.IntType(32), lane))
        for number, vector in enumerate((second, third, seen)):
            position = builder.add(at, ir.Constant(at.type, 4 * number * BATCH))
            pointer, four, align = address(context, builder, signature.args[0], arguments[0], position, 4)
            value = _convert(context, builder, builder.fsub(vector, first), four.element)
            if number < 2:
                extra, kind = arguments[9 + number], signature.args[9 + number]
                extra = context.cast(builder, extra, kind, signature.args[0].dtype)
                value = builder.insert_element(value, extra, ir.Constant(ir.IntType(32), 3))
            builder.store(value, pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def gather_four(typingctx, table, to, source, at):
    """Copy four numbers.

    Args:
        typingctx: numba's typing context.
        table: work space.
        to: position in `table`.
        source: array to read.
        at: position in `source`.
    """
    signature = types.void(table, to, source, at)

    def codegen(context, builder, signature, arguments):
        here, there = positions(context, builder, signature, arguments, (1, 3))
        value = load(context, builder, signature.args[2], arguments[2], there, 4)
        pointer, four, align = address(context, builder, signature.args[0], arguments[0], here, 4)
        builder.store(_convert(context, builder, value, four.element), pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def keep_nearest(typingctx, tiles, above, below, nearness, least, face, mask):
    """Let a face compete for a tile of 4 x 2 pixels.

    The tile keeps the larger of its value and, where least >= ON_EDGE, the nearness with the face in the bits of the
    mask (see `render_screen.pack`).

    Args:
        typingctx: numba's typing context.
        tiles: updated.
        above: position at which the tile's first row begins.
        below: position at which its second row begins.
        nearness: 1/z at the eight centres.
        least: smallest barycentric coordinate at the eight centres.
        face: number of the face.
        mask: bits of an index.
    """
    signature = types.void(tiles, above, below, nearness, least, face, mask)

    def codegen(context, builder, signature, arguments):
        rows = positions(context, builder, signature, arguments, (1, 2))
        face, mask = positions(context, builder, signature, arguments, (5, 6))
        whole = ir.VectorType(ir.IntType(64), 8)
        bits = builder.and_(builder.bitcast(arguments[3], whole), splat(builder, builder.not_(mask), whole))
        bits = builder.or_(bits, splat(builder, face, whole))
        inside = builder.fcmp_ordered(">=", arguments[4], ir.Constant(arguments[4].type, [ON_EDGE] * 8))
        bits = builder.select(inside, bits, ir.Constant(whole, [0] * 8))
        for row, first in zip(rows, (0, 4), strict=True):
            pointer, _, align = address(context, builder, signature.args[0], arguments[0], row, 4)
            held = builder.load(pointer)
            held.align = align
            mine = shuffle(builder, bits, bits, range(first, first + 4))
            larger = builder.select(builder.icmp_signed(">", mine, held), mine, held)
            builder.store(larger, pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def untangle(typingctx, table, to, source, at):
    """Write eight times four neighbouring numbers to four rows of the table, BATCH apart.

    Args:
        typingctx: numba's typing context.
        table: work space.
        to: position in `table`.
        source: array to read.
        at: position in `source`.
    """
    signature = types.void(table, to, source, at)

    def codegen(context, builder, signature, arguments):
        here, there = positions(context, builder, signature, arguments, (1, 3))
        mixed = load(context, builder, signature.args[2], arguments[2], there, 32)
        for row in _LANES:
            position = builder.add(here, ir.Constant(here.type, row * BATCH))
            pointer, _, align = address(context, builder, signature.args[0], arguments[0], position, 8)
            builder.store(shuffle(builder, mixed, mixed, range(row, 32, 4)), pointer).align = align
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def store_corners(typingctx, projected, to, stride, x, y, z):
    """Write (x, y, z, 0) of every lane.

    Args:
        typingctx: numba's typing context.
        projected: written to.
        to: position in `projected`.
        stride: numbers from one lane to the next.
        x: LANES numbers.
        y: LANES numbers.
        z: LANES numbers.
    """
    signature = types.void(projected, to, stride, x, y, z)

    def codegen(context, builder, signature, arguments):
        here, stride = positions(context, builder, signature, arguments, (1, 2))
        x, y, z = arguments[3:]
        pairs = [i for lane in range(LANES) for i in (lane, LANES + lane)]
        planes, depths = shuffle(builder, x, y, pairs), shuffle(builder, z, ir.Constant(z.type, [0.0] * LANES), pairs)
        for lane in range(LANES):
            pointer, _, align = address(context, builder, signature.args[0], arguments[0], here, 4)
            at = 2 * lane
            four = shuffle(builder, planes, depths, (at, at + 1, 2 * LANES + at, 2 * LANES + at + 1))
            builder.store(four, pointer).align = align
            here = builder.add(here, stride)
        return context.get_dummy_value()

    return signature, codegen
