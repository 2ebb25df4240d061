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
    TRACED_LAMPS,
)
from ..geom.vec import BLACK, FAR, LAST_BELOW_ONE, ONE, UP, ZERO, cross, mul, sub
from ..jit import device
from ..records import material_color
from ..simd import any_of, at, int32, no, select, to_index, uint32, words_at
from ..tables import EMISSION, LAMP_MASK, SHADOW_RAY, SUN_MASK, SUN_UNSHADOWED, UNSHADOWED, WORLD_COLOR, WORLD_MASK
from .area import (
    area_lamp_distance,
    before_shape,
    ellipse_lamp_seen,
    rectangle_lamp_seen,
    sample_ellipse_lamp,
    sample_rectangle_lamp,
)
from .environment import environment_lookup, sample_environment
from .groups import group_shares
from .point import (
    disk_lamp_distance,
    disk_lamp_seen,
    inside_lamp,
    sample_disk_lamp,
    sample_point,
    sample_sphere_lamp,
    sphere_lamp_distance,
    sphere_lamp_seen,
)
from .spherical import rectangle_pdf, sample_rectangle, sample_triangle, triangle_pdf
from .sun import choose_sun, sample_sun, sun_probability, sun_seen
from .tree import sample_tree, tree_probability

SEES_ALL = np.uint32(7)
NOTHING = (UP, ZERO, BLACK, ZERO, False, True, SEES_ALL)  # the fields of a LightSample that has drawn nothing


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
def sample_light(f, geometry, lights, environment, tree, p, n, own, u, u1, u2):
    """Draw a `LightSample` for the point p with normal n from three random numbers.

    own: the emitter that p lies on, or -1. It is flat and gives itself nothing; what rounding makes of its height
    above itself must not be taken for light.
    """
    shares, drawn = group_shares(f, lights, tree, p, n), NOTHING
    if f.emitter_choice != NO_EMITTER:
        local = u < shares.local
        if any_of(local):
            rest = min(u / shares.local, LAST_BELOW_ONE)
            drawn = select(
                local, _sample_local(f, geometry, lights, tree, p, n, own, rest, shares.local, u1, u2), drawn
            )
        u = select(local, ONE, u - shares.local)
    if f.suns:
        suns = u < shares.suns
        if any_of(suns):
            rest = min(u / shares.suns, LAST_BELOW_ONE)
            drawn = select(suns, _sample_suns(f, lights, n, rest, shares.suns, u1, u2), drawn)
        u = select(suns, ONE, u - shares.suns)
    if f.world == IMAGE_WORLD:
        world = u < shares.world
        if any_of(world):
            drawn = select(world, _sample_world(lights, environment, shares.world, u1, u2), drawn)
    wi, t, radiance, pdf, alone, shadowed, mask = drawn
    return LightSample(wi, t, radiance, pdf, alone, shadowed, mask)


@device
def _sample_local(f, geometry, lights, tree, p, n, own, u, share, u1, u2):
    """The fields of a `LightSample`."""
    emitter, chosen = np.int32(0), ONE
    if f.emitter_choice == EMITTER_TREE:
        emitter, chosen, u = sample_tree(tree, p, n, u)
    lamp_count, lit, drawn = np.int32(len(lights.lamp_kind)), chosen > ZERO, NOTHING
    if f.mesh_emitters:
        surface = lit & (emitter >= lamp_count) if f.lamp_kinds else lit
        if any_of(surface):
            i = to_index(select(surface, int32(emitter - lamp_count), np.int32(0)))
            drawn = _sample_surface(f, geometry, lights, i, p, u1, u2)
    if f.lamp_kinds:
        lamp = lit & (emitter < lamp_count)
        if any_of(lamp):
            i = to_index(select(lamp, emitter, np.int32(0)))
            drawn = select(lamp, _sample_lamp(f, lights, i, p, n, u1, u2), drawn)
    wi, t, radiance, pdf, alone, shadowed, mask = drawn
    return wi, t, radiance, select(no(lit) | (emitter == own), ZERO, pdf * chosen * share), alone, shadowed, mask


@device
def _sample_surface(f, geometry, lights, i, p, u1, u2):
    """Of emissive triangle i: the fields of a `LightSample`, without the choice."""
    wi, t, pdf = _sample_emitter_shape(f, geometry, lights, i, p, u1, u2)
    radiance = emission(geometry, at(geometry.triangle_slot, at(lights.emitter_triangle, i)))
    mask = uint32(at(lights.emitter_mask, i))
    alone = no(mask & SHADOW_RAY != np.uint32(0)) & (not f.shared_light)  # see kernels/mis.py
    return wi, t, radiance, pdf, alone, True, mask


