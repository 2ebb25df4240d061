"""The path tracer in stages: a batch of paths goes together from vertex to vertex, sixteen in a register.

camera -> (trace all rays -> shade all hits -> trace all shadow rays), until no path is left -> film. What is done at a
vertex is in `vertex`, `direct` and `met`, given vectors. Paths that end make room, so that the registers stay full.
`f` is the scene's `Features` everywhere: constants, so that what is off costs nothing.

Unidirectional, with light sampling at every vertex (`direct`), light that rays meet (`met`), multiple importance
sampling of both (`mis`) and Russian roulette. Bounces count as in Cycles: `max_bounces` 0 is direct light. A path that
has used up its bounces takes one more ray, which only sees emission: that is the BSDF-sampled half of the last vertex's
direct light.

A sample's light is added up in the order of its path, and a pixel's samples in the order of their numbers: what comes
out depends neither on threads nor, but for roundings, on where batches end. Where two surfaces lie in the same place,
which of them a camera ray meets depends on the rays in its packet, and so on the region that is rendered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..features import DARK_WORLD, Features
from . import rows
from .batch import (
    BATCH,
    add_at_3,
    at_3,
    batch_of,
    bounces_at,
    is_mixed,
    load_3,
    put_at_3,
    rays_at,
    store_3,
    store_front_3,
    with_looks,
)
from .direct import lit_share, samples_lights, shadow_segment, unshadowed_light
from .film.sums import add_sample
from .geom.surface import Hit, find_surface, offset_origin
from .geom.vec import BLACK, FAR, ONE, UP, ZERO, average, dot, is_black, length, mul, negate, scale, sub
from .jit import device, kernel
from .met import emitted, escaped, sees_shadows_light, shows_world_alone, world_behind
from .parts import add_parts, credit, credit_lobes, foresee, foresee_lit, start_parts
from .rays import light_all, trace_all
from .records import (
    FIRST_VERTEX,
    MAX_TRANSPARENT,
    VERTEX_DECISIONS,
    WHITE,
    Bounces,
    Light,
    Numbers,
    Ray,
    clamped,
    material_color,
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
    uint32,
)
from .tables import CAMERA_RAY, TRANSPARENCY
from .vertex import (
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

NONE = np.int64(0)  # not a plain 0, see `tables.words`


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


class Path(NamedTuple):
    """Of sixteen paths of the batch, side by side; `i` is the column of the first, `passed` how many surfaces each has
    gone straight through, `place` their samples' columns."""

    i: np.int64
    place: np.uint32
    numbers: Numbers
    ray: Ray
    bounces: Bounces
    passed: np.uint32
    light: Light


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
        if is_mixed(f):
            store(words, rows.BOUNCES, i, np.uint32(0))
            store(words, rows.DIFFUSE, i, np.uint32(0))
            store(words, rows.KIND, i, CAMERA_RAY)
            store(paths, rows.BEGINS, i, stretch.begins)
        store_3(batch.samples, rows.LIGHT, i, BLACK)
        if f.light_passes:
            start_parts(batch.parts, lanes() + np.uint32(i), first_lanes(n - i))
        store(batch.samples, rows.ALPHA, i, ONE)


@device
def _follow_paths(f, tables, limits, batch, n, counters, halt):
    """Follow the batch's n paths to their ends. Returns the number of rays traced."""
    stage, dimension, rays = NONE, FIRST_VERTEX, NONE
    while n > 0 and not halt[0]:
        trace_all(f, tables, limits, batch, n, stage, False)
        rays += n
        dimension += VERTEX_DECISIONS
        n, shadows, looks = _shade(f, tables, limits, batch, n, counters, dimension, stage)
        rays += light_all(f, tables, limits, batch, shadows, stage)
        stage += 1
        if sees_shadows_light(f):
            rays += _look_as_shadows(f, tables, limits, with_looks(batch), looks, stage)
    return rays


