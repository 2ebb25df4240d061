"""The diffuse lobe, f = kd / pi, and the three ways to choose a direction of the hemisphere for it."""

from __future__ import annotations

import numpy as np

from ..geom.frame import to_world
from ..geom.vec import scale
from ..jit import device
from ..sampler.warp import (
    INV_PI,
    cosine_hemisphere,
    cosine_hemisphere_pdf,
    rejection_hemisphere,
    uniform_hemisphere,
    uniform_hemisphere_pdf,
)

# Places in engine.settings.HEMISPHERE_SAMPLING.
COSINE, UNIFORM, REJECTION = 0, 1, 2


@device
def diffuse_f(kd):
    return scale(kd, INV_PI)


@device
def diffuse_pdf(hemisphere, cos_i):
    """For a direction above the surface."""
    if hemisphere == COSINE:
        return cosine_hemisphere_pdf(cos_i)
    return uniform_hemisphere_pdf(cos_i)


@device
def sample_diffuse(hemisphere, n, u1, u2, rng):
    """(wi, rng, draws). Rejection takes its numbers from `rng`, the state of `sampler.random`, and counts its draws;
    the others take u1, u2."""
    draws = np.int32(0)
    if hemisphere == COSINE:
        local = cosine_hemisphere(u1, u2)
    elif hemisphere == UNIFORM:
        local = uniform_hemisphere(u1, u2)
    else:
        local, rng, draws = rejection_hemisphere(rng)
    return to_world(local, n), rng, draws
