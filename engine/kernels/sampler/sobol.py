"""Low-discrepancy numbers from a table: Sobol points of two dimensions with the randomness of Owen scrambling.

Every decision of a path (a light's point, a lobe's direction, ...) takes its own `dimension`, which stands for a
pair of numbers. A pixel's samples 0, 1, 2, ... of one dimension are a randomised (0,2)-sequence: each aligned block
of 2^k of them, k <= TABLE_BITS, has one point in each elementary interval of area 2^-k. Dimensions are padded
(Kollig & Keller 2002): between them, and between pixels, the order of the samples is shuffled independently.

- The table holds Owen-scrambled points (Owen 1995), the same for all renders: their seeds are in the hashes of pixels.
- The order is shuffled by a hash that keeps the tree of bits (Laine & Karras 2011; Burley 2020, "Practical
  Hash-based Owen Scrambling"): a block of 2^k samples stays a block of 2^k points. Shuffling by xor alone leaves the
  first bits of two dimensions in step: measured on a path-like integrand, three times the variance of independent
  numbers at 64 samples.
- The values are shifted by xor with a hash of pixel, dimension and block. Any number of samples may be drawn:
  each further block of 2^TABLE_BITS gets another shuffle and another shift.

What it gains over independent numbers is the trial "tabulated Owen-scrambled Sobol points" of benchmarks/trials.py.
Hashed Owen scrambling of every number (Burley 2020) gains a little less and costs two to three times as much; joint
four-dimensional points for light and direction gain no more, so pairs suffice.

`start_sample` once for each path, then `sample_1d` and `sample_2d`. Results lie in the open interval (0, 1).
"""

from __future__ import annotations

import numpy as np

from ..jit import device
from ..simd import at, to_index, uint32
from .random import hash32, to_unit

TABLE_BITS = 12
TABLE_SIZE = 1 << TABLE_BITS
COORDINATE_BITS = 16  # stored for each coordinate; what follows them is noise that the shift supplies

_INDEX_SHIFT = np.uint32(32 - TABLE_BITS)
_BLOCK_MASK = np.uint32((1 << (32 - TABLE_BITS)) - 1)
_HIGH = np.uint32(0xFFFF0000)
_16 = np.uint32(16)
_MASKS = tuple(np.uint32(m) for m in (0x55555555, 0x33333333, 0x0F0F0F0F, 0x00FF00FF))
_1, _2, _4, _8 = np.uint32(1), np.uint32(2), np.uint32(4), np.uint32(8)

TABLE_PAIRS = 4
_PAIR_MASK = TABLE_PAIRS - 1
_GOLDEN = np.uint32(0x9E3779B9)
_SECOND = np.uint32(0xC2B2AE3D)
_SHUFFLE_1, _SHUFFLE_2 = np.uint32(0x05526C56), np.uint32(0x53A22864)


@device
def reverse_bits(x):
    """The bits of a uint32 from last to first."""
    x = uint32(((x >> _1) & _MASKS[0]) | uint32((x & _MASKS[0]) << _1))
    x = uint32(((x >> _2) & _MASKS[1]) | uint32((x & _MASKS[1]) << _2))
    x = uint32(((x >> _4) & _MASKS[2]) | uint32((x & _MASKS[2]) << _4))
    x = uint32(((x >> _8) & _MASKS[3]) | uint32((x & _MASKS[3]) << _8))
    return uint32((x >> _16) | uint32(x << _16))


@device
def hash_pixel(x, y, seed):
    """What makes this pixel's numbers its own: a uint32 for integers x, y and the render's seed."""
    line = hash32(uint32(uint32(y) + hash32(uint32(seed))))
    return hash32(uint32(uint32(x) + line))


@device
def start_sample(pixel_hash, index):
    """(key, order) of sample `index` = 0, 1, ... of a pixel, which `sample_1d` and `sample_2d` take."""
    order = reverse_bits(uint32(index))
    return hash32(uint32(pixel_hash + (order & _BLOCK_MASK))), order


@device
def _shuffle(order, seed):
    """Nested uniform shuffle of an index whose bits are reversed: a bit changes with the bits below it only.

    Multipliers by Laine & Karras 2011; two rounds do here, since the table's points are scrambled already.
    """
    x = uint32(order + seed)
    x = uint32(x ^ uint32(x * _SHUFFLE_1))
    return uint32(x ^ uint32(x * _SHUFFLE_2))


@device
def sample_2d(table, key, order, dimension):
    """Two numbers in (0, 1) for this decision of the path."""
    first = hash32(uint32(key + uint32(dimension) * _GOLDEN))
    second = uint32(first * _SECOND)
    point = at(table, dimension & _PAIR_MASK, to_index(_shuffle(order, first) >> _INDEX_SHIFT))
    return to_unit(uint32((point & _HIGH) ^ first)), to_unit(uint32(uint32(point << _16) ^ second))


@device
def sample_1d(table, key, order, dimension):
    """One number in (0, 1) for this decision of the path: the first of `sample_2d`."""
    first = hash32(uint32(key + uint32(dimension) * _GOLDEN))
    point = at(table, dimension & _PAIR_MASK, to_index(_shuffle(order, first) >> _INDEX_SHIFT))
    return to_unit(uint32((point & _HIGH) ^ first))


def build_sobol_table(seed: int = 0) -> np.ndarray:
    """(TABLE_PAIRS, TABLE_SIZE) uint32: x in the high 16 bits, y in the low 16, in order of reversed index bits."""
    generator = np.random.default_rng(seed & 0xFFFFFFFFFFFFFFFF)
    index = np.arange(TABLE_SIZE, dtype=np.uint32)
    x = np.zeros(TABLE_SIZE, np.uint32)
    y = np.zeros(TABLE_SIZE, np.uint32)
    direction = 1 << (COORDINATE_BITS - 1)
    for bit in range(TABLE_BITS):
        is_set = (index >> np.uint32(bit)) & _1
        x |= is_set << np.uint32(COORDINATE_BITS - 1 - bit)
        y ^= is_set * np.uint32(direction)
        direction ^= direction >> 1  # the second Sobol dimension: Pascal's triangle modulo 2
    reversed_index = x >> np.uint32(COORDINATE_BITS - TABLE_BITS)
    table = np.empty((TABLE_PAIRS, TABLE_SIZE), np.uint32)
    for pair in table:
        pair[:] = ((_owen_scramble(x, generator) << _16) | _owen_scramble(y, generator))[reversed_index]
    return table


def _owen_scramble(values: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Flip each bit of the 16-bit `values` by a coin of its own for every combination of the bits above it."""
    result = values.copy()
    for bit in range(COORDINATE_BITS):
        coins = generator.integers(0, 2, 1 << bit, dtype=np.uint32)
        prefix = values >> np.uint32(COORDINATE_BITS - bit)
        result ^= coins[prefix] << np.uint32(COORDINATE_BITS - 1 - bit)
    return result
