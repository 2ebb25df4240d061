"""The panels, drawn onto a layout that checks every property they name and notes it."""

from __future__ import annotations

import re
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from engine import Settings
from engine.adaptive import MIN_SAMPLES
from tools.lobe_blender import MODULE

from .. import little_memory
from .export_checks import new_material, node_tree


class Layout:
    """Stands in for bpy.types.UILayout, which can't be made without a window."""

    def __init__(self) -> None:
        self.shown: list[tuple[str, str]] = []
        self.texts: list[str] = []
        self.icons: list[str] = []

    def column(self, **_) -> Layout:
        return self

    row = box = split = column

    def separator(self) -> None: ...

    def prop_decorator(self, owner, name: str) -> None:
        assert name in owner.bl_rna.properties, f"{owner} has no property {name}"

    def label(self, text: str = "", icon: str = "NONE", **_) -> None:
        self.texts.append(text)
        self.icons.append(icon)

    def operator(self, name: str, **_) -> SimpleNamespace:
        group, _, rest = name.partition(".")
        getattr(getattr(bpy.ops, group), rest).get_rna_type()  # raises where there is none
        self.shown.append(("operator", name))
        return SimpleNamespace()

    def template_preview(self, datablock) -> None:
        self.shown.append(("preview", datablock.bl_rna.identifier))

    def popover(self, panel: str, **_) -> None:
        self.shown.append(("popover", panel))

    def template_node_view(self, tree, node, socket) -> None:
        self.shown.append(("node view", node.bl_idname))
        assert socket.node == node and socket.name == "Surface"
        self.shown.append(("node", node.name))

    def prop(self, owner, name: str, **_) -> None:
        assert name in owner.bl_rna.properties, f"{owner} has no property {name}"
        self.shown.append((owner.bl_rna.identifier, name))


@pytest.fixture
def classes() -> list[type]:
    return [cls for cls in sys.modules[f"{MODULE}.addon.ui"]._CLASSES if hasattr(cls, "bl_context")]


def draw(cls: type, context) -> list[tuple[str, str]]:
    layout = Layout()
    panel = SimpleNamespace(layout=layout, bl_space_type=cls.bl_space_type)
    panel.column = lambda **_: layout
    for name in ("draw_header", "draw"):
        if name in cls.__dict__:
            getattr(cls, name)(panel, context)
    return layout.shown


def fake_context(**values) -> SimpleNamespace:
    context = SimpleNamespace(scene=bpy.context.scene, engine="LOBE", view_layer=bpy.context.view_layer, region=None)
    context.preferences, context.window_manager = bpy.context.preferences, bpy.context.window_manager
    context.evaluated_depsgraph_get = bpy.context.evaluated_depsgraph_get
    context.light = context.object = context.world = context.material = None
    context.__dict__.update(values)
    return context


def test_every_setting_is_shown_once(classes) -> None:
    scene = bpy.context.scene
    scene.lobe.use_adaptive_sampling = True
    context = fake_context()
    shown = [s for c in classes if c.bl_context == "render" and c.poll(context) for s in draw(c, context)]
    settings = [name for owner, name in shown if owner == "LobeSettings"]
    expected = {*Settings.__dataclass_fields__, "viewport_samples", "use_denoising"} - {"threads", "passes"}
    assert sorted(settings) == sorted(expected)
    assert {("RenderSettings", "threads"), ("RenderSettings", "film_transparent")} <= set(shown)


@pytest.mark.parametrize("kind", ["POINT", "SUN", "SPOT", "AREA"])
@pytest.mark.parametrize("shape", ["SQUARE", "ELLIPSE"])
def test_lamps(classes, kind: str, shape: str) -> None:
    light = bpy.data.lights.new("Lamp", kind)
    if kind == "AREA":
        light.shape = shape
    context = fake_context()
    context.light = light
    shown = {name for c in classes if c.bl_context == "data" and c.poll(context) for _, name in draw(c, context)}
    expected = {
        "POINT": {"shadow_soft_size"},
        "SUN": {"angle"},
        "SPOT": {"shadow_soft_size", "spot_size", "spot_blend"},
        "AREA": {"shape", "size", "spread"},
    }[kind]
    assert expected | {"color", "energy", "use_shadow"} <= shown
    assert ("size_y" in shown) == (kind == "AREA" and shape == "ELLIPSE")


def test_ray_visibility_of_meshes_and_lamps(classes) -> None:
    panel = next(c for c in classes if c.__name__ == "LOBE_OBJECT_PT_ray_visibility")
    context = fake_context()
    assert not panel.poll(context)
    context.object = bpy.data.objects.new("Mesh", bpy.data.meshes.new("Mesh"))
    assert panel.poll(context)
    assert {name for _, name in draw(panel, context)} == {
        "visible_camera", "visible_diffuse", "visible_glossy", "visible_shadow"
    }  # fmt: skip


