"""What light a ray finds: of the lamps that it passes, of the surface that it meets, or of what lies behind."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..features import DARK_WORLD, DISK, IMAGE_WORLD, TRACED_LAMPS
from .embree import (
    INVALID,
    NOTED_GEOM,
    NOTED_LEAVES,
    NOTED_PRIM,
    NOTED_T,
    NOTED_WORDS,
)
from .geom.vec import BLACK, ZERO, add_scaled, is_black, length, scale, sub
from .jit import device
from .light.emitters import (
    emission,
    found_by_rays,
    lamp_distance,
    lamp_seen,
    local_probability,
    sun_seen_pdf,
    surface_seen_pdf,
    world_seen,
)
from .light.groups import Shares, group_shares
from .light.point import disk_distance, inside_lamp
from .mis import met_light_weight
from .records import Light, gather
from .simd import any_of, at, int32, no, put_at, select, to_index, uint32
from .tables import CAMERA_RAY, LAMP_MASK, LAMP_QUADS, LAMP_SHIFT, SHADOW_RAY


@device
def emitted(f, tables, ray, p, material, triangle):
    """(radiance, MIS weight included, of the surface that a ray met at p, the emitter there or -1)."""
    nobody = np.int32(-1)
    if not f.mesh_emitters:
        return BLACK, nobody
    radiance, lights = emission(tables.geometry, material), tables.lights
    shines = no(is_black(radiance))
    if not any_of(shines):
        return BLACK, nobody
    own = select(shines, at(lights.triangle_emitter, triangle), nobody)
    pdf, sampled = ZERO, (own >= np.int32(0)) & (ray.pdf > ZERO)
    if any_of(sampled):
        first = np.int32(len(lights.lamp_kind))  # of those that there are, for lanes that have met none
        emitter = to_index(select(sampled, own, first))
        pdf = surface_seen_pdf(f, tables.geometry, lights, emitter, ray.p, ray.wi, length(sub(p, ray.p)))
        pdf = select(sampled, pdf * local_probability(f, lights, tables.tree, emitter, ray.p, ray.n), ZERO)
    weight = met_light_weight(f, ray, pdf)
    if ray.as_shadow:
        weight = select(_lights_kind(lights, own, ray.kind), weight, ZERO)
    return select(shines, scale(radiance, weight), BLACK), own


@device
def sees_shadows_light(f):
    """Whether a ray that sees as shadow rays do is needed, and has anything to find."""
    return not f.shared_light and (f.mesh_emitters or f.lamp_shapes or f.sun_disks or f.world == IMAGE_WORLD)


@device
def reach(f, kind, as_shadow):
    """Embree's mask of what a ray meets. Lamps are left out where light sampling, or the ray that sees as shadow
    rays do, finds all of their light."""
    mask = SHADOW_RAY if as_shadow else kind
    if f.lamp_shapes & TRACED_LAMPS:
        mask = select(_meets_lamps(f, kind, as_shadow), uint32(mask | kind << np.uint32(LAMP_SHIFT)), uint32(mask))
    return mask


@device
def _meets_lamps(f, kind, as_shadow):
    return (kind == CAMERA_RAY) | as_shadow | (f.shared_light != 0)


@device
def escaped(f, tables, ray, light):
    """`light` with that of suns and of the world for a ray that left the scene. A transparent film shows no world."""
    suns, world = ZERO, ZERO
    if (f.world == IMAGE_WORLD or f.sun_disks) and any_of(ray.pdf > ZERO):
        _, suns, world = group_shares(f, tables.lights, tables.tree, ray.p, ray.n)
    shares = Shares(ZERO, suns, world)
    hidden = (ray.kind == CAMERA_RAY) & (f.transparent_film != 0)
    if f.world != DARK_WORLD and any_of(no(hidden)):
        seen, pdf = world_seen(f, tables.lights, shares, tables.environment, ray.wi, ray.kind)
        light = gather(f, light, select(hidden, BLACK, scale(seen, met_light_weight(f, ray, pdf))))
    if f.sun_disks:
        for i in range(len(tables.lights.suns)):
            seen, pdf = sun_seen_pdf(f, tables.lights, shares, i, ray.n, ray.wi, ray.kind)
            light = gather(f, light, scale(seen, met_light_weight(f, ray, pdf)))
    return light


@device
def shows_world_alone(f):
    """Whether a camera ray that meets no surface can have found the world's light only."""
    return not f.lamp_shapes and not f.sun_disks


@device
def world_behind(f, tables, wi):
    """The world's part of what a camera ray along wi finds that meets no surface."""
    if f.world == DARK_WORLD or f.transparent_film:
        return BLACK
    return world_seen(f, tables.lights, Shares(ZERO, ZERO, ZERO), tables.environment, wi, CAMERA_RAY)[0]


@device
def _lights_kind(lights, own, kind):
    """Whether rays of this kind see the emissive surface: light of what they don't see counts for no shadow ray."""
    i = to_index(max(int32(own - np.int32(len(lights.lamp_kind))), np.int32(0)))
    return (own >= np.int32(0)) & (uint32(at(lights.emitter_mask, i)) & kind != np.uint32(0))


class Notes(NamedTuple):
    """The lamps that Embree has noted on a ray's way from `t_near` to its hit at `t_hit`.

    words, floats  where they are, as uint32 and as float32; `first` is the place of the first, and their `count`
    """

    words: np.ndarray
    floats: np.ndarray
    first: np.int64
    count: np.uint32
    t_near: np.float32
    t_hit: np.float32


