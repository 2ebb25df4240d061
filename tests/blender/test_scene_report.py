"""The scene report: nothing is dropped in silence, the panel and the command line say the same, and it finds objects.

`CASES` is the table of what a scene can hold: each either changes the export as asked, or is named.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import addon_utils
import bpy
import numpy as np
import pytest

from tools import blender_render
from tools.lobe_blender import MODULE

from .export_checks import add_camera, add_object, new_material, node_tree, plane_mesh

V5 = bpy.app.version >= (5, 0)


@pytest.fixture
def part() -> Callable[[str], object]:
    return lambda name: sys.modules[f"{MODULE}.addon.{name}"]


@pytest.fixture
def scene():
    """A lit plane below the camera, of which nothing is to be said."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 32, 24, 100
    scene.lobe.samples = 1
    add_camera()
    material, _ = new_material("Plain", "ShaderNodeBsdfDiffuse")
    plane = add_object("Plane", plane_mesh())
    plane.data.materials.append(material)
    light = bpy.data.lights.new("Lamp", "POINT")
    light.energy = 100.0
    add_object("Lamp", light, (0, 0, 5))
    scene.world = bpy.data.worlds.new("World")
    node_tree(scene.world)
    return scene


@pytest.fixture
def checked(part) -> Callable[[], list]:
    """A function that runs Check Scene and gives back the groups of the report."""

    def run() -> list:
        assert bpy.ops.lobe.check_scene() == {"FINISHED"}
        return list(part("scene_report").report_of(bpy.context.scene).groups)

    return run


def texts(groups, *levels: str) -> list[str]:
    return [group.what for group in groups if group.level in (levels or ("ERROR", "WARNING"))]


# --- what a scene can hold ----------------------------------------------------------------------------------------


def plane():
    return bpy.data.objects["Plane"]


def lamp():
    return bpy.data.objects["Lamp"].data


def layer():
    return bpy.context.view_layer


def tree():
    return plane().active_material.node_tree


def feed(name: str, kind: str, socket: str = "Color", output: int = 0):
    """Plug a new node into an input of the plane's shader (or its output node)."""
    made = tree().nodes.new(kind)
    target = next(node for node in tree().nodes if socket in node.inputs and node.bl_idname.endswith(name))
    tree().links.new(made.outputs[output], target.inputs[socket])
    return made


def shader(kind: str, **inputs):
    material, node = new_material("Other", kind, **inputs)
    plane().data.materials[0] = material
    return node


def light_nodes(kind: str, socket: str):
    nodes = node_tree(lamp())
    emission = next(node for node in nodes.nodes if node.bl_idname == "ShaderNodeEmission")
    nodes.links.new(nodes.nodes.new(kind).outputs[0], emission.inputs[socket])


def world_volume():
    nodes = bpy.context.scene.world.node_tree
    output = next(node for node in nodes.nodes if node.bl_idname == "ShaderNodeOutputWorld")
    nodes.links.new(nodes.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])


def hair():
    system = plane().modifiers.new("Hair", "PARTICLE_SYSTEM").particle_system
    system.settings.type = "HAIR"
    system.settings.count = 3


def grease_pencil():
    add_object("Ink", bpy.data.grease_pencils_v3.new("Ink") if not V5 else bpy.data.grease_pencils.new("Ink"))


def collection_flag(**flags):
    inner = bpy.data.collections.new("Inner")
    bpy.context.scene.collection.children.link(inner)
    inner.objects.link(add_object("Second", plane_mesh()))
    for key, value in flags.items():
        setattr(layer().layer_collection.children["Inner"], key, value)


def put(owner: Callable, **values):
    """A case that sets properties."""

    def make():
        for key, value in values.items():
            setattr(owner(), key, value)

    return make


def cycles(datablock: Callable, **values):
    return put(lambda: datablock().cycles, **values)


def render():
    return bpy.context.scene.render


def object_of(name: str):
    """A case that adds an object whose data is made by `bpy.data.<name>.new`."""
    return lambda: add_object("Thing", getattr(bpy.data, name).new("Thing"))


