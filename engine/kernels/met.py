"""What light a ray finds: of the lamps that it passes, of the surface that it meets, or of what lies behind."""

from __future__ import annotations

import numpy as np

from ..features import DARK_WORLD, DISK, IMAGE_WORLD
from .embree import GEOM_ID, INST_ID, INVALID, NORMAL, PRIM_ID, TFAR, bits_of, float_of, intersect, occluded
from .geom.surface import find_surface, offset_origin
from .geom.vec import BLACK, FAR, ONE, ZERO, add_scaled, dot, is_black, length, negate, scale, sub
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
from .records import MAX_TRANSPARENT, NO_LAMP, Light, Ray, Stretch, dimmed, gather, material_color
from .tables import CAMERA_RAY, LAMP_MASK, LAMP_QUADS, LAMP_SHIFT, SHADOW_RAY, TRANSPARENCY

# Floats between a lamp that was met and where the rest of the ray starts.
STEPS_PAST = np.int32(4)


@device
def follow(f, tables, memory, ray, stretch, light):
    """Follow a ray through lamps to the next surface and gather what light it finds before it, or if none is left.

    Returns (whether a surface was met, which is then in `memory`, `light`, the lamp met last, rays traced)."""
    geometry, wi = tables.geometry, ray.wi
    t_near, last_lamp, rays = stretch.t_near, stretch.last_lamp, 0
    while True:
        rays += 1
        mask = _reach(f, ray)
        if not intersect(
            geometry.accel[0], memory.floats, memory.words, stretch.start, wi, t_near, stretch.t_far, mask
        ):
            return False, _escaped(f, tables, ray, light), last_lamp, rays
        if not (f.lamp_shapes and _is_lamp(f, geometry, memory.words)):
            return True, light, last_lamp, rays
        lamp, t_hit = _lamp_of_hit(geometry, tables.lights, memory.words), memory.floats[TFAR]
        t_near = _neighbour(t_hit, STEPS_PAST)
        # Far from the world's origin t is too coarse to leave a lamp behind: meeting it again counts for nothing.
        if lamp != last_lamp:
            last_lamp = lamp
            while lamp >= 0:
                memory.floats[TFAR] = t_hit  # a ray that looks for what is before a disk changes it
                found, more = _met_lamp(f, tables, memory, ray, lamp, stretch.start)
                light = gather(f, light, found)
                rays += more
                lamp = tables.lights.lamp_twin[lamp]
            # The rest of the ray starts behind the lamp. A surface in the lamp's plane must not be passed over.
            rays += 1
            before = max(_neighbour(t_hit, -STEPS_PAST), stretch.t_near)
            sight = SHADOW_RAY if ray.as_shadow else ray.kind
            if intersect(geometry.accel[0], memory.floats, memory.words, stretch.start, wi, before, t_near, sight):
                return True, light, last_lamp, rays


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
    stretch, rays = Stretch(start, ZERO, FAR, NO_LAMP), 0
    for _ in range(MAX_TRANSPARENT):
        met, light, last_lamp, more = follow(f, tables, memory, ray, stretch, light)
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
        stretch = Stretch(offset_origin(p, negate(ng)), ZERO, FAR, last_lamp)
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
def _neighbour(t, steps):
    """The float so many floats after t > 0."""
    return float_of(np.int32(bits_of(t) + steps))


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
def _lamp_of_hit(geometry, lights, words):
    """The lamp whose shape was hit."""
    prim, base = np.int64(words[PRIM_ID]), np.int64(geometry.base[words[GEOM_ID]])
    if geometry.kind[words[GEOM_ID]] == LAMP_QUADS:
        return lights.lamp_of_quad[base + prim // 2]
    return lights.lamp_of_sphere[base + prim]


@device
def _met_lamp(f, tables, memory, ray, lamp, start):
    """(radiance, MIS weight included, of the lamp whose shape a ray met on its way from `start`, rays traced)."""
    lights, p, wi = tables.lights, ray.p, ray.wi
    t_hit = memory.floats[TFAR]
    distance = length(sub(p, add_scaled(start, wi, t_hit)))
    if not np.uint32(lights.lamps[lamp, LAMP_MASK]) & ray.kind:
        return BLACK, 0
    if _leaves_sphere(tables.geometry, memory, wi) and not inside_lamp(lights.lamps, lamp, p):
        return BLACK, 0
    scattered = ray.pdf > ZERO
    if scattered and not found_by_rays(f, lights, lamp, p):
        return BLACK, 0
    radiance, pdf = lamp_seen(f, lights, lamp, p, ray.n, wi, distance)
    if is_black(radiance):
        return BLACK, 0
    rays = 0
    if f.lamp_kinds & DISK and lights.lamp_kind[lamp] & DISK:
        # Embree has no disk that turns towards a point, so what was met is the sphere around it.
        rays = 1
        t_disk = disk_distance(lights.lamps, lamp, p, wi) - (distance - t_hit)
        if t_disk > t_hit and _is_blocked(tables.geometry, memory, ray, start, t_hit, t_disk):
            return BLACK, rays
    if scattered:
        pdf *= local_probability(f, lights, tables.tree, lamp, p, ray.n)
    return scale(radiance, met_light_weight(f, ray, pdf)), rays


@device
def _leaves_sphere(geometry, memory, wi):
    """Whether a lamp was met from within. Rays meet a sphere twice: for those that start outside the second time
    does not count."""
    if geometry.kind[memory.words[GEOM_ID]] == LAMP_QUADS:
        return False
    normal = (memory.floats[NORMAL], memory.floats[NORMAL + 1], memory.floats[NORMAL + 2])
    return dot(wi, normal) > ZERO


@device
def _is_blocked(geometry, memory, ray, start, t_near, t_far):
    """Whether the ray meets a surface between t_near and t_far."""
    mask = SHADOW_RAY if ray.as_shadow else ray.kind
    return occluded(geometry.accel[0], memory.floats, memory.words, start, ray.wi, t_near, t_far, mask)
