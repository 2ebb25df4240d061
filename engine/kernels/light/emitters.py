"""All emitters behind one door: choose one, sample it, or say what a ray that met one sees of it.

Emitters are in three groups (see `groups`): local ones (lamps and emissive triangles, chosen by the light tree),
suns, and the world's image. A constant world is in none of them: sampling the BSDF finds it with less noise than any
light sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...features import (
    DISK,
    ELLIPSE,
    EMITTER_TREE,
    IMAGE_WORLD,
    NO_EMITTER,
    ONE_EMITTER,
    POINT,
    RECTANGLE,
    SPHERE,
    SPOT,
)
from ..geom.vec import BLACK, FAR, LAST_BELOW_ONE, ONE, ZERO, cross, mul, sub
from ..jit import device
from ..tables import EMISSION, LAMP_MASK, SHADOW_RAY, SUN_MASK, SUN_UNSHADOWED, UNSHADOWED, WORLD_COLOR, WORLD_MASK
from .area import before_shape, ellipse_lamp_seen, rectangle_lamp_seen, sample_ellipse_lamp, sample_rectangle_lamp
from .environment import environment_lookup, sample_environment
from .groups import group_shares
from .point import disk_lamp_seen, inside_lamp, sample_disk_lamp, sample_point, sample_sphere_lamp, sphere_lamp_seen
from .spherical import rectangle_pdf, sample_rectangle, sample_triangle, triangle_pdf
from .sun import choose_sun, sample_sun, sun_probability, sun_seen
from .tree import sample_tree, tree_probability

UP = (ZERO, ZERO, ONE)
SEES_ALL = np.uint32(7)


class LightSample(NamedTuple):
    """A direction towards some light.

    wi        unit;  t  metres, infinite for suns and the world
    radiance  along wi; for a delta light the irradiance on a facing plane
    pdf       of wi, the choice of the emitter included; 0: there is nothing. Of a delta light: of the choice alone
    alone     no ray that was sampled from a BSDF finds this light
    shadowed  things on the way count
    mask      which kinds of rays see the light: its visibility
    """

    wi: tuple
    t: np.float32
    radiance: tuple
    pdf: np.float32
    alone: bool
    shadowed: bool
    mask: np.uint32


@device
def no_sample():
    return LightSample(UP, ZERO, BLACK, ZERO, False, True, SEES_ALL)


@device
def sample_light(f, geometry, lights, environment, tree, p, n, own, u, u1, u2):
    """Draw a `LightSample` for the point p with normal n from three random numbers.

    own: the emitter that p lies on, or -1. It is flat and gives itself nothing; what rounding makes of its height
    above itself must not be taken for light.
    """
    shares = group_shares(f, lights, tree, p, n)
    if f.emitter_choice != NO_EMITTER:
        if u < shares.local:
            u = min(u / shares.local, LAST_BELOW_ONE)
            return _sample_local(f, geometry, lights, tree, p, n, own, u, shares.local, u1, u2)
        u -= shares.local
    if f.suns:
        if u < shares.suns:
            return _sample_suns(f, lights, n, min(u / shares.suns, LAST_BELOW_ONE), shares.suns, u1, u2)
        u -= shares.suns
    if f.world == IMAGE_WORLD and u < shares.world:
        local, radiance, pdf = sample_environment(environment, u1, u2)
        wi = _from_environment(lights, local)
        mask = np.uint32(lights.world[WORLD_MASK])
        return LightSample(wi, FAR, mul(radiance, _world_color(lights)), pdf * shares.world, False, True, mask)
    return no_sample()


@device
def _sample_local(f, geometry, lights, tree, p, n, own, u, share, u1, u2):
    emitter, chosen = np.int32(0), ONE
    if f.emitter_choice == EMITTER_TREE:
        emitter, chosen, u = sample_tree(tree, p, n, u)
        if chosen <= ZERO:
            return no_sample()
    if emitter == own:
        return no_sample()
    lamp_count = len(lights.lamp_kind)
    if f.mesh_emitters and (not f.lamp_kinds or emitter >= lamp_count):
        triangle = np.int64(lights.emitter_triangle[emitter - lamp_count])
        if f.rectangle_emitters and is_rectangle(lights, emitter - lamp_count):
            corner, x, y = rectangle(lights, emitter - lamp_count)
            wi, t, pdf = sample_rectangle(p, corner, x, y, u1, u2)
        else:
            a, b, c = triangle_vertices(geometry, triangle)
            wi, t, pdf = sample_triangle(p, a, b, c, u1, u2)
        radiance = emission(geometry, geometry.triangle_slot[triangle])
        mask = np.uint32(lights.emitter_mask[emitter - lamp_count])
        alone = not f.shared_light and not (mask & SHADOW_RAY)  # see kernels/mis.py
        return LightSample(wi, t, radiance, pdf * chosen * share, alone, True, mask)
    if f.lamp_kinds:
        wi, t, radiance, pdf, delta = _sample_lamp(f, lights, emitter, p, n, u1, u2)
        mask = np.uint32(lights.lamps[emitter, LAMP_MASK])
        shadowed = not (f.unshadowed and lights.lamps[emitter, UNSHADOWED] > ZERO)
        alone = delta or not found_by_rays(f, lights, emitter, p)
        return LightSample(wi, t, radiance, pdf * chosen * share, alone, shadowed, mask)
    return no_sample()


@device
def _sample_lamp(f, lights, i, p, n, u1, u2):
    """(wi, t, radiance, pdf, delta)"""
    kind, lamps = lights.lamp_kind[i], lights.lamps
    spot = (f.lamp_kinds & SPOT) and (kind & SPOT)
    if f.lamp_kinds & RECTANGLE and kind & RECTANGLE:
        wi, t, radiance, pdf = sample_rectangle_lamp(lamps, i, p, u1, u2)
        return wi, t, radiance, pdf, False
    if f.lamp_kinds & ELLIPSE and kind & ELLIPSE:
        wi, t, radiance, pdf = sample_ellipse_lamp(lamps, i, p, u1, u2)
        return wi, t, radiance, pdf, False
    if f.lamp_kinds & SPHERE and kind & SPHERE:
        wi, t, radiance, pdf = sample_sphere_lamp(spot, lamps, i, p, n, u1, u2)
        return wi, t, radiance, pdf, False
    if f.lamp_kinds & DISK and kind & DISK:
        wi, t, radiance, pdf = sample_disk_lamp(spot, lamps, i, p, u1, u2)
        return wi, t, radiance, pdf, False
    if f.lamp_kinds & POINT and kind & POINT:
        wi, t, radiance, pdf = sample_point(spot, lamps, i, p)
        return wi, t, radiance, pdf, True
    return UP, ZERO, BLACK, ZERO, False


@device
def _sample_suns(f, lights, n, u, share, u1, u2):
    i, chosen = choose_sun(lights.suns, n, u)
    wi, radiance, pdf, delta = sample_sun(lights.suns, i, u1, u2)
    shadowed = not (f.unshadowed and lights.suns[i, SUN_UNSHADOWED] > ZERO)
    mask = np.uint32(lights.suns[i, SUN_MASK])
    return LightSample(wi, FAR, radiance, pdf * chosen * share, delta or not shadowed, shadowed, mask)


@device
def local_probability(f, lights, tree, emitter, p, n):
    """Of `sample_light` choosing this lamp or emissive triangle, seen from p with normal n."""
    if f.emitter_choice == ONE_EMITTER:
        return ONE
    return group_shares(f, lights, tree, p, n).local * tree_probability(tree, emitter, p, n)


@device
def found_by_rays(f, lights, i, p):
    """Whether a ray that was scattered at p shares the light of lamp i with light sampling. If not, light sampling
    alone finds it: a lamp that casts no shadow, as rays would be blocked; an area lamp whose shape for rays p is too
    close to; and a disk, which is met by way of the sphere around it, where p is inside that sphere or something
    transparent may lie there."""
    if f.unshadowed and lights.lamps[i, UNSHADOWED] > ZERO:
        return False
    if f.lamp_kinds & (RECTANGLE | ELLIPSE) and lights.lamp_kind[i] & (RECTANGLE | ELLIPSE):
        return before_shape(lights.lamps, i, p)
    if f.lamp_kinds & DISK and lights.lamp_kind[i] & DISK:
        return not (f.transparency or inside_lamp(lights.lamps, i, p))
    return True


@device
def lamp_seen(f, lights, i, p, n, wi, t):
    """(radiance, pdf without the choice) for a ray from p that meets the shape of lamp i at t."""
    kind, lamps = lights.lamp_kind[i], lights.lamps
    spot = (f.lamp_kinds & SPOT) and (kind & SPOT)
    if f.lamp_kinds & RECTANGLE and kind & RECTANGLE:
        return rectangle_lamp_seen(lamps, i, p, wi, t)
    if f.lamp_kinds & ELLIPSE and kind & ELLIPSE:
        return ellipse_lamp_seen(lamps, i, p, wi, t)
    if f.lamp_kinds & SPHERE and kind & SPHERE:
        return sphere_lamp_seen(spot, lamps, i, p, n, wi)
    if f.lamp_kinds & DISK and kind & DISK:
        return disk_lamp_seen(spot, lamps, i, p, wi)
    return BLACK, ZERO


@device
def surface_seen_pdf(f, geometry, lights, emitter, p, wi, t):
    """Density, without the choice, of sampling the emissive surface along wi from p, which meets it at t."""
    if f.rectangle_emitters and is_rectangle(lights, emitter - len(lights.lamp_kind)):
        corner, x, y = rectangle(lights, emitter - len(lights.lamp_kind))
        return rectangle_pdf(p, corner, x, y, wi, t)
    triangle = np.int64(lights.emitter_triangle[emitter - len(lights.lamp_kind)])
    a, b, c = triangle_vertices(geometry, triangle)
    return triangle_pdf(p, a, b, c, cross(sub(b, a), sub(c, a)), wi, t)


@device
def sun_seen_pdf(f, lights, shares, i, n, wi, mask):
    """(radiance, pdf with the choice) of sun i along wi, black if rays of this kind don't see it. n, and the `shares`
    of the groups, are those of the point that the ray left."""
    if not (np.uint32(lights.suns[i, SUN_MASK]) & mask):
        return BLACK, ZERO
    radiance, pdf = sun_seen(lights.suns, i, wi)
    if pdf > ZERO:
        pdf *= shares.suns * sun_probability(lights.suns, i, n)
    return radiance, FAR if f.unshadowed and lights.suns[i, SUN_UNSHADOWED] > ZERO else pdf


@device
def world_seen(f, lights, shares, environment, wi, mask):
    """(radiance, pdf with the choice) of the world along wi, black if rays of this kind don't see it."""
    if not (np.uint32(lights.world[WORLD_MASK]) & mask):
        return BLACK, ZERO
    if f.world != IMAGE_WORLD:
        return _world_color(lights), ZERO
    local = _to_environment(lights, wi)
    radiance, pdf = environment_lookup(environment, local)
    return mul(radiance, _world_color(lights)), pdf * shares.world


