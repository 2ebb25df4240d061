"""Which of Blender's own panels Lobe shows, beside Cycles as the measure, and what its panels let one reach.

The lists are written down here by hand: what differs from Cycles differs on purpose.
"""

from __future__ import annotations

import inspect
import sys
import types
from collections.abc import Iterator
from types import SimpleNamespace

import bpy
import pytest

from tools.lobe_blender import MODULE

from .export_checks import new_material

# Blender's own panels that Cycles shows and Lobe doesn't, in any of Blender 4.2 to 5.2: Lobe draws none of it.
WITHOUT = {
    "stereoscopy": {"DATA_PT_camera_stereoscopy", "RENDER_PT_output_views", "RENDER_PT_stereoscopy"},
    "light probes": {
        "DATA_PT_context_lightprobe", "DATA_PT_lightprobe", "DATA_PT_lightprobe_display",
        "DATA_PT_lightprobe_parallax", "DATA_PT_lightprobe_visibility",
    },
    "volumes": {"DATA_PT_volume_render"},
    "hair": {"PARTICLE_PT_hair_shape", "PARTICLE_PT_render_path", "PARTICLE_PT_render_path_timing"},
    "what is Simplify's, which Lobe has a panel of its own for": {"RENDER_PT_simplify_greasepencil"},
    "working spaces": {"RENDER_PT_color_management_working_space"},
    "a texture node's own mapping": {"NODE_PT_texture_mapping"},
    "nothing by itself": {"OBJECT_PT_shading"},
}  # fmt: skip

# Those that Lobe takes as they are, while Cycles has the same in panels of its own.
BESIDE = {
    "DATA_PT_camera_dof",
    "DATA_PT_camera_dof_aperture",
    "EEVEE_MATERIAL_PT_context_material",
    "MATERIAL_PT_preview",
    "OBJECT_PT_visibility",
    "RENDER_PT_post_processing",
}

# Properties that the engine, the export or docs/settings.md name, and that some panel has to show.
REACHABLE = {
    "Camera": "type lens shift_x shift_y sensor_fit sensor_width clip_start clip_end",
    "CameraDOFSettings": "use_dof focus_object focus_distance aperture_fstop aperture_blades aperture_rotation "
    "aperture_ratio",
    "Collection": "hide_render instance_offset",
    "ColorManagedViewSettings": "view_transform exposure",
    "CyclesRenderSettings": "film_exposure",
    "CyclesVisibilitySettings": "camera diffuse glossy",
    "ImageFormatSettings": "color_management",
    "LayerCollection": "holdout indirect_only exclude",
    "LobeViewLayer": "denoising_data pass_sample_count",
    "Material": "pass_index",
    "Object": "pass_index is_holdout hide_render visible_camera visible_diffuse visible_glossy visible_shadow "
    "instance_type",
    "RenderSettings": "engine film_transparent threads_mode threads use_persistent_data use_simplify use_overwrite "
    "use_placeholder use_border use_crop_to_border resolution_x resolution_y resolution_percentage pixel_aspect_x "
    "simplify_subdivision simplify_subdivision_render simplify_child_particles simplify_child_particles_render "
    "use_single_layer use_freestyle simplify_gpencil",
    "Scene": "camera background_set frame_start frame_end",
    "ViewLayer": "use use_sky use_solid use_freestyle material_override use_pass_combined use_pass_z use_pass_mist "
    "use_pass_position use_pass_normal use_pass_uv use_pass_object_index use_pass_material_index use_pass_emit "
    "use_pass_environment use_pass_ambient_occlusion use_pass_diffuse_direct use_pass_diffuse_indirect "
    "use_pass_diffuse_color use_pass_glossy_direct use_pass_glossy_indirect use_pass_glossy_color",
    "WorldLighting": "distance",
    "WorldMistSettings": "start depth falloff",
}


def compat():
    return sys.modules[f"{MODULE}.addon.ui.compat"]


def of_engine(engine: str) -> set[str]:
    return {panel.__name__ for panel in compat()._all_panels() if engine in getattr(panel, "COMPAT_ENGINES", ())}


