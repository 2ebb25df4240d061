"""The path tracer without stages: one function that follows one path, and a kernel that fills a tile with them.

It renders what the engine's kernel (`engine/kernels/staged.py`) does, from the same numbers and with the same functions
at each vertex: the algorithm on one page, for tests that compare the two, and for a trial of what the stages bring.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import cache
from unittest import mock

import numpy as np

from engine import tiles
from engine.features import LISTED_LAMPS, TRACED_LAMPS, Features
from engine.kernels import embree, rows
from engine.kernels.batch import put_at_3
from engine.kernels.direct import dimmed_on_way, lit_share, samples_lights, shadow_segment, unshadowed_light
from engine.kernels.embree import LAMP_COUNT, TFAR, aligned_memory, init_ray, intersect, ray_words
from engine.kernels.film.sums import add_sample
from engine.kernels.geom.surface import find_surface, hit_of, offset_origin
from engine.kernels.geom.vec import BLACK, FAR, ONE, ZERO, add, average, dot, is_black, length, mul, negate, scale, sub
from engine.kernels.jit import device, kernel
from engine.kernels.met import (
    Notes,
    emitted,
    escaped,
    gather_listed_lamps,
    gather_noted_lamps,
    reach,
    sees_shadows_light,
    shows_world_alone,
    world_behind,
)
from engine.kernels.parts import add_parts, credit, credit_lit, credit_lobes, foresee, start_parts
from engine.kernels.records import (
    FIRST_VERTEX,
    MAX_TRANSPARENT,
    VERTEX_DECISIONS,
    WHITE,
    Bounces,
    Light,
    Numbers,
    Ray,
    RayMemory,
    Stretch,
    clamped,
    gather,
    material_color,
    without_density,
)
from engine.kernels.sampler.sobol import hash_pixel, start_sample
from engine.kernels.tables import TRANSPARENCY
from engine.kernels.vertex import (
    camera_ray,
    clamp_limit,
    counted,
    is_holdout,
    is_last,
    last_ray_finds_light,
    make_vertex,
    pass_through,
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
                alpha -= average(light.throughput)
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
            alpha -= average(light.throughput) - average(behind.throughput)
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
            passes, factor = pass_through(tables, numbers, material, last)
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
            light, sample, more = direct_light(f, tables, memory, vertex, numbers, light)
            rays += more
            if f.light_passes:
                _credit_lit(f, parts, vertex, sample, light, bounces.total)
        ray, value = scatter(f, tables, counters, True, vertex, numbers)
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
                credit_lobes(parts, bounces.total == 0, rows.SHARE, FIRST, light.radiance, True)
        bounces = counted(f, bounces, ray.kind)
        last = is_last(limits, bounces)
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
def dimmed(light, factor):
    """`light` where of what is found from here on this much arrives."""
    return Light(light.radiance, mul(light.throughput, factor), light.limit)


@device
def direct_light(f, tables, memory, vertex, numbers, light):
    """(`light` with that of one light sample, what was sampled, rays traced)."""
    sample, found = unshadowed_light(f, tables, vertex, numbers)
    brings, rays = mul(light.throughput, found), 0
    if sample.shadowed and sample.pdf > ZERO and not is_black(found):
        direction, t_far = shadow_segment(vertex, sample)
        brings, rays = dimmed_on_way(f, tables.geometry, memory, vertex.start, direction, t_far, brings)
    return Light(add(light.radiance, clamped(f, brings, light.limit)), light.throughput, light.limit), sample, rays


@device
def intersect_noting_lamps(scene, ray, words, origin, direction, t_near, t_far, mask):
    """As `intersect`, and note the lamps before the hit, in no order, and perhaps some behind it: LAMP_COUNT of them
    behind their number."""
    embree._set_ray(ray, words, origin, direction, t_near, t_far, mask)
    words[embree.GEOM_ID] = embree.INVALID
    words[embree.INST_ID] = embree.INVALID
    words[LAMP_COUNT] = np.uint32(0)
    address, pointer = np.uintp(ray.ctypes.data), embree._pointer
    embree._rtcIntersect1(pointer(scene), pointer(address), pointer(address + np.uintp(4 * embree._ARGUMENTS)))
    return words[embree.GEOM_ID] != embree.INVALID


@device
def follow(f, tables, memory, ray, stretch, light):
    """Follow a ray to the next surface, and gather the light that it finds: of the lamps before the surface, and of
    suns and the world if there is none.

    Returns (whether a surface was met, which is then in `memory`, `light`)."""
    scene, floats, words, mask = (
        tables.geometry.accel[0],
        memory.floats,
        memory.words,
        reach(f, ray.kind, ray.as_shadow),
    )
    if f.lamp_shapes & TRACED_LAMPS:
        met = intersect_noting_lamps(scene, floats, words, stretch.start, ray.wi, stretch.t_near, stretch.t_far, mask)
        notes = Notes(words, floats, np.int64(LAMP_COUNT + 1), words[LAMP_COUNT], stretch.t_near, floats[TFAR])
        light = gather_noted_lamps(f, tables, notes, ray, stretch.start, light)
    else:
        met = intersect(scene, floats, words, stretch.start, ray.wi, stretch.t_near, stretch.t_far, mask)
    if f.lamp_shapes & LISTED_LAMPS:
        light = gather_listed_lamps(f, tables, ray, stretch, floats[TFAR], light)
    if not met:
        light = escaped(f, tables, ray, light)
    return met, light


@device
def follow_as_shadow(f, tables, memory, ray, start, light):
    """The part of BSDF sampling in the direct light where rays do not see what shadow rays see: along the direction
    of the path's next ray, what a shadow ray sees. Returns (`light`, rays traced)."""
    geometry, throughput = tables.geometry, light.throughput
    ray = Ray(ray.p, ray.n, ray.wi, ray.kind, ray.pdf, True)
    stretch, rays = Stretch(start, ZERO, FAR, ZERO), 0
    for _ in range(MAX_TRANSPARENT):
        met, light = follow(f, tables, memory, ray, stretch, light)
        rays += 1
        if not met:
            break
        hit = hit_of(f, geometry, memory.floats, memory.words)
        p, _, ng, material, triangle, inside = find_surface(f, geometry, hit, negate(ray.wi))
        found, _ = emitted(f, tables, ray, p, material, triangle)
        light = gather(f, light, found)
        if not f.transparency:
            break
        light = dimmed(light, material_color(geometry, material, TRANSPARENCY))
        if is_black(light.throughput):
            break
        stretch = Stretch(offset_origin(inside, negate(ng)), ZERO, FAR, length(sub(p, ray.p)))
    return Light(light.radiance, throughput, light.limit), rays


