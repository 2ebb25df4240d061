"""The path tracer in stages: a batch of paths goes together from vertex to vertex, sixteen in a register.

camera -> (trace all rays -> shade all hits -> trace all shadow rays), until no path is left -> film. What is done at a
vertex is in `vertex`, `direct` and `met`, given vectors. Paths that end make room, so that the registers stay full.

A sample's light is added up in the order of its path, and a pixel's samples in the order of their numbers: what comes
out depends neither on threads nor, but for roundings, on where batches end. Where two surfaces lie in the same place,
which of them a camera ray meets depends on the rays in its packet, and so on the region that is rendered.
"""

from __future__ import annotations

import numpy as np

from ..features import DARK_WORLD, Features
from . import rows
from .batch import BATCH, add_at_3, at_3, batch_of, load_3, put_at_3, rays_at, store_3, store_front_3
from .bsdf.diffuse import REJECTION
from .direct import lit_share, samples_lights, shadow_segment, unshadowed_light
from .film.sums import add_sample
from .geom.surface import Hit, find_surface
from .geom.vec import BLACK, FAR, ONE, UP, ZERO, dot, is_black, mul, negate, scale
from .jit import device, kernel
from .met import emitted, escaped, shows_world_alone, world_behind
from .parts import add_parts, credit, credit_lobes, foresee, foresee_lit, start_parts
from .rays import occluded_all, trace_all
from .records import (
    FIRST_VERTEX,
    VERTEX_DECISIONS,
    WHITE,
    Light,
    Numbers,
    Ray,
    clamped,
    without_density,
)
from .sampler.sobol import hash_pixel, start_sample
from .simd import (
    WIDTH,
    add_at,
    any_of,
    count,
    first_lanes,
    int32,
    lanes,
    load,
    no,
    select,
    store,
    store_front,
    to_index,
)
from .tables import CAMERA_RAY, DIFFUSE_RAY
from .vertex import (
    camera_ray,
    clamp_limit,
    last_ray_finds_light,
    make_vertex,
    reflects,
    roulette,
    scatter,
    scattered_share,
)

NONE = np.int64(0)  # not a plain 0, see `tables.words`


def covers(f: Features) -> bool:
    """Whether this kernel does all that a scene with these features needs."""
    usual = f.shared_light and not f.transparency and not f.ray_kinds and not f.holdout
    return usual and f.hemisphere != REJECTION


# --- samples ---------------------------------------------------------------------------------------------------------


@device
def _next_samples(batch, tile, first_sample, sample_count, origin, active, x, y, done):
    """Fill the batch with samples from sample `done` of pixel (x, y) on, pixel by pixel.

    Returns (their number, and where to go on: x, y, done)."""
    words, n, adaptive = batch.sample_words, NONE, active.size > 1
    while n < BATCH and y < tile[3]:
        if done < sample_count and (not adaptive or active[y - origin[1], x - origin[0]]):
            words[rows.X, n], words[rows.Y, n] = np.uint32(x), np.uint32(y)
            words[rows.INDEX, n] = np.uint32(first_sample + done)
            n, done = n + 1, done + 1
            continue
        done, x = NONE, x + 1
        if x >= tile[2]:
            x, y = tile[0], y + 1
    return n, x, y, done


@device
def _to_film(f, batch, n, origin, sums, samples, half, active, film_parts, counters):
    """Add the batch's samples to their pixels, one after the other."""
    words, found, adaptive = batch.sample_words, batch.samples, active.size > 1
    for i in range(n):
        row, column = np.int64(words[rows.Y, i]) - origin[1], np.int64(words[rows.X, i]) - origin[0]
        radiance = found[rows.LIGHT, i], found[rows.LIGHT + 1, i], found[rows.LIGHT + 2, i]
        index, alpha = words[rows.INDEX, i], found[rows.ALPHA, i]
        add_sample(row, column, index, radiance, alpha, sums, samples, half, adaptive, counters)
        if f.light_passes:
            add_parts(film_parts, row, column, batch.parts, i, radiance)


# --- paths -----------------------------------------------------------------------------------------------------------


@device
def _start_paths(f, tables, batch, n, seed):
    """The camera's rays for the batch's first n samples."""
    paths, words = batch.paths, batch.path_words
    for i in range(0, n, WIDTH):
        x, y = load(batch.sample_words, rows.X, i), load(batch.sample_words, rows.Y, i)
        key, order = start_sample(hash_pixel(x, y, seed), load(batch.sample_words, rows.INDEX, i))
        ray, stretch = camera_ray(f, tables, Numbers(key, order, FIRST_VERTEX), x, y)
        for lane in range(WIDTH):
            words[rows.PLACE, i + lane] = np.uint32(i + lane)
        store(words, rows.KEY, i, key)
        store(words, rows.ORDER, i, order)
        store_3(paths, rows.THROUGHPUT, i, WHITE)
        store_3(paths, rows.P, i, ray.p)
        store_3(paths, rows.N, i, ray.n)
        store_3(paths, rows.WI, i, ray.wi)
        store(paths, rows.PDF, i, ray.pdf)
        store_3(paths, rows.START, i, stretch.start)
        store(paths, rows.T_NEAR, i, stretch.t_near)
        store(paths, rows.T_FAR, i, stretch.t_far)
        store_3(batch.samples, rows.LIGHT, i, BLACK)
        if f.light_passes:
            start_parts(batch.parts, lanes() + np.uint32(i), first_lanes(n - i))
        store(batch.samples, rows.ALPHA, i, ONE)


