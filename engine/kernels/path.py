"""The path tracer: one function that follows one path, and the kernel that fills a tile with them.

Unidirectional, with light sampling at every vertex (`direct`), light that rays meet (`met`), multiple importance
sampling of both (`mis`) and Russian roulette. `f` is the scene's `Features` everywhere: constants, so that what is
off costs nothing.

Bounces count as in Cycles: `max_bounces` 0 is direct light. A path that has used up its bounces takes one more ray,
which only sees emission: that is the BSDF-sampled half of the last vertex's direct light.
"""

from __future__ import annotations

import numpy as np

from ..features import Features
from .direct import direct_light, samples_lights
from .embree import TFAR
from .film.sums import add_sample
from .geom.surface import find_surface, hit_of, offset_origin
from .geom.vec import BLACK, FAR, ONE, ZERO, average, dot, is_black, negate, scale
from .jit import device, kernel
from .met import emitted, follow, follow_as_shadow, sees_shadows_light
from .records import (
    FIRST_VERTEX,
    MAX_TRANSPARENT,
    PASS,
    VERTEX_DECISIONS,
    WHITE,
    Bounces,
    Light,
    Numbers,
    RayMemory,
    Stretch,
    dimmed,
    gather,
    material_color,
    without_density,
)
from .sampler.random import hash32
from .sampler.sobol import hash_pixel, sample_1d, start_sample
from .tables import GLOSSY_RAY, HOLDOUT, KD, KS, TRANSPARENCY
from .vertex import camera_ray, clamp_limit, last_ray_finds_light, make_vertex, reflects, roulette, scatter


@device
def trace_path(f, tables, limits, memory, counters, pixel_x, pixel_y, pixel_hash, index):
    """Follow one path. Returns (radiance, alpha, rays traced)."""
    key, order = start_sample(pixel_hash, index)
    numbers = Numbers(key, order, FIRST_VERTEX)
    state = hash32(np.uint32(key ^ hash32(np.uint32(index))))  # the key alone is that of all samples of the pixel
    ray, stretch = camera_ray(f, tables, numbers, pixel_x, pixel_y)
    light, alpha, rays = Light(BLACK, WHITE, limits.clamp_direct), ONE, 0
    bounces, passed, last = Bounces(0, 0, 0), 0, np.bool_(False)  # a plain False would be a type of its own
    while True:
        met, light = follow(f, tables, memory, ray, stretch, light)
        rays += 1
        if not met:
            if f.transparent_film and bounces.total == 0:
                alpha = max(alpha - average(light.throughput), ZERO)
            break
        # What the ray met: emission, and perhaps it goes straight on.
        surface = find_surface(
            f, tables.geometry, hit_of(f, tables.geometry, memory.floats, memory.words), negate(ray.wi)
        )
        p, _, ng, material, triangle, inside = surface
        if f.holdout and bounces.total == 0 and tables.geometry.materials[material, HOLDOUT] > ZERO:
            through = material_color(tables.geometry, material, TRANSPARENCY)
            behind = dimmed(light, through)
            alpha = max(alpha - average(light.throughput) + average(behind.throughput), ZERO)
            light, passed = behind, passed + 1
            if is_black(through) or passed > MAX_TRANSPARENT:
                break
            numbers = Numbers(key, order, numbers.dimension + VERTEX_DECISIONS)
            stretch = Stretch(offset_origin(inside, negate(ng)), ZERO, stretch.t_far - memory.floats[TFAR])
            continue
        found, own = emitted(f, tables, ray, p, material, triangle)
        if not is_black(found):
            light = gather(f, light, found)
        numbers = Numbers(key, order, numbers.dimension + VERTEX_DECISIONS)
        if f.transparency:
            passes, factor = _pass(tables, numbers, material, last)
            light = dimmed(light, factor)
            if passes:
                passed += 1
                if passed > MAX_TRANSPARENT:
                    break
                stretch = Stretch(offset_origin(inside, negate(ng)), ZERO, stretch.t_far - memory.floats[TFAR])
                continue
        if last or not reflects(tables.geometry, material):
            break
        # A vertex: direct light, and a new direction.
        vertex = make_vertex(f, tables.geometry, surface, ray, own)
        light = Light(light.radiance, light.throughput, clamp_limit(limits, bounces.total + 1))
        if samples_lights(f):
            found, more = direct_light(f, tables, memory, vertex, numbers)
            light = gather(f, light, found)
            rays += more
        ray, value, state = scatter(f, tables, counters, vertex, numbers, state)
        if not ray.pdf > ZERO:
            light = gather(f, light, without_density(ray.pdf))
            break
        light = dimmed(light, scale(value, dot(vertex.n, ray.wi) / ray.pdf))
        if sees_shadows_light(f):
            light, more = follow_as_shadow(f, tables, memory, ray, vertex.start, light)
            rays += more
        bounces = _counted(f, bounces, ray.kind)
        last = _is_last(limits, bounces)
        if last and not last_ray_finds_light(f):
            break
        if bounces.total > 1:
            survives, chance = roulette(tables, numbers, light.throughput)
            if not survives:
                break
            light = dimmed(light, scale(WHITE, ONE / chance))
        stretch = Stretch(vertex.start, ZERO, FAR)
    return light.radiance, alpha, rays


@device
def _pass(tables, numbers, material, last):
    """(whether the path goes straight on through a surface, factor of its throughput, whichever it does)."""
    geometry = tables.geometry
    through = material_color(geometry, material, TRANSPARENCY)
    if is_black(through):
        return False, WHITE
    share = average(through)
    chance = ONE
    if not last:
        kd, ks = material_color(geometry, material, KD), material_color(geometry, material, KS)
        chance = share / (share + average(kd) + average(ks))
    if sample_1d(tables.sampler, numbers.key, numbers.order, numbers.dimension + PASS) < chance:
        return True, scale(through, ONE / chance)
    return False, scale(WHITE, ONE / (ONE - chance))


@device
def _counted(f, bounces, kind):
    """`bounces` after one more, of this kind."""
    if not f.ray_kinds:
        return Bounces(bounces.total + 1, 0, 0)
    glossy = 1 if kind == GLOSSY_RAY else 0
    return Bounces(bounces.total + 1, bounces.diffuse + 1 - glossy, bounces.glossy + glossy)


@device
def _is_last(limits, bounces):
    """Whether the next ray only sees emission."""
    return (
        bounces.total > limits.max_bounces
        or bounces.diffuse > limits.diffuse_bounces
        or bounces.glossy > limits.glossy_bounces
    )


def make_path_kernel(features: Features):
    """The kernel that renders a tile path by path, for any features."""

    @kernel
    def render_tile(
        tables, limits, ray, tile, first_sample, sample_count, seed, origin, sums, samples, half, active, counters, halt
    ):
        """Add samples first_sample.. of the pixels of `tile` (x0, y0, x1, y1) to the film, whose pixel (0, 0) is the
        picture's pixel `origin`. half and active are `engine/adaptive.py`'s, one pixel large where it is off.
        counters[REJECTED] counts samples that are not finite and were left out. halt[0]
        ends the work before the next pixel. Returns the number of rays traced."""
        memory = RayMemory(ray, ray.view(np.uint32))
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
                for index in range(first_sample, first_sample + sample_count):
                    radiance, alpha, traced = trace_path(
                        features, tables, limits, memory, counters, x, y, pixel_hash, index
                    )
                    rays += traced
                    add_sample(row, column, index, radiance, alpha, sums, samples, half, adaptive, counters)
        return rays

    return render_tile
