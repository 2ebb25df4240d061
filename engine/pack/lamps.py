"""Point, spot and area lamps to rows of the lamp table, and the shapes by which rays meet them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..accel import SphereGeometry, TriangleGeometry
from ..features import DISK, ELLIPSE, POINT, RECTANGLE, SPHERE, SPOT
from ..kernels import tables as t
from ..scene import AreaLight, PointLight, Scene, SpotLight, Visibility
from ..validate import SMALLEST_SIZE
from .geometry import VERTEX_PADDING

# So many lamps the kernel asks one after the other. In Embree's scene each lamp that a ray meets is a call back, and
# spheres, be it one, are a second search, as they are kept apart from triangles there.
MOST_LISTED_ROUND, MOST_LISTED_FLAT = 128, 16
RAYS_THAT_SEE = Visibility.CAMERA | Visibility.DIFFUSE | Visibility.GLOSSY
# Below this half spread, 1 / (tan h - h) cancels in float64: its series is 3 / h^3. Its cube must fit float32.
SMALL_SPREAD, SMALLEST_SPREAD = 1e-3, 1e-10
# An area lamp's shape for rays lies before the lamp by this part of the scene's largest coordinate, so that rays meet
# it before a surface in the lamp's plane: where Embree finds a hit errs by some roundings of the lengths that it
# reckons with, of the ray and of the surface. Light samples stop before the lamp by more: see kernels/direct.py.
SHAPE_STEP_PART = 2.0**-20
# But no farther than this part of its own size, more than its own coordinates ask for: else a single object left
# a thousand kilometres away would put the shapes of all lamps behind other things.
LONGEST_SHAPE_STEP = 2.0**-8


def unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v)
    return v / length if length > 0 else np.array([0.0, 0.0, 1.0])


def pack_points(lights: Sequence[PointLight]) -> tuple[np.ndarray, np.ndarray]:
    """Rows and kinds of point, sphere, disk and spot lamps. All at once: a scene may hold 100,000 of them."""
    rows = np.zeros((len(lights), t.LAMP_WORDS), np.float32)
    matrices = np.array([light.transform for light in lights], np.float64).reshape(-1, 3, 4)
    rows[:, t.POSITION : t.POSITION + 3] = matrices[:, :, 3]
    lengths = np.sqrt(np.einsum("ij,ij->i", matrices[:, :, 2], matrices[:, :, 2]))[:, None]
    upright = np.broadcast_to([0.0, 0.0, 1.0], (len(lights), 3)).copy()
    rows[:, t.AXIS : t.AXIS + 3] = -np.divide(matrices[:, :, 2], lengths, out=upright, where=lengths > 0)
    radius = np.array([light.radius for light in lights], np.float64)
    radius[radius < SMALLEST_SIZE] = 0
    rows[:, t.SIZE : t.SIZE + 2] = radius[:, None]
    intensity = np.array([light.intensity for light in lights], np.float64).reshape(-1, 3)
    rows[:, t.RADIANCE : t.RADIANCE + 3] = intensity / np.where(radius > 0, np.pi * radius**2, 1)[:, None]
    soft = np.array([light.soft_falloff for light in lights], bool)
    kinds = np.where(radius > 0, np.where(soft, DISK, SPHERE), POINT).astype(np.int32)
    for i, light in enumerate(lights):
        if isinstance(light, SpotLight):
            kinds[i] |= SPOT
            _add_cone(rows[i], light)
    return rows, kinds


def _add_cone(row: np.ndarray, light: SpotLight) -> None:
    matrix = np.asarray(light.transform, np.float64)
    drop = 2 * np.sin(light.half_angle / 2) ** 2
    row[t.SPOT_DROP] = drop
    # smoothstep clamps, so a huge finite factor is the hard edge that blend = 0 asks for.
    row[t.SPOT_SCALE] = min(1 / max(drop * light.blend, 1e-12), 1e12)
    # Only directions are taken there: the scale, whose inverse may not fit float32, is left out.
    linear = matrix[:, :3] / (float(np.abs(matrix[:, :3]).max()) or 1.0)
    row[t.TO_LOCAL : t.TO_LOCAL + 9] = np.linalg.pinv(linear).ravel()


def pack_area(row: np.ndarray, light: AreaLight, reach: float) -> int:
    """Rectangle and ellipse lamps in a scene of such coordinates. Returns the kind.

    The lamp is the image of the square or disk under its matrix, shear and all: it lies in the plane of the two axes
    and shines to the side where the local -z points. Cycles takes the axes likewise, but the -z column itself for the
    normal, which under a shear is none.
    """
    matrix = np.asarray(light.transform, np.float64)
    x, y = matrix[:, 0] * light.size_x, matrix[:, 1] * light.size_y
    row[t.POSITION : t.POSITION + 3] = matrix[:, 3]
    row[t.AXIS_X : t.AXIS_X + 3] = unit(x)
    row[t.AXIS_Y : t.AXIS_Y + 3] = unit(y)
    across = np.cross(x, y)
    row[t.AXIS : t.AXIS + 3] = unit(-across if across @ matrix[:, 2] >= 0 else across)
    row[t.AREA] = np.linalg.norm(across) * (np.pi / 4 if light.ellipse else 1)
    row[t.TO_LOCAL : t.TO_LOCAL + 6] = np.linalg.pinv(np.column_stack([x / 2, y / 2])).ravel()
    row[t.RADIANCE : t.RADIANCE + 3] = light.radiance
    row[t.SIZE], row[t.SIZE + 1] = np.linalg.norm(x) / 2, np.linalg.norm(y) / 2
    half = light.spread / 2
    if half < np.pi / 2 - 1e-6:
        row[t.TAN_SPREAD] = np.tan(half)
        row[t.SPREAD_NORM] = 1 / (np.tan(half) - half) if half > SMALL_SPREAD else 3 / max(half, SMALLEST_SPREAD) ** 3
    row[t.SHAPE_STEP] = _shape_step(corners_of(row), float(row[t.SIZE : t.SIZE + 2].max()), reach)
    return ELLIPSE if light.ellipse else RECTANGLE


def _shape_step(corners: np.ndarray, size: float, reach: float) -> float:
    """How far the lamp's shape lies before it, in a scene of such coordinates."""
    own = SHAPE_STEP_PART * float(np.abs(corners).max())
    return max(own, min(SHAPE_STEP_PART * reach, LONGEST_SHAPE_STEP * size))