def test_ray_visibility_of_what_places_a_collection(classes) -> None:
    panel = next(c for c in classes if c.__name__ == "LOBE_OBJECT_PT_ray_visibility")
    context = fake_context(object=bpy.data.objects.new("Empty", None))
    context.object.instance_type = "COLLECTION"
    assert not panel.poll(context)
    context.object.instance_collection = bpy.data.collections.new("Placed")
    assert panel.poll(context) and ("Object", "visible_shadow") in draw(panel, context)
    context.object.instance_type = "NONE"
    assert not panel.poll(context)


def test_panels_hide_from_other_engines(classes) -> None:
    context = fake_context()
    context.engine = "CYCLES"
    assert not any(c.poll(context) for c in classes)


@pytest.mark.parametrize("ticked", [True, False])
def test_denoise_says_where_there_is_no_library(classes, monkeypatch, capfd, ticked: bool) -> None:
    """A warning where it was asked for. Looked for once, however often the panel is drawn, and not a word on the
    console."""
    module, tried = sys.modules[f"{MODULE}.addon.denoise"], []
    panel = find(classes, "LOBE_RENDER_PT_sampling_render_denoise")
    monkeypatch.setattr(module, "_candidates", lambda: tried.append(1) or ["no_such_library.so"])
    for cached in (module._library, module.is_missing):
        cached.cache_clear()
    context, layout = fake_context(), Layout()
    context.scene.lobe.use_denoising = ticked
    for _ in range(3):
        text = "is rendered without denoising" if ticked else "this Blender lacks OpenImageDenoise"
        assert text in texts(panel, context)
    panel.draw(SimpleNamespace(layout=layout), context)
    assert ("ERROR" in layout.icons) == ticked
    assert len(tried) == 1 and "no_such_library.so" not in capfd.readouterr().out
    monkeypatch.undo()
    for cached in (module._library, module.is_missing):
        cached.cache_clear()


# --- every tab ------------------------------------------------------------------------------------------------------


# Of each property: what its tooltip says of its unit, None where it has none, and of its cost in time or noise.
TOLD = {
    "samples": ("paths traced for each pixel", "time grows in proportion"),
    "viewport_samples": ("paths traced for each pixel", "then it rests and takes no time"),
    "seed": ("which random numbers", "costs no time"),
    "time_limit": ("seconds", "keeps the noise of the samples that it got"),
    "use_adaptive_sampling": (f"before {MIN_SAMPLES} samples", "saves time"),
    "adaptive_threshold": (f"without unit.*before {MIN_SAMPLES} samples", "four times as long"),
    "use_denoising": (None, "takes some seconds and a gigabyte"),
    "max_bounces": ("surfaces", "each bounce costs up to as much time as the one before"),
    "diffuse_bounces": ("how many of the bounces", "fewer take less time"),
    "glossy_bounces": ("how many of the bounces", "fewer take less time"),
    "clamp_direct": (r"each contribution.*in w/\(m² sr\)", "costs no time"),
    "clamp_indirect": (r"each contribution.*in w/\(m² sr\)", "costs no time.*preset without bright specks"),
    "hemisphere_sampling": (None, "the noise is not.*more noise.*slower"),
    "lobe_selection": (None, "the noise is not.*less noise"),
    "pixel_filter": (None, "costs no time"),
    "filter_width": ("in pixels", "costs no time"),
    "road": ("leave it at compiled", "far slower.*far slower"),
    "denoising_data": (None, "the time of one more ray for each sample"),
    "pass_sample_count": ("how many samples", "takes no time"),
    "mode": (None, "four renders.*four renders"),
    "seconds": ("seconds", "preparing the scene comes on top"),
    "kd": ("0 to 1", "costs no time"),
    "ks": ("0 to 1", "takes a little more time"),
    "exponent": ("without unit", "costs no time"),
}


def test_tooltips_tell_unit_and_cost() -> None:
    told = {}
    groups = bpy.context.scene.lobe, bpy.context.view_layer.lobe, bpy.context.window_manager.lobe_compare
    for prop in (prop for group in groups for prop in group.bl_rna.properties):
        items = (item.description for item in getattr(prop, "enum_items", ()))
        told[prop.identifier] = " ".join([prop.description, *items])
    sockets = sys.modules[f"{MODULE}.addon.phong_group"].phong_group().interface.items_tree
    told |= {socket.name: socket.description for socket in sockets if socket.in_out == "INPUT"}
    assert set(told) - {"rna_type", "name"} == set(TOLD)
    for name, (unit, cost) in TOLD.items():
        assert unit is None or re.search(unit, told[name].lower()), f"{name}: {told[name]}"
        assert re.search(cost, told[name].lower()), f"{name}: {told[name]}"


