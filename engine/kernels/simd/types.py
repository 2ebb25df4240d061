"""The types: WIDTH numbers in a register, and a scalar as all lanes of one wherever the two meet.

`F32`, `F64`, `I32`, `U32` (wraps, shifts in zeros) and `MASK`, what a comparison gives.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core.imputils import lower_cast
from numba.core.typeconv import Conversion
from numba.extending import models, register_model

# AVX-512 has registers for so many float32; LLVM takes two or four of them elsewhere: the trial "sixteen
# numbers in a register, not eight" of benchmarks/trials.py.
WIDTH = 16

I1, I32_WORD, I64 = ir.IntType(1), ir.IntType(32), ir.IntType(64)
_FLOAT, _DOUBLE = ir.FloatType(), ir.DoubleType()


class Vector(types.Type):
    """WIDTH numbers of one type.

    element   Numba's type of one of them
    scalars   Numba's types of the scalars that become all lanes where they meet a vector
    llvm      LLVM's type;  suffix: its name in LLVM's functions
    """

    def __init__(self, name: str, element: types.Type, scalars: type, llvm: ir.Type, suffix: str):
        super().__init__(name=f"{name}x{WIDTH}")
        self.element, self.scalars = element, scalars
        self.llvm, self.suffix = ir.VectorType(llvm, WIDTH), f"v{WIDTH}{suffix}"

    def takes(self, other: types.Type) -> bool:
        """Whether a scalar of this type becomes such a vector. A float64 does not become a F32: that would hide
        where a formula is calculated in more digits than was meant. An integer does become 32 bits, and wraps: Numba's
        are 64 bits wide once they have been calculated with."""
        if isinstance(self.element, types.Float):
            return other == self.element or isinstance(other, types.IntegerLiteral)
        return isinstance(other, self.scalars)

    def can_convert_from(self, typingctx, other):
        return Conversion.safe if self.takes(other) else None


class FloatVector(Vector):
    pass


class IntVector(Vector):
    pass


class MaskVector(Vector):
    pass


F32 = FloatVector("f32", types.float32, types.Float, _FLOAT, "f32")
F64 = FloatVector("f64", types.float64, types.Float, _DOUBLE, "f64")
I32 = IntVector("i32", types.int32, types.Integer, I32_WORD, "i32")
U32 = IntVector("u32", types.uint32, types.Integer, I32_WORD, "i32")
MASK = MaskVector("mask", types.boolean, types.Boolean, I1, "i1")


@register_model(FloatVector)
@register_model(IntVector)
@register_model(MaskVector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, vector):
        super().__init__(manager, vector, vector.llvm)


def filled(vector: Vector, value) -> ir.Constant:
    """The same constant in all lanes."""
    return ir.Constant(vector.llvm, [value] * WIDTH)


def splat(builder, value, llvm):
    """A scalar in all lanes."""
    undefined = ir.Constant(llvm, ir.Undefined)
    one = builder.insert_element(undefined, value, ir.Constant(I32_WORD, 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(I32_WORD, WIDTH), [0] * WIDTH))


def widen(context, builder, value, given, vector: Vector):
    """A scalar or a vector as `vector`."""
    if given == vector:
        return value
    value = context.cast(builder, value, given, vector.element)
    if vector is MASK and value.type != I1:
        value = builder.trunc(value, I1)
    return splat(builder, value, vector.llvm)


@lower_cast(types.Number, Vector)
@lower_cast(types.Boolean, Vector)
def _scalar_to_vector(context, builder, given, vector, value):
    return widen(context, builder, value, given, vector)
