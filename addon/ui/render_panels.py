"""The panels of the Render properties: Sampling, Light Paths, Film and Performance, in Blender's own layout."""

from __future__ import annotations

import bpy
from bl_ui.properties_grease_pencil_common import GreasePencilSimplifyPanel

from .. import precompile
from ..denoise import MISSING, UNUSABLE, is_missing
from ..export.scene import WORKING_SPACE, working_space
from .panel import LobePanel
from .presets import draw_presets
from .text import draw_text


class _Panel(LobePanel):
    bl_context = "render"


class LOBE_RENDER_PT_sampling(_Panel, bpy.types.Panel):
    bl_label = "Sampling"

    def draw(self, context):
        pass


class LOBE_RENDER_PT_sampling_viewport(_Panel, bpy.types.Panel):
    bl_label = "Viewport"
    bl_parent_id = "LOBE_RENDER_PT_sampling"

    def draw_header_preset(self, context):
        draw_presets(self.layout, "viewport_sampling")

    def draw(self, context):
        self.column().prop(context.scene.lobe, "viewport_samples", text="Samples")


class LOBE_RENDER_PT_sampling_render(_Panel, bpy.types.Panel):
    bl_label = "Render"
    bl_parent_id = "LOBE_RENDER_PT_sampling"

    def draw_header_preset(self, context):
        draw_presets(self.layout, "sampling")

    def draw(self, context):
        lobe = context.scene.lobe
        column = self.column()
        heading = column.column(align=True, heading="Noise Threshold")
        row = heading.row(align=True)
        row.prop(lobe, "use_adaptive_sampling", text="")
        sub = row.row()
        sub.active = lobe.use_adaptive_sampling
        sub.prop(lobe, "adaptive_threshold", text="")
        column = column.column(align=True)
        column.prop(lobe, "samples", text="Max Samples" if lobe.use_adaptive_sampling else "Samples")
        column.prop(lobe, "time_limit")


class LOBE_RENDER_PT_sampling_render_denoise(_Panel, bpy.types.Panel):
    bl_label = "Denoise"
    bl_parent_id = "LOBE_RENDER_PT_sampling_render"

    def draw_header(self, context):
        self.layout.active = not is_missing()
        self.layout.prop(context.scene.lobe, "use_denoising", text="")

    def draw(self, context):
        if is_missing() and context.scene.lobe.use_denoising:
            draw_text(self.layout, context, MISSING, "ERROR")
        elif is_missing():
            self.layout.active = False
            draw_text(self.layout, context, UNUSABLE)
        else:
            draw_text(self.layout, context, "With OpenImageDenoise, at the end of the render")


class LOBE_RENDER_PT_sampling_advanced(_Panel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "LOBE_RENDER_PT_sampling"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        lobe = context.scene.lobe
        column = self.column()
        column.prop(lobe, "seed")
        column.prop(lobe, "hemisphere_sampling")
        column.prop(lobe, "lobe_selection")


class LOBE_RENDER_PT_light_paths(_Panel, bpy.types.Panel):
    bl_label = "Light Paths"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header_preset(self, context):
        draw_presets(self.layout, "light_paths")

    def draw(self, context):
        pass


class LOBE_RENDER_PT_light_paths_max_bounces(_Panel, bpy.types.Panel):
    bl_label = "Max Bounces"
    bl_parent_id = "LOBE_RENDER_PT_light_paths"

    def draw(self, context):
        lobe = context.scene.lobe
        column = self.column(align=True)
        column.prop(lobe, "max_bounces")
        column.separator()
        column.prop(lobe, "diffuse_bounces")
        column.prop(lobe, "glossy_bounces")


class LOBE_RENDER_PT_light_paths_clamping(_Panel, bpy.types.Panel):
    bl_label = "Clamping"
    bl_parent_id = "LOBE_RENDER_PT_light_paths"

    def draw(self, context):
        lobe = context.scene.lobe
        column = self.column(align=True)
        column.prop(lobe, "clamp_direct")
        column.prop(lobe, "clamp_indirect")


class LOBE_RENDER_PT_film(_Panel, bpy.types.Panel):
    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        scene = context.scene
        column = self.column()
        # Blender itself has no film exposure: Lobe honours the one that Cycles brings, where it is enabled.
        if hasattr(scene, "cycles"):
            column.prop(scene.cycles, "film_exposure")
        column.prop(scene.render, "film_transparent", text="Transparent")


class LOBE_RENDER_PT_film_pixel_filter(_Panel, bpy.types.Panel):
    bl_label = "Pixel Filter"
    bl_parent_id = "LOBE_RENDER_PT_film"

    def draw(self, context):
        lobe = context.scene.lobe
        column = self.column()
        column.prop(lobe, "pixel_filter", text="Type")
        if lobe.pixel_filter != "BOX":
            column.prop(lobe, "filter_width")


class LOBE_RENDER_PT_simplify(_Panel, bpy.types.Panel):
    """Blender's own, which would stand above Sampling."""

    bl_label = "Simplify"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context):
        self.layout.prop(context.scene.render, "use_simplify", text="")

    def draw(self, context):
        pass