def find(classes, name: str) -> type:
    return next(cls for cls in classes if cls.__name__ == name)


def test_world_and_view_layer(classes) -> None:
    context = fake_context(world=bpy.data.worlds.new("World"))
    panel = find(classes, "LOBE_WORLD_PT_ray_visibility")
    assert panel.poll(context)
    assert {name for _, name in draw(panel, context)} == {"camera", "diffuse", "glossy"}
    assert not panel.poll(fake_context())
    panels = [find(classes, f"LOBE_VIEWLAYER_PT_{kind}") for kind in ("filter", "override")]
    shown = {name for panel in panels for _, name in draw(panel, context)}
    assert {"use_sky", "use_solid", "material_override"} <= shown


@pytest.mark.parametrize("kind", ["mist", "ambient_occlusion"])
def test_what_a_pass_takes_from_the_world(classes, kind: str) -> None:
    panel = find(classes, f"LOBE_WORLD_PT_{kind}")
    context = fake_context(world=bpy.data.worlds.new("World"))
    assert not panel.poll(context)
    setattr(context.scene.view_layers.new("Other"), f"use_pass_{kind}", True)
    assert panel.poll(context) and not panel.poll(fake_context())
    shown = {"mist": {"start", "depth", "falloff"}, "ambient_occlusion": {"distance"}}[kind]
    assert {name for _, name in draw(panel, context)} == shown


def test_previews(classes) -> None:
    world, light = bpy.data.worlds.new("World"), bpy.data.lights.new("Lamp", "AREA")
    for name, context, shown in (
        ("LOBE_WORLD_PT_preview", fake_context(world=world), "World"),
        ("LOBE_LIGHT_PT_preview", fake_context(light=light), "AreaLight"),
    ):
        panel = find(classes, name)
        assert panel.poll(context) and not panel.poll(fake_context())
        assert draw(panel, context) == [("preview", shown)]


def test_the_pass_index_of_a_material(classes) -> None:
    panel = find(classes, "LOBE_MATERIAL_PT_settings")
    context = fake_context(material=bpy.data.materials.new("M"))
    assert panel.poll(context) and draw(panel, context) == [("Material", "pass_index")]


@pytest.mark.parametrize("kind", ["Material", "World"])
def test_the_surface_that_is_rendered_is_shown(classes, kind: str) -> None:
    datablock = getattr(bpy.data, f"{kind.lower()}s").new("Shown")
    panel = find(classes, f"LOBE_{kind.upper()}_PT_surface")
    context = fake_context(**{kind.lower(): datablock})
    tree = node_tree(datablock)
    tree.nodes.clear()
    assert panel.poll(context) and "No output node" in texts(panel, context)
    for target in ("EEVEE", "CYCLES"):
        node = tree.nodes.new(f"ShaderNodeOutput{kind}")
        node.name, node.target = f"For {target}", target
        tree.nodes["For EEVEE"].is_active_output = True
        assert ("node", f"For {target}") in draw(panel, context)
    if bpy.app.version < (5, 0):
        datablock.use_nodes = False
        assert ("node view", node.bl_idname) not in draw(panel, context)
        assert (kind, {"Material": "diffuse_color", "World": "color"}[kind]) in draw(panel, context)


def test_the_nodes_of_a_lamp(classes) -> None:
    panel = find(classes, "LOBE_LIGHT_PT_nodes")
    context = fake_context(light=bpy.data.lights.new("Lamp", "POINT"))
    if bpy.app.version < (5, 1):  # from then on they always have nodes
        context.light.use_nodes = False
        assert ("node view", "ShaderNodeOutputLight") not in draw(panel, context)
        context.light.use_nodes = True
    assert ("node view", "ShaderNodeOutputLight") in draw(panel, context)


def texts(cls: type, context) -> str:
    layout = Layout()
    panel = SimpleNamespace(layout=layout, column=lambda **_: layout)
    if "draw_header_preset" in cls.__dict__:
        cls.draw_header_preset(panel, context)
    cls.draw(panel, context)
    return " ".join(layout.texts)


def test_compiling_in_the_background_is_shown_while_it_lasts(classes, monkeypatch) -> None:
    panel, precompile = find(classes, "LOBE_RENDER_PT_performance"), sys.modules[f"{MODULE}.addon.precompile"]
    assert texts(panel, fake_context()) == ""
    monkeypatch.setattr(precompile, "_said", "Compiling in the background: 4 of 11")
    assert texts(panel, fake_context()) == "Compiling in the background: 4 of 11"


