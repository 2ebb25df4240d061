"""The panels, drawn onto a layout that checks every property they name and notes it."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import bpy
import pytest

from engine import Settings
from tools.lobe_blender import MODULE


class Layout:
    """Stands in for bpy.types.UILayout, which can't be made without a window."""

    def __init__(self) -> None:
        self.shown: list[tuple[str, str]] = []

    def column(self, **_) -> Layout:
        return self

    def row(self, **_) -> Layout:
        return self

    def separator(self) -> None: ...

    def prop(self, owner, name: str, **_) -> None:
        assert name in owner.bl_rna.properties, f"{owner} has no property {name}"
        self.shown.append((owner.bl_rna.identifier, name))


@pytest.fixture
def classes() -> list[type]:
    return list(sys.modules[f"{MODULE}.addon.ui"]._CLASSES)


def draw(cls: type, context) -> list[tuple[str, str]]:
    layout = Layout()
    panel = SimpleNamespace(layout=layout)
    panel.column = lambda align=False: layout
    for name in ("draw_header", "draw"):
        if name in cls.__dict__:
            getattr(cls, name)(panel, context)
    return layout.shown


def fake_context(**values) -> SimpleNamespace:
    return SimpleNamespace(scene=bpy.context.scene, engine="LOBE", light=None, object=None, **values)


def test_every_setting_is_shown_once(classes) -> None:
    scene = bpy.context.scene
    scene.lobe.use_adaptive_sampling = True
    shown = [s for c in classes if c.bl_context == "render" for s in draw(c, fake_context())]
    settings = [name for owner, name in shown if owner == "LobeSettings"]
    expected = {*Settings.__dataclass_fields__, "viewport_samples"} - {"threads"}
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


def test_panels_hide_from_other_engines(classes) -> None:
    context = fake_context()
    context.engine = "CYCLES"
    assert not any(c.poll(context) for c in classes)


def test_blenders_own_panels_join_in() -> None:
    for name in ("EEVEE_MATERIAL_PT_surface", "EEVEE_WORLD_PT_surface", "DATA_PT_camera_dof", "DATA_PT_lens"):
        assert "LOBE" in getattr(bpy.types, name).COMPAT_ENGINES, name
    for name in ("RENDER_PT_simplify", "DATA_PT_light", "VIEWLAYER_PT_freestyle"):
        assert "LOBE" not in getattr(bpy.types, name).COMPAT_ENGINES, name
