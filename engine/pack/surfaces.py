"""What only passes show of surfaces, in the order of the triangle tables. Nothing is packed that no pass shows."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ..kernels.tables import (
    AO_DISTANCE,
    LETS_THROUGH,
    MIST_FALLOFF,
    MIST_PER_METRE,
    MIST_START,
    MOVE_FACTOR,
    MOVE_X,
    SURFACE_NUMBERS,
    Surfaces,
)
from ..scene import Mesh, Scene
from .geometry import by_visibility, plan
from .middle import Move


def pack_surfaces(scene: Scene, move: Move, materials: np.ndarray, wanted: Collection[str]) -> Surfaces:
    """scene: as it was packed, after the move; materials: as `pack_materials` has them."""
    triangles = instances = np.zeros(0, np.int32)
    uv_row, uvs = np.zeros(0, np.int32), np.zeros((0, 3, 2), np.float32)
    if "OBJECT_INDEX" in wanted or "UV" in wanted:
        baked, shared = plan(scene, materials)
        meshes = [scene.meshes[mesh] for mesh, _ in baked] + [scene.meshes[mesh] for mesh in shared]
        if "OBJECT_INDEX" in wanted:
            triangles, instances = _object_indices(scene, baked, shared)
        if "UV" in wanted:
            uv_row, uvs = _uvs(meshes)
    indices = [material.pass_index for material in scene.materials] if "MATERIAL_INDEX" in wanted else []
    return Surfaces(triangles, instances, np.array(indices, np.int32), uv_row, uvs, _numbers(scene, move))


def _object_indices(
    scene: Scene, baked: list[tuple[int, int]], shared: dict[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """(of the baked triangles, of the instances of shared meshes), int32."""
    placed = scene.instances
    of_object = np.zeros(len(placed.object_names), np.int32) if placed.pass_index is None else placed.pass_index
    of_row = of_object[placed.object]
    counts = [len(scene.meshes[mesh].triangles) for mesh, _ in baked]
    members = [rows for of_mesh in shared.values() for _, rows in by_visibility(placed, of_mesh)]
    rows = np.concatenate([np.zeros(0, np.intp), *members]).astype(np.intp)
    return np.repeat(of_row[[row for _, row in baked]].astype(np.int32), counts), of_row[rows].astype(np.int32)


def _uvs(meshes: list[Mesh]) -> tuple[np.ndarray, np.ndarray]:
    """(the row of each triangle, -1 where its mesh has none; the rows). Meshes that come twice are stored once."""
    first: dict[int, int] = {}
    rows, tables, count = [], [], 0
    for mesh in meshes:
        if mesh.uvs is None:
            rows.append(np.full(len(mesh.triangles), -1, np.int32))
            continue
        if id(mesh) not in first:
            first[id(mesh)] = count
            tables.append(mesh.uvs)
            count += len(mesh.uvs)
        rows.append(np.arange(len(mesh.triangles), dtype=np.int32) + np.int32(first[id(mesh)]))
    empty = np.zeros((0, 3, 2), np.float32)
    return np.concatenate([np.zeros(0, np.int32), *rows]), np.ascontiguousarray(np.concatenate([empty, *tables]))


def _numbers(scene: Scene, move: Move) -> np.ndarray:
    mist, numbers = scene.mist, np.zeros(SURFACE_NUMBERS)
    numbers[MIST_START] = mist.start * move.factor
    numbers[MIST_PER_METRE] = 1.0 / (mist.depth * move.factor) if mist.depth > 0 else 0.0
    numbers[MIST_FALLOFF] = mist.falloff
    numbers[AO_DISTANCE] = scene.occlusion_distance * move.factor
    numbers[LETS_THROUGH] = 1.0 - scene.alpha_threshold if scene.alpha_threshold > 0 else np.inf
    numbers[MOVE_FACTOR], numbers[MOVE_X : MOVE_X + 3] = move.factor, move.middle
    return numbers
