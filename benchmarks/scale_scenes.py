"""The scenes of scale.py: a terrain of any number of triangles, a small body placed many times, and any number of
emitters over a terrain.

Scenes of a kind differ in their number alone: shape, camera, light, and the emitters' total power are the same, so that
a render of one traces about the same rays as a render of the next. Emitters lie in a layer, as street lamps or windows
do: of a cloud of n bodies a ray passes the cube root of n, whether they shine or not. Each scene is one of its own in
the open file, so that they can be rendered in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

GROUND_TRIANGLES = 10_000  # under emitters
SMALL_TRIANGLES = 100_000  # over the ground, of which some or all shine
EMITTER_AREA = 0.02  # of all lamps or small triangles together, m2: some rays in a hundred meet one
POWER = 20.0  # of all emitters together, W
BODY_TRIANGLES = 20  # of the icosahedron that is placed many times


def quads_per_side(triangles: int) -> int:
    """Of the square grid whose number of triangles comes nearest."""
    return max(round(math.sqrt(triangles / 2)), 1)


def terrain_triangles(triangles: int) -> int:
    """How many `terrain` really has, asked for so many."""
    return 2 * quads_per_side(triangles) ** 2


def grid(quads: int) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) float32 metres and (F, 4) int32: hills over the square from -1 to 1, wide enough for a coarse grid."""
    axis = np.linspace(-1, 1, quads + 1, dtype=np.float32)
    x, y = np.meshgrid(axis, axis)
    z = np.float32(0.15) * np.sin(4 * x + 1) * np.cos(np.float32(3.5) * y)
    n = quads + 1
    corner = (np.arange(quads, dtype=np.int32)[:, None] * n + np.arange(quads, dtype=np.int32)).reshape(-1, 1)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), corner + np.array([0, 1, n + 1, n], np.int32)


def places(count: int) -> np.ndarray:
    """(count, 3) float32 metres, spread over a layer above the terrain."""
    rng = np.random.default_rng(3)
    return rng.uniform((-0.9, -0.9, 0.6), (0.9, 0.9, 0.61), (count, 3)).astype(np.float32)


def small_triangles(count: int) -> tuple[np.ndarray, np.ndarray]:
    """(3 count, 3) float32 metres and (count, 3) int32: equilateral, facing all ways, EMITTER_AREA in all."""
    rng = np.random.default_rng(4)
    x, other = rng.normal(size=(2, count, 3))
    x /= np.linalg.norm(x, axis=1)[:, None]
    y = np.cross(x, other)
    y /= np.linalg.norm(y, axis=1)[:, None]
    radius = math.sqrt(EMITTER_AREA / count / (3 * math.sqrt(3) / 4))
    angle = np.arange(3) * 2 * math.pi / 3
    corners = np.cos(angle)[:, None] * x[:, None] + np.sin(angle)[:, None] * y[:, None]
    vertices = (places(count)[:, None] + radius * corners).reshape(-1, 3).astype(np.float32)
    return vertices, np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


# --- in Blender -----------------------------------------------------------------------------------------------


