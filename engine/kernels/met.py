"""What light a ray finds: of the lamps that it passes, of the surface that it meets, or of what lies behind."""

from __future__ import annotations

import numpy as np

from ..features import DARK_WORLD, DISK, IMAGE_WORLD
from .embree import (
    INVALID,
    LAMP_COUNT,
    NOTED_GEOM,
    NOTED_LAMPS,
    NOTED_LEAVES,
    NOTED_PRIM,
    NOTED_T,
    NOTED_WORDS,
    TFAR,
    TNEAR,
    intersect,
    intersect_noting_lamps,
)
from .geom.surface import find_surface, hit_of, offset_origin
from .geom.vec import BLACK, FAR, ZERO, add_scaled, is_black, length, negate, scale, sub
from .jit import device
from .light.emitters import (
    emission,
    found_by_rays,
    lamp_seen,
    local_probability,
    sun_seen_pdf,
    surface_seen_pdf,
    world_seen,
)
from .light.groups import Shares, group_shares
from .light.point import disk_distance, inside_lamp
from .mis import met_light_weight
from .records import MAX_TRANSPARENT, Light, Ray, Stretch, dimmed, gather, material_color
from .simd import any_of, at, int32, no, select, to_index, uint32
from .tables import CAMERA_RAY, LAMP_QUADS, LAMP_SHIFT, SHADOW_RAY, TRANSPARENCY


@device
def follow(f, tables, memory, ray, stretch, light):
    """Follow a ray to the next surface, and gather the light that it finds: of the lamps before the surface, and of
    suns and the world if there is none.

    Returns (whether a surface was met, which is then in `memory`, `light`)."""
    scene, floats, words, mask = tables.geometry.accel[0], memory.floats, memory.words, _reach(f, ray)
    if f.lamp_shapes:
        met = intersect_noting_lamps(scene, floats, words, stretch.start, ray.wi, stretch.t_near, stretch.t_far, mask)
        light = _gather_lamps(f, tables, memory, ray, stretch.start, light)
    else:
        met = intersect(scene, floats, words, stretch.start, ray.wi, stretch.t_near, stretch.t_far, mask)
    if not met:
        light = escaped(f, tables, ray, light)
    return met, light


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
        emitter = select(sampled, own, np.int32(len(lights.lamp_kind)))  # others take the first that there is
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
def follow_as_shadow(f, tables, memory, ray, start, light):
    """The part of BSDF sampling in the direct light where rays do not see what shadow rays see: along the direction
    of the path's next ray, what a shadow ray sees. Returns (`light`, rays traced)."""
    geometry, throughput = tables.geometry, light.throughput
    ray = Ray(ray.p, ray.n, ray.wi, ray.kind, ray.pdf, True)
    stretch, rays = Stretch(start, ZERO, FAR), 0
    for _ in range(MAX_TRANSPARENT):
        met, light = follow(f, tables, memory, ray, stretch, light)
        rays += 1
        if not met:
            break
        hit = hit_of(f, geometry, memory.floats, memory.words)
        p, _, ng, material, triangle = find_surface(f, geometry, hit, negate(ray.wi))
        found, _ = emitted(f, tables, ray, p, material, triangle)
        light = gather(f, light, found)
        if not f.transparency:
            break
        light = dimmed(light, material_color(geometry, material, TRANSPARENCY))
        if is_black(light.throughput):
            break
        stretch = Stretch(offset_origin(p, negate(ng)), ZERO, FAR)
    return Light(light.radiance, throughput, light.limit), rays


@device
def _reach(f, ray):
    """Embree's mask of what the ray meets. Lamps are left out where light sampling, or the ray that sees as shadow
    rays do, finds all of their light."""
    mask = SHADOW_RAY if ray.as_shadow else ray.kind
    if f.lamp_shapes and (f.shared_light or ray.as_shadow or ray.kind == CAMERA_RAY):
        mask = np.uint32(mask | ray.kind << np.uint32(LAMP_SHIFT))
    return mask


