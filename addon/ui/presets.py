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

# Kind, which names the folder of its files -> (whose values its presets hold, and which).
KINDS = {
    "sampling": (
        LOBE, ["lobe.use_adaptive_sampling", "lobe.adaptive_threshold", "lobe.samples", "lobe.time_limit"]
    ),
    "viewport_sampling": (LOBE, ["lobe.viewport_samples"]),
    "light_paths": (
        LOBE,
        [
            "lobe.max_bounces",
            "lobe.diffuse_bounces",
            "lobe.glossy_bounces",
            "lobe.clamp_direct",
            "lobe.clamp_indirect",
        ],
    ),
    "performance": (RENDER, ["render.use_persistent_data"]),
}  # fmt: skip


class _PresetPanel(PresetPanel):
    preset_operator = "script.execute_preset"
    COMPAT_ENGINES = {"LOBE"}

    @staticmethod
    def post_cb(context, filepath) -> None:
        """As Cycles has it: values that a script has set would not be noticed otherwise."""
        render = context.scene.render
        render.filter_size = render.filter_size


def _classes(kind: str, owner: str, values: list[str]) -> tuple[type, type]:
    """The operator that adds and removes presets of a kind, and the panel that lists them."""
    label, menu, folder = kind.replace("_", " ").title(), f"LOBE_PT_{kind}_presets", f"lobe/{kind}"
    adding = {
        "bl_idname": f"lobe.{kind}_preset_add",
        "bl_label": f"Add {label} Preset",
        "bl_description": f"Add or remove a preset of the {label} settings",
        "preset_menu": menu,
        "preset_subdir": folder,
        "preset_defines": [owner],
        "preset_values": values,
    }
    listing = {"bl_label": f"{label} Presets", "preset_subdir": folder, "preset_add_operator": adding["bl_idname"]}
    return (
        type(f"LOBE_OT_{kind}_preset_add", (AddPresetBase, bpy.types.Operator), adding),
        type(menu, (_PresetPanel, bpy.types.Panel), listing),
    )


_PAIRS = {kind: _classes(kind, *of_kind) for kind, of_kind in KINDS.items()}
CLASSES = tuple(cls for pair in _PAIRS.values() for cls in pair)


def draw_presets(layout, kind: str) -> None:
    """The button in a panel's header."""
    _PAIRS[kind][1].draw_panel_header(layout)


def register() -> None:
    bpy.utils.register_preset_path(FOLDER)


def unregister() -> None:
    bpy.utils.unregister_preset_path(FOLDER)
