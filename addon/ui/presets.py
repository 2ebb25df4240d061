"""Presets of the Sampling panel: some of ours, in `addon/presets`, and the user's own, where Blender keeps those."""

from __future__ import annotations

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

FOLDER = str(Path(__file__).resolve().parent.parent)  # the one that holds `presets`
SUBFOLDER = "lobe/sampling"

# What a preset of sampling is about: how much time goes into a pixel. Not how paths are drawn, nor the seed.
PROPERTIES = ("use_adaptive_sampling", "adaptive_threshold", "samples", "time_limit")


class LOBE_OT_sampling_preset_add(AddPresetBase, bpy.types.Operator):
    """Add or remove a preset of the sampling: noise threshold, samples and time limit"""

    bl_idname = "lobe.sampling_preset_add"
    bl_label = "Add Sampling Preset"

    preset_menu = "LOBE_PT_sampling_presets"
    preset_subdir = SUBFOLDER
    preset_defines = ["lobe = bpy.context.scene.lobe"]
    preset_values = [f"lobe.{name}" for name in PROPERTIES]


class LOBE_PT_sampling_presets(PresetPanel, bpy.types.Panel):
    bl_label = "Sampling Presets"
    preset_subdir = SUBFOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = LOBE_OT_sampling_preset_add.bl_idname
    COMPAT_ENGINES = {"LOBE"}

    @staticmethod
    def post_cb(context, filepath) -> None:
        """As Cycles has it: values that a script has set would not be noticed otherwise."""
        render = context.scene.render
        render.filter_size = render.filter_size


CLASSES = (LOBE_OT_sampling_preset_add, LOBE_PT_sampling_presets)


def register() -> None:
    bpy.utils.register_preset_path(FOLDER)


def unregister() -> None:
    bpy.utils.unregister_preset_path(FOLDER)
