"""The choice of one emitter of many, by an estimate of what each sends to a point.

A binary tree of clusters of emitters, after Conty Estevez & Kulla 2018, "Importance Sampling of Many Lights with
Adaptive Tree Splitting". `engine.lighttree` builds it; the path kernel walks it down, each time to one of two
children with a probability proportional to their importance. `tree_probability` walks to a given emitter by the bits
stored for it, so both give the same probability.

The receiver's normal n is the one whose cosine multiplies the light (the shading normal), and only emitters above
its horizon count: surfaces reflect, they don't transmit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..geom.vec import HALF, LARGE, LAST_BELOW_ONE, ONE, SMALL, ZERO, dot
from ..jit import device
from ..simd import any_of, at, bits_of, int32, no, select, words_at

# Words of a node, one cache line. COS_TOTAL: of theta_o + theta_e. CHILD is an integer: the row of the left child, with
# the right one behind it, or -1 - emitter. TWO_SIDED: the axis has no sign.
CENTER, HALF_SIZE, POWER, AXIS, COS_O, SIN_O, COS_TOTAL, CHILD, TWO_SIDED, NODE_WORDS = (
    0,
    3,
    6,
    7,
    10,
    11,
    12,
    13,
    14,
    16,
)

ROOT, FIRST_EMITTER = np.int32(0), np.int32(-1)
# Rounding may put an emitter that touches its bounds beyond them: cones are widened by this, as a cosine.
SLACK = np.float32(1e-5)

# A cluster is taken for a ball of sqrt(SOFTNESS) times its bounding radius, and a cosine in it for the mean of its
# bounds, at least LEAST_COSINE times the sine of the angle that the ball covers. Chosen for the least second moment of
# one sample over scenes of random triangles, quads and spheres: far less than with Conty & Kulla's upper bounds where
# there are thousands, and in none more.
SOFTNESS = np.float32(0.15)
LEAST_COSINE = np.float32(0.2)


class LightTree(NamedTuple):
    """nodes     (N, 16) float32, the root is row 0; without emitters a single row of power 0
    integers  (N, 16) int32, the same memory
    paths     (E, 2) uint32, of each emitter: the turns from the root, lowest bit first, 1 is right
    """

    nodes: np.ndarray
    integers: np.ndarray
    paths: np.ndarray


@device
def mean_cosine(cosine, cos_w, sin_w):
    """Mean of the largest and the smallest cosine, none below 0, within the angle w of a direction with `cosine`."""
    sine = math.sqrt(max(ONE - cosine * cosine, ZERO))
    wide = sin_w < ZERO
    largest = select((cosine >= cos_w) | wide, ONE, cosine * cos_w + sine * sin_w)
    smallest = select((cosine <= -cos_w) | wide, ZERO, cosine * cos_w - sine * sin_w)
    return HALF * (max(largest, ZERO) + max(smallest, ZERO))


@device
def _faces_away(total, cosine, radius_squared, distance_squared):
    """Whether p is out of the cone of every emitter in a one-sided cluster with this COS_TOTAL."""
    sine_squared = radius_squared / distance_squared
    cos_u = math.sqrt(max(ONE - sine_squared, ZERO))
    in_reach = (total <= -ONE) | (distance_squared <= radius_squared) | (cosine >= cos_u)
    largest = cosine * cos_u + math.sqrt(max(ONE - cosine * cosine, ZERO) * sine_squared)
    return no(in_reach) & (largest < total - SLACK)


@device
def _row(tree, k):
    """The words of a node, or of one for each lane."""
    return words_at(tree.nodes, k * np.int32(NODE_WORDS), NODE_WORDS)


@device
def _importance(node, p, n):
    """An estimate, up to a common factor, of what a cluster, its row `node`, sends to p; 0 only where nothing can
    arrive."""
    to = node[CENTER] - p[0], node[CENTER + 1] - p[1], node[CENTER + 2] - p[2]
    half = node[HALF_SIZE], node[HALF_SIZE + 1], node[HALF_SIZE + 2]
    height = dot(n, to)
    above = height + abs(n[0]) * half[0] + abs(n[1]) * half[1] + abs(n[2]) * half[2] > ZERO
    importance = ZERO
    if any_of(above):
        importance = select(above, _importance_above(node, to, half, height), ZERO)
    return importance


@device
def _importance_above(node, to, half, height):
    """The same for a cluster at `to` from p and at this height above the horizon."""
    distance_squared, radius_squared = min(dot(to, to), LARGE), min(dot(half, half), LARGE)
    inverse = ONE / math.sqrt(distance_squared + SMALL)
    blur_squared = SOFTNESS * radius_squared
    soft_inverse = ONE / math.sqrt(distance_squared + blur_squared + SMALL)
    cos_u, sin_u = distance_squared * inverse * soft_inverse, math.sqrt(blur_squared) * soft_inverse
    least = LEAST_COSINE * sin_u
    importance = node[POWER] * soft_inverse * soft_inverse
    importance *= max(mean_cosine(height * inverse, cos_u, sin_u), least)
    cos_o, sin_o, two_sided = node[COS_O], node[SIN_O], node[TWO_SIDED] > ZERO
    oriented = cos_o > -ONE
    if any_of(oriented):
        cosine = -(node[AXIS] * to[0] + node[AXIS + 1] * to[1] + node[AXIS + 2] * to[2]) * inverse
        one_sided = oriented & no(two_sided)
        if any_of(one_sided):
            away = one_sided & _faces_away(node[COS_TOTAL], cosine, radius_squared, distance_squared)
            importance = select(away, ZERO, importance)
        cosine = select(two_sided, abs(cosine), cosine)
        cos_w, sin_w = cos_u * cos_o - sin_u * sin_o, sin_u * cos_o + cos_u * sin_o
        importance *= select(oriented, max(mean_cosine(cosine, cos_w, sin_w), least), ONE)
    return importance


@device
def tree_importance(tree, p, n):
    """An estimate of the irradiance at p, as luminance, if the emitters' power is luminance x area; 0 only where
    nothing can arrive."""
    child = tree.integers[0, CHILD]
    if child < 0:
        return _importance(_row(tree, ROOT), p, n)
    return _importance(_row(tree, child), p, n) + _importance(_row(tree, np.int32(child + 1)), p, n)


@device
def _children(tree, k, p, n):
    """(CHILD, importance) of the cluster in row k, and the same of the one behind it."""
    left, right = _row(tree, k), _row(tree, int32(k + np.int32(1)))
    left_child, right_child = bits_of(left[CHILD]), bits_of(right[CHILD])
    return left_child, _importance(left, p, n), right_child, _importance(right, p, n)


@device
def sample_tree(tree, p, n, u):
    """(emitter, probability, u_rest) as seen from p with normal n; u and u_rest in [0, 1).

    u_rest can be used again: it is u stretched from the emitter's interval, which leaves it log2(1 / probability)
    bits shorter. probability == 0: no emitter can light p, and emitter is 0.
    """
    probability, child = ONE, tree.integers[0, CHILD]
    if child < 0:
        probability = select(_importance(_row(tree, ROOT), p, n) > ZERO, ONE, ZERO)
    descends = child >= np.int32(0)
    while any_of(descends):
        k = select(descends, child, np.int32(0))  # where others have arrived already, any node will do
        left_child, left, right_child, right = _children(tree, k, p, n)
        total = left + right
        lit, share_of_left = total > ZERO, left / total
        to_left = u < share_of_left
        share = select(to_left, share_of_left, ONE - share_of_left)
        rest = select(to_left, u, u - share_of_left) / share
        u = select(descends & lit, min(rest, LAST_BELOW_ONE), u)
        probability = select(descends, select(lit, probability * share, ZERO), probability)
        chosen = select(lit, select(to_left, left_child, right_child), FIRST_EMITTER)
        child = select(descends, chosen, child)
        descends = child >= np.int32(0)
    return int32(np.int32(-1) - child), probability, u


@device
def tree_probability(tree, emitter, p, n):
    """The probability with which `sample_tree` chooses `emitter` at p with normal n."""
    probability, child, depth = ONE, tree.integers[0, CHILD], 0
    if child < 0:
        probability = select(_importance(_row(tree, ROOT), p, n) > ZERO, ONE, ZERO)
    descends = child >= np.int32(0)
    while any_of(descends):
        k = select(descends, child, np.int32(0))
        left_child, left, right_child, right = _children(tree, k, p, n)
        total = left + right
        turns = at(tree.paths, emitter, depth >> 5) >> np.uint32(depth & 31)
        to_left = (turns & np.uint32(1)) == np.uint32(0)
        # Not right / total: two quotients may become one reciprocal, which of the smallest totals is infinite.
        share = select(total > ZERO, select(to_left, left / total, ONE - left / total), ZERO)
        probability = select(descends, probability * share, probability)
        child = select(descends, select(to_left, left_child, right_child), child)
        descends, depth = child >= np.int32(0), depth + 1
    return probability