@device
def gather_listed_lamps(f, tables, ray, stretch, t_hit, light):
    """`light` with that of the listed lamps that the ray meets on its stretch, up to its hit so far from the start."""
    lights, meets = tables.lights, _meets_lamps(f, ray.kind, ray.as_shadow)
    # A start is a little off its surface. A lamp may begin before the first one, and counts there.
    behind = length(sub(stretch.start, ray.p))
    for k in range(len(lights.listed_lamps)):
        i = lights.listed_lamps[k]
        seen = meets & (ray.kind & np.uint32(lights.lamps[i, LAMP_MASK]) != np.uint32(0))
        if any_of(seen):
            distance = lamp_distance(f, lights, i, ray.p, ray.wi)
            counts = (distance > ZERO) & (distance - stretch.begins > stretch.t_near) & (distance - behind <= t_hit)
            counts = counts & seen
            if any_of(counts):
                lamp = to_index(select(counts, int32(i), np.int32(0)))
                found = gather(f, light, _met_lamp(f, tables, ray, lamp, distance))
                light = Light(select(counts, found.radiance, light.radiance), light.throughput, light.limit)
    return light


@device
def gather_noted_lamps(f, tables, notes, ray, start, light):
    """`light` with that of the lamps that were noted on the ray's way from `start` to its hit."""
    i = np.int64(0)
    while any_of(i < notes.count):
        noted = i < notes.count
        place = notes.first + i * NOTED_WORDS
        lamp, is_quad = _noted_lamp(tables, notes, place, noted)
        counts = noted & _counts(f, tables, notes, place, lamp, is_quad, ray, start)
        put_at(notes.words, place + NOTED_PRIM, select(counts, uint32(lamp), INVALID), noted)
        counts = counts & no(_noted_before(notes, i))
        if any_of(counts):
            met_at = add_scaled(start, ray.wi, at(notes.floats, place + NOTED_T))
            found = gather(f, light, _met_lamp(f, tables, ray, lamp, length(sub(ray.p, met_at))))
            light = Light(select(counts, found.radiance, light.radiance), light.throughput, light.limit)
        i += 1
    return light


@device
def _noted_lamp(tables, notes, place, noted):
    """(the lamp whose shape was met, whether that is a quad). Where nothing is noted: any lamp."""
    geometry, lights = tables.geometry, tables.lights
    shape = to_index(select(noted, at(notes.words, place + NOTED_GEOM), np.uint32(0)))
    prim = int32(at(notes.words, place + NOTED_PRIM))
    base, lamp = at(geometry.base, shape), np.int32(0)
    is_quad = at(geometry.kind, shape) == np.int32(LAMP_QUADS)
    quad = noted & is_quad
    if any_of(quad):
        lamp = at(lights.lamp_of_quad, to_index(select(quad, int32(base + (prim >> np.int32(1))), np.int32(0))))
    sphere = noted & no(is_quad)
    if any_of(sphere):
        met = at(lights.lamp_of_sphere, to_index(select(sphere, int32(base + prim), np.int32(0))))
        lamp = select(sphere, met, lamp)
    return to_index(lamp), is_quad


@device
def _counts(f, tables, notes, place, lamp, is_quad, ray, start):
    """Whether the ray meets the lamp there, on its way from `start` to its hit."""
    lights, t = tables.lights, at(notes.floats, place + NOTED_T)
    # Rays meet a sphere twice: the first time counts, or for those from within the second.
    leaves = at(notes.words, place + NOTED_LEAVES) != np.uint32(0)
    counts = is_quad | (leaves == inside_lamp(lights.lamps, lamp, ray.p))
    if f.lamp_kinds & DISK:
        # Embree has no disk that turns towards a point, so the sphere around it was met, on either side of the disk.
        is_disk = at(lights.lamp_kind, lamp) & np.int32(DISK) != np.int32(0)
        t_disk = disk_distance(lights.lamps, lamp, ray.p, ray.wi) - length(sub(start, ray.p))
        t, counts = select(is_disk, t_disk, t), select(is_disk, notes.t_near < t_disk, counts)
    return counts & (t <= notes.t_hit)


@device
def _noted_before(notes, i):
    """A lamp may be met twice: both triangles of a quad at its diagonal, both ends of the sphere around a disk. The
    lamps that count, which have taken the primitives' places, are compared."""
    own, before = at(notes.words, notes.first + i * NOTED_WORDS + NOTED_PRIM), i < np.uint32(0)
    for other in range(i):
        before = before | (at(notes.words, notes.first + other * NOTED_WORDS + NOTED_PRIM) == own)
    return before


@device
def _met_lamp(f, tables, ray, lamp, distance):
    """Radiance, MIS weight included, of the lamp that a ray meets so far from where it set out."""
    lights, p = tables.lights, ray.p
    radiance, pdf = lamp_seen(f, lights, lamp, p, ray.n, ray.wi, distance)
    scattered = ray.pdf > ZERO
    if any_of(scattered):
        radiance = select(scattered & no(found_by_rays(f, lights, lamp, p)), BLACK, radiance)
        pdf = select(scattered, pdf * local_probability(f, lights, tables.tree, lamp, p, ray.n), pdf)
    return select(is_black(radiance), BLACK, scale(radiance, met_light_weight(f, ray, pdf)))