@device
def _shade(f, tables, limits, batch, n, counters, dimension, stage):
    """From the hits of n rays to the next rays. Returns (paths that go on, shadow rays, rays that see as those do),
    packed together in `batch`."""
    live, shadows, looks = NONE, NONE, NONE
    for i in range(0, n, WIDTH):
        within, met = first_lanes(n - i), load(batch.hit_words, rows.MET, i) != np.uint32(0)
        path = _path_at(f, limits, batch, i, within, dimension, stage, False)
        _add_escaped(f, tables, batch, path, within & no(met))
        if finds_lamps_alone(f, limits, stage):
            continue
        alive = within & met
        if not any_of(alive):
            continue
        surface = find_surface(f, tables.geometry, _hit_at(batch, i), negate(path.ray.wi))
        material = surface[3]
        hole = alive & (path.bounces.total == 0) & is_holdout(f, tables.geometry, material)
        own = _add_emitted(f, tables, batch, path, surface, alive, hole)
        last = is_last(limits, path.bounces)
        passes, throughput = _pass_on(f, tables, batch, path, material, alive, hole, last)
        alive = alive & no(hole | passes | last) & reflects(tables.geometry, material)
        if not any_of(alive | passes):
            continue
        vertex = make_vertex(f, tables.geometry, surface, path.ray, own)
        light = Light(BLACK, throughput, clamp_limit(limits, path.bounces.total + np.uint32(1)))
        if samples_lights(f) and any_of(alive):
            shadows += _queue_shadows(f, tables, batch, path, vertex, light, alive, shadows)
        if not (last_ray_finds_light(f) or sees_shadows_light(f)):
            alive = alive & (path.bounces.total < limits.max_bounces)
        if any_of(alive | passes):
            ray, throughput, alive = _scatter(f, tables, batch, path, vertex, light, alive, counters)
            if sees_shadows_light(f):
                looks += _queue_looks(f, batch, path, vertex, ray, throughput, alive, looks)
            live += _go_on(f, tables, limits, batch, path, surface, vertex, ray, light, throughput, alive, passes, live)
    return live, shadows, looks


@device
def finds_lamps_alone(f, limits, stage):
    """Whether nothing is to be found on surfaces by the rays of a stage, which then are the last ones."""
    return not (is_mixed(f) or f.mesh_emitters or f.light_passes) and stage > limits.max_bounces


@device
def _path_at(f, limits, batch, i, within, dimension, stage, as_shadow):
    """The `Path` from column i on. Lanes that are not `within` have the first sample's place."""
    words, bounces = batch.path_words, bounces_at(f, batch, i, stage)
    place = to_index(select(within, load(words, rows.PLACE, i), np.uint32(0)))
    numbers = Numbers(load(words, rows.KEY, i), load(words, rows.ORDER, i), dimension)
    light = Light(BLACK, load_3(batch.paths, rows.THROUGHPUT, i), clamp_limit(limits, bounces.total))
    ray, passed = rays_at(f, batch, i, stage, as_shadow), uint32(stage) - bounces.total
    return Path(i, place, numbers, ray, bounces, passed, light)


@device
def _hit_at(batch, i):
    triangle, instance = load(batch.hit_words, rows.TRIANGLE, i), load(batch.hit_words, rows.INSTANCE, i)
    return Hit(to_index(triangle), int32(instance), load(batch.hits, rows.U, i), load(batch.hits, rows.V, i))


# --- what rays find ---------------------------------------------------------------------------------------------------


