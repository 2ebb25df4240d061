"""From Embree's hit to a point of a surface: position, normals, material.

The position is rebuilt from the triangle's vertices and barycentrics, which is exact to a few ulps of the vertices
wherever the ray came from. Rays that leave start from `offset_origin`, off the surface by a bound on those ulps: as
Waechter & Binder do in "A Fast and Robust Method for Avoiding Self-Intersection" (Ray Tracing Gems 2019, ch. 6), but
for the triangle at hand (Pharr et al., Physically Based Rendering, 4th ed., 6.8.6). A bound that knows only the point
is too short on large triangles that pass near the world's origin, and so long far from it, or in scenes of a few
micrometres, that rays start behind the next wall. From a point nearer to an edge than rounding can tell they
start off that edge, too, or they would slip out between two walls.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..embree import GEOM_ID, INST_ID, INST_PRIM_ID, INVALID, PRIM_ID, U, V
from ..jit import device
from ..light.emitters import row_of_3, triangle_vertices
from ..simd import any_of, at, select, to_index, words_at
from ..tables import INSTANCED_MESH
from .vec import ONE, SMALL, TINY, ZERO, add, cross, direction_and_length, dot, negate, scale, sub

# Lengths of the step off a surface, as parts of what the error depends on (see `_step`); one rounding is 2^-24.
_STEP = np.float32(16 * 2**-24)
_SMALLEST_STEP = np.float32(2 * 2**-24)
_AT_THE_ORIGIN = np.float32(1e-25)
# Random slivers are met again from 1.5 roundings of what `_sizes` says of them down.
_TILT = np.float32(4 * 2**-24)
# Of the square root of a triangle's area: for the sake of its neighbours, reached at an aspect ratio of some 2,000;
# for its own, reached where all sides are 1e5 times as long as the triangle is high.
_LONGEST_FOR_NEIGHBOURS, _LONGEST_FOR_OWN = np.float32(1 / 128), np.float32(1)
# How far rays start from each edge of their triangle, as a part of its coordinates, and at most as a part of its height
# over that edge; and how far their starts are moved for it at most, in these distances: in the corners of slivers more
# would show.
_OFF_THE_EDGES, _FARTHEST_OFF, _LARGEST_MOVE = np.float32(16 * 2**-24), np.float32(1 / 256), np.float32(4)


class Hit(NamedTuple):
    """Where a ray met a surface.

    triangle  its row
    instance  row of the instance tables, -1 on a baked mesh
    u, v      barycentric
    """

    triangle: np.int64
    instance: np.int64
    u: np.float32
    v: np.float32


@device
def hit_of(f, geometry, ray, words):
    """The `Hit` that Embree has left in `ray` and `words`."""
    outer = words[INST_ID] if f.instances and words[INST_ID] != INVALID else words[GEOM_ID]
    triangle, instance = np.int64(geometry.base[outer]) + np.int64(words[PRIM_ID]), np.int64(-1)
    if f.instances and geometry.kind[outer] == INSTANCED_MESH:
        instance = np.int64(geometry.instance_base[outer]) + np.int64(words[INST_PRIM_ID])
    return Hit(triangle, instance, ray[U], ray[V])


@device
def find_surface(f, geometry, hit, wo):
    """A `Hit` as (p, n, ng, material, triangle, inside), n and ng on wo's side as the mesh has them to each other.

    n is a unit vector; ng is as long as the step that takes rays off the surface, see `offset_origin`. inside: p, or
    where it lies on an edge of its triangle a point beside it, a few roundings away; rays start over that.
    """
    triangle, u, v = hit.triangle, hit.u, hit.v
    a, b, c = triangle_vertices(geometry, triangle)
    ng = cross(sub(b, a), sub(c, a))
    n = _shading_normal(geometry, triangle, u, v, ng) if f.smooth else ng
    material, extent, sizes = at(geometry.triangle_slot, triangle), _extent(a, b, c), _sizes(a, b, c)
    if f.instances:
        placed, m = hit.instance >= np.int32(0), geometry.transforms
        row = to_index(select(placed, hit.instance, np.int32(0)))
        if any_of(placed):
            ng = select(placed, _to_world_normal(m, row, ng), ng)
            n = select(placed, _to_world_normal(m, row, n), n)
            extent, sizes = select(placed, _to_world_sizes(m, row, extent, sizes), (extent, sizes))
            slot = min(max(material, np.int32(0)), at(geometry.slot_count, row) - np.int32(1))
            slot = select(placed, at(geometry.slot_offset, row) + slot, np.int32(0))
            material = select(placed, at(geometry.slots, slot), material)
    ng, area = _unit_and_length(ng)
    p, inside = _interpolate(a, b, c, u, v), _interpolate(a, b, c, *_off_the_edges(u, v, extent, sizes[0], area))
    if f.instances and any_of(placed):
        p = select(placed, _to_world_point(m, row, p), p)
        inside = select(placed, _to_world_point(m, row, inside), inside)
    behind = dot(ng, wo) < ZERO
    ng, n = select(behind, negate(ng), ng), select(behind, negate(n), n)
    if f.smooth:
        n = _unit_and_length(n)[0]
        n = select(dot(n, n) == ZERO, ng, n)  # a mesh may have normals of length zero, which say nothing
    else:
        n = ng
    return p, n, scale(ng, _step(p, ng, extent, sizes, area)), material, triangle, inside


@device
def _shading_normal(geometry, triangle, u, v, ng):
    """The interpolated normal, of any length, of a triangle that has one, else ng."""
    i, j, k, _ = words_at(geometry.normal_triangles, triangle * np.uint32(3), 4)
    has_normals = i != INVALID
    if not any_of(has_normals):
        return ng
    na = row_of_3(geometry.normals, select(has_normals, i, np.uint32(0)))
    nb = row_of_3(geometry.normals, select(has_normals, j, np.uint32(0)))
    nc = row_of_3(geometry.normals, select(has_normals, k, np.uint32(0)))
    return select(has_normals, _interpolate(na, nb, nc, u, v), ng)


@device
def offset_origin(inside, step):
    """Where rays that leave a point start, so that they don't meet its own triangle, nor slip past its neighbours.
    inside, step: the last and the `ng` of `find_surface`."""
    return add(inside, step)


@device
def _extent(a, b, c):
    """How far a triangle reaches from the origin along each axis."""
    return (
        max(abs(a[0]), max(abs(b[0]), abs(c[0]))),
        max(abs(a[1]), max(abs(b[1]), abs(c[1]))),
        max(abs(a[2]), max(abs(b[2]), abs(c[2]))),
    )


@device
def _sizes(a, b, c):
    """(the lengths of a triangle's sides ca, ab and bc along their longest axes, and how far rounding may tilt the
    normal that Embree calculates, as two volumes: of any triangle in such a box, and of this one). Over the triangle's
    area these are heights.

    Embree takes the smaller of two products of sides for each component (`stable_triangle_normal`). So it errs little
    where one side is short, and most where a corner lies next to the middle of a side.
    """
    x, y, z = sub(c, a), sub(a, b), sub(b, c)
    width = max(abs(x[0]), max(abs(y[0]), abs(z[0])))
    depth = max(abs(x[1]), max(abs(y[1]), abs(z[1])))
    height = max(abs(x[2]), max(abs(y[2]), abs(z[2])))
    own = (
        min(abs(x[2] * y[1]), abs(y[2] * z[1])) * width
        + min(abs(x[0] * y[2]), abs(y[0] * z[2])) * depth
        + min(abs(x[1] * y[0]), abs(y[1] * z[0])) * height
    )
    return (_reach(x), _reach(y), _reach(z)), width * depth * height, own


@device
def _reach(a):
    return max(abs(a[0]), max(abs(a[1]), abs(a[2])))


@device
def _to_world_sizes(m, row, e, sizes):
    """(a bound on the coordinates that an instance's points are summed from, `_sizes` in the world). Embree
    turns rays into the instance's space, which mixes the errors of all axes, so that every axis gets the sum."""
    total, longest = ZERO, ZERO
    for i in range(3):
        x, y, z = abs(at(m, row, i, 0)), abs(at(m, row, i, 1)), abs(at(m, row, i, 2))
        total += x * e[0] + y * e[1] + z * e[2] + abs(at(m, row, i, 3))
        longest = max(longest, x + y + z)
    x = (at(m, row, 0, 0), at(m, row, 1, 0), at(m, row, 2, 0))
    y = (at(m, row, 0, 1), at(m, row, 1, 1), at(m, row, 2, 1))
    z = (at(m, row, 0, 2), at(m, row, 1, 2), at(m, row, 2, 2))
    larger = abs(dot(cross(x, y), z))
    return (total, total, total), (scale(sizes[0], longest), sizes[1] * larger, sizes[2] * larger)


@device
def _off_the_edges(u, v, extent, sides, area):
    """Barycentrics of a point, moved off the edges that it lies on. sides: see `_sizes`; area: twice the
    triangle's, over a side the height over it."""
    off = _OFF_THE_EDGES * _reach(extent)
    ca, ab, bc = sides
    part = off / (area + SMALL)
    moved_u, moved_v = max(u, min(part * ca, _FARTHEST_OFF)), max(v, min(part * ab, _FARTHEST_OFF))
    inwards = ONE - max(moved_u + moved_v + min(part * bc, _FARTHEST_OFF) - ONE, ZERO)
    du, dv = moved_u * inwards - u, moved_v * inwards - v
    share = min(_LARGEST_MOVE * off / (abs(du) * ab + abs(dv) * ca + _AT_THE_ORIGIN), ONE)
    return u + share * du, v + share * dv


@device
def _step(p, ng, extent, sizes, area):
    """How far off its surface a ray has to start. area: twice the triangle's.

    Only errors along the normal count: on the ground at z = 0 next to none, wherever the ground ends. The first is of
    the point and of the ray's start, the second of the plane that Embree finds a hit in (`_sizes`). It grows with a
    sliver's aspect ratio. Its neighbours may err as much as any triangle of its size: a step that clears them is taken
    while it is shorter than the sliver is wide. Beyond, it would only bring rays over more of them.
    """
    across = abs(ng[0]) * extent[0] + abs(ng[1]) * extent[1] + abs(ng[2]) * extent[2]
    side, inverse = math.sqrt(area), _TILT / (area + SMALL)
    tilt, around = min(sizes[2] * inverse, _LONGEST_FOR_OWN * side), sizes[1] * inverse
    tilt = select(around < _LONGEST_FOR_NEIGHBOURS * side, max(tilt, around), tilt)
    return _STEP * across + _SMALLEST_STEP * _reach(p) + tilt + _AT_THE_ORIGIN


@device
def _unit_and_length(a):
    """As `direction_and_length`, also for vectors whose square leaves float32: products of edges of any length."""
    largest = _reach(a)
    unit, length = direction_and_length(scale(a, select(largest > TINY, ONE / largest, ZERO)))
    return unit, length * largest


@device
def _interpolate(a, b, c, u, v):
    w = ONE - u - v
    return (
        w * a[0] + u * b[0] + v * c[0],
        w * a[1] + u * b[1] + v * c[1],
        w * a[2] + u * b[2] + v * c[2],
    )


@device
def _to_world_point(m, row, p):
    return (
        at(m, row, 0, 0) * p[0] + at(m, row, 0, 1) * p[1] + at(m, row, 0, 2) * p[2] + at(m, row, 0, 3),
        at(m, row, 1, 0) * p[0] + at(m, row, 1, 1) * p[1] + at(m, row, 1, 2) * p[2] + at(m, row, 1, 3),
        at(m, row, 2, 0) * p[0] + at(m, row, 2, 1) * p[1] + at(m, row, 2, 2) * p[2] + at(m, row, 2, 3),
    )


@device
def _to_world_normal(m, row, n):
    """By the matrix of cofactors, which is the inverse transpose up to a factor, mirrored instances included."""
    x = (at(m, row, 0, 0), at(m, row, 1, 0), at(m, row, 2, 0))
    y = (at(m, row, 0, 1), at(m, row, 1, 1), at(m, row, 2, 1))
    z = (at(m, row, 0, 2), at(m, row, 1, 2), at(m, row, 2, 2))
    yz, zx, xy = cross(y, z), cross(z, x), cross(x, y)
    return (
        yz[0] * n[0] + zx[0] * n[1] + xy[0] * n[2],
        yz[1] * n[0] + zx[1] * n[1] + xy[1] * n[2],
        yz[2] * n[0] + zx[2] * n[1] + xy[2] * n[2],
    )
