"""The thin lens: rays start all over the aperture and meet the unbent ray on the plane of focus."""

from __future__ import annotations

from ..geom.vec import ONE, ZERO, add, add_scaled
from ..jit import device
from ..sampler.warp import concentric_disk, regular_polygon
from .layout import BLADE_ROTATION, BLADES, FOCUS, LENS_X, LENS_Y


@device
def through_lens(camera, origin, direction, u1, u2):
    """(origin, direction) of the ray through a random point of the lens; lengths along the axis stay one unit."""
    if camera[BLADES] > ZERO:
        a, b = regular_polygon(camera[BLADES], camera[BLADE_ROTATION], u1, u2)
    else:
        a, b = concentric_disk(u1, u2)
    offset = (
        a * camera[LENS_X] + b * camera[LENS_Y],
        a * camera[LENS_X + 1] + b * camera[LENS_Y + 1],
        a * camera[LENS_X + 2] + b * camera[LENS_Y + 2],
    )
    # focus point - lens point, divided by the focus distance
    return add(origin, offset), add_scaled(direction, offset, -ONE / camera[FOCUS])
