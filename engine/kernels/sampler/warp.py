"""Shapes that uniform numbers are warped to. Directions have z along the axis; their density per steradian follows."""

from __future__ import annotations

import math

import numpy as np

from ..geom.elementary import sin_cos_acute, sin_cos_turn
from ..geom.vec import INV_PI, INV_TWO_PI, ONE, QUARTER_PI, TINY, TWO, UP, ZERO
from ..jit import device
from ..simd import any_of, floor, int32, no, select
from .random import random_1d


@device
def concentric_disk(u1, u2):
    """Uniform in the unit disk, keeping neighbours together (Shirley & Chiu 1997)."""
    a = TWO * u1 - ONE
    b = TWO * u2 - ONE
    wide = abs(a) > abs(b)
    radius = select(wide, a, b)
    other = select(wide, b, a)
    ratio = select(radius != ZERO, other / radius, ZERO)
    s, c = sin_cos_acute(QUARTER_PI * ratio)
    return radius * select(wide, c, s), radius * select(wide, s, c)


@device
def cosine_hemisphere(u1, u2):
    """Malley's method: the disk, lifted onto the hemisphere."""
    x, y = concentric_disk(u1, u2)
    return x, y, math.sqrt(max(ONE - x * x - y * y, ZERO))


@device
def cosine_hemisphere_pdf(cos_theta):
    return max(cos_theta, ZERO) * INV_PI


@device
def uniform_cone(u1, u2, one_minus_cos):
    """Uniform in solid angle, within a half-angle of at most pi that is given by 1 - cos. Digits are kept in the
    narrowest of cones. By the equal-area map from the disk: 1 - z = r^2 (1 - cos)."""
    x, y = concentric_disk(u1, u2)
    drop = (x * x + y * y) * one_minus_cos
    stretch = math.sqrt(max(one_minus_cos * (TWO - drop), ZERO))
    return x * stretch, y * stretch, ONE - drop


@device
def uniform_cone_pdf(one_minus_cos):
    """Inside the cone."""
    return INV_TWO_PI / one_minus_cos


@device
def uniform_hemisphere(u1, u2):
    """Uniform in solid angle."""
    x, y, z = uniform_cone(u1, u2, ONE)
    return x, y, max(z, ZERO)


@device
def uniform_hemisphere_pdf(cos_theta):
    return select(cos_theta >= ZERO, INV_TWO_PI, ZERO)


@device
def rejection_hemisphere(state):
    """(direction, new state, draws): points of the cube until one lies in the upper half ball, 12 / pi on average.

    A draw is a point of three numbers. Uniform in solid angle, as `uniform_hemisphere`.
    """
    direction, draws, searches = UP, np.int32(0), state == state
    while any_of(searches):
        u, after = random_1d(state)
        v, after = random_1d(after)
        w, after = random_1d(after)
        state, draws = select(searches, after, state), int32(draws + select(searches, np.int32(1), np.int32(0)))
        x = TWO * u - ONE
        y = TWO * v - ONE
        z = TWO * w - ONE
        squared = x * x + y * y + z * z
        found = searches & (z > ZERO) & (squared <= ONE) & (squared > TINY)
        s = ONE / math.sqrt(max(squared, TINY))
        direction, searches = select(found, (x * s, y * s, z * s), direction), searches & no(found)
    return direction, state, draws


@device
def regular_polygon(blades, rotation, u1, u2):
    """Uniform in the regular polygon inscribed in the unit circle, with a corner at `rotation` radians.

    blades  float32, a whole number of at least 3
    """
    scaled = u1 * blades
    blade = floor(scaled)
    u = math.sqrt(scaled - blade)
    step, turned = ONE / blades, rotation * INV_TWO_PI
    # A point of the triangle (centre, corner k, corner k + 1): u its distance from the centre, u2 along the side.
    s0, c0 = sin_cos_turn(turned + step * blade)
    s1, c1 = sin_cos_turn(turned + step * (blade + ONE))
    return u * (c0 + (c1 - c0) * u2), u * (s0 + (s1 - s0) * u2)