@device
def _follow_paths(f, tables, limits, batch, n, counters, halt):
    """Follow the batch's n paths to their ends. Returns the number of rays traced."""
    bounces, kind, dimension, rays, samples = NONE, CAMERA_RAY, FIRST_VERTEX, NONE, n
    while n > 0 and not halt[0]:
        first, last = bounces == 0, bounces > limits.max_bounces
        trace_all(f, tables, batch, n, kind, clamp_limit(limits, bounces), first)
        if f.light_passes and first and not shows_world_alone(f):
            _foresee_world(f, tables, limits, batch, n)
        rays += n
        dimension += VERTEX_DECISIONS
        n, shadows = _shade(f, tables, limits, batch, n, counters, kind, dimension, bounces, last)
        if f.light_passes:
            _credit_found(f, batch, samples, bounces)
        occluded_all(f, tables, batch, shadows, first)
        rays += shadows
        bounces, kind = bounces + 1, DIFFUSE_RAY
    return rays


@device
def _shade(f, tables, limits, batch, n, counters, kind, dimension, bounces, last):
    """From the hits of n rays to the next rays. Returns (paths that go on, shadow rays), packed together in `batch`."""
    live, shadows = NONE, NONE
    goes_on = not last and (bounces < limits.max_bounces or last_ray_finds_light(f))
    for i in range(0, n, WIDTH):
        paths, words = batch.paths, batch.path_words
        within = first_lanes(n - i)
        place = to_index(select(within, load(words, rows.PLACE, i), np.uint32(0)))
        met = load(batch.hit_words, rows.MET, i) != np.uint32(0)
        ray = rays_at(paths, i, kind)
        light = Light(BLACK, load_3(paths, rows.THROUGHPUT, i), clamp_limit(limits, bounces))
        _add_escaped(f, tables, batch, ray, light, place, within & no(met), bounces)
        alive = within & met
        if not any_of(alive):
            continue
        triangle, instance = load(batch.hit_words, rows.TRIANGLE, i), int32(load(batch.hit_words, rows.INSTANCE, i))
        hit = Hit(to_index(triangle), instance, load(batch.hits, rows.U, i), load(batch.hits, rows.V, i))
        surface = find_surface(f, tables.geometry, hit, negate(ray.wi))
        found, own = emitted(f, tables, ray, surface[0], surface[3], surface[4])
        shines = alive & no(is_black(found))
        if any_of(shines):
            contribution = clamped(f, mul(light.throughput, found), light.limit)
            add_at_3(batch.samples, rows.LIGHT, place, contribution, shines)
        alive = alive & reflects(tables.geometry, surface[3])
        if last or not any_of(alive):
            continue
        vertex = make_vertex(f, tables.geometry, surface, ray, own)
        numbers = Numbers(load(words, rows.KEY, i), load(words, rows.ORDER, i), dimension)
        light = Light(BLACK, light.throughput, clamp_limit(limits, bounces + 1))
        if samples_lights(f):
            shadows += _queue_shadows(f, tables, batch, vertex, numbers, light, place, alive, shadows, bounces)
        if goes_on:
            live += _go_on(f, tables, batch, vertex, numbers, light, place, alive, live, counters, bounces)
    return live, shadows


@device
def _add_escaped(f, tables, batch, ray, light, place, missed, bounces):
    """To the samples of rays that met nothing: the light of what lies behind everything."""
    if f.transparent_film and bounces == 0:
        add_at(batch.samples, rows.ALPHA, place, -ONE, missed)
    if (f.world != DARK_WORLD or f.sun_disks) and any_of(missed):
        # The image is looked up in all lanes, also in those past the last path.
        ray = Ray(ray.p, ray.n, select(missed, ray.wi, UP), ray.kind, ray.pdf, ray.as_shadow)
        light = Light(at_3(batch.samples, rows.LIGHT, place), light.throughput, light.limit)
        put_at_3(batch.samples, rows.LIGHT, place, escaped(f, tables, ray, light).radiance, missed)


@device
def _foresee_world(f, tables, limits, batch, n):
    """Of the light that the camera's rays find behind everything, the world's has its part: the rest is of lamps."""
    for i in range(0, n, WIDTH):
        missed = first_lanes(n - i) & (load(batch.hit_words, rows.MET, i) == np.uint32(0))
        wi = select(missed, load_3(batch.paths, rows.WI, i), UP)
        world = clamped(f, world_behind(f, tables, wi), limits.clamp_direct)
        foresee(batch.parts, rows.ENVIRONMENT, lanes() + np.uint32(i), world, missed)


