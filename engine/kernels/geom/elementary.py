"""Elementary functions of float32, where the C library's are slow: they do not inline and reduce any argument.

The polynomials are minimax fits in relative error (weighted least squares at Chebyshev nodes, float64); the fit's
error is in each docstring, float32 rounding adds about 1e-7. `math.exp` and `math.log` of float32 are fast enough
(1.7 ns against 8.6 for `math.log1p` and 6.0 for `math.expm1`).
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import device
from .vec import ONE

_LOG = tuple(
    np.float32(c) for c in (-1.0, -0.49999669, -0.33350438, -0.24671064, -0.22955219, -0.03542827, -0.40521616)
)
_LOG_LIMIT = np.float32(0.3)
_EXP = tuple(np.float32(c) for c in (-1.0, -0.49999684, -0.16660433, -0.041229423, -0.0070571909))
_EXP_LIMIT = np.float32(-0.4)
_SIN = tuple(np.float32(c) for c in (1.0, -0.16666651, 0.0083320169, -0.00019501822))
_COS = tuple(np.float32(c) for c in (0.99999994, -0.49999842, 0.041654419, -0.0013579404))
_FOUR = np.float32(4)
_HALF = np.float32(0.5)
_HALF_PI = np.float32(math.pi / 2)


@device
def log_one_minus(x):
    """log(1 - x) for x in [0, 1), precise for small x; 1e-8."""
    if x > _LOG_LIMIT:
        return math.log(ONE - x)
    c = _LOG
    return x * (c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * (c[5] + x * c[6]))))))


@device
def one_minus_exp(x):
    """1 - exp(x) for x <= 0, precise for small x; 3e-8."""
    if x < _EXP_LIMIT:
        return ONE - math.exp(x)
    c = _EXP
    return x * (c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4]))))


@device
def sin_cos_acute(x):
    """(sin x, cos x) for |x| <= pi / 4; 3e-8."""
    z = x * x
    s, c = _SIN, _COS
    return x * (s[0] + z * (s[1] + z * (s[2] + z * s[3]))), c[0] + z * (c[1] + z * (c[2] + z * c[3]))


@device
def sin_cos_turn(u):
    """(sin 2 pi u, cos 2 pi u) for u in [0, 1]."""
    quarters = _FOUR * u
    nearest = np.floor(quarters + _HALF)
    s, c = sin_cos_acute((quarters - nearest) * _HALF_PI)
    k = np.int32(nearest)
    odd = k & np.int32(1) != np.int32(0)
    sine, cosine = (c if odd else s), (s if odd else c)
    back = k & np.int32(2) != np.int32(0)
    left = (k + np.int32(1)) & np.int32(2) != np.int32(0)
    return -sine if back else sine, -cosine if left else cosine
