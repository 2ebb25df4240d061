"""Meshes, instances and materials to triangle tables.

A mesh that is used once, or so small that its copies cost nothing, is baked: its triangles go to world space and
into one Embree geometry with all others of the same visibility, which is the fastest to trace. The rest becomes
Embree instances of a shared mesh. Emissive meshes are always baked, as each of their triangles is a light.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import groupby, pairwise

import numpy as np

from ..accel import InstanceGeometry, TriangleGeometry
from ..kernels.tables import (
    BAKED_MESH,
    EMISSION,
    EXPONENT,
    HOLDOUT,
    INSTANCED_MESH,
    KD,
    KS,
    MATERIAL_WORDS,
    TRANSPARENCY,
    Geometry,
)
from ..memory import foresee, need_of
from ..scene import Instances, Mesh, Scene, Visibility

# A mesh whose copies have no more triangles than this in all is baked: they fit the cache, and a two-level
# traversal costs more than they do.
BAKE_LIMIT = 1 << 16
# An instance matrix that squeezes space by more than this turns rays into the mesh's space with too few digits left
# for their starts to be off its surfaces: baked instead.
FLATTEST_INSTANCE = 0.05

# Sharper mirrors cannot be told apart, and the kernels' float32 keeps to numbers that it can square.
MAX_EXPONENT = 1e8

# Embree takes triangles for points whose area, in the mesh's own space, is below 1e-18: a shared mesh of another size
# than this, metres, is stored at a size of about 1, and its placements make up for it.
ORDINARY_SIZES = 1e-3, 1e3

VERTEX_PADDING = 2  # rows that no triangle uses: Embree and the kernels read 16 bytes at the last vertex
CHUNK = 1 << 13
INVALID = np.uint32(0xFFFFFFFF)
SCATTERED = int(Visibility.DIFFUSE | Visibility.GLOSSY | Visibility.SHADOW)


@dataclass
class PackedGeometry:
    """`tables` lacks the lamps' shapes and the Embree address; `shapes` go to Embree in the order of their ids."""

    tables: Geometry
    baked_count: int  # of triangles in world space; they come first
    visibility: np.ndarray  # (baked_count,) uint8
    shapes: list[TriangleGeometry | InstanceGeometry]
    used: np.ndarray  # (M,) bool: some triangle has the material
    features: dict[str, int]

    def with_materials(self, materials: np.ndarray) -> PackedGeometry:
        """The same surfaces with another table of as many materials, of which the same emit."""
        tables = self.tables._replace(materials=materials)
        return replace(self, tables=tables, features={**self.features, **_material_features(materials[self.used])})


def pack_geometry(scene: Scene, passes: tuple[str, ...] = ()) -> PackedGeometry:
    """Everything that has triangles. See the module's text for what is baked and what is instanced. passes: of the
    picture, which the memory must hold too."""
    instances = scene.instances
    materials = pack_materials(scene)
    baked, shared = plan(scene, materials)
    meshes = [scene.meshes[mesh] for mesh, _ in baked] + [scene.meshes[mesh] for mesh in shared]
    foresee(need_of(scene, meshes, sum(map(len, shared.values())), passes))
    out = _Triangles(meshes)
    shapes = _Shapes()
    _add_baked(scene, baked, out, shapes)
    baked_count = out.triangle_count
    _add_shared(scene, shared, out, shapes)
    tables = Geometry(
        accel=np.zeros(1, np.uint64),
        vertices=out.vertices,
        triangles=out.triangles,
        triangle_slot=out.slots,
        normals=out.normals,
        normal_triangles=out.normal_triangles,
        kind=np.array(shapes.kind, np.int32),
        base=np.array(shapes.base, np.int32),
        instance_base=np.array(shapes.instance_base, np.int32),
        transforms=_join(shapes.transforms, (0, 3, 4), np.float32),
        slot_offset=_join(shapes.slot_offset, (0,), np.int32),
        slot_count=_join(shapes.slot_count, (0,), np.int32),
        slots=fresh(instances.material_table, np.int32),
        materials=materials,
    )
    used = np.zeros(len(materials), bool)
    used[out.slots[:baked_count]] = True
    if shared:
        used[instances.material_table] = True
    bounced = instances.visibility & SCATTERED
    features = {
        # An object that blocks shadow rays only, or only the others, makes the two ways of finding light disagree.
        "shared_light": int(np.all((bounced == 0) | (bounced == SCATTERED))),
        "smooth": int(out.has_normals),
        "instances": int(bool(shared)),
        **_material_features(materials[used]),
    }
    visibility = instances.visibility[[row for _, row in baked]]
    counts = [len(scene.meshes[mesh].triangles) for mesh, _ in baked]
    return PackedGeometry(tables, baked_count, np.repeat(visibility, counts), shapes.shapes, used, features)


