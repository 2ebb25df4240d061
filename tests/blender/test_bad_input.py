"""Bad input never ends in a traceback, nor in a black picture without a word.

Every message stands here as the user sees it: raised by `bpy.ops.render.render`, or among Blender's reports.
"""

from __future__ import annotations

import importlib

import bpy
import numpy as np
import pytest

from tests.blender.export_checks import add_object, new_material, node_tree, plane_mesh
from tools import blender_render
from tools.lobe_blender import MODULE

NAN, INF = float("nan"), float("inf")
EMPTY = "there is nothing to render: no object has faces, and no world shows behind them"
DARK = "nothing gives light, so every surface is black: add a lamp, an emission or a world colour"


@pytest.fixture
def scene(simple_scene) -> bpy.types.Scene:
    """The white world of `simple_scene` and a plane that fills the picture."""
    add_object("Table", plane_mesh(100, "Plane"), (0, 10, 0), (np.pi / 2, 0, 0))
    return simple_scene


@pytest.fixture
def refused(capfd):
    """A function: the message that a render ends with."""

    def render() -> str:
        with pytest.raises(RuntimeError) as caught:
            bpy.ops.render.render()
        assert "Traceback" not in capfd.readouterr().err
        return str(caught.value).strip()

    return render


@pytest.fixture
def reported(capfd):
    """A function: Blender's report lines of a render that goes on, the ones that warn, but for what is said of meshes
    without a material."""

    def render() -> list[str]:
        assert bpy.ops.render.render() == {"FINISHED"}
        said = capfd.readouterr()
        assert "Traceback" not in said.err
        assert importlib.import_module(f"{MODULE}.addon.report").last_report["rejected"] == 0
        warnings = [line for line in said.out.splitlines() if line.startswith("Warning: ")]
        return [line for line in warnings if "without a material" not in line]

    return render


# --- refused, with the name of what is at fault -----------------------------------------------------------------


def test_no_camera(scene, refused) -> None:
    scene.camera = None
    assert refused() == "Error: Cannot render, no camera"


def test_no_pixels(scene, refused) -> None:
    scene.render.resolution_x = scene.render.resolution_y = 4
    scene.render.resolution_percentage = 1
    assert refused() == "Error: Image too small"


@pytest.mark.parametrize("crop", [False, True])
@pytest.mark.parametrize("high", [0.5, 0.51])
def test_a_border_without_pixels(scene, refused, crop: bool, high: float) -> None:
    render = scene.render
    render.use_border, render.use_crop_to_border = True, crop
    render.border_min_x, render.border_max_x = 0.5, high
    assert refused() == "Error: Image too small"


@pytest.mark.parametrize(("value", "text"), [(NAN, "nan"), (INF, "inf"), (-INF, "-inf")])
def test_vertices_that_are_nowhere(scene, refused, value: float, text: str) -> None:
    positions = bpy.data.meshes["Plane"].attributes["position"].data
    positions.foreach_set("vector", np.insert(np.full(11, 100.0, np.float32), 7, value))
    assert refused() == (
        f"Error: object 'Table', mesh 'Plane': vertex 2 is at (100, {text}, 100); "
        "remove it, or the modifier or driver that made it"
    )


def test_an_object_that_is_nowhere(scene, refused) -> None:
    bpy.data.objects["Table"].location.x = NAN
    assert refused() == (
        "Error: object 'Table': its transform holds values that are not finite; "
        "check its location, rotation, scale, drivers and parents"
    )


def test_an_object_out_of_reach(scene, refused) -> None:
    bpy.data.objects["Table"].location.x = 1e30
    assert refused() == (
        "Error: object 'Table': it reaches 1e+30 m from the origin, and 1e+09 m is the limit; "
        "check its location, scale and modifiers"
    )