# What is in the scene -> (how to make it, a part of what the report says, and at which level).
NAMED = {
    "volume object": (object_of("volumes"), "volumes are not supported", "WARNING"),
    "hair curves": (object_of("hair_curves"), "hair curves are not supported", "WARNING"),
    "point cloud": (object_of("pointclouds"), "point clouds are not supported", "WARNING"),
    "light probe": (lambda: bpy.ops.object.lightprobe_add(type="SPHERE"), "light probes are for EEVEE only", "SKIPPED"),
    "grease pencil": (grease_pencil, "grease pencil are not supported", "WARNING"),
    "particle hair": (hair, "hair of particle system", "WARNING"),
    "adaptive subdivision": (None, "adaptive subdivision is not supported", "WARNING"),
    "motion blur": (put(render, use_motion_blur=True), "motion blur is not supported", "WARNING"),
    "stereo": (put(render, use_multiview=True), "stereo rendering is not supported", "WARNING"),
    "Freestyle": (put(render, use_freestyle=True), "Freestyle lines are not supported", "WARNING"),
    "caustics off": (cycles(lambda: bpy.context.scene, caustics_reflective=False), "caustics are switched off", "WARNING"),
    "fast GI": (cycles(lambda: bpy.context.scene, use_fast_gi=True), "Fast Global Illumination", "WARNING"),
    "camera culling": (None, "culling by the camera", "WARNING"),
    "panorama": (put(lambda: bpy.data.cameras["Camera"], type="PANO"), "type pano is not supported", "WARNING"),
    "passes": (put(layer, use_pass_normal=True), "only the Combined pass is supported, not Normal", "WARNING"),
    "Cycles' passes": (cycles(layer, denoising_store_passes=True), "only the Combined pass is supported", "WARNING"),
    "AOVs": (lambda: setattr(layer().aovs.add(), "name", "Dirt"), "shader AOVs are not supported and left out: Dirt",
             "WARNING"),
    "light groups": (lambda: layer().lightgroups.add(name="Key"), "light groups are not supported and left out: Key",
                     "WARNING"),
    "samples of a view layer": (put(layer, samples=7), "its own number of samples (7)", "WARNING"),
    "holdout object": (put(plane, is_holdout=True), "holdouts are not supported", "WARNING"),
    "holdout collection": (lambda: collection_flag(holdout=True), "holdouts are not supported", "WARNING"),
    "shadow catcher": (put(plane, is_shadow_catcher=True), "shadow catchers are not supported", "WARNING"),
    "light linking": (None, "light linking is not supported", "WARNING"),
    "shadow linking": (None, "light linking is not supported", "WARNING"),
    "transmission rays": (put(plane, visible_transmission=False), "hiding it from transmission rays", "WARNING"),
    "volume scatter rays": (put(plane, visible_volume_scatter=False), "hidden from volume scatter", "SKIPPED"),
    "hidden from all rays": (None, "it is hidden from every ray", "SKIPPED"),
    "shadow terminator": (None, "shadow terminator offsets are not supported", "WARNING"),
    "caustics caster": (cycles(plane, is_caustics_caster=True), "shadow caustics are not supported", "WARNING"),
    "caustics light": (cycles(lamp, is_caustics_light=True), "shadow caustics are not supported", "WARNING"),
    "caustics world": (cycles(lambda: bpy.context.scene.world, is_caustics_light=True), "shadow caustics", "WARNING"),
    "a lamp's bounces": (cycles(lamp, max_bounces=1), "its own limit of bounces is not supported", "WARNING"),
    "a world's bounces": (cycles(lambda: bpy.context.scene.world, max_bounces=1), "its own limit of bounces", "WARNING"),
    "a lamp's factors": (put(lamp, specular_factor=0.0), "specular factor: only EEVEE knows that", "SKIPPED"),
    "a lamp's reach": (put(lamp, use_custom_distance=True), "custom distance: only EEVEE knows that", "SKIPPED"),
    "IES": (lambda: light_nodes("ShaderNodeTexIES", "Strength"), "IES Texture is not supported", "WARNING"),
    "light falloff": (None, "Light Falloff is supported for a quadratic falloff", "WARNING"),
    "gobo": (lambda: light_nodes("ShaderNodeTexNoise", "Color"), "Noise Texture is not supported", "WARNING"),
    "world volume": (world_volume, "volumes are not supported", "WARNING"),
    "sky": (None, "Sky Texture is not supported", "WARNING"),
    "world hidden from transmission": (
        put(lambda: bpy.context.scene.world.cycles_visibility, transmission=False),
        "hiding it from transmission rays", "WARNING"),
    "material volume": (
        lambda: feed("OutputMaterial", "ShaderNodeVolumeScatter", "Volume"), "volumes are not supported", "WARNING"),
    "displacement": (
        lambda: feed("OutputMaterial", "ShaderNodeDisplacement", "Displacement"), "displacement is not supported",
        "WARNING"),
    "bump": (lambda: feed("BsdfDiffuse", "ShaderNodeBump", "Normal"), "Bump is not supported", "WARNING"),
    "normal map": (lambda: feed("BsdfDiffuse", "ShaderNodeNormalMap", "Normal"), "Normal Map is not supported",
                   "WARNING"),
    "bump on Toon": (None, "Bump is not supported", "WARNING"),
    "texture": (lambda: feed("BsdfDiffuse", "ShaderNodeTexNoise"), "Noise Texture is not supported", "WARNING"),
    "vertex colours": (
        lambda: feed("BsdfDiffuse", "ShaderNodeVertexColor"), "is not supported and counts as unplugged", "WARNING"),
    "glass": (lambda: shader("ShaderNodeBsdfGlass"), "Glass BSDF is not supported", "WARNING"),
    "holdout shader": (lambda: shader("ShaderNodeHoldout"), "Holdout is not supported", "WARNING"),
    "clear coat": (
        lambda: shader("ShaderNodeEeveeSpecular", Clear_Coat=1.0), "clear coat is not supported", "WARNING"),
    "opaque shadows": (None, "opaque shadows of a transparent surface", "WARNING"),
    "backface culling": (
        lambda: setattr(plane().active_material, "use_backface_culling", True), "only EEVEE knows that", "SKIPPED"),
}  # fmt: skip


