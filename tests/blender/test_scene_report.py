"""The scene report: nothing is dropped in silence, the panel and the command line say the same, and it finds objects.

`NAMED` and `HONOURED` are tables of what a scene can hold: each is named, or changes the export as asked.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import addon_utils
import bpy
import numpy as np
import pytest

from tools import blender_render
from tools.lobe_blender import MODULE

from .export_checks import add_camera, add_object, in_render, new_material, node_tree, plane_mesh

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


LEVELS = ("ERROR", "WARNING", "APPROXIMATED", "SKIPPED")


def texts(groups, *levels: str) -> list[str]:
    return [group.what for group in groups if group.level in (levels or LEVELS[:3])]


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


def exr_file(name: str, *parts: list[str]) -> str:
    """A file of 2 x 2 pixels with a part for each list of channels, all of them 0.5."""
    import OpenImageIO as oiio

    path, specs = str(Path(bpy.app.tempdir) / name), []
    for number, channels in enumerate(parts):
        specs.append(oiio.ImageSpec(2, 2, len(channels), "float"))
        specs[-1].channelnames = channels
        specs[-1].attribute("name", f"part{number}")
    file = oiio.ImageOutput.create(path)
    file.open(path, tuple(specs)) if len(specs) > 1 else file.open(path, specs[0])
    for number, spec in enumerate(specs):
        if number:
            file.open(path, spec, "AppendSubimage")
        file.write_image(np.full((2, 2, spec.nchannels), 0.5, np.float32))
    file.close()
    return path


def show_in_a_texture(path: str):
    image = feed("BsdfDiffuse", "ShaderNodeTexImage").image = bpy.data.images.load(path)
    return image


def world_volume():
    nodes = bpy.context.scene.world.node_tree
    output = next(node for node in nodes.nodes if node.bl_idname == "ShaderNodeOutputWorld")
    nodes.links.new(nodes.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])


def hair():
    system = plane().modifiers.new("Hair", "PARTICLE_SYSTEM").particle_system
    system.settings.type = "HAIR"
    system.settings.count = 3


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


def hair_curves():
    curves = bpy.data.hair_curves.new("Thing")
    curves.add_curves([2] * 20)
    ends = np.zeros((20, 2, 3), np.float32)
    ends[:, 0, 0] = ends[:, 1, 0] = np.linspace(-3, 3, 20)
    ends[:, 1, 1:] = 2.0
    curves.attributes["position"].data.foreach_set("vector", ends.ravel())
    curves.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", np.full(40, 0.1, np.float32))
    add_object("Thing", curves)


def point_cloud():
    points = bpy.data.pointclouds.new("Thing")
    if hasattr(points, "resize"):  # Blender 4.3 on: before, a script can make none
        points.resize(1)
        points.attributes["position"].data[0].vector = (0, 0, 3)
        points.attributes.new("radius", "FLOAT", "POINT").data[0].value = 1.0
    add_object("Thing", points)


# What is in the scene -> (how to make it, a part of what the report says, and at which level).
NAMED = {
    "volume object": (object_of("volumes"), "volumes are not supported", "WARNING"),
    "hair curves": (hair_curves, "hair curves are not supported", "WARNING"),
    "point cloud": (point_cloud, "point clouds are not supported", "WARNING"),
    "light probe": (lambda: bpy.ops.object.lightprobe_add(type="SPHERE"), "light probes are for EEVEE only", "SKIPPED"),
    "particle hair": (hair, "hair of particle system", "WARNING"),
    "adaptive subdivision": (None, "adaptive subdivision is not supported", "WARNING"),
    "motion blur": (put(render, use_motion_blur=True), "motion blur is not supported", "WARNING"),
    "stereo": (put(render, use_multiview=True), "stereo rendering is not supported", "WARNING"),
    "Freestyle": (None, "Freestyle lines that one can see through are drawn by EEVEE", "APPROXIMATED"),
    "caustics off": (
        cycles(lambda: bpy.context.scene, caustics_reflective=False), "caustics are switched off", "WARNING"),
    "few transparent bounces": (
        cycles(lambda: bpy.context.scene, transparent_max_bounces=2), "limit of 2 transparent bounces", "WARNING"),
    "fast GI": (cycles(lambda: bpy.context.scene, use_fast_gi=True), "Fast Global Illumination", "WARNING"),
    "transparent glass": (None, "Transparent Glass is not supported", "WARNING"),
    "camera culling": (None, "culling by the camera", "WARNING"),
    "panorama": (put(lambda: bpy.data.cameras["Camera"], type="PANO"), "type pano is not supported", "WARNING"),
    "passes": (put(layer, use_pass_vector=True), "these passes are not made: Vector;", "WARNING"),
    "Cycles' passes": (
        cycles(layer, denoising_store_passes=True), "not made: Store Denoising Passes (Cycles);", "WARNING"),
    "AOVs": (lambda: setattr(layer().aovs.add(), "name", "Dirt"),
             "shader AOVs are not supported and left out: Dirt; to remove them, choose Cycles", "WARNING"),
    "light groups": (lambda: layer().lightgroups.add(name="Key"),
                     "light groups are not supported and left out: Key; to remove them, choose Cycles", "WARNING"),
    "samples of a view layer": (put(layer, samples=7), "its own number of samples (7)", "WARNING"),
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
    "a world's bounces": (
        cycles(lambda: bpy.context.scene.world, max_bounces=1), "its own limit of bounces", "WARNING"),
    "a lamp's factors": (put(lamp, specular_factor=0.0), "specular factor: only EEVEE knows that", "SKIPPED"),
    "a lamp's reach": (put(lamp, use_custom_distance=True), "custom distance: only EEVEE knows that", "SKIPPED"),
    "IES": (lambda: light_nodes("ShaderNodeTexIES", "Strength"), "IES Texture is not supported", "WARNING"),
    "light falloff": (None, "Light Falloff is supported for a quadratic falloff", "WARNING"),
    "gobo": (lambda: light_nodes("ShaderNodeTexNoise", "Color"), "Noise Texture is not supported", "WARNING"),
    "world volume": (world_volume, "volumes are not supported", "WARNING"),
    "sky": (None, "Sky Texture is drawn with its default turbidity", "WARNING"),
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
    "UDIM tiles": (None, "UDIM tiles are not supported", "WARNING"),
    "glass": (lambda: shader("ShaderNodeBsdfGlass"), "Glass BSDF is not supported", "WARNING"),
    "holdout shader in a sum": (
        lambda: shader("ShaderNodeAddShader") and feed("AddShader", "ShaderNodeHoldout", "Shader"),
        "Holdout is not supported", "WARNING"),
    "clear coat": (
        lambda: shader("ShaderNodeEeveeSpecular", Clear_Coat=1.0), "clear coat is not supported", "WARNING"),
    "a principled surface's gloss": (
        lambda: shader("ShaderNodeBsdfPrincipled"), "don't grow stronger towards the edges", "APPROXIMATED"),
    "diffuse roughness": (
        lambda: shader("ShaderNodeBsdfDiffuse", Roughness=0.5), "roughness is not supported", "APPROXIMATED"),
    "layers of an image": (None, "several layers or views in one image are not supported", "WARNING"),
    "stereo image": (None, "the views of a stereo image are not supported", "WARNING"),
    "opaque shadows": (None, "opaque shadows of a transparent surface", "WARNING"),
    "backface culling": (
        lambda: setattr(plane().active_material, "use_backface_culling", True), "only EEVEE knows that", "SKIPPED"),
}  # fmt: skip


NO_MATERIAL = "without a material it is drawn as a diffuse surface, in Cycles with a Principled BSDF"
if V5:  # before that Cycles does the same
    NAMED["no material"] = (lambda: plane().data.materials.clear(), NO_MATERIAL, "APPROXIMATED")
    NAMED["an empty slot"] = (lambda: empty_slot(), NO_MATERIAL, "APPROXIMATED")
    NAMED["working space"] = (
        lambda: bpy.ops.wm.set_working_color_space(working_space="ACEScg"),
        "the working space ACEScg is not supported: colours are taken for Linear Rec.709",
        "WARNING",
    )


def empty_slot():
    plane().data.materials.append(None)
    for face in plane().data.polygons:
        face.material_index = 7  # beyond the last


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


@makes("transparent glass")
def _():
    bpy.context.scene.render.film_transparent = bpy.context.scene.cycles.film_transparent_glass = True


@makes("Freestyle")
def _():
    lines = layer().freestyle_settings.linesets
    (lines[0] if len(lines) else lines.new("Lines")).linestyle = bpy.data.linestyles.new("Style")
    lines[0].linestyle.alpha = 0.5
    render().use_freestyle = layer().use_freestyle = True


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
    sky = nodes.nodes.new("ShaderNodeTexSky")
    sky.sky_type, sky.turbidity = "PREETHAM", 5.0
    nodes.links.new(sky.outputs[0], nodes.nodes["Background"].inputs["Color"])


@makes("bump on Toon")
def _():
    node = shader("ShaderNodeBsdfToon")
    nodes = node.id_data
    nodes.links.new(nodes.nodes.new("ShaderNodeBump").outputs[0], node.inputs["Normal"])


@makes("UDIM tiles")
def _():
    image = feed("BsdfDiffuse", "ShaderNodeTexImage").image = bpy.data.images.new("Tiled", 4, 4, tiled=True)
    image.tiles.new(1002)


@makes("layers of an image")
def _():
    show_in_a_texture(exr_file("layers.exr", ["First.R", "First.G", "First.B", "Second.R", "Second.G", "Second.B"]))


@makes("stereo image")
def _():
    show_in_a_texture(exr_file("one.exr", ["R", "G", "B"])).use_multiview = True


@makes("opaque shadows")
def _():
    shader("ShaderNodeBsdfTransparent")
    plane().active_material.use_transparent_shadow = False


@pytest.mark.parametrize("case", NAMED)
def test_what_is_not_drawn_as_asked_is_named(scene, checked, rendered, case) -> None:
    """And what is called left out changes nothing in the picture, whoever else might draw it. A material is made with
    what it leaves out, and changes the picture by itself."""
    make, expected, level = NAMED[case]
    before, picture = checked(), rendered(scene)
    assert texts(before, *LEVELS) == []
    make()
    groups = [group for group in checked() if group.level == level]
    found = texts(groups, level)
    assert any(expected in text for text in found), found
    if any((level == "SKIPPED" or "left out" in group.what) and group.kind != "material" for group in groups):
        assert np.array_equal(rendered(scene), picture)


@pytest.mark.parametrize("case", ["passes", "Cycles' passes"])
def test_passes_that_are_not_made_can_be_unticked(scene, part, checked, case) -> None:
    """In Lobe's own panel, which shows them for as long as they are ticked."""
    panel = part("ui.passes_panels").LOBE_VIEWLAYER_PT_passes_not_made
    context = SimpleNamespace(engine="LOBE", view_layer=layer())
    assert not panel.poll(context)
    NAMED[case][0]()
    assert panel.poll(context) and checked()
    ticked = []
    column = SimpleNamespace(prop=lambda owner, key, text: ticked.append((owner, key)))
    column.column = lambda **_: column
    panel.draw(SimpleNamespace(column=lambda: column), context)
    for owner, key in ticked:
        setattr(owner, key, False)
    assert not panel.poll(context) and checked() == []


