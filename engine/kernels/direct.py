"""Light sampling: the direct light of a vertex by one light sample and its shadow ray."""

from __future__ import annotations

import numpy as np

from ..features import IMAGE_WORLD, NO_EMITTER
from .bsdf import evaluate
from .bsdf.diffuse import diffuse_f
from .embree import intersect, occluded
from .geom.surface import find_surface, hit_of, offset_origin
from .geom.vec import (
    BLACK,
    FAR,
    HALF,
    ONE,
    ZERO,
    add,
    add_scaled,
    dot,
    is_black,
    length,
    mul,
    negate,
    scale,
    share_of,
    sub,
)
from .jit import device
from .light.emitters import sample_light
from .mis import sampled_light_weight
from .records import LIGHT_CHOICE, LIGHT_POINT, MAX_TRANSPARENT, WHITE, material_color, without_density
from .sampler.sobol import sample_1d, sample_2d
from .simd import any_of, select
from .tables import DIFFUSE_RAY, GLOSSY_RAY, SHADOW_RAY, TRANSPARENCY

# A shadow ray ends a little before the light, so that it does not meet the light itself: this part of its length, and
# this part of the coordinates, which is some roundings of float32.
SHADOW_GAP, COORDINATE_GAP = np.float32(1e-5), np.float32(1e-6)


@device
def samples_lights(f):
    """Whether the scene has any light that light sampling finds."""
    return f.emitter_choice != NO_EMITTER or f.suns or f.world == IMAGE_WORLD


@device
def unshadowed_light(f, tables, vertex, numbers):
    """(a `LightSample`, radiance towards wo by it if nothing is in the way)."""
    p, n, contribution = vertex.p, vertex.n, BLACK
    u = sample_1d(tables.sampler, numbers.key, numbers.order, numbers.dimension + LIGHT_CHOICE)
    u1, u2 = sample_2d(tables.sampler, numbers.key, numbers.order, numbers.dimension + LIGHT_POINT)
    light = sample_light(
        f, tables.geometry, tables.lights, tables.environment, tables.tree, p, n, vertex.own, u, u1, u2
    )
    drawn = light.pdf > ZERO
    if any_of(drawn):
        value, pdf = evaluate(f.phong, f.hemisphere, vertex.surface, vertex.wo, light.wi, n, vertex.ng)
        nothing = is_black(light.radiance) | is_black(value)
        value = _lit_lobes(f, vertex.surface, value, light.mask)
        weight = dot(n, light.wi) / light.pdf
        weight *= sampled_light_weight(light, pdf)
        contribution = select(nothing, BLACK, scale(mul(value, light.radiance), weight))
    return light, select(drawn, contribution, without_density(light.pdf))


@device
def _lit_lobes(f, surface, value, mask):
    """Of the BRDF's value, what the lobes contribute whose kind of ray sees a light of this mask."""
    if f.ray_kinds:
        diffuse = diffuse_f(surface[0])
        sees_diffuse, sees_glossy = mask & DIFFUSE_RAY != np.uint32(0), mask & GLOSSY_RAY != np.uint32(0)
        lit = select(sees_diffuse, diffuse, BLACK)
        value = select(sees_glossy, select(sees_diffuse, value, sub(value, diffuse)), lit)
    return value


@device
def lit_share(f, vertex, light):
    """Of the light that a `LightSample` brings, for each channel the part that the diffuse lobe scatters."""
    if not f.phong:
        return WHITE
    value, _ = evaluate(f.phong, f.hemisphere, vertex.surface, vertex.wo, light.wi, vertex.n, vertex.ng)
    diffuse = _lit_lobes(f, (vertex.surface[0], BLACK, ZERO, ZERO), diffuse_f(vertex.surface[0]), light.mask)
    return share_of(diffuse, _lit_lobes(f, vertex.surface, value, light.mask))


@device
def shadow_segment(vertex, light):
    """(direction, t_far) of the shadow ray from the vertex's start to a `LightSample`."""
    # The start lies off the surface, so the ray is aimed anew: at a light that is near, t would end behind it.
    near = light.t < FAR
    aimed = sub(add_scaled(vertex.p, light.wi, select(near, light.t, ONE)), vertex.start)
    return select(near, aimed, light.wi), select(near, shadow_end(vertex.p, light.t), FAR)


@device
def shadow_end(p, t):
    """Where, as a part of its length t, a shadow ray from p ends."""
    largest = max(abs(p[0]), max(abs(p[1]), abs(p[2])))
    return ONE - min(SHADOW_GAP + COORDINATE_GAP * largest / t, HALF)


@device
def dimmed_on_way(f, geometry, memory, start, direction, t_far, light):
    """(what of `light` gets through from `start` on, as far as `t_far`, rays traced).

    t_far is infinite, or 1 for a `direction` as long as the way, or just below 1 for one that reaches a light.
    """
    accel, ray, words = geometry.accel[0], memory.floats, memory.words
    if not f.transparency:
        blocked = occluded(accel, ray, words, start, direction, ZERO, t_far, SHADOW_RAY)
        return (BLACK if blocked else light), 1
    for i in range(MAX_TRANSPARENT):
        if not intersect(accel, ray, words, start, direction, ZERO, t_far, SHADOW_RAY):
            return light, i + 1
        _, _, ng, material, _, inside = find_surface(f, geometry, hit_of(f, geometry, ray, words), negate(direction))
        light = mul(light, material_color(geometry, material, TRANSPARENCY))
        if is_black(light):
            return light, i + 1
        behind = offset_origin(inside, negate(ng))
        if t_far < FAR:
            direction = sub(add(start, direction), behind)
        if t_far < ONE:  # on a short rest of the way the same part of it is too short a gap
            t_far = shadow_end(behind, length(direction))
        start = behind
    return BLACK, MAX_TRANSPARENT