def test_blenders_panels_are_those_of_cycles_but_for_these() -> None:
    ui = pytest.importorskip("cycles.ui")
    cycles = {panel.__name__ for panel in ui.get_panels()}
    lobe = {name for name in of_engine("LOBE") if not name.startswith(("LOBE_", "NODE_LOBE_"))}
    assert cycles - lobe == set().union(*WITHOUT.values()) & cycles
    assert lobe - cycles == BESIDE
    assert len(cycles) > 100


def test_no_panel_of_what_lobe_ignores() -> None:
    ignored = {"RENDER_PT_eevee_motion_blur", "VIEWLAYER_PT_layer_passes", "EEVEE_WORLD_PT_volume", "DATA_PT_light",
               "EEVEE_MATERIAL_PT_volume", "EEVEE_MATERIAL_PT_surface", "EEVEE_WORLD_PT_surface"}  # fmt: skip
    assert not ignored & of_engine("LOBE")


# --- what can be reached --------------------------------------------------------------------------------------------


class AnyLayout:
    """Takes whatever a panel draws, and notes the properties, which have to be there."""

    def __init__(self) -> None:
        self.__dict__["shown"] = set()

    def __setattr__(self, name: str, value) -> None: ...

    def __getattr__(self, name: str):
        return lambda *_, **__: self

    def prop(self, owner, name: str, *_, **__) -> None:
        assert name in owner.bl_rna.properties, f"{owner} has no property {name}"
        self.shown.add((owner.bl_rna.identifier, name))

    def operator(self, *_, **__) -> SimpleNamespace:
        return SimpleNamespace()

    def panel(self, *_, **__) -> tuple[AnyLayout, AnyLayout]:
        return self, self


class Drawn:
    """An instance of a panel, which can't be made without a window."""

    def __init__(self, panel: type) -> None:
        self.layout, self._panel = AnyLayout(), panel

    def __getattr__(self, name: str):
        value = inspect.getattr_static(self._panel, name)
        return types.MethodType(value, self) if isinstance(value, types.FunctionType) else getattr(self._panel, name)


class Context:
    def __init__(self, **values) -> None:
        names = ("world", "object", "active_object", "material", "material_slot", "light", "camera", "mesh")
        self.__dict__.update(dict.fromkeys((*names, "collection", "region")))
        self.engine, self.space_data = "LOBE", SimpleNamespace(use_pin_id=False, pin_id=None)
        self.__dict__.update(values)

    def __getattr__(self, name: str):
        return getattr(bpy.context, name, None)


def tabs() -> dict[str, Context]:
    scene, layer = bpy.context.scene, bpy.context.view_layer
    layer.use_pass_mist = layer.use_pass_ambient_occlusion = True  # then the world has panels for them
    scene.render.use_freestyle = True
    scene.world = bpy.data.worlds.new("World")
    mesh = bpy.data.objects.new("Mesh", bpy.data.meshes.new("Mesh"))
    material, _ = new_material("Material", "ShaderNodeBsdfDiffuse")
    mesh.data.materials.append(material)
    scene.collection.objects.link(mesh)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.dof.use_dof = True
    of_mesh = {"object": mesh, "active_object": mesh}
    return {
        **dict.fromkeys(("render", "output", "view_layer", "scene"), Context()),
        "world": Context(world=scene.world),
        "collection": Context(collection=bpy.data.collections.new("Collection")),
        "object": Context(**of_mesh),
        "material": Context(**of_mesh, material=material, material_slot=mesh.material_slots[0]),
        "data": Context(object=camera, active_object=camera, camera=camera.data),
    }


