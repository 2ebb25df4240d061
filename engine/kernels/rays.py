"""The stages of a batch that trace: Embree takes all rays one after the other, or in packets.

Rays that start and go alike cost a packet a fraction of what they cost one by one; those that go anywhere, as after
the first vertex, still cost it less, except through instances. A packet is as wide as the processor allows, so that
sixteen rays are one packet, two or four.
"""

from __future__ import annotations

import numpy as np

from ..features import LISTED_LAMPS, TRACED_LAMPS
from . import rows
from .batch import (
    add_at_3,
    at_3,
    bounces_at,
    is_mixed,
    load_3,
    put_at_3,
    rays_at,
    store_front_3,
    stretches_at,
)
from .direct import shadow_end
from .embree import (
    AIM,
    FLAGS,
    GEOM_ID,
    ID,
    INST_ID,
    INST_PRIM_ID,
    INVALID,
    LAMP_COUNT,
    MASK,
    ORIGIN,
    PACKET_WIDTH,
    PRIM_ID,
    TFAR,
    TIME,
    TNEAR,
    VALID,
    intersect_one_by_one,
    intersect_packets,
    note_words,
    occluded_one_by_one,
    occluded_packets,
)
from .embree import U as HIT_U
from .embree import V as HIT_V
from .geom.surface import Hit, find_surface, offset_origin
from .geom.vec import FAR, ONE, ZERO, add, is_black, length, mul, negate, sub
from .jit import AS_WRITTEN, device
from .met import Notes, gather_listed_lamps, gather_noted_lamps, reach
from .parts import credit_lit
from .records import MAX_TRANSPARENT, Light, clamped, material_color
from .simd import (
    WIDTH,
    any_of,
    at,
    count,
    first_lanes,
    int32,
    lanes,
    load,
    load_parts,
    no,
    select,
    spread,
    store,
    store_front,
    store_parts,
    to_index,
    uint32,
)
from .tables import INSTANCED_MESH, SHADOW_RAY, TRANSPARENCY
from .vertex import clamp_limit

_YES, _NO, _NO_INSTANCE = np.uint32(0xFFFFFFFF), np.uint32(0), np.uint32(0xFFFFFFFF)


@device
def packets_pay(f, first):
    """Whether to trace packets of camera rays and their shadow rays, the `first`, or of others. Their hits may differ
    from those of single rays by a rounding."""
    return not AS_WRITTEN and (first or not f.instances)


@device
def trace_all(f, tables, limits, batch, n, stage, as_shadow):
    """Find the hits of the first n paths' rays, and add the light of the lamps before them to the samples."""
    geometry, first = tables.geometry, stage == 0
    for i in range(0, n, WIDTH):
        ray, stretch = rays_at(f, batch, i, stage, as_shadow), stretches_at(f, batch, i)
        _set_packets(batch, i, n, stretch.start, ray.wi, reach(f, ray.kind, as_shadow))
        if f.lamp_shapes & TRACED_LAMPS:
            _forget_lamps(batch.ray)
        _search(f, geometry, batch, stretch.t_near, stretch.t_far, first)
        _keep_hits(f, geometry, batch, i, n)
        if f.lamp_shapes & TRACED_LAMPS:
            _add_noted_lamps(f, tables, limits, batch, i, n, ray, stretch, stage)
        if f.lamp_shapes & LISTED_LAMPS:
            _add_listed_lamps(f, tables, limits, batch, i, n, ray, stretch, stage)


@device
def _search(f, geometry, batch, t_near, t_far, first):
    """Find what the packets' rays meet first."""
    packets, words, scene = batch.packets, batch.packet_words, geometry.accel[0]
    store_parts(packets, TNEAR, PACKET_WIDTH, t_near)
    store_parts(packets, TFAR, PACKET_WIDTH, t_far)
    store_parts(words, GEOM_ID, PACKET_WIDTH, INVALID)
    store_parts(words, INST_ID, PACKET_WIDTH, INVALID)
    if packets_pay(f, first):
        intersect_packets(scene, words, batch.ray, first)
    else:
        intersect_one_by_one(scene, words, batch.ray)


