"""Suns: a direction, or a uniform cone of directions."""

from __future__ import annotations

import numpy as np

from ..geom.frame import to_world
from ..geom.vec import BLACK, ONE, TWO, ZERO, dot, sub
from ..jit import device
from ..sampler.warp import uniform_cone, uniform_cone_pdf
from ..simd import at, no, select
from ..tables import SUN_AXIS, SUN_COS, SUN_IRRADIANCE, SUN_ONE_MINUS_COS, SUN_RADIANCE, SUN_SIN
from .tree import mean_cosine


@device
def _axis(suns, i):
    return at(suns, i, SUN_AXIS), at(suns, i, SUN_AXIS + 1), at(suns, i, SUN_AXIS + 2)


@device
def _radiance(suns, i):
    return at(suns, i, SUN_RADIANCE), at(suns, i, SUN_RADIANCE + 1), at(suns, i, SUN_RADIANCE + 2)


@device
def sun_importance(suns, i, n):
    """About the irradiance on a plane with normal n; 0 only where the whole disk is below its horizon."""
    return suns[i, SUN_IRRADIANCE] * mean_cosine(dot(n, _axis(suns, i)), suns[i, SUN_COS], suns[i, SUN_SIN])


@device
def suns_importance(suns, n):
    """Of all suns together."""
    total = ZERO
    for i in range(len(suns)):
        total += sun_importance(suns, i, n)
    return total


@device
def choose_sun(suns, n, u):
    """(sun, probability) by importance for a plane with normal n; u in [0, 1). probability == 0: none is up."""
    if len(suns) == 1:
        return np.int32(0), ONE
    total = suns_importance(suns, n)
    u *= total
    chosen, importance, searches = np.int32(0), ZERO, total > ZERO
    for i in range(len(suns)):
        candidate = sun_importance(suns, i, n)
        takes = searches & (candidate > ZERO)
        chosen, importance = select(takes, np.int32(i), chosen), select(takes, candidate, importance)
        searches = searches & no(takes & (u < candidate))
        u -= select(takes, candidate, ZERO)
    return chosen, select(total > ZERO, importance / total, ZERO)


@device
def sun_probability(suns, i, n):
    """The probability with which `choose_sun` chooses sun i."""
    if len(suns) == 1:
        return ONE
    total = suns_importance(suns, n)
    return select(total > ZERO, sun_importance(suns, i, n) / total, ZERO)


@device
def sample_sun(suns, i, u1, u2):
    """(wi, radiance, pdf, delta): for a sun without an angle the irradiance and pdf = 1."""
    one_minus_cos, axis = at(suns, i, SUN_ONE_MINUS_COS), _axis(suns, i)
    delta = one_minus_cos <= ZERO
    wi = select(delta, axis, to_world(uniform_cone(u1, u2, one_minus_cos), axis))
    return wi, _radiance(suns, i), select(delta, ONE, uniform_cone_pdf(one_minus_cos)), delta


@device
def sun_seen(suns, i, wi):
    """(radiance, pdf) along wi; black beside the disk. |wi - axis|^2 / 2 = 1 - cos keeps small angles exact."""
    one_minus_cos = suns[i, SUN_ONE_MINUS_COS]
    off = sub(wi, _axis(suns, i))
    beside = (dot(off, off) > TWO * one_minus_cos) | (one_minus_cos <= ZERO)
    return select(beside, BLACK, _radiance(suns, i)), select(beside, ZERO, uniform_cone_pdf(one_minus_cos))
