"""Elementary functions of float32, where the C library's are slow: they do not inline and reduce any argument.

The polynomials are minimax fits in relative error (weighted least squares at Chebyshev nodes, float64); the fit's
error is in each docstring, float32 rounding adds about 1e-7.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import device
from ..simd import any_of, bits_of, float32, float_of, floor, int32, select
from .vec import ONE

_LOG = tuple(
    np.float32(c) for c in (-1.0, -0.49999669, -0.33350438, -0.24671064, -0.22955219, -0.03542827, -0.40521616)
)
_LOG_1_PLUS = tuple(
    np.float32(c)
    for c in (0.33333354, -0.25000852, 0.19999827, -0.1662137, 0.14227114, -0.13202104, 0.12620327, -0.073628679)
)
_ROOT_HALF_BITS, _FRACTION_BITS = np.int32(0x3F3504F3), np.int32(23)
_LN_2, _LOG2_E = np.float32(math.log(2)), np.float32(1 / math.log(2))
_LN_2_HIGH, _LN_2_LOW = np.float32(0.693359375), np.float32(math.log(2) - 0.693359375)
_EXPONENTIAL = tuple(np.float32(c) for c in (0.50000001, 0.16666516, 0.041666263, 0.0083691589, 0.0013946458))
_EXPONENT_BIAS, _LEAST_EXPONENT = np.int32(127), np.float32(-87)
_LOG_LIMIT = np.float32(0.3)
_EXP = tuple(np.float32(c) for c in (-1.0, -0.49999684, -0.16660433, -0.041229423, -0.0070571909))
_EXP_LIMIT = np.float32(-0.4)
_SIN = tuple(np.float32(c) for c in (1.0, -0.16666651, 0.0083320169, -0.00019501822))
_COS = tuple(np.float32(c) for c in (0.99999994, -0.49999842, 0.041654419, -0.0013579404))
_SIN_DOUBLE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(1, 8))
_COS_DOUBLE = tuple((-1) ** k / math.factorial(2 * k) for k in range(1, 8))
_TWO_BY_PI, _HALF_PI_DOUBLE = 2 / math.pi, math.pi / 2
_FOUR = np.float32(4)
_HALF = np.float32(0.5)
_HALF_PI = np.float32(math.pi / 2)


@device
def exp(x):
    """exp(x) for x <= 0; 6e-9. Below -87, where it would be no normal float32, exp(-87)."""
    x = max(x, _LEAST_EXPONENT)
    power = floor(x * _LOG2_E + _HALF)
    r = (x - power * _LN_2_HIGH) - power * _LN_2_LOW
    c = _EXPONENTIAL
    fraction = ONE + r + r * r * (c[0] + r * (c[1] + r * (c[2] + r * (c[3] + r * c[4]))))
    return fraction * float_of(int32((int32(power) + _EXPONENT_BIAS) << _FRACTION_BITS))


@device
def log(x):
    """log(x) for normal x > 0; 7e-9. As x = 2^power (1 + r) with 1 + r within sqrt(2) of 1."""
    bits = bits_of(x)
    power = int32(int32(bits - _ROOT_HALF_BITS) >> _FRACTION_BITS)
    r = float_of(int32(bits - (power << _FRACTION_BITS))) - ONE
    c = _LOG_1_PLUS
    tail = c[4] + r * (c[5] + r * (c[6] + r * c[7]))
    tail = r * r * r * (c[0] + r * (c[1] + r * (c[2] + r * (c[3] + r * tail))))
    return r + (tail - _HALF * r * r) + float32(power) * _LN_2


@device
def log_one_minus(x):
    """log(1 - x) for x in [0, 1), precise for small x; 1e-8."""
    c = _LOG
    near = x * (c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * (c[5] + x * c[6]))))))
    far = x > _LOG_LIMIT
    if any_of(far):
        near = select(far, log(ONE - x), near)
    return near


@device
def one_minus_exp(x):
    """1 - exp(x) for x <= 0, precise for small x; 3e-8."""
    c = _EXP
    near = x * (c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4]))))
    far = x < _EXP_LIMIT
    if any_of(far):
        near = select(far, ONE - exp(x), near)
    return near


@device
def sin_cos_acute(x):
    """(sin x, cos x) for |x| <= pi / 4; 3e-8."""
    z = x * x
    s, c = _SIN, _COS
    return x * (s[0] + z * (s[1] + z * (s[2] + z * s[3]))), c[0] + z * (c[1] + z * (c[2] + z * c[3]))


@device
def sin_cos_turn(u):
    """(sin 2 pi u, cos 2 pi u); digits are lost as |u| grows beyond 1."""
    quarters = _FOUR * u
    nearest = floor(quarters + _HALF)
    s, c = sin_cos_acute((quarters - nearest) * _HALF_PI)
    return _turned_by_quarters(int32(nearest), s, c)


@device
def _turned_by_quarters(k, s, c):
    """The sine and cosine of an angle that is k right angles more than that of the sine s and the cosine c."""
    odd = k & np.int32(1) != np.int32(0)
    back = k & np.int32(2) != np.int32(0)
    left = (k + np.int32(1)) & np.int32(2) != np.int32(0)
    sine, cosine = select(odd, c, s), select(odd, s, c)
    return select(back, -sine, sine), select(left, -cosine, cosine)


@device
def sin_cos_double(x):
    """(sin x, cos x) of a float64 in [0, 7], to its last digits but two: Taylor's series in a quarter turn about 0."""
    k = floor(x * _TWO_BY_PI + 0.5)
    r = x - k * _HALF_PI_DOUBLE
    z = r * r
    s, c = _SIN_DOUBLE, _COS_DOUBLE
    sine = r + r * z * (s[0] + z * (s[1] + z * (s[2] + z * (s[3] + z * (s[4] + z * s[5])))))
    cosine = 1.0 + z * (c[0] + z * (c[1] + z * (c[2] + z * (c[3] + z * (c[4] + z * (c[5] + z * c[6]))))))
    return _turned_by_quarters(int32(k), sine, cosine)
