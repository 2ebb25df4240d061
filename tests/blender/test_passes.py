"""Passes from Blender's side: boxes, names, what is exported for them, and their pictures in files, beside Cycles'."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe import engine
from bl_ext.user_default.lobe.addon import passes as addon_passes
from bl_ext.user_default.lobe.addon.export import export_scene

from tests.blender.export_checks import add_camera, add_object, depsgraph, new_material, plane_mesh
from tests.blender.test_addon_ui import draw, fake_context
from tools import blender_render
from tools.lobe_blender import MODULE

SAMPLES = Path(__file__).resolve().parents[2] / "sample_blends"
KINDS = addon_passes.KINDS


def tick(layer, *names: str, on: bool = True) -> None:
    """Boxes by the engine's names of the passes."""
    for name in names or KINDS:
        box = KINDS[name].box
        setattr(layer if hasattr(layer, box) else layer.lobe, box, on)


def names_of(found: dict[str, np.ndarray]) -> set[str]:
    return {name.split(".")[1] for name in found}


def test_every_pass_of_the_engine_has_a_box() -> None:
    assert set(KINDS) == set(engine.PASSES)
    assert all(len(kind.channels) == engine.PASSES[name] for name, kind in KINDS.items())
    layer = bpy.context.view_layer
    tick(layer, on=False)
    assert addon_passes.wanted_passes(layer) == ()
    tick(layer)
    assert addon_passes.wanted_passes(layer) == tuple(KINDS)


def test_files_have_the_passes_that_are_ticked_and_no_others(simple_scene, layers) -> None:
    layer = simple_scene.view_layers[0]
    tick(layer, on=False)
    assert names_of(layers(simple_scene)) == {"Combined"}
    tick(layer, "DEPTH", "ENVIRONMENT", "SAMPLE_COUNT")
    found = layers(simple_scene)
    light = "Environment" if bpy.app.version >= (5, 0) else "Env"
    assert names_of(found) == {"Combined", "Depth", light, "Debug Sample Count"}
    assert np.all(found[f"{layer.name}.Depth.Z"] == 1e10)
    assert np.all(found[f"{layer.name}.{light}.R"] == 1.0)
    assert np.all(found[f"{layer.name}.Debug Sample Count.X"] == 4)


def test_rows_of_passes_are_those_of_the_picture(simple_scene, layers) -> None:
    """A plate in the lower half, upright before the camera, which is at the origin."""
    plate = add_object("Plate", plane_mesh(2.0), (0, 4, -2), (np.pi / 2, 0, 0))
    simple_scene.render.resolution_x = simple_scene.render.resolution_y = 8
    plate.pass_index = 3
    tick(simple_scene.view_layers[0])
    found = layers(simple_scene)
    name = "Object Index" if bpy.app.version >= (5, 0) else "IndexOB"
    index = found[f"{simple_scene.view_layers[0].name}.{name}.X"]
    assert np.all(index[4:, 3:5] == 3) and not index[:4].any()
    depth = found[f"{simple_scene.view_layers[0].name}.Depth.Z"]
    assert np.allclose(depth[4:, 3:5], 4.0) and np.all(depth[:4] == 1e10)


def test_each_view_layer_has_its_own_boxes(simple_scene, layers) -> None:
    first, second = simple_scene.view_layers[0], simple_scene.view_layers.new("Second")
    tick(first, on=False)
    tick(second, on=False)
    tick(second, "MIST")
    found = layers(simple_scene)
    assert {f"{first.name}.Combined.R", "Second.Combined.R", "Second.Mist.Z"} <= set(found)
    assert f"{first.name}.Mist.Z" not in found


def render_layers_node(scene):
    """Of the compositor, where it shows the scene's first view layer."""
    if bpy.app.version >= (5, 0):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("C", "CompositorNodeTree")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
    node = tree.nodes.new("CompositorNodeRLayers")
    node.scene, node.layer = scene, scene.view_layers[0].name
    return node


def sockets(node) -> set[str]:
    return {socket.name for socket in node.outputs if socket.enabled}


def test_the_compositor_has_a_socket_for_each(simple_scene) -> None:
    layer = simple_scene.view_layers[0]
    tick(layer, on=False)
    node = render_layers_node(simple_scene)
    tick(layer)
    simple_scene.update_render_engine()
    assert {addon_passes.blender_name(name) for name in KINDS} <= sockets(node) | {"Depth"}


