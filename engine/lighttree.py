"""Builds the light tree: clusters of emitters, split so that each is small, of one direction and of little power.

Called once per scene by `engine/pack`; walked by `engine/kernels/light/tree.py`, whose words it fills. A cluster's
bounds are exact: its cone is about the mean of its emitters' axes and reaches the widest of them. Compiled, since
100,000 emitters take 0.1 s so; scenes with one emitter or none never compile it.
"""

from __future__ import annotations

import math

import numpy as np

from .kernels.jit import device, kernel
from .kernels.light import tree as words
from .kernels.light.tree import LightTree

BUCKETS = 12
# Deeper than this, clusters are halved by count, so that a path of 64 turns reaches 16 million emitters.
DEPTH_OF_HALVING = 40
STACK_ROWS = 128
START, END, ROW, DEPTH, PATH = 0, 1, 2, 3, 4

# Sums kept for a bucket or a side: bounds, sum of axes, largest theta_o and theta_e, power, count.
LOW, HIGH, AXIS_SUM, WIDEST_O, WIDEST_E, POWER_SUM, COUNT, SIDES, SUMS = 0, 3, 6, 9, 10, 11, 12, 13, 14

# Widens bounds when they are rounded to float32.
ROUNDING = 1 + 1e-6


def build_light_tree(
    bounds: np.ndarray,
    axis: np.ndarray,
    theta_o: np.ndarray,
    theta_e: np.ndarray,
    power: np.ndarray,
    two_sided: np.ndarray | None = None,
) -> LightTree:
    """A tree whose leaves hold one emitter each.

    bounds     (E, 6) lowest and highest x, y, z, metres, world space
    axis       (E, 3) unit, the middle of the directions it faces; any where theta_o is pi
    theta_o    (E,) radians: its normals lie within this angle of the axis; pi: it faces all ways
    theta_e    (E,) radians: it emits within this angle of each of its normals
    power      (E,) any unit, not negative; an emitter of power 0 is never chosen
    two_sided  (E,) bool: it also emits about -axis, as flat mesh emitters do (axis its normal, theta_o 0); None: none
    """
    count = len(power)
    nodes = np.zeros((max(2 * count - 1, 1), words.NODE_WORDS), np.float32)
    paths = np.zeros(count, np.uint64)
    integers = nodes.view(np.int32)
    if count == 0:
        integers[0, words.CHILD] = -1
        return LightTree(nodes, integers, _halves(paths))
    emitters = np.ones((count, SUMS))
    emitters[:, LOW:AXIS_SUM] = bounds
    emitters[:, AXIS_SUM:WIDEST_O] = axis
    emitters[:, WIDEST_O], emitters[:, WIDEST_E], emitters[:, POWER_SUM] = theta_o, theta_e, power
    if two_sided is not None:
        emitters[:, SIDES] = np.where(two_sided, 1, -1)
    else:
        emitters[:, SIDES] = -1
    stack = np.zeros((STACK_ROWS, 5), np.int64)
    build_nodes(emitters, np.arange(count), stack, np.zeros((3, BUCKETS + 1, SUMS)), nodes, integers, paths)
    return LightTree(nodes, integers, _halves(paths))


def _halves(paths: np.ndarray) -> np.ndarray:
    """(E,) uint64 as (E, 2) uint32, the lower half first on any machine."""
    return np.stack([paths & np.uint64(0xFFFFFFFF), paths >> np.uint64(32)], axis=1).astype(np.uint32)


def load_builder() -> None:
    """Have the builder ready: compiled, or read from the disk cache."""
    if not build_nodes.signatures:
        two = np.zeros((2, 6))
        build_light_tree(two, two[:, :3], two[:, 0], two[:, 0], np.ones(2))


@kernel
def build_nodes(emitters, order, stack, scratch, nodes, integers, paths):
    """Fills `nodes` and `paths`. order: the emitter of each row of `emitters`; both are changed so that clusters lie
    side by side: rows that are read one after the other come from memory in half the time."""
    used, top = 1, 0
    stack[0, START], stack[0, END], stack[0, ROW], stack[0, DEPTH], stack[0, PATH] = 0, len(order), 0, 0, 0
    while top >= 0:
        start, end, row, depth, path = (
            stack[top, START],
            stack[top, END],
            stack[top, ROW],
            stack[top, DEPTH],
            stack[top, PATH],
        )
        top -= 1
        total = scratch[0, BUCKETS]
        _sum_up(emitters, start, end, total)
        _write_node(emitters, start, end, total, nodes[row])
        if end - start == 1:
            integers[row, words.CHILD] = -1 - order[start]
            paths[order[start]] = np.uint64(path)
            continue
        middle = _split(emitters, order, start, end, depth, scratch)
        integers[row, words.CHILD] = used
        for side in range(2):
            top += 1
            stack[top, START] = start if side == 0 else middle
            stack[top, END] = middle if side == 0 else end
            stack[top, ROW] = used + side
            stack[top, DEPTH] = depth + 1
            stack[top, PATH] = path | (side << depth)
        used += 2