@device
def escaped(f, tables, ray, light):
    """`light` with that of suns and of the world for a ray that left the scene. A transparent film shows no world."""
    suns, world = ZERO, ZERO
    if (f.world == IMAGE_WORLD or f.sun_disks) and any_of(ray.pdf > ZERO):
        _, suns, world = group_shares(f, tables.lights, tables.tree, ray.p, ray.n)
    shares = Shares(ZERO, suns, world)
    if f.world != DARK_WORLD and not (f.transparent_film and ray.kind == CAMERA_RAY):
        seen, pdf = world_seen(f, tables.lights, shares, tables.environment, ray.wi, ray.kind)
        light = gather(f, light, scale(seen, met_light_weight(f, ray, pdf)))
    if f.sun_disks:
        for i in range(len(tables.lights.suns)):
            seen, pdf = sun_seen_pdf(f, tables.lights, shares, i, ray.n, ray.wi, ray.kind)
            light = gather(f, light, scale(seen, met_light_weight(f, ray, pdf)))
    return light


@device
def _lights_kind(lights, own, kind):
    """Whether rays of this kind see the emissive surface: light of what they don't see counts for no shadow ray."""
    i = to_index(max(int32(own - np.int32(len(lights.lamp_kind))), np.int32(0)))
    return (own >= np.int32(0)) & (uint32(at(lights.emitter_mask, i)) & kind != np.uint32(0))


@device
def _gather_lamps(f, tables, memory, ray, start, light):
    """`light` with that of the lamps that were noted on the ray's way from `start` to its hit."""
    words = memory.words
    for i in range(words[LAMP_COUNT]):
        place = NOTED_LAMPS + i * NOTED_WORDS
        lamp = _noted_lamp(tables, words, place)
        if not _counts(f, tables, memory, place, lamp, ray, start):
            words[place + NOTED_PRIM] = INVALID
            continue
        words[place + NOTED_PRIM] = np.uint32(lamp)
        if not _noted_before(words, place):
            light = gather(f, light, _met_lamp(f, tables, memory, ray, lamp, start, place))
    return light


@device
def _noted_lamp(tables, words, place):
    """The lamp whose shape was met."""
    geometry, lights = tables.geometry, tables.lights
    shape, prim = words[place + NOTED_GEOM], np.int64(words[place + NOTED_PRIM])
    base = np.int64(geometry.base[shape])
    if geometry.kind[shape] == LAMP_QUADS:
        return lights.lamp_of_quad[base + prim // 2]
    return lights.lamp_of_sphere[base + prim]


@device
def _counts(f, tables, memory, place, lamp, ray, start):
    """Whether the ray meets the lamp there, on its way from `start` to its hit."""
    geometry, lights = tables.geometry, tables.lights
    t, t_hit = memory.floats[place + NOTED_T], memory.floats[TFAR]
    if f.lamp_kinds & DISK and lights.lamp_kind[lamp] & DISK:
        # Embree has no disk that turns towards a point, so the sphere around it was met, on either side of the disk.
        t = disk_distance(lights.lamps, lamp, ray.p, ray.wi) - length(sub(start, ray.p))
        return memory.floats[TNEAR] < t and t <= t_hit
    if geometry.kind[memory.words[place + NOTED_GEOM]] == LAMP_QUADS:
        return t <= t_hit
    # Rays meet a sphere twice: the first time counts, or for those from within the second.
    leaves = memory.words[place + NOTED_LEAVES] != 0
    return t <= t_hit and leaves == inside_lamp(lights.lamps, lamp, ray.p)


@device
def _noted_before(words, place):
    """A lamp may be met twice: both triangles of a quad at its diagonal, both ends of the sphere around a disk. The
    lamps that count, which have taken the primitives' places, are compared."""
    for other in range(NOTED_LAMPS, place, NOTED_WORDS):
        if words[other + NOTED_PRIM] == words[place + NOTED_PRIM]:
            return True
    return False


@device
def _met_lamp(f, tables, memory, ray, lamp, start, place):
    """Radiance, MIS weight included, of the lamp noted at `place` by a ray on its way from `start`."""
    lights, p, wi = tables.lights, ray.p, ray.wi
    scattered = ray.pdf > ZERO
    if scattered and not found_by_rays(f, lights, lamp, p):
        return BLACK
    distance = length(sub(p, add_scaled(start, wi, memory.floats[place + NOTED_T])))
    radiance, pdf = lamp_seen(f, lights, lamp, p, ray.n, wi, distance)
    if is_black(radiance):
        return BLACK
    if scattered:
        pdf *= local_probability(f, lights, tables.tree, lamp, p, ray.n)
    return scale(radiance, met_light_weight(f, ray, pdf))