@pytest.mark.parametrize(
    ("parts", "several"),
    [
        ([["R", "G", "B"]], False),
        ([["R", "G", "B", "A", "Z"]], False),
        ([["Layer.Combined.R", "Layer.Combined.G", "Layer.Combined.B", "Layer.Combined.A"]], False),
        ([["Layer.Combined.R", "Layer.Combined.G", "Layer.Combined.B", "Layer.Depth.Z"]], True),
        ([["R", "G", "B"], ["R", "G", "B"]], True),
    ],
)
def test_an_image_of_several_pictures_is_named(scene, checked, parts, several) -> None:
    """And one that has no more than one is not, whatever its channels are called."""
    image = show_in_a_texture(exr_file("parts.exr", *parts))
    named = [(group.kind, group.names) for group in checked() if "several layers" in group.what]
    assert named == [("image", ("parts.exr",))][: int(several)]
    if several:
        image.pack()
        assert any("has several layers or views and is packed" in text for text in texts(checked()))


def test_objects_without_a_material_are_one_line_that_finds_them(scene, checked) -> None:
    """Not those whose faces all have one, nor those that the view layer gives one."""
    shared = plane_mesh()
    for number in range(3):
        add_object(f"Bare {number}", shared)
    painted = add_object("Painted", plane_mesh())
    painted.data.materials.append(plane().active_material)
    painted.data.materials.append(None)
    assert [(group.kind, group.names) for group in checked()] == [("object", ("Bare 0", "Bare 1", "Bare 2"))][: int(V5)]
    layer().material_override = plane().active_material
    assert checked() == []
    layer().material_override = None
    for number in range(3):
        bpy.data.objects[f"Bare {number}"].is_holdout = True
    assert checked() == []


