"""The `Phong BSDF` node group and its entry in the shader editor."""

from __future__ import annotations

import sys

import bpy
import numpy as np
import pytest

from tools.lobe_blender import MODULE


@pytest.fixture
def phong():
    return sys.modules[f"{MODULE}.addon.phong_group"]


def test_sockets(phong) -> None:
    tree = phong.phong_group()
    sockets = {(item.in_out, item.name): item.socket_type for item in tree.interface.items_tree}
    assert sockets == {
        ("INPUT", "kd"): "NodeSocketColor",
        ("INPUT", "ks"): "NodeSocketColor",
        ("INPUT", "exponent"): "NodeSocketFloat",
        ("OUTPUT", "BSDF"): "NodeSocketShader",
    }


def test_made_once_and_known_by_mark_and_name(phong) -> None:
    tree = phong.phong_group()
    tree.name = "renamed"
    assert phong.phong_group() is tree
    assert phong.is_phong_tree(tree)
    assert not phong.is_phong_tree(None)
    assert not phong.is_phong_tree(bpy.data.node_groups.new("other", "ShaderNodeTree"))


def is_known_by_all(phong, tree) -> bool:
    """Of the menu, the export and Cycles' peer, who have to be of one mind."""
    peer, walk = (sys.modules[f"{MODULE}.addon.{name}"] for name in ("compare.peer", "export.materials.tree"))
    material = bpy.data.materials.new("Any")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeGroup")
    node.node_tree = tree
    known = {walk.is_phong_group(node), tree in peer.phong_groups(), phong.phong_group() == tree}
    assert len(known) == 1
    return known.pop()


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("marked", [False, True])
@pytest.mark.parametrize("lacking", ["", "ks"])
def test_all_know_the_same_groups(phong, named: bool, marked: bool, lacking: str) -> None:
    """Without an input it can't be read as one, nor can Cycles' closure be put in."""
    tree = phong.phong_group()
    if not named:
        tree.name = "renamed"
    if not marked:
        del tree[phong.PHONG_MARK]
    if lacking:
        tree.interface.remove(tree.interface.items_tree[lacking])
    assert is_known_by_all(phong, tree) == ((named or marked) and not lacking)


def test_defaults_conserve_energy(phong) -> None:
    inputs = {i.name: i for i in phong.phong_group().interface.items_tree if i.in_out == "INPUT"}
    assert np.all(np.array(inputs["kd"].default_value)[:3] + np.array(inputs["ks"].default_value)[:3] <= 1.0)
    assert inputs["exponent"].min_value == 0.0


@pytest.mark.skipif("cycles" not in bpy.context.preferences.addons, reason="Cycles is not enabled")
def test_cycles_renders_it(phong, simple_scene, rendered) -> None:
    """Only that it shows light of the right order: Cycles' lobe is another one."""
    scene = simple_scene
    material = bpy.data.materials.new("Phong")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    tree = material.node_tree
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = phong.phong_group()
    tree.links.new(node.outputs["BSDF"], tree.get_output_node("ALL").inputs["Surface"])
    bpy.ops.mesh.primitive_plane_add(size=100, location=(0, 5, 0), rotation=(np.pi / 2, 0, 0))
    bpy.context.object.data.materials.append(material)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 16
    assert rendered(scene)[..., :3].mean() == pytest.approx(0.8, abs=0.03)


def test_menu_entry(phong) -> None:
    assert phong.LOBE_OT_add_phong_node.is_registered
    assert not bpy.ops.lobe.add_phong_node.poll()  # no shader editor here: the entry must refuse, not fail
