"""Evaluated meshes to `engine.Mesh`, through the attribute arrays: nothing here loops over vertices in Python.

For a million triangles in quads: positions and corner vertices 1 ms, corner normals 2 ms, triangle corners 3 ms if
they are read where they lie and 80 ms through RNA.
"""

from __future__ import annotations

import ctypes

import numpy as np

from ...engine import Mesh
from .stop import Stop

TRIANGLE_BYTES = 12  # three 32 bit corners
FEW = 1000  # triangles, for which asking takes less time than checking where they lie


def export_mesh(data, name: str, stop: Stop, with_uvs: bool = False) -> Mesh | None:
    """Of an evaluated bpy mesh; None where it has no faces. Copies everything, keeps nothing of Blender's."""
    if not len(data.polygons):
        return None
    data.calc_loop_triangles()
    count = len(data.loop_triangles)
    if not count:
        return None
    positions = _positions(data)
    stop.check()
    corners = _triangle_corners(data, count)
    # Clipping takes no time, and it lets numpy skip a check of all indices before the first.
    triangles = np.take(_corner_vertices(data), corners, mode="clip")
    stop.check()
    normals, normal_indices = _normals(data, corners)
    return Mesh(
        name=name,
        vertices=positions,
        triangles=triangles,
        normals=normals,
        normal_indices=normal_indices,
        material_slots=_material_slots(data, count),
        uvs=_uvs(data, corners) if with_uvs else None,
    )


def _positions(data) -> np.ndarray:
    """(V, 3) float32."""
    flat = np.empty(len(data.vertices) * 3, np.float32)
    data.attributes["position"].data.foreach_get("vector", flat)
    return flat.reshape(-1, 3)


def _corner_vertices(data) -> np.ndarray:
    """(C,) uint32, the vertex at each face corner."""
    vertices = np.empty(len(data.loops), np.int32)
    data.attributes[".corner_vert"].data.foreach_get("value", vertices)
    return vertices.view(np.uint32)


def _triangle_corners(data, count: int) -> np.ndarray:
    """(T, 3) int32, the face corners of each triangle, read-only: it may be Blender's own table."""
    if len(data.loops) == 3 * count == 3 * len(data.polygons):
        return np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    if count > FEW and (table := _table_in_place(data.loop_triangles)) is not None:
        return table
    corners = np.empty(3 * count, np.int32)
    data.loop_triangles.foreach_get("loops", corners)
    return corners.reshape(-1, 3)


def _table_in_place(loop_triangles) -> np.ndarray | None:
    """Blender's own table of triangle corners, (T, 3) int32, without a copy; None where its layout is another.

    RNA hands the corners out one triangle at a time. They lie one after the other in every version so far, which is
    checked: the distances of the elements, and the contents of the first and the last.
    """
    last = len(loop_triangles) - 1
    start = loop_triangles[0].as_pointer()
    if any(loop_triangles[i].as_pointer() - start != TRIANGLE_BYTES * i for i in {min(1, last), last // 2, last}):
        return None
    table = np.ctypeslib.as_array((ctypes.c_int32 * (3 * (last + 1))).from_address(start)).reshape(-1, 3)
    alike = all(tuple(table[i]) == tuple(loop_triangles[i].loops) for i in (0, last // 2, last))
    return table if alike else None


def _normals(data, corners: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Shading normals in Blender's own finest needed domain: none, one for each vertex, or one for each corner."""
    domain = data.normals_domain
    if domain == "FACE":
        return None, None
    source = data.vertex_normals if domain == "POINT" else data.corner_normals
    flat = np.empty(len(source) * 3, np.float32)
    source.foreach_get("vector", flat)
    return flat.reshape(-1, 3), None if domain == "POINT" else corners.astype(np.uint32)


def _uvs(data, corners: np.ndarray) -> np.ndarray | None:
    """(T, 3, 2) float32 of the map that is ticked for renders; None without one."""
    layer = next((layer for layer in data.uv_layers if layer.active_render), None)
    if layer is None:
        return None
    flat = np.empty(2 * len(data.loops), np.float32)
    layer.uv.foreach_get("vector", flat)
    return flat.reshape(-1, 2)[corners]


def _material_slots(data, count: int) -> np.ndarray | None:
    """(T,) int32, or None where all faces use the first slot."""
    attribute = data.attributes.get("material_index")
    if attribute is None or attribute.domain != "FACE" or attribute.data_type != "INT":
        return None
    of_face = np.empty(len(data.polygons), np.int32)
    attribute.data.foreach_get("value", of_face)
    if not of_face.any():
        return None
    if count == len(of_face):
        return of_face
    faces = np.empty(count, np.int32)
    data.loop_triangle_polygons.foreach_get("value", faces)
    return of_face[faces]
