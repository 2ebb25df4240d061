"""Diffuse plus Phong: one surface, one density.

A surface is (kd, ks, exponent, p_phong): two colours, the Phong exponent, and the probability of drawing the Phong
lobe, which depends on the view and comes from `phong_probability`. Callers turn n and ng to wo's side (ng . wo > 0).

`has_phong` and `hemisphere` are compile-time constants of the outermost kernel: a scene without Phong surfaces runs
no line of it.
"""

from __future__ import annotations

import numpy as np

from ..geom.vec import BLACK, ONE, TINY, TWO, ZERO, average, dot, reflect
from ..jit import device
from ..simd import any_of, no, select
from .diffuse import diffuse_f, diffuse_pdf, sample_diffuse
from .phong import phong_albedo, phong_lobe, sample_phong

# Places in engine.settings.LOBE_SELECTION.
ALBEDO, CLASSIC = 0, 1
DIFFUSE_LOBE, PHONG_LOBE = np.int32(0), np.int32(1)

# A lobe that reflects anything is drawn at least this often, so that no direction's weight grows without bound.
MIN_PROBABILITY = np.float32(0.05)


@device
def phong_probability(lobe_selection, kd, ks, exponent, cos_o):
    """Probability of drawing the Phong lobe.

    CLASSIC: ks / (kd + ks). ALBEDO: by what the lobes reflect towards this view, ks albedo(cos_o) against kd.
    """
    diffuse = average(kd)
    phong = average(ks)
    if lobe_selection == CLASSIC:
        chance = phong / (diffuse + phong)
    else:
        reflected = phong * phong_albedo(exponent, cos_o)
        chance = min(max(reflected / (diffuse + reflected), MIN_PROBABILITY), ONE - MIN_PROBABILITY)
    return select(phong <= ZERO, ZERO, select(diffuse <= ZERO, ONE, chance))


@device
def evaluate(has_phong, hemisphere, surface, wo, wi, n, ng):
    """(f, pdf): the BRDF without the cosine, and the density with which `sample` draws wi, per steradian.

    Both are zero for a wi below the surface or on the other side of the geometric normal.
    """
    cos_i = dot(wi, n)
    below = (cos_i <= ZERO) | (dot(wi, ng) <= ZERO)
    kd, ks, exponent, p_phong = surface
    f = diffuse_f(kd)
    pdf = diffuse_pdf(hemisphere, cos_i)
    if has_phong:
        glossy = p_phong > ZERO
        if any_of(glossy & no(below)):
            lobe = select(glossy, phong_lobe(exponent, reflect(wo, n), wi), ZERO)
            strength = lobe * (exponent + TWO)
            f = (f[0] + ks[0] * strength, f[1] + ks[1] * strength, f[2] + ks[2] * strength)
            pdf += p_phong * (lobe * (exponent + ONE) - pdf)
    nothing = below | (pdf < TINY)
    return select(nothing, BLACK, f), select(nothing, ZERO, pdf)


@device
def sample(has_phong, hemisphere, surface, wo, n, ng, u_lobe, u1, u2, rng):
    """(wi, f, pdf, lobe, rng, draws), as `evaluate` for the wi drawn. pdf = 0: failed, the path ends here.

    u_lobe, u1, u2  in (0, 1)
    rng             uint32, state of `sampler.random`, used by rejection sampling only
    draws           how many points rejection sampling drew
    """
    wi, lobe, draws = n, DIFFUSE_LOBE, np.int32(0)
    glossy = (u_lobe < surface[3]) & (has_phong != 0)
    if any_of(no(glossy)):
        wi, rng, draws = sample_diffuse(hemisphere, n, u1, u2, rng)
    if any_of(glossy):
        wi = select(glossy, sample_phong(surface[2], n, wo, u1, u2), wi)
        lobe, draws = select(glossy, (PHONG_LOBE, np.int32(0)), (DIFFUSE_LOBE, draws))
    f, pdf = evaluate(has_phong, hemisphere, surface, wo, wi, n, ng)
    return wi, f, pdf, lobe, rng, draws