def lamps_that_rays_meet(kinds: np.ndarray, rows: np.ndarray, masks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(those that the kernel is to ask one after the other, those that are to go into Embree's scene): int32, places in
    `rows`. masks: which rays see them, 0: none."""
    seen = masks > 0
    round_ones = np.flatnonzero(seen & ((kinds & (SPHERE | DISK)) != 0))
    flat_ones = np.flatnonzero(seen & ((kinds & (RECTANGLE | ELLIPSE)) != 0))
    flat_ones = flat_ones[np.all(rows[flat_ones, t.SIZE : t.SIZE + 2] > 0, axis=1)]
    few = len(round_ones) <= MOST_LISTED_ROUND, len(flat_ones) <= MOST_LISTED_FLAT
    listed = [ones for ones, are_few in zip((round_ones, flat_ones), few, strict=True) if are_few]
    traced = [ones for ones, are_few in zip((round_ones, flat_ones), few, strict=True) if not are_few]
    none = [np.zeros(0, np.int64)]
    return np.concatenate(listed + none).astype(np.int32), np.concatenate(traced + none).astype(np.int32)


def may_be_traced(scene: Scene) -> bool:
    """Whether it has so many lamps that Embree may have to know some: asked before they are packed."""
    flat = sum(isinstance(light, AreaLight) for light in scene.lights)
    return flat > MOST_LISTED_FLAT or len(scene.lights) - flat > MOST_LISTED_ROUND


def lamp_shapes(traced: np.ndarray, kinds: np.ndarray, rows: np.ndarray, masks: np.ndarray):
    """Embree geometries of the lamps `traced`, by visibility.

    Returns (shapes, kind of each, base of each, lamp of each quad, lamp of each sphere).
    """
    shapes: list[TriangleGeometry | SphereGeometry] = []
    shape_kind: list[int] = []
    shape_base: list[int] = []
    of_quad: list[int] = []
    of_sphere: list[int] = []
    for mask in np.unique(masks[traced]):
        seen_so = traced[masks[traced] == mask]
        quads = seen_so[(kinds[seen_so] & (RECTANGLE | ELLIPSE)) != 0]
        if len(quads):
            shapes.append(_quads(np.array([_shape(rows[i]) for i in quads]), int(mask) << t.LAMP_SHIFT))
            shape_kind.append(t.LAMP_QUADS)
            shape_base.append(len(of_quad))
            of_quad.extend(quads)
        spheres = seen_so[(kinds[seen_so] & (SPHERE | DISK)) != 0]
        if len(spheres):
            points = np.ascontiguousarray(rows[spheres][:, [t.POSITION, t.POSITION + 1, t.POSITION + 2, t.SIZE]])
            shapes.append(SphereGeometry(points, int(mask) << t.LAMP_SHIFT))
            shape_kind.append(t.LAMP_SPHERES)
            shape_base.append(len(of_sphere))
            of_sphere.extend(spheres)
    return shapes, shape_kind, shape_base, np.array(of_quad, np.int32), np.array(of_sphere, np.int32)


def corners_of(row: np.ndarray) -> np.ndarray:
    center = row[t.POSITION : t.POSITION + 3].astype(np.float64)
    x = row[t.AXIS_X : t.AXIS_X + 3] * float(row[t.SIZE])
    y = row[t.AXIS_Y : t.AXIS_Y + 3] * float(row[t.SIZE + 1])
    return np.array([center - x - y, center + x - y, center + x + y, center - x + y])


def _shape(row: np.ndarray) -> np.ndarray:
    """(4, 3) corners by which rays meet the lamp."""
    return corners_of(row) + float(row[t.SHAPE_STEP]) * row[t.AXIS : t.AXIS + 3].astype(np.float64)


def _quads(corners: np.ndarray, mask: int) -> TriangleGeometry:
    """corners (Q, 4, 3): two triangles each."""
    vertices = np.zeros((4 * len(corners) + VERTEX_PADDING, 3), np.float32)
    vertices[:-VERTEX_PADDING] = corners.reshape(-1, 3)
    first = 4 * np.arange(len(corners))[:, None, None]
    triangles = (first + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3).astype(np.uint32)
    return TriangleGeometry(vertices, triangles, mask, is_lamp=True)
