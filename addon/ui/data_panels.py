"""Panels of the data that every engine shows in its own way: lamps, and which rays see an object.

They show what Lobe honours, and nothing else; the properties are Blender's own.
"""

from __future__ import annotations

import bpy

from .panel import LobePanel


class LOBE_LIGHT_PT_light(LobePanel, bpy.types.Panel):
    bl_label = "Light"
    bl_context = "data"

    @classmethod
    def poll(cls, context) -> bool:
        return context.light is not None and super().poll(context)

    def draw(self, context):
        light = context.light
        self.layout.row().prop(light, "type", expand=True)
        column = self.column()
        if getattr(light, "use_temperature", None) is not None:  # Blender 4.5 on
            heading = column.column(align=True, heading="Temperature")
            row = heading.row(align=True)
            row.prop(light, "use_temperature", text="")
            sub = row.row()
            sub.active = light.use_temperature
            sub.prop(light, "temperature", text="")
        column.prop(light, "color")
        column.prop(light, "energy", text="Strength" if light.type == "SUN" else "Power")
        if hasattr(light, "exposure"):
            column.prop(light, "exposure")
        column.separator()
        _SHAPES[light.type](column, light)
        column.separator()
        column.prop(light, "use_shadow", text="Cast Shadow")


def _point(column, light) -> None:
    if hasattr(light, "use_soft_falloff"):
        column.prop(light, "use_soft_falloff")
    column.prop(light, "shadow_soft_size", text="Radius")


def _sun(column, light) -> None:
    column.prop(light, "angle")


def _area(column, light) -> None:
    column.prop(light, "shape")
    sub = column.column(align=True)
    if light.shape in {"SQUARE", "DISK"}:
        sub.prop(light, "size")
    else:
        sub.prop(light, "size", text="Size X")
        sub.prop(light, "size_y", text="Y")
    column.prop(light, "spread")


_SHAPES = {"POINT": _point, "SPOT": _point, "SUN": _sun, "AREA": _area}


class LOBE_LIGHT_PT_beam_shape(LobePanel, bpy.types.Panel):
    bl_label = "Beam Shape"
    bl_parent_id = "LOBE_LIGHT_PT_light"
    bl_context = "data"

    @classmethod
    def poll(cls, context) -> bool:
        return context.light is not None and context.light.type == "SPOT" and super().poll(context)

    def draw(self, context):
        column = self.column()
        column.prop(context.light, "spot_size", text="Spot Size")
        column.prop(context.light, "spot_blend", text="Blend", slider=True)
        column.prop(context.light, "show_cone")


class LOBE_OBJECT_PT_ray_visibility(LobePanel, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_parent_id = "OBJECT_PT_visibility"
    bl_context = "object"

    @classmethod
    def poll(cls, context) -> bool:
        kinds = {"MESH", "CURVE", "SURFACE", "FONT", "META", "LIGHT"}
        return context.object is not None and context.object.type in kinds and super().poll(context)

    def draw(self, context):
        column = self.column()
        column.prop(context.object, "visible_camera", text="Camera")
        column.prop(context.object, "visible_diffuse", text="Diffuse")
        column.prop(context.object, "visible_glossy", text="Glossy")
        if context.object.type != "LIGHT":
            column.prop(context.object, "visible_shadow", text="Shadow")


CLASSES = (LOBE_LIGHT_PT_light, LOBE_LIGHT_PT_beam_shape, LOBE_OBJECT_PT_ray_visibility)