@device
def _add_escaped(f, tables, batch, path, missed):
    """To the samples of rays that met nothing: the light of what lies behind everything."""
    ray, place, light = path.ray, path.place, path.light
    if f.transparent_film:
        _uncover(batch, place, average(light.throughput), missed & (path.bounces.total == 0))
    if not any_of(missed):
        return
    # The image is looked up in all lanes, also in those past the last path.
    wi = select(missed, ray.wi, UP)
    if f.world != DARK_WORLD or f.sun_disks:
        before = Light(at_3(batch.samples, rows.LIGHT, place), light.throughput, light.limit)
        after = escaped(f, tables, Ray(ray.p, ray.n, wi, ray.kind, ray.pdf, ray.as_shadow), before)
        put_at_3(batch.samples, rows.LIGHT, place, after.radiance, missed)
    if f.light_passes:
        seen = missed & (path.bounces.total == 0)
        if not shows_world_alone(f) and any_of(seen):
            # Of the light that the camera's rays find behind everything the world's has its part: the rest is of lamps.
            world = clamped(f, mul(light.throughput, world_behind(f, tables, wi)), light.limit)
            foresee(batch.parts, rows.ENVIRONMENT, place, world, seen)
        _credit_found(batch, path, missed, rows.ENVIRONMENT if shows_world_alone(f) else rows.EMISSION)


@device
def _uncover(batch, place, much, mask):
    """Take so much off the samples' alpha. Of a single sample it may fall below 0: only their mean is the alpha."""
    add_at(batch.samples, rows.ALPHA, place, -much, mask)


@device
def _add_emitted(f, tables, batch, path, surface, alive, hole):
    """To the samples of rays that met a surface, and no hole in the picture: its light. Returns the emitters there."""
    p, _, _, material, triangle, _ = surface
    found, own = emitted(f, tables, path.ray, p, material, triangle)
    shines = alive & no(hole) & no(is_black(found))
    if any_of(shines):
        contribution = clamped(f, mul(path.light.throughput, found), path.light.limit)
        add_at_3(batch.samples, rows.LIGHT, path.place, contribution, shines)
    if f.light_passes:
        _credit_found(batch, path, alive, rows.EMISSION)
    return own


@device
def _credit_found(batch, path, mask, part):
    """What the paths' rays have found has its part: that one, if they are the camera's."""
    found, first = at_3(batch.samples, rows.LIGHT, path.place), path.bounces.total == 0
    credit(batch.parts, part, path.place, found, mask & first)
    credit_lobes(batch.parts, path.bounces.total == 1, rows.SHARE, path.place, found, mask & no(first))


# --- what becomes of them ---------------------------------------------------------------------------------------------


@device
def _pass_on(f, tables, batch, path, material, alive, hole, last):
    """(which of the paths that are alive go straight on through the surface that they have met, all throughputs)."""
    passes, throughput, geometry = first_lanes(NONE), path.light.throughput, tables.geometry
    if f.transparency:
        chosen, factor = pass_through(tables, path.numbers, material, last)
        passes, throughput = alive & chosen, mul(throughput, factor)
    if f.holdout:
        through = material_color(geometry, material, TRANSPARENCY)
        behind = mul(path.light.throughput, through)
        _uncover(batch, path.place, average(path.light.throughput) - average(behind), hole)
        passes, throughput = select(hole, no(is_black(through)), passes), select(hole, behind, throughput)
    return passes, throughput


@device
def _queue_shadows(f, tables, batch, path, vertex, light, alive, at_column):
    """Draw a light sample for each vertex, and queue its shadow ray from that column on. Returns how many."""
    place, first = path.place, path.bounces.total == 0
    sample, found = unshadowed_light(f, tables, vertex, path.numbers)
    arrives, brings = alive & no(is_black(found)), mul(light.throughput, found)
    sends = arrives & sample.shadowed & (sample.pdf > ZERO)
    at_once = arrives & no(sends)  # light that nothing shadows, and of a density that is no number
    if any_of(at_once):
        add_at_3(batch.samples, rows.LIGHT, place, clamped(f, brings, light.limit), at_once)
    if f.light_passes:
        put_at_3(batch.parts, rows.LIGHT_SHARE, place, lit_share(f, vertex, sample), alive & first)
        foresee_lit(batch.parts, first, place, clamped(f, brings, light.limit), at_once)
    if f.light_passes or f.clamp:
        store_front(batch.shadow_words, rows.FIRST, at_column, select(first, np.uint32(1), np.uint32(0)), sends)
    direction, t_far = shadow_segment(vertex, sample)
    store_front(batch.shadow_words, rows.TO, at_column, place, sends)
    store_front_3(batch.shadows, rows.FROM, at_column, vertex.start, sends)
    store_front_3(batch.shadows, rows.DIRECTION, at_column, direction, sends)
    store_front(batch.shadows, rows.END, at_column, t_far, sends)
    store_front_3(batch.shadows, rows.BRINGS, at_column, brings, sends)
    return count(sends)


