"""The path tracer: one function that follows one path, and the kernel that fills a tile with them.

Unidirectional, with light sampling at every vertex, multiple importance sampling (power heuristic) and Russian
roulette. `f` is the scene's `Features` everywhere: constants, so that what is off costs nothing.

Bounces count as in Cycles: `max_bounces` 0 is direct light. A path that has used up its bounces takes one more ray,
which only sees emission: that is the BSDF-sampled half of the last vertex's direct light.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..features import DARK_WORLD, DISK, IMAGE_WORLD, NO_EMITTER, Features
from .bsdf import evaluate, phong_probability, sample
from .bsdf.diffuse import REJECTION
from .camera import generate_ray
from .embree import (
    GEOM_ID,
    INST_ID,
    INVALID,
    NORMAL,
    PRIM_ID,
    TFAR,
    bits_of,
    float_of,
    intersect,
    is_finite,
    occluded,
)
from .film.filter import sample_filter
from .geom.surface import find_surface, offset_origin
from .geom.vec import (
    BLACK,
    ONE,
    ZERO,
    add,
    add_scaled,
    average,
    dot,
    is_black,
    length,
    max_component,
    mul,
    negate,
    scale,
    sub,
)
from .jit import device, kernel
from .light.emitters import (
    emission,
    found_by_rays,
    lamp_seen,
    local_probability,
    sample_light,
    sun_seen_pdf,
    surface_seen_pdf,
    world_seen,
)
from .light.point import disk_distance, inside_lamp
from .sampler.random import hash32
from .sampler.sobol import hash_pixel, sample_1d, sample_2d, start_sample
from .sampler.warp import INV_PI
from .tables import (
    CAMERA_RAY,
    DIFFUSE_RAY,
    EXPONENT,
    GLOSSY_RAY,
    KD,
    KS,
    LAMP_QUADS,
    LAMP_SHIFT,
    SHADOW_RAY,
    TRANSPARENCY,
)

FAR = np.float32(np.inf)
HALF = np.float32(0.5)
# A shadow ray ends a little before the light, so that it does not meet the light itself: this part of its length, and
# this part of the coordinates, which is some roundings of float32.
SHADOW_GAP, COORDINATE_GAP = np.float32(1e-5), np.float32(1e-6)
# Roulette lets a path go on with probability sqrt(this x throughput). 1 is Cycles' rule; on the Cornell box 1.25 takes
# 5 % more rays and 13 % off the variance.
ROULETTE_KEEP = np.float32(1.25)
# Rays pass at most this many transparent surfaces in a row.
MAX_TRANSPARENT = 256

# Decisions of a path, as dimensions of the sampler: two for the camera, then these for each vertex.
PIXEL, LENS, FIRST_VERTEX = 0, 1, 2
LIGHT_CHOICE, LIGHT_POINT, LOBE, DIRECTION, ROULETTE, PASS, KIND, VERTEX_DECISIONS = 0, 1, 2, 3, 4, 5, 6, 7


# What a kernel counts besides rays: samples that were not finite; points that rejection sampling drew, and for how
# many directions.
REJECTED, DRAWS, DIRECTIONS, COUNTERS = 0, 1, 2, 3


class Limits(NamedTuple):
    """Where paths end. clamp_*: of a single contribution's mean over the channels; 0: none."""

    max_bounces: np.int32
    diffuse_bounces: np.int32
    glossy_bounces: np.int32
    clamp_direct: np.float32
    clamp_indirect: np.float32


class Tables(NamedTuple):
    """Everything a path reads: see kernels/tables.py and the modules that build each table."""

    geometry: tuple
    lights: tuple
    environment: tuple
    tree: tuple
    camera: np.ndarray
    filter_table: np.ndarray
    sampler: np.ndarray


@device
def power_heuristic(a, b):
    """Weight of a sample with density a where b was the other way to draw it. Veach 1997, beta = 2."""
    ratio = b / a
    return ONE / (ONE + ratio * ratio)


