"""Operators and functions of vectors, and the few that take the place of `if`, `not` and casts for both.

Registered with Numba when this is imported; nothing is compiled then.
"""

from __future__ import annotations

import math
import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic

from ..jit import FASTMATH
from .types import (
    F32,
    F64,
    I1,
    I32,
    I32_WORD,
    I64,
    MASK,
    U32,
    WIDTH,
    FloatVector,
    IntVector,
    MaskVector,
    Vector,
    filled,
    splat,
    widen,
)

_SCALARS = (types.Number, types.Boolean)


def call(builder, name: str, result, args):
    """Call a function of LLVM's. Numba gives its fast-math flags to scalar calls only."""
    function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(result, [a.type for a in args]), name)
    floating = isinstance(result, ir.VectorType) and isinstance(result.element, (ir.FloatType, ir.DoubleType))
    return builder.call(function, args, fastmath=sorted(FASTMATH) if floating else ())


def plain(ty):
    """A literal's type without its value."""
    return types.unliteral(ty)


def fits(value, vector: Vector) -> bool:
    """Whether a value of this type is such a vector, or a scalar that becomes one."""
    return value == vector or vector.takes(value)


def _vector_of(args) -> Vector | None:
    """The first vector's type, if there is one."""
    return next((a for a in args if isinstance(a, Vector)), None)


# --- operators -------------------------------------------------------------------------------------------------------


def _binary(operation, kinds, result, build) -> None:
    """Make `operation` work on vectors of these kinds. result: of the vector's type; build: (builder, vector, a, b)."""

    @infer_global(operation)
    class _(AbstractTemplate):
        def generic(self, args, kws):
            vector = _vector_of(args) if len(args) == 2 and not kws else None
            if vector is None:
                return None
            if not isinstance(vector, kinds):
                raise TypingError(f"{operation.__name__} means nothing for {vector}")
            if not all(fits(a, vector) for a in args):
                raise TypingError(f"{args[0]} {operation.__name__} {args[1]}: cast one of them to the other's type")
            return signature(result(vector), *args)

    def lower(context, builder, sig, args):
        vector = _vector_of(sig.args)
        a, b = (widen(context, builder, x, t, vector) for x, t in zip(args, sig.args, strict=True))
        return build(builder, vector, a, b)

    lower_builtin(operation, Vector, Vector)(lower)
    for scalar in _SCALARS:
        lower_builtin(operation, Vector, scalar)(lower)
        lower_builtin(operation, scalar, Vector)(lower)


def _same(vector):
    return vector


def _by_kind(on_floats: str, on_integers: str):
    def build(builder, vector, a, b):
        return getattr(builder, on_floats if isinstance(vector, FloatVector) else on_integers)(a, b)

    return build


def _comparison(sign: str):
    def build(builder, vector, a, b):
        if isinstance(vector, FloatVector):
            return (builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered)(sign, a, b)
        return (builder.icmp_signed if vector is I32 else builder.icmp_unsigned)(sign, a, b)

    return build


def _smaller_or_larger(sign: str):
    """As Numba does it of scalars: where neither is smaller, as beside what is no number, it is the first one."""
    less = _comparison(sign)
    return lambda builder, vector, a, b: builder.select(less(builder, vector, b, a), b, a)


def _shift_right(builder, vector, a, b):
    return (builder.ashr if vector is I32 else builder.lshr)(a, b)


_NUMBERS, _BITS = (FloatVector, IntVector), (IntVector, MaskVector)
for _names, _kinds, _build in (
    (("add", "iadd"), _NUMBERS, _by_kind("fadd", "add")),
    (("sub", "isub"), _NUMBERS, _by_kind("fsub", "sub")),
    (("mul", "imul"), _NUMBERS, _by_kind("fmul", "mul")),
    (("truediv", "itruediv"), FloatVector, _by_kind("fdiv", "")),
    (("and_", "iand"), _BITS, _by_kind("", "and_")),
    (("or_", "ior"), _BITS, _by_kind("", "or_")),
    (("xor", "ixor"), _BITS, _by_kind("", "xor")),
    (("lshift", "ilshift"), IntVector, _by_kind("", "shl")),
    (("rshift", "irshift"), IntVector, _shift_right),
):
    for _name in _names:
        _binary(getattr(operator, _name), _kinds, _same, _build)
