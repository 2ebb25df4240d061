"""A path's steps at the camera and at its vertices, for one path and for sixteen at once.

`f` is the scene's `Features`.
"""

from __future__ import annotations

import math

import numpy as np

from ..features import CONSTANT_WORLD, DARK_WORLD
from .bsdf import phong_probability, sample
from .bsdf.diffuse import REJECTION, diffuse_f
from .camera import generate_ray
from .film.filter import sample_filter
from .geom.surface import offset_origin
from .geom.vec import BLACK, HALF, ONE, ZERO, add, average, dot, is_black, max_component, negate, scale, share_of, sub
from .jit import device
from .records import (
    DIRECTION,
    DIRECTIONS,
    DRAWS,
    KIND,
    LENS,
    LOBE,
    PASS,
    PIXEL,
    ROULETTE,
    WHITE,
    Bounces,
    Ray,
    Stretch,
    Vertex,
    material_color,
)
from .sampler.random import hash32
from .sampler.sobol import sample_1d, sample_2d
from .simd import at, float32, no, select, total, uint32
from .tables import CAMERA_RAY, DIFFUSE_RAY, EXPONENT, GLOSSY_RAY, HOLDOUT, KD, KS, TRANSPARENCY

# Roulette lets a path go on with probability sqrt(this x throughput). 1 is Cycles' rule: the trial "roulette
# of Cycles" of benchmarks/trials.py.
ROULETTE_KEEP = np.float32(1.25)


@device
def camera_ray(f, tables, numbers, pixel_x, pixel_y):
    """The path's first `Ray`, and the `Stretch` of it between the clip planes."""
    u1, u2 = sample_2d(tables.sampler, numbers.key, numbers.order, PIXEL)
    dx, dy = sample_filter(tables.filter_table, u1, u2)
    x = float32(pixel_x) + HALF + dx
    y = float32(pixel_y) + HALF + dy
    if f.lens:
        u1, u2 = sample_2d(tables.sampler, numbers.key, numbers.order, LENS)
    origin, wi, t_near, t_far = generate_ray(tables.camera, f.orthographic, f.lens, x, y, u1, u2)
    return Ray(origin, wi, wi, CAMERA_RAY, -ONE, False), Stretch(origin, t_near, t_far, ZERO)


@device
def reflects(geometry, material):
    return no(is_black(add(material_color(geometry, material, KD), material_color(geometry, material, KS))))


@device
def is_holdout(f, geometry, material):
    """Whether the camera sees a hole there."""
    return (at(geometry.materials, material, HOLDOUT) > ZERO) & (f.holdout != 0)


@device
def make_vertex(f, geometry, surface, ray, own):
    """The `Vertex` at what `find_surface` has found, on the emitter `own`, if it is not -1."""
    p, n, ng, material, _, inside = surface
    wo = negate(ray.wi)
    kd, ks = material_color(geometry, material, KD), material_color(geometry, material, KS)
    exponent = at(geometry.materials, material, EXPONENT) if f.phong else ZERO
    cos_o = dot(n, wo)
    # A probability of 0 switches the Phong lobe off: seen from behind its shading normal it has no mirror side.
    chance = ZERO
    if f.phong:
        chance = select(cos_o > ZERO, phong_probability(f.lobe_selection, kd, ks, exponent, cos_o), ZERO)
    return Vertex(p, n, ng, offset_origin(inside, ng), wo, (kd, ks, exponent, chance), own)


