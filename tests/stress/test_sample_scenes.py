"""The sample scenes themselves, moved and scaled: minutes, so they are `long`."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from stress import moves

from engine.scene import Scene

pytestmark = pytest.mark.long
SCENES = ("cornell_diffuse", "plates_phong", "lamps", "world", "instances", "many_lights")
FOLDER = Path(__file__).resolve().parents[2] / "sample_blends"
ALONG = np.array([0.6, -0.7, 0.39])


@cache
def sample_scene(name: str) -> Scene:
    """Exported through bpy, at a small size."""
    from tools.lobe_blender import enable_lobe

    enable_lobe()
    import bpy
    from bl_ext.user_default.lobe.addon.export import export_scene

    from tools import blender_render

    scene = blender_render.open_blend(FOLDER / f"{name}.blend")
    scene.render.resolution_percentage = max(1, round(100 * 48 / scene.render.resolution_x))
    return moves.adopted(export_scene(bpy.context.evaluated_depsgraph_get()))


@cache
def unstressed(name: str) -> np.ndarray:
    return moves.render(sample_scene(name))


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1e3, 1e6])
def test_scaled(name, factor):
    found = moves.difference(moves.render(moves.scaled(sample_scene(name), factor)), unstressed(name))
    print(f"{name} scaled by {factor:g}: {found}")
    assert found.half_width.max() < 0.1 and found.holds(), f"{found}"


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("distance", [1e3, 1e4, 1e5, 1e6])
def test_moved(name, distance):
    found = moves.difference(moves.render(moves.moved(sample_scene(name), distance * ALONG)), unstressed(name))
    print(f"{name} moved by {distance:g}: {found}")
    assert found.half_width.max() < 0.1 and found.holds(), f"{found}"
