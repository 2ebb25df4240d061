"""Cycles as Lobe's peer: the bounce limits mean the same, the Phong closure is exact, the fair settings arrive."""

from __future__ import annotations

import json

import pytest

from tools import blender_render as br
from tools import cycles_peer
from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

import bpy  # noqa: E402

KD, EMISSION = 0.5, 1.0


@pytest.fixture
def scene():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    br.set_resolution(scene, 8, 8)
    scene.lobe.pixel_filter = "BOX"
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def node_tree(datablock):
    if bpy.app.version < (5, 0):
        datablock.use_nodes = True
    return datablock.node_tree


def mean(scene, engine: str) -> float:
    br.set_engine(scene, engine)
    br.render(scene)
    return float(br.picture(scene)[..., 0].mean())


@pytest.fixture
def furnace(scene):
    """A closed cube that everywhere reflects KD and emits EMISSION, seen from inside."""
    bpy.ops.mesh.primitive_cube_add(size=2)
    material = bpy.data.materials.new("Furnace")
    tree = node_tree(material)
    tree.nodes.clear()
    lambert, glow = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeEmission")
    both, output = tree.nodes.new("ShaderNodeAddShader"), tree.nodes.new("ShaderNodeOutputMaterial")
    lambert.inputs["Color"].default_value = (KD, KD, KD, 1)
    glow.inputs["Color"].default_value = (EMISSION, EMISSION, EMISSION, 1)
    tree.links.new(lambert.outputs[0], both.inputs[0])
    tree.links.new(glow.outputs[0], both.inputs[1])
    tree.links.new(both.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    scene.lobe.samples = 256
    return scene


@pytest.mark.parametrize("engine", ["LOBE", "CYCLES"])
@pytest.mark.parametrize(("total", "diffuse", "scatterings"), [(0, 8, 1), (1, 8, 2), (3, 8, 4), (8, 0, 1), (8, 2, 3)])
def test_bounce_limits(furnace, engine, total, diffuse, scatterings):
    """L = Le sum(kd^i, i = 0 .. scatterings): a limit of k lets light scatter k + 1 times, in both engines."""
    furnace.lobe.max_bounces, furnace.lobe.diffuse_bounces = total, diffuse
    expected = EMISSION * sum(KD**i for i in range(scatterings + 1))
    assert mean(furnace, engine) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("exponent", "angle"), [(10, 60), (100, 75), (1, 45)])
@pytest.mark.parametrize("engine", ["LOBE", "CYCLES"])
def test_phong_is_exact(scene, repository, engine, exponent, angle):
    """A tilted plane under a white world shows the lobe's albedo, as computed by quadrature."""
    from math import radians

    from bl_ext.user_default.lobe.addon.phong_group import phong_group

    scene.world = bpy.data.worlds.new("World")
    node_tree(scene.world).nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    bpy.ops.mesh.primitive_plane_add(size=100, location=(0, 0, -5), rotation=(radians(angle), 0, 0))
    material = bpy.data.materials.new("Phong")
    tree = node_tree(material)
    tree.nodes.clear()
    node, output = tree.nodes.new("ShaderNodeGroup"), tree.nodes.new("ShaderNodeOutputMaterial")
    node.node_tree = phong_group()
    node.inputs["kd"].default_value, node.inputs["ks"].default_value = (0, 0, 0, 1), (1, 1, 1, 1)
    node.inputs["exponent"].default_value = exponent
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    scene.camera.data.lens = 2000  # all rays nearly parallel
    scene.lobe.samples = 1024
    rows = json.loads((repository / "tests" / "kernels" / "phong_albedo.json").read_text())["rows"]
    (expected,) = [albedo for n, degrees, albedo in rows if (n, degrees) == (exponent, angle)]
    assert mean(scene, engine) == pytest.approx(expected, rel=0.01)


def test_fair_settings(furnace):
    lobe, cycles = furnace.lobe, furnace.cycles
    lobe.max_bounces, lobe.diffuse_bounces, lobe.glossy_bounces, lobe.seed = 5, 4, 3, 9
    cycles.use_adaptive_sampling, cycles.sample_clamp_indirect, cycles.light_sampling_threshold = True, 10, 0.01
    furnace.render.use_motion_blur = True
    br.set_engine(furnace, "CYCLES")
    assert cycles.use_layer_samples == "IGNORE" and not furnace.render.use_motion_blur
    assert (cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces, cycles.seed) == (5, 4, 3, 9)
    assert cycles.pixel_filter_type == "BOX" and cycles.samples == 256
    assert not cycles.use_adaptive_sampling and not cycles.use_denoising
    assert cycles.sample_clamp_indirect == 0 and cycles.light_sampling_threshold == 0
    assert cycles_peer.shadow_terminator(bpy.data.objects["Cube"]).shadow_terminator_geometry_offset == 0
    assert bpy.data.materials["Furnace"].cycles.emission_sampling == "FRONT_BACK"
    assert not cycles.shading_system  # no Phong group, no Open Shading Language


def test_as_is_changes_nothing(furnace):
    furnace.cycles.max_bounces, furnace.cycles.samples = 2, 7
    br.set_engine(furnace, "CYCLES", as_is=True)
    assert (furnace.cycles.max_bounces, furnace.cycles.samples) == (2, 7)
    assert not cycles_peer.phong_groups()
