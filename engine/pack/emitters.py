"""What the light tree is built from: bounds, orientation and power of lamps and of emissive surfaces."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..features import ELLIPSE, RECTANGLE, SPOT
from ..kernels import tables as t
from ..kernels.geom.vec import LUMINANCE
from ..lighttree import build_light_tree
from ..memory import OF_EMISSIVE_TRIANGLE, foresee
from ..scene import AreaLight, Lamp, SpotLight, Visibility
from .geometry import PackedGeometry
from .lamps import corners_of

SCATTERED_RAYS = Visibility.DIFFUSE | Visibility.GLOSSY
# How far, in parts of its size, two triangles may be off a rectangle and still be sampled as one.
RECTANGLE_TOLERANCE = 1e-5


@dataclass
class Emitters:
    """What the light tree is built from; the meaning of each array is in engine/lighttree.py."""

    bounds: np.ndarray
    axis: np.ndarray
    theta_o: np.ndarray
    theta_e: np.ndarray
    power: np.ndarray
    two_sided: np.ndarray


def mesh_emitters(packed: PackedGeometry, lamp_count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, Emitters]:
    """Emissive surfaces with an area: the triangle of each emitter, its rectangle, the emitter of every triangle, and
    what the tree needs. Two triangles that make a rectangle are one emitter."""
    geometry = packed.tables
    glows = np.any(geometry.materials[:, t.EMISSION : t.EMISSION + 3] > 0, axis=1)
    lit = (
        np.flatnonzero(glows[geometry.triangle_slot[: packed.baked_count]]) if np.any(glows) else np.zeros(0, np.int64)
    )
    foresee({f"{len(lit):,} emissive triangles": OF_EMISSIVE_TRIANGLE * len(lit)})
    corners = geometry.vertices[geometry.triangles[lit]].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(normals, axis=1)
    keep = double_area > 0
    lit, corners, normals, double_area = lit[keep], corners[keep], normals[keep], double_area[keep]

    first, rectangles = _rectangles(geometry, lit)
    second = first + 1
    alone = np.ones(len(lit), bool)
    alone[second] = False
    emitter = np.cumsum(alone) - 1
    of_triangle = np.zeros(0, np.int32)
    if len(lit):
        of_triangle = np.full(len(geometry.triangles), -1, np.int32)
        of_triangle[lit] = lamp_count + emitter
    # Reductions over an axis of three take numpy several times as long as this.
    low = np.minimum(np.minimum(corners[:, 0], corners[:, 1]), corners[:, 2])
    high = np.maximum(np.maximum(corners[:, 0], corners[:, 1]), corners[:, 2])
    low[first], high[first] = np.minimum(low[first], low[second]), np.maximum(high[first], high[second])
    power = geometry.materials[geometry.triangle_slot[lit], t.EMISSION : t.EMISSION + 3] @ LUMINANCE * double_area / 2
    power[first] += power[second]
    power[(packed.visibility[lit] & int(SCATTERED_RAYS)) == 0] = 0  # only the camera sees it
    shape = np.zeros((int(alone.sum()), 9), np.float32)
    shape[emitter[first]] = rectangles
    emitters = Emitters(
        bounds=np.concatenate([low, high], axis=1)[alone].reshape(-1, 6),
        axis=(normals / double_area[:, None])[alone].reshape(-1, 3),
        theta_o=np.zeros(len(shape)),
        theta_e=np.full(len(shape), np.pi / 2),
        power=power[alone],
        two_sided=np.ones(len(shape), np.bool_),
    )
    return lit[alone].astype(np.uint32), shape if len(first) else shape[:0], of_triangle, emitters


def _rectangles(geometry: t.Geometry, lit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours in `lit` that make a rectangle: (places of the first of each two, (R, 9) corner and two edges)."""
    slot = geometry.triangle_slot[lit]
    place = np.flatnonzero((lit[1:] == lit[:-1] + 1) & (slot[1:] == slot[:-1]))
    one, two = geometry.triangles[lit[place]], geometry.triangles[lit[place + 1]]
    shared = _has(two, one)  # corners of the first that the second has too
    quad = shared[:, 0].astype(np.int8) + shared[:, 1] + shared[:, 2] == 2
    place, one, two, shared = place[quad], one[quad], two[quad], shared[quad]
    row = np.arange(len(one))
    apex = np.argmin(shared, axis=1)
    corner = geometry.vertices[one[row, apex]].astype(np.float64)
    edge_x = geometry.vertices[one[row, (apex + 1) % 3]] - corner
    edge_y = geometry.vertices[one[row, (apex + 2) % 3]] - corner
    opposite = np.argmin(_has(one, two), axis=1)
    far = geometry.vertices[two[row, opposite]] - corner
    size = np.linalg.norm(edge_x, axis=1) + np.linalg.norm(edge_y, axis=1)
    fits = np.linalg.norm(edge_x + edge_y - far, axis=1) < RECTANGLE_TOLERANCE * size
    fits &= np.abs(np.sum(edge_x * edge_y, axis=1)) < RECTANGLE_TOLERANCE * size**2
    # Of a run of neighbours that all fit, each with the next, every other one: none is in two rectangles.
    candidates = np.flatnonzero(fits)
    begins = np.flatnonzero(np.diff(place[candidates], prepend=-2) != 1)
    of_run = np.arange(len(candidates)) - np.repeat(begins, np.diff(begins, append=len(candidates)))
    chosen = candidates[of_run % 2 == 0]
    return place[chosen], np.concatenate([corner, edge_x, edge_y], axis=1)[chosen].astype(np.float32).reshape(-1, 9)


