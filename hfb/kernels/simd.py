"""SIMD operations of the kernels, written in LLVM: several neighbouring numbers in one register.

Numba's compiler does not vectorise where it cannot rule out that arrays overlap, or tests for it at every call; so a
few steps are written by hand. Positions are counted in numbers from the beginning of a contiguous array.
"""
# mypy: ignore-errors
# (builds code for numba: its types are not mypy's)

import operator

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model


def address(context, builder, array_type, array, position, count):
    """Return a pointer to `count` numbers of an array, their type, and the bytes of one.

    Args:
        context: numba's target context.
        builder: llvmlite's builder.
        array_type: numba's type of the array.
        array: array to access.
        position: position of the first number in the array.
        count: number of numbers.
    """
    data = context.make_array(array_type)(context, builder, array).data
    vector = ir.VectorType(context.get_value_type(array_type.dtype), count)
    return builder.bitcast(builder.gep(data, [position]), vector.as_pointer()), vector, array_type.dtype.bitwidth // 8


def load(context, builder, array_type, array, position, count):
    """Load `count` numbers of an array.

    Args:
        context: numba's target context.
        builder: llvmlite's builder.
        array_type: numba's type of the array.
        array: array to access.
        position: position of the first number in the array.
        count: number of numbers.
    """
    pointer, _, align = address(context, builder, array_type, array, position, count)
    value = builder.load(pointer)
    value.align = align
    return value


def splat(builder, scalar, vector):
    """Return a vector with a number in every lane.

    Args:
        builder: llvmlite's builder.
        scalar: the number.
        vector: type of the result.
    """
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    return shuffle(builder, first, first, [0] * vector.count)


def shuffle(builder, left, right, order):
    """Return lanes of two vectors, numbered consecutively, in another order.

    Args:
        builder: llvmlite's builder.
        left: first vector.
        right: second vector.
        order: numbers of the lanes.
    """
    return builder.shuffle_vector(left, right, ir.Constant(ir.VectorType(ir.IntType(32), len(order)), list(order)))


def fma(builder, a, b, c):
    """Return a b + c, rounded once where the CPU can.

    Args:
        builder: llvmlite's builder.
        a: factor.
        b: factor.
        c: summand.
    """
    return builder.fadd(builder.fmul(a, b, flags=("contract",)), c, flags=("contract",))


def positions(context, builder, signature, arguments, wanted):
    """Convert some of the arguments to positions.

    Args:
        context: numba's target context.
        builder: llvmlite's builder.
        signature: signature of the function.
        arguments: arguments of the function.
        wanted: numbers of the arguments.
    """
    return [context.cast(builder, arguments[k], signature.args[k], types.intp) for k in wanted]


class _Lanes(types.Type):
    """The type of several neighbouring numbers, in compiled code alone."""

    def __init__(self, number, count) -> None:
        super().__init__(name=f"{count} {number}")
        self.number = number
        self.vector = ir.VectorType(ir.FloatType() if number is types.float32 else ir.DoubleType(), count)


LANES = 8
_eight = {number: _Lanes(number, LANES) for number in (types.float32, types.float64)}
_lanes = _eight[types.float64]
lanes_of = _eight.__getitem__
_four = {number: _Lanes(number, 4) for number in (types.float32, types.float64)}
register_model(_Lanes)(lambda manager, kind: models.PrimitiveModel(manager, kind, kind.vector))


def _widened(context, builder, kind, value, lanes=_lanes):
    """Return lanes as they are; a number in every lane."""
    if isinstance(kind, _Lanes):
        return value
    return splat(builder, context.cast(builder, value, kind, lanes.number), lanes.vector)


def _operator(symbol, operation):
    """Let a sign of Python's work on lanes, and on lanes and a number."""

    def allow(kind):
        pairs = ((kind, kind), (kind, kind.number), (kind.number, kind))

        def lower(context, builder, signature, arguments):
            operands = zip(signature.args, arguments, strict=True)
            left, right = (_widened(context, builder, *one, kind) for one in operands)
            return getattr(builder, operation)(left, right)

        for pair in pairs:
            lower_builtin(symbol, *pair)(lower)
        return [signature(kind, *pair) for pair in pairs]

    cases = [case for kind in (*_eight.values(), *_four.values()) for case in allow(kind)]
    infer_global(symbol)(type("_", (ConcreteTemplate,), {"cases": cases}))


