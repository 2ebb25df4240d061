"""Point lamps: a point, a sphere, or the disk that always faces the shading point ("soft falloff").

All have the intensity of a point seen from afar: the radiance of sphere and disk is intensity / (pi radius^2).
"""

from __future__ import annotations

import math

from ..geom.frame import to_world
from ..geom.vec import BLACK, ONE, TINY, ZERO, direction_and_length, dot, negate, scale, sub
from ..jit import device
from ..sampler.warp import uniform_cone, uniform_cone_pdf
from ..simd import any_of, at, no, select
from ..tables import POSITION, RADIANCE, SIZE
from .spherical import one_minus_cos, sample_sphere, sphere_pdf
from .spot import spot_falloff


@device
def _position(lamps, i):
    return at(lamps, i, POSITION), at(lamps, i, POSITION + 1), at(lamps, i, POSITION + 2)


@device
def _radiance(lamps, i):
    return at(lamps, i, RADIANCE), at(lamps, i, RADIANCE + 1), at(lamps, i, RADIANCE + 2)


@device
def sample_point(spot, lamps, i, p):
    """(wi, t, irradiance on a plane that faces the lamp, pdf = 1): a delta, no density."""
    wi, t = direction_and_length(sub(_position(lamps, i), p))
    here = t <= ZERO
    falloff = ONE / (t * t)
    if any_of(spot):
        falloff *= select(spot, spot_falloff(lamps, i, negate(wi)), ONE)
    return wi, t, select(here, BLACK, scale(_radiance(lamps, i), falloff)), select(here, ZERO, ONE)


@device
def sample_sphere_lamp(spot, lamps, i, p, n, u1, u2):
    """(wi, t, radiance, pdf)"""
    wi, t, pdf = sample_sphere(p, n, _position(lamps, i), at(lamps, i, SIZE), u1, u2)
    return wi, t, _sphere_radiance(spot, lamps, i, p, wi), pdf


@device
def sphere_lamp_seen(spot, lamps, i, p, n, wi):
    """(radiance, pdf) for a ray from p along wi that meets the sphere; n is the normal at p."""
    return _sphere_radiance(spot, lamps, i, p, wi), sphere_pdf(p, n, _position(lamps, i), at(lamps, i, SIZE), wi)


@device
def _sphere_radiance(spot, lamps, i, p, wi):
    radiance = _radiance(lamps, i)
    if any_of(spot):
        # As in Cycles, a spot's cone does not darken what is inside its sphere.
        darkens = spot & no(inside_lamp(lamps, i, p))
        radiance = scale(radiance, select(darkens, spot_falloff(lamps, i, negate(wi)), ONE))
    return radiance


@device
def sample_disk_lamp(spot, lamps, i, p, u1, u2):
    """(wi, t, radiance, pdf). The disk faces p, so what p sees of it is a cone: uniform in solid angle."""
    axis, distance = direction_and_length(sub(_position(lamps, i), p))
    here = distance <= ZERO
    cap = _disk_cap(at(lamps, i, SIZE), distance)
    local = uniform_cone(u1, u2, cap)
    wi = to_world(local, axis)
    radiance, pdf = _disk_radiance(spot, lamps, i, wi), uniform_cone_pdf(cap)
    return wi, distance / max(local[2], TINY), select(here, BLACK, radiance), select(here, ZERO, pdf)


@device
def disk_lamp_seen(spot, lamps, i, p, wi):
    """(radiance, pdf) for a ray from p along wi; black where it misses the disk, as Embree has the sphere about it."""
    to_lamp = sub(_position(lamps, i), p)
    axis, distance = direction_and_length(to_lamp)
    cosine = dot(axis, wi)
    off = sub(scale(wi, distance / cosine), to_lamp)
    radius = at(lamps, i, SIZE)
    beside = (cosine <= TINY) | (dot(off, off) > radius * radius)
    radiance, pdf = _disk_radiance(spot, lamps, i, wi), uniform_cone_pdf(_disk_cap(radius, distance))
    return select(beside, BLACK, radiance), select(beside, ZERO, pdf)


@device
def _disk_cap(radius, distance):
    """1 - cos of the half-angle under which the disk is seen."""
    squared = radius * radius
    return one_minus_cos(squared / (squared + distance * distance))


@device
def disk_distance(lamps, i, p, wi):
    """Along wi from p to the plane of the disk, for a ray that meets the disk."""
    axis, distance = direction_and_length(sub(_position(lamps, i), p))
    return distance / max(dot(axis, wi), TINY)


@device
def sphere_lamp_distance(lamps, i, p, wi):
    """How far from p along wi the sphere is met, from within where it is left; negative where it is missed."""
    to_lamp, radius = sub(_position(lamps, i), p), at(lamps, i, SIZE)
    along = dot(to_lamp, wi)
    off = sub(scale(wi, along), to_lamp)  # from the middle, where the ray is next to it: cancels nothing for far lamps
    half_squared = radius * radius - dot(off, off)
    far = along + math.sqrt(max(half_squared, ZERO))
    # The product of both distances is the power of p, so the nearer one cancels nothing, however close to it p is.
    near = max(dot(to_lamp, to_lamp) - radius * radius, TINY) / max(far, TINY)
    t = select(inside_lamp(lamps, i, p), far, near)
    return select((half_squared < ZERO) | (far <= ZERO), -ONE, t)


@device
def disk_lamp_distance(lamps, i, p, wi):
    """How far from p along wi the disk is met; negative where it is missed."""
    t = disk_distance(lamps, i, p, wi)
    off, radius = sub(scale(wi, t), sub(_position(lamps, i), p)), at(lamps, i, SIZE)
    return select(dot(off, off) > radius * radius, -ONE, t)


@device
def inside_lamp(lamps, i, p):
    """Whether p lies inside the sphere of the lamp, or on it: rays from there only meet it where they leave it."""
    off = sub(_position(lamps, i), p)
    return dot(off, off) <= at(lamps, i, SIZE) * at(lamps, i, SIZE)


@device
def _disk_radiance(spot, lamps, i, wi):
    radiance = _radiance(lamps, i)
    if any_of(spot):
        radiance = scale(radiance, select(spot, spot_falloff(lamps, i, negate(wi)), ONE))
    return radiance
