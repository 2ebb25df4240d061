"""Rays of the camera, and the array that a camera is packed into for the kernels.

Each projection gives an origin and a direction that is one unit long ALONG THE AXIS; the lens bends that pair, and
what is left, unit length and clipping, is the same for all. `orthographic` and `lens` are compile-time constants.
"""

from __future__ import annotations

from ..geom.vec import direction_and_length
from ..jit import device
from .layout import FAR, NEAR, pack_camera
from .orthographic import orthographic_ray
from .perspective import perspective_ray
from .thin_lens import through_lens

__all__ = ["generate_ray", "pack_camera"]


@device
def generate_ray(camera, orthographic, lens, x, y, u1, u2):
    """(origin, unit direction, t_near, t_far) in world space through a point of the picture.

    camera  the array of `pack_camera`
    x, y    pixels of the whole picture, from the left and from the bottom
    u1, u2  in [0, 1): the point of the lens, unused without one

    The clip planes are perpendicular to the axis, so t_near and t_far grow towards the corners of the picture. With
    a lens Cycles takes the pinhole ray's angle for both; here the planes stay planes.
    """
    if orthographic:
        origin, direction = orthographic_ray(camera, x, y)
    else:
        origin, direction = perspective_ray(camera, x, y)
    if lens:
        origin, direction = through_lens(camera, origin, direction, u1, u2)
    unit, stretch = direction_and_length(direction)
    return origin, unit, camera[NEAR] * stretch, camera[FAR] * stretch