def _material_features(seen: np.ndarray) -> dict[str, int]:
    """What the materials of a scene's surfaces ask of the kernels. seen (M, 16)."""
    return {
        "phong": int(np.any(seen[:, KS : KS + 3] > 0)),
        "transparency": int(np.any(seen[:, TRANSPARENCY : TRANSPARENCY + 3] > 0)),
        "holdout": int(np.any(seen[:, HOLDOUT] > 0)),
    }


def plan(scene: Scene, materials: np.ndarray) -> tuple[list[tuple[int, int]], dict[int, np.ndarray]]:
    """(what is baked, as mesh and row of the instance, sorted by visibility; the rows of each mesh that is shared)."""
    instances = scene.instances
    emits = _instances_that_emit(instances, materials)
    flat = _squeezed(instances.transforms)
    baked: list[tuple[int, int]] = []
    shared: dict[int, np.ndarray] = {}
    for index, (mesh, rows) in enumerate(zip(scene.meshes, _rows_of_meshes(scene), strict=True)):
        rows = rows[instances.visibility[rows] != 0]
        if not len(rows) or not len(mesh.triangles):
            continue
        bake = np.ones(len(rows), bool)
        if len(rows) > 1 and len(rows) * len(mesh.triangles) > BAKE_LIMIT:
            bake = emits[rows] | flat[rows]
        baked += [(index, int(row)) for row in rows[bake]]
        if not bake.all():
            shared[index] = rows[~bake]
    baked.sort(key=lambda placed: instances.visibility[placed[1]])
    return baked, shared


def corners(triangles: int) -> np.ndarray:
    """(triangles, 3) uint32, empty, with memory behind it: the kernels read 16 bytes at the last triangle."""
    return np.empty((triangles + 1, 3), np.uint32)[:triangles]


class _Triangles:
    """The arrays of all triangles, allocated once and filled mesh by mesh."""

    def __init__(self, meshes: list[Mesh]):
        vertices, triangles = sum(len(m.vertices) for m in meshes), sum(len(m.triangles) for m in meshes)
        normals = sum(len(m.normals) for m in meshes if m.normals is not None)
        self.has_normals = normals > 0
        self.vertices = np.empty((vertices + VERTEX_PADDING, 3), np.float32)
        self.vertices[vertices:] = 0
        self.triangles = corners(triangles)
        self.slots = np.empty(triangles, np.int32)
        self.normals = np.empty((normals + VERTEX_PADDING, 3), np.float32)
        self.normals[normals:] = 0
        # Where every vertex of every mesh has its normal, the two are numbered alike.
        self._alike = all(m.normals is not None and m.normal_indices is None for m in meshes)
        self._alike &= normals == vertices
        self.normal_triangles = self.triangles
        if not self._alike:
            self.normal_triangles = corners(triangles if normals else 0)
        self._vertex_count = self.triangle_count = self._normal_count = 0

    def add(self, mesh: Mesh, matrix: np.ndarray, slots: np.ndarray | int) -> TriangleGeometry:
        """Write a mesh, moved by `matrix` (3, 4)."""
        first, count = self.triangle_count, len(mesh.triangles)
        rows = slice(first, first + count)
        _transform(mesh.vertices, matrix[:, :3], matrix[:, 3], self.vertices[self._vertex_count :])
        np.add(mesh.triangles, np.uint32(self._vertex_count), out=self.triangles[rows])
        self.slots[rows] = slots
        if mesh.normals is None:
            if self.has_normals:
                self.normal_triangles[rows] = INVALID
        else:
            _transform_normals(mesh.normals, matrix[:, :3], self.normals[self._normal_count :])
            if not self._alike:
                indices = mesh.triangles if mesh.normal_indices is None else mesh.normal_indices
                np.add(indices, np.uint32(self._normal_count), out=self.normal_triangles[rows])
            self._normal_count += len(mesh.normals)
        self._vertex_count += len(mesh.vertices)
        self.triangle_count += count
        return TriangleGeometry(self.vertices, self.triangles[rows], 0)


@dataclass
class _Shapes:
    """The Embree geometries, and by their ids what the kernels need to know of each."""

    shapes: list[TriangleGeometry | InstanceGeometry] = field(default_factory=list)
    kind: list[int] = field(default_factory=list)
    base: list[int] = field(default_factory=list)
    instance_base: list[int] = field(default_factory=list)
    transforms: list[np.ndarray] = field(default_factory=list)
    slot_offset: list[np.ndarray] = field(default_factory=list)
    slot_count: list[np.ndarray] = field(default_factory=list)
    instance_count: int = 0

    def add(self, shape: TriangleGeometry | InstanceGeometry, kind: int, base: int) -> None:
        self.shapes.append(shape)
        self.kind.append(kind)
        self.base.append(base)
        self.instance_base.append(self.instance_count)


