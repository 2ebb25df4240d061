"""What light a ray finds: of the lamps that it passes, of the surface that it meets, or of what lies behind."""

from __future__ import annotations

import numpy as np

from ..features import DARK_WORLD, DISK, IMAGE_WORLD
from .embree import (
    GEOM_ID,
    INST_ID,
    INVALID,
    LAMP_COUNT,
    NOTED_GEOM,
    NOTED_LAMPS,
    NOTED_LEAVES,
    NOTED_PRIM,
    NOTED_T,
    NOTED_WORDS,
    TFAR,
    bits_of,
    float_of,
    intersect,
    intersect_noting_lamps,
)
from .geom.surface import find_surface, offset_origin
from .geom.vec import BLACK, FAR, ONE, ZERO, add_scaled, is_black, length, negate, scale, sub
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
from .light.groups import NO_SHARES, group_shares
from .light.point import disk_distance, inside_lamp
from .mis import met_light_weight
from .records import MAX_TRANSPARENT, Light, Ray, Stretch, dimmed, gather, material_color
from .tables import CAMERA_RAY, LAMP_QUADS, LAMP_SHIFT, SHADOW_RAY, TRANSPARENCY


@device
def follow(f, tables, memory, ray, stretch, light):
    """Follow a ray to the next surface, and gather the light that it finds: of the lamps before the surface, and of
    suns and the world if there is none.

    Returns (whether a surface was met, which is then in `memory`, `light`, rays traced)."""
    scene, floats, words = tables.geometry.accel[0], memory.floats, memory.words
    mask, t_near, rays = _reach(f, ray), stretch.t_near, 1
    if f.lamp_shapes:
        met = intersect_noting_lamps(scene, floats, words, stretch.start, ray.wi, t_near, stretch.t_far, mask)
        light = _gather_lamps(f, tables, memory, ray, stretch.start, light)
        while met and _is_lamp(f, tables.geometry, words):  # there were more than can be noted
            rays += 1
            t_near = float_of(np.int32(bits_of(floats[TFAR]) + 1))
            met = intersect_noting_lamps(scene, floats, words, stretch.start, ray.wi, t_near, stretch.t_far, mask)
            light = _gather_lamps(f, tables, memory, ray, stretch.start, light)
    else:
        met = intersect(scene, floats, words, stretch.start, ray.wi, t_near, stretch.t_far, mask)
    if not met:
        light = _escaped(f, tables, ray, light)
    return met, light, rays


@device
def emitted(f, tables, ray, p, material, triangle):
    """(radiance, MIS weight included, of the surface that a ray met at p, the emitter there or -1)."""
    own = np.int32(-1)
    if not f.mesh_emitters:
        return BLACK, own
    radiance = emission(tables.geometry, material)
    if is_black(radiance):
        return BLACK, own
    own = tables.lights.triangle_emitter[triangle]
    if ray.as_shadow and not _lights_kind(tables.lights, own, ray.kind):
        return BLACK, own
    weight = ONE
    if ray.pdf > ZERO:
        pdf = ZERO
        if own >= 0:
            t = length(sub(p, ray.p))
            pdf = surface_seen_pdf(f, tables.geometry, tables.lights, own, ray.p, ray.wi, t)
            pdf *= local_probability(f, tables.lights, tables.tree, own, ray.p, ray.n)
        weight = met_light_weight(f, ray, pdf)
    return scale(radiance, weight), own


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
        met, light, more = follow(f, tables, memory, ray, stretch, light)
        rays += more
        if not met:
            break
        p, _, ng, material, triangle = find_surface(f, geometry, memory.floats, memory.words, negate(ray.wi))
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
def _escaped(f, tables, ray, light):
    """`light` with that of suns and of the world for a ray that left the scene. A transparent film shows no world."""
    shares = NO_SHARES
    if (f.world == IMAGE_WORLD or f.sun_disks) and ray.pdf > ZERO:
        shares = group_shares(f, tables.lights, tables.tree, ray.p, ray.n)
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
    return own >= 0 and lights.emitter_mask[own - len(lights.lamp_kind)] & kind


@device
def _is_lamp(f, geometry, words):
    """Whether the hit is a lamp's shape and no surface."""
    if f.instances and words[INST_ID] != INVALID:
        return False
    return geometry.kind[words[GEOM_ID]] >= LAMP_QUADS


@device
def _gather_lamps(f, tables, memory, ray, start, light):
    """`light` with that of the lamps that were noted on the ray's way from `start` to its hit."""
    floats, words = memory.floats, memory.words
    for i in range(words[LAMP_COUNT]):
        place = NOTED_LAMPS + i * NOTED_WORDS
        if floats[place + NOTED_T] > floats[TFAR]:
            words[place + NOTED_PRIM] = INVALID
            continue
        lamp = _noted_lamp(tables, words, place)
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
def _noted_before(words, place):
    """Rays that meet the diagonal of a quad meet both of its triangles. The lamps, which have taken the primitives'
    places, are compared."""
    for other in range(NOTED_LAMPS, place, NOTED_WORDS):
        if (
            words[other + NOTED_PRIM] == words[place + NOTED_PRIM]
            and words[other + NOTED_LEAVES] == words[place + NOTED_LEAVES]
        ):
            return True
    return False


@device
def _met_lamp(f, tables, memory, ray, lamp, start, place):
    """Radiance, MIS weight included, of the lamp noted at `place` by a ray on its way from `start`."""
    lights, p, wi = tables.lights, ray.p, ray.wi
    t_hit = memory.floats[place + NOTED_T]
    distance = length(sub(p, add_scaled(start, wi, t_hit)))
    if not _counts(tables, memory.words, place, lamp, p):
        return BLACK
    scattered = ray.pdf > ZERO
    if scattered and not found_by_rays(f, lights, lamp, p):
        return BLACK
    radiance, pdf = lamp_seen(f, lights, lamp, p, ray.n, wi, distance)
    if is_black(radiance):
        return BLACK
    if f.lamp_kinds & DISK and lights.lamp_kind[lamp] & DISK:
        # Embree has no disk that turns towards a point, so what was met is the sphere around it.
        t_disk = disk_distance(lights.lamps, lamp, p, wi) - (distance - t_hit)
        if t_disk > memory.floats[TFAR]:
            return BLACK
    if scattered:
        pdf *= local_probability(f, lights, tables.tree, lamp, p, ray.n)
    return scale(radiance, met_light_weight(f, ray, pdf))


@device
def _counts(tables, words, place, lamp, p):
    """Rays meet a sphere twice: the first time counts, or for those from within the second. A quad has one side."""
    if tables.geometry.kind[words[place + NOTED_GEOM]] == LAMP_QUADS:
        return True
    return (words[place + NOTED_LEAVES] != 0) == inside_lamp(tables.lights.lamps, lamp, p)
