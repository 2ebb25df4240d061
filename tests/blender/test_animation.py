"""Animations: with Persistent Data each frame exports only what has changed, and its picture is the same to the bit."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe.addon.export import instances, kept
from bl_ext.user_default.lobe.addon.export.materials import material as materials

from tests.blender.export_checks import add_object, new_material, node_tree, plane_mesh
from tools.lobe_blender import MODULE

FRAMES = 4


@pytest.fixture
def scene(simple_scene) -> bpy.types.Scene:
    """Four frames of two cubes on a floor before the camera, lit by an area and a point lamp and by the world."""
    scene = simple_scene
    scene.frame_start, scene.frame_end = 1, FRAMES
    scene.render.resolution_x, scene.render.resolution_y = 24, 16
    node_tree(scene.world).nodes["Background"].inputs["Strength"].default_value = 0.2
    add_object("Floor", plane_mesh(20, "Floor"), (0, 6, -1))
    for number in range(2):
        bpy.ops.mesh.primitive_cube_add(location=(2.5 * number - 1.2, 7, 0), size=1.5)
        cube = bpy.context.object
        cube.name = cube.data.name = f"Cube {number}"
        cube.data.materials.append(new_material(f"Paint {number}", "ShaderNodeBsdfDiffuse")[0])
    add_object("Area", bpy.data.lights.new("Area", "AREA"), (0, 5, 4)).data.energy = 200
    add_object("Bulb", bpy.data.lights.new("Bulb", "POINT"), (2, 3, 2)).data.energy = 50
    return scene


def keyed(owner, path: str, values, index: int = -1) -> None:
    """Animate a property linearly from one value to another."""
    for frame, value in zip((1, FRAMES), values, strict=True):
        if index < 0:
            setattr(owner, path, value)
        else:
            getattr(owner, path)[index] = value
        owner.keyframe_insert(path, index=index, frame=frame)


class Rendered:
    """Pictures, warnings and the number of meshes, materials and worlds exported and of builds, layer by layer."""

    def __init__(self, monkeypatch) -> None:
        self.pictures: list[np.ndarray] = []
        self.warnings: list[list[str]] = []
        self.exported: list[tuple[int, int, int]] = []
        self.built: list[tuple[int, int]] = []
        self._counts = dict.fromkeys(("mesh", "material", "world", "pack", "accel"), 0)
        session = importlib.import_module(f"{MODULE}.addon.session")
        again = importlib.import_module(f"{MODULE}.engine.pack.again")
        pack = importlib.import_module(f"{MODULE}.engine.pack")
        for module, function, name in (
            (instances, "export_mesh", "mesh"), (materials, "export_material", "material"),
            (kept, "export_world", "world"), (again, "pack", "pack"), (pack, "Accel", "accel"),
        ):  # fmt: skip
            monkeypatch.setattr(module, function, self._counted(getattr(module, function), name))
        render = session.lobe.render

        def noted(scene, *arguments, **options):
            exported = tuple(self._counts[name] for name in ("mesh", "material", "world"))
            result = render(scene, *arguments, **options)
            self.exported.append(exported)
            self.built.append((self._counts["pack"], self._counts["accel"]))
            self._counts = dict.fromkeys(self._counts, 0)
            self.pictures.append(result.pixels)
            self.warnings.append(scene.warnings + scene.skipped)
            return result

        monkeypatch.setattr(session.lobe, "render", noted)

    def _counted(self, function: Callable, name: str) -> Callable:
        def counted(*arguments):
            self._counts[name] += 1
            return function(*arguments)

        return counted

    def animation(self, scene, persistent: bool) -> list[np.ndarray]:
        scene.render.use_persistent_data = persistent
        for results in (self.pictures, self.warnings, self.exported, self.built):
            results.clear()
        bpy.ops.render.render(animation=True)
        return list(self.pictures)


@pytest.fixture
def rendering(monkeypatch, tmp_path) -> Rendered:
    bpy.context.scene.render.filepath = f"{tmp_path}/"
    return Rendered(monkeypatch)


def moving_camera(scene) -> None:
    keyed(scene.camera, "location", (0.0, 1.0), 0)


def distant_camera(scene) -> None:
    """It leaves the reach of the area lamp's shape, and comes back."""
    keyed(scene.camera, "location", (-100.0, 0.0), 1)