def test_the_gloss_of_principled_surfaces_is_one_line_with_their_names(scene, checked) -> None:
    for number in range(2):
        material, _ = new_material(f"Shiny {number}", "ShaderNodeBsdfPrincipled")
        add_object(f"Ball {number}", plane_mesh()).data.materials.append(material)
    (group,) = checked()
    assert (group.kind, group.names) == ("material", ("Shiny 0", "Shiny 1"))


# --- what is honoured -------------------------------------------------------------------------------------------------


def geometry_nodes_instances():
    """A cube at each corner of the plane."""
    group = bpy.data.node_groups.new("Scatter", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeInstanceOnPoints", "GeometryNodeMeshCube", "NodeGroupOutput")
    start, scatter, cube, end = (group.nodes.new(kind) for kind in kinds)
    group.links.new(start.outputs[0], scatter.inputs["Points"])
    group.links.new(cube.outputs["Mesh"], scatter.inputs["Instance"])
    group.links.new(scatter.outputs[0], end.inputs[0])
    plane().modifiers.new("Scatter", "NODES").node_group = group


def collection_instance():
    inner = bpy.data.collections.new("Inner")
    inner.objects.link(bpy.data.objects.new("Inside", plane_mesh()))
    empty = add_object("Instancer", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", inner


def background_scene():
    other = bpy.data.scenes.new("Set")
    other.collection.objects.link(bpy.data.objects.new("Backdrop", plane_mesh()))
    bpy.context.scene.background_set = other


def depth_of_field():
    dof = bpy.data.cameras["Camera"].dof
    dof.use_dof, dof.aperture_fstop, dof.aperture_blades, dof.aperture_ratio = True, 1.0, 6, 2.0


def border():
    render().use_border, render().border_max_x = True, 0.5


def meta():
    data = bpy.data.metaballs.new("Meta")
    data.elements.new()
    add_object("Meta", data)


def curve():
    data = bpy.data.curves.new("Curve", "CURVE")
    data.splines.new("BEZIER").bezier_points.add(1)
    data.splines[0].bezier_points[1].co = (1, 0, 0)
    data.bevel_depth = 0.1
    add_object("Curve", data)


def only_in_renders():
    """What the viewport's evaluation doesn't hold."""
    object_of("volumes")()
    bpy.data.objects["Thing"].hide_viewport = True


def subdivided_in_renders():
    modifier = plane().modifiers.new("Subdivision", "SUBSURF")
    modifier.levels, modifier.render_levels = 0, 2


def instances(exported) -> int:
    return len(exported.instances.mesh)


# What is in the scene -> (how to make it, what is then true of the exported scene).
HONOURED = {
    "text": (lambda: setattr(add_object("Text", bpy.data.curves.new("Text", "FONT")).data, "body", "A"),
             lambda scene: instances(scene) == 2),
    "curve": (curve, lambda scene: instances(scene) == 2),
    "metaball": (meta, lambda scene: instances(scene) == 2),
    "collection instance": (collection_instance, lambda scene: instances(scene) == 2),
    "geometry nodes": (geometry_nodes_instances, lambda scene: instances(scene) == 4),
    "background scene": (background_scene, lambda scene: instances(scene) == 2),
    "render subdivision": (subdivided_in_renders, lambda scene: len(scene.meshes[0].triangles) == 32),
    "no environment": (put(layer, use_sky=False), lambda scene: not any(scene.world.color)),
    "film": (put(render, film_transparent=True), lambda scene: scene.transparent_film),
    "border": (border, lambda scene: scene.region == (0, 0, 16, 24)),
    "depth of field": (
        depth_of_field, lambda scene: (a := scene.camera.aperture) is not None and (a.blades, a.ratio) == (6, 2.0)),
    "orthographic": (put(lambda: bpy.data.cameras["Camera"], type="ORTHO"), lambda scene: scene.camera.orthographic),
    "hidden from the camera": (
        put(plane, visible_camera=False), lambda scene: not scene.instances.visibility[0] & 1),
    "indirect only": (
        lambda: collection_flag(indirect_only=True),
        lambda scene: sorted(v & 1 for v in scene.instances.visibility) == [0, 1]),
    "holdout object": (put(plane, is_holdout=True), lambda scene: any(m.holdout for m in scene.materials)),
    "holdout shader": (
        lambda: shader("ShaderNodeHoldout"), lambda scene: any(m.holdout for m in scene.materials)),
    "holdout collection": (
        lambda: collection_flag(holdout=True), lambda scene: any(m.holdout for m in scene.materials)),
    "no shadow": (put(lamp, use_shadow=False), lambda scene: not scene.lights[0].cast_shadow),
    "soft falloff off": (put(lamp, use_soft_falloff=False), lambda scene: not scene.lights[0].soft_falloff),
    "exposure of the film": (
        cycles(lambda: bpy.context.scene, film_exposure=2.0), lambda scene: scene.exposure == 2.0),
    "material override": (
        lambda: setattr(layer(), "material_override", new_material("Over", "ShaderNodeEmission")[0]),
        lambda scene: any(scene.materials[scene.instances.material_table[0]].emission)),
}  # fmt: skip


@pytest.mark.parametrize("case", HONOURED)
def test_what_is_honoured_is_drawn_and_not_listed(scene, part, checked, case) -> None:
    make, holds = HONOURED[case]
    export_scene = part("export").export_scene
    assert not holds(in_render(lambda engine, graph: export_scene(graph)))
    make()
    assert holds(in_render(lambda engine, graph: export_scene(graph)))
    assert [text for text in texts(checked()) if not text.startswith(NO_MATERIAL)] == []


# --- the check ------------------------------------------------------------------------------------------------------


def test_the_check_sees_what_a_render_sees(scene, checked) -> None:
    only_in_renders()
    assert [group.names for group in checked()] == [("Thing",)]
    bpy.data.objects["Thing"].hide_render = True
    assert checked() == []


def test_all_view_layers_are_checked(scene, checked) -> None:
    scene.view_layers.new("Second").use_pass_vector = True
    assert [group.names for group in checked()] == [("Second",)]


def test_the_check_leaves_everything_as_it_was(scene, checked) -> None:
    engines = {cls for cls in bpy.types.RenderEngine.__subclasses__() if cls.is_registered}
    names = ("scenes", "objects", "meshes", "materials", "collections", "worlds", "node_groups")
    before = {name: len(getattr(bpy.data, name)) for name in names}
    scene.render.use_compositing = True
    checked()
    assert {name: len(getattr(bpy.data, name)) for name in before} == before
    assert bpy.context.scene == scene and scene.render.engine == "LOBE" and scene.render.use_compositing
    assert {cls for cls in bpy.types.RenderEngine.__subclasses__() if cls.is_registered} == engines


def test_handlers_of_renders_hear_nothing_of_a_check(scene, checked, rendered) -> None:
    heard = []

    def hear(*_) -> None:
        heard.append(1)

    lists = (bpy.app.handlers.render_init, bpy.app.handlers.render_pre, bpy.app.handlers.render_complete)
    for handlers in lists:
        handlers.append(hear)
    try:
        checked()
        assert heard == []
        rendered(scene)
        assert len(heard) == 3
    finally:
        for handlers in lists:
            handlers.remove(hear)


def test_the_render_result_stays(scene, checked, rendered, tmp_path) -> None:
    pixels = rendered(scene)
    checked()
    bpy.data.images["Render Result"].save_render(str(tmp_path / "again.exr"), scene=scene)
    import OpenImageIO as oiio

    again = oiio.ImageBuf(str(tmp_path / "again.exr")).get_pixels(oiio.FLOAT)
    assert pixels.max() > 0.0 and np.array_equal(again[::-1], pixels)


def test_the_tooltip_says_that_a_check_cannot_be_stopped() -> None:
    """Blender waits for it, and looks at no key meanwhile."""
    assert "can't be stopped" in bpy.ops.lobe.check_scene.get_rna_type().description


def mean_color(slot: int) -> list[float]:
    """Of the picture in a slot of the Render Result, which becomes the active one."""
    import OpenImageIO as oiio

    image, path = bpy.data.images["Render Result"], str(Path(bpy.app.tempdir) / "slot.png")
    image.render_slots.active_index = slot
    image.save_render(path, scene=bpy.context.scene)
    return [round(channel, 2) for channel in oiio.ImageBuf(path).get_pixels(oiio.FLOAT)[..., :3].mean((0, 1))]


def render_into(slot: int, color: tuple[float, float, float]) -> None:
    scene = bpy.context.scene
    plane().hide_render, scene.view_settings.view_transform = True, "Standard"
    background = next(node for node in scene.world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    background.inputs["Color"].default_value = (*color, 1.0)
    if "Render Result" in bpy.data.images:
        bpy.data.images["Render Result"].render_slots.active_index = slot
    bpy.ops.render.render()


RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@pytest.mark.parametrize("active", [0, 1, 2])
def test_the_pictures_in_all_slots_stay(scene, checked, active: int) -> None:
    """Whichever of them is the active one, which it remains."""
    render_into(0, RED)
    render_into(1, GREEN)
    slots = bpy.data.images["Render Result"].render_slots
    slots.active_index = active
    for _ in range(2):
        checked()
        assert slots.active_index == active
    assert (mean_color(0), mean_color(1)) == ([*RED], [*GREEN])
    with pytest.raises(RuntimeError):  # there is nothing in it
        mean_color(2)


def test_the_pictures_in_all_slots_stay_where_a_slot_was_removed(scene, checked) -> None:
    """Before that of the newest picture."""
    for slot, color in ((0, BLUE), (2, GREEN), (1, RED)):
        render_into(slot, color)
    slots = bpy.data.images["Render Result"].render_slots
    slots.active_index = 0
    window = bpy.context.window_manager.windows[0]
    area = window.screen.areas[0]
    area.type = "IMAGE_EDITOR"
    area.spaces.active.image = bpy.data.images["Render Result"]
    with bpy.context.temp_override(window=window, area=area):
        assert bpy.ops.image.remove_render_slot() == {"FINISHED"}
    slots.active_index = 1
    checked()
    assert (mean_color(0), mean_color(1)) == ([*RED], [*GREEN])


@pytest.mark.parametrize(
    ("make", "kind", "text"),
    [
        (lambda: setattr(bpy.context.scene, "camera", None), "", "the scene has no camera"),
        (lambda: setattr(layer(), "use", False), "", "no view layer is rendered: tick Use for Rendering"),
        (lambda: setattr(lamp(), "energy", -1.0), "light", "negative"),
        (
            put(lambda: bpy.data.cameras["Camera"], type="ORTHO", ortho_scale=0.0), "camera",
            "its view is empty: check its focal length, sensor size and orthographic scale",
        ),
        (
            put(lambda: bpy.data.cameras["Camera"], clip_start=50.0, clip_end=10.0), "camera",
            "its clip start (50 m) must be nearer than its clip end (10 m)",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_rendered(scene, part, checked, make, kind, text) -> None:
    """What is at fault can be selected."""
    make()
    (group,) = [group for group in checked() if group.level == "ERROR"]
    assert group.kind == kind and text in group.what
    assert group.names == ((kind.replace("light", "lamp").capitalize(),) if kind else ())
    found = part("ui.objects_of").objects_of(layer(), bpy.context.evaluated_depsgraph_get(), [group])
    assert [object_.name for object_ in found[0]] == list(group.names)
    assert not blender_render.check(scene).is_nearly_honoured


def test_a_view_layer_alone_is_rendered_in_windows_only(scene, checked) -> None:
    layer().use = False
    scene.render.use_single_layer = True
    assert texts(checked(), "ERROR") == [
        "no view layer is rendered: tick Use for Rendering in View Layer properties > View Layer"
    ]


def test_objects_of_one_name_are_told_apart(scene, part, checked, tmp_path) -> None:
    """As those of linked files may be."""
    for name in ("a", "b"):
        collection = bpy.data.collections.new(f"From {name}")
        thing = bpy.data.objects.new("Thing", bpy.data.volumes.new("Volume"))
        collection.objects.link(thing)
        bpy.data.libraries.write(str(tmp_path / f"{name}.blend"), {collection})
        bpy.data.collections.remove(collection)
        bpy.data.objects.remove(thing)
    plane().name = "Thing"
    for name in ("a", "b"):
        with bpy.data.libraries.load(str(tmp_path / f"{name}.blend"), link=True) as (_, into):
            into.collections = [f"From {name}"]
        scene.collection.children.link(into.collections[0])
    (group,) = checked()
    assert group.names == ("Thing [a.blend]", "Thing [b.blend]")
    (found,) = part("ui.objects_of").objects_of(layer(), bpy.context.evaluated_depsgraph_get(), [group])
    assert {object_.name_full for object_ in found} == set(group.names)


def test_a_crash_is_named_and_not_swallowed(scene, part, checked, monkeypatch, capfd) -> None:
    def fail(*_, **__):
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(part("check"), "export_scene", fail)
    text = "Lobe failed (ZeroDivisionError: on purpose). This is a bug: the console has the details"
    assert texts(checked(), "ERROR") == [text]
    assert "ZeroDivisionError" in capfd.readouterr().err


def test_a_crash_names_its_object_as_a_render_does(scene, part, checked, monkeypatch) -> None:
    def fail(*_, **__):
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(part("export.instances"), "export_mesh", fail)
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.render.render()
    (text,) = texts(checked(), "ERROR")
    assert "at object 'Plane'" in text and str(caught.value).strip() == f"Error: {text}"


QUOTES = ["Bob's lamp", 'The "best" lamp', "Both ' and \"", "C:\\new\\lamp", "\\'", "it's: 'quoted': twice"]


@pytest.mark.parametrize("name", QUOTES)
def test_names_with_quotes_keep_their_row(scene, part, checked, name) -> None:
    """Of what the export notes and of what the engine raises, as sentences too."""
    lamp().energy, lamp().specular_factor = -1.0, 0.5
    bpy.data.objects["Lamp"].name = name
    groups = [group for group in checked() if group.kind == "light"]
    assert {group.level for group in groups} == {"ERROR", "SKIPPED"}
    assert all(group.names == (name,) for group in groups)
    note = part("export.notes").Note("WARNING", "object", name, "it is 'odd': very")
    assert part("scene_report").note_from_sentence("WARNING", note.sentence) == note


def test_names_with_quotes_are_grouped(part) -> None:
    Note = part("export.notes").Note
    notes = [Note("WARNING", "material", str(i), f"image {name!r} is not mapped") for i, name in enumerate(QUOTES)]
    (group,) = part("export.notes").grouped(notes)
    assert len(group.names) == len(QUOTES) and group.what == "image '...' is not mapped"


def test_a_check_and_a_render_say_the_same_of_the_settings(scene, part, checked) -> None:
    """Of the reference, which leaves out what the compiled road does."""
    scene.lobe.use_adaptive_sampling, layer().use_pass_z = True, True
    assert checked() == []
    scene.lobe.road = "REFERENCE"
    found = texts(checked(), "WARNING")
    assert len(found) == 2 and all("not part of the reference road" in text for text in found)
    bpy.ops.render.render()
    assert texts(part("scene_report").report_of(scene).groups, "WARNING") == found


# --- the report -----------------------------------------------------------------------------------------------------


def three_of_glass() -> None:
    shader("ShaderNodeBsdfGlass")
    for number in range(2):
        material, _ = new_material(f"Glass {number}", "ShaderNodeBsdfGlass")
        add_object(f"Pane {number}", plane_mesh()).data.materials.append(material)


def test_equal_notes_are_counted_once(scene, checked) -> None:
    three_of_glass()
    groups = [group for group in checked() if "Glass BSDF" in group.what]
    assert [sorted(group.names) for group in groups] == [["Glass 0", "Glass 1", "Other"]]


def test_names_of_images_do_not_keep_notes_apart(part) -> None:
    notes = part("export").Notes()
    for name in ("a.png", "b.png"):
        notes.warn("material", name, f"image '{name}' is drawn in its average colour: textures are not supported yet")
    (group,) = part("export").grouped(notes.all)
    assert group.what == "image '...' is drawn in its average colour: textures are not supported yet"
    assert len(group.names) == 2


def test_what_changes_no_pixel_of_the_picture_comes_last_of_its_level(part) -> None:
    notes = part("export").Notes()
    notes.warn("view layer", "Layer", "these passes are not made: Vector")
    notes.warn("material", "Pane", "Glass BSDF is not supported")
    notes.warn_scene("fast GI is not supported")
    assert [group.kind for group in part("export").grouped(notes.all)] == ["", "material", "view layer"]


def test_a_render_fills_the_list_too(scene, part, rendered) -> None:
    three_of_glass()
    rendered(scene)
    report = part("scene_report").report_of(scene)
    assert report.source == "render"
    assert any("Glass BSDF" in group.what and len(group.names) == 3 for group in report.groups)


def test_a_render_that_fails_does_so(scene, part) -> None:
    lamp().energy = -1.0
    with pytest.raises(RuntimeError, match="negative"):
        bpy.ops.render.render()
    (group,) = part("scene_report").report_of(scene).of_level("ERROR")
    assert group.names == ("Lamp",)


def test_two_scenes_have_reports_of_their_own(scene, part, checked) -> None:
    shader("ShaderNodeBsdfGlass")
    other = bpy.data.scenes.new("Other")
    checked()
    assert part("scene_report").report_of(other) is None


def test_loading_a_file_forgets(scene, part, checked, tmp_path) -> None:
    shader("ShaderNodeBsdfGlass")
    checked()
    path = str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    assert part("scene_report").report_of(bpy.context.scene) is not None
    bpy.ops.wm.open_mainfile(filepath=path)
    assert part("scene_report").report_of(bpy.context.scene) is None


def test_a_file_that_cannot_be_opened_leaves_all_that_is_known(scene, part, checked, tmp_path, monkeypatch) -> None:
    """The file that is open stays so."""
    shader("ShaderNodeBsdfGlass")
    checked()
    operators, understood = part("compare.operators"), part("ui.understood").understood
    monkeypatch.setitem(operators._outcomes, scene.session_uid, outcome := object())
    known = understood.of(bpy.data.materials[0])
    with pytest.raises(RuntimeError, match=r"missing\.blend"):
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "missing.blend"))
    assert part("scene_report").report_of(scene) is not None
    assert operators.outcome_of(scene) is outcome
    assert understood.of(bpy.data.materials[0]) is known
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert not (part("scene_report")._reports or operators._outcomes or understood._known)


def test_switching_the_add_on_off_and_on(scene, part, checked) -> None:
    shader("ShaderNodeBsdfGlass")
    groups = checked()
    addon_utils.disable(MODULE)
    gone = bpy.data.scenes.new("Gone")
    part("scene_report").keep(part("scene_report").key(gone), "check", [])
    bpy.data.scenes.remove(gone)
    addon_utils.enable(MODULE, default_set=True)
    assert list(part("scene_report").report_of(scene).groups) == groups
    assert len(part("scene_report")._reports) == 1


def test_what_matters_most_comes_first(scene, part, checked) -> None:
    """The gloss of Principled BSDFs, of which there are many, is last of what isn't drawn quite as asked."""
    for number in range(3):
        material, _ = new_material(f"Shiny {number}", "ShaderNodeBsdfPrincipled")
        add_object(f"Ball {number}", plane_mesh()).data.materials.append(material)
    add_object("Chalk", plane_mesh()).data.materials.append(
        new_material("Chalk", "ShaderNodeBsdfDiffuse", Roughness=1)[0]
    )
    shader("ShaderNodeBsdfGlass")
    lamp().energy, lamp().specular_factor = -1.0, 0.5
    groups = checked()
    assert [group.level for group in groups] == ["ERROR", "WARNING", "APPROXIMATED", "APPROXIMATED", "SKIPPED"]
    assert "Diffuse BSDF's roughness" in groups[2].what and groups[3].what == part("export.notes").PRINCIPLED_GLOSS


def test_what_is_drawn_nearly_as_asked_is_not_as_asked(scene, part) -> None:
    shader("ShaderNodeBsdfPrincipled")
    honoured, nearly, lines = blender_render.check(scene)
    assert not honoured and nearly and lines[0] == "Drawn nearly as asked:"


# --- the panel -----------------------------------------------------------------------------------------------------


def press(part, index: int) -> set[str]:
    """The button of a line of the report as it is now."""
    number = part("scene_report").report_of(bpy.context.scene).number
    return bpy.ops.lobe.select_reported(report_number=number, index=index)


def select(part, what: str) -> set[str]:
    groups = part("scene_report").report_of(bpy.context.scene).groups
    index = next(i for i, group in enumerate(groups) if what in group.what)
    assert press(part, index) == {"FINISHED"}
    return {object_.name for object_ in bpy.context.view_layer.objects if object_.select_get()}


def test_the_button_selects_the_objects(scene, part, checked) -> None:
    three_of_glass()
    plane().is_shadow_catcher = True
    lamp().cycles.max_bounces = 1
    bpy.data.cameras["Camera"].type = "PANO"
    checked()
    assert select(part, "Glass BSDF") == {"Plane", "Pane 0", "Pane 1"}
    assert select(part, "shadow catchers") == {"Plane"}
    assert bpy.context.view_layer.objects.active == plane()
    assert select(part, "limit of bounces") == {"Lamp"}
    assert select(part, "type pano") == {"Camera"}


def test_the_button_selects_what_instances_an_object(scene, part, checked) -> None:
    collection_instance()
    bpy.data.objects["Inside"].is_shadow_catcher = True
    checked()
    assert select(part, "shadow catchers") == {"Instancer"}


def set_by_nodes(*kinds: str):
    """Geometry nodes on the plane: a chain of these, into its output."""
    group = bpy.data.node_groups.new("Chain", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    last = group.nodes.new("NodeGroupInput").outputs[0]
    made = [group.nodes.new(kind) for kind in kinds]
    for node in made:
        if node.inputs[0].type == "GEOMETRY":
            group.links.new(last, node.inputs[0])
        last = node.outputs["Geometry"]
    group.links.new(last, group.nodes.new("NodeGroupOutput").inputs[0])
    plane().modifiers.new("Chain", "NODES").node_group = group
    return made


def with_buttons(part) -> set[tuple[str, str]]:
    """Kind and text of the lines of the report that have a button."""
    report, buttons = part("scene_report").report_of(bpy.context.scene), part("ui.report_panel")._buttons
    return {(group.kind, group.what) for group in report.groups if buttons.has(report, group)}


def test_the_button_selects_what_nodes_give_a_material(scene, part, checked) -> None:
    (node,) = set_by_nodes("GeometryNodeSetMaterial")
    node.inputs["Material"].default_value, _ = new_material("Glass", "ShaderNodeBsdfGlass")
    checked()
    assert select(part, "Glass BSDF") == {"Plane"}
    assert any("Glass BSDF" in what for _, what in with_buttons(part))


def test_the_button_selects_what_places_an_object_by_nodes(scene, part, checked) -> None:
    hidden = bpy.data.objects.new("Placed", plane_mesh(name="Placed"))  # in no collection
    hidden.is_shadow_catcher = True
    (node,) = set_by_nodes("GeometryNodeObjectInfo")
    node.inputs["Object"].default_value, node.inputs["As Instance"].default_value = hidden, True
    checked()
    assert select(part, "shadow catchers") == {"Plane"}


def test_a_button_that_finds_nothing_says_so(scene, part, checked) -> None:
    """Objects of the background scene. The image of the world has no button: no object can have it."""
    other = bpy.data.scenes.new("Background")
    scene.background_set = other
    catcher = bpy.data.objects.new("Catcher", plane_mesh(name="Catcher"))
    catcher.is_shadow_catcher = True
    other.collection.objects.link(catcher)
    nodes = scene.world.node_tree
    texture = nodes.nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.new("Sky", 8, 4, tiled=True)
    texture.image.tiles.new(1002)
    background = next(node for node in nodes.nodes if node.bl_idname == "ShaderNodeBackground")
    nodes.links.new(texture.outputs[0], background.inputs["Color"])
    groups = checked()
    assert {(group.kind, *group.names) for group in groups} >= {("object", "Catcher"), ("image", "Sky")}
    assert {kind for kind, _ in with_buttons(part)} == {"object"}
    for index in range(len(groups)):
        assert press(part, index) == {"CANCELLED"}
    feed("BsdfDiffuse", "ShaderNodeTexImage").image = texture.image
    checked()
    assert {kind for kind, _ in with_buttons(part)} == {"image", "material", "object"}


def test_instances_are_walked_only_where_something_could_be_found(scene, part) -> None:
    """Of an image that nothing but the world shows, and one that a material shows."""

    class Depsgraph:
        walks = 0

        @property
        def object_instances(self):
            self.walks += 1
            return iter(())

    bpy.data.images.new("Sky", 8, 4)
    feed("BsdfDiffuse", "ShaderNodeTexImage").image = bpy.data.images.new("Wood", 8, 4)
    plane().data.materials.clear()
    depsgraph, notes = Depsgraph(), part("export").Notes()
    for name, walks in (("Sky", 0), ("Wood", 1)):
        notes.warn("image", name, "UDIM tiles are not supported, only the first is read")
        groups = part("export").grouped(notes.all[-1:])
        assert part("ui.objects_of").may_have_objects(groups[0]) == bool(walks)
        assert depsgraph.walks == 0
        assert part("ui.objects_of").objects_of(bpy.context.view_layer, depsgraph, groups) == [[]]
        assert depsgraph.walks == walks


def test_the_button_says_when_nothing_is_left(scene, part, checked) -> None:
    plane().is_shadow_catcher = True
    checked()
    bpy.data.objects.remove(plane())
    assert press(part, 0) == {"CANCELLED"}
    assert press(part, 99) == {"CANCELLED"}


def test_a_button_of_an_older_report_selects_nothing(scene, part, checked, capfd) -> None:
    """A render may put another list in place of the one on the screen, with other lines at the same places."""
    plane().is_shadow_catcher = True
    checked()
    number = part("scene_report").report_of(scene).number
    plane().is_shadow_catcher, lamp().cycles.max_bounces = False, 1
    checked()
    plane().select_set(False)
    properties = SimpleNamespace(report_number=number, index=0)
    operator = part("ui.report_panel").LOBE_OT_select_reported
    assert operator.description(bpy.context, properties) == "Check the scene again"
    assert bpy.ops.lobe.select_reported(report_number=number, index=0) == {"CANCELLED"}
    assert "The list is a new one: press again" in capfd.readouterr().out
    assert not any(object_.select_get() for object_ in bpy.context.view_layer.objects if object_.type == "LIGHT")
    assert press(part, 0) == {"FINISHED"}


def test_the_report_as_a_text(scene, part, checked) -> None:
    for number in range(12):
        glass, _ = new_material(f"Glass {number}", "ShaderNodeBsdfGlass")
        add_object(f"Pane {number}", plane_mesh()).data.materials.append(glass)
    checked()
    for _ in range(2):
        assert bpy.ops.lobe.report_as_text() == {"FINISHED"}
    (text,) = bpy.data.texts
    assert text.name == "Scene Report" and f"Scene '{scene.name}'" in text.as_string()
    assert all(f"Glass {number}" in text.as_string() for number in range(12))
    assert "more" not in text.as_string()


def test_texts_of_the_user_are_left_alone(scene, checked) -> None:
    """Also a report that was renamed, and a copy of one."""
    mine = bpy.data.texts.new("Scene Report")
    mine.write("mine")
    checked()
    bpy.ops.lobe.report_as_text()
    assert mine.as_string() == "mine" and len(bpy.data.texts) == 2
    (report,) = (text for text in bpy.data.texts if text != mine)
    for theirs in (report.copy(), report):
        theirs.name = f"Kept {theirs.name}"
        theirs.from_string("mine")
        for _ in range(2):
            bpy.ops.lobe.report_as_text()
        assert theirs.as_string() == "mine"
    assert len(bpy.data.texts) == 4


def test_lines_are_broken_between_words(part) -> None:
    broken = part("ui.text").broken
    assert broken("one two three", 7, len) == ["one two", "three"]
    assert broken("incomprehensible", 3, len) == ["incomprehensible"]
    assert broken("", 3, len) == []


def test_the_command_line_says_the_same(scene, part) -> None:
    three_of_glass()
    honoured, nearly, lines = blender_render.check(scene)
    assert (
        not honoured
        and not nearly
        and lines[:2]
        == [
            "Not drawn as asked:",
            "      3  material    Glass BSDF is not supported, drawn as a clear pane: what is behind it shows straight "
            "through, neither bent nor blurred: Other, Glass 0, Glass 1",
        ]
    )


def test_the_command_line_of_a_scene_that_is_honoured(scene) -> None:
    assert blender_render.check(scene) == (True, True, ["Lobe draws everything in this scene as asked"])
    lamp().specular_factor = 0.0
    honoured, nearly, lines = blender_render.check(scene)
    assert honoured and nearly
    assert lines[:2] == ["Lobe draws everything in this scene as asked", "Left out, which changes nothing:"]
    assert len(lines) == 3


def test_the_example_of_the_settings_page_prints_the_report(scene, capsys) -> None:
    three_of_glass()
    page = (Path(__file__).parents[2] / "docs" / "settings.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    exec(example, {})
    assert "WARNING material Glass BSDF is not supported" in capsys.readouterr().out
