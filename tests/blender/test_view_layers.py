"""View layers: what each leaves out, cuts out, shows to other rays alone or covers with one material, as Cycles does.

The pictures are the same to the noise: Cycles is the judge of colours and of alpha.
"""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from tests.blender.export_checks import add_object, new_material, node_tree, plane_mesh

WIDTH, HEIGHT = 32, 24
SAMPLES = 256


@pytest.fixture
def scene(simple_scene) -> bpy.types.Scene:
    """A red wall on a grey floor, under a lamp and a blue sky: light bounces between them."""
    scene = simple_scene
    node_tree(scene.world).nodes["Background"].inputs["Color"].default_value = (0.3, 0.4, 0.5, 1.0)
    scene.lobe.samples = SAMPLES
    floor = plane_mesh(6, "Floor")
    floor.materials.append(new_material("Grey", "ShaderNodeBsdfDiffuse", Color=(0.8, 0.8, 0.8, 1.0))[0])
    add_object("Floor", floor, (0, 8, -1.5))
    wall = plane_mesh(1.2, "Wall")
    wall.materials.append(new_material("Red", "ShaderNodeBsdfDiffuse", Color=(0.8, 0.1, 0.1, 1.0))[0])
    add_object("Wall", wall, (-0.8, 7, -0.3), (np.pi / 2, 0, 0.4))
    add_object("Key", bpy.data.lights.new("Key", "POINT"), (2, 4, 2)).data.energy = 300
    return scene


def in_collection(name: str):
    """Move an object into a collection of its own; gives back that of the view layer."""
    collection = bpy.data.collections.new(f"Of {name}")
    scene = bpy.context.scene
    scene.collection.children.link(collection)
    thing = bpy.data.objects[name]
    scene.collection.objects.unlink(thing)
    collection.objects.link(thing)
    return bpy.context.view_layer.layer_collection.children[collection.name]


def holdout_object(scene) -> None:
    bpy.data.objects["Wall"].is_holdout = True


def holdout_collection(scene) -> None:
    in_collection("Wall").holdout = True


def indirect_only(scene) -> None:
    in_collection("Wall").indirect_only = True


def holdout_and_indirect_only(scene) -> None:
    layer = in_collection("Wall")
    layer.indirect_only = layer.holdout = True


def excluded(scene) -> None:
    in_collection("Wall").exclude = True


def transparent_holdout(scene) -> None:
    """Half of it is a hole, the other half shows what is behind."""
    tree = bpy.data.materials["Red"].node_tree
    mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
    clear.inputs["Color"].default_value = (1.0, 0.5, 0.2, 1.0)
    tree.links.new(tree.nodes["Diffuse BSDF"].outputs[0], mix.inputs[1])
    tree.links.new(clear.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.get_output_node("ALL").inputs["Surface"])
    bpy.data.objects["Wall"].is_holdout = True


def behind_glass(scene) -> None:
    """A hole is one through transparent surfaces too."""
    pane = plane_mesh(1, "Pane")
    pane.materials.append(new_material("Clear", "ShaderNodeBsdfTransparent", Color=(0.5, 0.7, 0.9, 1.0))[0])
    add_object("Pane", pane, (-0.5, 3, 0), (np.pi / 2, 0, 0))
    bpy.data.objects["Wall"].is_holdout = True


def shining_holdout(scene) -> None:
    """Its light falls on others, and isn't seen."""
    bpy.data.meshes["Wall"].materials[0] = new_material("Glow", "ShaderNodeEmission", Strength=2.0)[0]
    bpy.data.objects["Wall"].is_holdout = True


def holdout_shader(scene) -> None:
    bpy.data.meshes["Wall"].materials[0] = new_material("Hole", "ShaderNodeHoldout")[0]


def instanced(scene, holdout: str) -> None:
    collection = bpy.data.collections.new("Things")
    wall = bpy.data.objects["Wall"]
    scene.collection.objects.unlink(wall)
    collection.objects.link(wall)
    empty = add_object("Empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    bpy.data.objects[holdout].is_holdout = True


def holdout_instancer(scene) -> None:
    instanced(scene, "Empty")


def instanced_holdout(scene) -> None:
    instanced(scene, "Wall")


def material_override(scene) -> None:
    over = new_material("Over", "ShaderNodeBsdfDiffuse", Color=(0.1, 0.7, 0.2, 1.0))[0]
    bpy.context.view_layer.material_override = over


CASES = [
    holdout_object, holdout_collection, indirect_only, holdout_and_indirect_only, excluded, transparent_holdout,
    behind_glass, shining_holdout, holdout_shader, holdout_instancer, instanced_holdout, material_override,
]  # fmt: skip


def by_cycles(scene, rendered) -> np.ndarray:
    from tools.cycles_peer import apply_fair_settings

    scene.render.engine = "CYCLES"
    apply_fair_settings(scene)
    scene.cycles.samples, scene.cycles.pixel_filter_type, scene.cycles.max_bounces = SAMPLES, "BOX", 8
    picture = rendered(scene)
    scene.render.engine = "LOBE"
    return picture


@pytest.mark.parametrize("film", ["opaque", "transparent"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_the_picture_is_that_of_cycles(scene, rendered, case, film: str) -> None:
    scene.render.film_transparent = film == "transparent"
    plain = rendered(scene)
    case(scene)
    ours, theirs = rendered(scene), by_cycles(scene, rendered)
    if case is instanced_holdout:  # the instancer alone decides
        assert np.array_equal(ours, plain)
    else:
        assert np.abs(ours - plain).mean() > 0.005
    # The mean of blocks of pixels, against the noise.
    blocks = [picture.reshape(HEIGHT // 4, 4, WIDTH // 4, 4, 4).mean(axis=(1, 3)) for picture in (ours, theirs)]
    assert np.abs(blocks[0] - blocks[1]).max() < 0.03
    assert np.abs(blocks[0] - blocks[1]).mean() < 0.004