@pytest.mark.parametrize(
    ("owner", "box", "name"),
    [
        ("layer", "denoising_data", "Denoising Normal"),
        ("layer", "pass_sample_count", "Debug Sample Count"),
        ("scene", "use_denoising", addon_passes.NOISY),
    ],
)
def test_a_box_of_lobes_own_makes_its_socket_at_once(simple_scene, owner: str, box: str, name: str) -> None:
    node = render_layers_node(simple_scene)
    properties = (simple_scene if owner == "scene" else simple_scene.view_layers[0]).lobe
    for on in (True, False):
        setattr(properties, box, on)
        assert (name in sockets(node)) == on


def test_registering_passes_makes_no_settings_in_an_evaluated_scene() -> None:
    """Nobody would free them there."""
    registered, graph = [], depsgraph()
    fake = SimpleNamespace(register_pass=lambda _scene, _layer, name, *_: registered.append(name))
    addon_passes.register_passes(fake, graph.scene_eval, bpy.context.view_layer)
    assert "Combined" in registered and addon_passes.NOISY not in registered
    assert not graph.scene_eval.is_property_set("lobe")
    bpy.context.scene.lobe.use_denoising = True
    addon_passes.register_passes(fake, graph.scene_eval, bpy.context.view_layer)
    assert registered[-1] == addon_passes.NOISY


def test_what_passes_need_is_exported_only_where_they_are_ticked() -> None:
    add_camera()
    mesh = plane_mesh()
    mesh.uv_layers.new(name="Other", do_init=True)
    chosen = mesh.uv_layers.new(name="Chosen", do_init=False)
    chosen.active_render = True
    for loop in mesh.loops:
        vertex = mesh.vertices[loop.vertex_index].co
        chosen.uv[loop.index].vector = (vertex.x, 2 * vertex.y)
    mesh.materials.append(new_material("M", "ShaderNodeBsdfDiffuse")[0])
    mesh.materials[0].pass_index = 9
    add_object("Plane", mesh).pass_index = 4
    layer = bpy.context.view_layer
    tick(layer, on=False)
    assert export_scene(depsgraph()).meshes[0].uvs is None
    tick(layer, "UV")
    scene = export_scene(depsgraph())
    scene.validate()
    exported = scene.meshes[0]
    expected = exported.vertices[exported.triangles][..., :2] * (1, 2)
    assert np.allclose(exported.uvs, expected)
    assert scene.instances.pass_index.tolist() == [4] and scene.materials[1].pass_index == 9


def test_duplicates_have_the_index_of_what_they_show() -> None:
    add_camera()
    child, parent = add_object("Child", plane_mesh(1.0)), add_object("Parent", plane_mesh(3.0))
    child.parent, parent.instance_type = parent, "VERTS"
    child.pass_index, parent.pass_index = 5, 6
    instances = export_scene(depsgraph()).instances
    shown = [instances.pass_index[number] for number in instances.object]
    assert shown.count(5) == 5 and shown.count(6) == 1  # the child itself, too


def test_mist_and_occlusion_are_the_worlds() -> None:
    add_camera()
    world = bpy.context.scene.world = bpy.data.worlds.new("World")
    mist = world.mist_settings
    mist.start, mist.depth, mist.falloff = 2.0, 30.0, "INVERSE_QUADRATIC"
    world.light_settings.distance = 0.5
    scene = export_scene(depsgraph())
    assert scene.mist == engine.Mist(2.0, 30.0, 0.5) and scene.occlusion_distance == 0.5
    bpy.context.scene.world = None
    assert export_scene(depsgraph()).mist == engine.Mist()


def test_the_alpha_threshold_is_the_view_layers() -> None:
    add_camera()
    bpy.context.view_layer.pass_alpha_threshold = 0.25
    assert export_scene(depsgraph()).alpha_threshold == 0.25


def test_the_panel_shows_every_box_and_no_other() -> None:
    classes = [cls for cls in sys.modules[f"{MODULE}.addon.ui"]._CLASSES if cls.__name__.startswith("LOBE_VIEWLAYER")]
    panels = [cls for cls in classes if "_passes" in cls.__name__]
    shown = [name for cls in panels for _, name in draw(cls, fake_context())]
    blenders = {"use_pass_combined", "use_pass_grease_pencil"} & set(bpy.types.ViewLayer.bl_rna.properties.keys())
    assert sorted(shown) == sorted({"pass_alpha_threshold", *blenders, *(kind.box for kind in KINDS.values())})


# --- beside Cycles ----------------------------------------------------------------------------------------------------