def test_the_scene_report(classes) -> None:
    panel, skipped = (find(classes, f"LOBE_RENDER_PT_scene_report{which}") for which in ("", "_skipped"))
    report = sys.modules[f"{MODULE}.addon.scene_report"]
    notes = sys.modules[f"{MODULE}.addon.export"].Notes()
    context = fake_context()
    assert "after a check or a render" in texts(panel, context) and not skipped.poll(context)
    report.keep(report.key(context.scene), "check", [])
    assert report.HONOURED in texts(panel, context)
    for number in range(3):
        notes.warn("material", f"M{number}", "bump is not drawn")
    notes.warn("world", "World", "volumes are not drawn")
    notes.approximate("object", "Bare", "it has no material")
    notes.skip("object", "Empty", "it has no faces")
    report.keep(report.key(context.scene), "render", notes.all)
    shown = texts(panel, context)
    assert shown.startswith("2 ") and "as of the last render" in shown
    assert shown.count("Bump is not drawn") == 1 and "World: volumes are not drawn" in shown
    assert shown.index("Drawn nearly as asked") < shown.index("Bare: it has no material")
    assert "no faces" not in shown and skipped.poll(context) and "Empty: it has no faces" in texts(skipped, context)


@pytest.mark.parametrize(
    ("level", "number", "icon"), [("WARNING", "1", "ERROR"), ("APPROXIMATED", "", "INFO"), ("SKIPPED", "", "CHECKMARK")]
)
def test_only_what_is_drawn_wrongly_is_counted_in_the_header(classes, level: str, number: str, icon: str) -> None:
    report = sys.modules[f"{MODULE}.addon.scene_report"]
    layout, context = Layout(), fake_context()
    report.keep(report.key(context.scene), "check", [report.Note(level, "object", "Cube", "is odd")])
    find(classes, "LOBE_RENDER_PT_scene_report").draw_header_preset(SimpleNamespace(layout=layout), context)
    assert (layout.texts, layout.icons) == ([number], [icon])


@pytest.fixture
def glossy():
    material, node = new_material("M", "ShaderNodeBsdfGlossy", Color=(0.5, 0.4, 0.3, 1), Roughness=0.5)
    return material, node


def test_what_lobe_understood_of_a_material(classes, glossy) -> None:
    material, node = glossy
    context = fake_context(material=material)
    panel = find(classes, "LOBE_MATERIAL_PT_understood")
    assert panel.poll(context)
    assert "Phong ks 0.5  0.4  0.3 Exponent 30 " in texts(panel, context)
    assert "get darker where they turn away" in texts(panel, context)
    node.inputs["Color"].default_value = (0.25, 0.25, 0.25, 1)
    bpy.context.view_layer.update()
    assert "Phong ks 0.25 Exponent" in texts(panel, context)


def test_a_material_without_a_remark(classes) -> None:
    material, _ = new_material("M", "ShaderNodeBsdfDiffuse", Color=(0.5, 0.5, 0.5, 1))
    shown = texts(find(classes, "LOBE_MATERIAL_PT_understood"), fake_context(material=material))
    assert "Every node of it is honoured" in shown


def test_images_are_read_by_a_timer_and_once(classes, monkeypatch) -> None:
    """Drawing the panel reads none; what was read holds until that image changes. These are Blender's own."""
    module = sys.modules[f"{MODULE}.addon.ui.understood"]
    read: list[str] = []
    whole = module.KeptAverages._read
    monkeypatch.setattr(
        module.KeptAverages, "_read", lambda self, n, *rest: read.append(n.image.name) or whole(self, n, *rest)
    )
    panel = find(classes, "LOBE_MATERIAL_PT_understood")
    contexts = {}
    for name, level in (("One", 0.25), ("Two", 0.75)):
        material, node = new_material(name, "ShaderNodeBsdfDiffuse")
        image = bpy.data.images.new(name, 4, 4, float_buffer=True)
        image.pixels = [level, level, level, 1.0] * 16
        texture = material.node_tree.nodes.new("ShaderNodeTexImage")
        texture.image = image
        material.node_tree.links.new(texture.outputs[0], node.inputs["Color"])
        contexts[name] = fake_context(material=material)
        object_ = bpy.data.objects.new(name, bpy.data.meshes.new(name))
        object_.data.materials.append(material)
        bpy.context.scene.collection.objects.link(object_)
    bpy.context.view_layer.update()
    assert all("Reading its images" in texts(panel, context) for context in contexts.values()) and not read
    assert bpy.app.timers.is_registered(module._read)
    module._read()
    assert "Diffuse kd 0.25" in texts(panel, contexts["One"]) and "Diffuse kd 0.75" in texts(panel, contexts["Two"])
    assert sorted(read) == ["One", "Two"]

    contexts["One"].material.roughness = 0.3  # another property of it
    bpy.context.view_layer.update()
    bpy.context.scene.frame_set(7)
    assert "Diffuse kd 0.25" in texts(panel, contexts["One"]) and len(read) == 2
    bpy.data.images["One"].pixels = [0.5, 0.5, 0.5, 1.0] * 16
    bpy.data.images["One"].update_tag()
    bpy.context.view_layer.update()
    assert "Reading its images" in texts(panel, contexts["One"])
    assert "Diffuse kd 0.75" in texts(panel, contexts["Two"])
    module._read()
    assert "Diffuse kd 0.5" in texts(panel, contexts["One"]) and read[2:] == ["One"]


