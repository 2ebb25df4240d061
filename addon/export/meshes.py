"""Evaluated meshes to `engine.Mesh`, through the attribute arrays: nothing here loops over vertices in Python.

The calls and their times for a million triangles are those of the project's table of fast and slow ways: positions
0.3 ms, corner vertices 0.4 ms, corner normals 2 ms, triangle corners 85 ms (none where every face is a triangle).
"""

from __future__ import annotations

import numpy as np

from ...engine import Mesh
from .stop import Stop


def export_mesh(data, name: str, stop: Stop) -> Mesh | None:
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
    triangles = _corner_vertices(data)[corners]
    stop.check()
    normals, normal_indices = _normals(data, corners)
    return Mesh(
        name=name,
        vertices=positions,
        triangles=triangles,
        normals=normals,
        normal_indices=normal_indices,
        material_slots=_material_slots(data, count),
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
    """(T, 3) int32, the face corners of each triangle. Where every face is a triangle they are in order."""
    if len(data.loops) == 3 * count == 3 * len(data.polygons):
        return np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    corners = np.empty(3 * count, np.int32)
    data.loop_triangles.foreach_get("loops", corners)
    return corners.reshape(-1, 3)


def _normals(data, corners: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Shading normals in Blender's own finest needed domain: none, one for each vertex, or one for each corner."""
    domain = data.normals_domain
    if domain == "FACE":
        return None, None
    source = data.vertex_normals if domain == "POINT" else data.corner_normals
    flat = np.empty(len(source) * 3, np.float32)
    source.foreach_get("vector", flat)
    return flat.reshape(-1, 3), None if domain == "POINT" else corners.view(np.uint32)


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
