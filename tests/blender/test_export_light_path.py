"""Light Path in materials, worlds and lamps: the constants that stand for its outputs are Cycles' values."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe.addon.export import export_scene

from tests.blender.export_checks import (
    add_camera,
    add_object,
    cycles_picture,
    depsgraph,
    new_material,
    node_tree,
    plane_mesh,
    warnings_of,
)

KINDS = ("material", "world", "lamp")
SHINES = {"material": "ShaderNodeEmission", "world": "ShaderNodeBackground", "lamp": "ShaderNodeEmission"}
BASE = 4  # no output is as large in these scenes


def stage(kind: str):
    """A floor that the camera looks at: white and lit, or shining itself. Gives back the tree and what shines in it."""
    floor = plane_mesh()
    add_object("Floor", floor)
    add_camera(location=(0, 0, 5))
    if kind == "material":
        material, shines = new_material("M", SHINES[kind])
        floor.materials.append(material)
        return material.node_tree, shines
    floor.materials.append(new_material("White", "ShaderNodeBsdfDiffuse", Color=(1, 1, 1, 1))[0])
    if kind == "world":
        datablock = bpy.context.scene.world = bpy.data.worlds.new("World")
    else:
        datablock = bpy.data.lights.new("Lamp", "SUN")
        add_object("Lamp", datablock, (0, 0, 3))
    tree = node_tree(datablock)
    return tree, next(node for node in tree.nodes if node.bl_idname == SHINES[kind])


def shone(kind: str) -> np.ndarray:
    """(3,): what the exported scene shines with."""
    scene = export_scene(depsgraph())
    if kind == "material":
        return np.array(scene.materials[1].emission)
    return np.array(scene.world.color if kind == "world" else scene.lights[0].irradiance)


def outputs() -> list[str]:
    tree = node_tree(bpy.data.materials.new("Any"))
    return [socket.name for socket in tree.nodes.new("ShaderNodeLightPath").outputs]


def feed_all(tree, shines) -> None:
    """Make the emission the digits of all outputs but Ray Length, a part of them in each channel."""
    path, combine = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeCombineXYZ")
    names = [name for name in outputs() if name != "Ray Length"]
    sums: list = [None] * 3
    for i, name in enumerate(names):
        add = tree.nodes.new("ShaderNodeMath")
        add.operation = "MULTIPLY_ADD"
        add.inputs[1].default_value, add.inputs[2].default_value = BASE ** (i // 3), 0.0
        tree.links.new(path.outputs[name], add.inputs[0])
        if sums[i % 3] is not None:
            tree.links.new(sums[i % 3], add.inputs[2])
        sums[i % 3] = add.outputs[0]
    for i, total in enumerate(sums):
        tree.links.new(total, combine.inputs[i])
    tree.links.new(combine.outputs[0], shines.inputs["Color"])


@pytest.mark.parametrize("kind", KINDS)
def test_light_path_counts_as_cycles_has_it(kind, tmp_path):
    tree, shines = stage(kind)
    shines.inputs["Color"].default_value, shines.inputs["Strength"].default_value = (1, 1, 1, 1), 1.0
    plain, in_cycles = shone(kind), cycles_picture(4, 4, 64, tmp_path).mean(axis=(0, 1))
    feed_all(tree, shines)
    of_cycles = cycles_picture(4, 4, 64, tmp_path).mean(axis=(0, 1)) / in_cycles
    assert shone(kind) / plain == pytest.approx(of_cycles, rel=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_no_output_of_light_path_counts_as_unplugged(kind):
    tree, shines = stage(kind)
    path, add = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeMath")
    add.inputs[1].default_value = 1.0
    tree.links.new(add.outputs[0], shines.inputs["Strength"])
    for name in outputs():
        tree.links.new(path.outputs[name], add.inputs[0])
        (warning,) = warnings_of(export_scene(depsgraph()))
        assert f"Light Path is not supported, '{name}' counts as " in warning