@device
def clamped(f, contribution, limit):
    """At most `limit` in the mean over the channels, the hue kept."""
    if f.clamp and limit > ZERO:
        mean = average(contribution)
        if mean > limit:
            return scale(contribution, limit / mean)
    return contribution


@device
def material_color(geometry, material, word):
    m = geometry.materials
    return m[material, word], m[material, word + 1], m[material, word + 2]


@device
def transmittance(f, geometry, ray, words, start, direction, t_far):
    """(fraction of light that gets through from `start` on, as far as `t_far`, rays traced).

    t_far is infinite, or just below 1 for a `direction` that reaches from `start` to the light.
    """
    if not f.transparency:
        blocked = occluded(geometry.accel[0], ray, words, start, direction, ZERO, t_far, SHADOW_RAY)
        return (BLACK if blocked else (ONE, ONE, ONE)), 1
    through, end = (ONE, ONE, ONE), add(start, direction)
    for i in range(MAX_TRANSPARENT):
        if not intersect(geometry.accel[0], ray, words, start, direction, ZERO, t_far, SHADOW_RAY):
            return through, i + 1
        p, _, ng, material, _ = find_surface(f, geometry, ray, words, negate(direction))
        through = mul(through, material_color(geometry, material, TRANSPARENCY))
        if is_black(through):
            return through, i + 1
        start = offset_origin(p, negate(ng))
        if t_far < FAR:
            direction = sub(end, start)
    return BLACK, MAX_TRANSPARENT


@device
def past(t):
    """A start for the rest of a ray that has met a lamp at t and goes on: the next floats, so that a surface right
    behind the lamp is not passed over."""
    return float_of(np.int32(bits_of(t) + np.int32(4)))


@device
def diffuse_part(kd):
    """The diffuse lobe's share of a BRDF value."""
    return scale(kd, INV_PI)


@device
def shadow_end(p, t):
    """Where, as a part of its length t, a shadow ray from p ends."""
    largest = max(abs(p[0]), max(abs(p[1]), abs(p[2])))
    return ONE - min(SHADOW_GAP + COORDINATE_GAP * largest / t, HALF)


@device
def direct_light(f, tables, ray, words, surface, p, start, n, ng, own, wo, key, order, dimension):
    """(radiance towards wo by one light sample, rays traced).

    start: where rays that leave p begin;  own: the emitter that p lies on, or -1
    """
    geometry = tables.geometry
    u = sample_1d(tables.sampler, key, order, dimension + LIGHT_CHOICE)
    u1, u2 = sample_2d(tables.sampler, key, order, dimension + LIGHT_POINT)
    light = sample_light(f, geometry, tables.lights, tables.environment, tables.tree, p, n, own, u, u1, u2)
    if not light.pdf > ZERO or is_black(light.radiance):
        return BLACK, 0
    value, pdf = evaluate(f.phong, f.hemisphere, surface, wo, light.wi, n, ng)
    if is_black(value):
        return BLACK, 0
    if f.ray_kinds:
        diffuse = diffuse_part(surface[0])
        if not light.mask & GLOSSY_RAY:
            value = diffuse
        if not light.mask & DIFFUSE_RAY:
            value = sub(value, diffuse) if light.mask & GLOSSY_RAY else BLACK
    weight = dot(n, light.wi) / light.pdf
    if f.shared_light and not light.alone:
        weight *= power_heuristic(light.pdf, pdf)
    contribution = scale(mul(value, light.radiance), weight)
    if not light.shadowed or is_black(contribution):
        return contribution, 0
    # The start lies off the surface, so the ray is aimed anew: at a light that is near, t would end behind it.
    direction, t_far = light.wi, FAR
    if light.t < FAR:
        direction, t_far = sub(add_scaled(p, light.wi, light.t), start), shadow_end(p, light.t)
    through, rays = transmittance(f, geometry, ray, words, start, direction, t_far)
    return mul(contribution, through), rays


@device
def light_weight(f, pdf_bsdf, pdf_light):
    """MIS weight of light that a ray met. pdf_bsdf <= 0 marks camera rays, with which no light sample competes."""
    if pdf_bsdf <= ZERO or pdf_light <= ZERO:
        return ONE
    return power_heuristic(pdf_bsdf, pdf_light) if f.shared_light else ZERO