_ARITHMETIC = ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv"))
for _symbol, _operation in _ARITHMETIC:
    _operator(_symbol, _operation)


@intrinsic
def lanes(typingctx, number):
    """Return a number in every lane, in its own precision if that is single.

    Args:
        typingctx: numba's typing context.
        number: number to repeat.
    """
    kind = _eight.get(number, _lanes)

    def codegen(context, builder, signature, arguments):
        return _widened(context, builder, signature.args[0], arguments[0], kind)

    return kind(number), codegen


@intrinsic
def lane_numbers(typingctx):
    """Return 0 to 7.

    Args:
        typingctx: numba's typing context.
    """

    def codegen(context, builder, signature, arguments):
        return ir.Constant(_lanes.vector, [float(lane) for lane in range(LANES)])

    return _lanes(), codegen


def _loading(kind_of):
    def load_from(typingctx, array, position):
        kind = kind_of(array.dtype)

        def codegen(context, builder, signature, arguments):
            (at,) = positions(context, builder, signature, arguments, (1,))
            return load(context, builder, signature.args[0], arguments[0], at, kind.vector.count)

        return kind(array, position), codegen

    return load_from


load_lanes = intrinsic(_loading(_eight.__getitem__))
"""Eight numbers of an array from a position on, of either precision: of (array, position)."""

load_four = intrinsic(_loading(_four.__getitem__))
"""Four numbers of an array from a position on, of either precision: of (array, position)."""


@intrinsic
def store_lanes(typingctx, array, position, value):
    """Write all lanes to an array of their precision.

    Args:
        typingctx: numba's typing context.
        array: array to access.
        position: position of the first number in the array.
        value: lanes.
    """

    def codegen(context, builder, signature, arguments):
        (at,) = positions(context, builder, signature, arguments, (1,))
        count = signature.args[2].vector.count
        pointer, _, align = address(context, builder, signature.args[0], arguments[0], at, count)
        builder.store(arguments[2], pointer).align = align
        return context.get_dummy_value()

    return types.void(array, position, value), codegen


@intrinsic
def load_apart(typingctx, array, position, stride):
    """Load eight numbers of an array of either precision, `stride` apart.

    Args:
        typingctx: numba's typing context.
        array: array to access.
        position: position of the first number in the array.
        stride: numbers from one lane to the next.
    """
    kind = _eight[array.dtype]

    def codegen(context, builder, signature, arguments):
        at, stride = positions(context, builder, signature, arguments, (1, 2))
        value = ir.Constant(kind.vector, ir.Undefined)
        for lane in range(LANES):
            pointer, _, _ = address(context, builder, signature.args[0], arguments[0], at, 1)
            number = builder.load(builder.bitcast(pointer, kind.vector.element.as_pointer()))
            value = builder.insert_element(value, number, ir.Constant(ir.IntType(32), lane))
            at = builder.add(at, stride)
        return value

    return kind(array, position, stride), codegen


@intrinsic
def store_apart(typingctx, array, position, stride, value):
    """Write all lanes to an array of their precision, `stride` apart.

    Args:
        typingctx: numba's typing context.
        array: array to access.
        position: position of the first number in the array.
        stride: numbers from one lane to the next.
        value: lanes.
    """

    def codegen(context, builder, signature, arguments):
        at, stride = positions(context, builder, signature, arguments, (1, 2))
        element = signature.args[3].vector.element
        for lane in range(LANES):
            pointer, _, _ = address(context, builder, signature.args[0], arguments[0], at, 1)
            number = builder.extract_element(arguments[3], ir.Constant(ir.IntType(32), lane))
            builder.store(number, builder.bitcast(pointer, element.as_pointer()))
            at = builder.add(at, stride)
        return context.get_dummy_value()

    return types.void(array, position, stride, value), codegen