for _name, _sign in (("lt", "<"), ("le", "<="), ("gt", ">"), ("ge", ">=")):
    _binary(getattr(operator, _name), _NUMBERS, lambda vector: MASK, _comparison(_sign))
for _name, _sign in (("eq", "=="), ("ne", "!=")):
    _binary(getattr(operator, _name), (*_NUMBERS, MaskVector), lambda vector: MASK, _comparison(_sign))
_binary(min, _NUMBERS, _same, _smaller_or_larger("<"))
_binary(max, _NUMBERS, _same, _smaller_or_larger(">"))
_binary(
    math.copysign,
    FloatVector,
    _same,
    lambda builder, vector, a, b: call(builder, f"llvm.copysign.{vector.suffix}", vector.llvm, [a, b]),
)


def _unary(operation, build, kinds=FloatVector) -> None:
    @infer_global(operation)
    class _(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 1 and isinstance(args[0], kinds):
                return signature(args[0], args[0])
            return None

    lower_builtin(operation, Vector)(lambda context, builder, sig, args: build(builder, sig.args[0], args[0]))


def _llvm(name: str):
    return lambda builder, vector, x: call(builder, f"llvm.{name}.{vector.suffix}", vector.llvm, [x])


def _negated(builder, vector, x):
    if isinstance(vector, FloatVector):
        return builder.fsub(filled(vector, -0.0), x)
    return builder.sub(filled(vector, 0), x)


_unary(math.sqrt, _llvm("sqrt"))
_unary(abs, _llvm("fabs"))
_unary(operator.neg, _negated, _NUMBERS)


# --- instead of `if` and `not` ---------------------------------------------------------------------------------------


def _selected(typing_context, condition, a, b):
    """The type of `select`."""
    if isinstance(a, types.BaseTuple) and isinstance(b, types.BaseTuple) and len(a) == len(b):
        return types.Tuple([_selected(typing_context, condition, x, y) for x, y in zip(a, b, strict=True)])
    a, b = plain(a), plain(b)
    if isinstance(condition, Vector) and _vector_of((a, b)) is None:
        result = next((vector for vector in (F32, F64, I32, U32, MASK) if vector.element == a == b), None)
    else:
        result = typing_context.unify_pairs(a, b)
    if result is None:
        raise TypingError(f"select between {a} and {b}: cast them to one type that there are vectors of")
    return result


def _select(context, builder, result, types_, values):
    if isinstance(result, types.BaseTuple):
        parts = [
            _select(
                context,
                builder,
                ty,
                (types_[0], types_[1][i], types_[2][i]),
                (values[0], *(builder.extract_value(value, i) for value in values[1:])),
            )
            for i, ty in enumerate(result)
        ]
        return context.make_tuple(builder, result, parts)
    a, b = (context.cast(builder, value, ty, result) for value, ty in zip(values[1:], types_[1:], strict=True))
    if isinstance(types_[0], Vector):
        return builder.select(values[0], a, b)
    condition = context.cast(builder, values[0], types_[0], types.boolean)
    return builder.select(builder.trunc(condition, I1) if condition.type != I1 else condition, a, b)


@intrinsic
def select(typing_context, condition, a, b):
    """a where `condition` holds, else b: of scalars, vectors and tuples of them. Both are calculated."""
    result = _selected(typing_context, condition, a, b)

    def codegen(context, builder, sig, args):
        return _select(context, builder, sig.return_type, sig.args, args)

    return result(condition, a, b), codegen


@intrinsic
def no(typing_context, condition):
    """`not condition`."""

    def codegen(context, builder, sig, args):
        if sig.args[0] == MASK:
            return builder.xor(args[0], filled(MASK, 1))
        return builder.icmp_unsigned("==", args[0], args[0].type(0))

    return (MASK if condition == MASK else types.boolean)(condition), codegen


_LANES = ir.IntType(WIDTH)


@intrinsic
def any_of(typing_context, condition):
    """Whether it holds in any lane; of a scalar, whether it holds."""

    def codegen(context, builder, sig, args):
        bits = builder.bitcast(args[0], _LANES) if sig.args[0] == MASK else args[0]
        return builder.icmp_unsigned("!=", bits, bits.type(0))

    return types.boolean(condition), codegen


@intrinsic
def spread(typing_context, value, mask):
    """`value` in the lanes of the mask, which has some, and that of the first of them in all others: where lanes that
    don't take part look something up, it is something that exists."""

    def codegen(context, builder, sig, args):
        bits = builder.zext(builder.bitcast(args[1], _LANES), I32_WORD)
        first = builder.extract_element(args[0], builder.cttz(bits, I1(0)))
        return builder.select(args[1], args[0], splat(builder, first, sig.args[0].llvm))

    return value(value, mask), codegen


@intrinsic
def count(typing_context, mask):
    """In how many lanes it holds."""

    def codegen(context, builder, sig, args):
        return builder.ctpop(builder.zext(builder.bitcast(args[0], _LANES), I64))

    return types.int64(mask), codegen


@intrinsic
def total(typing_context, numbers):
    """The sum of an integer vector's lanes; a scalar is its own."""

    def codegen(context, builder, sig, args):
        if not isinstance(sig.args[0], Vector):
            return context.cast(builder, args[0], sig.args[0], types.int64)
        name = f"llvm.vector.reduce.add.{sig.args[0].suffix}"
        return builder.sext(call(builder, name, I32_WORD, [args[0]]), I64)

    return types.int64(numbers), codegen


# --- casts -----------------------------------------------------------------------------------------------------------


def _cast(target: Vector, scalar, methods: dict, text: str):
    """A cast to a vector by the methods of LLVM's builder, by the vector's type; of a scalar to Numba's type."""

    def cast(typing_context, x):
        if isinstance(x, Vector):
            method = methods.get(x, "bitcast" if x == target else None)
            if method is None:
                return None
            return target(x), lambda c, builder, sig, args: getattr(builder, method)(args[0], target.llvm)
        return scalar(x), lambda c, builder, sig, args: c.cast(builder, args[0], sig.args[0], scalar)

    cast.__doc__ = text
    return intrinsic(cast)


float32 = _cast(F32, types.float32, {I32: "sitofp", U32: "uitofp", F64: "fptrunc"}, "As np.float32(x).")
float64 = _cast(F64, types.float64, {F32: "fpext"}, "As np.float64(x).")
int32 = _cast(I32, types.int32, {F32: "fptosi", F64: "fptosi", U32: "bitcast"}, "As np.int32(x): towards zero.")
uint32 = _cast(U32, types.uint32, {I32: "bitcast"}, "As np.uint32(x): what is larger wraps.")
to_index = _cast(U32, types.int64, {I32: "bitcast"}, "An integer as the row of a table; not negative.")


@intrinsic
def floor(typing_context, x):
    """The largest whole number that is not above x, as a float: `math.floor` gives an integer of a scalar."""
    x = plain(x)

    def codegen(context, builder, sig, args):
        suffix = sig.args[0].suffix if isinstance(sig.args[0], Vector) else f"f{sig.args[0].bitwidth}"
        return call(builder, f"llvm.floor.{suffix}", args[0].type, [args[0]])

    return x(x), codegen


@intrinsic
def bits_of(typing_context, value):
    """The bits of float32 as int32."""
    result = I32 if value == F32 else types.int32

    def codegen(context, builder, sig, args):
        return builder.bitcast(args[0], context.get_value_type(sig.return_type))

    return result(value), codegen


@intrinsic
def float_of(typing_context, bits):
    """The float32 that has these bits."""
    result = F32 if isinstance(bits, Vector) else types.float32

    def codegen(context, builder, sig, args):
        return builder.bitcast(args[0], context.get_value_type(sig.return_type))

    return result(bits), codegen