@pytest.fixture
def textured(tmp_path):
    """A material that shows a file of an image, and its texture node."""
    made = bpy.data.images.new("Made", 64, 64, alpha=True)
    made.pixels = (np.random.default_rng(1).random((64 * 64, 4), np.float32) * (0.9, 0.3, 0.3, 1)).ravel()
    made.filepath_raw, made.file_format = str(tmp_path / "made.png"), "PNG"
    made.save()
    material, node = new_material("M", "ShaderNodeBsdfDiffuse")
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.load(str(tmp_path / "made.png"))
    material.node_tree.links.new(texture.outputs[0], node.inputs["Color"])
    return material, texture


def test_a_thread_that_averages_asks_blender_for_nothing(textured, monkeypatch) -> None:
    """Not for the place of its colour spaces either."""
    module = sys.modules[f"{MODULE}.addon.ui.understood"]
    material, texture = textured
    place, read, threads, shown = bpy.utils.resource_path, module.KeptAverages.mean_of_file, [], []

    def asked(*arguments, **options):
        assert threading.current_thread() is threading.main_thread()
        return place(*arguments, **options)

    def noted(*arguments):
        mean = read(*arguments)
        threads.append(threading.current_thread())  # which it has outlived
        return mean

    monkeypatch.setattr(bpy.utils, "resource_path", asked)
    monkeypatch.setattr(module.KeptAverages, "mean_of_file", noted)
    for space in ("Linear Rec.2020", "Linear Rec.709"):
        texture.image.colorspace_settings.name = space
        module.understood.forget()
        assert module.understood.at_hand(material) is None
        while module._read() is not None:
            module.understood.wait()
        shown.append(module.understood.at_hand(material)[0].kd)
    assert len(threads) == 2 and threading.main_thread() not in threads
    assert shown[0] != pytest.approx(shown[1], rel=1e-2)


def test_a_thread_that_averages_outlives_a_colour_space_it_cannot_read(textured, monkeypatch) -> None:
    """An image of that space is read as sRGB, and not once more by Blender."""
    module = sys.modules[f"{MODULE}.addon.ui.understood"]
    monkeypatch.setattr(sys.modules[f"{MODULE}.addon.export.images"], "_convert", lambda *arguments: None)
    material, texture = textured
    shown = []
    for space in ("Linear Rec.2020", "sRGB"):
        texture.image.colorspace_settings.name = space
        module.understood.forget()
        assert module.understood.at_hand(material) is None
        while module._read() is not None:
            module.understood.wait()
        shown.append(module.understood.at_hand(material)[0].kd)
        assert not module.understood._images._by_blender
    assert shown[0] == shown[1]


def test_files_of_images_are_averaged_on_a_thread(classes, textured, tmp_path, monkeypatch) -> None:
    """To the same as an export's, and forgotten where the image changes meanwhile."""
    module = sys.modules[f"{MODULE}.addon.ui.understood"]
    material, texture = textured
    panel, context = find(classes, "LOBE_MATERIAL_PT_understood"), fake_context(material=material)
    go, threads, whole = threading.Event(), [], module.KeptAverages.mean_of_file

    def slow(self, image, path):
        if threading.current_thread() is threading.main_thread():  # an export, which waits for it
            return whole(self, image, path)
        threads.append(threading.current_thread())
        assert go.wait(60) and isinstance(image, SimpleNamespace)
        return whole(self, image, path)

    monkeypatch.setattr(module.KeptAverages, "mean_of_file", slow)
    assert "Reading its images" in texts(panel, context)
    assert module._read() == module._read() == module.INTERVAL and len(threads) == 1
    module.understood.changed([texture.image])
    assert module._read() == module.INTERVAL and len(threads) == 2  # begun anew
    assert "Reading its images" in texts(panel, context)
    go.set()
    while module._read() is not None:
        module.understood.wait()
    mean, _ = module.understood.at_hand(material)
    module.understood.forget()
    assert mean == module.understood.of(material)[0] and len(threads) == 2

    Path(tmp_path / "made.png").write_bytes(b"no picture")
    module.understood.forget()
    texture.image.reload()
    assert "Reading its images" in texts(panel, context)
    while module._read() is not None:
        module.understood.wait()
    assert "cannot be read" in texts(panel, context)