@intrinsic
def widen_lanes(typingctx, value):
    """Convert lanes to double precision.

    Args:
        typingctx: numba's typing context.
        value: lanes.
    """

    def codegen(context, builder, signature, arguments):
        return arguments[0] if signature.args[0] is _lanes else builder.fpext(arguments[0], _lanes.vector)

    return _lanes(value), codegen


@intrinsic
def multiply_add(typingctx, left, right, added):
    """Return `left` times `right` plus `added`, in every lane.

    Args:
        typingctx: numba's typing context.
        left: lanes.
        right: lanes, or a number of their precision.
        added: lanes.
    """

    def codegen(context, builder, signature, arguments):
        right = _widened(context, builder, signature.args[1], arguments[1], left)
        return fma(builder, arguments[0], right, arguments[2])

    return left(left, right if isinstance(right, _Lanes) else left.number, added), codegen


@intrinsic
def some_lane(typingctx, value):
    """Return whether any lane is not zero.

    Args:
        typingctx: numba's typing context.
        value: lanes.
    """

    def codegen(context, builder, signature, arguments):
        zero = ir.Constant(arguments[0].type, [0.0] * LANES)
        found = builder.bitcast(builder.fcmp_unordered("!=", arguments[0], zero), ir.IntType(LANES))
        return builder.icmp_unsigned("!=", found, ir.Constant(found.type, 0))

    return types.boolean(value), codegen


@intrinsic
def with_last(typingctx, four, number):
    """Return four lanes with another number in the last one.

    Args:
        typingctx: numba's typing context.
        four: four lanes.
        number: number of the last lane.
    """

    def codegen(context, builder, signature, arguments):
        return builder.insert_element(*arguments, ir.Constant(ir.IntType(32), 3))

    return four(four, four.number), codegen


@intrinsic
def four(typingctx, number):
    """Return a number in each of four lanes of double precision.

    Args:
        typingctx: numba's typing context.
        number: number to repeat.
    """
    kind = _four[types.float64]

    def codegen(context, builder, signature, arguments):
        return _widened(context, builder, signature.args[0], arguments[0], kind)

    return kind(number), codegen


@intrinsic
def widen_four(typingctx, value):
    """Convert four lanes to double precision.

    Args:
        typingctx: numba's typing context.
        value: lanes.
    """
    kind = _four[types.float64]

    def codegen(context, builder, signature, arguments):
        return arguments[0] if signature.args[0] is kind else builder.fpext(arguments[0], kind.vector)

    return kind(value), codegen


@intrinsic
def positive_part(typingctx, four):
    """Return the positive lanes, zero in the others.

    Args:
        typingctx: numba's typing context.
        four: four lanes.
    """

    def codegen(context, builder, signature, arguments):
        zero = ir.Constant(arguments[0].type, [0.0] * 4)
        return builder.select(builder.fcmp_ordered(">", arguments[0], zero), arguments[0], zero)

    return four(four), codegen


@intrinsic
def last_of(typingctx, four):
    """Return the last of four lanes.

    Args:
        typingctx: numba's typing context.
        four: four lanes.
    """

    def codegen(context, builder, signature, arguments):
        return builder.extract_element(arguments[0], ir.Constant(ir.IntType(32), 3))

    return four.number(four), codegen


@intrinsic
def sum_three(typingctx, four):
    """Return the sum of the first three of four lanes.

    Args:
        typingctx: numba's typing context.
        four: four lanes.
    """

    def codegen(context, builder, signature, arguments):
        one, two, three = (
            builder.extract_element(arguments[0], ir.Constant(ir.IntType(32), lane)) for lane in range(3)
        )
        return builder.fadd(builder.fadd(one, two), three)

    return four.number(four), codegen


def _choice(comparison):
    def choose(typingctx, left, right, then, otherwise):
        def codegen(context, builder, signature, arguments):
            operands = zip(signature.args, arguments, strict=True)
            left, right, then, otherwise = (_widened(context, builder, *one) for one in operands)
            return builder.select(builder.fcmp_ordered(comparison, left, right), then, otherwise)

        return _lanes(left, right, then, otherwise), codegen

    return choose


if_less = intrinsic(_choice("<"))
"""Select, in every lane, `then` where left < right, else `otherwise`: of (left, right, then, otherwise), lanes or
numbers."""

