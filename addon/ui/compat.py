"""Blender's own panels that work with Lobe: those made for any engine, and a few that name EEVEE or Cycles alone. And
what Blender's menus show or do with engines that they know alone, though Lobe does it too."""

from __future__ import annotations

import sys

import bpy

ENGINE = "LOBE"

# Made for any engine (BLENDER_RENDER), but they show what Lobe doesn't do, or what a panel of ours shows better.
_EXCLUDE = {
    "DATA_PT_camera_stereoscopy",
    "DATA_PT_falloff_curve",
    "DATA_PT_light",
    "DATA_PT_preview",
    "DATA_PT_spot",
    "DATA_PT_volume_render",
    "NODE_DATA_PT_light",
    "NODE_DATA_PT_spot",
    "NODE_PT_texture_mapping",
    "OBJECT_PT_shading",  # empty by itself: the engines hang theirs into it
    "PARTICLE_PT_hair_shape",
    "PARTICLE_PT_render_path",
    "PARTICLE_PT_render_path_timing",
    "RENDER_PT_color_management_working_space",
    "RENDER_PT_output_views",
    "RENDER_PT_simplify",
    "RENDER_PT_simplify_greasepencil",  # which belongs to that one
    "RENDER_PT_stereoscopy",
}
_EXCLUDE_WORD = "lightprobe"  # of what Lobe doesn't draw at all

# Made for EEVEE alone, and right for Lobe too.
_INCLUDE = {
    "DATA_PT_camera_dof",
    "DATA_PT_camera_dof_aperture",
    "EEVEE_MATERIAL_PT_context_material",
    "MATERIAL_PT_preview",
}

_opted_in: list[type] = []


def _all_panels(cls: type = bpy.types.Panel):
    for sub in cls.__subclasses__():
        yield sub
        yield from _all_panels(sub)


def _wanted(panel: type) -> bool:
    engines = getattr(panel, "COMPAT_ENGINES", None)
    if engines is None or ENGINE in engines or panel.__name__ in _EXCLUDE or _EXCLUDE_WORD in panel.__name__:
        return False
    return panel.__name__ in _INCLUDE or "BLENDER_RENDER" in engines


def _draw_indirect_only(self, context) -> None:
    if context.engine == ENGINE:
        self.layout.operator("outliner.collection_indirect_only_set")
        self.layout.operator("outliner.collection_indirect_only_clear")


def _image_plane_engines() -> set[str]:
    """The engines for which Blender makes an image into a plane: its operators refuse others when they are invoked.
    The materials that they make are of nodes that Lobe reads."""
    return getattr(sys.modules.get("bl_operators.image_as_planes"), "COMPATIBLE_ENGINES", set())


def register() -> None:
    _image_plane_engines().add(ENGINE)
    bpy.types.OUTLINER_MT_collection_view_layer.append(_draw_indirect_only)
    for panel in _all_panels():
        if _wanted(panel):
            panel.COMPAT_ENGINES.add(ENGINE)
            _opted_in.append(panel)


def unregister() -> None:
    _image_plane_engines().discard(ENGINE)
    bpy.types.OUTLINER_MT_collection_view_layer.remove(_draw_indirect_only)
    while _opted_in:
        _opted_in.pop().COMPAT_ENGINES.discard(ENGINE)
