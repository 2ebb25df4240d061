"""What the scene scripts share: an empty file with fair settings, meshes from arrays, materials, lamps and cameras.

Each script of this folder has `build()`, which fills an empty file, and is run by make_all.py. Lengths are metres.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tools.lobe_blender import enable_lobe  # noqa: E402

enable_lobe()

import bpy  # noqa: E402
import numpy as np  # noqa: E402
from mathutils import Matrix, Vector  # noqa: E402

from tools import cycles_peer  # noqa: E402

FOLDER = Path(__file__).resolve().parent
SAVED_BY = (4, 2)  # the oldest Blender that Lobe runs in: all later ones open its files, which isn't so the other way


def new_file(width: int = 512, height: int = 512, samples: int = 64, view_transform: str = "Standard"):
    """An empty file whose scene renders with Lobe; returns the scene."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)  # unlike read_factory_settings keeps add-ons
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    prepare_scene(scene, width, height, samples, view_transform)
    set_background(scene.world, (0, 0, 0))
    return scene


def prepare_scene(scene, width: int, height: int, samples: int, view_transform: str) -> None:
    """Lobe's own defaults, and Cycles' settings as near to them as they come."""
    scene.render.engine = "LOBE"
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.view_settings.view_transform = view_transform
    scene.lobe.samples = samples
    cycles_peer.apply_fair_settings(scene)
    cycles_peer.copy_lobe_settings(scene)


def save(name: str) -> Path:
    """Write the file, packed and compressed, next to the scripts."""
    if bpy.app.version[:2] != SAVED_BY:
        version = ".".join(map(str, SAVED_BY))
        sys.exit(f"the sample files are saved by Blender {version}, not by {bpy.app.version_string}: see make_all.py")
    cycles_peer.apply_fair_settings(bpy.context.scene)  # once more, for the objects and materials made since
    forget_places()
    path = FOLDER / f"{name}.blend"
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True, relative_remap=False)
    return path


def forget_places() -> None:
    """A new file holds the temporary folder, and the home folder in its file browsers: folders of this machine."""
    for scene in bpy.data.scenes:
        scene.render.filepath = "//"
    for space in (space for screen in bpy.data.screens for area in screen.areas for space in area.spaces):
        if space.type == "FILE_BROWSER" and space.params is not None:
            space.params.directory = b"//"


# --- materials ------------------------------------------------------------------------------------------------


def empty_tree(data):
    """The node tree of a material or world, without a node."""
    if bpy.app.version < (5, 0):  # from then on they always have one
        data.use_nodes = True
    data.node_tree.nodes.clear()
    return data.node_tree


def _empty_material(name: str):
    material = bpy.data.materials.new(name)
    tree = empty_tree(material)
    return material, tree.nodes, tree.links


def _finish(material, shader_socket):
    nodes = material.node_tree.nodes
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    material.node_tree.links.new(shader_socket, output.inputs["Surface"])
    return material


def diffuse(name: str, color):
    """A Lambertian surface of reflectance `color` (linear RGB)."""
    material, nodes, _ = _empty_material(name)
    node = nodes.new("ShaderNodeBsdfDiffuse")
    node.inputs["Color"].default_value = (*color, 1)
    material.diffuse_color = (*color, 1)
    return _finish(material, node.outputs["BSDF"])


def emission(name: str, radiance, reflectance=None):
    """A surface that sends out `radiance`, W/(m2 sr) per channel, and reflects `reflectance` diffusely if given."""
    material, nodes, links = _empty_material(name)
    strength = max(radiance)
    node = nodes.new("ShaderNodeEmission")
    node.inputs["Color"].default_value = (*(c / strength for c in radiance), 1)
    node.inputs["Strength"].default_value = strength
    if reflectance is None:
        return _finish(material, node.outputs["Emission"])
    lambert, add = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeAddShader")
    lambert.inputs["Color"].default_value = (*reflectance, 1)
    node.location, lambert.location = (-200, 80), (-200, -80)
    links.new(node.outputs["Emission"], add.inputs[0])
    links.new(lambert.outputs["BSDF"], add.inputs[1])
    return _finish(material, add.outputs["Shader"])


def phong(name: str, kd, ks, exponent: float):
    """The `Phong BSDF` group that the add-on brings."""
    from bl_ext.user_default.lobe.addon import phong_group

    material, nodes, _ = _empty_material(name)
    node = nodes.new("ShaderNodeGroup")
    node.node_tree = phong_group.phong_group()
    node.inputs["kd"].default_value = (*kd, 1)
    node.inputs["ks"].default_value = (*ks, 1)
    node.inputs["exponent"].default_value = exponent
    material.diffuse_color = (*kd, 1)
    return _finish(material, node.outputs[0])


def set_background(world, color, strength: float = 1.0) -> None:
    nodes = empty_tree(world).nodes
    background, output = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    background.location, output.location = (0, 0), (220, 0)
    background.inputs["Color"].default_value = (*color, 1)
    background.inputs["Strength"].default_value = strength
    world.node_tree.links.new(background.outputs["Background"], output.inputs["Surface"])


# --- objects --------------------------------------------------------------------------------------------------


def add_object(name: str, data, location=(0, 0, 0), collection=None):
    obj = bpy.data.objects.new(name, data)
    obj.location = location
    (collection or bpy.context.scene.collection).objects.link(obj)
    return obj


def mesh(name: str, vertices, faces, materials=(), material_index=None, smooth: bool = False):
    """A mesh of arrays. vertices (V, 3) metres; faces: lists of vertex indices."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(np.asarray(vertices, float).tolist(), [], [list(map(int, f)) for f in faces])
    for material in materials:
        data.materials.append(material)
    if material_index is not None:
        data.polygons.foreach_set("material_index", np.asarray(material_index, np.int32))
    if smooth:
        data.shade_smooth()
    return data


BOX_FACES = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])


def box_vertices(low, high) -> np.ndarray:
    """(8, 3) corners, for `BOX_FACES`, whose normals point outwards."""
    return np.array([(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


def ico_sphere(name: str, radius: float, subdivisions: int, material, smooth: bool = True):
    """A ball of triangles; smooth shading makes it look round."""
    import bmesh

    work = bmesh.new()
    bmesh.ops.create_icosphere(work, subdivisions=subdivisions, radius=radius)
    data = bpy.data.meshes.new(name)
    work.to_mesh(data)
    work.free()
    data.materials.append(material)
    if smooth:
        data.shade_smooth()
    return data


def lamp(name: str, kind: str, location, target=None, visible: bool = False, **properties):
    """A lamp that looks at `target` (straight down without one). `visible`: whether the camera sees it."""
    data = bpy.data.lights.new(name, kind)
    if kind in ("POINT", "SPOT"):
        data.use_soft_falloff = False
    for key, value in properties.items():
        setattr(data, key, value)
    obj = add_object(name, data, location)
    if target is not None:
        look_at(obj, target)
    obj.visible_camera = visible
    return obj


def look_at(obj, target) -> None:
    """Turn local -z towards `target`, local y up."""
    direction = Vector(target) - obj.location
    obj.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()


def camera(scene, location, target, lens: float = 50, sensor: float = 36, name: str = "Camera"):
    data = bpy.data.cameras.new(name)
    data.lens, data.sensor_width = lens, sensor
    obj = bpy.data.objects.new(name, data)
    scene.collection.objects.link(obj)
    obj.location = location
    look_at(obj, target)
    scene.camera = obj
    return obj


__all__ = [name for name in globals() if not name.startswith("_")] + ["Matrix", "math"]
