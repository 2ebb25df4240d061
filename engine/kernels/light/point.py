"""Point lamps: a point, a sphere, or the disk that always faces the shading point ("soft falloff").

All have the intensity of a point seen from afar: the radiance of sphere and disk is intensity / (pi radius^2).
"""

from __future__ import annotations

from ..geom.frame import to_world
from ..geom.vec import BLACK, ONE, TINY, ZERO, direction_and_length, dot, negate, scale, sub
from ..jit import device
from ..sampler.warp import uniform_cone, uniform_cone_pdf
from ..tables import POSITION, RADIANCE, SIZE
from .spherical import one_minus_cos, sample_sphere, sphere_pdf
from .spot import spot_falloff


@device
def _position(lamps, i):
    return lamps[i, POSITION], lamps[i, POSITION + 1], lamps[i, POSITION + 2]


@device
def _radiance(lamps, i):
    return lamps[i, RADIANCE], lamps[i, RADIANCE + 1], lamps[i, RADIANCE + 2]


@device
def sample_point(spot, lamps, i, p):
    """(wi, t, irradiance on a plane that faces the lamp, pdf = 1): a delta, no density."""
    wi, t = direction_and_length(sub(_position(lamps, i), p))
    if t <= ZERO:
        return wi, ZERO, BLACK, ZERO
    falloff = ONE / (t * t)
    if spot:
        falloff *= spot_falloff(lamps, i, negate(wi))
    return wi, t, scale(_radiance(lamps, i), falloff), ONE


@device
def sample_sphere_lamp(spot, lamps, i, p, n, u1, u2):
    """(wi, t, radiance, pdf)"""
    wi, t, pdf = sample_sphere(p, n, _position(lamps, i), lamps[i, SIZE], u1, u2)
    return wi, t, _sphere_radiance(spot, lamps, i, p, wi), pdf


@device
def sphere_lamp_seen(spot, lamps, i, p, n, wi):
    """(radiance, pdf) for a ray from p along wi that meets the sphere; n is the normal at p."""
    return _sphere_radiance(spot, lamps, i, p, wi), sphere_pdf(p, n, _position(lamps, i), lamps[i, SIZE], wi)


@device
def _sphere_radiance(spot, lamps, i, p, wi):
    radiance = _radiance(lamps, i)
    if spot:
        to_lamp = sub(_position(lamps, i), p)
        # As in Cycles, a spot's cone does not darken what is inside its sphere.
        if dot(to_lamp, to_lamp) > lamps[i, SIZE] * lamps[i, SIZE]:
            radiance = scale(radiance, spot_falloff(lamps, i, negate(wi)))
    return radiance


@device
def sample_disk_lamp(spot, lamps, i, p, u1, u2):
    """(wi, t, radiance, pdf). The disk faces p, so what p sees of it is a cone: uniform in solid angle."""
    axis, distance = direction_and_length(sub(_position(lamps, i), p))
    if distance <= ZERO:
        return axis, ZERO, BLACK, ZERO
    cap = _disk_cap(lamps[i, SIZE], distance)
    local = uniform_cone(u1, u2, cap)
    wi = to_world(local, axis)
    return wi, distance / max(local[2], TINY), _disk_radiance(spot, lamps, i, wi), uniform_cone_pdf(cap)


@device
def disk_lamp_seen(spot, lamps, i, p, wi):
    """(radiance, pdf) for a ray from p along wi that meets the sphere about the disk; black where it misses it."""
    to_lamp = sub(_position(lamps, i), p)
    axis, distance = direction_and_length(to_lamp)
    cosine = dot(axis, wi)
    if cosine <= TINY:
        return BLACK, ZERO
    off = sub(scale(wi, distance / cosine), to_lamp)
    radius = lamps[i, SIZE]
    if dot(off, off) > radius * radius:
        return BLACK, ZERO
    return _disk_radiance(spot, lamps, i, wi), uniform_cone_pdf(_disk_cap(radius, distance))


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
def inside_lamp(lamps, i, p):
    """Whether p lies inside the sphere of the lamp, or on it: rays from there only meet it where they leave it."""
    off = sub(_position(lamps, i), p)
    return dot(off, off) <= lamps[i, SIZE] * lamps[i, SIZE]


@device
def _disk_radiance(spot, lamps, i, wi):
    radiance = _radiance(lamps, i)
    return scale(radiance, spot_falloff(lamps, i, negate(wi))) if spot else radiance
