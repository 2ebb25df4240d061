"""Lobe's panels, and its place in Blender's own."""

from __future__ import annotations

import bpy

from . import compat, data_panels, render_panels

_CLASSES = (*render_panels.CLASSES, *data_panels.CLASSES)


def register() -> None:
    compat.register()
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
    compat.unregister()