@device
def _sample_emitter_shape(f, geometry, lights, i, p, u1, u2):
    """(wi, t, pdf)"""
    whole = is_rectangle(f, lights, i)
    if not any_of(no(whole)):
        corner, x, y = rectangle(lights, i)
        return sample_rectangle(p, corner, x, y, u1, u2)
    a, b, c = triangle_vertices(geometry, at(lights.emitter_triangle, i))
    drawn = sample_triangle(p, a, b, c, u1, u2)
    if any_of(whole):
        corner, x, y = rectangle(lights, i)
        drawn = select(whole, sample_rectangle(p, corner, x, y, u1, u2), drawn)
    return drawn


@device
def _sample_lamp(f, lights, i, p, n, u1, u2):
    """The fields of a `LightSample`, without the choice."""
    kind, lamps = at(lights.lamp_kind, i), lights.lamps
    spot = _is(f, kind, np.int32(SPOT))
    drawn = (UP, ZERO, BLACK, ZERO)
    is_kind = _is(f, kind, np.int32(RECTANGLE))
    if any_of(is_kind):
        drawn = select(is_kind, sample_rectangle_lamp(lamps, i, p, u1, u2), drawn)
    is_kind = _is(f, kind, np.int32(ELLIPSE))
    if any_of(is_kind):
        drawn = select(is_kind, sample_ellipse_lamp(lamps, i, p, u1, u2), drawn)
    is_kind = _is(f, kind, np.int32(SPHERE))
    if any_of(is_kind):
        drawn = select(is_kind, sample_sphere_lamp(spot, lamps, i, p, n, u1, u2), drawn)
    is_kind = _is(f, kind, np.int32(DISK))
    if any_of(is_kind):
        drawn = select(is_kind, sample_disk_lamp(spot, lamps, i, p, u1, u2), drawn)
    delta = _is(f, kind, np.int32(POINT))
    if any_of(delta):
        drawn = select(delta, sample_point(spot, lamps, i, p), drawn)
    wi, t, radiance, pdf = drawn
    shadowed = (at(lamps, i, UNSHADOWED) <= ZERO) | (not f.unshadowed)
    alone = delta | no(found_by_rays(f, lights, i, p))
    return wi, t, radiance, pdf, alone, shadowed, uint32(int32(at(lamps, i, LAMP_MASK)))


@device
def _is(f, kind, bit):
    """Whether a lamp is of that kind, in a scene that has such lamps."""
    return (kind & bit != np.int32(0)) & (f.lamp_kinds & bit != 0)


@device
def _sample_suns(f, lights, n, u, share, u1, u2):
    """The fields of a `LightSample`."""
    i, chosen = choose_sun(lights.suns, n, u)
    wi, radiance, pdf, delta = sample_sun(lights.suns, i, u1, u2)
    shadowed = (at(lights.suns, i, SUN_UNSHADOWED) <= ZERO) | (not f.unshadowed)
    mask = uint32(int32(at(lights.suns, i, SUN_MASK)))
    return wi, FAR, radiance, pdf * chosen * share, delta | no(shadowed), shadowed, mask