@device
def _scatter(f, tables, batch, path, vertex, light, alive, counters):
    """Draw a new ray for each vertex. Returns (the rays, throughput along them, which of the paths have one)."""
    ray, value = scatter(f, tables, counters, alive, vertex, path.numbers)
    failed = alive & no(ray.pdf > ZERO)
    if any_of(failed):
        add_at_3(batch.samples, rows.LIGHT, path.place, mul(light.throughput, without_density(ray.pdf)), failed)
    alive = alive & (ray.pdf > ZERO)
    if f.light_passes:
        share = scattered_share(f, vertex, ray.kind, value)
        put_at_3(batch.parts, rows.SHARE, path.place, share, alive & (path.bounces.total == 0))
    return ray, mul(light.throughput, scale(value, dot(vertex.n, ray.wi) / ray.pdf)), alive


@device
def _go_on(f, tables, limits, batch, path, surface, vertex, ray, light, throughput, alive, passes, at_column):
    """Write the paths that go on from that column on, those that go straight on through a surface among them. Returns
    how many."""
    first, bounces = path.bounces.total == 0, counted(f, path.bounces, ray.kind)
    if not last_ray_finds_light(f):
        alive = alive & no(is_last(limits, bounces))
    if any_of(no(first)):
        survives, chance = roulette(tables, path.numbers, throughput)
        alive, throughput = alive & (first | survives), select(first, throughput, scale(throughput, ONE / chance))
    scattered = throughput, ray.p, ray.n, ray.wi, ray.pdf, vertex.start, bounces.total, bounces.diffuse, ray.kind
    store(batch.paths, rows.T_NEAR, at_column, ZERO)
    if not is_mixed(f):
        store(batch.paths, rows.T_FAR, at_column, FAR)
        return _store_paths(f, batch, path, scattered, alive, at_column)
    straight, left, begins = _straight_on(batch, path, surface, light)
    alive = select(passes, path.passed < np.uint32(MAX_TRANSPARENT), alive)
    store_front(batch.paths, rows.BEGINS, at_column, select(passes, begins, ZERO), alive)
    store_front(batch.paths, rows.T_FAR, at_column, select(passes, left, FAR), alive)
    return _store_paths(f, batch, path, select(passes, straight, scattered), alive, at_column)


@device
def _straight_on(batch, path, surface, light):
    """(what `_store_paths` takes of paths that go straight on through a surface, as far as their rays have left, how
    far from where they set out)."""
    ray, behind = path.ray, offset_origin(surface[5], negate(surface[2]))
    left = load(batch.paths, rows.T_FAR, path.i) - load(batch.hits, rows.T, path.i)
    bounces, begins = path.bounces, length(sub(surface[0], ray.p))
    straight = light.throughput, ray.p, ray.n, ray.wi, ray.pdf, behind, bounces.total, bounces.diffuse, ray.kind
    return straight, left, begins


