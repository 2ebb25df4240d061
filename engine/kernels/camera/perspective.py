"""The perspective camera: all rays start at one point."""

from __future__ import annotations

from ..jit import device
from .layout import CORNER, ORIGIN, PIXEL_X, PIXEL_Y


@device
def perspective_ray(camera, x, y):
    """(origin, direction of unit length along the axis)."""
    direction = (
        camera[CORNER] + x * camera[PIXEL_X] + y * camera[PIXEL_Y],
        camera[CORNER + 1] + x * camera[PIXEL_X + 1] + y * camera[PIXEL_Y + 1],
        camera[CORNER + 2] + x * camera[PIXEL_X + 2] + y * camera[PIXEL_Y + 2],
    )
    return (camera[ORIGIN], camera[ORIGIN + 1], camera[ORIGIN + 2]), direction