class LOBE_RENDER_PT_simplify_viewport(_Panel, bpy.types.Panel):
    bl_label = "Viewport"
    bl_parent_id = "LOBE_RENDER_PT_simplify"

    def draw(self, context):
        column = self.column()
        _draw_simplify(column, context.scene.render, "")
        column.prop(context.scene.render, "use_simplify_normals", text="Normals")


class LOBE_RENDER_PT_simplify_render(_Panel, bpy.types.Panel):
    bl_label = "Render"
    bl_parent_id = "LOBE_RENDER_PT_simplify"

    def draw(self, context):
        _draw_simplify(self.column(), context.scene.render, "_render")


class LOBE_RENDER_PT_simplify_greasepencil(_Panel, GreasePencilSimplifyPanel, bpy.types.Panel):
    bl_label = "Grease Pencil"
    bl_parent_id = "LOBE_RENDER_PT_simplify"
    bl_options = {"DEFAULT_CLOSED"}


def _draw_simplify(column, render, suffix: str) -> None:
    column.active = render.use_simplify
    column.prop(render, f"simplify_subdivision{suffix}", text="Max Subdivision")
    column.prop(render, f"simplify_child_particles{suffix}", text="Max Child Particles")


class LOBE_RENDER_PT_performance(_Panel, bpy.types.Panel):
    bl_label = "Performance"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header_preset(self, context):
        draw_presets(self.layout, "performance")

    def draw(self, context):
        render = context.scene.render
        column = self.column()
        column.prop(render, "threads_mode")
        sub = column.column()
        sub.enabled = render.threads_mode == "FIXED"
        sub.prop(render, "threads")
        column.prop(render, "use_persistent_data", text="Persistent Data")
        if said := precompile.said():
            draw_text(self.layout, context, said, "TIME")


class LOBE_RENDER_PT_performance_debug(_Panel, bpy.types.Panel):
    bl_label = "Debug"
    bl_parent_id = "LOBE_RENDER_PT_performance"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        self.column().prop(context.scene.lobe, "road")


class LOBE_RENDER_PT_working_space(_Panel, bpy.types.Panel):
    """Where a file has a working space that Lobe doesn't support, Blender's own panel, so that it can be put back."""

    bl_label = "Working Space"
    bl_parent_id = "RENDER_PT_color_management"

    @classmethod
    def poll(cls, context) -> bool:
        return super().poll(context) and working_space() != WORKING_SPACE

    def draw(self, context):
        bpy.types.RENDER_PT_color_management_working_space.draw(self, context)


CLASSES = (
    LOBE_RENDER_PT_sampling,
    LOBE_RENDER_PT_sampling_viewport,
    LOBE_RENDER_PT_sampling_render,
    LOBE_RENDER_PT_sampling_render_denoise,
    LOBE_RENDER_PT_sampling_advanced,
    LOBE_RENDER_PT_light_paths,
    LOBE_RENDER_PT_light_paths_max_bounces,
    LOBE_RENDER_PT_light_paths_clamping,
    LOBE_RENDER_PT_simplify,
    LOBE_RENDER_PT_simplify_viewport,
    LOBE_RENDER_PT_simplify_render,
    LOBE_RENDER_PT_simplify_greasepencil,
    LOBE_RENDER_PT_film,
    LOBE_RENDER_PT_film_pixel_filter,
    LOBE_RENDER_PT_performance,
    LOBE_RENDER_PT_performance_debug,
    LOBE_RENDER_PT_working_space,
)