def _has(triangles: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(E, 3) bool: whether the triangle (E, 3) has the corner (E, 3)."""
    return (corners == triangles[:, :1]) | (corners == triangles[:, 1:2]) | (corners == triangles[:, 2:])


def lamp_emitters(local: list[Lamp], kinds: np.ndarray, rows: np.ndarray) -> Emitters:
    """Bounds, orientation and power of the lamps. Power in the unit of the emissive triangles': radiance x area."""
    center = rows[:, t.POSITION : t.POSITION + 3].astype(np.float64)
    radius = rows[:, t.SIZE].astype(np.float64)[:, None]
    area = np.where(radius > 0, np.pi * radius**2, 1)[:, 0]
    out = Emitters(
        bounds=np.concatenate([center - radius, center + radius], axis=1),
        axis=rows[:, t.AXIS : t.AXIS + 3].astype(np.float64),
        theta_o=np.full(len(local), np.pi),
        theta_e=np.full(len(local), np.pi / 2),
        power=rows[:, t.RADIANCE : t.RADIANCE + 3] @ LUMINANCE * area,
        two_sided=np.zeros(len(local), np.bool_),
    )
    for i in np.flatnonzero(kinds & (RECTANGLE | ELLIPSE | SPOT)):
        light, row = local[i], rows[i]
        if isinstance(light, SpotLight):
            # Seen from the side of a wide lamp the cone's rim shines beyond its angle: keep it conservative. The tree
            # takes what an emitter sends to fall with the cosine: beyond 90 degrees it must be a cone of axes.
            reach = spot_reach(light)
            out.theta_e[i] = min(reach, np.pi / 2)
            out.theta_o[i] = reach - out.theta_e[i]
        elif isinstance(light, AreaLight):
            corners = corners_of(row)
            out.bounds[i] = [*corners.min(axis=0), *corners.max(axis=0)]
            out.theta_o[i], out.theta_e[i] = 0.0, light.spread / 2
            radiance = float(row[t.RADIANCE : t.RADIANCE + 3] @ LUMINANCE)
            out.power[i] = radiance * float(row[t.AREA]) * max(float(row[t.TAN_SPREAD] * row[t.SPREAD_NORM]), 1.0)
    scatters = np.array([int(light.visibility) & int(SCATTERED_RAYS) for light in local], np.int64)
    out.power[scatters == 0] = 0  # only the camera sees it
    return out


def spot_reach(light: SpotLight) -> float:
    """No less than the widest angle off the axis at which the cone shines, in world space, where scale and shear may
    have bent it.

    A direction of the cone's rim is M (z + e tan(half angle)) with a unit e across z: its part across the axis is at
    most the largest singular value of M's x and y columns without their parts along the axis, times the tangent; its
    part along the axis is the length of M z, less at most those parts.
    """
    matrix = np.asarray(light.transform, np.float64)[:, :3]
    if np.linalg.matrix_rank(matrix) < 3:
        return np.pi
    length = float(np.linalg.norm(matrix[:, 2]))
    axis, across = matrix[:, 2] / length, matrix[:, :2]
    along = axis @ across
    widest = np.linalg.norm(across - axis[:, None] * along, 2)
    tangent = np.tan(min(light.half_angle, np.pi / 2 - 1e-6))
    least = length - tangent * float(np.linalg.norm(along))
    return float(np.arctan(tangent * widest / least)) if least > 0 else np.pi


def choice_tree(e: Emitters, groups: int) -> tuple:
    """A single emitter needs no tree where there is nothing else to choose; an empty one has the same type."""
    used = slice(None) if len(e.power) > 1 or groups > 1 else slice(0, 0)
    return build_light_tree(
        e.bounds[used], e.axis[used], e.theta_o[used], e.theta_e[used], e.power[used], e.two_sided[used]
    )


def join_emitters(a: Emitters, b: Emitters) -> Emitters:
    return Emitters(*(np.concatenate([getattr(a, f.name), getattr(b, f.name)]) for f in fields(Emitters)))
