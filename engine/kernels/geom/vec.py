"""The numbers that all kernels share, and arithmetic on 3-tuples of float32, which is what vectors and colours are.

A component is one number, or sixteen of as many paths (`simd`).

Results stay float32 as long as the arguments are: no literal here is a Python float.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import device
from ..simd import select

ZERO = np.float32(0)
ONE = np.float32(1)
TWO = np.float32(2)
THREE = np.float32(3)
HALF = np.float32(0.5)
THIRD = np.float32(1 / 3)
PI = np.float32(math.pi)
HALF_PI = np.float32(math.pi / 2)
QUARTER_PI = np.float32(math.pi / 4)
TWO_PI = np.float32(2 * math.pi)
INV_PI = np.float32(1 / math.pi)
INV_TWO_PI = np.float32(0.5 / math.pi)
TINY = np.float32(1e-37)  # a little above the smallest normal float32
SMALL, LARGE = np.float32(1e-30), np.float32(1e30)  # keep a quotient finite, and a sum of importances
LAST_BELOW_ONE = np.float32(1 - 2**-24)
FAR = np.float32(np.inf)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear RGB, Rec. 709
RED, GREEN, BLUE = LUMINANCE.astype(np.float32)
BLACK = (ZERO, ZERO, ZERO)
UP = (ZERO, ZERO, ONE)


@device
def add(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@device
def sub(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@device
def mul(a, b):
    """Product of each component, for colours."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@device
def scale(a, s):
    return a[0] * s, a[1] * s, a[2] * s


@device
def add_scaled(a, b, s):
    """a + b s, for example the point at distance s along a ray."""
    return a[0] + b[0] * s, a[1] + b[1] * s, a[2] + b[2] * s


@device
def negate(a):
    return -a[0], -a[1], -a[2]


@device
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device
def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@device
def length(a):
    return math.sqrt(dot(a, a))


@device
def normalize(a):
    """Unit vector along a; zero (not NaN) for a vector whose squared length is below the smallest normal float."""
    squared = dot(a, a)
    return scale(a, select(squared > TINY, ONE / math.sqrt(squared), ZERO))


@device
def direction_and_length(a):
    """(unit vector along a, length of a), with one square root; both zero for a vector too short to have one."""
    squared = dot(a, a)
    distance = math.sqrt(squared)
    return scale(a, select(squared > TINY, ONE / distance, ZERO)), distance


@device
def reflect(w, n):
    """Mirror direction of w about n, both leaving the surface."""
    d = dot(w, n)
    s = d + d
    return n[0] * s - w[0], n[1] * s - w[1], n[2] * s - w[2]


@device
def average(color):
    return (color[0] + color[1] + color[2]) * THIRD


@device
def max_component(color):
    return max(color[0], max(color[1], color[2]))


@device
def is_black(color):
    return (color[0] == ZERO) & (color[1] == ZERO) & (color[2] == ZERO)


@device
def share_of(part, whole):
    """A colour's share in another, 0 of what is black."""
    return (
        select(whole[0] > ZERO, min(part[0] / whole[0], ONE), ZERO),
        select(whole[1] > ZERO, min(part[1] / whole[1], ONE), ZERO),
        select(whole[2] > ZERO, min(part[2] / whole[2], ONE), ZERO),
    )
