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
from . import rows
from .batch import put_at_3
from .direct import direct_light, lit_share, samples_lights
from .embree import TFAR, aligned_memory, init_ray, ray_words
from .film.sums import add_sample
from .geom.surface import find_surface, hit_of, offset_origin
from .geom.vec import BLACK, FAR, ONE, ZERO, average, dot, is_black, length, mul, negate, scale, sub
from .jit import device, kernel
from .met import emitted, follow, follow_as_shadow, sees_shadows_light, shows_world_alone, world_behind
from .parts import add_parts, credit, credit_lobes, foresee, start_parts
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
    clamped,
    dimmed,
    gather,
    material_color,
    without_density,
)
from .sampler.random import hash32
from .sampler.sobol import hash_pixel, sample_1d, start_sample
from .tables import GLOSSY_RAY, KD, KS, TRANSPARENCY
from .vertex import (
    camera_ray,
    clamp_limit,
    is_holdout,
    last_ray_finds_light,
    make_vertex,
    reflects,
    roulette,
    scatter,
    scattered_share,
)

FIRST = np.int64(0)  # the place of the one sample whose parts there are


@device
def trace_path(f, tables, limits, memory, parts, counters, pixel_x, pixel_y, pixel_hash, index):
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
        if f.light_passes and not met:
            _credit_escaped(f, tables, parts, ray, light, bounces.total)
        if not met:
            if f.transparent_film and bounces.total == 0:
                alpha = max(alpha - average(light.throughput), ZERO)
            break
        # What the ray met: emission, and perhaps it goes straight on.
        surface = find_surface(
            f, tables.geometry, hit_of(f, tables.geometry, memory.floats, memory.words), negate(ray.wi)
        )
        p, _, ng, material, triangle, inside = surface
        if bounces.total == 0 and is_holdout(f, tables.geometry, material):
            if f.light_passes:
                _credit_met(parts, light, 0)  # of the lamps before the hole
            through = material_color(tables.geometry, material, TRANSPARENCY)
            behind = dimmed(light, through)
            alpha = max(alpha - average(light.throughput) + average(behind.throughput), ZERO)
            light, passed = behind, passed + 1
            if is_black(through) or passed > MAX_TRANSPARENT:
                break
            numbers = Numbers(key, order, numbers.dimension + VERTEX_DECISIONS)
            left = stretch.t_far - memory.floats[TFAR]
            stretch = Stretch(offset_origin(inside, negate(ng)), ZERO, left, length(sub(p, ray.p)))
            continue
        found, own = emitted(f, tables, ray, p, material, triangle)
        if not is_black(found):
            light = gather(f, light, found)
        if f.light_passes:
            _credit_met(parts, light, bounces.total)
        numbers = Numbers(key, order, numbers.dimension + VERTEX_DECISIONS)
        if f.transparency:
            passes, factor = _pass(tables, numbers, material, last)
            light = dimmed(light, factor)
            if passes:
                passed += 1
                if passed > MAX_TRANSPARENT:
                    break
                left = stretch.t_far - memory.floats[TFAR]
                stretch = Stretch(offset_origin(inside, negate(ng)), ZERO, left, length(sub(p, ray.p)))
                continue
        if last or not reflects(tables.geometry, material):
            break
        # A vertex: direct light, and a new direction.
        vertex = make_vertex(f, tables.geometry, surface, ray, own)
        light = Light(light.radiance, light.throughput, clamp_limit(limits, bounces.total + 1))
        if samples_lights(f):
            found, sample, more = direct_light(f, tables, memory, vertex, numbers)
            light = gather(f, light, found)
            rays += more
            if f.light_passes:
                _credit_lit(f, parts, vertex, sample, light, bounces.total)
        ray, value, state = scatter(f, tables, counters, vertex, numbers, state)
        if not ray.pdf > ZERO:
            light = gather(f, light, without_density(ray.pdf))
            break
        if f.light_passes and bounces.total == 0:
            put_at_3(parts, rows.SHARE, FIRST, scattered_share(f, vertex, ray.kind, value), True)
        light = dimmed(light, scale(value, dot(vertex.n, ray.wi) / ray.pdf))
        if sees_shadows_light(f):
            light, more = follow_as_shadow(f, tables, memory, ray, vertex.start, light)
            rays += more
            if f.light_passes:
                credit_lobes(parts, bounces.total + 1, rows.SHARE, FIRST, light.radiance, True)
        bounces = _counted(f, bounces, ray.kind)
        last = _is_last(limits, bounces)
        if last and not last_ray_finds_light(f):
            break
        if bounces.total > 1:
            survives, chance = roulette(tables, numbers, light.throughput)
            if not survives:
                break
            light = dimmed(light, scale(WHITE, ONE / chance))
        stretch = Stretch(vertex.start, ZERO, FAR, ZERO)
    return light.radiance, alpha, rays


