"""Independent pseudo-random numbers, for the few decisions that need unboundedly many of them.

The generator is PCG RXS-M-XS of 32 bits (O'Neill 2014): a state of one uint32, which the caller carries.
"""

from __future__ import annotations

import numpy as np

from ..jit import device
from ..simd import float32, int32, uint32

_MULTIPLIER = np.uint32(747796405)
_INCREMENT = np.uint32(2891336453)
_OUTPUT = np.uint32(277803737)
_HASH_1 = np.uint32(0x7FEB352D)
_HASH_2 = np.uint32(0x846CA68B)
_STEP = np.float32(2.0**-24)


@device
def to_unit(bits):
    """A uint32 as a float32 in the OPEN interval (0, 1): the odd multiples of 2^-24, so log(u) is always finite."""
    return float32(int32((uint32(bits) >> np.uint32(8)) | np.uint32(1))) * _STEP


@device
def hash32(x):
    """A bijection of uint32 that looks random: Wellons' lowbias32 (2018)."""
    x = uint32(x)
    x = uint32(x ^ (x >> np.uint32(16)))
    x = uint32(x * _HASH_1)
    x = uint32(x ^ (x >> np.uint32(15)))
    x = uint32(x * _HASH_2)
    return uint32(x ^ (x >> np.uint32(16)))


@device
def random_1d(state):
    """(u in (0, 1), new state)."""
    word = uint32(uint32((state >> uint32((state >> np.uint32(28)) + np.uint32(4))) ^ state) * _OUTPUT)
    word = uint32((word >> np.uint32(22)) ^ word)
    return to_unit(word), uint32(state * _MULTIPLIER + _INCREMENT)
