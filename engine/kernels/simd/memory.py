"""Between vectors and arrays: lanes side by side in a row, or one place of a table for each.

None of these checks an index.
"""

from __future__ import annotations

from llvmlite import ir
from llvmlite.ir import instructions
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

from .arithmetic import call, fits
from .types import F32, F64, I32, I32_WORD, I64, MASK, U32, WIDTH, Vector, filled, splat, widen

_VECTORS = {types.float32: F32, types.float64: F64, types.int32: I32, types.uint32: U32}
_BYTE = ir.IntType(8)
_EIGHT, _FRONTS = 8, "lobe_fronts"


def _vector_of(array) -> Vector:
    """Of numbers as this array has them."""
    if array.dtype not in _VECTORS:
        raise TypingError(f"vectors are of {', '.join(map(str, _VECTORS))}, not of {array.dtype}")
    return _VECTORS[array.dtype]


def _row_of(array) -> Vector:
    """What lies side by side in this array."""
    if array.layout != "C":
        raise TypingError(f"lanes lie side by side in a C array, not in {array}: look them up with `at`")
    return _vector_of(array)


def _stored(value, vector: Vector) -> Vector:
    """The vector, if the value can be written as one."""
    if not fits(value, vector):
        raise TypingError(f"{value} is not stored as {vector}: cast it, or take its `bits_of`")
    return vector


class _Places(instructions.Instruction):
    """A vector of pointers: `base` plus elements, by a vector of indices. llvmlite has only the scalar one."""

    def __init__(self, parent, base, index, element):
        super().__init__(parent, ir.VectorType(ir.PointerType(), WIDTH), "getelementptr", [base, index])
        self.element = element

    def descr(self, buf):
        base, index = self.operands
        buf.append(
            f"getelementptr {self.element}, {base.type} {base.get_reference()}, {index.type} {index.get_reference()}\n"
        )


def _array(context, builder, ty, value):
    return context.make_array(ty)(context, builder, value)


def _row_place(context, builder, sig, args):
    """Pointer to array[row, i] of a C array."""
    array = _array(context, builder, sig.args[0], args[0])
    row, i = (context.cast(builder, x, t, types.int64) for x, t in zip(args[1:3], sig.args[1:3], strict=True))
    offset = builder.mul(row, builder.extract_value(array.strides, 0))
    pointer = builder.gep(builder.bitcast(array.data, ir.PointerType()), [offset], source_etype=_BYTE)
    return builder.gep(pointer, [i], source_etype=_VECTORS[sig.args[0].dtype].llvm.element)


@intrinsic
def load(typing_context, array, row, i):
    """array[row, i : i + WIDTH]"""
    vector = _row_of(array)

    def codegen(context, builder, sig, args):
        return builder.load(_row_place(context, builder, sig, args), typ=vector.llvm, align=4)

    return vector(array, row, i), codegen


@intrinsic
def store(typing_context, array, row, i, value):
    """array[row, i : i + WIDTH] = value, a vector or a scalar for all lanes."""
    vector = _stored(value, _row_of(array))

    def codegen(context, builder, sig, args):
        lanes = widen(context, builder, args[3], sig.args[3], vector)
        place = builder.bitcast(_row_place(context, builder, sig, args), lanes.type.as_pointer())
        builder.store(lanes, place, align=4)
        return context.get_dummy_value()

    return types.void(array, row, i, value), codegen


def _part(context, builder, sig, args, number):
    """Pointer to array[number, row, 0], and the lanes of a vector that it holds, for `load_parts`."""
    array = _array(context, builder, sig.args[0], args[0])
    row = context.cast(builder, args[1], sig.args[1], types.int64)
    offset = builder.mul(row, builder.extract_value(array.strides, 1))
    offset = builder.add(offset, builder.mul(I64(number), builder.extract_value(array.strides, 0)))
    return builder.gep(builder.bitcast(array.data, ir.PointerType()), [offset], source_etype=_BYTE)