def test_an_image_that_finds_no_memory_is_named_in_the_panel(classes, textured, monkeypatch) -> None:
    """One that only Blender has, and once: the timer ends. A file is read in strips."""
    module, memory = sys.modules[f"{MODULE}.addon.ui.understood"], sys.modules[f"{MODULE}.engine.memory"]
    little_memory.leave(monkeypatch, memory, 0.0)
    material, texture = textured
    panel, context = find(classes, "LOBE_MATERIAL_PT_understood"), fake_context(material=material)
    for packed in (False, True):
        if packed:
            texture.image.pack()
        module.understood.forget()
        assert "Reading its images" in texts(panel, context)
        while module._read() is not None:
            module.understood.wait()
        shown = texts(panel, context)
        assert "Reading its images" not in shown and ("needs more memory than can be had" in shown) == packed


def test_use_phong_keeps_what_is_drawn(classes) -> None:
    material, node = new_material("M", "ShaderNodeBsdfPrincipled", Base_Color=(0.5, 0.4, 0.3, 1), Alpha=0.75)
    node.inputs["Emission Color"].default_value = (1, 0.5, 0, 1)
    node.inputs["Emission Strength"].default_value = 4.0
    understood = sys.modules[f"{MODULE}.addon.ui.understood"].understood
    before, _ = understood.of(material)
    with bpy.context.temp_override(material=material):
        assert bpy.ops.lobe.use_phong() == {"FINISHED"}
    after, remarks = understood.of(material)
    assert remarks == []
    for part in ("kd", "ks", "emission", "transparency"):
        assert getattr(after, part) == pytest.approx(getattr(before, part), rel=1e-6), part
    assert after.exponent == pytest.approx(before.exponent)


def test_use_phong_has_nothing_to_do_a_second_time(classes) -> None:
    """Nor beside what else the first time made; and what is no Phong surface says that it was replaced."""
    material, node = new_material("M", "ShaderNodeBsdfGlass")
    node.label, tree = "Mine", material.node_tree
    with bpy.context.temp_override(material=material):
        assert bpy.ops.lobe.use_phong() == {"FINISHED"}
        number = len(tree.nodes)
        assert not bpy.ops.lobe.use_phong.poll()
        with pytest.raises(RuntimeError, match="is a Phong BSDF already"):
            bpy.ops.lobe.use_phong()
    assert len(tree.nodes) == number
    panel = find(classes, "LOBE_MATERIAL_PT_phong")
    assert draw(panel, fake_context(material=material)) == []
    assert "Gives back up to" in texts(panel, fake_context(material=material))
    tree.links.new(node.outputs[0], next(n for n in tree.nodes if n.bl_idname == "ShaderNodeAddShader").inputs[0])
    assert draw(panel, fake_context(material=material)) == [("operator", "lobe.use_phong")]


@pytest.mark.parametrize(
    ("kind", "lost"),
    [
        ("ShaderNodeBsdfGlass", "Glass BSDF is not supported, drawn as a clear pane"),
        ("ShaderNodeSubsurfaceScattering", "Subsurface Scattering is not supported, drawn as an opaque"),
        ("ShaderNodeBsdfDiffuse", ""),
        ("ShaderNodeBsdfAnisotropic", ""),
        ("ShaderNodeBsdfPrincipled", ""),
    ],
)
def test_use_phong_says_what_it_replaces(capfd, kind: str, lost: str) -> None:
    """And nothing of what is still left out afterwards."""
    material, _ = new_material("M", kind)
    tree = material.node_tree
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], output.inputs["Volume"])
    with bpy.context.temp_override(material=material):
        bpy.ops.lobe.use_phong()
    lines = [line for line in capfd.readouterr().out.splitlines() if line.startswith("Warning")]
    assert len(lines) == bool(lost)
    assert all("(Undo brings it back)" in line and lost in line and "volumes" not in line for line in lines)


def test_use_phong_leaves_a_volume_alone_in_clear_air() -> None:
    """Its surface would otherwise hide the volume from Cycles."""
    material, volume = new_material("M", "ShaderNodeVolumeScatter")
    tree = material.node_tree
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.clear()
    tree.links.new(volume.outputs[0], output.inputs["Volume"])
    with bpy.context.temp_override(material=material):
        assert bpy.ops.lobe.use_phong() == {"FINISHED"}
    sides = {link.from_node.bl_idname: link.from_node for link in tree.links if link.to_node.type == "ADD_SHADER"}
    assert output.inputs["Surface"].links[0].from_node.type == "ADD_SHADER"
    assert tuple(sides["ShaderNodeBsdfTransparent"].inputs["Color"].default_value) == (1.0, 1.0, 1.0, 1.0)
    assert max(sides["ShaderNodeGroup"].inputs["kd"].default_value[:3]) == 0.0


