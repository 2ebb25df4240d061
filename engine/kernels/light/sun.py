"""Suns: a direction, or a uniform cone of directions."""

from __future__ import annotations

from ..geom.frame import to_world
from ..geom.vec import BLACK, ONE, TWO, ZERO, dot, sub
from ..jit import device
from ..sampler.warp import uniform_cone, uniform_cone_pdf
from ..tables import SUN_AXIS, SUN_COS, SUN_IRRADIANCE, SUN_ONE_MINUS_COS, SUN_RADIANCE, SUN_SIN
from .tree import mean_cosine


@device
def _axis(suns, i):
    return suns[i, SUN_AXIS], suns[i, SUN_AXIS + 1], suns[i, SUN_AXIS + 2]


@device
def _radiance(suns, i):
    return suns[i, SUN_RADIANCE], suns[i, SUN_RADIANCE + 1], suns[i, SUN_RADIANCE + 2]


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
        return 0, ONE
    total = suns_importance(suns, n)
    u *= total
    chosen, importance = 0, ZERO
    for i in range(len(suns)):
        candidate = sun_importance(suns, i, n)
        if candidate > ZERO:
            chosen, importance = i, candidate
            if u < candidate:
                break
            u -= candidate
    return chosen, importance / total if total > ZERO else ZERO


@device
def sun_probability(suns, i, n):
    """The probability with which `choose_sun` chooses sun i."""
    if len(suns) == 1:
        return ONE
    total = suns_importance(suns, n)
    return sun_importance(suns, i, n) / total if total > ZERO else ZERO


@device
def sample_sun(suns, i, u1, u2):
    """(wi, radiance, pdf, delta): for a sun without an angle the irradiance and pdf = 1."""
    one_minus_cos = suns[i, SUN_ONE_MINUS_COS]
    if one_minus_cos <= ZERO:
        return _axis(suns, i), _radiance(suns, i), ONE, True
    wi = to_world(uniform_cone(u1, u2, one_minus_cos), _axis(suns, i))
    return wi, _radiance(suns, i), uniform_cone_pdf(one_minus_cos), False


@device
def sun_seen(suns, i, wi):
    """(radiance, pdf) along wi; black beside the disk. |wi - axis|^2 / 2 = 1 - cos keeps small angles exact."""
    one_minus_cos = suns[i, SUN_ONE_MINUS_COS]
    off = sub(wi, _axis(suns, i))
    if dot(off, off) > TWO * one_minus_cos or one_minus_cos <= ZERO:
        return BLACK, ZERO
    return _radiance(suns, i), uniform_cone_pdf(one_minus_cos)
