"""The stages of a batch that trace: Embree takes all rays one after the other, or sixteen at a time.

Sixteen rays that start and go alike cost a fraction of sixteen single ones; of those that go anywhere, as after the
first vertex, a packet still costs less, except through instances.
"""

from __future__ import annotations

import numpy as np

from .batch import (
    BRINGS,
    DIRECTION,
    END,
    FROM,
    INSTANCE,
    LIGHT,
    MET,
    START,
    T_FAR,
    T_NEAR,
    TO,
    TRIANGLE,
    WI,
    U,
    V,
    add_at_3,
    at_3,
    load_3,
    store_3,
)
from .embree import (
    GEOM_ID,
    INST_ID,
    INST_PRIM_ID,
    INVALID,
    PRIM_ID,
    TFAR,
    TNEAR,
    VALID_ROW,
    intersect,
    intersect_packet,
    occluded,
    occluded_packet,
)
from .embree import U as U_WORD
from .embree import V as V_WORD
from .geom.surface import hit_of
from .geom.vec import ZERO
from .jit import AS_WRITTEN, device
from .simd import WIDTH, any_of, at, first_lanes, load, select, store, to_index, uint32
from .tables import INSTANCED_MESH, SHADOW_RAY

_DIRECTION_WORD, _TIME, _MASK, _ID, _FLAGS = 4, 7, 9, 10, 11
_YES, _NO, _NOWHERE = np.uint32(0xFFFFFFFF), np.uint32(0), np.uint32(0xFFFFFFFF)


@device
def packets_pay(f, coherent):
    """Whether to trace packets. Their hits may differ from those of single rays by a rounding."""
    return not AS_WRITTEN and (coherent or not f.instances)


@device
def trace_all(f, tables, batch, n, mask, coherent):
    """Find the hits of the first n paths' rays."""
    if packets_pay(f, coherent):
        for i in range(0, n, WIDTH):
            _trace_packet(f, tables.geometry, batch, i, n, mask, coherent)
    else:
        for i in range(n):
            _trace_one(f, tables.geometry, batch, i, mask)


@device
def _trace_packet(f, geometry, batch, i, n, mask, coherent):
    packet, words = batch.packet, batch.packet_words
    _set_packet(batch, i, n, load_3(batch.paths, START, i), load_3(batch.paths, WI, i), mask)
    store(packet, TNEAR, 0, load(batch.paths, T_NEAR, i))
    store(packet, TFAR, 0, load(batch.paths, T_FAR, i))
    store(words, GEOM_ID, 0, INVALID)
    store(words, INST_ID, 0, INVALID)
    intersect_packet(geometry.accel[0], packet, words, coherent)
    outer, instance = load(words, GEOM_ID, 0), _NOWHERE
    met = (outer != INVALID) & first_lanes(n - i)
    triangle = uint32(outer ^ outer)
    if any_of(met):
        if f.instances:
            inner = load(words, INST_ID, 0)
            outer = select(inner != INVALID, inner, outer)
        outer = to_index(select(met, outer, np.uint32(0)))
        triangle = select(met, uint32(at(geometry.base, outer)) + load(words, PRIM_ID, 0), np.uint32(0))
        if f.instances:
            row = uint32(at(geometry.instance_base, outer)) + load(words, INST_PRIM_ID, 0)
            placed = met & (at(geometry.kind, outer) == np.int32(INSTANCED_MESH))
            instance = select(placed, row, _NOWHERE)
    store(batch.hit_words, MET, i, select(met, _YES, _NO))
    store(batch.hit_words, TRIANGLE, i, triangle)
    store(batch.hit_words, INSTANCE, i, instance)
    store(batch.hits, U, i, load(packet, U_WORD, 0))
    store(batch.hits, V, i, load(packet, V_WORD, 0))


@device
def _set_packet(batch, i, n, start, direction, mask):
    """The rows of the packet with rays i.. of n, but for TNEAR and TFAR."""
    packet, words = batch.packet, batch.packet_words
    store(words, VALID_ROW, 0, select(first_lanes(n - i), _YES, _NO))
    store_3(packet, 0, 0, start)
    store_3(packet, _DIRECTION_WORD, 0, direction)
    store(packet, _TIME, 0, ZERO)
    store(words, _MASK, 0, mask)
    store(words, _ID, 0, np.uint32(0))
    store(words, _FLAGS, 0, np.uint32(0))


@device
def _trace_one(f, geometry, batch, i, mask):
    paths, hits, words, ray = batch.paths, batch.hits, batch.hit_words, batch.ray
    start, wi = at_3(paths, START, i), at_3(paths, WI, i)
    met = intersect(geometry.accel[0], ray.floats, ray.words, start, wi, paths[T_NEAR, i], paths[T_FAR, i], mask)
    words[MET, i], words[TRIANGLE, i], words[INSTANCE, i] = _NO, np.uint32(0), _NOWHERE
    if met:
        hit = hit_of(f, geometry, ray.floats, ray.words)
        words[MET, i], words[TRIANGLE, i], words[INSTANCE, i] = _YES, np.uint32(hit.triangle), np.uint32(hit.instance)
        hits[U, i], hits[V, i] = hit.u, hit.v


@device
def occluded_all(f, tables, batch, n, coherent):
    """Trace n shadow rays, and add the light of those that nothing blocks to their samples."""
    scene = tables.geometry.accel[0]
    if packets_pay(f, coherent):
        for i in range(0, n, WIDTH):
            _set_packet(batch, i, n, load_3(batch.shadows, FROM, i), load_3(batch.shadows, DIRECTION, i), SHADOW_RAY)
            store(batch.packet, TNEAR, 0, ZERO)
            store(batch.packet, TFAR, 0, load(batch.shadows, END, i))
            occluded_packet(scene, batch.packet, batch.packet_words, coherent)
            arrives = (load(batch.packet, TFAR, 0) >= ZERO) & first_lanes(n - i)
            place = to_index(load(batch.shadow_words, TO, i))
            add_at_3(batch.samples, LIGHT, place, load_3(batch.shadows, BRINGS, i), arrives)
    else:
        for i in range(n):
            _shadow_one(scene, batch, i)


@device
def _shadow_one(scene, batch, i):
    s, ray = batch.shadows, batch.ray
    start, direction = at_3(s, FROM, i), at_3(s, DIRECTION, i)
    if not occluded(scene, ray.floats, ray.words, start, direction, ZERO, s[END, i], SHADOW_RAY):
        place = np.int64(batch.shadow_words[TO, i])
        for k in range(3):
            batch.samples[LIGHT + k, place] += s[BRINGS + k, i]