@device
def _credit_escaped(f, tables, parts, ray, light, scatterings):
    """The light that came with a ray that met nothing has its part."""
    if scatterings > 0:
        credit_lobes(parts, scatterings == 1, rows.SHARE, FIRST, light.radiance, True)
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
        credit_lobes(parts, scatterings == 1, rows.SHARE, FIRST, light.radiance, True)
    else:
        credit(parts, rows.EMISSION, FIRST, light.radiance, True)


@device
def _credit_lit(f, parts, vertex, sample, light, scatterings):
    """The light that a `LightSample` brought to a vertex has its part."""
    if scatterings == 0:
        put_at_3(parts, rows.LIGHT_SHARE, FIRST, lit_share(f, vertex, sample), True)
    credit_lit(parts, scatterings == 0, FIRST, light.radiance, True)


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


path_kernel = cache(make_path_kernel)


def new_memory(features: Features, lamp_count: int = 0) -> np.ndarray:
    """A thread's, for `path_kernel`, as `batch.new_batch` is for the engine's."""
    return new_path(lamp_count, features.light_passes)


@contextlib.contextmanager
def by_path() -> Iterator[None]:
    """Within, the compiled road renders path by path."""
    with mock.patch.object(tiles, "tile_kernel", path_kernel), mock.patch.object(tiles, "new_batch", new_memory):
        yield