@pytest.mark.parametrize("kind", ["POINT", "SPOT", "SUN", "AREA"])
def test_a_lamp_that_takes_light_away(scene, refused, kind: str) -> None:
    lamp = bpy.data.lights.new("Lamp", kind)
    lamp.energy = -5.0
    add_object("Key", lamp)
    assert refused() == "Error: light 'Key': its energy is negative; Lobe cannot subtract light, set it to 0 or more"


def test_a_phong_exponent_below_zero(scene, refused) -> None:
    group = importlib.import_module(f"{MODULE}.addon.phong_group").phong_group()
    material, node = new_material("Lacquer", "ShaderNodeGroup")
    tree = material.node_tree
    node.node_tree = group
    value = tree.nodes.new("ShaderNodeValue")  # the socket's own range begins at 0
    value.outputs[0].default_value = -3.0
    tree.links.new(value.outputs[0], node.inputs["exponent"])
    tree.links.new(node.outputs[0], tree.get_output_node("ALL").inputs["Surface"])
    bpy.data.meshes["Plane"].materials.append(material)
    assert refused() == "Error: material 'Lacquer': its Phong exponent is -3; set it to 0 or more"


def test_a_surface_that_takes_light_away(scene, refused) -> None:
    material, _ = new_material("Hole", "ShaderNodeEmission", Strength=-1.0)
    bpy.data.meshes["Plane"].materials.append(material)
    assert refused() == "Error: material 'Hole': its emission is negative (-1, -1, -1); set every channel to 0 or more"


def test_a_world_that_takes_light_away(scene, refused) -> None:
    node_tree(scene.world).nodes["Background"].inputs["Strength"].default_value = -1.0
    assert refused() == "Error: the world: its colour is negative (-1, -1, -1); set every channel to 0 or more"


def test_a_camera_that_sees_nothing(scene, refused) -> None:
    scene.camera.data.clip_start, scene.camera.data.clip_end = 10.0, 1.0
    assert refused() == "Error: camera 'Camera': its clip start (10 m) must be nearer than its clip end (1 m)"


# --- rendered, with a word about it -----------------------------------------------------------------------------


def missing_image(tree, kind: str, name: str):
    image = bpy.data.images.new(name, 1, 1)
    image.source, image.filepath = "FILE", f"//gone/{name}"
    node = tree.nodes.new(kind)
    node.image = image
    return node.outputs["Color"]


def test_a_missing_image_on_a_surface_is_magenta_and_named(scene, reported, rendered) -> None:
    material, node = new_material("Wood", "ShaderNodeEmission")
    tree = material.node_tree
    tree.links.new(missing_image(tree, "ShaderNodeTexImage", "oak.png"), node.inputs["Color"])
    bpy.data.meshes["Plane"].materials.append(material)
    assert reported() == ["Warning: Lobe: material 'Wood': image 'oak.png' is missing, drawn magenta"]
    assert np.allclose(rendered(scene)[..., :3], (1, 0, 1), atol=1e-4)


def test_a_missing_environment_is_magenta_and_named(scene, reported, rendered) -> None:
    bpy.data.objects["Table"].hide_render = True
    tree = node_tree(scene.world)
    sky = missing_image(tree, "ShaderNodeTexEnvironment", "sky.hdr")
    tree.links.new(sky, tree.nodes["Background"].inputs["Color"])
    magenta = "Warning: Lobe: world 'World': image 'sky.hdr' is missing, drawn magenta"
    assert reported() == [magenta]
    assert np.allclose(rendered(scene)[..., :3], (1, 0, 1), atol=1e-4)


def test_a_missing_library_is_named(scene, reported, tmp_path) -> None:
    path = tmp_path / "trees.blend"
    bpy.data.libraries.write(str(path), {add_object("Tree", plane_mesh(name="Crown"))})
    bpy.data.objects.remove(bpy.data.objects["Tree"])
    with bpy.data.libraries.load(str(path), link=True) as (_, into):
        into.objects = ["Tree"]
    scene.collection.objects.link(into.objects[0])
    assert reported() == []
    path.unlink()
    gone = f"Warning: Lobe: library '{path}': it is missing, and so is what is linked from it"
    assert reported() == [gone]


