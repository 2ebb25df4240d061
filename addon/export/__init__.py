"""Blender to the engine: turns an evaluated dependency graph into an `engine.Scene`.

This package reads bpy and never keeps any of it: what it returns is plain arrays, safe to trace on another thread
after the callback that handed out the dependency graph has ended. It draws nothing and renders nothing. The render
engine, the viewport and `tools/render.py` call it.
"""

from __future__ import annotations

from .notes import Group, Note, Notes, grouped
from .scene import export_scene
from .settings import export_settings
from .stop import ExportStopped

__all__ = ["ExportStopped", "Group", "Note", "Notes", "export_scene", "export_settings", "grouped"]
