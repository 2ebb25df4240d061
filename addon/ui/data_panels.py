"""Panels of the data that every engine shows in its own way: lamps, view layers, and which rays see what.

They show what Lobe honours, and nothing else; the properties are Blender's own.
"""

from __future__ import annotations

import bpy

from ..export.materials.material import always_uses_nodes, uses_nodes
from .nodes import draw_surface
from .panel import LobePanel
from .text import draw_text


class _LightPanel(LobePanel):
    bl_context = "data"

    @classmethod
    def poll(cls, context) -> bool:
        return context.light is not None and super().poll(context)


class LOBE_LIGHT_PT_preview(_LightPanel, bpy.types.Panel):
    bl_label = "Preview"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        self.layout.template_preview(context.light)


class LOBE_LIGHT_PT_light(_LightPanel, bpy.types.Panel):
    bl_label = "Light"

    def draw(self, context):
        light = context.light
        if self.bl_space_type == "PROPERTIES":
            self.layout.row().prop(light, "type", expand=True)
            self.layout.separator()
            column = self.column(dots=True)
        else:  # four buttons are too wide for a sidebar
            column = self.column(dots=True)
            column.prop(light, "type")
        if getattr(light, "use_temperature", None) is not None:  # Blender 4.5 on
            heading = column.column(align=True, heading="Temperature")
            row = heading.row(align=True)
            row.use_property_decorate = False  # one dot, the temperature's
            row.prop(light, "use_temperature", text="")
            sub = row.row()
            sub.active = light.use_temperature
            sub.prop(light, "temperature", text="")
            row.prop_decorator(light, "temperature")
        column.prop(light, "color")
        column.prop(light, "energy", text="Strength" if light.type == "SUN" else "Power")
        if hasattr(light, "exposure"):
            column.prop(light, "exposure")
        if hasattr(light, "normalize"):  # Blender 4.5 on
            column.prop(light, "normalize")
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


_SHAPES = {"POINT": _point, "SPOT": _point, "SUN": _sun, "AREA": _area}


class LOBE_LIGHT_PT_beam_shape(_LightPanel, bpy.types.Panel):
    bl_label = "Beam Shape"
    bl_parent_id = "LOBE_LIGHT_PT_light"

    @classmethod
    def poll(cls, context) -> bool:
        return _LightPanel.poll(context) and context.light.type in ("SPOT", "AREA")

    def draw(self, context):
        light, column = context.light, self.column(dots=True)
        if light.type == "AREA":
            column.prop(light, "spread")
            return
        column.prop(light, "spot_size", text="Angle" if bpy.app.version >= (5, 0, 0) else "Spot Size")
        column.prop(light, "spot_blend", text="Blend", slider=True)
        column.prop(light, "show_cone")


class LOBE_LIGHT_PT_nodes(_LightPanel, bpy.types.Panel):
    bl_label = "Nodes"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        if not always_uses_nodes(context.light):
            self.layout.prop(context.light, "use_nodes", text="")

    def draw(self, context):
        light = context.light
        if not uses_nodes(light):
            self.layout.active = False
            draw_text(self.layout, context, "The color above is the whole light")
            return
        draw_surface(self.layout, light.node_tree, "ShaderNodeOutputLight")


class LOBE_VIEWLAYER_PT_filter(LobePanel, bpy.types.Panel):
    bl_label = "Filter"
    bl_context = "view_layer"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        column = self.column()
        include = column.column(heading="Include")
        include.prop(context.view_layer, "use_sky", text="Environment")
        include.prop(context.view_layer, "use_solid", text="Surfaces")
        if hasattr(context.view_layer, "use_grease_pencil"):  # Blender 5.0 on
            include.prop(context.view_layer, "use_grease_pencil", text="Grease Pencil")


class LOBE_VIEWLAYER_PT_override(LobePanel, bpy.types.Panel):
    bl_label = "Override"
    bl_context = "view_layer"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        column = self.column()
        column.prop(context.view_layer, "material_override", text="Material")
        if hasattr(context.view_layer, "world_override"):  # Blender 4.3 on
            column.prop(context.view_layer, "world_override", text="World")


class LOBE_OBJECT_PT_ray_visibility(LobePanel, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_parent_id = "OBJECT_PT_visibility"
    bl_context = "object"

    @classmethod
    def poll(cls, context) -> bool:
        return context.object is not None and is_or_places_visible(context.object) and super().poll(context)

    def draw(self, context):
        column = self.column()
        column.prop(context.object, "visible_camera", text="Camera")
        column.prop(context.object, "visible_diffuse", text="Diffuse")
        column.prop(context.object, "visible_glossy", text="Glossy")
        if context.object.type != "LIGHT":
            column.prop(context.object, "visible_shadow", text="Shadow")


def is_or_places_visible(object_) -> bool:
    """An empty's flags hold for the collection that it places, too."""
    if object_.instance_type == "COLLECTION" and object_.instance_collection is not None:
        return True
    return object_.type in {"MESH", "CURVE", "SURFACE", "FONT", "META", "LIGHT"}


CLASSES = (
    LOBE_LIGHT_PT_preview,
    LOBE_LIGHT_PT_light,
    LOBE_LIGHT_PT_beam_shape,
    LOBE_LIGHT_PT_nodes,
    LOBE_VIEWLAYER_PT_filter,
    LOBE_VIEWLAYER_PT_override,
    LOBE_OBJECT_PT_ray_visibility,
)
