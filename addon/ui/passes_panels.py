"""The passes of a view layer, laid out as Cycles' are. Boxes of passes that Lobe doesn't make are shown where they are
ticked, to be unticked."""

from __future__ import annotations

import bpy

from ..export.unsupported import passes_not_made
from .panel import LobePanel


class _Panel(LobePanel):
    bl_context = "view_layer"


class LOBE_VIEWLAYER_PT_passes(_Panel, bpy.types.Panel):
    bl_label = "Passes"

    def draw(self, context):
        pass


class LOBE_VIEWLAYER_PT_passes_data(_Panel, bpy.types.Panel):
    bl_label = "Data"
    bl_parent_id = "LOBE_VIEWLAYER_PT_passes"

    def draw(self, context):
        layer = context.view_layer
        include = self.column().column(heading="Include", align=True)
        for name in ("combined", "z", "mist", "position", "normal", "uv"):
            include.prop(layer, f"use_pass_{name}")
        if hasattr(layer, "use_pass_grease_pencil"):  # Blender's own, from 5.0 on
            include.prop(layer, "use_pass_grease_pencil", text="Grease Pencil")
        include.prop(layer.lobe, "denoising_data")
        indexes = self.column().column(heading="Indexes", align=True)
        indexes.prop(layer, "use_pass_object_index")
        indexes.prop(layer, "use_pass_material_index")
        self.column().prop(layer, "pass_alpha_threshold")
        self.column().column(heading="Debug", align=True).prop(layer.lobe, "pass_sample_count")


class LOBE_VIEWLAYER_PT_passes_light(_Panel, bpy.types.Panel):
    bl_label = "Light"
    bl_parent_id = "LOBE_VIEWLAYER_PT_passes"

    def draw(self, context):
        layer = context.view_layer
        for lobe in ("diffuse", "glossy"):
            column = self.column().column(heading=lobe.capitalize(), align=True)
            for part in ("direct", "indirect", "color"):
                column.prop(layer, f"use_pass_{lobe}_{part}", text=part.capitalize())
        other = self.column().column(heading="Other", align=True)
        other.prop(layer, "use_pass_emit", text="Emission")
        other.prop(layer, "use_pass_environment")
        other.prop(layer, "use_pass_ambient_occlusion", text="Ambient Occlusion")


class LOBE_VIEWLAYER_PT_passes_not_made(_Panel, bpy.types.Panel):
    bl_label = "Not Made by Lobe"
    bl_parent_id = "LOBE_VIEWLAYER_PT_passes"

    @classmethod
    def poll(cls, context) -> bool:
        return super().poll(context) and bool(passes_not_made(context.view_layer))

    def draw(self, context):
        column = self.column().column(heading="Ticked", align=True)
        column.active = False
        for owner, key, text in passes_not_made(context.view_layer):
            column.prop(owner, key, text=text)


CLASSES = (
    LOBE_VIEWLAYER_PT_passes,
    LOBE_VIEWLAYER_PT_passes_data,
    LOBE_VIEWLAYER_PT_passes_light,
    LOBE_VIEWLAYER_PT_passes_not_made,
)