def test_adaptive_subdivision_is_named(scene, reported) -> None:
    modifier = bpy.data.objects["Table"].modifiers.new("Subdivision", "SUBSURF")
    before_5_0 = not hasattr(modifier, "use_adaptive_subdivision")
    owner = bpy.data.objects["Table"].cycles if before_5_0 else modifier
    owner.use_adaptive_subdivision = True
    what = "adaptive subdivision is not supported, subdivided as often as its modifier says"
    assert reported() == [f"Warning: Lobe: object 'Table': {what}"]


@pytest.mark.parametrize("smooth", [False, True])
def test_faces_without_area(scene, reported, rendered, smooth: bool) -> None:
    """Some in a point, some in a line, one of them glowing: they show nothing and harm nothing."""
    mesh = bpy.data.meshes.new("Flat")
    corners = [(0, 5, 0)] * 3 + [(-1, 5, 0), (0, 5, 0), (1, 5, 0)]
    mesh.from_pydata(corners, [], [(0, 1, 2), (3, 4, 5), (0, 1, 3, 5)])
    if smooth:
        mesh.shade_smooth()
    mesh.materials.append(new_material("Glow", "ShaderNodeEmission", Strength=5.0)[0])
    add_object("Flat", mesh)
    add_object("Scaled to nothing", plane_mesh(name="Nothing"), (0, 5, 0), scale=(0, 0, 0))
    assert reported() == []
    pixels = rendered(scene)
    assert np.isfinite(pixels).all()
    assert np.allclose(pixels[..., :3], 0.8, rtol=0.02)  # the table's grey under a white sky


def test_a_scene_of_a_sky_alone_is_as_asked(simple_scene, reported, rendered) -> None:
    assert reported() == []
    assert np.allclose(rendered(simple_scene), 1.0)
    assert blender_render.check(simple_scene).is_honoured


def test_a_scene_of_a_lamp_alone_is_as_asked(simple_scene, reported, rendered) -> None:
    """It shows itself, and nothing else does."""
    simple_scene.world = None
    lamp = bpy.data.lights.new("Panel", "AREA")
    lamp.energy, lamp.size = 100.0, 10.0
    add_object("Panel", lamp, (0, 10, 0), (-np.pi / 2, 0, 0)).visible_camera = True
    assert reported() == []
    assert rendered(simple_scene)[..., :3].min() > 0.0


@pytest.mark.parametrize("way", ["film", "visibility"])
def test_a_world_that_nobody_sees_is_nothing_to_see(simple_scene, reported, rendered, way: str) -> None:
    if way == "film":
        simple_scene.render.film_transparent = True
    else:
        simple_scene.world.cycles_visibility.camera = False
    assert reported() == [f"Warning: Lobe: {EMPTY}"]
    assert not rendered(simple_scene)[..., :3].any()


def test_an_empty_scene_without_a_world(simple_scene, reported, rendered) -> None:
    simple_scene.world = None
    assert reported() == [f"Warning: Lobe: {EMPTY}"]
    assert np.allclose(rendered(simple_scene), (0, 0, 0, 1))


def test_a_scene_without_light(scene, reported) -> None:
    scene.world = None
    assert reported() == [f"Warning: Lobe: {DARK}"]


def test_objects_that_show_nothing_are_listed(scene, reported, capfd) -> None:
    add_object("Cloud", bpy.data.meshes.new("Cloud"))
    lamp = bpy.data.lights.new("Lamp", "POINT")
    lamp.energy = 0.0
    add_object("Key", lamp)
    bpy.ops.render.render()
    said = [line for line in capfd.readouterr().out.splitlines() if line.startswith("Info: Lobe left out")]
    assert said == ["Info: Lobe left out: object 'Cloud': it has no faces, light 'Key': its strength is zero"]
