"""Blender to the engine: turns an evaluated dependency graph into an `engine.Scene`.

This package reads bpy and never keeps any of it: what it returns is plain arrays, safe to trace on another thread
after the callback that handed out the dependency graph has ended. It draws nothing and renders nothing. The render
engine, the viewport and `tools/render.py` call it.
"""

from __future__ import annotations

from .kept import KeptLayers
from .live import LiveExport, export_viewport_settings
from .notes import Group, Note, Notes, grouped
from .scene import export_scene
from .settings import export_settings, film_exposure, property_group
from .stop import ExportStopped
from .view import View, export_view

__all__ = [
    "ExportStopped",
    "Group",
    "KeptLayers",
    "LiveExport",
    "Note",
    "Notes",
    "View",
    "export_scene",
    "export_settings",
    "export_view",
    "export_viewport_settings",
    "film_exposure",
    "grouped",
    "property_group",
]
