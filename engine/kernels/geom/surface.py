"""From Embree's hit to a point of a surface: position, normals, material.

The position is rebuilt from the triangle's vertices and barycentrics, which is exact to a few ulps of the vertices
wherever the ray came from; rays that leave start from `offset_origin`.
"""

from __future__ import annotations

import numpy as np

from ..embree import GEOM_ID, INST_ID, INST_PRIM_ID, INVALID, PRIM_ID, U, V, bits_of, float_of
from ..jit import device
from ..light.emitters import triangle_vertices
from ..tables import INSTANCED_MESH
from .vec import ONE, ZERO, cross, dot, negate, normalize, sub

# Waechter & Binder 2019, "A Fast and Robust Method for Avoiding Self-Intersection", Ray Tracing Gems, ch. 6.
_ORIGIN = np.float32(1 / 32)
_FLOAT_SCALE = np.float32(1 / 65536)
_INT_SCALE = np.float32(256)


@device
def find_surface(f, geometry, ray, words, wo):
    """The hit in `ray` as (p, n, ng, material, triangle), n and ng on wo's side as the mesh has them to each other."""
    outer = words[INST_ID] if f.instances and words[INST_ID] != INVALID else words[GEOM_ID]
    u, v = ray[U], ray[V]
    triangle = np.int64(geometry.base[outer]) + np.int64(words[PRIM_ID])
    a, b, c = triangle_vertices(geometry, triangle)
    p, ng = _interpolate(a, b, c, u, v), cross(sub(b, a), sub(c, a))
    n = ng
    if f.smooth and geometry.normal_triangles[triangle, 0] != INVALID:
        corners = geometry.normal_triangles
        na, nb, nc = (
            _normal(geometry, corners[triangle, 0]),
            _normal(geometry, corners[triangle, 1]),
            _normal(geometry, corners[triangle, 2]),
        )
        n = _interpolate(na, nb, nc, u, v)
    material = geometry.triangle_slot[triangle]
    if f.instances and geometry.kind[outer] == INSTANCED_MESH:
        row = np.int64(geometry.instance_base[outer]) + np.int64(words[INST_PRIM_ID])
        p = _to_world_point(geometry.transforms, row, p)
        ng = _to_world_normal(geometry.transforms, row, ng)
        n = _to_world_normal(geometry.transforms, row, n)
        slot = min(max(material, np.int32(0)), geometry.slot_count[row] - np.int32(1))
        material = geometry.slots[geometry.slot_offset[row] + slot]
    ng = normalize(ng)
    if dot(ng, wo) < ZERO:
        ng, n = negate(ng), negate(n)
    n = normalize(n) if f.smooth else ng
    if f.smooth and dot(n, n) == ZERO:  # a mesh may have normals of length zero, which say nothing
        n = ng
    return p, n, ng, material, triangle


@device
def offset_origin(p, ng):
    """Where rays that leave p on ng's side start, so that they don't meet p's own triangle."""
    return _offset(p[0], ng[0]), _offset(p[1], ng[1]), _offset(p[2], ng[2])


@device
def _offset(x, along):
    if abs(x) < _ORIGIN:
        return x + _FLOAT_SCALE * along
    steps = np.int32(_INT_SCALE * along)
    return float_of(np.int32(bits_of(x) + (-steps if x < ZERO else steps)))


@device
def _interpolate(a, b, c, u, v):
    w = ONE - u - v
    return (
        w * a[0] + u * b[0] + v * c[0],
        w * a[1] + u * b[1] + v * c[1],
        w * a[2] + u * b[2] + v * c[2],
    )


@device
def _normal(geometry, i):
    return geometry.normals[i, 0], geometry.normals[i, 1], geometry.normals[i, 2]


@device
def _to_world_point(m, row, p):
    return (
        m[row, 0, 0] * p[0] + m[row, 0, 1] * p[1] + m[row, 0, 2] * p[2] + m[row, 0, 3],
        m[row, 1, 0] * p[0] + m[row, 1, 1] * p[1] + m[row, 1, 2] * p[2] + m[row, 1, 3],
        m[row, 2, 0] * p[0] + m[row, 2, 1] * p[1] + m[row, 2, 2] * p[2] + m[row, 2, 3],
    )


@device
def _to_world_normal(m, row, n):
    """By the matrix of cofactors, which is the inverse transpose up to a factor, mirrored instances included."""
    x = (m[row, 0, 0], m[row, 1, 0], m[row, 2, 0])
    y = (m[row, 0, 1], m[row, 1, 1], m[row, 2, 1])
    z = (m[row, 0, 2], m[row, 1, 2], m[row, 2, 2])
    yz, zx, xy = cross(y, z), cross(z, x), cross(x, y)
    return (
        yz[0] * n[0] + zx[0] * n[1] + xy[0] * n[2],
        yz[1] * n[0] + zx[1] * n[1] + xy[1] * n[2],
        yz[2] * n[0] + zx[2] * n[1] + xy[2] * n[2],
    )
