"""Lobe's panels, and its place in Blender's own."""

from __future__ import annotations

import bpy

from . import (
    compare_panel,
    compat,
    data_panels,
    material_panels,
    node_panels,
    passes_panels,
    presets,
    render_panels,
    report_panel,
    understood,
    world_panels,
)

_CLASSES = (
    *presets.CLASSES,
    *report_panel.CLASSES,  # first in its tab, where one sees the number in its header
    *render_panels.CLASSES,
    *compare_panel.CLASSES,
    *passes_panels.CLASSES,
    *data_panels.CLASSES,
    *world_panels.CLASSES,
    *material_panels.CLASSES,
    *node_panels.CLASSES,
)


def register() -> None:
    compat.register()
    presets.register()
    understood.register()
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
    understood.unregister()
    presets.unregister()
    compat.unregister()
