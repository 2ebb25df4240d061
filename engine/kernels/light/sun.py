"""Suns: a direction, or a uniform cone of directions."""

from __future__ import annotations

import math

import numpy as np

from ..geom.frame import to_world
from ..geom.vec import BLACK, ONE, ZERO, dot, sub
from ..jit import device
from ..tables import SUN_AXIS, SUN_ONE_MINUS_COS, SUN_RADIANCE

TWO_PI = np.float32(2 * math.pi)
TWO = np.float32(2)


@device
def _axis(suns, i):
    return suns[i, SUN_AXIS], suns[i, SUN_AXIS + 1], suns[i, SUN_AXIS + 2]


@device
def _radiance(suns, i):
    return suns[i, SUN_RADIANCE], suns[i, SUN_RADIANCE + 1], suns[i, SUN_RADIANCE + 2]


@device
def sample_sun(suns, i, u1, u2):
    """(wi, radiance, pdf, delta): for a sun without an angle the irradiance and pdf = 1."""
    one_minus_cos = suns[i, SUN_ONE_MINUS_COS]
    if one_minus_cos <= ZERO:
        return _axis(suns, i), _radiance(suns, i), ONE, True
    drop = u1 * one_minus_cos
    sine = math.sqrt(drop * (TWO - drop))
    phi = TWO_PI * u2
    wi = to_world((sine * math.cos(phi), sine * math.sin(phi), ONE - drop), _axis(suns, i))
    return wi, _radiance(suns, i), ONE / (TWO_PI * one_minus_cos), False


@device
def sun_seen(suns, i, wi):
    """(radiance, pdf) along wi; black beside the disk. |wi - axis|^2 / 2 = 1 - cos keeps small angles exact."""
    one_minus_cos = suns[i, SUN_ONE_MINUS_COS]
    off = sub(wi, _axis(suns, i))
    if dot(off, off) > TWO * one_minus_cos or one_minus_cos <= ZERO:
        return BLACK, ZERO
    return _radiance(suns, i), ONE / (TWO_PI * one_minus_cos)
