"""What a viewport exports of each edit: all that makes the scene what a new export would have, and no more."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe.addon.export import LiveExport, export_viewport_settings, instances, kept, live
from bl_ext.user_default.lobe.addon.export.kept_meshes import KeptMeshes
from bl_ext.user_default.lobe.addon.export.materials import material as materials
from bl_ext.user_default.lobe.engine import SceneError

from tests.blender.export_checks import add_object


class Viewport:
    """A `LiveExport` that hears of updates as a viewport does, and counts what it exports."""

    def __init__(self, monkeypatch) -> None:
        self.meshes = self.materials = self.worlds = self.placements = 0
        self.export = LiveExport()
        self.scene = None
        self.error: Exception | None = None
        self._patch = monkeypatch
        self._count(instances, "export_mesh", "meshes")
        self._count(materials, "export_material", "materials")
        self._count(kept, "export_world", "worlds")
        self._count(live, "Placement", "placements")

    def _count(self, module, function: str, name: str) -> None:
        whole = getattr(module, function)

        def counted(*arguments):
            setattr(self, name, getattr(self, name) + 1)
            return whole(*arguments)

        self._patch.setattr(module, function, counted)

    def hear(self, _scene, depsgraph) -> None:
        try:
            self.scene = self.export.update(depsgraph)
        except SceneError as error:
            self.error = error

    def counts(self) -> tuple[int, int, int]:
        return self.meshes, self.materials, self.worlds

    def after(self, edit: Callable[[], object]):
        """The scene after an edit, and how many meshes, materials and worlds were exported for it."""
        before = self.counts()
        edit()
        bpy.context.view_layer.update()
        exported = tuple(np.subtract(self.counts(), before))
        assert differences(self.scene, LiveExport().update(bpy.context.evaluated_depsgraph_get())) == []
        return self.scene, exported


@pytest.fixture
def viewport(monkeypatch) -> Iterator[Viewport]:
    """Of a scene with three cubes, two of which share a mesh, a material each, a lamp, a world and a camera."""
    scene = bpy.context.scene
    scene.world = new_with_nodes(bpy.data.worlds, "World")
    for number in range(2):
        bpy.ops.mesh.primitive_cube_add(location=(3 * number, 0, 0))
        bpy.context.object.data.materials.append(new_with_nodes(bpy.data.materials, f"Paint {number}"))
    add_object("Twin", bpy.data.objects["Cube"].data, (0, 3, 0))
    add_object("Lamp", bpy.data.lights.new("Lamp", "POINT"), (0, 0, 5)).data.energy = 10
    scene.camera = add_object("Camera", bpy.data.cameras.new("Camera"), (0, 0, 9))
    viewport = Viewport(monkeypatch)
    handlers = bpy.app.handlers.depsgraph_update_post, bpy.app.handlers.frame_change_post
    for handler in handlers:
        handler.append(viewport.hear)
    bpy.context.view_layer.update()
    assert viewport.counts() == (2, 2, 1)
    assert len(viewport.scene.instances) == 3 and len(viewport.scene.lights) == 1
    yield viewport
    for handler in handlers:
        handler.remove(viewport.hear)


def new_with_nodes(collection, name: str):
    datablock = collection.new(name)
    if bpy.app.version < (5, 0):
        datablock.use_nodes = True
    return datablock


def paint(number: int = 0):
    return bpy.data.materials[f"Paint {number}"].node_tree.nodes["Principled BSDF"].inputs


def cube():
    return bpy.data.objects["Cube"]


def differences(a, b, path: str = "scene") -> list[str]:
    """Where two exports differ. Their order of meshes and materials may be another, so that instances name them."""
    if is_dataclass(a) and type(a) is type(b):
        names = [field.name for field in fields(a)]
        return [d for name in names for d in differences(getattr(a, name), getattr(b, name), f"{path}.{name}")]
    if isinstance(a, list | tuple) and len(a) == len(b):
        return [d for i, (x, y) in enumerate(zip(a, b, strict=True)) for d in differences(x, y, f"{path}[{i}]")]
    return [] if np.array_equal(a, b) else [path]


def test_selecting_and_moving_the_camera_change_nothing(viewport):
    before = viewport.scene
    camera = bpy.data.objects["Camera"]

    def edits() -> None:
        cube().select_set(True)
        camera.location.x += 1
        camera.data.lens = 20

    scene, exported = viewport.after(edits)
    assert scene is before and exported == (0, 0, 0)


def test_a_moved_object_is_a_new_transform(viewport):
    before = viewport.scene
    scene, exported = viewport.after(lambda: cube().location.__setitem__(0, 7.0))
    assert exported == (0, 0, 0)
    assert scene.meshes is before.meshes and scene.materials is before.materials and scene.lights is before.lights
    assert 7.0 in scene.instances.transforms[:, 0, 3]


def test_a_material_is_exported_alone(viewport):
    before = viewport.scene
    scene, exported = viewport.after(lambda: paint()["Base Color"].__setattr__("default_value", (1, 0, 0, 1)))
    assert exported == (0, 1, 0)
    assert scene.instances is before.instances and scene.meshes is before.meshes and scene.world is before.world
    assert scene.materials is not before.materials


def color(number: int, red: float) -> Callable[[], None]:
    return lambda: paint(number)["Base Color"].__setattr__("default_value", (red, 0, 0, 1))


def walks(viewport, *edits: Callable[[], None]) -> int:
    """How often the edits have all objects looked at. `after` itself exports anew to compare."""
    before = viewport.placements
    for edit in edits:
        viewport.after(edit)
    return viewport.placements - before - len(edits)


def test_a_material_that_is_edited_again_leaves_objects_alone(viewport):
    """At its first edit nobody knows whether its objects have changed too: Blender lists them all."""
    assert walks(viewport, color(0, 0.1)) == 1
    assert walks(viewport, color(0, 0.2), color(0, 0.3)) == 0
    assert walks(viewport, color(1, 0.2)) == 1
    assert walks(viewport, color(1, 0.3), lambda: setattr(bpy.data.materials["Paint 1"], "pass_index", 7)) == 0
    assert walks(viewport, lambda: cube().location.__setitem__(0, 5.0)) == 1
    assert walks(viewport, color(0, 0.4), color(0, 0.5)) == 1


@pytest.mark.parametrize(
    "edit",
    [
        lambda: setattr(cube(), "visible_glossy", False),
        lambda: setattr(cube(), "is_holdout", True),
        lambda: setattr(cube(), "pass_index", 3),
        lambda: setattr(cube(), "hide_viewport", True),
        lambda: setattr(cube().material_slots[0], "material", bpy.data.materials["Paint 1"]),
        lambda: setattr(bpy.context.view_layer, "material_override", bpy.data.materials["Paint 1"]),
        lambda: cube().data.materials.clear(),
    ],
    ids=["visibility", "holdout", "pass index", "hidden", "slot", "override", "no slot"],
)
def test_an_object_that_changes_beside_its_material(viewport, edit):
    """`after` compares with a new export."""

    def both() -> None:
        color(0, 0.5)()
        edit()

    walks(viewport, color(0, 0.1), color(0, 0.2), both, color(0, 0.6), color(1, 0.6))


@pytest.mark.parametrize("how", ["driven", "keyed"])
def test_an_object_that_is_hidden_in_the_frame_in_which_its_material_changes(viewport, how):
    scene, socket = bpy.context.scene, paint(0)["Base Color"]
    if how == "driven":
        socket.driver_add("default_value", 0).driver.expression = "frame / 10"
        cube().driver_add("hide_viewport").driver.expression = "frame % 2"
    else:
        for frame in range(1, 9):
            socket.default_value[0], cube().hide_viewport = frame / 10, bool(frame % 2)
            socket.keyframe_insert("default_value", frame=frame)
            cube().keyframe_insert("hide_viewport", frame=frame)
    for frame in range(1, 9):
        viewport.after(lambda frame=frame: scene.frame_set(frame))


def test_a_surface_with_an_image_sequence(viewport, tmp_path):
    """No update names it when the frame changes: it is exported whenever any material is."""
    for number, red in ((1, 0.0), (2, 1.0)):
        still = bpy.data.images.new(f"Still {number}", 2, 2)
        still.pixels = [red, 0.5, 0.0, 1.0] * 4
        still.filepath_raw, still.file_format = str(tmp_path / f"still_{number:04}.png"), "PNG"
        still.save()
    tree = bpy.data.materials["Paint 0"].node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.load(str(tmp_path / "still_0001.png"))
    texture.image.source = "SEQUENCE"
    texture.image_user.frame_duration, texture.image_user.use_auto_refresh = 2, True
    viewport.after(lambda: tree.links.new(texture.outputs["Color"], paint(0)["Base Color"]))
    for frame in (1, 2, 1, 2):
        bpy.context.scene.frame_set(frame)
        walks(viewport, color(1, frame / 10), color(1, frame / 20))


def write_image(path, *color: float) -> None:
    image = bpy.data.images.new("Written", 2, 2)
    image.pixels = [*color, 1.0] * 4
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)


def test_an_image_that_is_read_again(viewport, tmp_path):
    """Blender lists the material and its tree, without the image."""
    path = tmp_path / "read.png"
    write_image(path, 1, 0, 0)
    tree = bpy.data.materials["Paint 0"].node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.load(str(path))
    viewport.after(lambda: tree.links.new(texture.outputs["Color"], paint(0)["Base Color"]))
    before = viewport.scene.materials

    def read_again() -> None:
        write_image(path, 0, 1, 0)
        texture.image.reload()

    scene, exported = viewport.after(read_again)
    assert exported == (0, 1, 0) and scene.materials != before


def test_a_scene_without_surfaces(viewport):
    for object_ in [o for o in bpy.data.objects if o.type == "MESH"]:
        bpy.data.objects.remove(object_)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not len(LiveExport().update(bpy.context.evaluated_depsgraph_get()).instances)


def test_a_material_of_a_holdout(viewport):
    cube().is_holdout = True
    walks(viewport, color(0, 0.1))
    assert walks(viewport, color(0, 0.2)) == 0


def test_a_change_that_makes_no_difference_is_none(viewport):
    before = viewport.scene
    scene, exported = viewport.after(lambda: paint()["IOR"].__setattr__("default_value", paint()["IOR"].default_value))
    assert scene is before and exported[0] == 0


def test_lamps(viewport):
    before = viewport.scene
    scene, exported = viewport.after(lambda: bpy.data.lights["Lamp"].__setattr__("energy", 50))
    assert exported == (0, 0, 0) and scene.instances is before.instances and scene.world is before.world
    assert scene.lights[0].intensity[0] == pytest.approx(5 * before.lights[0].intensity[0])
    moved, _ = viewport.after(lambda: bpy.data.objects["Lamp"].location.__setitem__(2, 1.0))
    assert moved.lights[0].transform[2, 3] == 1.0


def set_value(datablock, **values) -> Callable[[], None]:
    def edit() -> None:
        for key, value in values.items():
            setattr(datablock() if callable(datablock) else datablock, key, value)

    return edit


def lamp():
    """Its class changes with its type."""
    return bpy.data.lights["Lamp"]


LAMP_EDITS = {
    "energy": set_value(lamp, energy=3.0), "off": set_value(lamp, energy=0.0), "on": set_value(lamp, energy=7.0),
    "color": set_value(lamp, color=(1.0, 0.5, 0.0)), "area": set_value(lamp, type="AREA"),
    "size": lambda: setattr(lamp(), "size", 2.0) if lamp().type == "AREA" else None,
    "no area": lambda: setattr(lamp(), "size", 0.0) if lamp().type == "AREA" else None,
    "sun": set_value(lamp, type="SUN"), "spot": set_value(lamp, type="SPOT"), "point": set_value(lamp, type="POINT"),
    "shadow": set_value(lamp, use_shadow=False), "radius": set_value(lamp, shadow_soft_size=0.5),
}  # fmt: skip


def layer():
    return bpy.context.view_layer


def collection():
    """Of the second cube, in the view layer."""
    return layer().layer_collection.children["Second"]


# What leaves objects where they are, and as they are.
VIEW_EDITS = {
    "exposure": lambda: setattr(bpy.context.scene.view_settings, "exposure", 1.0),
    "film": lambda: setattr(bpy.context.scene.render, "film_transparent", True),
    "resolution": lambda: setattr(bpy.context.scene.render, "resolution_x", 333),
    "selected": lambda: cube().select_set(True),
    "active": lambda: setattr(layer().objects, "active", bpy.data.objects["Twin"]),
    "frame rate": lambda: setattr(bpy.context.scene.render, "fps", 30),
}

# Blender lists the scene for these too, and often nothing else.
SCENE_EDITS = {
    "hidden": lambda: cube().hide_set(True), "shown": lambda: cube().hide_set(False),
    "hidden lamp": lambda: bpy.data.objects["Lamp"].hide_set(True),
    "shown lamp": lambda: bpy.data.objects["Lamp"].hide_set(False),
    "excluded": set_value(collection, exclude=True), "included": set_value(collection, exclude=False),
    "hidden collection": set_value(collection, hide_viewport=True),
    "shown collection": set_value(collection, hide_viewport=False),
    "disabled collection": lambda: setattr(bpy.data.collections["Second"], "hide_viewport", True),
    "enabled collection": lambda: setattr(bpy.data.collections["Second"], "hide_viewport", False),
    "indirect only": set_value(collection, indirect_only=True), "direct": set_value(collection, indirect_only=False),
    "holdout": set_value(collection, holdout=True), "no holdout": set_value(collection, holdout=False),
    "no surfaces": set_value(layer, use_solid=False), "surfaces": set_value(layer, use_solid=True),
    "override": lambda: setattr(layer(), "material_override", bpy.data.materials["Paint 1"]),
    "no override": set_value(layer, material_override=None),
    "no inner objects": lambda: setattr(bpy.data.collections["Inner"], "hide_viewport", True),
    "inner objects": lambda: setattr(bpy.data.collections["Inner"], "hide_viewport", False),
    "an inner object less": lambda: setattr(bpy.data.objects["Inner cube"], "hide_viewport", True),
    "an inner object more": lambda: setattr(bpy.data.objects["Inner cube"], "hide_viewport", False),
    "offset": lambda: setattr(bpy.data.collections["Apart"], "instance_offset", (0, 0, 1)),
    "no offset": lambda: setattr(bpy.data.collections["Apart"], "instance_offset", (0, 0, 0)),
    "simplified": lambda: setattr(bpy.context.scene.render, "use_simplify", True),
    "not simplified": lambda: setattr(bpy.context.scene.render, "use_simplify", False),
    "swapped": lambda: (cube().hide_set(True), bpy.data.objects["Twin"].hide_set(False)),
    "swapped back": lambda: (cube().hide_set(False), bpy.data.objects["Twin"].hide_set(True)),
}  # fmt: skip

OBJECT_EDITS = {
    "moved": lambda: cube().location.__setitem__(0, cube().location[0] + 1.0),
    "moved lamp": lambda: bpy.data.objects["Lamp"].location.__setitem__(0, bpy.data.objects["Lamp"].location[0] + 1.0),
    "unseen lamp": lambda: setattr(bpy.data.objects["Lamp"], "visible_glossy", False),
    "seen lamp": lambda: setattr(bpy.data.objects["Lamp"], "visible_glossy", True),
    "another lamp": lambda: setattr(bpy.data.objects["Lamp"], "data", bpy.data.lights["Other"]),
    "the first lamp": lambda: setattr(bpy.data.objects["Lamp"], "data", bpy.data.lights["Lamp"]),
    "other lamp": lambda: setattr(
        bpy.data.lights["Other"], "energy", bpy.data.lights["Other"].energy + 1.0
    ),
    "red": lambda: color(0, 0.9)(), "green": lambda: color(0, 0.1)(),
}  # fmt: skip


@pytest.fixture
def in_collections(viewport) -> Viewport:
    """The second cube is in a collection of its own, and instanced with a lamp; the first has a subdivision. One more
    collection, with another in it, is there as an instance alone."""
    second = bpy.data.collections.new("Second")
    bpy.context.scene.collection.children.link(second)
    second.objects.link(bpy.data.objects["Cube.001"])
    bpy.context.scene.collection.objects.unlink(bpy.data.objects["Cube.001"])
    bpy.data.lights.new("Other", "SPOT").energy = 5
    instanced = bpy.data.objects.new("Instanced lamp", lamp())
    second.objects.link(instanced)
    empty = add_object("Empty", None, (0, 0, 4))
    empty.instance_type, empty.instance_collection = "COLLECTION", second
    apart, inner = bpy.data.collections.new("Apart"), bpy.data.collections.new("Inner")
    apart.children.link(inner)
    inner.objects.link(bpy.data.objects.new("Inner cube", cube().data))
    apart_here = add_object("Apart here", None, (0, 0, -4))
    apart_here.instance_type, apart_here.instance_collection = "COLLECTION", apart
    cube().modifiers.new("Smooth", "SUBSURF").levels = 2
    bpy.context.view_layer.update()
    return viewport


@pytest.mark.parametrize("name", [*LAMP_EDITS, *VIEW_EDITS])
def test_what_leaves_objects_alone(in_collections, name):
    """Walking through them takes the longer the more they are."""
    for type_ in ("POINT", "AREA"):
        lamp().type = type_
        bpy.context.view_layer.update()
        assert walks(in_collections, (LAMP_EDITS | VIEW_EDITS)[name]) == 0


def test_the_compositor_leaves_objects_alone(viewport):
    scene = bpy.context.scene
    if bpy.app.version < (5, 0):
        scene.use_nodes = True
        tree = scene.node_tree
    else:
        tree = scene.compositing_node_group = bpy.data.node_groups.new("Compositor", "CompositorNodeTree")
    blur = tree.nodes.new("CompositorNodeBlur")
    bpy.context.view_layer.update()
    assert walks(viewport, lambda: setattr(blur, "mute", True), lambda: tree.nodes.remove(blur)) == 0


def test_a_lamp_with_nodes(viewport):
    lamp().use_nodes = True
    strength = lamp().node_tree.nodes["Emission"].inputs["Strength"]
    bpy.context.view_layer.update()
    before = viewport.scene
    edits = [lambda value=value: setattr(strength, "default_value", value) for value in (2.0, 0.0, 3.0)]
    assert walks(viewport, *edits) == 0
    assert viewport.scene.lights[0].intensity[0] == pytest.approx(3 * before.lights[0].intensity[0])


@pytest.mark.parametrize("name", SCENE_EDITS)
def test_what_the_scene_says_of_its_objects(in_collections, name):
    """`after` compares with a new export, before and after the view is edited too."""
    viewport = in_collections
    viewport.after(VIEW_EDITS["exposure"])
    viewport.after(SCENE_EDITS[name])
    viewport.after(VIEW_EDITS["film"])
    viewport.after(lambda: (SCENE_EDITS[name](), LAMP_EDITS["on"]()))


@pytest.mark.parametrize("seed", range(6))
def test_edits_in_any_order(in_collections, seed):
    """One to three at a time."""
    random = np.random.default_rng(seed)
    edits = LAMP_EDITS | VIEW_EDITS | SCENE_EDITS | OBJECT_EDITS
    for _ in range(40):
        names = random.choice(list(edits), random.integers(1, 4), replace=False)
        try:
            in_collections.after(lambda names=names: [edits[name]() for name in names])
        except AssertionError as error:
            raise AssertionError(", ".join(names)) from error


def test_world(viewport):
    before = viewport.scene
    background = bpy.data.worlds["World"].node_tree.nodes["Background"].inputs
    scene, exported = viewport.after(lambda: background["Strength"].__setattr__("default_value", 3.0))
    assert exported == (0, 0, 1) and scene.instances is before.instances and scene.lights is before.lights
    assert scene.world.color != before.world.color
    other = new_with_nodes(bpy.data.worlds, "Other")
    scene, exported = viewport.after(lambda: setattr(bpy.context.scene, "world", other))
    assert exported[2] == 1
    scene, _ = viewport.after(lambda: setattr(bpy.context.scene, "world", None))
    assert scene.world.color == (0, 0, 0)


def test_the_sun_of_a_sky(viewport):
    """It is a lamp, and the objects' lamps stay as they are."""
    tree = bpy.data.worlds["World"].node_tree
    sky = tree.nodes.new("ShaderNodeTexSky")
    (lamp,) = viewport.scene.lights
    scene, _ = viewport.after(lambda: tree.links.new(sky.outputs["Color"], tree.nodes["Background"].inputs["Color"]))
    before = scene
    assert len(before.lights) == 2 and before.lights[0] is lamp
    placements = viewport.placements
    scene, exported = viewport.after(lambda: setattr(sky, "sun_elevation", 1.0))
    assert exported == (0, 0, 1) and viewport.placements == placements + 1  # that of `after` itself
    assert scene.lights[0] is lamp and scene.instances is before.instances and scene.world is not before.world
    assert scene.lights[1].transform[2, 2] == pytest.approx(np.sin(1.0), abs=1e-6)
    light = bpy.data.lights["Lamp"]
    again, _ = viewport.after(lambda: setattr(light, "energy", 2 * light.energy))
    assert again.lights[1] is scene.lights[1] and again.lights[0] is not lamp and again.world is scene.world
    again, _ = viewport.after(lambda: setattr(bpy.context.scene.render, "film_transparent", True))
    assert again.lights[1].visibility != scene.lights[1].visibility
    scene, _ = viewport.after(lambda: setattr(bpy.context.scene, "world", None))
    assert [light.name for light in scene.lights] == ["Lamp"]