if_equal = intrinsic(_choice("=="))
"""`if_less` for left == right."""


def _extreme(comparison):
    def choose(typingctx, left, right):
        def codegen(context, builder, signature, arguments):
            operands = zip(signature.args, arguments, strict=True)
            left, right = (_widened(context, builder, *one) for one in operands)
            return builder.select(builder.fcmp_ordered(comparison, left, right), left, right)

        return _lanes(left, right), codegen

    return choose


smaller = intrinsic(_extreme("<"))
"""The smaller number in every lane; the second where one is not a number: of (left, right), lanes or numbers."""

larger = intrinsic(_extreme(">"))
"""`smaller` for the larger number."""


def _bits(comparison):
    def compare(typingctx, left, right):
        def codegen(context, builder, signature, arguments):
            operands = zip(signature.args, arguments, strict=True)
            left, right = (_widened(context, builder, *one) for one in operands)
            found = builder.bitcast(builder.fcmp_ordered(comparison, left, right), ir.IntType(LANES))
            return builder.zext(found, ir.IntType(64))

        return types.int64(left, right), codegen

    return compare


where_more = intrinsic(_bits(">"))
"""A bit per lane, the lowest the first: whether left > right: of (left, right), lanes or numbers."""

where_no_less = intrinsic(_bits(">="))
"""`where_more` for left >= right."""


@intrinsic
def floor_lanes(typingctx, value):
    """Round every lane down.

    Args:
        typingctx: numba's typing context.
        value: lanes.
    """

    def codegen(context, builder, signature, arguments):
        kind = ir.FunctionType(_lanes.vector, [_lanes.vector])
        floor = cgutils.get_or_insert_function(builder.module, kind, f"llvm.floor.v{LANES}f64")
        return builder.call(floor, arguments)

    return _lanes(value), codegen


@intrinsic
def sum_lanes(typingctx, value):
    """Return the sum of all lanes, in a fixed order.

    Args:
        typingctx: numba's typing context.
        value: lanes.
    """

    def codegen(context, builder, signature, arguments):
        total, count = arguments[0], LANES
        while count > 1:
            count //= 2
            halves = (shuffle(builder, total, total, range(at, at + count)) for at in (0, count))
            total = builder.fadd(*halves)
        return builder.extract_element(total, ir.Constant(ir.IntType(32), 0))

    return value.number(value), codegen


@intrinsic
def insert_sorted(typingctx, sorted_lanes, number):
    """Insert a number into ascending lanes; the largest falls out.

    Args:
        typingctx: numba's typing context.
        sorted_lanes: ascending.
        number: number to insert.
    """

    def codegen(context, builder, signature, arguments):
        held = arguments[0]
        wide = splat(builder, arguments[1], held.type)
        # What comes before each lane, or the number where that is less: the smaller of it and the lane.
        before = shuffle(builder, wide, held, [0, *range(LANES, 2 * LANES - 1)])
        most = builder.select(builder.fcmp_ordered(">", before, wide), before, wide)
        return builder.select(builder.fcmp_ordered("<", most, held), most, held)

    return sorted_lanes(sorted_lanes, sorted_lanes.number), codegen


@intrinsic
def last_lane(typingctx, value):
    """Return the number in the last lane.

    Args:
        typingctx: numba's typing context.
        value: lanes.
    """

    def codegen(context, builder, signature, arguments):
        return builder.extract_element(arguments[0], ir.Constant(ir.IntType(32), LANES - 1))

    return value.number(value), codegen


@intrinsic
def prefetch(typingctx, array, position):
    """Prefetch a number of an array.

    Args:
        typingctx: numba's typing context.
        array: array to access.
        position: position of the first number in the array.
    """

    def codegen(context, builder, signature, arguments):
        (at,) = positions(context, builder, signature, arguments, (1,))
        pointer, _, _ = address(context, builder, signature.args[0], arguments[0], at, 1)
        byte = ir.IntType(8).as_pointer()
        whole = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, whole, whole, whole])
        ask = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(ask, [builder.bitcast(pointer, byte), *(ir.Constant(whole, n) for n in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, position), codegen