def drawn_panels() -> Iterator[tuple[str, set[tuple[str, str]]]]:
    """Name of each panel of the properties that Lobe shows in these tabs, and what it shows."""
    contexts = tabs()
    for panel in compat()._all_panels():
        context = contexts.get(getattr(panel, "bl_context", ""))
        engines = getattr(panel, "COMPAT_ENGINES", {"LOBE"})
        if context is None or panel.bl_space_type != "PROPERTIES" or "LOBE" not in engines or not panel.is_registered:
            continue
        if hasattr(panel, "poll") and not panel.poll(context):
            continue
        drawn = Drawn(panel)
        for name in ("draw_header", "draw"):
            if hasattr(panel, name):
                getattr(drawn, name)(context)
        yield panel.__name__, drawn.layout.shown


# What the shader editor's sidebar shows of a datablock whose nodes are edited: title -> some of the properties.
SIDEBAR = {
    "light": {"Light": "type color energy shadow_soft_size use_shadow", "Beam Shape": "spot_size spot_blend show_cone"},
    "world": {"Ray Visibility": "camera diffuse glossy", "Viewport Display": "color"},
    "material": {"Settings": "pass_index", "Viewport Display": "diffuse_color metallic roughness"},
}


@pytest.mark.parametrize("kind", SIDEBAR)
def test_the_shader_editors_sidebar(kind: str) -> None:
    datablocks = {
        "light": lambda: bpy.data.lights.new("Lamp", "SPOT"),
        "world": lambda: bpy.data.worlds.new("World"),
        "material": lambda: new_material("Material", "ShaderNodeBsdfDiffuse")[0],
    }
    context = Context(**{kind: datablocks[kind]()}, space_data=SimpleNamespace(tree_type="ShaderNodeTree"))
    options = [p for p in compat()._all_panels() if getattr(p, "bl_category", "") == "Options" and p.is_registered]
    found = {}
    for panel in options:
        for_lobe = panel.bl_space_type == "NODE_EDITOR" and "LOBE" in getattr(panel, "COMPAT_ENGINES", {"LOBE"})
        if for_lobe and panel.poll(context):
            drawn = Drawn(panel)
            drawn.draw(context)
            found[panel.bl_label] = {name for _, name in drawn.layout.shown}
    assert set(found) == set(SIDEBAR[kind])
    for title, names in SIDEBAR[kind].items():
        assert set(names.split()) <= found[title]


# These need a window to be drawn: a graphics card, or the context's own path to the datablock.
UNDRAWN = ("custom_props", "color_management_display_settings")


def test_what_lobe_honours_can_be_reached(monkeypatch) -> None:
    for panel in compat()._all_panels():
        if any(word in panel.__name__ for word in UNDRAWN) and panel.is_registered:
            monkeypatch.setattr(panel, "draw", lambda self, context: None)
    reached = set().union(*(shown for _, shown in drawn_panels()))
    for owner, names in REACHABLE.items():
        missing = [name for name in names.split() if (owner, name) not in reached]
        if owner == "LayerCollection" and bpy.app.version < (4, 4):
            continue  # the outliner has them
        assert not missing, f"{owner}: {missing}"


# --- dots to set keyframes with ---------------------------------------------------------------------------------------


class DottedLayout:
    """Notes of each property, by its name, whether it gets a dot, which layouts take over from the one around them."""

    def __init__(self, around: DottedLayout | None = None) -> None:
        self.use_property_decorate = around is None or around.use_property_decorate
        self.dots: dict[str, bool] = {} if around is None else around.dots

    def __getattr__(self, name: str):
        return lambda *_, **__: DottedLayout(self)

    def prop(self, owner, name: str, *_, **__) -> None:
        self.dots[name] = self.use_property_decorate

    def prop_decorator(self, owner, name: str) -> None:
        self.dots[name] = True


def dots(panel: type, context: Context) -> dict[str, bool]:
    if not panel.poll(context):
        return {}
    drawn = Drawn(panel)
    drawn.layout = DottedLayout()
    drawn.draw(context)
    return drawn.layout.dots


