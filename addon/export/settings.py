"""Render settings: `scene.lobe` and Blender's own thread count to `engine.Settings`."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from ...engine import Settings


def property_group(scene, name: str) -> Any:
    """`scene.lobe` or `scene.cycles`, of a scene that may be evaluated; None without that add-on.

    The evaluated scene's own is what is animated. Where none was ever set it is the original's: to ask an evaluated
    datablock for a group of properties that it hasn't makes one.
    """
    try:
        return getattr(scene if scene.is_property_set(name) else scene.original, name)
    except (TypeError, AttributeError):  # there is no such property
        return None


def export_settings(scene) -> Settings:
    """The settings of a Blender scene. Without the add-on's properties (not registered) the defaults hold."""
    render = scene.render
    values = {"threads": render.threads if render.threads_mode == "FIXED" else 0}
    properties = property_group(scene, "lobe")
    for field in fields(Settings):
        if field.name != "threads" and hasattr(properties, field.name):
            values[field.name] = getattr(properties, field.name)
    return Settings(**values)


def film_exposure(scene) -> float:
    """Linear factor. Blender has no film exposure of its own: Cycles' property counts where Cycles is enabled.

    The view transform's exposure is not it: that is applied when the picture is shown.
    """
    return float(getattr(property_group(scene, "cycles"), "film_exposure", 1.0))
