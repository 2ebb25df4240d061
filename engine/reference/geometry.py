"""All triangles of a scene in world space, and the rays against them.

Instances are flattened: simple, and as large as the scene really is. Embree works in float32; a hit point is rebuilt
in float64 from the corners of its triangle and the barycentric coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from ..scene import Instances, Mesh, Scene, Visibility
from .vectors import dot, length, unit

# How far off a surface a ray starts, relative to the coordinates around: some 30 steps of the float32 in which Embree
# calculates. See tests/reference/test_geometry.py.
OFFSET = 4e-6

FAR = 1e37  # what embreex takes for "no limit"


@dataclass
class Surface:
    """n points on triangles, seen from `wo`.

    point     (n, 3)
    normal    (n, 3) shading normal
    flat      (n, 3) geometric normal, on the side of `wo`; `normal` was flipped with it
    triangle  (n,) index
    offset    (n,) how far along `flat` a ray that leaves the surface starts
    """

    point: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    triangle: np.ndarray
    offset: np.ndarray


class Geometry:
    """
    corners     (T, 3, 3) world space, rounded to float32 as Embree sees them
    normals     (T, 3, 3) at the corners
    flat        (T, 3) geometric normals
    material    (T,) index into `Scene.materials`
    visibility  (T,) `Visibility` bits
    """

    def __init__(self, scene: Scene) -> None:
        parts = [_flatten(scene.meshes[m], scene.instances, m) for m in np.unique(scene.instances.mesh)]
        parts = [part for part in parts if len(part[0])]
        empty = [(np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), np.zeros(0, int), np.zeros(0, np.uint8))]
        columns = zip(*(parts or empty), strict=True)
        self.corners, self.normals, self.material, self.visibility = (np.concatenate(column) for column in columns)
        self.flat = unit(_cross_of(self.corners))
        self.transparency = np.array([m.transparency for m in scene.materials], np.float64).reshape(-1, 3)
        self._trees: dict[bytes, tuple[np.ndarray, EmbreeScene]] = {}
        self._by_kind = {kind: self._tree(kind) for kind in Visibility.ALL}
        self.rays = 0

    def __len__(self) -> int:
        return len(self.material)

    @property
    def radius(self) -> float:
        """Of a sphere around everything, for weighing the sun and the world against lamps."""
        if not len(self):
            return 1.0
        points = self.corners.reshape(-1, 3)
        size = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
        return max(size / 2, 1e-6)

    def _tree(self, kind: Visibility) -> tuple[np.ndarray, EmbreeScene]:
        """The triangles that rays of this kind meet, and Embree's structure over them, shared between equal sets."""
        chosen = np.flatnonzero(self.visibility & kind)
        key = chosen.tobytes()
        if key not in self._trees:
            tree = EmbreeScene(robust=True)
            if len(chosen):
                TriangleMesh(tree, np.ascontiguousarray(self.corners[chosen], np.float32))
            self._trees[key] = chosen, tree
        return self._trees[key]

    def intersect(
        self, kind: Visibility, origin: np.ndarray, direction: np.ndarray, limit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The nearest triangle (n,), -1 for none, within `limit` (n,), and (n, 2) barycentric coordinates."""
        chosen, tree = self._by_kind[kind]
        self.rays += len(origin)
        if not len(chosen) or not len(origin):
            return np.full(len(origin), -1), np.zeros((len(origin), 2))
        hit = tree.run(
            np.ascontiguousarray(origin, np.float32),
            np.ascontiguousarray(direction, np.float32),
            dists=np.minimum(limit, FAR).astype(np.float32),
            output=True,
        )
        primitive = hit["primID"]
        triangle = np.where(primitive >= 0, chosen[primitive], -1)
        return triangle, np.column_stack([hit["u"], hit["v"]]).astype(np.float64)

    def surface(self, triangle: np.ndarray, uv: np.ndarray, wo: np.ndarray) -> Surface:
        """The points (n,) on `triangle` at `uv`, seen from `wo`."""
        weights = np.column_stack([1 - uv.sum(axis=1), uv])
        corners = self.corners[triangle]
        point = np.einsum("nk,nki->ni", weights, corners)
        flat = self.flat[triangle]
        normal = unit(np.einsum("nk,nki->ni", weights, self.normals[triangle]))
        normal = np.where(dot(normal, normal)[:, None] > 0.5, normal, flat)
        side = np.where(dot(flat, wo) < 0, -1.0, 1.0)[:, None]
        offset = OFFSET * np.abs(corners).max(axis=(1, 2))
        return Surface(point, normal * side, flat * side, triangle, offset)

    def transmittance(self, origin: np.ndarray, direction: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """The fraction (n, 3) of light that reaches `origin` from `distance` away: what transparent surfaces leave."""
        left = np.ones((len(origin), 3))
        alive = np.arange(len(origin))
        while len(alive):
            triangle, uv = self.intersect(Visibility.SHADOW, origin, direction, distance)
            hit = triangle >= 0
            alive, origin, direction, distance = (a[hit] for a in (alive, origin, direction, distance))
            triangle, uv = triangle[hit], uv[hit]
            left[alive] *= self.transparency[self.material[triangle]]

            surface = self.surface(triangle, uv, -direction)
            start = surface.point - surface.flat * surface.offset[:, None]
            distance = distance - dot(start - origin, direction)
            on = (left[alive].max(axis=1) > 0) & (distance > 0)
            alive, origin, direction, distance = (a[on] for a in (alive, start, direction, distance))
        return left


def _flatten(mesh: Mesh, instances: Instances, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Corners (k T, 3, 3), corner normals (k T, 3, 3), material (k T,) and visibility (k T,) of all k instances."""
    which = np.flatnonzero(instances.mesh == index)
    faces, count = len(mesh.triangles), len(which)
    transforms = np.asarray(instances.transforms[which], np.float64)
    local = mesh.vertices[mesh.triangles].astype(np.float64)
    corners = np.einsum("kij,tcj->ktci", transforms[:, :, :3], local) + transforms[:, None, None, :, 3]
    # A mirrored instance turns its triangles inside out: two corners change places, so that the geometric normal
    # follows the shading normals.
    mirrored = np.linalg.det(transforms[:, :, :3]) < 0
    order = np.where(mirrored[:, None], [0, 2, 1], [0, 1, 2])
    corners = np.take_along_axis(corners, order[:, None, :, None], axis=2)
    corners = corners.astype(np.float32).astype(np.float64).reshape(-1, 3, 3)

    if mesh.normals is None:
        normals = np.repeat(unit(_cross_of(corners))[:, None], 3, axis=1)
    else:
        local = mesh.normals[mesh.triangles if mesh.normal_indices is None else mesh.normal_indices]
        normals = np.einsum("kij,tcj->ktci", _cofactors(transforms[:, :, :3]), local)
        normals = np.where(mirrored[:, None, None, None], -normals, normals)
        normals = unit(np.take_along_axis(normals, order[:, None, :, None], axis=2)).reshape(-1, 3, 3)

    slots = np.zeros(faces, np.int64) if mesh.material_slots is None else mesh.material_slots
    slots = np.minimum(slots[None, :], instances.slot_count[which][:, None] - 1)
    material = instances.material_table[instances.material_offset[which][:, None] + slots]
    visibility = np.broadcast_to(instances.visibility[which][:, None], (count, faces))
    return corners, normals, material.reshape(-1), visibility.reshape(-1)


def _cofactors(m: np.ndarray) -> np.ndarray:
    """(k, 3, 3): how normals transform, up to length and sign. Unlike the inverse it exists for flattened objects."""
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)


def _cross_of(corners: np.ndarray) -> np.ndarray:
    """Twice the area of each triangle (T, 3, 3), as a vector along its normal."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def areas(corners: np.ndarray) -> np.ndarray:
    """(T,) square metres."""
    return length(_cross_of(corners)) / 2