@device
def _clear(sums):
    for i in range(SUMS):
        sums[i] = 0.0
    for i in range(3):
        sums[LOW + i], sums[HIGH + i] = math.inf, -math.inf


@device
def _add(sums, other):
    """Merge `other`, the sums of a cluster or of one emitter, into `sums`."""
    along = 0.0
    for i in range(3):
        along += sums[AXIS_SUM + i] * other[AXIS_SUM + i]
    # Axes of two-sided emitters have no sign. SIDES: 1 two-sided, -1 one-sided, 0 both, so of no use as a cone.
    sign = -1.0 if along < 0 and other[SIDES] > 0 else 1.0
    sums[SIDES] = other[SIDES] if sums[COUNT] == 0 or sums[SIDES] == other[SIDES] else 0.0
    for i in range(3):
        sums[AXIS_SUM + i] += sign * other[AXIS_SUM + i]
    for i in range(3):
        sums[LOW + i] = min(sums[LOW + i], other[LOW + i])
        sums[HIGH + i] = max(sums[HIGH + i], other[HIGH + i])
    sums[WIDEST_O] = max(sums[WIDEST_O], other[WIDEST_O])
    sums[WIDEST_E] = max(sums[WIDEST_E], other[WIDEST_E])
    sums[POWER_SUM] += other[POWER_SUM]
    sums[COUNT] += other[COUNT]


@device
def _sum_up(emitters, start, end, sums):
    _clear(sums)
    for i in range(start, end):
        _add(sums, emitters[i])


@device
def _angle(x, y, z, emitter, sides):
    cosine = x * emitter[AXIS_SUM] + y * emitter[AXIS_SUM + 1] + z * emitter[AXIS_SUM + 2]
    if sides > 0:
        cosine = abs(cosine)
    return math.acos(min(max(cosine, -1.0), 1.0))


@device
def _write_node(emitters, start, end, sums, node):
    """The words of a node, all but its child, from the sums of its emitters."""
    for i in range(3):
        center = np.float32(0.5 * (sums[LOW + i] + sums[HIGH + i]))
        half = max(sums[HIGH + i] - center, center - sums[LOW + i]) * ROUNDING
        node[words.CENTER + i], node[words.HALF_SIZE + i] = center, half
    node[words.POWER] = sums[POWER_SUM]
    node[words.TWO_SIDED] = sums[SIDES] > 0
    x, y, z = sums[AXIS_SUM], sums[AXIS_SUM + 1], sums[AXIS_SUM + 2]
    length = math.sqrt(x * x + y * y + z * z)
    theta_o, reach = math.pi, math.pi
    if sums[WIDEST_O] < math.pi - 1e-4 and sums[SIDES] != 0 and length > 1e-6 * sums[COUNT]:
        x, y, z = x / length, y / length, z / length
        theta_o, reach = 0.0, 0.0
        for i in range(start, end):
            emitter = emitters[i]
            widest = _angle(x, y, z, emitter, sums[SIDES]) + emitter[WIDEST_O]
            theta_o, reach = max(theta_o, widest), max(reach, widest + emitter[WIDEST_E])
        theta_o, reach = min(theta_o, math.pi), min(reach, math.pi)
        node[words.AXIS], node[words.AXIS + 1], node[words.AXIS + 2] = x, y, z
    node[words.COS_O], node[words.SIN_O], node[words.COS_TOTAL] = math.cos(theta_o), math.sin(theta_o), math.cos(reach)