def empty_file() -> None:
    """Forget all scenes that were made."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def terrain(triangles: int):
    """So many triangles, smooth, under a sun."""
    scene = _scene("Terrain", triangles)
    _add(scene, "Terrain", _terrain_mesh(triangles))
    _add_sun(scene)
    return scene


def instances(count: int):
    """A body of 20 triangles on so many points, by geometry nodes."""
    import bmesh
    import bpy

    scene = _scene("Instances", count)
    body, work = bpy.data.meshes.new("Body"), bmesh.new()
    bmesh.ops.create_icosphere(work, subdivisions=1, radius=1 / math.sqrt(count))
    work.to_mesh(body)
    work.free()
    _scatter(scene, places(count), bpy.data.objects.new("Body", body))
    _add_sun(scene)
    return scene


def lamps(count: int):
    """So many spheres of light, by geometry nodes."""
    import bpy

    data = bpy.data.lights.new("Lamp", "POINT")
    data.energy, data.use_soft_falloff = POWER / count, False
    data.shadow_soft_size = math.sqrt(EMITTER_AREA / count / math.pi)
    return _with_lamps("Lamps", count, data)


def area_lamps(count: int):
    """So many squares that shine down, by geometry nodes."""
    import bpy

    data = bpy.data.lights.new("Lamp", "AREA")
    data.energy, data.size = POWER / count, math.sqrt(EMITTER_AREA / count)
    return _with_lamps("Area lamps", count, data)


def _with_lamps(kind: str, count: int, data):
    import bpy

    scene = _scene(kind, count)
    _scatter(scene, places(count), bpy.data.objects.new("Lamp", data))
    _add(scene, "Ground", _terrain_mesh(GROUND_TRIANGLES))
    return scene


def emissive_triangles(count: int):
    """So many triangles that shine, each by itself, among small ones that don't: rays and triangles stay the same."""
    scene = _scene("Emissive triangles", count)
    mesh = _mesh("Small triangles", *small_triangles(SMALL_TRIANGLES))
    mesh.materials.append(None)
    mesh.materials.append(_emission(POWER / (2 * math.pi * EMITTER_AREA * count / SMALL_TRIANGLES)))
    shines = np.zeros(SMALL_TRIANGLES, np.int32)
    shines[np.random.default_rng(5).permutation(SMALL_TRIANGLES)[:count]] = 1
    mesh.polygons.foreach_set("material_index", shines)
    _add(scene, "Small triangles", mesh)
    _add(scene, "Ground", _terrain_mesh(GROUND_TRIANGLES))
    return scene


MAKERS: dict[str, Callable] = {
    "triangles": terrain, "instances": instances, "lamps": lamps, "area lamps": area_lamps,
    "emissive triangles": emissive_triangles,
}  # fmt: skip


def _scene(kind: str, count: int):
    """Empty, seen straight from above."""
    import bpy

    scene = bpy.data.scenes.new(f"{kind} {count}")
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0, 0, 2.4)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.lobe.pixel_filter, scene.lobe.use_adaptive_sampling = "BOX", False
    return scene


def _add(scene, name: str, data):
    import bpy

    made = bpy.data.objects.new(name, data)
    scene.collection.objects.link(made)
    return made


def _add_sun(scene) -> None:
    import bpy

    _add(scene, "Sun", bpy.data.lights.new("Sun", "SUN")).rotation_euler = (0.6, 0.3, 0)


def _mesh(name: str, vertices: np.ndarray, faces: np.ndarray):
    """Of arrays: vertices (V, 3) metres, faces (F, corners)."""
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(len(faces), dtype=np.int32) * faces.shape[1])
    mesh.update()
    return mesh


def _terrain_mesh(triangles: int):
    mesh = _mesh("Terrain", *grid(quads_per_side(triangles)))
    mesh.shade_smooth()
    return mesh


def _emission(radiance: float):
    """radiance: W/(m2 sr), on both sides."""
    import bpy

    material = bpy.data.materials.new("Emission")
    if bpy.app.version < (5, 0):  # from then on materials always have nodes
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    shader, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Strength"].default_value = radiance
    links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def _scatter(scene, points: np.ndarray, placed) -> None:
    """An object whose nodes put `placed` on each of (n, 3) points; `placed` itself is in no scene."""
    import bpy

    nodes_of = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        nodes_of.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    nodes, links = nodes_of.nodes, nodes_of.links
    source, sink = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    scatter, info = nodes.new("GeometryNodeInstanceOnPoints"), nodes.new("GeometryNodeObjectInfo")
    info.inputs["Object"].default_value, info.inputs["As Instance"].default_value = placed, True
    links.new(source.outputs[0], scatter.inputs["Points"])
    links.new(info.outputs["Geometry"], scatter.inputs["Instance"])
    links.new(scatter.outputs["Instances"], sink.inputs[0])
    carrier = _add(scene, "Places", _mesh("Places", points, np.zeros((0, 3), np.int32)))
    carrier.modifiers.new("Scatter", "NODES").node_group = nodes_of