@device
def _credit_found(f, batch, n, bounces):
    """What the rays of a stage have found for the batch's n samples has its part."""
    parts = batch.parts
    for i in range(0, n, WIDTH):
        within, place = first_lanes(n - i), lanes() + np.uint32(i)
        found = load_3(batch.samples, rows.LIGHT, i)
        if bounces > 0:
            credit_lobes(parts, bounces, rows.SHARE, place, found, within)
            continue
        if shows_world_alone(f):
            missed = within & (load(batch.hit_words, rows.MET, i) == np.uint32(0))
            credit(parts, rows.ENVIRONMENT, place, found, missed)
        credit(parts, rows.EMISSION, place, found, within)


@device
def _queue_shadows(f, tables, batch, vertex, numbers, light, place, alive, at_column, bounces):
    """Draw a light sample for each vertex, and queue its shadow ray from that column on. Returns how many."""
    sample, found = unshadowed_light(f, tables, vertex, numbers)
    arrives, brings = alive & no(is_black(found)), clamped(f, mul(light.throughput, found), light.limit)
    sends = arrives & sample.shadowed & (sample.pdf > ZERO)
    at_once = arrives & no(sends)  # light that nothing shadows, and of a density that is no number
    if any_of(at_once):
        add_at_3(batch.samples, rows.LIGHT, place, brings, at_once)
    if f.light_passes:
        if bounces == 0:
            put_at_3(batch.parts, rows.LIGHT_SHARE, place, lit_share(f, vertex, sample), alive)
        foresee_lit(batch.parts, place, brings, at_once, bounces == 0)
    direction, t_far = shadow_segment(vertex, sample)
    store_front(batch.shadow_words, rows.TO, at_column, place, sends)
    store_front_3(batch.shadows, rows.FROM, at_column, vertex.start, sends)
    store_front_3(batch.shadows, rows.DIRECTION, at_column, direction, sends)
    store_front(batch.shadows, rows.END, at_column, t_far, sends)
    store_front_3(batch.shadows, rows.BRINGS, at_column, brings, sends)
    return count(sends)


@device
def _go_on(f, tables, batch, vertex, numbers, light, place, alive, at_column, counters, bounces):
    """Draw a new ray for each vertex, and write the paths that go on from that column on. Returns how many."""
    paths, words = batch.paths, batch.path_words
    ray, value, _ = scatter(f, tables, counters, vertex, numbers, np.uint32(0))
    failed = alive & no(ray.pdf > ZERO)
    if any_of(failed):
        add_at_3(batch.samples, rows.LIGHT, place, mul(light.throughput, without_density(ray.pdf)), failed)
    alive = alive & (ray.pdf > ZERO)
    if f.light_passes and bounces == 0:
        put_at_3(batch.parts, rows.SHARE, place, scattered_share(f, vertex, ray.kind, value), alive)
    throughput = mul(light.throughput, scale(value, dot(vertex.n, ray.wi) / ray.pdf))
    if bounces > 0:
        survives, chance = roulette(tables, numbers, throughput)
        alive, throughput = alive & survives, scale(throughput, ONE / chance)
    store_front(words, rows.KEY, at_column, numbers.key, alive)
    store_front(words, rows.ORDER, at_column, numbers.order, alive)
    store_front(words, rows.PLACE, at_column, place, alive)
    store_front_3(paths, rows.THROUGHPUT, at_column, throughput, alive)
    store_front_3(paths, rows.P, at_column, vertex.p, alive)
    store_front_3(paths, rows.N, at_column, vertex.n, alive)
    store_front_3(paths, rows.WI, at_column, ray.wi, alive)
    store_front(paths, rows.PDF, at_column, ray.pdf, alive)
    store_front_3(paths, rows.START, at_column, vertex.start, alive)
    store(paths, rows.T_NEAR, at_column, ZERO)
    store(paths, rows.T_FAR, at_column, FAR)
    return count(alive)


def make_staged_kernel(features: Features):
    """As `path.make_path_kernel`, for features that `covers` says yes to; `memory` is that of `batch.new_batch`."""

    @kernel
    def render_tile(
        tables, limits, memory, tile, first_sample, sample_count, seed, origin, sums, samples, half, active, film_parts,
        counters, halt,
    ):  # fmt: skip
        """See `path.make_path_kernel`. halt[0] is asked at every vertex; what the batch has gathered is then lost."""
        batch, rays = batch_of(features, memory), NONE
        x, y, done = tile[0], tile[1], NONE
        while True:
            n, x, y, done = _next_samples(batch, tile, first_sample, sample_count, origin, active, x, y, done)
            if n == 0 or halt[0]:
                return rays
            _start_paths(features, tables, batch, n, seed)
            rays += _follow_paths(features, tables, limits, batch, n, counters, halt)
            if halt[0]:
                return rays
            _to_film(features, batch, n, origin, sums, samples, half, active, film_parts, counters)

    return render_tile
