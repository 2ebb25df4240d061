"""Meshes, instances and materials to triangle tables.

A mesh that is used once, or so small that its copies cost nothing, is baked: its triangles go to world space and
into one Embree geometry with all others of the same visibility, which is the fastest to trace. The rest becomes
Embree instances of a shared mesh. Emissive meshes are always baked, as each of their triangles is a light.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ..accel import InstanceGeometry, TriangleGeometry
from ..kernels.tables import (
    BAKED_MESH,
    EMISSION,
    EXPONENT,
    INSTANCED_MESH,
    KD,
    KS,
    MATERIAL_WORDS,
    TRANSPARENCY,
    Geometry,
)
from ..scene import Instances, Mesh, Scene, Visibility

# A mesh whose copies have no more triangles than this in all is baked: they fit the cache, and a two-level
# traversal costs more than they do.
BAKE_LIMIT = 1 << 16
# An instance matrix that squeezes space by more than this has no usable inverse in float32: baked instead.
FLATTEST_INSTANCE = 1e-6

# Sharper mirrors cannot be told apart, and the kernels' float32 keeps to numbers that it can square.
MAX_EXPONENT = 1e8

INVALID = np.uint32(0xFFFFFFFF)
SCATTERED = int(Visibility.DIFFUSE | Visibility.GLOSSY | Visibility.SHADOW)


@dataclass
class PackedGeometry:
    """`tables` lacks the lamps' shapes and the Embree address; `shapes` go to Embree in the order of their ids."""

    tables: Geometry
    baked_count: int  # of triangles in world space; they come first
    visibility: np.ndarray  # (baked_count,) uint8
    shapes: list[TriangleGeometry | InstanceGeometry]
    features: dict[str, int]


@dataclass
class _Triangles:
    """Arrays to be joined, with the running numbers of vertices, triangles and normals."""

    vertices: list[np.ndarray] = field(default_factory=list)
    triangles: list[np.ndarray] = field(default_factory=list)
    slots: list[np.ndarray] = field(default_factory=list)
    normals: list[np.ndarray] = field(default_factory=list)
    normal_triangles: list[np.ndarray | None] = field(default_factory=list)
    vertex_count: int = 0
    triangle_count: int = 0
    normal_count: int = 0

    def add(self, mesh: Mesh, vertices: np.ndarray, normals: np.ndarray | None, slots: np.ndarray) -> int:
        """Append a mesh; returns the index of its first triangle."""
        first = self.triangle_count
        self.vertices.append(vertices)
        self.triangles.append(mesh.triangles + np.uint32(self.vertex_count))
        self.slots.append(slots)
        if normals is None:
            self.normal_triangles.append(None)
        else:
            indices = mesh.triangles if mesh.normal_indices is None else mesh.normal_indices
            self.normals.append(normals)
            self.normal_triangles.append(indices + np.uint32(self.normal_count))
            self.normal_count += len(normals)
        self.vertex_count += len(vertices)
        self.triangle_count += len(mesh.triangles)
        return first

    def joined_normal_triangles(self) -> np.ndarray:
        if not self.normals:
            return np.zeros((0, 3), np.uint32)
        return np.concatenate(
            [
                np.full(triangles.shape, INVALID, np.uint32) if normals is None else normals
                for triangles, normals in zip(self.triangles, self.normal_triangles, strict=True)
            ]
        )


