"""The open .blend as a scene of `engine`, for tests and benchmarks that work on the engine itself.

The add-on inside Blender has a copy of the engine, whose classes are others of the same names.
"""

from __future__ import annotations

import dataclasses
import enum

import engine.scene
from engine.scene import Scene


def exported() -> Scene:
    """Lobe has been enabled, see `lobe_blender.enable_lobe`."""
    import bpy
    from bl_ext.user_default.lobe.addon.export import export_scene

    return _adopted(export_scene(bpy.context.evaluated_depsgraph_get()))


def _adopted(other):
    if dataclasses.is_dataclass(other):
        kind = getattr(engine.scene, type(other).__name__)
        return kind(**{field.name: _adopted(getattr(other, field.name)) for field in dataclasses.fields(other)})
    if isinstance(other, list):
        return [_adopted(item) for item in other]
    if isinstance(other, enum.IntFlag):
        return engine.scene.Visibility(int(other))
    return other