@device
def _cost(sums):
    """Power x size^2 x solid angle of the directions it lights: the measure of Conty & Kulla 2018, section 4.1, with
    the squared diagonal for the area, which also tells points in a line apart."""
    diagonal_squared = 0.0
    for i in range(3):
        extent = sums[HIGH + i] - sums[LOW + i]
        diagonal_squared += extent * extent
    theta_o = sums[WIDEST_O]
    if theta_o >= math.pi:
        return sums[POWER_SUM] * diagonal_squared * 4 * math.pi
    if sums[COUNT] > 1:
        x, y, z = sums[AXIS_SUM], sums[AXIS_SUM + 1], sums[AXIS_SUM + 2]
        # The spread of the axes from the length of their mean: the exact cone would take another pass.
        theta_o += math.acos(min(math.sqrt(x * x + y * y + z * z) / sums[COUNT], 1.0))
    theta_o = min(theta_o, math.pi)
    theta_w = min(theta_o + sums[WIDEST_E], math.pi)
    sine, cosine = math.sin(theta_o), math.cos(theta_o)
    solid_angle = 2 * math.pi * (1 - cosine) + math.pi / 2 * (
        2 * theta_w * sine - math.cos(theta_o - 2 * theta_w) - 2 * theta_o * sine + cosine
    )
    return sums[POWER_SUM] * diagonal_squared * solid_angle


@device
def _center(emitter, axis):
    return 0.5 * (emitter[LOW + axis] + emitter[HIGH + axis])


@device
def _bucket(emitter, axis, low, scale):
    return min(max(int((_center(emitter, axis) - low) * scale), 0), BUCKETS - 1)


@device
def _split(emitters, order, start, end, depth, scratch):
    """Reorders a cluster so that [start, middle) and [middle, end) are its children. Returns the middle."""
    if end - start == 2:
        return start + 1
    best_cost, best_axis, best_bucket, best_low, best_scale = math.inf, -1, 0, 0.0, 0.0
    lows, highs = _center_ranges(emitters, start, end)
    widest = max(highs[0] - lows[0], highs[1] - lows[1], highs[2] - lows[2])
    for axis in range(3):
        low, high = lows[axis], highs[axis]
        if depth >= DEPTH_OF_HALVING or not high > low:
            continue
        scale = BUCKETS / (high - low)
        if not scale < math.inf:
            continue
        _fill_buckets(emitters, start, end, axis, low, scale, scratch)
        cost, bucket = _best_plane(scratch)
        cost *= widest / (high - low)  # thin sides are worse
        if cost < best_cost:
            best_cost, best_axis, best_bucket, best_low, best_scale = cost, axis, bucket, low, scale
    if best_axis < 0:
        return (start + end) // 2
    return _partition(emitters, order, start, end, best_axis, best_bucket, best_low, best_scale)


@device
def _center_ranges(emitters, start, end):
    """The lowest and the highest x, y, z of the emitters' middles."""
    x, y, z = _center(emitters[start], 0), _center(emitters[start], 1), _center(emitters[start], 2)
    low_x, low_y, low_z, high_x, high_y, high_z = x, y, z, x, y, z
    for i in range(start + 1, end):
        x, y, z = _center(emitters[i], 0), _center(emitters[i], 1), _center(emitters[i], 2)
        low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
        high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
    return (low_x, low_y, low_z), (high_x, high_y, high_z)


@device
def _fill_buckets(emitters, start, end, axis, low, scale, scratch):
    for i in range(BUCKETS):
        _clear(scratch[0, i])
    for i in range(start, end):
        emitter = emitters[i]
        _add(scratch[0, _bucket(emitter, axis, low, scale)], emitter)


@device
def _best_plane(scratch):
    """(cost, first bucket of the right side) of the cheapest plane between buckets. Rows 1 and 2 of the scratch hold
    the sums of the left and right sides."""
    _clear(scratch[2, BUCKETS])
    for i in range(BUCKETS - 1, 0, -1):
        if scratch[0, i, COUNT] > 0:
            _add(scratch[2, BUCKETS], scratch[0, i])
        for word in range(SUMS):
            scratch[2, i, word] = scratch[2, BUCKETS, word]
    left = scratch[1, BUCKETS]
    _clear(left)
    best, bucket = math.inf, 1
    for i in range(1, BUCKETS):
        if scratch[0, i - 1, COUNT] == 0:  # the plane before cut the same way
            continue
        _add(left, scratch[0, i - 1])
        if scratch[2, i, COUNT] > 0:
            cost = _cost(left) + _cost(scratch[2, i])
            if cost < best:
                best, bucket = cost, i
    return best, bucket


@device
def _partition(emitters, order, start, end, axis, bucket, low, scale):
    i, j = start, end - 1
    while i <= j:
        if _bucket(emitters[i], axis, low, scale) < bucket:
            i += 1
        else:
            order[i], order[j] = order[j], order[i]
            for word in range(SUMS):
                emitters[i, word], emitters[j, word] = emitters[j, word], emitters[i, word]
            j -= 1
    return i
