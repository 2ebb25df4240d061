"""Render settings: `scene.lobe`, Blender's thread count and its film properties."""

from __future__ import annotations

import dataclasses

import bpy
import pytest
from bl_ext.user_default.lobe import engine
from bl_ext.user_default.lobe.addon.export import export_scene, export_settings, film_exposure

from tests.blender.export_checks import add_camera, add_object, depsgraph, plane_mesh


def test_defaults_are_the_engines():
    """Blender's properties are float32."""
    exported, default = export_settings(bpy.context.scene), engine.Settings()
    for field in dataclasses.fields(default):
        value = getattr(default, field.name)
        expected = pytest.approx(value) if isinstance(value, float) else value
        assert getattr(exported, field.name) == expected, field.name


def test_every_setting_arrives():
    lobe = bpy.context.scene.lobe
    values = {
        "samples": 7,
        "seed": 3,
        "time_limit": 5.0,
        "use_adaptive_sampling": True,
        "adaptive_threshold": 0.25,
        "max_bounces": 3,
        "diffuse_bounces": 2,
        "glossy_bounces": 1,
        "clamp_direct": 4.0,
        "clamp_indirect": 2.0,
        "hemisphere_sampling": "REJECTION",
        "lobe_selection": "CLASSIC",
        "pixel_filter": "BOX",
        "filter_width": 2.0,
        "road": "REFERENCE",
    }
    for key, value in values.items():
        setattr(lobe, key, value)
    settings = export_settings(bpy.context.scene)
    assert settings == engine.Settings(**values)
    settings.validate()


def test_an_export_makes_no_groups_of_properties_in_the_evaluated_scene():
    """Nobody is known to free them."""
    bpy.context.window.scene = scene = bpy.data.scenes.new("Untouched")
    add_camera()
    assert not scene.is_property_set("lobe") and not scene.is_property_set("cycles")
    evaluated = depsgraph().scene_eval
    export_scene(depsgraph())
    assert export_settings(evaluated) == export_settings(scene)
    assert not evaluated.is_property_set("lobe") and not evaluated.is_property_set("cycles")


def test_what_is_animated_is_read_from_the_evaluated_scene():
    scene = bpy.context.scene
    scene.lobe.driver_add("seed").driver.expression = "frame + 5"
    scene.cycles.film_exposure = 1.0
    scene.frame_set(4)
    evaluated = depsgraph().scene_eval
    scene.lobe.seed, scene.cycles.film_exposure = 1, 3.0  # not evaluated yet
    assert export_settings(evaluated).seed == 9 and film_exposure(evaluated) == 1.0


def test_threads_are_blenders():
    render = bpy.context.scene.render
    render.threads_mode, render.threads = "FIXED", 3
    assert export_settings(bpy.context.scene).threads == 3
    render.threads_mode = "AUTO"
    assert export_settings(bpy.context.scene).threads == 0


def test_film():
    add_camera()
    scene = bpy.context.scene
    scene.render.film_transparent = True
    scene.view_settings.exposure = 3.0  # How it is shown, not how it is rendered.
    scene.cycles.film_exposure = 1.5
    exported = export_scene(depsgraph())
    assert exported.transparent_film
    assert exported.exposure == pytest.approx(1.5)


def test_what_the_render_settings_ask_in_vain_is_named():
    add_camera()
    bpy.context.scene.render.use_motion_blur = True
    assert export_scene(depsgraph()).warnings == ["motion blur is not supported and left out"]


def test_passes_are_named():
    add_camera()
    layer = bpy.context.view_layer
    layer.use_pass_z = layer.use_pass_normal = True
    assert export_scene(depsgraph()).warnings == []
    layer.use_pass_vector = layer.use_pass_transmission_color = True
    assert export_scene(depsgraph()).warnings == [
        f"view layer '{layer.name}': these passes are not made: Vector, Transmission Color; untick them "
        "under View Layer > Passes"
    ]


def test_a_view_layer_without_surfaces():
    add_camera()
    add_object("Plane", plane_mesh())
    bpy.context.view_layer.use_solid = False
    scene = export_scene(depsgraph())
    assert len(scene.instances.mesh) == 0 and scene.skipped == ["object 'Plane': the view layer includes no surfaces"]