def moving_object(scene) -> None:
    keyed(bpy.data.objects["Cube 0"], "location", (0.0, 1.0), 2)


def shape_key(scene) -> None:
    cube = bpy.data.objects["Cube 0"]
    cube.shape_key_add()
    key = cube.shape_key_add()
    key.data[6].co.z = 3
    keyed(key, "value", (0.0, 1.0))


def modifier(scene) -> None:
    bpy.data.objects["Cube 0"].modifiers.new("Wave", "WAVE").height = 1.0


def armature(scene) -> None:
    bones = bpy.data.armatures.new("Bones")
    owner = add_object("Bones", bones, (-1.2, 7, 0))
    bpy.context.view_layer.objects.active = owner
    bpy.ops.object.mode_set(mode="EDIT")
    bones.edit_bones.new("Bone").tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    cube = bpy.data.objects["Cube 0"]
    cube.vertex_groups.new(name="Bone").add([5, 6, 7], 1.0, "REPLACE")
    cube.modifiers.new("Armature", "ARMATURE").object = owner
    keyed(owner.pose.bones["Bone"], "location", (0.0, 1.0), 1)


def geometry_nodes(scene) -> None:
    """Of a cube whose size and number of instances are those of the frame."""
    tree = bpy.data.node_groups.new("Grow", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes = [tree.nodes.new(kind) for kind in (
        "GeometryNodeInputSceneTime", "GeometryNodeMeshLine", "GeometryNodeInstanceOnPoints", "GeometryNodeMeshCube",
        "NodeGroupOutput",
    )]  # fmt: skip
    time, line, on_points, cube, output = nodes
    tree.links.new(time.outputs["Frame"], line.inputs["Count"])
    tree.links.new(time.outputs["Seconds"], cube.inputs["Size"])
    tree.links.new(line.outputs[0], on_points.inputs["Points"])
    tree.links.new(cube.outputs[0], on_points.inputs["Instance"])
    tree.links.new(on_points.outputs[0], output.inputs[0])
    bpy.data.objects["Cube 1"].modifiers.new("Grow", "NODES").node_group = tree


def driver(scene) -> None:
    bpy.data.objects["Cube 0"].driver_add("scale", 2).driver.expression = "1 + frame / 4"


def material_colour(scene) -> None:
    inputs = bpy.data.materials["Paint 0"].node_tree.nodes["Diffuse BSDF"].inputs
    keyed(inputs["Color"], "default_value", (0.0, 0.9), 0)


def emission_that_begins(scene) -> None:
    material, node = new_material("Glow", "ShaderNodeEmission")
    bpy.data.meshes["Cube 1"].materials[0] = material
    keyed(node.inputs["Strength"], "default_value", (0.0, 3.0))
    node.inputs["Strength"].keyframe_insert("default_value", frame=2)


def node_group(scene) -> None:
    tree = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    diffuse, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("NodeGroupOutput")
    tree.links.new(diffuse.outputs[0], output.inputs[0])
    material, node = new_material("Grouped", "ShaderNodeGroup")
    node.node_tree = tree
    material.node_tree.links.new(node.outputs[0], material.node_tree.get_output_node("ALL").inputs["Surface"])
    bpy.data.meshes["Cube 1"].materials[0] = material
    keyed(diffuse.inputs["Color"], "default_value", (0.0, 0.9), 1)


def lamp_energy(scene) -> None:
    keyed(bpy.data.lights["Bulb"], "energy", (10.0, 90.0))


def moving_lamp(scene) -> None:
    keyed(bpy.data.objects["Area"], "location", (-1.0, 3.0), 0)


def visibility(scene) -> None:
    keyed(bpy.data.objects["Cube 0"], "hide_render", (False, True))
    keyed(bpy.data.objects["Cube 1"], "visible_camera", (True, False))


def world_strength(scene) -> None:
    keyed(node_tree(scene.world).nodes["Background"].inputs["Strength"], "default_value", (0.0, 1.0))


def rising_sun(scene) -> None:
    tree = node_tree(scene.world)
    sky = tree.nodes.new("ShaderNodeTexSky")
    tree.links.new(sky.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    keyed(sky, "sun_elevation", (-0.1, 0.5))


def image_sequence(scene, tmp_path) -> None:
    """On a surface and around the world, another picture in each frame."""
    for number in range(1, FRAMES + 1):
        image = bpy.data.images.new("Still", 8, 4)
        image.pixels.foreach_set(np.tile(np.float32([number / FRAMES, 0.5, 1 - number / FRAMES, 1]), 32))
        image.filepath_raw, image.file_format = str(tmp_path / f"still_{number:04}.png"), "PNG"
        image.save()
    sequence = bpy.data.images.load(str(tmp_path / "still_0001.png"))
    sequence.source = "SEQUENCE"
    material, node = new_material("Film", "ShaderNodeBsdfDiffuse")
    bpy.data.meshes["Floor"].materials.append(material)
    for tree, kind, target in (
        (material.node_tree, "ShaderNodeTexImage", node.inputs["Color"]),
        (node_tree(scene.world), "ShaderNodeTexEnvironment", scene.world.node_tree.nodes["Background"].inputs["Color"]),
    ):
        texture = tree.nodes.new(kind)
        texture.image = sequence
        texture.image_user.frame_duration, texture.image_user.use_auto_refresh = FRAMES, True
        tree.links.new(texture.outputs["Color"], target)


def growing_text(scene) -> None:
    curve = bpy.data.curves.new("Text", "FONT")
    curve.body = "Lobe"
    add_object("Text", curve, (-1, 5, 0), (np.pi / 2, 0, 0))
    keyed(curve, "extrude", (0.0, 0.5))


CHANGES = [
    moving_camera, distant_camera, moving_object, shape_key, modifier, armature, geometry_nodes, driver,
    material_colour, emission_that_begins, node_group, lamp_energy, moving_lamp, visibility, world_strength,
    rising_sun, image_sequence, growing_text,
]  # fmt: skip

# Meshes, materials and worlds that the frames after the first export, and whether they pack and build.
EXPORTS = {
    moving_camera: ((0, 0, 0), (0, 0)),
    moving_object: ((0, 0, 0), (1, 1)),
    shape_key: ((1, 0, 0), (1, 1)),
    modifier: ((1, 0, 0), (1, 1)),
    material_colour: ((0, 1, 0), (0, 0)),
    lamp_energy: ((0, 0, 0), (0, 0)),
    world_strength: ((0, 0, 1), (0, 0)),
}


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_persistent_data_renders_the_same_pictures(scene, rendering, change, tmp_path) -> None:
    change(scene, tmp_path) if change is image_sequence else change(scene)
    plain = rendering.animation(scene, persistent=False)
    warnings = list(rendering.warnings)
    assert len(plain) == FRAMES
    assert not np.array_equal(plain[0], plain[-1])  # something does move
    assert all(meshes >= 2 for meshes, _, _ in rendering.exported)  # everything, each time
    persistent = rendering.animation(scene, persistent=True)
    assert [np.array_equal(a, b) for a, b in zip(plain, persistent, strict=True)] == [True] * FRAMES
    assert rendering.warnings == warnings
    if change in EXPORTS:
        exported, built = EXPORTS[change]
        assert rendering.exported[1:] == [exported] * (FRAMES - 1)
        assert rendering.built[1:] == [built] * (FRAMES - 1)


def test_all_changes_at_once_on_two_layers(scene, rendering) -> None:
    for change in (moving_camera, shape_key, modifier, material_colour, lamp_energy, visibility, world_strength):
        change(scene)
    second = scene.view_layers.new("Second")
    collection = bpy.data.collections.new("Away")
    scene.collection.children.link(collection)
    cube = bpy.data.objects["Cube 0"]
    scene.collection.objects.unlink(cube)
    collection.objects.link(cube)
    second.layer_collection.children["Away"].exclude = True
    plain = rendering.animation(scene, persistent=False)
    persistent = rendering.animation(scene, persistent=True)
    assert len(plain) == 2 * FRAMES and not np.array_equal(plain[0], plain[1])
    assert [np.array_equal(a, b) for a, b in zip(plain, persistent, strict=True)] == [True] * 2 * FRAMES


def test_edits_between_renders_are_seen(scene, rendering) -> None:
    """Of what Blender keeps after a render, too."""
    scene.render.use_persistent_data = True
    floor = bpy.data.objects["Floor"]

    def longer() -> None:
        floor.data.vertices[0].co.z = 3
        floor.data.update()

    edits = [
        lambda: None, longer, lambda: setattr(floor, "location", (0, 6, -2)),
        lambda: floor.data.materials.append(bpy.data.materials["Paint 1"]),
        lambda: bpy.data.objects.remove(bpy.data.objects["Cube 1"]),
        lambda: add_object("New", plane_mesh(1, "New"), (0, 4, 0)),
        lambda: setattr(bpy.context.view_layer, "material_override", new_material("Over", "ShaderNodeBsdfDiffuse")[0]),
        lambda: setattr(scene, "world", None), lambda: setattr(scene.render, "film_transparent", True),
        lambda: setattr(scene.render, "resolution_x", 16), lambda: setattr(scene.lobe, "samples", 2),
        lambda: setattr(scene.view_layers[0], "name", "Renamed"),
    ]  # fmt: skip
    kept_pictures = []
    for edit in edits:
        edit()
        bpy.ops.render.render()
        kept_pictures.append(rendering.pictures[-1])
        scene.render.use_persistent_data = False
        bpy.ops.render.render()
        assert np.array_equal(rendering.pictures[-1], kept_pictures[-1])
        scene.render.use_persistent_data = True


def write_image(path: Path, color) -> None:
    image = bpy.data.images.new("Written", 2, 2)
    image.pixels = [*color, 1.0] * 4
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


@pytest.mark.parametrize("of_world", [False, True])
def test_pixels_that_change_between_renders_are_seen(scene, rendering, tmp_path, of_world: bool) -> None:
    """Blender lists no image for any of these."""
    textures = []
    for number in range(2):
        tree = (scene.world if of_world else bpy.data.materials[f"Paint {number}"]).node_tree
        textures.append(tree.nodes.new("ShaderNodeTexEnvironment" if of_world else "ShaderNodeTexImage"))
        node = tree.nodes["Background" if of_world else "Diffuse BSDF"]
        tree.links.new(textures[-1].outputs["Color"], node.inputs["Strength" if of_world and number else "Color"])

    def pictures(persistent: bool) -> list[np.ndarray]:
        path = tmp_path / f"{persistent}.png"
        write_image(path, (1, 0, 0))
        painted, read = bpy.data.images.new("Painted", 8, 8), bpy.data.images.load(str(path))
        for texture, image in zip(textures, (painted, read), strict=True):
            texture.image = image

        def paint(*color: float) -> None:
            painted.pixels = [*color, 1.0] * 64

        def paint_and_pack() -> None:
            painted.pixels.foreach_set(np.random.default_rng(0).random(256, np.float32))
            painted.pack()

        def rewrite(*color: float) -> None:
            write_image(path, color)
            read.reload()

        scene.render.use_persistent_data = persistent
        rendering.pictures.clear()
        rendering.exported.clear()
        for edit in (
            lambda: None, lambda: paint(0, 1, 0), lambda: paint(0, 0, 1), lambda: rewrite(0, 1, 0), painted.pack,
            paint_and_pack, lambda: write_image(path, (0.5, 0.5, 1)),
        ):  # fmt: skip
            edit()
            bpy.ops.render.render()
        return list(rendering.pictures)

    plain = pictures(False)
    same = [np.array_equal(a, b) for a, b in zip(plain, pictures(True), strict=True)]
    assert same == [True] * len(plain)
    assert [meshes for meshes, _, _ in rendering.exported[1:]] == [0] * (len(plain) - 1)  # the rest is kept
    assert sum(not np.array_equal(a, b) for a, b in pairwise(plain)) >= 4


def test_scenes_in_turn_do_not_see_each_other(scene, rendering) -> None:
    other = scene.copy()
    other.camera = scene.camera
    other.world = None
    scene.render.use_persistent_data = other.render.use_persistent_data = True
    for _ in range(3):
        bpy.ops.render.render(scene=scene.name)
        bpy.ops.render.render(scene=other.name)
    first, second = rendering.pictures[:2]
    assert not np.array_equal(first, second)
    for number, picture in enumerate(rendering.pictures):
        assert np.array_equal(picture, rendering.pictures[number % 2])


# --- sequences in a process of their own ------------------------------------------------------------------------

# A ball whose vertices move in every frame, seen by a moving camera. `PERSISTENT`, `FOLDER`, `LAST` come before it.
SEQUENCE = f"""
import os, sys
sys.path.insert(0, {str(Path(__file__).resolve().parents[2])!r})
from tools.lobe_blender import MODULE, enable_lobe, install
os.environ["BLENDER_USER_RESOURCES"] = str(install())
import bpy
enable_lobe()
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
scene = bpy.context.scene
scene.render.engine = "LOBE"
scene.render.resolution_x = scene.render.resolution_y = 16
scene.render.use_persistent_data, scene.render.filepath = PERSISTENT, FOLDER
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.use_overwrite = False
scene.frame_end, scene.lobe.samples, scene.lobe.max_bounces = LAST, 1, 1
scene.render.threads_mode, scene.render.threads = "FIXED", 1
scene.world = bpy.data.worlds.new("World")
scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
scene.collection.objects.link(scene.camera)
scene.camera.location.z = 5
scene.camera.driver_add("location", 0).driver.expression = "frame / 100"
bpy.ops.mesh.primitive_uv_sphere_add(segments=200, ring_count=100)
bpy.context.object.modifiers.new("Wave", "WAVE")
"""

# After it: resident memory in MB after each frame.
MEASURE = """
import importlib, json
memory, known = importlib.import_module(f"{MODULE}.addon.memory"), []
bpy.app.handlers.render_write.append(lambda *_: known.append(memory.current_and_peak_mb()[0]))
bpy.ops.render.render(animation=True)
bpy.app.handlers.render_write.clear()  # at the end Blender 4.2 would call into what Python has freed
print(json.dumps(known))
"""


def script(persistent: bool, folder: Path, last: int, then: str) -> list[str]:
    first = f"PERSISTENT, FOLDER, LAST = {persistent}, {str(folder) + '/'!r}, {last}"
    return [sys.executable, "-c", f"{first}\n{SEQUENCE}\n{then}"]


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory in use is known on Linux alone")
@pytest.mark.parametrize("persistent", [False, True])
def test_memory_does_not_grow_over_two_hundred_frames(tmp_path, persistent: bool) -> None:
    command = script(persistent, tmp_path, 200, MEASURE)
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    known = np.array(json.loads(done.stdout.splitlines()[-1]))
    assert len(known) == 200
    grown = np.median(known[-20:]) - np.median(known[50:70])
    assert grown < 3.0  # MB in 130 frames; the ball is 1.4


# After it: as if the power went off in the middle of a frame.
STOP = """
def off(*_):
    if scene.frame_current == 4:
        os._exit(9)
bpy.app.handlers.render_stats.append(off)
bpy.ops.render.render(animation=True)
"""


@pytest.mark.parametrize("persistent", [False, True])
def test_a_sequence_goes_on_where_it_was_interrupted(tmp_path, persistent: bool) -> None:
    """With Blender's own Overwrite unticked. What is rendered then depends on no frame before."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    render = "bpy.ops.render.render(animation=True)"
    subprocess.run(script(persistent, whole, 6, render), capture_output=True, check=True)
    assert subprocess.run(script(persistent, parts, 6, STOP), capture_output=True).returncode == 9
    assert sorted(path.name for path in parts.iterdir()) == ["0001.exr", "0002.exr", "0003.exr"]
    times = {path: path.stat().st_mtime_ns for path in parts.iterdir()}
    subprocess.run(script(persistent, parts, 6, render), capture_output=True, check=True)
    assert all(path.stat().st_mtime_ns == time for path, time in times.items())
    for number in range(1, 7):
        assert np.array_equal(pixels_of(whole / f"{number:04}.exr"), pixels_of(parts / f"{number:04}.exr"))
    assert not np.array_equal(pixels_of(whole / "0004.exr"), pixels_of(whole / "0005.exr"))


def pixels_of(path: Path) -> np.ndarray:
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(str(path))
    pixels = image.read_image("float")
    image.close()
    return pixels