@device
def _store_paths(f, batch, path, new, mask, at_column):
    """Write paths side by side from that column on. Returns how many."""
    paths, words, numbers = batch.paths, batch.path_words, path.numbers
    throughput, p, n, wi, pdf, start, bounces, diffuse, kind = new
    store_front(words, rows.KEY, at_column, numbers.key, mask)
    store_front(words, rows.ORDER, at_column, numbers.order, mask)
    store_front(words, rows.PLACE, at_column, path.place, mask)
    store_front_3(paths, rows.THROUGHPUT, at_column, throughput, mask)
    store_front_3(paths, rows.P, at_column, p, mask)
    store_front_3(paths, rows.N, at_column, n, mask)
    store_front_3(paths, rows.WI, at_column, wi, mask)
    store_front(paths, rows.PDF, at_column, pdf, mask)
    store_front_3(paths, rows.START, at_column, start, mask)
    if is_mixed(f):
        store_front(words, rows.BOUNCES, at_column, bounces, mask)
        store_front(words, rows.KIND, at_column, kind, mask)
    if f.ray_kinds:
        store_front(words, rows.DIFFUSE, at_column, diffuse, mask)
    return count(mask)


# --- rays that see as shadow rays do ----------------------------------------------------------------------------------


@device
def _queue_looks(f, batch, path, vertex, ray, throughput, alive, at_column):
    """A second ray along each new one, for what only shadow rays see: see kernels/mis.py. Returns how many."""
    looks, bounces = with_looks(batch), counted(f, path.bounces, ray.kind)
    scattered = throughput, ray.p, ray.n, ray.wi, ray.pdf, vertex.start, bounces.total, bounces.diffuse, ray.kind
    store(looks.paths, rows.T_NEAR, at_column, ZERO)
    store(looks.paths, rows.T_FAR, at_column, FAR)
    store(looks.paths, rows.BEGINS, at_column, ZERO)
    return _store_paths(f, looks, path, scattered, alive, at_column)


@device
def _look_as_shadows(f, tables, limits, looks, n, stage):
    """Add the light that the n rays of `looks` find to their samples. Returns the number of rays traced."""
    rays = NONE
    for _ in range(MAX_TRANSPARENT):
        if n == 0:
            break
        trace_all(f, tables, limits, looks, n, stage, True)
        rays += n
        n = _see(f, tables, limits, looks, n, stage)
    return rays


@device
def _see(f, tables, limits, looks, n, stage):
    """From the hits of n such rays to what they see behind them. Returns how many go on."""
    live = NONE
    for i in range(0, n, WIDTH):
        within, met = first_lanes(n - i), load(looks.hit_words, rows.MET, i) != np.uint32(0)
        path = _path_at(f, limits, looks, i, within, NONE, stage, True)
        _add_escaped(f, tables, looks, path, within & no(met))
        alive = within & met
        if not any_of(alive):
            continue
        surface = find_surface(f, tables.geometry, _hit_at(looks, i), negate(path.ray.wi))
        _add_emitted(f, tables, looks, path, surface, alive, first_lanes(NONE))
        throughput = mul(path.light.throughput, material_color(tables.geometry, surface[3], TRANSPARENCY))
        alive = alive & no(is_black(throughput))
        if f.transparency and any_of(alive):
            straight, left, begins = _straight_on(looks, path, surface, Light(BLACK, throughput, path.light.limit))
            store(looks.paths, rows.T_NEAR, live, ZERO)
            store_front(looks.paths, rows.BEGINS, live, begins, alive)
            store_front(looks.paths, rows.T_FAR, live, left, alive)
            live += _store_paths(f, looks, path, straight, alive, live)
    return live


def make_staged_kernel(features: Features):
    """The kernel that renders a tile of scenes with these features. Compiled, or read from disk, at its first call."""

    @kernel
    def render_tile(
        tables, limits, memory, tile, first_sample, sample_count, seed, origin, sums, samples, half, active, film_parts,
        counters, halt,
    ):  # fmt: skip
        """Add samples first_sample.. of the pixels of `tile` (x0, y0, x1, y1) to the film, whose pixel (0, 0) is the
        picture's pixel `origin`. memory is that of `batch.new_batch`; half and active are `engine/adaptive.py`'s, one
        pixel large where it is off, and film_parts are `parts.PartSums`, as small where no pass shows a part of the
        light. counters[REJECTED] counts samples that are not finite: they count as black. halt[0] is asked at every
        vertex; what the batch has gathered is then lost. Returns the number of rays traced."""
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