@device
def _world_color(lights):
    return lights.world[WORLD_COLOR], lights.world[WORLD_COLOR + 1], lights.world[WORLD_COLOR + 2]


@device
def _to_environment(lights, w):
    r = lights.world_rotation
    return (
        r[0, 0] * w[0] + r[0, 1] * w[1] + r[0, 2] * w[2],
        r[1, 0] * w[0] + r[1, 1] * w[1] + r[1, 2] * w[2],
        r[2, 0] * w[0] + r[2, 1] * w[1] + r[2, 2] * w[2],
    )


@device
def _from_environment(lights, w):
    r = lights.world_rotation
    return (
        r[0, 0] * w[0] + r[1, 0] * w[1] + r[2, 0] * w[2],
        r[0, 1] * w[0] + r[1, 1] * w[1] + r[2, 1] * w[2],
        r[0, 2] * w[0] + r[1, 2] * w[1] + r[2, 2] * w[2],
    )


@device
def is_rectangle(lights, i):
    r = lights.emitter_rectangle
    return r[i, 3] != ZERO or r[i, 4] != ZERO or r[i, 5] != ZERO


@device
def rectangle(lights, i):
    """(corner, edge x, edge y)"""
    r = lights.emitter_rectangle
    return (r[i, 0], r[i, 1], r[i, 2]), (r[i, 3], r[i, 4], r[i, 5]), (r[i, 6], r[i, 7], r[i, 8])


@device
def vertex(geometry, i):
    return geometry.vertices[i, 0], geometry.vertices[i, 1], geometry.vertices[i, 2]


@device
def triangle_vertices(geometry, triangle):
    corners = geometry.triangles
    return (
        vertex(geometry, corners[triangle, 0]),
        vertex(geometry, corners[triangle, 1]),
        vertex(geometry, corners[triangle, 2]),
    )


@device
def emission(geometry, material):
    m = geometry.materials
    return m[material, EMISSION], m[material, EMISSION + 1], m[material, EMISSION + 2]