@device
def scatter(f, tables, counters, alive, vertex, numbers):
    """(new `Ray`, value of the BRDF). Without a density the path ends here. What rejection sampling draws for those
    that are `alive` is counted."""
    key, order, dimension = numbers.key, numbers.order, numbers.dimension
    u = sample_1d(tables.sampler, key, order, dimension + LOBE) if f.phong else ZERO
    u1, u2 = sample_2d(tables.sampler, key, order, dimension + DIRECTION)
    state = hash32(uint32(key ^ hash32(uint32(order + uint32(dimension)))))  # the key alone is that of many samples
    wi, value, pdf, _, _, draws = sample(
        f.phong, f.hemisphere, vertex.surface, vertex.wo, vertex.n, vertex.ng, u, u1, u2, state
    )
    if f.hemisphere == REJECTION:
        drew = select(alive & (draws > np.int32(0)), (draws, np.int32(1)), (np.int32(0), np.int32(0)))
        counters[DRAWS] += total(drew[0])
        counters[DIRECTIONS] += total(drew[1])
    pdf = select(is_black(value), ZERO, pdf)
    kind = DIFFUSE_RAY
    if f.ray_kinds:
        # The kind of the ray is drawn by the lobes' shares of the BRDF, whichever of them wi came from, so that each
        # lobe sees exactly what rays of its kind see.
        diffuse = diffuse_f(vertex.surface[0])
        share = min(average(diffuse) / average(value), ONE)
        glossy = no(sample_1d(tables.sampler, key, order, dimension + KIND) < share)
        value = select(glossy, scale(sub(value, diffuse), ONE / (ONE - share)), scale(diffuse, ONE / share))
        kind = select(glossy, GLOSSY_RAY, DIFFUSE_RAY)
    return Ray(vertex.p, vertex.n, wi, kind, pdf, False), value


@device
def scattered_share(f, vertex, kind, value):
    """Of what a ray from `scatter` brings, for each channel the part that the diffuse lobe scatters."""
    if f.ray_kinds:
        return select(kind == GLOSSY_RAY, BLACK, WHITE)
    return share_of(diffuse_f(vertex.surface[0]), value) if f.phong else WHITE


@device
def roulette(tables, numbers, throughput):
    """(whether the path goes on, with which probability)."""
    chance = min(ONE, math.sqrt(ROULETTE_KEEP * max_component(throughput)))
    return no(sample_1d(tables.sampler, numbers.key, numbers.order, numbers.dimension + ROULETTE) >= chance), chance


@device
def clamp_limit(limits, scatterings):
    """Of light that is found after so many."""
    return select(scatterings <= 1, limits.clamp_direct, limits.clamp_indirect)


@device
def counted(f, bounces, kind):
    """`bounces` after one more, of this kind."""
    more = bounces.total + np.uint32(1)
    if not f.ray_kinds:
        return Bounces(more, bounces.diffuse, bounces.glossy)
    diffuse, glossy = select(kind == GLOSSY_RAY, (np.uint32(0), np.uint32(1)), (np.uint32(1), np.uint32(0)))
    return Bounces(more, bounces.diffuse + diffuse, bounces.glossy + glossy)


@device
def is_last(limits, bounces):
    """Whether the next ray only sees emission."""
    ends = bounces.total > limits.max_bounces
    return ends | (bounces.diffuse > limits.diffuse_bounces) | (bounces.glossy > limits.glossy_bounces)


@device
def pass_through(tables, numbers, material, last):
    """(whether the path goes straight on through a surface, factor of its throughput, whichever it does)."""
    geometry = tables.geometry
    through = material_color(geometry, material, TRANSPARENCY)
    share, lets_through = average(through), no(is_black(through))
    kd, ks = material_color(geometry, material, KD), material_color(geometry, material, KS)
    chance = select(last, ONE, share / (share + average(kd) + average(ks)))
    passes = lets_through & (sample_1d(tables.sampler, numbers.key, numbers.order, numbers.dimension + PASS) < chance)
    factor = select(passes, scale(through, ONE / chance), scale(WHITE, ONE / (ONE - chance)))
    return passes, select(lets_through, factor, WHITE)


@device
def last_ray_finds_light(f):
    """Whether there is emission that a path's last ray may count."""
    if not f.shared_light:
        return f.world == CONSTANT_WORLD
    return f.mesh_emitters or f.lamp_shapes or f.world != DARK_WORLD or f.sun_disks
