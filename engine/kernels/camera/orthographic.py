"""The orthographic camera: all rays are parallel."""

from __future__ import annotations

from ..jit import device
from .layout import CORNER, FORWARD, ORIGIN, PIXEL_X, PIXEL_Y


@device
def orthographic_ray(camera, x, y):
    """(origin, direction of unit length along the axis)."""
    origin = (
        camera[ORIGIN] + (camera[CORNER] + x * camera[PIXEL_X] + y * camera[PIXEL_Y]),
        camera[ORIGIN + 1] + (camera[CORNER + 1] + x * camera[PIXEL_X + 1] + y * camera[PIXEL_Y + 1]),
        camera[ORIGIN + 2] + (camera[CORNER + 2] + x * camera[PIXEL_X + 2] + y * camera[PIXEL_Y + 2]),
    )
    return origin, (camera[FORWARD], camera[FORWARD + 1], camera[FORWARD + 2])
