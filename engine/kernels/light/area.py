"""Area lamps: rectangles and ellipses that shine from one side, with an optional spread.

A spread below 180 degrees dims with the angle off the axis like a soft box with a grid; far off the axis only the
part of the lamp below the shading point is seen, so rectangles are sampled only where they can be seen.

A shear leaves a parallelogram, or an ellipse whose given radii are not its own axes: both are the exact image.
"""

from __future__ import annotations

from ..geom.vec import BLACK, ONE, TINY, TWO, ZERO, add_scaled, direction_and_length, dot, length, scale, sub
from ..jit import device
from ..sampler.warp import concentric_disk
from ..simd import any_of, at, select
from ..tables import AREA, AXIS, AXIS_X, AXIS_Y, POSITION, RADIANCE, SHAPE_STEP, SIZE, SPREAD_NORM, TAN_SPREAD, TO_LOCAL
from .spherical import rectangle_pdf, sample_rectangle


@device
def _vector(lamps, i, word):
    return at(lamps, i, word), at(lamps, i, word + 1), at(lamps, i, word + 2)


@device
def _lamp_radiance(lamps, i, wi):
    """Radiance towards the point that sees the lamp along wi, spread included; black from behind."""
    cosine = -dot(wi, _vector(lamps, i, AXIS))
    radiance = _vector(lamps, i, RADIANCE)
    tan_spread = at(lamps, i, TAN_SPREAD)
    spreads = tan_spread > ZERO
    if any_of(spreads):
        sine = length(add_scaled(wi, _vector(lamps, i, AXIS), cosine))
        factor = max(tan_spread - sine / max(cosine, TINY), ZERO) * at(lamps, i, SPREAD_NORM)
        radiance = select(spreads, scale(radiance, factor), radiance)
    return select(cosine <= ZERO, BLACK, radiance)


@device
def _visible_part(lamps, i, p):
    """The part of the rectangle within the cone of the spread, as (corner, edge x, edge y, height): the height of p
    above the lamp's plane; 0 or less means nothing is seen."""
    center = _vector(lamps, i, POSITION)
    half_x, half_y = at(lamps, i, SIZE), at(lamps, i, SIZE + 1)
    to_p = sub(p, center)
    height = dot(to_p, _vector(lamps, i, AXIS))
    low_x, high_x, low_y, high_y = -ONE, ONE, -ONE, ONE
    spreads = at(lamps, i, TAN_SPREAD) > ZERO
    if any_of(spreads):
        reach = height * at(lamps, i, TAN_SPREAD)
        to_x, to_y = _vector(lamps, i, TO_LOCAL), _vector(lamps, i, TO_LOCAL + 3)
        x, y = dot(to_p, to_x), dot(to_p, to_y)
        reach_x, reach_y = reach * length(to_x), reach * length(to_y)
        low_x, high_x = select(spreads, max(-ONE, x - reach_x), -ONE), select(spreads, min(ONE, x + reach_x), ONE)
        low_y, high_y = select(spreads, max(-ONE, y - reach_y), -ONE), select(spreads, min(ONE, y + reach_y), ONE)
        height = select((low_x >= high_x) | (low_y >= high_y), ZERO, height)
    half_edge_x, half_edge_y = scale(_vector(lamps, i, AXIS_X), half_x), scale(_vector(lamps, i, AXIS_Y), half_y)
    corner = add_scaled(add_scaled(center, half_edge_x, low_x), half_edge_y, low_y)
    return corner, scale(half_edge_x, high_x - low_x), scale(half_edge_y, high_y - low_y), height


@device
def before_shape(lamps, i, p):
    """Whether p is well before the shape by which rays meet the lamp, on the side that it shines to."""
    return dot(sub(p, _vector(lamps, i, POSITION)), _vector(lamps, i, AXIS)) > TWO * at(lamps, i, SHAPE_STEP)


@device
def area_lamp_distance(lamps, i, p, wi):
    """How far from p along wi the shape is by which rays meet the lamp; negative where they miss it."""
    axis = _vector(lamps, i, AXIS)
    to_lamp = sub(_vector(lamps, i, POSITION), p)
    cosine = dot(wi, axis)
    t = (dot(to_lamp, axis) + at(lamps, i, SHAPE_STEP)) / select(abs(cosine) > TINY, cosine, TINY)
    off = sub(scale(wi, t), to_lamp)
    x, y = dot(off, _vector(lamps, i, TO_LOCAL)), dot(off, _vector(lamps, i, TO_LOCAL + 3))
    return select((abs(x) <= ONE) & (abs(y) <= ONE), t, -ONE)


@device
def sample_rectangle_lamp(lamps, i, p, u1, u2):
    """(wi, t, radiance, pdf), uniform in the solid angle of what p can see."""
    corner, edge_x, edge_y, height = _visible_part(lamps, i, p)
    behind = height <= ZERO
    wi, t, pdf = sample_rectangle(p, corner, edge_x, edge_y, u1, u2)
    return wi, t, select(behind, BLACK, _lamp_radiance(lamps, i, wi)), select(behind, ZERO, pdf)


@device
def rectangle_lamp_seen(lamps, i, p, wi, t):
    """(radiance, pdf) for a ray from p that meets the rectangle at distance t."""
    corner, edge_x, edge_y, height = _visible_part(lamps, i, p)
    behind, pdf = height <= ZERO, rectangle_pdf(p, corner, edge_x, edge_y, wi, t)
    return select(behind, BLACK, _lamp_radiance(lamps, i, wi)), select(behind, ZERO, pdf)


@device
def sample_ellipse_lamp(lamps, i, p, u1, u2):
    """(wi, t, radiance, pdf), uniform in area."""
    x, y = concentric_disk(u1, u2)
    half_x, half_y = at(lamps, i, SIZE), at(lamps, i, SIZE + 1)
    point = add_scaled(_vector(lamps, i, POSITION), _vector(lamps, i, AXIS_X), x * half_x)
    point = add_scaled(point, _vector(lamps, i, AXIS_Y), y * half_y)
    wi, t = direction_and_length(sub(point, p))
    return wi, t, _lamp_radiance(lamps, i, wi), _ellipse_pdf(lamps, i, wi, t)


@device
def ellipse_lamp_seen(lamps, i, p, wi, t):
    """(radiance, pdf) for a ray that meets the ellipse's rectangle at t; black in the corners."""
    off = sub(add_scaled(p, wi, t), _vector(lamps, i, POSITION))
    x, y = dot(off, _vector(lamps, i, TO_LOCAL)), dot(off, _vector(lamps, i, TO_LOCAL + 3))
    corner, pdf = x * x + y * y > ONE, _ellipse_pdf(lamps, i, wi, t)
    return select(corner, BLACK, _lamp_radiance(lamps, i, wi)), select(corner, ZERO, pdf)


@device
def _ellipse_pdf(lamps, i, wi, t):
    cosine = -dot(wi, _vector(lamps, i, AXIS))
    area = at(lamps, i, AREA)
    return select(area * cosine > TINY, t * t / (area * cosine), ZERO)
