"""The stages of a batch that trace: Embree takes all rays one after the other, or in packets.

Rays that start and go alike cost a packet a fraction of what they cost one by one; those that go anywhere, as after
the first vertex, still cost it less, except through instances. A packet is as wide as the processor allows, so that
sixteen rays are one packet, two or four.
"""

from __future__ import annotations

import numpy as np

from ..features import LISTED_LAMPS, TRACED_LAMPS
from . import rows
from .batch import add_at_3, at_3, load_3, put_at_3, rays_at
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
from .geom.vec import FAR, ONE, ZERO
from .jit import AS_WRITTEN, device
from .met import Notes, gather_listed_lamps, gather_noted_lamps, reach
from .parts import credit_lit
from .records import Light, Stretch
from .simd import (
    WIDTH,
    any_of,
    at,
    first_lanes,
    lanes,
    load,
    load_parts,
    select,
    spread,
    store,
    store_parts,
    to_index,
    uint32,
)
from .tables import INSTANCED_MESH, SHADOW_RAY

_YES, _NO, _NO_INSTANCE = np.uint32(0xFFFFFFFF), np.uint32(0), np.uint32(0xFFFFFFFF)


@device
def packets_pay(f, first):
    """Whether to trace packets of camera rays and their shadow rays, the `first`, or of others. Their hits may differ
    from those of single rays by a rounding."""
    return not AS_WRITTEN and (first or not f.instances)


@device
def trace_all(f, tables, batch, n, kind, limit, first):
    """Find the hits of the first n paths' rays, and add the light of the lamps before them to the samples, each
    contribution clamped to `limit`. first: they are the camera's."""
    geometry, paths, packets, words = tables.geometry, batch.paths, batch.packets, batch.packet_words
    for i in range(0, n, WIDTH):
        _set_packets(batch, i, n, load_3(paths, rows.START, i), load_3(paths, rows.WI, i), reach(f, kind, False))
        store_parts(packets, TNEAR, PACKET_WIDTH, load(paths, rows.T_NEAR, i))
        store_parts(packets, TFAR, PACKET_WIDTH, load(paths, rows.T_FAR, i))
        store_parts(words, GEOM_ID, PACKET_WIDTH, INVALID)
        store_parts(words, INST_ID, PACKET_WIDTH, INVALID)
        if f.lamp_shapes & TRACED_LAMPS:
            _forget_lamps(batch.ray)
        if packets_pay(f, first):
            intersect_packets(geometry.accel[0], words, batch.ray, first)
        else:
            intersect_one_by_one(geometry.accel[0], words, batch.ray)
        _keep_hits(f, geometry, batch, i, n)
        if f.lamp_shapes & TRACED_LAMPS:
            _add_noted_lamps(f, tables, batch, i, n, kind, limit)
        if f.lamp_shapes & LISTED_LAMPS:
            _add_listed_lamps(f, tables, batch, i, n, kind, limit)


@device
def _keep_hits(f, geometry, batch, i, n):
    """The packets' hits as those of paths i.. of n. Those without one get another's, if any has one, as `find_surface`
    looks up what all have met."""
    words, hits = batch.packet_words, batch.hit_words
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
    store(hits, rows.MET, i, select(met, _YES, _NO))
    store(hits, rows.TRIANGLE, i, triangle)
    store(hits, rows.INSTANCE, i, instance)
    store(hits, rows.U, i, load_parts(words, HIT_U, PACKET_WIDTH))
    store(hits, rows.V, i, load_parts(words, HIT_V, PACKET_WIDTH))


@device
def _forget_lamps(ray):
    """Empty the notes of all rays of a packet."""
    for lane in range(WIDTH):
        ray.words[LAMP_COUNT + lane * note_words(ray)] = np.uint32(0)


@device
def _add_listed_lamps(f, tables, batch, i, n, kind, limit):
    """Add the light of the listed lamps that paths i.. of n have passed to their samples."""
    paths, within = batch.paths, first_lanes(n - i)
    t_hit = select(within, load_parts(batch.packets, TFAR, PACKET_WIDTH), -ONE)
    stretch = Stretch(load_3(paths, rows.START, i), load(paths, rows.T_NEAR, i), FAR, ZERO)
    place, light = _light_of(batch, i, within, limit)
    light = gather_listed_lamps(f, tables, rays_at(paths, i, kind), stretch, t_hit, light)
    put_at_3(batch.samples, rows.LIGHT, place, light.radiance, within)


@device
def _light_of(batch, i, within, limit):
    """(places of the samples of paths i.., their `Light`)."""
    place = to_index(select(within, load(batch.path_words, rows.PLACE, i), np.uint32(0)))
    return place, Light(at_3(batch.samples, rows.LIGHT, place), load_3(batch.paths, rows.THROUGHPUT, i), limit)


@device
def _add_noted_lamps(f, tables, batch, i, n, kind, limit):
    """Add the light of the lamps that Embree has noted on the way of paths i.. of n to their samples."""
    paths, notes_of, within = batch.paths, batch.ray, first_lanes(n - i)
    counts = lanes() * np.uint32(note_words(notes_of)) + np.uint32(LAMP_COUNT)
    count = select(within, at(notes_of.words, counts), np.uint32(0))
    if not any_of(count > np.uint32(0)):
        return
    t_near, t_hit = load(paths, rows.T_NEAR, i), load_parts(batch.packets, TFAR, PACKET_WIDTH)
    notes = Notes(notes_of.words, notes_of.floats, counts + np.uint32(1), count, t_near, t_hit)
    place, light = _light_of(batch, i, within, limit)
    light = gather_noted_lamps(f, tables, notes, rays_at(paths, i, kind), load_3(paths, rows.START, i), light)
    put_at_3(batch.samples, rows.LIGHT, place, light.radiance, within)


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
def occluded_all(f, tables, batch, n, first):
    """Trace n shadow rays, of the `first` vertices or others, and add the light of those that nothing blocks to their
    samples."""
    scene, shadows, packets, words = tables.geometry.accel[0], batch.shadows, batch.packets, batch.packet_words
    for i in range(0, n, WIDTH):
        _set_packets(batch, i, n, load_3(shadows, rows.FROM, i), load_3(shadows, rows.DIRECTION, i), SHADOW_RAY)
        store_parts(packets, TNEAR, PACKET_WIDTH, ZERO)
        store_parts(packets, TFAR, PACKET_WIDTH, load(shadows, rows.END, i))
        if packets_pay(f, first):
            occluded_packets(scene, words, batch.ray, first)
        else:
            occluded_one_by_one(scene, words, batch.ray)
        arrives = (load_parts(packets, TFAR, PACKET_WIDTH) >= ZERO) & first_lanes(n - i)
        place = to_index(load(batch.shadow_words, rows.TO, i))
        add_at_3(batch.samples, rows.LIGHT, place, load_3(shadows, rows.BRINGS, i), arrives)
        if f.light_passes:
            credit_lit(batch, place, arrives, first)
