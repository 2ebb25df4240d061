"""What the export tests share: scenes made in a few lines, and the picture that Cycles makes of them."""

from __future__ import annotations

import bpy
import numpy as np


def depsgraph():
    return bpy.context.evaluated_depsgraph_get()


def in_render(function, callback: str = "update"):
    """What `function(engine, depsgraph)` gives in a render, where Blender evaluates more than for the viewport."""
    results, errors = [], []

    def run(engine, graph):
        try:
            results.append(function(engine, graph))
        except Exception as error:  # Blender would print it and go on.
            errors.append(error)

    class Probe(bpy.types.RenderEngine):
        bl_idname, bl_label = "LOBE_TEST_PROBE", "Probe"

        def update(self, data, depsgraph):
            if callback == "update":
                run(self, depsgraph)

        def render(self, depsgraph):
            if callback == "render":
                run(self, depsgraph)

    scene = bpy.context.scene
    engine_before = scene.render.engine
    bpy.utils.register_class(Probe)
    try:
        scene.render.engine = "LOBE_TEST_PROBE"
        bpy.ops.render.render()
    finally:
        scene.render.engine = engine_before
        bpy.utils.unregister_class(Probe)
    if errors:
        raise errors[0]
    return results[0]


def add_object(name: str, data, location=(0, 0, 0), rotation=(0, 0, 0), scale=(1, 1, 1)):
    object_ = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(object_)
    object_.location, object_.rotation_euler, object_.scale = location, rotation, scale
    return object_


def add_camera(location=(0, 0, 10), rotation=(0, 0, 0), **properties):
    """Makes it the scene's camera. Unrotated it looks straight down, with +y up in the picture."""
    data = bpy.data.cameras.new("Camera")
    for key, value in properties.items():
        setattr(data, key, value)
    bpy.context.scene.camera = add_object("Camera", data, location, rotation)
    return bpy.context.scene.camera


def plane_mesh(size: float = 10.0, name: str = "Plane"):
    """A square around the origin that faces up; the length of a side is 2 `size`."""
    mesh = bpy.data.meshes.new(name)
    corners = [(-size, -size, 0), (size, -size, 0), (size, size, 0), (-size, size, 0)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    return mesh


def node_tree(datablock):
    """Of a material, world or lamp, with nodes switched on where this Blender asks for that."""
    if bpy.app.version < (5, 0) or isinstance(datablock, bpy.types.Light):
        datablock.use_nodes = True
    return datablock.node_tree


def new_material(name: str, bl_idname: str, **inputs):
    """A material whose surface is one node with these inputs (`_` for a space); gives back both."""
    material = bpy.data.materials.new(name)
    tree = node_tree(material)
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    node = tree.nodes.new(bl_idname)
    for key, value in inputs.items():
        node.inputs[key.replace("_", " ")].default_value = value
    if len(node.outputs):  # A group node has none yet.
        tree.links.new(node.outputs[0], output.inputs["Surface"])
    return material, node


def warnings_of(scene) -> list[str]:
    """Of an exported scene, but for what is said of meshes without a material, which tests are full of."""
    return [warning for warning in scene.warnings if "without a material" not in warning]


def cycles_picture(width: int, height: int, samples: int, folder, **settings) -> np.ndarray:
    """(height, width, 3) scene-linear, row 0 at the bottom, of the open file with the fair settings of a comparison."""
    import OpenImageIO as oiio

    from tools.cycles_peer import apply_fair_settings

    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    apply_fair_settings(scene)
    scene.cycles.samples, scene.cycles.pixel_filter_type, scene.cycles.max_bounces = samples, "BOX", 0
    for key, value in settings.items():
        setattr(scene.cycles, key, value)
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.color_mode = "RGBA"
    render.filepath = str(folder / "cycles.exr")
    bpy.ops.render.render(write_still=True)
    image = oiio.ImageInput.open(render.filepath)
    pixels = image.read_image("float")
    image.close()
    return pixels[::-1, :, :3]