@pytest.mark.parametrize("how", ["hide_set", "hide_viewport"])
def test_hidden_and_shown_again(viewport, how):
    def hide(hidden: bool) -> None:
        if how == "hide_set":
            cube().hide_set(hidden)
        else:
            cube().hide_viewport = hidden

    scene, exported = viewport.after(lambda: hide(True))
    assert len(scene.instances) == 2 and exported == (0, 0, 0)
    scene, _ = viewport.after(lambda: hide(False))
    assert len(scene.instances) == 3


def test_ray_visibility(viewport):
    scene, exported = viewport.after(lambda: setattr(cube(), "visible_camera", False))
    assert exported == (0, 0, 0) and scene.instances.visibility.min() < scene.instances.visibility.max()


def test_a_changed_mesh_is_exported_alone(viewport):
    data = bpy.data.objects["Cube.001"].data

    def edit() -> None:
        data.vertices[0].co.x = 9
        data.update()

    before = viewport.scene
    scene, exported = viewport.after(edit)
    assert exported == (1, 0, 0)
    assert len({*map(id, before.meshes)} & {*map(id, scene.meshes)}) == 1


def test_modifiers_and_edit_mode(viewport):
    scene, _ = viewport.after(lambda: cube().modifiers.new("Smooth", "SUBSURF"))
    assert max(len(mesh.triangles) for mesh in scene.meshes) == 48
    bpy.context.view_layer.objects.active = cube()
    viewport.after(lambda: bpy.ops.object.mode_set(mode="EDIT"))
    viewport.after(lambda: bpy.ops.object.mode_set(mode="OBJECT"))
    scene, _ = viewport.after(lambda: cube().modifiers.clear())
    assert max(len(mesh.triangles) for mesh in scene.meshes) == 12