def _add_baked(scene: Scene, baked: list[tuple[int, int]], out: _Triangles, shapes: _Shapes) -> None:
    """In world space, slots replaced by materials: one Embree geometry for each visibility."""
    instances = scene.instances
    for visibility, placed in groupby(baked, key=lambda placed: int(instances.visibility[placed[1]])):
        first = out.triangle_count
        for index, row in placed:
            mesh, offset = scene.meshes[index], int(instances.material_offset[row])
            materials = instances.material_table[offset : offset + int(instances.slot_count[row])]
            slots = mesh.material_slots
            out.add(
                mesh,
                np.asarray(instances.transforms[row], np.float64),
                materials[0] if slots is None else materials[np.clip(slots, 0, len(materials) - 1)],
            )
        whole = TriangleGeometry(out.vertices, out.triangles[first : out.triangle_count], visibility)
        shapes.add(whole, BAKED_MESH, first)


def _add_shared(scene: Scene, shared: dict[int, np.ndarray], out: _Triangles, shapes: _Shapes) -> None:
    """In object space, about the middle of the mesh's box: the hit points of a mesh that lies far from its own origin
    would be too coarse to start rays from. One Embree geometry of instances for each mesh and visibility."""
    smallest, largest = ORDINARY_SIZES
    instances = scene.instances
    for index, rows in shared.items():
        mesh, first = scene.meshes[index], out.triangle_count
        bounds = mesh.bounds().astype(np.float64)
        center, size = bounds.mean(axis=0), np.ptp(bounds, axis=0).max()
        factor = 1.0 if smallest <= size <= largest or size == 0 else 2.0 ** -np.floor(np.log2(size))
        to_center = factor * np.column_stack([np.eye(3), -center])
        geometry = out.add(mesh, to_center, 0 if mesh.material_slots is None else mesh.material_slots)
        for visibility, members in by_visibility(instances, rows):
            matrices = _stored_otherwise(instances.transforms[members], center, factor)
            shapes.add(InstanceGeometry(geometry, matrices, visibility), INSTANCED_MESH, first)
            shapes.instance_count += len(members)
            shapes.transforms.append(matrices)
            shapes.slot_offset.append(instances.material_offset[members])
            shapes.slot_count.append(instances.slot_count[members])


def by_visibility(instances: Instances, rows: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """A mesh's instances in the order in which they are packed: (visibility, rows)."""
    for visibility in np.unique(instances.visibility[rows]):
        yield int(visibility), rows[instances.visibility[rows] == visibility]


def fresh(values, dtype) -> np.ndarray:
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
        row[HOLDOUT] = material.holdout
    return table


def _rows_of_meshes(scene: Scene) -> list[np.ndarray]:
    """Of each mesh the rows of its instances."""
    order = np.argsort(scene.instances.mesh, kind="stable")
    ends = np.searchsorted(scene.instances.mesh[order], np.arange(len(scene.meshes) + 1))
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


def _stored_otherwise(transforms: np.ndarray, center: np.ndarray, factor: float) -> np.ndarray:
    """(I, 3, 4) float32: the same placement for vertices from which `center` was subtracted, and which were then
    multiplied by `factor`. In float64, rounded once."""
    moved = np.array(transforms, np.float64)
    moved[:, :, 3] += moved[:, :, :3] @ center
    moved[:, :, :3] /= factor
    return fresh(moved, np.float32)


def _transform(points: np.ndarray, linear: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
    """points (n, 3) float32 into the first rows of `out`. In float64, rounded once."""
    if np.array_equal(linear, np.eye(3)) and not origin.any():
        out[: len(points)] = points
        return
    for rows in _chunks(len(points)):
        out[rows] = points[rows] @ linear.T + origin


def _transform_normals(normals: np.ndarray, linear: np.ndarray, out: np.ndarray) -> None:
    """By the matrix of cofactors, so that they keep to the side that the transformed triangle's winding gives."""
    if np.array_equal(linear, np.eye(3)) and _are_unit(normals):
        out[: len(normals)] = normals
        return
    columns = linear.T
    cofactors = np.cross(columns[[1, 2, 0]], columns[[2, 0, 1]]).T  # at once: a call takes longer than its sums
    for rows in _chunks(len(normals)):
        turned = normals[rows] @ cofactors.T
        length = np.sqrt(np.einsum("ij,ij->i", turned, turned))[:, None]
        out[rows] = np.divide(turned, length, out=np.zeros_like(turned), where=length > 0)


def _are_unit(vectors: np.ndarray) -> bool:
    """Of (n, 3) float32. Others would weigh more, or less, between the corners of a triangle."""
    with np.errstate(over="ignore"):
        squared = np.einsum("ij,ij->i", vectors, vectors)
    return bool(np.all(np.abs(squared - 1) < 1e-3))


def _chunks(count: int) -> Iterator[slice]:
    """Parts of an array whose temporaries fit the cache, which makes numpy some four times as fast."""
    return (slice(first, min(first + CHUNK, count)) for first in range(0, count, CHUNK))


def _join(parts: list[np.ndarray], empty_shape: tuple[int, ...], dtype) -> np.ndarray:
    """Concatenated; `empty_shape` where there is none."""
    return np.concatenate([np.empty(empty_shape, dtype), *parts], dtype=dtype)