def _side_by_side(builder, parts: list):
    """Vectors, a power of two of them, as one."""
    while len(parts) > 1:
        both = ir.Constant(ir.VectorType(I32_WORD, 2 * parts[0].type.count), list(range(2 * parts[0].type.count)))
        parts = [builder.shuffle_vector(a, b, both) for a, b in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


@intrinsic
def load_parts(typing_context, array, row, width):
    """array[:, row, :] of parts that are `width` wide, a constant, and WIDTH together."""
    if not isinstance(width, types.IntegerLiteral):
        return None  # Numba then comes back with the constant
    vector, width = _row_of(array), width.literal_value

    def codegen(context, builder, sig, args):
        narrow = ir.VectorType(vector.llvm.element, width)
        places = [_part(context, builder, sig, args, number) for number in range(WIDTH // width)]
        parts = [builder.load(place, typ=narrow, align=4) for place in places]
        return _side_by_side(builder, parts)

    return vector(array, row, types.literal(width)), codegen


@intrinsic
def store_parts(typing_context, array, row, width, value):
    """array[:, row, :] = value: see `load_parts`."""
    if not isinstance(width, types.IntegerLiteral):
        return None
    vector, width = _stored(value, _row_of(array)), width.literal_value

    def codegen(context, builder, sig, args):
        lanes = widen(context, builder, args[3], sig.args[3], vector)
        for number in range(WIDTH // width):
            own = list(range(number * width, (number + 1) * width))
            part = builder.shuffle_vector(lanes, lanes, ir.Constant(ir.VectorType(I32_WORD, width), own))
            place = _part(context, builder, sig, args, number)
            builder.store(part, builder.bitcast(place, part.type.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, row, types.literal(width), value), codegen


@intrinsic
def first_lanes(typing_context, n):
    """The mask of the first n lanes; all if there are fewer than n."""

    def codegen(context, builder, sig, args):
        lanes = ir.Constant(U32.llvm, list(range(WIDTH)))
        n = widen(context, builder, args[0], sig.args[0], I32)
        return builder.icmp_signed("<", lanes, n)

    return MASK(n), codegen


@intrinsic
def lanes(typing_context):
    """0, 1, 2, ..."""
    return U32(), lambda context, builder, sig, args: ir.Constant(U32.llvm, list(range(WIDTH)))


@intrinsic
def store_front(typing_context, array, row, i, value, mask):
    """array[row, i : i + n] = the n lanes of the mask, a vector's. What lies behind them, up to i + WIDTH, is lost."""
    _stored(value, _row_of(array))

    def codegen(context, builder, sig, args):
        # As integers: LLVM 22 ends the process when it compresses floats for a processor without AVX-512.
        words = builder.bitcast(args[3], U32.llvm)
        place = _row_place(context, builder, sig, args)
        (_store_permuted if _has_permutes(context) else _store_compressed)(builder, words, args[4], place)
        return context.get_dummy_value()

    return types.void(array, row, i, value, mask), codegen


def _has_permutes(context) -> bool:
    """Whether the processor puts eight numbers into any order at once, and has no instruction that compresses."""
    features = context.codegen().magic_tuple()[2].split(",")
    return "+avx2" in features and "+avx512f" not in features


def _store_compressed(builder, words, mask, place) -> None:
    name = f"llvm.experimental.vector.compress.{U32.suffix}"
    front = call(builder, name, U32.llvm, [words, mask, filled(U32, 0)])
    builder.store(front, builder.bitcast(place, front.type.as_pointer()), align=4)


def _store_permuted(builder, words, mask, place) -> None:
    """Eight lanes after eight. Which of them come to the front, and in what order, is looked up by the bits of their
    mask: LLVM makes a single instruction of the extracts and inserts."""
    table = _fronts(builder.module)
    for first in range(0, WIDTH, _EIGHT):
        lanes = ir.Constant(ir.VectorType(I32_WORD, _EIGHT), list(range(first, first + _EIGHT)))
        part, own = (builder.shuffle_vector(of, of, lanes) for of in (words, mask))
        bits = builder.bitcast(own, _BYTE)
        entry = builder.gep(table, [I64(0), builder.zext(bits, I64)])
        order = builder.zext(builder.load(entry, align=_EIGHT), part.type)
        front = ir.Constant(part.type, ir.Undefined)
        for lane in range(_EIGHT):
            chosen = builder.extract_element(part, builder.extract_element(order, I32_WORD(lane)))
            front = builder.insert_element(front, chosen, I32_WORD(lane))
        builder.store(front, builder.bitcast(place, part.type.as_pointer()), align=4)
        place = builder.gep(place, [builder.zext(builder.ctpop(bits), I64)], source_etype=I32_WORD)


def _fronts(module) -> ir.GlobalVariable:
    """For each mask of eight lanes: their numbers, those of the mask first."""
    if _FRONTS not in module.globals:
        entry = ir.VectorType(_BYTE, _EIGHT)
        orders = [sorted(range(_EIGHT), key=lambda lane: not mask >> lane & 1) for mask in range(1 << _EIGHT)]
        table = ir.Constant(ir.ArrayType(entry, len(orders)), [ir.Constant(entry, order) for order in orders])
        variable = ir.GlobalVariable(module, table.type, _FRONTS)
        variable.linkage, variable.global_constant, variable.initializer = "private", True, table
    return module.globals[_FRONTS]


def _steps(builder, array, ty):
    """Of each index, how many elements lie between its places."""
    size = ty.dtype.bitwidth // 8
    for axis in range(ty.ndim):
        if axis == ty.ndim - 1 and ty.layout == "C":
            yield I64(1)
        else:
            yield builder.sdiv(builder.extract_value(array.strides, axis), I64(size))


def _place(context, builder, ty, value, index_types, indices):
    """A pointer to one of ty's elements."""
    array, element = _array(context, builder, ty, value), context.get_value_type(ty.dtype)
    place = builder.bitcast(array.data, ir.PointerType())
    for step, index_type, index in zip(_steps(builder, array, ty), index_types, indices, strict=True):
        offset = builder.mul(context.cast(builder, index, index_type, types.int64), step)
        place = builder.gep(place, [offset], source_etype=element)
    return place


def _lane_places(context, builder, ty, value, index_types, indices):
    """A vector of pointers to ty's elements. Scalar indices move the base; offsets of lanes are 32 bits wide."""
    array = _array(context, builder, ty, value)
    element = context.get_value_type(ty.dtype)
    base, lanes = builder.bitcast(array.data, ir.PointerType()), None
    for step, index_type, index in zip(_steps(builder, array, ty), index_types, indices, strict=True):
        if isinstance(index_type, Vector):
            term = index
            if not isinstance(step, ir.Constant):
                term = builder.mul(index, splat(builder, builder.trunc(step, I32_WORD), U32.llvm))
            lanes = term if lanes is None else builder.add(lanes, term)
        else:
            offset = builder.mul(context.cast(builder, index, index_type, types.int64), step)
            base = builder.gep(base, [offset], source_etype=element)
    places = _Places(builder.block, base, lanes, element)
    builder._insert(places)
    return places


def _gather(builder, vector, places, mask, bits):
    """LLVM's masked gather, its alignment as an operand: as LLVM took it before 22, which still reads that."""
    llvm = ir.VectorType(ir.IntType(8), WIDTH) if bits == 8 else vector.llvm
    name = f"llvm.masked.gather.{f'v{WIDTH}i8' if bits == 8 else vector.suffix}.v{WIDTH}p0"
    shape = ir.FunctionType(llvm, [places.type, I32_WORD, mask.type, llvm])
    function = cgutils.get_or_insert_function(builder.module, shape, name)
    found = builder.call(function, [places, I32_WORD(bits // 8), mask, ir.Constant(llvm, ir.Undefined)])
    return builder.zext(found, vector.llvm) if bits == 8 else found


@intrinsic
def at(typing_context, array, *indices):
    """array[indices]: one place for each lane where an index is a vector. Every lane's place must exist."""
    given = types.StarArgTuple.from_types(indices)
    result = array.dtype
    if any(isinstance(index, Vector) for index in indices):
        result = U32 if result == types.uint8 else _vector_of(array)

    def codegen(context, builder, sig, args):
        ty, index_types = sig.args[0], list(sig.args[1])
        indices = [builder.extract_value(args[1], i) for i in range(len(index_types))]
        if isinstance(sig.return_type, Vector):
            places = _lane_places(context, builder, ty, args[0], index_types, indices)
            return _gather(builder, sig.return_type, places, ir.Constant(MASK.llvm, [1] * WIDTH), ty.dtype.bitwidth)
        place = _place(context, builder, ty, args[0], index_types, indices)
        return builder.load(place, typ=context.get_value_type(ty.dtype), align=ty.dtype.bitwidth // 8)

    return result(array, given), codegen


def _transposed(builder, rows: list) -> list:
    """WIDTH rows of as many words or fewer, a power of two, as their columns: by rounds of shuffles of two."""
    count = rows[0].type.count
    # Of fewer words several rows fit a vector: those that `count` lies between.
    together = [_side_by_side(builder, rows[i::count]) for i in range(count)]
    bit = 1
    while bit < count:
        low = ir.Constant(U32.llvm, [k if not k & bit else WIDTH + k - bit for k in range(WIDTH)])
        high = ir.Constant(U32.llvm, [k + bit if not k & bit else WIDTH + k for k in range(WIDTH)])
        for i in range(count):
            if not i & bit:
                a, b = together[i], together[i | bit]
                together[i], together[i | bit] = builder.shuffle_vector(a, b, low), builder.shuffle_vector(a, b, high)
        bit *= 2
    return together


@intrinsic
def words_at(typing_context, array, first, count):
    """`count` words of a C array, a constant power of two, from its word `first` on. All
    of them must exist: a table of rows of three has memory for a fourth behind its last. For vectors each
    lane's are one load, and the lot of them is turned about: that takes half the time of looking up each word."""
    if not isinstance(count, types.IntegerLiteral):
        return None  # Numba then comes back with the constant
    words = _row_of(array) if isinstance(first, Vector) else array.dtype
    result, number = types.UniTuple(words, count.literal_value), count.literal_value

    def codegen(context, builder, sig, args):
        array = _array(context, builder, sig.args[0], args[0])
        base, element = builder.bitcast(array.data, ir.PointerType()), context.get_value_type(sig.args[0].dtype)
        if isinstance(sig.args[1], Vector):
            lanes = [builder.zext(builder.extract_element(args[1], I32_WORD(lane)), I64) for lane in range(WIDTH)]
            row, found = ir.VectorType(element, min(number, WIDTH)), []
            for word in range(0, number, WIDTH):
                places = [builder.gep(base, [builder.add(lane, I64(word))], source_etype=element) for lane in lanes]
                found += _transposed(builder, [builder.load(place, typ=row, align=4) for place in places])
            return context.make_tuple(builder, sig.return_type, found)
        start = builder.gep(base, [context.cast(builder, args[1], sig.args[1], types.int64)], source_etype=element)
        places = [builder.gep(start, [I64(word)], source_etype=element) for word in range(number)]
        found = [builder.load(place, typ=element, align=4) for place in places]
        return context.make_tuple(builder, sig.return_type, found)

    return result(array, first, types.literal(number)), codegen


def _scatter(builder, vector, places, value, mask):
    """As `_gather`."""
    shape = ir.FunctionType(ir.VoidType(), [vector.llvm, places.type, I32_WORD, mask.type])
    name = f"llvm.masked.scatter.{vector.suffix}.v{WIDTH}p0"
    function = cgutils.get_or_insert_function(builder.module, shape, name)
    builder.call(function, [value, places, I32_WORD(4), mask])


@intrinsic
def put_at(typing_context, array, place, value, mask):
    """array[place] = value where the mask says so, of one number or in lanes whose places differ. Words of 4 bytes."""
    if isinstance(mask, Vector):
        _stored(value, _vector_of(array))

    def codegen(context, builder, sig, args):
        ty, element = sig.args[0], sig.args[0].dtype
        index_types, indices = [sig.args[1]], [args[1]]
        if isinstance(sig.args[1], types.BaseTuple):
            index_types = list(sig.args[1])
            indices = [builder.extract_value(args[1], i) for i in range(ty.ndim)]
        if any(isinstance(index, Vector) for index in index_types):
            places, vector = _lane_places(context, builder, ty, args[0], index_types, indices), _VECTORS[element]
            lanes_on = widen(context, builder, args[3], sig.args[3], MASK)
            _scatter(builder, vector, places, widen(context, builder, args[2], sig.args[2], vector), lanes_on)
            return context.get_dummy_value()
        with builder.if_then(context.cast(builder, args[3], sig.args[3], types.boolean)):
            value = context.cast(builder, args[2], sig.args[2], element)
            place = _place(context, builder, ty, args[0], index_types, indices)
            builder.store(value, builder.bitcast(place, value.type.as_pointer()))
        return context.get_dummy_value()

    return types.void(array, place, value, mask), codegen


@intrinsic
def add_at(typing_context, array, row, index, value, mask):
    """array[row, index] += value in the lanes of the mask, whose indices all differ. float32."""
    _stored(value, F32), _stored(F32, _vector_of(array))

    def codegen(context, builder, sig, args):
        places = _lane_places(context, builder, sig.args[0], args[0], sig.args[1:3], args[1:3])
        old = _gather(builder, F32, places, args[4], 32)
        value = widen(context, builder, args[3], sig.args[3], F32)
        _scatter(builder, F32, places, builder.fadd(old, value), args[4])
        return context.get_dummy_value()

    return types.void(array, row, index, value, mask), codegen