def makes(name: str):
    """Register a function as the way to make a case that takes more than a line."""

    def register(function):
        NAMED[name] = (function, *NAMED[name][1:])
        return function

    return register


@makes("adaptive subdivision")
def _():
    modifier = plane().modifiers.new("Subdivision", "SUBSURF")
    if V5:
        modifier.use_adaptive_subdivision = True
    else:
        bpy.context.scene.cycles.feature_set = "EXPERIMENTAL"
        plane().cycles.use_adaptive_subdivision = True


@makes("camera culling")
def _():
    bpy.context.scene.render.use_simplify = bpy.context.scene.cycles.use_camera_cull = True


@makes("light linking")
def _():
    lamp_object = bpy.data.objects["Lamp"]
    lamp_object.light_linking.receiver_collection = bpy.data.collections.new("Lit")


@makes("shadow linking")
def _():
    bpy.data.objects["Lamp"].light_linking.blocker_collection = bpy.data.collections.new("Blockers")


@makes("hidden from all rays")
def _():
    second = add_object("Second", plane_mesh())
    for ray in ("camera", "diffuse", "glossy", "shadow"):
        setattr(second, f"visible_{ray}", False)


@makes("shadow terminator")
def _():
    holder = plane() if hasattr(plane(), "shadow_terminator_geometry_offset") else plane().cycles
    holder.shadow_terminator_geometry_offset = 0.5


@makes("light falloff")
def _():
    light_nodes("ShaderNodeLightFalloff", "Strength")
    nodes = lamp().node_tree
    falloff = next(node for node in nodes.nodes if node.bl_idname == "ShaderNodeLightFalloff")
    emission = next(node for node in nodes.nodes if node.bl_idname == "ShaderNodeEmission")
    nodes.links.new(falloff.outputs["Linear"], emission.inputs["Strength"])


@makes("sky")
def _():
    nodes = bpy.context.scene.world.node_tree
    nodes.links.new(nodes.nodes.new("ShaderNodeTexSky").outputs[0], nodes.nodes["Background"].inputs["Color"])


@makes("bump on Toon")
def _():
    node = shader("ShaderNodeBsdfToon")
    nodes = node.id_data
    nodes.links.new(nodes.nodes.new("ShaderNodeBump").outputs[0], node.inputs["Normal"])


@makes("opaque shadows")
def _():
    shader("ShaderNodeBsdfTransparent")
    plane().active_material.use_transparent_shadow = False


@pytest.mark.parametrize("case", NAMED)
def test_what_is_not_drawn_as_asked_is_named(scene, checked, case) -> None:
    make, expected, level = NAMED[case]
    before = checked()
    assert texts(before, "ERROR", "WARNING", "SKIPPED") == []
    make()
    found = texts(checked(), level)
    assert any(expected in text for text in found), found