def test_deleted_and_added_objects(viewport):
    scene, exported = viewport.after(lambda: bpy.data.objects.remove(bpy.data.objects["Cube.001"]))
    assert len(scene.instances) == 2 and exported == (0, 0, 0)
    scene, exported = viewport.after(lambda: bpy.ops.mesh.primitive_plane_add())
    assert len(scene.instances) == 3 and exported[0] == 1
    for _ in range(5):  # addresses that were freed are used again
        viewport.after(lambda: bpy.data.objects.remove(bpy.context.object))
        viewport.after(lambda: bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=4))
        viewport.after(lambda: bpy.data.objects.remove(bpy.context.object))
        viewport.after(lambda: bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=4, radius=3.0))


def test_instances_of_geometry_nodes_and_collections(viewport):
    bpy.ops.mesh.primitive_plane_add()
    plane = bpy.context.object
    group = bpy.data.node_groups.new("Cone", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    cone, out = group.nodes.new("GeometryNodeMeshCone"), group.nodes.new("NodeGroupOutput")
    to_instance = group.nodes.new("GeometryNodeGeometryToInstance")
    group.links.new(cone.outputs[0], to_instance.inputs[0])
    group.links.new(to_instance.outputs[0], out.inputs[0])
    scene, _ = viewport.after(lambda: setattr(plane.modifiers.new("Nodes", "NODES"), "node_group", group))
    assert len(scene.instances) == 4
    for count in (5, 6, 5):
        viewport.after(lambda count=count: setattr(cone.inputs["Vertices"], "default_value", count))
    collection = bpy.data.collections.new("Things")
    collection.objects.link(bpy.data.objects["Twin"])
    empty = add_object("Empty", None, (0, 0, 4))
    empty.instance_type = "COLLECTION"
    scene, _ = viewport.after(lambda: setattr(empty, "instance_collection", collection))
    assert len(scene.instances) == 5
    scene, exported = viewport.after(lambda: empty.location.__setitem__(0, 1.0))
    assert exported == (0, 0, 0)


def test_node_groups_and_images_reach_all_that_use_them(viewport):
    tree = bpy.data.materials["Paint 0"].node_tree
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    diffuse, out = group.nodes.new("ShaderNodeBsdfDiffuse"), group.nodes.new("NodeGroupOutput")
    group.links.new(diffuse.outputs[0], out.inputs[0])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    viewport.after(lambda: tree.links.new(node.outputs[0], output.inputs[0]))
    scene, exported = viewport.after(lambda: setattr(diffuse.inputs[0], "default_value", (0, 1, 0, 1)))
    assert (0.0, 1.0, 0.0) in [material.kd for material in scene.materials] and exported[0] == 0

    image = bpy.data.images.new("Image", 4, 4)
    texture = bpy.data.materials["Paint 1"].node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    viewport.after(
        lambda: bpy.data.materials["Paint 1"].node_tree.links.new(texture.outputs[0], paint(1)["Base Color"])
    )
    if bpy.app.version < (4, 5):
        return  # lists nothing for the pixels of an image that a script has just linked

    def repaint() -> None:
        image.pixels.foreach_set(np.tile(np.float32([0, 0, 1, 1]), 16))
        image.update()
        image.update_tag()

    scene, exported = viewport.after(repaint)
    assert exported[0] == 0
    assert any(material.kd[2] > material.kd[0] for material in scene.materials)


def test_material_override_and_another_scene(viewport):
    scene, _ = viewport.after(
        lambda: setattr(bpy.context.view_layer, "material_override", new_with_nodes(bpy.data.materials, "Override"))
    )
    assert [material.name for material in scene.materials] == ["default grey", "Override"]
    graph = bpy.context.evaluated_depsgraph_get()
    bpy.context.window.scene = bpy.data.scenes.new("Empty")
    assert not len(viewport.export.update(bpy.context.evaluated_depsgraph_get()).instances)
    assert graph is not None


def test_after_an_error_all_is_exported(viewport):
    inputs = paint()
    inputs["Emission Color"].default_value = (1, 1, 1, 1)
    inputs["Emission Strength"].default_value = 1e35
    bpy.context.view_layer.update()
    assert "its emission is" in str(viewport.error)
    viewport.after(lambda: inputs["Emission Strength"].__setattr__("default_value", 0.0))


def test_settings_of_a_viewport():
    """Those that only end a final render sooner leave it alone."""
    lobe = bpy.context.scene.lobe
    plain = export_viewport_settings(bpy.context.scene)
    lobe.samples, lobe.time_limit, lobe.use_adaptive_sampling, lobe.road = 3, 5.0, True, "REFERENCE"
    assert export_viewport_settings(bpy.context.scene) == plain
    lobe.viewport_samples, lobe.max_bounces = 7, 2
    settings = export_viewport_settings(bpy.context.scene)
    assert (settings.samples, settings.max_bounces) == (7, 2)


def test_a_thousand_edits_keep_no_meshes(viewport):
    kept = viewport.export._kept.meshes
    for number in range(1000):
        data = bpy.data.objects["Cube.001"].data
        data.vertices[0].co.x = 1 + number / 1000
        data.update()
        bpy.context.view_layer.update()
    assert len(kept._meshes) == 2 and not kept._asked
    assert len(viewport.scene.meshes) == 2


def fake_datablock(uid: int, address: int = 0, size: int = 8):
    """As much of a bpy datablock as `KeptMeshes` looks at."""
    original = SimpleNamespace(session_uid=uid)
    return SimpleNamespace(
        original=original, as_pointer=lambda: address, vertices=range(size), loops=range(size), polygons=range(size)
    )


def test_what_was_evaluated_again_is_not_taken_over_whatever_its_address():
    kept, exports = KeptMeshes(), iter("abcdefgh")

    def export(data, owner, *changed: int, with_uvs: bool = False) -> str:
        kept.forget(set(changed))
        mesh = kept.get(data, owner, None, with_uvs, lambda: next(exports))
        kept.finish()
        return mesh

    cube, twin, mesh = fake_datablock(1), fake_datablock(2), fake_datablock(3, address=64)
    assert export(mesh, cube) == export(mesh, cube) == export(mesh, twin) == export(mesh, cube, 99) == "a"
    assert export(mesh, cube, 3) == "b"  # its mesh has changed
    assert export(mesh, cube, 1) == "c"  # its modifiers
    assert export(mesh, twin, 2) == "d"  # another object, evaluated into the memory that the first one left
    assert export(fake_datablock(3, address=64, size=9), twin) == "e"
    assert export(mesh, twin) == "f"  # what nobody asked for was dropped
    assert export(mesh, cube, 2) == "g"  # the object that it was exported of has changed, not the one that asks
    assert export(mesh, cube, with_uvs=True) == "h"