def test_undo_takes_use_phong_back() -> None:
    material, _ = new_material("M", "ShaderNodeBsdfGlass")
    material.use_fake_user = True
    names = {node.name for node in material.node_tree.nodes}
    bpy.ops.ed.undo_push(message="before")
    with bpy.context.temp_override(material=material):
        bpy.ops.lobe.use_phong("EXEC_DEFAULT", True)
    assert len(material.node_tree.nodes) > len(names)
    bpy.ops.ed.undo()
    tree = bpy.data.materials["M"].node_tree
    assert {node.name for node in tree.nodes} == names
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    assert output.inputs["Surface"].links[0].from_node.bl_idname == "ShaderNodeBsdfGlass"


def test_a_hole_stays_one() -> None:
    material, _ = new_material("M", "ShaderNodeHoldout")
    number = len(material.node_tree.nodes)
    with bpy.context.temp_override(material=material), pytest.raises(RuntimeError, match="hole in the picture"):
        bpy.ops.lobe.use_phong()
    assert len(material.node_tree.nodes) == number


def test_what_matters_to_a_material_comes_first(classes) -> None:
    material, _ = new_material("M", "ShaderNodeBsdfPrincipled", Transmission_Weight=0.5)
    shown = texts(find(classes, "LOBE_MATERIAL_PT_understood"), fake_context(material=material))
    assert shown.index("Transmission is not") < shown.index("Principled BSDF's")


def test_phong_quick_settings(classes, glossy) -> None:
    material, _ = glossy
    context = fake_context(material=material)
    phong_node = sys.modules[f"{MODULE}.addon.ui.material_panels"].phong_node
    panel = find(classes, "LOBE_MATERIAL_PT_phong")
    assert draw(panel, context) == [("operator", "lobe.use_phong")]
    with bpy.context.temp_override(material=material):
        bpy.ops.lobe.use_phong()
        assert not bpy.ops.lobe.use_phong.poll()
    assert draw(panel, context) == []  # the panel above has them
    assert "Gives back up to 50% of the light, as sharp as roughness 0.5" in texts(panel, context)
    tree = material.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeRGB").outputs[0], phong_node(material).inputs["kd"])
    assert "Other nodes tell" in texts(panel, context)


def of_preset(name: str) -> tuple:
    """The group that a value in a preset belongs to, and the property: "lobe.samples"."""
    owner, _, key = name.partition(".")
    return getattr(bpy.context.scene, owner), key


def another(owner, key: str):
    """A value of a property that isn't its default."""
    rna = owner.bl_rna.properties[key]
    if rna.type == "ENUM":
        return next(item.identifier for item in rna.enum_items if item.identifier != rna.default)
    return not rna.default if rna.type == "BOOLEAN" else rna.default + (0.25 if rna.type == "FLOAT" else 3)


# In the menu's order, by name.
PRESETS = {
    "sampling": ["Default", "Draft", "Final", "Until_Clean"],
    "viewport_sampling": ["Default", "Draft", "Fine"],
    "light_paths": ["Bright_Closed_Rooms", "Default", "Direct_Light_Only", "Same_as_Cycles", "Without_Bright_Specks"],
    "performance": ["Default", "Faster_Animation"],
}


def preset_values(kind: str) -> list[str]:
    """What a preset of that kind holds, as the operator that adds one has it."""
    return getattr(bpy.types, f"LOBE_OT_{kind}_preset_add").preset_values


@pytest.mark.parametrize("kind", PRESETS)
def test_presets(kind: str) -> None:
    """Each of ours sets all that a preset of its kind holds, as one of the user's own does."""
    menu = f"LOBE_PT_{kind}_presets"
    added = preset_values(kind)
    files = {f.stem: f for folder in bpy.utils.preset_paths(f"lobe/{kind}") for f in Path(folder).glob("*.py")}
    assert set(PRESETS[kind]) <= set(files)
    for name in PRESETS[kind]:
        values = [line.partition(" = ")[0] for line in files[name].read_text().splitlines()[4:]]
        assert sorted(values) == sorted(added), name
        for value in values:
            setattr(*of_preset(value), another(*of_preset(value)))
        assert bpy.ops.script.execute_preset(filepath=str(files[name]), menu_idname=menu) == {"FINISHED"}
        if name == "Default":
            for owner, key in map(of_preset, values):
                assert getattr(owner, key) == pytest.approx(owner.bl_rna.properties[key].default), key


def test_the_settings_page_lists_the_presets(repository: Path) -> None:
    """Panel by panel, in the menu's order."""
    page = (repository / "docs" / "settings.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \*[^|]+\* \| (.+) \|$", page.partition("## Presets")[2].partition("\n## ")[0], re.MULTILINE)
    listed = [re.findall(r"\*([^*]+)\* *(?:\(|,|$)", row) for row in rows]
    assert listed == [[name.replace("_", " ") for name in names] for names in PRESETS.values()]