def pack_geometry(scene: Scene) -> PackedGeometry:
    """Everything that has triangles. See the module's text for what is baked and what is instanced."""
    instances = scene.instances
    materials = pack_materials(scene)
    members = _instances_by_mesh(instances, len(scene.meshes))
    emits = _instances_that_emit(instances, materials)
    flat = _squeezed(instances.transforms)

    out = _Triangles()
    baked: dict[int, list[tuple[Mesh, int]]] = {}  # by visibility
    instanced: list[tuple[Mesh, int, np.ndarray]] = []
    for mesh, rows in zip(scene.meshes, members, strict=True):
        if not len(mesh.triangles):
            continue
        rows = rows[instances.visibility[rows] != 0]
        if len(rows) * len(mesh.triangles) <= BAKE_LIMIT or len(rows) == 1:
            alone, shared = rows, rows[:0]
        else:
            bake = emits[rows] | flat[rows]
            alone, shared = rows[bake], rows[~bake]
        for row in alone:
            baked.setdefault(int(instances.visibility[row]), []).append((mesh, int(row)))
        for visibility in np.unique(instances.visibility[shared]):
            instanced.append((mesh, int(visibility), shared[instances.visibility[shared] == visibility]))

    shapes: list[TriangleGeometry | InstanceGeometry] = []
    kind, base, instance_base = [], [], []
    visible: list[np.ndarray] = []
    for visibility, placed in baked.items():
        first = out.triangle_count
        for mesh, row in placed:
            _bake(out, mesh, instances, row)
        shapes.append(TriangleGeometry(first, out.triangle_count - first, visibility))
        visible.append(np.full(out.triangle_count - first, visibility, np.uint8))
        kind.append(BAKED_MESH)
        base.append(first)
        instance_base.append(0)
    baked_count = out.triangle_count

    transforms, slot_offset, slot_count = [], [], []
    shared_meshes: dict[int, TriangleGeometry] = {}
    placed_count = 0
    for mesh, visibility, rows in instanced:
        center = _center(mesh)
        if id(mesh) not in shared_meshes:
            first = out.add(mesh, (mesh.vertices - center).astype(np.float32), mesh.normals, _slots(mesh))
            shared_meshes[id(mesh)] = TriangleGeometry(first, len(mesh.triangles), 0)
        shared_mesh = shared_meshes[id(mesh)]
        matrices = _moved_origin(instances.transforms[rows], center)
        shapes.append(InstanceGeometry(shared_mesh, matrices, visibility))
        kind.append(INSTANCED_MESH)
        base.append(shared_mesh.first)
        instance_base.append(placed_count)
        placed_count += len(rows)
        transforms.append(matrices)
        slot_offset.append(instances.material_offset[rows])
        slot_count.append(instances.slot_count[rows])

    tables = Geometry(
        accel=np.zeros(1, np.uint64),
        vertices=_join(out.vertices, (0, 3), np.float32, padding=2),
        triangles=_join(out.triangles, (0, 3), np.uint32),
        triangle_slot=_join(out.slots, (0,), np.int32),
        normals=_join(out.normals, (0, 3), np.float32),
        normal_triangles=own(out.joined_normal_triangles(), np.uint32),
        kind=np.array(kind, np.int32),
        base=np.array(base, np.int32),
        instance_base=np.array(instance_base, np.int32),
        transforms=_join(transforms, (0, 3, 4), np.float32),
        slot_offset=_join(slot_offset, (0,), np.int32),
        slot_count=_join(slot_count, (0,), np.int32),
        slots=own(instances.material_table, np.int32),
        materials=materials,
    )
    used = np.zeros(len(materials), bool)
    used[np.unique(tables.triangle_slot[:baked_count])] = True
    if placed_count:
        used[instances.material_table] = True
    seen = materials[used]
    bounced = instances.visibility & SCATTERED
    features = {
        # An object that blocks shadow rays only, or only the others, makes the two ways of finding light disagree.
        "shared_light": int(np.all((bounced == 0) | (bounced == SCATTERED))),
        "phong": int(np.any(seen[:, KS : KS + 3] > 0)),
        "smooth": int(bool(out.normals)),
        "instances": int(placed_count > 0),
        "transparency": int(np.any(seen[:, TRANSPARENCY : TRANSPARENCY + 3] > 0)),
    }
    return PackedGeometry(tables, baked_count, _join(visible, (0,), np.uint8), shapes, features)


def own(values, dtype) -> np.ndarray:
    """A fresh array for a table. Numba compiles a kernel anew, for seconds, if one is strided or read-only."""
    return np.array(values, dtype, order="C")


