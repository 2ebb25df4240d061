"""A path's steps at the camera and at its vertices: what both kernels do there, for one path and for sixteen at once.

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
    PIXEL,
    ROULETTE,
    WHITE,
    Ray,
    Stretch,
    Vertex,
    material_color,
)
from .sampler.sobol import sample_1d, sample_2d
from .simd import at, float32, no, select
from .tables import CAMERA_RAY, DIFFUSE_RAY, EXPONENT, GLOSSY_RAY, HOLDOUT, KD, KS

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
    """Whether the camera sees a hole there. For one number only."""
    return f.holdout and geometry.materials[material, HOLDOUT] > ZERO


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
def scatter(f, tables, counters, vertex, numbers, state):
    """(new `Ray`, value of the BRDF, state of the generator). Without a density the path ends here."""
    key, order, dimension = numbers.key, numbers.order, numbers.dimension
    u = sample_1d(tables.sampler, key, order, dimension + LOBE) if f.phong else ZERO
    u1, u2 = sample_2d(tables.sampler, key, order, dimension + DIRECTION)
    wi, value, pdf, _, state, draws = sample(
        f.phong, f.hemisphere, vertex.surface, vertex.wo, vertex.n, vertex.ng, u, u1, u2, state
    )
    if f.hemisphere == REJECTION and draws:
        counters[DRAWS] += draws
        counters[DIRECTIONS] += 1
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
    return Ray(vertex.p, vertex.n, wi, kind, pdf, False), value, state


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
    return limits.clamp_direct if scatterings <= 1 else limits.clamp_indirect


@device
def last_ray_finds_light(f):
    """Whether there is emission that a path's last ray may count."""
    if not f.shared_light:
        return f.world == CONSTANT_WORLD
    return f.mesh_emitters or f.lamp_shapes or f.world != DARK_WORLD or f.sun_disks