def test_presets_of_performance_leave_the_threads_alone() -> None:
    render = bpy.context.scene.render
    render.threads_mode, render.threads = "FIXED", 3
    for folder in bpy.utils.preset_paths("lobe/performance"):
        for file in Path(folder).glob("*.py"):
            bpy.ops.script.execute_preset(filepath=str(file), menu_idname="LOBE_PT_performance_presets")
            assert (render.threads_mode, render.threads) == ("FIXED", 3), file.name


@pytest.mark.parametrize("kind", PRESETS)
def test_a_preset_of_ones_own(kind: str) -> None:
    values = preset_values(kind)
    for value in values:
        setattr(*of_preset(value), another(*of_preset(value)))
    assert getattr(bpy.ops.lobe, f"{kind}_preset_add")(name="Mine") == {"FINISHED"}
    (file,) = [f for folder in bpy.utils.preset_paths(f"lobe/{kind}") for f in Path(folder).glob("[Mm]ine.py")]
    try:
        for owner, key in map(of_preset, values):
            owner.property_unset(key)
        bpy.ops.script.execute_preset(filepath=str(file), menu_idname=f"LOBE_PT_{kind}_presets")
        for owner, key in map(of_preset, values):
            assert getattr(owner, key) == pytest.approx(another(owner, key)), key
    finally:
        file.unlink()


@pytest.mark.parametrize("kind", PRESETS)
def test_presets_hang_in_a_panels_header(classes, kind: str) -> None:
    layout = Layout()
    for cls in classes:
        if "draw_header_preset" in cls.__dict__:
            cls.draw_header_preset(SimpleNamespace(layout=layout), fake_context())
    assert layout.shown.count(("popover", f"LOBE_PT_{kind}_presets")) == 1


def comparison(scene, mean_difference: float, unmatched: list[str], different: list[str]) -> None:
    """As if there had been one of this scene: the speed-up is 3.25."""
    module = sys.modules[f"{MODULE}.addon.compare"]
    figures = module.run.Figures(mean_difference, 0.002, 0.1, 0.0005, 0.0003, 0.02, 0.04, 0.05, 3.25, 3.5, 0.1)
    times = {"LOBE": module.run.Timing(1.0, 0.9), "CYCLES": module.run.Timing(2.0, 1.9)}
    sys.modules[f"{MODULE}.addon.compare.operators"]._outcomes[scene.session_uid] = module.Outcome(
        "Scene", (8, 8), 0.0, {"LOBE": 4.0, "CYCLES": 4.0}, times, figures, {}, 0.5, [], unmatched, different, "2"
    )


@pytest.fixture
def compare_panel(classes):
    yield find(classes, "LOBE_RENDER_PT_compare")
    sys.modules[f"{MODULE}.addon.compare.operators"]._outcomes.clear()


def test_the_comparison(classes, compare_panel) -> None:
    unmatched, context = find(classes, "LOBE_RENDER_PT_compare_unmatched"), fake_context()
    assert ("operator", "lobe.compare_with_cycles") in draw(compare_panel, context) and not unmatched.poll(context)
    assert ("operator", "lobe.open_comparison") not in draw(compare_panel, context)
    comparison(context.scene, 0.005, ["passes are ticked"], [])
    shown = texts(compare_panel, context)
    said = "Lobe is 3.2 ± 0.4 times as fast as Cycles at equal error. The pictures agree within 5%"
    assert shown.startswith(f"{said} Done. ")
    assert "in the render slots Lobe and Cycles" in shown
    assert "Speed-up" in shown and "3.2 ± 0.4 x" in shown and "+0.50% ± 0.20%" in shown
    assert not any(long in shown for long in sys.modules[compare_panel.__module__].SHORT)
    assert ("operator", "lobe.open_comparison") in draw(compare_panel, context)
    assert unmatched.poll(context) and "passes are ticked" in texts(unmatched, context)
    assert "DEFAULT_CLOSED" not in getattr(unmatched, "bl_options", set())


def test_the_comparison_says_first_that_pictures_differ(compare_panel) -> None:
    context, lines = fake_context(), ["bump is not drawn"]
    comparison(context.scene, 0.2, lines, lines)
    shown = texts(compare_panel, context)
    assert shown.startswith("The pictures differ: in the mean by +20.00% ± 0.20% (1 reason under Not Matched), so no")
    assert "3.2" not in shown and "Speed-up" not in shown and "Means" in shown


def test_the_panel_says_which_render_of_a_comparison_runs(compare_panel, monkeypatch) -> None:
    monkeypatch.setattr(sys.modules[f"{MODULE}.addon.compare.operators"], "_running", "Comparing: Cycles, 1 of 2")
    assert texts(compare_panel, fake_context()) == "Comparing: Cycles, 1 of 2. Escape stops it"