def pack_materials(scene: Scene) -> np.ndarray:
    """(M, 16) float32, see kernels/tables.py."""
    table = np.zeros((len(scene.materials), MATERIAL_WORDS), np.float32)
    for row, material in zip(table, scene.materials, strict=True):
        row[KD : KD + 3] = material.kd
        row[KS : KS + 3] = material.ks
        row[EXPONENT] = min(material.exponent, MAX_EXPONENT)
        row[EMISSION : EMISSION + 3] = material.emission
        row[TRANSPARENCY : TRANSPARENCY + 3] = material.transparency
    return table


def _instances_by_mesh(instances: Instances, mesh_count: int) -> list[np.ndarray]:
    """Rows of the instances of each mesh."""
    order = np.argsort(instances.mesh, kind="stable")
    ends = np.searchsorted(instances.mesh[order], np.arange(mesh_count + 1))
    return [order[a:b] for a, b in pairwise(ends)]


def _instances_that_emit(instances: Instances, materials: np.ndarray) -> np.ndarray:
    """(I,) bool: some slot of the instance has an emissive material."""
    glows = np.any(materials[:, EMISSION : EMISSION + 3] > 0, axis=1)
    running = np.concatenate([[0], np.cumsum(glows[instances.material_table])])
    return running[instances.material_offset + instances.slot_count] > running[instances.material_offset]


def _squeezed(transforms: np.ndarray) -> np.ndarray:
    """(I,) bool: the matrix has no inverse worth the name."""
    linear = np.asarray(transforms, np.float64)[:, :, :3]
    lengths = np.prod(np.linalg.norm(linear, axis=1), axis=1)
    return ~(np.abs(np.linalg.det(linear)) > FLATTEST_INSTANCE * lengths)


def _center(mesh: Mesh) -> np.ndarray:
    """(3,) float64, the middle of the mesh's box. Shared meshes are stored about it: the hit points of one that lies
    far from its own origin would be too coarse to start rays from."""
    return (mesh.vertices.min(axis=0).astype(np.float64) + mesh.vertices.max(axis=0)) / 2


def _moved_origin(transforms: np.ndarray, center: np.ndarray) -> np.ndarray:
    """(I, 3, 4) float32: the same placement for vertices from which `center` was subtracted. In float64, rounded
    once."""
    moved = np.array(transforms, np.float64)
    moved[:, :, 3] += moved[:, :, :3] @ center
    return moved.astype(np.float32)


def _slots(mesh: Mesh) -> np.ndarray:
    if mesh.material_slots is None:
        return np.zeros(len(mesh.triangles), np.int32)
    return np.asarray(mesh.material_slots, np.int32)


def _bake(out: _Triangles, mesh: Mesh, instances: Instances, row: int) -> None:
    """Append a mesh in world space, its slots replaced by materials. In float64, rounded once."""
    matrix = np.asarray(instances.transforms[row], np.float64)
    if np.array_equal(matrix, np.eye(3, 4)):
        vertices, normals = mesh.vertices, mesh.normals
    else:
        vertices = (mesh.vertices @ matrix[:, :3].T + matrix[:, 3]).astype(np.float32)
        normals = None if mesh.normals is None else _transform_normals(mesh.normals, matrix)
    offset, count = int(instances.material_offset[row]), int(instances.slot_count[row])
    slots = np.clip(_slots(mesh), 0, count - 1)
    out.add(mesh, vertices, normals, np.asarray(instances.material_table, np.int32)[offset + slots])


def _transform_normals(normals: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """By the matrix of cofactors, so that they keep to the side that the transformed triangle's winding gives."""
    x, y, z = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    turned = normals @ cofactors.T
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return np.divide(turned, length, out=np.zeros_like(turned), where=length > 0).astype(np.float32)


def _join(parts: list[np.ndarray], empty_shape: tuple[int, ...], dtype, padding: int = 0) -> np.ndarray:
    """Concatenate, with `padding` rows of zeros past the end that no index reaches."""
    rest = empty_shape[1:]
    total = sum(len(p) for p in parts)
    out = np.empty((total + padding, *rest), dtype)
    at = 0
    for part in parts:
        out[at : at + len(part)] = part
        at += len(part)
    out[total:] = 0
    return out