@device
def _credit_escaped(f, tables, parts, ray, light, scatterings):
    """The light that came with a ray that met nothing has its part."""
    if scatterings > 0:
        credit_lobes(parts, scatterings, rows.SHARE, FIRST, light.radiance, True)
    elif shows_world_alone(f):
        credit(parts, rows.ENVIRONMENT, FIRST, light.radiance, True)
    else:
        world = clamped(f, mul(light.throughput, world_behind(f, tables, ray.wi)), light.limit)
        foresee(parts, rows.ENVIRONMENT, FIRST, world, True)
        credit(parts, rows.EMISSION, FIRST, light.radiance, True)


@device
def _credit_met(parts, light, scatterings):
    """The light that came with a ray to a surface, and the surface's own, has its part."""
    if scatterings > 0:
        credit_lobes(parts, scatterings, rows.SHARE, FIRST, light.radiance, True)
    else:
        credit(parts, rows.EMISSION, FIRST, light.radiance, True)


@device
def _credit_lit(f, parts, vertex, sample, light, scatterings):
    """The light that a `LightSample` brought to a vertex has its part."""
    if scatterings == 0:
        put_at_3(parts, rows.LIGHT_SHARE, FIRST, lit_share(f, vertex, sample), True)
        credit_lobes(parts, 1, rows.LIGHT_SHARE, FIRST, light.radiance, True)
    else:
        credit_lobes(parts, scatterings + 1, rows.SHARE, FIRST, light.radiance, True)


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


def new_path(lamp_count: int, light_passes: int = 0) -> np.ndarray:
    """A thread's memory, in a scene where a ray may meet so many lamps. light_passes: with room for parts, or 0."""
    parts = light_passes * rows.PART_ROWS
    memory = aligned_memory(ray_words(lamp_count) + parts)
    init_ray(memory, lamp_count)
    return memory


def make_path_kernel(features: Features):
    """The kernel that renders a tile path by path, for any features."""

    @kernel
    def render_tile(
        tables, limits, ray, tile, first_sample, sample_count, seed, origin, sums, samples, half, active, film_parts,
        counters, halt,
    ):  # fmt: skip
        """Add samples first_sample.. of the pixels of `tile` (x0, y0, x1, y1) to the film, whose pixel (0, 0) is the
        picture's pixel `origin`. half and active are `engine/adaptive.py`'s, one pixel large where it is off, and
        film_parts are `parts.PartSums`, as small where no pass shows a part of the light.
        counters[REJECTED] counts samples that are not finite: they count as black. halt[0]
        ends the work before the next pixel. Returns the number of rays traced."""
        memory = RayMemory(ray, ray.view(np.uint32))
        parts = ray[len(ray) - features.light_passes * rows.PART_ROWS :].reshape((-1, 1))
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
                    if features.light_passes:
                        start_parts(parts, FIRST, True)
                    radiance, alpha, traced = trace_path(
                        features, tables, limits, memory, parts, counters, x, y, pixel_hash, index
                    )
                    rays += traced
                    add_sample(row, column, index, radiance, alpha, sums, samples, half, adaptive, counters)
                    if features.light_passes:
                        add_parts(film_parts, row, column, parts, FIRST, radiance)
        return rays

    return render_tile
