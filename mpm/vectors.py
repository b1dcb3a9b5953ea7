"""Four float64 in one register: what the transfers between particles and grid are made of.

A node of the grid is four numbers (three components and one more), so a transfer is a handful of
operations on vectors of four. Numba has no such type and LLVM seldom finds it by itself, so it is
defined here: `<4 x double>` behind ordinary functions, to be called from compiled code only. On a
machine without registers of that width LLVM splits them.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model


class _Four(types.Type):
    def __init__(self):
        super().__init__(name='Four')


four = _Four()
_LLVM = ir.VectorType(ir.DoubleType(), 4)


@register_model(_Four)
class _FourModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _LLVM)


def _splat(builder, scalar):
    i32 = ir.IntType(32)
    one = builder.insert_element(ir.Constant(_LLVM, ir.Undefined), scalar, i32(0))
    return builder.shuffle_vector(
        one, ir.Constant(_LLVM, ir.Undefined), ir.Constant(ir.VectorType(i32, 4), [0] * 4)
    )


def _pointer(context, builder, kind, array, index):
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _LLVM.as_pointer())


@intrinsic
def load(typing, array, index):
    """Returns array[index : index + 4] of a contiguous float64 vector, unchecked."""

    def code(context, builder, signature, args):
        pointer = _pointer(context, builder, signature.args[0], args[0], args[1])
        return builder.load(pointer, align=8)

    return four(array, types.uintp), code


@intrinsic
def store(typing, array, index, value):
    """Writes `value` to array[index : index + 4], unchecked."""

    def code(context, builder, signature, args):
        pointer = _pointer(context, builder, signature.args[0], args[0], args[1])
        builder.store(args[2], pointer, align=8)
        return context.get_dummy_value()

    return types.void(array, types.uintp, four), code


@intrinsic
def make(typing, a, b, c, d):
    """Returns the vector (a, b, c, d)."""

    def code(context, builder, signature, args):
        value = ir.Constant(_LLVM, ir.Undefined)
        for lane, number in enumerate(args):
            value = builder.insert_element(value, number, ir.IntType(32)(lane))
        return value

    return four(types.float64, types.float64, types.float64, types.float64), code


@intrinsic
def muladd(typing, factor, a, b):
    """Returns factor * a + b for a scalar `factor`, rounded once where the machine can."""

    def code(context, builder, signature, args):
        kind = ir.FunctionType(_LLVM, [_LLVM] * 3)
        fma = cgutils.get_or_insert_function(builder.module, kind, 'llvm.fmuladd.v4f64')
        return builder.call(fma, [_splat(builder, args[0]), args[1], args[2]])

    return four(types.float64, four, four), code


@intrinsic
def scale(typing, factor, a):
    """Returns factor * a for a scalar `factor`."""

    def code(context, builder, signature, args):
        return builder.fmul(_splat(builder, args[0]), args[1])

    return four(types.float64, four), code


@intrinsic
def add(typing, a, b):
    """Returns a + b."""

    def code(context, builder, signature, args):
        return builder.fadd(args[0], args[1])

    return four(four, four), code


@intrinsic
def parts(typing, a):
    """Returns the four numbers of a vector as a tuple."""

    def code(context, builder, signature, args):
        lanes = [builder.extract_element(args[0], ir.IntType(32)(lane)) for lane in range(4)]
        return context.make_tuple(builder, signature.return_type, lanes)

    return types.UniTuple(types.float64, 4)(four), code
