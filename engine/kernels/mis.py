"""Which of two ways finds a light, and how much each counts: multiple importance sampling (Veach 1997).

Light sampling draws a point of a light; BSDF sampling draws a direction, and the ray along it may meet a light. What
both could have found they share by the power heuristic; what only one finds counts there in full. Light sampling
never finds a constant world (its density is 0); `LightSample.alone` says what no ray finds.

Both ways have to see the same objects. Light sampling sees what shadow rays see, and that is what direct light is.
Where some object is hidden from shadow rays and not from others, or the reverse (`shared_light` is 0), the path's own
ray therefore leaves to light sampling all that it can find, and a second ray along the same direction, which sees as
shadow rays do (`Ray.as_shadow`), takes the part of BSDF sampling.
"""

from __future__ import annotations

from .geom.vec import ONE, ZERO
from .jit import device
from .simd import select


@device
def power_heuristic(a, b):
    """Weight of a sample with density a where b was the other way to draw it. Veach 1997, beta = 2."""
    ratio = b / a
    return ONE / (ONE + ratio * ratio)


@device
def sampled_light_weight(light, pdf_bsdf):
    """Of a `LightSample` whose direction has this density in BSDF sampling."""
    return select(light.alone, ONE, power_heuristic(light.pdf, pdf_bsdf))


@device
def met_light_weight(f, ray, pdf_light):
    """Of light that `ray` met, where pdf_light is the density with which light sampling draws its direction."""
    shares = f.shared_light or ray.as_shadow
    weight = power_heuristic(ray.pdf, pdf_light) if shares else ZERO
    weight = select(pdf_light <= ZERO, ZERO if ray.as_shadow else ONE, weight)
    return select(ray.pdf <= ZERO, ONE, weight)