@pytest.mark.parametrize("kind", ["POINT", "SUN", "SPOT", "AREA"])
def test_lamps_have_dots_where_cycles_has_them(kind: str) -> None:
    ui = pytest.importorskip("cycles.ui")
    lamp, shown = bpy.data.lights.new("Lamp", kind), []
    if hasattr(lamp, "use_temperature"):
        lamp.use_temperature = True
    for engine, module in (("CYCLES", ui), ("LOBE", bpy.types)):
        context = Context(engine=engine, light=lamp, scene=bpy.context.scene)
        names = (f"{engine}_LIGHT_PT_{part}" for part in ("light", "beam_shape", "settings"))
        panels = [getattr(module, name) for name in names if hasattr(module, name)]
        shown.append({name: dot for panel in panels for name, dot in dots(panel, context).items()})
    cycles, lobe = shown
    common = set(cycles) & set(lobe) - {"type"}  # buttons in a row have none
    assert {"color", "energy", "use_shadow"} <= common
    assert {name: lobe[name] for name in common} == {name: cycles[name] for name in common}
    assert lobe["energy"] and not lobe.get("use_temperature")


def test_mist_has_dots() -> None:
    context = tabs()["world"]
    assert dots(bpy.types.LOBE_WORLD_PT_mist, context) == dict.fromkeys(("start", "depth", "falloff"), True)


def test_the_outliners_menu_knows_indirect_only(monkeypatch) -> None:
    menu = bpy.types.OUTLINER_MT_collection_view_layer
    hooks = [function for function in menu.draw._draw_funcs if function.__module__ == compat().__name__]
    for engine, number in (("LOBE", 2), ("CYCLES", 0)):
        named: list[str] = []
        layout = SimpleNamespace(operator=named.append)
        for hook in hooks:
            hook(SimpleNamespace(layout=layout), SimpleNamespace(engine=engine))
        assert len(named) == number
        for name in named:
            assert "indirect_only" in name


@pytest.mark.parametrize("engine", ["LOBE", "NO_SUCH_ENGINE"])
@pytest.mark.parametrize("name", ["import_as_mesh_planes", "convert_to_mesh_plane"])
def test_images_become_planes(name: str, engine: str) -> None:
    """What the menus call: Blender looks at the engine, and then asks for the operator's options."""
    operator, asked, said = getattr(bpy.types, f"IMAGE_OT_{name}"), [], []
    context = SimpleNamespace(
        scene=SimpleNamespace(render=SimpleNamespace(engine=engine)),
        window_manager=SimpleNamespace(invoke_props_dialog=asked.append),
    )
    operator.invoke(SimpleNamespace(report=lambda *text: said.append(text), invoke_popup=asked.append), context, None)
    assert (len(asked), len(said)) == ((1, 0) if engine == "LOBE" else (0, 1))


@pytest.mark.parametrize("where", ["no module", "no set"])
def test_blender_without_a_list_of_engines_for_planes(monkeypatch, where: str) -> None:
    module = types.ModuleType("image_as_planes") if where == "no set" else None
    monkeypatch.setitem(sys.modules, "bl_operators.image_as_planes", module)
    compat().unregister()
    compat().register()


def test_another_working_space_can_be_put_back(monkeypatch) -> None:
    """Lobe doesn't support any but the default: with that there is nothing to choose."""
    if not hasattr(bpy.data, "colorspace"):
        pytest.skip("before Blender 5.0 a file has no working space")
    panel = bpy.types.LOBE_RENDER_PT_working_space
    assert "RENDER_PT_color_management_working_space" not in of_engine("LOBE")
    context = SimpleNamespace(
        engine="LOBE", scene=bpy.context.scene, blend_data=SimpleNamespace(colorspace=bpy.data.colorspace)
    )
    assert not panel.poll(context)
    bpy.ops.wm.set_working_color_space(working_space="Linear Rec.2020", convert_colors=False)
    assert bpy.data.colorspace.working_space == "Linear Rec.2020"
    assert panel.poll(context) and not panel.poll(SimpleNamespace(engine="CYCLES"))
    drawn, operators = Drawn(panel), []
    monkeypatch.setattr(AnyLayout, "operator_menu_enum", lambda self, name, *_, **__: operators.append(name), False)
    drawn.draw(context)
    assert operators == ["wm.set_working_color_space"]