@device
def _keep_hits(f, geometry, batch, i, n):
    """The packets' hits as those of paths i.. of n."""
    hits = batch.hits
    met, hit = _hits(f, geometry, batch, i, n)
    store(batch.hit_words, rows.MET, i, select(met, _YES, _NO))
    store(batch.hit_words, rows.TRIANGLE, i, uint32(hit.triangle))
    store(batch.hit_words, rows.INSTANCE, i, uint32(hit.instance))
    store(hits, rows.U, i, hit.u)
    store(hits, rows.V, i, hit.v)
    if is_mixed(f):
        store(hits, rows.T, i, load_parts(batch.packets, TFAR, PACKET_WIDTH))


@device
def _hits(f, geometry, batch, i, n):
    """(which of the packets' rays i.. of n have met something, the `Hit`). Those that have not get another's, if any
    has one, as `find_surface` looks up what all have met."""
    words = batch.packet_words
    outer, triangle, instance = load_parts(words, GEOM_ID, PACKET_WIDTH), np.uint32(0), _NO_INSTANCE
    met = (outer != INVALID) & first_lanes(n - i)
    if any_of(met):
        if f.instances:
            inner = load_parts(words, INST_ID, PACKET_WIDTH)
            outer = select(inner != INVALID, inner, outer)
        outer = to_index(select(met, outer, np.uint32(0)))
        triangle = spread(uint32(at(geometry.base, outer)) + load_parts(words, PRIM_ID, PACKET_WIDTH), met)
        if f.instances:
            row = uint32(at(geometry.instance_base, outer)) + load_parts(words, INST_PRIM_ID, PACKET_WIDTH)
            placed = met & (at(geometry.kind, outer) == np.int32(INSTANCED_MESH))
            instance = spread(select(placed, row, _NO_INSTANCE), met)
    u, v = load_parts(batch.packets, HIT_U, PACKET_WIDTH), load_parts(batch.packets, HIT_V, PACKET_WIDTH)
    return met, Hit(to_index(triangle), int32(instance), u, v)


@device
def _forget_lamps(ray):
    """Empty the notes of all rays of a packet."""
    for lane in range(WIDTH):
        ray.words[LAMP_COUNT + lane * note_words(ray)] = np.uint32(0)


@device
def _add_listed_lamps(f, tables, limits, batch, i, n, ray, stretch, stage):
    """Add the light of the listed lamps that paths i.. of n have passed to their samples."""
    t_hit = select(first_lanes(n - i), load_parts(batch.packets, TFAR, PACKET_WIDTH), -ONE)
    place, light = _light_of(f, limits, batch, i, n, stage)
    light = gather_listed_lamps(f, tables, ray, stretch, t_hit, light)
    put_at_3(batch.samples, rows.LIGHT, place, light.radiance, first_lanes(n - i))


@device
def _add_noted_lamps(f, tables, limits, batch, i, n, ray, stretch, stage):
    """Add the light of the lamps that Embree has noted on the way of paths i.. of n to their samples."""
    notes_of = batch.ray
    counts = lanes() * np.uint32(note_words(notes_of)) + np.uint32(LAMP_COUNT)
    count = select(first_lanes(n - i), at(notes_of.words, counts), np.uint32(0))
    if not any_of(count > np.uint32(0)):
        return
    t_hit = load_parts(batch.packets, TFAR, PACKET_WIDTH)
    notes = Notes(notes_of.words, notes_of.floats, counts + np.uint32(1), count, stretch.t_near, t_hit)
    place, light = _light_of(f, limits, batch, i, n, stage)
    light = gather_noted_lamps(f, tables, notes, ray, stretch.start, light)
    put_at_3(batch.samples, rows.LIGHT, place, light.radiance, first_lanes(n - i))


@device
def _light_of(f, limits, batch, i, n, stage):
    """(places of the samples of paths i.. of n, their `Light`)."""
    place = to_index(select(first_lanes(n - i), load(batch.path_words, rows.PLACE, i), np.uint32(0)))
    limit = clamp_limit(limits, bounces_at(f, batch, i, stage).total)
    return place, Light(at_3(batch.samples, rows.LIGHT, place), load_3(batch.paths, rows.THROUGHPUT, i), limit)


@device
def _set_packets(batch, i, n, start, direction, mask):
    """The rows of the packets with rays i.. of n, but for TNEAR and TFAR."""
    packets, words = batch.packets, batch.packet_words
    store_parts(words, VALID, PACKET_WIDTH, select(first_lanes(n - i), _YES, _NO))
    for k in range(3):
        store_parts(packets, ORIGIN + k, PACKET_WIDTH, start[k])
        store_parts(packets, AIM + k, PACKET_WIDTH, direction[k])
    store_parts(packets, TIME, PACKET_WIDTH, ZERO)
    store_parts(words, MASK, PACKET_WIDTH, mask)
    store_parts(words, ID, PACKET_WIDTH, lanes())
    store_parts(words, FLAGS, PACKET_WIDTH, np.uint32(0))


