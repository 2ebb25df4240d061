"""The modified Phong lobe of Lafortune & Willems 1994: f = ks (n + 2) / (2 pi) cos^n(alpha).

alpha is the angle between wi and the mirror direction of wo, n the exponent, from 0 to 1e8. The lobe loses the
energy that it would send below the horizon, so its albedo falls off towards grazing angles (`phong_albedo`), where a
real mirror's rises to 1.
"""

from __future__ import annotations

import math

import numpy as np

from ..geom.elementary import exp, log, log_one_minus, one_minus_exp, sin_cos_turn
from ..geom.frame import to_world
from ..geom.vec import ONE, TWO, TWO_PI, ZERO, reflect
from ..jit import device
from ..sampler.warp import INV_TWO_PI
from ..simd import select

_HALF = np.float32(0.5)
_THREE, _FOUR = np.float32(3), np.float32(4)
_EIGHTH = np.float32(1 / 8)
_SMALL_N = np.float32(4 - math.pi)  # makes a(0) = 1/2 exact
_NOTHING = np.float32(87)  # exp(-87) is about the smallest normal float32


@device
def phong_lobe(exponent, mirror, wi):
    """cos^n(alpha) / (2 pi), to be multiplied by n + 2 for f / ks and by n + 1 for the pdf.

    cos(alpha) = 1 - |wi - R|^2 / 2, so that small angles are not lost in the rounding of a dot product.
    """
    x, y, z = wi[0] - mirror[0], wi[1] - mirror[1], wi[2] - mirror[2]
    drop = _HALF * (x * x + y * y + z * z)
    nothing = (drop >= ONE) | (exponent * drop > _NOTHING)
    return select(nothing, ZERO, INV_TWO_PI * exp(exponent * log_one_minus(drop)))


@device
def sample_phong(exponent, n, wo, u1, u2):
    """wi about the mirror direction with pdf (n + 1) / (2 pi) cos^n(alpha); may lie below the surface.

    cos(alpha) = u1^(1 / (n + 1)), by way of 1 - cos(alpha): the sine of a cosine rounded to float32 would be off by
    18 % at n = 1e6.
    """
    drop = one_minus_exp(log(u1) / (exponent + ONE))
    radius = math.sqrt(drop * (TWO - drop))
    s, c = sin_cos_turn(u2)
    return to_world((radius * c, radius * s, ONE - drop), reflect(wo, n))


@device
def phong_albedo(exponent, cos_o):
    """Approximate directional albedo of the lobe with ks = 1.

    The lobe is a bell of width sigma ~ 1 / sqrt(n) about R, cut off at the horizon, so the albedo is cos_o plus what
    the cut adds: a(n) ~ 1 / sqrt(2 pi (n + 1/2)) at grazing, falling with slope 1/2 and gone beyond some three sigma.
    Here it falls as (1 - cos_o / w)^m with m = min(4, 1 / (2 a)), w = 2 m a, which is exact for n = 0 and n = 2.
    Error: below 1.3 % for all exponents and angles against quadrature, 0 at normal incidence.
    """
    inverse = math.sqrt(TWO_PI * (exponent + _HALF) + _SMALL_N / (exponent + ONE))  # 1 / a(n)
    cos_o = max(cos_o, ZERO)
    s = max(ONE - cos_o * max(ONE, inverse * _EIGHTH), ZERO)
    # s^power, linear between whole powers.
    power = min(inverse * _HALF, _FOUR)
    product = s * select(power >= TWO, s, ONE) * select(power >= _THREE, s, ONE)
    rest = power - select(power >= _THREE, _THREE, select(power >= TWO, TWO, ONE))
    return cos_o + product * (ONE + rest * (s - ONE)) / inverse