GRID = 3  # regions along each side, whose means are compared
# Of the largest region: what is sharp in the gloss has the most noise.
TOLERANCES = {
    "Gloss": 0.3,
    "Dir": 0.05,
    "Indirect": 0.1,
    "Index": 0.02,
    "Ind": 0.1,
    "Combined": 0.05,
    "UV": 0.05,
    "": 0.02,
}
# Cycles counts samples in parts of all. Its albedo has what mirrors show, and lamps: one scene has either.
APART = {"instances": {"Debug Sample Count"}, "lamps": {"Debug Sample Count", "Denoising Albedo"}}


def everything_told_apart(scene) -> None:
    """Indices, texture coordinates and mist that differ from place to place."""
    for number, object_ in enumerate(bpy.data.objects):
        object_.pass_index = number + 1
    for number, material in enumerate(bpy.data.materials):
        material.pass_index = number + 1
    for mesh in bpy.data.meshes:
        layer = mesh.uv_layers.active or mesh.uv_layers.new()
        for loop in mesh.loops:
            place = mesh.vertices[loop.vertex_index].co
            layer.uv[loop.index].vector = (place.x + place.z / 4, place.y / 2)
    world = scene.world or bpy.data.worlds.new("World")
    scene.world, world.mist_settings.start, world.mist_settings.depth = world, 2.0, 20.0
    world.light_settings.distance = 2.0


def tolerance(key: str) -> float:
    name = key.split(".")[1]
    is_color = name.endswith(("Color", "Col"))
    return next(value for part, value in TOLERANCES.items() if part in name and not (part and is_color))


def regions(image: np.ndarray) -> np.ndarray:
    height, width = (size // GRID * GRID for size in image.shape)
    return image[:height, :width].reshape(GRID, height // GRID, GRID, width // GRID).mean(axis=(1, 3))


def undivided(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Light with its colour again: what little of a surface shows in the pixels of its rim divides noise by noise."""
    out = {}
    for key, image in found.items():
        layer, name, channel = key.split(".")
        colors = {"Diff": "DIFFUSE_COLOR", "Glos": "GLOSSY_COLOR"}
        part = name.endswith(("Direct", "Indirect", "Dir", "Ind")) and colors.get(name[:4])
        out[key] = image * found[f"{layer}.{addon_passes.blender_name(part)}.{channel}"] if part else image
    return out


@pytest.mark.parametrize("name", ["instances", "lamps"])
def test_passes_are_those_of_cycles(name: str, layers) -> None:
    scene = blender_render.open_blend(SAMPLES / f"{name}.blend")
    scene.render.resolution_percentage = max(1, round(100 * 48 / scene.render.resolution_x))
    everything_told_apart(scene)
    tick(scene.view_layers[0])
    scene.view_layers[0].cycles.denoising_store_passes = True
    scene.lobe.samples = 256
    found = {}
    for engine_name in ("LOBE", "CYCLES"):
        blender_render.set_engine(scene, engine_name)
        found[engine_name] = undivided(layers(scene))
    compared = [key for key in found["LOBE"] if key.split(".")[1] not in APART[name]]
    assert len(compared) >= 40
    assert set(compared) <= set(found["CYCLES"])
    worst = {}
    for key in compared:
        lobe, cycles = (regions(np.minimum(found[engine_name][key], 1e3)) for engine_name in ("LOBE", "CYCLES"))
        worst[key] = np.abs(lobe - cycles).max() / max(np.abs(cycles).max(), 1e-6)
    assert {key: off for key, off in worst.items() if off > tolerance(key)} == {}


@pytest.mark.parametrize("name", ["plates_phong", "cornell_diffuse"])
def test_parts_in_the_file_add_up_to_combined(name: str, layers) -> None:
    scene = blender_render.open_blend(SAMPLES / f"{name}.blend")
    scene.render.resolution_percentage = max(1, round(100 * 32 / scene.render.resolution_x))
    scene.lobe.samples = 8
    layer = scene.view_layers[0]
    tick(layer)
    found = layers(scene)

    def part(engine_name: str, channel: str) -> np.ndarray:
        return found[f"{layer.name}.{addon_passes.blender_name(engine_name)}.{channel}"]

    for channel in "RGB":
        total = part("EMISSION", channel) + part("ENVIRONMENT", channel)
        for lobe in ("DIFFUSE", "GLOSSY"):
            light = part(f"{lobe}_DIRECT", channel) + part(f"{lobe}_INDIRECT", channel)
            total = total + part(f"{lobe}_COLOR", channel) * light
        combined = found[f"{layer.name}.Combined.{channel}"]
        assert combined.max() > 0 and np.allclose(total, combined, rtol=1e-5, atol=1e-6 * combined.max())