@device
def _sample_world(lights, environment, share, u1, u2):
    """The fields of a `LightSample`."""
    local, radiance, pdf = sample_environment(environment, u1, u2)
    wi, mask = _from_environment(lights, local), np.uint32(lights.world[WORLD_MASK])
    return wi, FAR, mul(radiance, _world_color(lights)), pdf * share, False, True, mask


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
    close to; and a disk that Embree has, as the sphere around it, where p is inside that sphere or something
    transparent may lie there."""
    kind, lamps = at(lights.lamp_kind, i), lights.lamps
    found = (at(lamps, i, UNSHADOWED) <= ZERO) | (not f.unshadowed)
    if f.lamp_kinds & (RECTANGLE | ELLIPSE):
        flat = _is(f, kind, np.int32(RECTANGLE)) | _is(f, kind, np.int32(ELLIPSE))
        found = found & (no(flat) | before_shape(lamps, i, p))
    if f.lamp_kinds & DISK and f.lamp_shapes & TRACED_LAMPS:
        found = found & no(_is(f, kind, np.int32(DISK)) & (inside_lamp(lamps, i, p) | (f.transparency != 0)))
    return found


@device
def lamp_distance(f, lights, i, p, wi):
    """How far from p along wi lamp i, the same for all lanes, is met; negative where it is missed."""
    kind, lamps = lights.lamp_kind[i], lights.lamps
    if f.lamp_kinds & (RECTANGLE | ELLIPSE) and kind & np.int32(RECTANGLE | ELLIPSE):
        return area_lamp_distance(lamps, i, p, wi)
    if f.lamp_kinds & DISK and kind & np.int32(DISK):
        return disk_lamp_distance(lamps, i, p, wi)
    return sphere_lamp_distance(lamps, i, p, wi)


@device
def lamp_seen(f, lights, i, p, n, wi, t):
    """(radiance, pdf without the choice) for a ray from p that meets the shape of lamp i at t."""
    kind, lamps = at(lights.lamp_kind, i), lights.lamps
    spot = _is(f, kind, np.int32(SPOT))
    seen = (BLACK, ZERO)
    is_kind = _is(f, kind, np.int32(RECTANGLE))
    if any_of(is_kind):
        seen = select(is_kind, rectangle_lamp_seen(lamps, i, p, wi, t), seen)
    is_kind = _is(f, kind, np.int32(ELLIPSE))
    if any_of(is_kind):
        seen = select(is_kind, ellipse_lamp_seen(lamps, i, p, wi, t), seen)
    is_kind = _is(f, kind, np.int32(SPHERE))
    if any_of(is_kind):
        seen = select(is_kind, sphere_lamp_seen(spot, lamps, i, p, n, wi), seen)
    is_kind = _is(f, kind, np.int32(DISK))
    if any_of(is_kind):
        seen = select(is_kind, disk_lamp_seen(spot, lamps, i, p, wi), seen)
    return seen


@device
def surface_seen_pdf(f, geometry, lights, emitter, p, wi, t):
    """Density, without the choice, of sampling the emissive surface along wi from p, which meets it at t."""
    i = to_index(emitter - np.int32(len(lights.lamp_kind)))
    whole = is_rectangle(f, lights, i)
    if not any_of(no(whole)):
        corner, x, y = rectangle(lights, i)
        return rectangle_pdf(p, corner, x, y, wi, t)
    a, b, c = triangle_vertices(geometry, at(lights.emitter_triangle, i))
    pdf = triangle_pdf(p, a, b, c, cross(sub(b, a), sub(c, a)), wi, t)
    if any_of(whole):
        corner, x, y = rectangle(lights, i)
        pdf = select(whole, rectangle_pdf(p, corner, x, y, wi, t), pdf)
    return pdf


@device
def sun_seen_pdf(f, lights, shares, i, n, wi, mask):
    """(radiance, pdf with the choice) of sun i along wi, black if rays of this kind don't see it. n, and the `shares`
    of the groups, are those of the point that the ray left."""
    kind_sees = mask & np.uint32(lights.suns[i, SUN_MASK]) != np.uint32(0)
    if not any_of(kind_sees):
        return BLACK, ZERO
    radiance, pdf = sun_seen(lights.suns, i, wi)
    if any_of(pdf > ZERO):
        pdf *= shares.suns * sun_probability(lights.suns, i, n)
    if f.unshadowed and lights.suns[i, SUN_UNSHADOWED] > ZERO:
        pdf = FAR
    return select(kind_sees, (radiance, pdf), (BLACK, ZERO))


@device
def world_seen(f, lights, shares, environment, wi, mask):
    """(radiance, pdf with the choice) of the world along wi, black if rays of this kind don't see it."""
    kind_sees = mask & np.uint32(lights.world[WORLD_MASK]) != np.uint32(0)
    if not any_of(kind_sees):
        return BLACK, ZERO
    if f.world != IMAGE_WORLD:
        return select(kind_sees, _world_color(lights), BLACK), ZERO
    local = _to_environment(lights, wi)
    radiance, pdf = environment_lookup(environment, local)
    return select(kind_sees, (mul(radiance, _world_color(lights)), pdf * shares.world), (BLACK, ZERO))


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
def is_rectangle(f, lights, i):
    """Whether emissive triangle i is a half of a rectangle that emits as one."""
    if not f.rectangle_emitters:
        return i < np.uint32(0)  # no
    r = lights.emitter_rectangle
    return (at(r, i, 3) != ZERO) | (at(r, i, 4) != ZERO) | (at(r, i, 5) != ZERO)


@device
def rectangle(lights, i):
    """(corner, edge x, edge y)"""
    r = lights.emitter_rectangle
    corner = at(r, i, 0), at(r, i, 1), at(r, i, 2)
    return corner, (at(r, i, 3), at(r, i, 4), at(r, i, 5)), (at(r, i, 6), at(r, i, 7), at(r, i, 8))


@device
def triangle_vertices(geometry, triangle):
    i, j, k, _ = words_at(geometry.triangles, triangle * np.uint32(3), 4)
    return row_of_3(geometry.vertices, i), row_of_3(geometry.vertices, j), row_of_3(geometry.vertices, k)


@device
def row_of_3(array, i):
    """Row i of an array of rows of three numbers, which has memory for a fourth behind its last."""
    x, y, z, _ = words_at(array, i * np.uint32(3), 4)
    return x, y, z


@device
def emission(geometry, material):
    return material_color(geometry, material, EMISSION)
