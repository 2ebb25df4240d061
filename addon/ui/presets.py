"""Presets of the Render properties' panels: some of ours, in `addon/presets`, and the user's own, where Blender keeps
those. They hold what takes time and what is lost for it; not how paths are drawn, nor the seed.
"""

from __future__ import annotations

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

FOLDER = str(Path(__file__).resolve().parent.parent)  # the one that holds `presets`
LOBE = "lobe = bpy.context.scene.lobe"
RENDER = "render = bpy.context.scene.render"


class _PresetPanel(PresetPanel):
    preset_operator = "script.execute_preset"
    COMPAT_ENGINES = {"LOBE"}

    @staticmethod
    def post_cb(context, filepath) -> None:
        """As Cycles has it: values that a script has set would not be noticed otherwise."""
        render = context.scene.render
        render.filter_size = render.filter_size


class LOBE_OT_sampling_preset_add(AddPresetBase, bpy.types.Operator):
    """Add or remove a preset of the sampling: noise threshold, samples and time limit"""

    bl_idname = "lobe.sampling_preset_add"
    bl_label = "Add Sampling Preset"
    preset_menu = "LOBE_PT_sampling_presets"
    preset_subdir = "lobe/sampling"
    preset_defines = [LOBE]
    preset_values = ["lobe.use_adaptive_sampling", "lobe.adaptive_threshold", "lobe.samples", "lobe.time_limit"]


class LOBE_PT_sampling_presets(_PresetPanel, bpy.types.Panel):
    bl_label = "Sampling Presets"
    preset_subdir = LOBE_OT_sampling_preset_add.preset_subdir
    preset_add_operator = LOBE_OT_sampling_preset_add.bl_idname


class LOBE_OT_viewport_sampling_preset_add(AddPresetBase, bpy.types.Operator):
    """Add or remove a preset of the viewport's samples"""

    bl_idname = "lobe.viewport_sampling_preset_add"
    bl_label = "Add Viewport Sampling Preset"
    preset_menu = "LOBE_PT_viewport_sampling_presets"
    preset_subdir = "lobe/viewport_sampling"
    preset_defines = [LOBE]
    preset_values = ["lobe.viewport_samples"]


class LOBE_PT_viewport_sampling_presets(_PresetPanel, bpy.types.Panel):
    bl_label = "Viewport Sampling Presets"
    preset_subdir = LOBE_OT_viewport_sampling_preset_add.preset_subdir
    preset_add_operator = LOBE_OT_viewport_sampling_preset_add.bl_idname


class LOBE_OT_light_paths_preset_add(AddPresetBase, bpy.types.Operator):
    """Add or remove a preset of the light paths: bounces and clamping"""

    bl_idname = "lobe.light_paths_preset_add"
    bl_label = "Add Light Paths Preset"
    preset_menu = "LOBE_PT_light_paths_presets"
    preset_subdir = "lobe/light_paths"
    preset_defines = [LOBE]
    preset_values = [
        "lobe.max_bounces",
        "lobe.diffuse_bounces",
        "lobe.glossy_bounces",
        "lobe.clamp_direct",
        "lobe.clamp_indirect",
    ]


class LOBE_PT_light_paths_presets(_PresetPanel, bpy.types.Panel):
    bl_label = "Light Paths Presets"
    preset_subdir = LOBE_OT_light_paths_preset_add.preset_subdir
    preset_add_operator = LOBE_OT_light_paths_preset_add.bl_idname


class LOBE_OT_performance_preset_add(AddPresetBase, bpy.types.Operator):
    """Add or remove a preset of the performance: threads, and whether data stay in memory"""

    bl_idname = "lobe.performance_preset_add"
    bl_label = "Add Performance Preset"
    preset_menu = "LOBE_PT_performance_presets"
    preset_subdir = "lobe/performance"
    preset_defines = [RENDER]
    preset_values = ["render.threads_mode", "render.use_persistent_data"]


class LOBE_PT_performance_presets(_PresetPanel, bpy.types.Panel):
    bl_label = "Performance Presets"
    preset_subdir = LOBE_OT_performance_preset_add.preset_subdir
    preset_add_operator = LOBE_OT_performance_preset_add.bl_idname


CLASSES = (
    LOBE_OT_sampling_preset_add,
    LOBE_PT_sampling_presets,
    LOBE_OT_viewport_sampling_preset_add,
    LOBE_PT_viewport_sampling_presets,
    LOBE_OT_light_paths_preset_add,
    LOBE_PT_light_paths_presets,
    LOBE_OT_performance_preset_add,
    LOBE_PT_performance_presets,
)


def register() -> None:
    bpy.utils.register_preset_path(FOLDER)


def unregister() -> None:
    bpy.utils.unregister_preset_path(FOLDER)
