"""Render settings: `scene.lobe` and Blender's own thread count to `engine.Settings`."""

from __future__ import annotations

from dataclasses import fields

from ...engine import Settings


def export_settings(scene) -> Settings:
    """The settings of a Blender scene. Without the add-on's properties (not registered) the defaults hold."""
    render = scene.render
    values = {"threads": render.threads if render.threads_mode == "FIXED" else 0}
    properties = getattr(scene, "lobe", None)
    for field in fields(Settings):
        if field.name != "threads" and hasattr(properties, field.name):
            values[field.name] = getattr(properties, field.name)
    return Settings(**values)


def film_exposure(scene) -> float:
    """Linear factor. Blender has no film exposure of its own: Cycles' property counts where Cycles is enabled.

    The view transform's exposure is not it: that is applied when the picture is shown.
    """
    cycles = getattr(scene, "cycles", None)
    return float(getattr(cycles, "film_exposure", 1.0))