@device
def escaped(f, tables, wi, pdf_bsdf, mask, clear):
    """Radiance of suns and, unless it is `clear`ed from the film, of the world for a ray that left along wi."""
    radiance = BLACK
    if f.world != DARK_WORLD and not clear:
        seen, pdf = world_seen(f, tables.lights, tables.environment, wi, mask)
        radiance = scale(seen, light_weight(f, pdf_bsdf, pdf)) if f.world == IMAGE_WORLD else seen
    if f.sun_disks:
        for i in range(len(tables.lights.suns)):
            seen, pdf = sun_seen_pdf(f, tables.lights, i, wi, mask)
            radiance = add(radiance, scale(seen, light_weight(f, pdf_bsdf, pdf)))
    return radiance


@device
def is_lamp(f, geometry, words):
    """Whether the hit is a lamp's shape and no surface."""
    if f.instances and words[INST_ID] != INVALID:
        return False
    return geometry.kind[words[GEOM_ID]] >= LAMP_QUADS


@device
def lamp_of_hit(geometry, lights, words):
    """The lamp whose shape was hit."""
    prim, base = np.int64(words[PRIM_ID]), np.int64(geometry.base[words[GEOM_ID]])
    if geometry.kind[words[GEOM_ID]] == LAMP_QUADS:
        return lights.lamp_of_quad[base + prim // 2]
    return lights.lamp_of_sphere[base + prim]


@device
def met_lamp(f, tables, ray, words, lamp, origin, p, n, wi, pdf_bsdf, mask):
    """(radiance, MIS weight included, of the lamp whose shape a ray met, rays traced).

    p, n: where the ray's direction was sampled, which is where the light sample would have been made.
    """
    geometry, lights = tables.geometry, tables.lights
    t_hit, rays = ray[TFAR], 0
    to_p = sub(p, add_scaled(origin, wi, t_hit))
    if geometry.kind[words[GEOM_ID]] != LAMP_QUADS:
        # Rays meet a sphere twice. The second time counts only for those that start inside.
        leaves = wi[0] * ray[NORMAL] + wi[1] * ray[NORMAL + 1] + wi[2] * ray[NORMAL + 2] > ZERO
        if leaves and not inside_lamp(lights.lamps, lamp, p):
            return BLACK, rays
    scattered = pdf_bsdf > ZERO
    if scattered and not found_by_rays(f, lights, lamp, p):
        return BLACK, rays
    radiance, pdf = lamp_seen(f, lights, lamp, p, n, wi, length(to_p))
    if is_black(radiance):
        return BLACK, rays
    if f.lamp_kinds & DISK and lights.lamp_kind[lamp] & DISK:
        # Embree has no disk that turns towards a point, so what was met is the sphere around it.
        rays = 1
        t_disk = disk_distance(lights.lamps, lamp, p, wi) - (length(to_p) - t_hit)
        if t_disk > t_hit and occluded(geometry.accel[0], ray, words, origin, wi, t_hit, t_disk, mask):
            return BLACK, rays
    if scattered:
        pdf *= local_probability(f, tables.tree, lamp, p, n)
    return scale(radiance, light_weight(f, pdf_bsdf, pdf)), rays


@device
def trace_path(f, tables, limits, ray, words, counters, pixel_x, pixel_y, pixel_hash, index):
    """Follow one path. Returns (radiance, alpha, rays traced)."""
    geometry = tables.geometry
    accel = geometry.accel[0]
    key, order = start_sample(pixel_hash, index)
    u1, u2 = sample_2d(tables.sampler, key, order, PIXEL)
    dx, dy = sample_filter(tables.filter_table, u1, u2)
    x = np.float32(pixel_x) + HALF + dx
    y = np.float32(pixel_y) + HALF + dy
    if f.lens:
        u1, u2 = sample_2d(tables.sampler, key, order, LENS)
    origin, wi, t_near, t_far = generate_ray(tables.camera, f.orthographic, f.lens, x, y, u1, u2)

    radiance, throughput = BLACK, (ONE, ONE, ONE)
    mask, pdf_bsdf, from_p, from_n = CAMERA_RAY, -ONE, origin, wi
    bounce, diffuse_bounces, glossy_bounces, passed = 0, 0, 0, 0
    last, alpha, rays = False, ONE, 0
    dimension, last_lamp = FIRST_VERTEX, np.int32(-1)
    state = hash32(key ^ hash32(np.uint32(index)))  # the key alone is that of all samples of the pixel

    while True:
        limit = limits.clamp_direct if bounce <= 1 else limits.clamp_indirect
        rays += 1
        reach = mask | (mask << np.uint32(LAMP_SHIFT)) if f.lamp_shapes else mask
        if not intersect(accel, ray, words, origin, wi, t_near, t_far, reach):
            clear = f.transparent_film and bounce == 0
            if clear:
                alpha = max(ONE - average(throughput), ZERO)
            if f.sun_disks or (f.world != DARK_WORLD and not clear):
                seen = mul(throughput, escaped(f, tables, wi, pdf_bsdf, mask, clear))
                radiance = add(radiance, clamped(f, seen, limit))
            break
        if f.lamp_shapes and is_lamp(f, geometry, words):
            lamp = lamp_of_hit(geometry, tables.lights, words)
            t_near = past(ray[TFAR])
            # Far from the world's origin t is too coarse to leave a lamp behind: meeting it again counts for nothing.
            if lamp != last_lamp:
                last_lamp = lamp
                seen, more = met_lamp(f, tables, ray, words, lamp, origin, from_p, from_n, wi, pdf_bsdf, mask)
                radiance = add(radiance, clamped(f, mul(throughput, seen), limit))
                rays += more
            continue

        wo = negate(wi)
        t_hit = ray[TFAR]
        p, n, ng, material, triangle = find_surface(f, geometry, ray, words, wo)
        own = np.int32(-1)
        if f.mesh_emitters:
            seen = emission(geometry, material)
            if not is_black(seen):
                weight = ONE
                own = tables.lights.triangle_emitter[triangle]
                if pdf_bsdf > ZERO and own >= 0:
                    t = length(sub(p, from_p))
                    pdf = surface_seen_pdf(f, geometry, tables.lights, own, from_p, wi, t)
                    pdf *= local_probability(f, tables.tree, own, from_p, from_n)
                    weight = light_weight(f, pdf_bsdf, pdf)
                radiance = add(radiance, clamped(f, scale(mul(throughput, seen), weight), limit))
        dimension += VERTEX_DECISIONS
        kd, ks = material_color(geometry, material, KD), material_color(geometry, material, KS)
        if f.transparency:
            through = material_color(geometry, material, TRANSPARENCY)
            if not is_black(through):
                share = average(through)
                chance = ONE if last else share / (share + average(kd) + average(ks))
                if sample_1d(tables.sampler, key, order, dimension + PASS) < chance:
                    throughput = scale(mul(throughput, through), ONE / chance)
                    origin = offset_origin(p, negate(ng))
                    t_near, t_far = ZERO, t_far - t_hit
                    passed += 1
                    if passed > MAX_TRANSPARENT:
                        break
                    continue
                throughput = scale(throughput, ONE / (ONE - chance))
        if last or is_black(add(kd, ks)):
            break

        exponent = geometry.materials[material, EXPONENT] if f.phong else ZERO
        cos_o = dot(n, wo)
        # A probability of 0 switches the Phong lobe off: seen from behind its shading normal it has no mirror side.
        chance = phong_probability(f.lobe_selection, kd, ks, exponent, cos_o) if f.phong and cos_o > ZERO else ZERO
        surface = (kd, ks, exponent, chance)
        start = offset_origin(p, ng)
        if f.emitter_choice != NO_EMITTER or f.suns or f.world == IMAGE_WORLD:
            lit, more = direct_light(f, tables, ray, words, surface, p, start, n, ng, own, wo, key, order, dimension)
            limit = limits.clamp_direct if bounce == 0 else limits.clamp_indirect
            radiance = add(radiance, clamped(f, mul(throughput, lit), limit))
            rays += more

        u = sample_1d(tables.sampler, key, order, dimension + LOBE) if f.phong else ZERO
        u1, u2 = sample_2d(tables.sampler, key, order, dimension + DIRECTION)
        wi, value, pdf_bsdf, _, state, draws = sample(f.phong, f.hemisphere, surface, wo, n, ng, u, u1, u2, state)
        if f.hemisphere == REJECTION and draws:
            counters[DRAWS] += draws
            counters[DIRECTIONS] += 1
        if not pdf_bsdf > ZERO or is_black(value):
            break
        bounce += 1
        mask = DIFFUSE_RAY
        if f.ray_kinds:
            # The kind of the ray is drawn by the lobes' shares of the BRDF, whichever of them wi came from, so that
            # each lobe sees exactly what rays of its kind see.
            diffuse = diffuse_part(kd)
            share = min(average(diffuse) / average(value), ONE)
            if sample_1d(tables.sampler, key, order, dimension + KIND) < share:
                value = scale(diffuse, ONE / share)
                diffuse_bounces += 1
            else:
                value = scale(sub(value, diffuse), ONE / (ONE - share))
                glossy_bounces += 1
                mask = GLOSSY_RAY
        throughput = mul(throughput, scale(value, dot(n, wi) / pdf_bsdf))
        last = (
            bounce > limits.max_bounces
            or diffuse_bounces > limits.diffuse_bounces
            or glossy_bounces > limits.glossy_bounces
        )
        if last and not (f.mesh_emitters or f.lamp_shapes or f.world != DARK_WORLD or f.sun_disks):
            break
        if bounce > 1:
            survival = min(ONE, math.sqrt(ROULETTE_KEEP * max_component(throughput)))
            if sample_1d(tables.sampler, key, order, dimension + ROULETTE) >= survival:
                break
            throughput = scale(throughput, ONE / survival)
        origin, from_p, from_n = start, p, n
        t_near, t_far, last_lamp = ZERO, FAR, np.int32(-1)
    return radiance, alpha, rays


def make_tile_kernel(features: Features):
    """The kernel that renders a tile of scenes with these features. Compiled, or read from disk, at its first call."""

    @kernel
    def render_tile(
        tables, limits, ray, tile, first_sample, sample_count, seed, origin, sums, samples, half, active, counters, halt
    ):
        """Add samples first_sample.. of the pixels of `tile` (x0, y0, x1, y1) to the film, whose pixel (0, 0) is the
        picture's pixel `origin`. half and active are `engine/adaptive.py`'s, one pixel large where it is off.
        counters[REJECTED] counts samples that are not finite and were left out. halt[0]
        ends the work before the next pixel. Returns the number of rays traced."""
        words = ray.view(np.uint32)
        adaptive = active.size > 1
        rays = 0
        for y in range(tile[1], tile[3]):
            for x in range(tile[0], tile[2]):
                if halt[0]:
                    return rays
                row, column = y - origin[1], x - origin[0]
                if adaptive and not active[row, column]:
                    continue
                pixel_hash = hash_pixel(x, y, seed)
                red, green, blue, cover = ZERO, ZERO, ZERO, ZERO
                for index in range(first_sample, first_sample + sample_count):
                    radiance, alpha, traced = trace_path(
                        features, tables, limits, ray, words, counters, x, y, pixel_hash, index
                    )
                    rays += traced
                    if not is_finite(radiance[0] + radiance[1] + radiance[2]):
                        counters[REJECTED] += 1
                        continue
                    red += radiance[0]
                    green += radiance[1]
                    blue += radiance[2]
                    cover += alpha
                    if adaptive and index % 2 == 0:
                        half[row, column, 0] += radiance[0]
                        half[row, column, 1] += radiance[1]
                        half[row, column, 2] += radiance[2]
                sums[row, column, 0] += red
                sums[row, column, 1] += green
                sums[row, column, 2] += blue
                sums[row, column, 3] += cover
                samples[row, column] += sample_count
        return rays

    return render_tile