@device
def light_all(f, tables, limits, batch, n, stage):
    """Trace n shadow rays of a stage, and add the light of those that get through to their samples. Returns the number
    of rays traced."""
    if not f.transparency:
        _light_unblocked(f, tables, limits, batch, n, stage)
        return n
    rays = np.int64(0)
    for _ in range(MAX_TRANSPARENT):
        if n == 0:
            break
        rays += n
        n = _light_or_dim(f, tables, limits, batch, n, stage)
    return rays


@device
def _light_unblocked(f, tables, limits, batch, n, stage):
    """All surfaces block light: which of them does says nothing."""
    scene, packets, words, first = tables.geometry.accel[0], batch.packets, batch.packet_words, stage == 0
    for i in range(0, n, WIDTH):
        _set_shadow_packets(batch, i, n)
        store_parts(packets, TNEAR, PACKET_WIDTH, ZERO)
        store_parts(packets, TFAR, PACKET_WIDTH, load(batch.shadows, rows.END, i))
        if packets_pay(f, first):
            occluded_packets(scene, words, batch.ray, first)
        else:
            occluded_one_by_one(scene, words, batch.ray)
        _add_arriving(f, limits, batch, i, (load_parts(packets, TFAR, PACKET_WIDTH) >= ZERO) & first_lanes(n - i))


@device
def _light_or_dim(f, tables, limits, batch, n, stage):
    """Shadow rays that meet nothing bring their light. Those that meet something that lets light through are dimmed by
    it, and packed together in `batch` as they go on behind it. Returns how many."""
    geometry, shadows, live = tables.geometry, batch.shadows, np.int64(0)
    for i in range(0, n, WIDTH):
        start, direction = _set_shadow_packets(batch, i, n)
        t_far = load(shadows, rows.END, i)
        _search(f, geometry, batch, ZERO, t_far, stage == 0)
        met, hit = _hits(f, geometry, batch, i, n)
        _add_arriving(f, limits, batch, i, first_lanes(n - i) & no(met))
        if not any_of(met):
            continue
        _, _, ng, material, _, inside = find_surface(f, geometry, hit, negate(direction))
        brings = mul(load_3(shadows, rows.BRINGS, i), material_color(geometry, material, TRANSPARENCY))
        goes_on, behind = met & no(is_black(brings)), offset_origin(inside, negate(ng))
        near = t_far < FAR
        aimed = select(near, sub(add(start, direction), behind), direction)
        # On a short rest of the way the same part of it would be too short a gap before the light.
        end = select(near, shadow_end(behind, length(aimed)), FAR)
        words = batch.shadow_words
        store_front(words, rows.TO, live, load(words, rows.TO, i), goes_on)
        if f.light_passes or f.clamp:
            store_front(words, rows.FIRST, live, load(words, rows.FIRST, i), goes_on)
        store_front_3(shadows, rows.FROM, live, behind, goes_on)
        store_front_3(shadows, rows.DIRECTION, live, aimed, goes_on)
        store_front(shadows, rows.END, live, end, goes_on)
        store_front_3(shadows, rows.BRINGS, live, brings, goes_on)
        live += count(goes_on)
    return live


@device
def _set_shadow_packets(batch, i, n):
    """The rows of the packets with shadow rays i.. of n, but for TNEAR and TFAR. Returns (start, direction)."""
    start, direction = load_3(batch.shadows, rows.FROM, i), load_3(batch.shadows, rows.DIRECTION, i)
    _set_packets(batch, i, n, start, direction, SHADOW_RAY)
    return start, direction


@device
def _add_arriving(f, limits, batch, i, arrives):
    """Add the light that shadow rays i.. bring to their samples."""
    place = to_index(select(arrives, load(batch.shadow_words, rows.TO, i), np.uint32(0)))
    brings, first = load_3(batch.shadows, rows.BRINGS, i), load(batch.shadow_words, rows.FIRST, i) != np.uint32(0)
    limit = select(first, limits.clamp_direct, limits.clamp_indirect)
    add_at_3(batch.samples, rows.LIGHT, place, clamped(f, brings, limit), arrives)
    if f.light_passes:
        credit_lit(batch.parts, first, place, at_3(batch.samples, rows.LIGHT, place), arrives)
