"""The sample scenes as the add-on exports them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from engine.scene import Scene

SCENES = ("cornell_diffuse", "plates_phong", "lamps", "world", "instances", "many_lights")
FOLDER = Path(__file__).resolve().parents[1] / "sample_blends"


@cache
def sample_scene(name: str, width: int = 48) -> Scene:
    """Exported through bpy, about as many pixels wide."""
    from tools.lobe_blender import enable_lobe

    enable_lobe()
    from tools import blender_render
    from tools.exported import exported

    scene = blender_render.open_blend(FOLDER / f"{name}.blend")
    scene.render.resolution_percentage = max(1, round(100 * width / scene.render.resolution_x))
    return exported()
