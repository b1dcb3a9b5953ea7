"""Registers of four and of sixteen numbers: what transfers between particles and grid are made of.

A node of the grid is four numbers (three components and one more), and the nodes along z lie one
after another: a particle's 27 nodes are nine rows of three, each read and written as one row of
four nodes, the last of weight 0. Numba has no such types and LLVM seldom finds them by itself, so
they are defined here: `<4 x T>` and `<16 x T>` behind ordinary functions, to be called from
compiled code only. T is float32 or float64, that of the array that is read or written. On a
machine without registers of that width LLVM splits them.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

FOUR, ROW = 4, 16


class _Lanes(types.Type):
    """A register of `count` numbers of a type."""

    def __init__(self, dtype, count):
        self.dtype, self.count = dtype, count
        super().__init__(name=f'Lanes({dtype}, {count})')


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _llvm(kind))


def _llvm(kind):
    return ir.VectorType(
        ir.FloatType() if kind.dtype == types.float32 else ir.DoubleType(), kind.count
    )


def _splat(builder, kind, scalar):
    """All lanes of a register the same float64, rounded to their type."""
    llvm = _llvm(kind)
    if kind.dtype == types.float32:
        scalar = builder.fptrunc(scalar, ir.FloatType())
    empty = ir.Constant(llvm, ir.Undefined)
    one = builder.insert_element(empty, scalar, ir.IntType(32)(0))
    return _shuffle(builder, llvm, one, [0] * kind.count)


def _shuffle(builder, llvm, value, lanes):
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(lanes)), lanes)
    return builder.shuffle_vector(value, ir.Constant(llvm, ir.Undefined), mask)


def _pointer(context, builder, kind, array, index, lanes):
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _llvm(lanes).as_pointer())


def _load(count):
    @intrinsic
    def load(typing, array, index):
        lanes = _Lanes(array.dtype, count)

        def code(context, builder, signature, args):
            pointer = _pointer(context, builder, signature.args[0], args[0], args[1], lanes)
            return builder.load(pointer, align=array.dtype.bitwidth // 8)

        return lanes(array, types.uintp), code

    return load


def _store(count):
    @intrinsic
    def store(typing, array, index, value):
        lanes = _Lanes(array.dtype, count)

        def code(context, builder, signature, args):
            pointer = _pointer(context, builder, signature.args[0], args[0], args[1], lanes)
            builder.store(args[2], pointer, align=array.dtype.bitwidth // 8)
            return context.get_dummy_value()

        return types.void(array, types.uintp, lanes), code

    return store


# array[index : index + 4] and array[index : index + 16] of a contiguous vector, unchecked.
load, load_row = _load(FOUR), _load(ROW)
store, store_row = _store(FOUR), _store(ROW)


@intrinsic
def make(typing, array, a, b, c, d):
    """Returns the register (a, b, c, d) of the type of an array."""
    kind = _Lanes(array.dtype, FOUR)

    def code(context, builder, signature, args):
        value = ir.Constant(ir.VectorType(ir.DoubleType(), FOUR), ir.Undefined)
        for lane, number in enumerate(args[1:]):
            value = builder.insert_element(value, number, ir.IntType(32)(lane))
        return builder.fptrunc(value, _llvm(kind)) if kind.dtype == types.float32 else value

    return kind(array, types.float64, types.float64, types.float64, types.float64), code


def _spread(lanes):
    @intrinsic
    def spread(typing, four):
        def code(context, builder, signature, args):
            return _shuffle(builder, _llvm(four), args[0], lanes)

        return _Lanes(four.dtype, ROW)(four), code

    return spread


# A row whose four nodes are all `four`; one whose node k is number k of `four`, four times.
repeat, stretch = _spread([0, 1, 2, 3] * 4), _spread([n // 4 for n in range(ROW)])


@intrinsic
def fold(typing, row):
    """Returns the sum of a row's four nodes."""

    def code(context, builder, signature, args):
        low = _shuffle(builder, _llvm(row), args[0], list(range(8)))
        high = _shuffle(builder, _llvm(row), args[0], list(range(8, 16)))
        half = builder.fadd(low, high)
        low = _shuffle(builder, half.type, half, list(range(4)))
        high = _shuffle(builder, half.type, half, list(range(4, 8)))
        return builder.fadd(low, high)

    return _Lanes(row.dtype, FOUR)(row), code


# The factor of these two may come from memory: the machine reads and repeats it at once.


@intrinsic
def muladd(typing, factor, a, b):
    """Returns factor * a + b for a scalar `factor`, rounded once where the machine can."""

    def code(context, builder, signature, args):
        llvm = _llvm(a)
        name = f'llvm.fmuladd.v{a.count}f{a.dtype.bitwidth}'
        function = ir.FunctionType(llvm, [llvm] * 3)
        fmuladd = cgutils.get_or_insert_function(builder.module, function, name)
        return builder.call(fmuladd, [_splat(builder, a, args[0]), args[1], args[2]])

    return a(types.float64, a, a), code


@intrinsic
def scale(typing, factor, a):
    """Returns factor * a for a scalar `factor`."""

    def code(context, builder, signature, args):
        return builder.fmul(_splat(builder, a, args[0]), args[1])

    return a(types.float64, a), code


def _elementwise(operation):
    @intrinsic
    def combine(typing, a, b):
        return a(a, a), lambda context, builder, signature, args: getattr(builder, operation)(*args)

    return combine


# a + b and a * b, number by number.
add, multiply = _elementwise('fadd'), _elementwise('fmul')


@intrinsic
def parts(typing, a):
    """Returns the four numbers of a register as a tuple of float64."""

    def code(context, builder, signature, args):
        value = args[0]
        if a.dtype == types.float32:
            value = builder.fpext(value, ir.VectorType(ir.DoubleType(), FOUR))
        lanes = [builder.extract_element(value, ir.IntType(32)(lane)) for lane in range(FOUR)]
        return context.make_tuple(builder, signature.return_type, lanes)

    return types.UniTuple(types.float64, FOUR)(a), code
