"""The World properties: its surface, and what passes take from it. All of it is Blender's own, as Lobe honours it."""

from __future__ import annotations

import bpy

from ..export.materials.material import always_uses_nodes, uses_nodes
from .nodes import draw_surface
from .panel import LobePanel


class _Panel(LobePanel):
    bl_context = "world"

    @classmethod
    def poll(cls, context) -> bool:
        return context.world is not None and super().poll(context)


class LOBE_WORLD_PT_preview(_Panel, bpy.types.Panel):
    bl_label = "Preview"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        self.layout.template_preview(context.world)


class LOBE_WORLD_PT_surface(_Panel, bpy.types.Panel):
    bl_label = "Surface"

    def draw(self, context):
        world = context.world
        if not always_uses_nodes(world):
            self.layout.prop(world, "use_nodes", icon="NODETREE")
            self.layout.separator()
        if uses_nodes(world):
            draw_surface(self.layout, world.node_tree, "ShaderNodeOutputWorld")
        else:
            self.column().prop(world, "color")


class LOBE_WORLD_PT_mist(_Panel, bpy.types.Panel):
    bl_label = "Mist Pass"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        return super().poll(context) and makes(context.scene, "mist")

    def draw(self, context):
        mist = context.world.mist_settings
        column = self.column(align=True, dots=True)
        column.prop(mist, "start")
        column.prop(mist, "depth")
        self.column(dots=True).prop(mist, "falloff")


class LOBE_WORLD_PT_ambient_occlusion(_Panel, bpy.types.Panel):
    bl_label = "Ambient Occlusion Pass"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        return super().poll(context) and makes(context.scene, "ambient_occlusion")

    def draw(self, context):
        self.column().prop(context.world.light_settings, "distance")


def makes(scene, name: str) -> bool:
    """Whether the box of a pass is ticked in any view layer: settings of others would change nothing."""
    return any(getattr(layer, f"use_pass_{name}") for layer in scene.view_layers)


class LOBE_WORLD_PT_ray_visibility(_Panel, bpy.types.Panel):
    """Blender itself has no such thing of a world: Lobe honours what Cycles brings, where it is enabled."""

    bl_label = "Ray Visibility"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        return hasattr(context.world, "cycles_visibility") and _Panel.poll(context)

    def draw(self, context):
        column = self.column()
        for name in ("camera", "diffuse", "glossy"):
            column.prop(context.world.cycles_visibility, name)


CLASSES = (
    LOBE_WORLD_PT_preview,
    LOBE_WORLD_PT_surface,
    LOBE_WORLD_PT_mist,
    LOBE_WORLD_PT_ambient_occlusion,
    LOBE_WORLD_PT_ray_visibility,
)
