"""Tests that run inside bpy, with Lobe built, installed and enabled as a user would have it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

import bpy  # noqa: E402


@pytest.fixture(autouse=True)
def _fresh_file():
    """Every test starts with an empty file that renders with Lobe: no camera, no object, one scene."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)  # unlike factory settings keeps the add-on
    bpy.context.scene.render.engine = "LOBE"
    yield


@pytest.fixture
def simple_scene() -> bpy.types.Scene:
    """A white world, a camera at the origin that looks along +y, 32 x 24 pixels, 4 samples, box filter."""
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.camera.rotation_euler = (np.pi / 2, 0.0, 0.0)
    scene.collection.objects.link(scene.camera)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 32, 24, 100
    scene.lobe.samples, scene.lobe.pixel_filter = 4, "BOX"
    return scene


@pytest.fixture
def rendered(tmp_path: Path) -> Callable[[bpy.types.Scene], np.ndarray]:
    """A function that renders a scene to a file and reads it back: (h, w, 4) float32, row 0 at the bottom."""
    import OpenImageIO as oiio

    def render(scene: bpy.types.Scene) -> np.ndarray:
        settings = scene.render.image_settings
        settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
        path = tmp_path / "render.exr"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        image = oiio.ImageInput.open(str(path))
        pixels = image.read_image("float")
        image.close()
        return pixels[::-1]

    return render


@pytest.fixture
def layers(tmp_path: Path) -> Callable[[bpy.types.Scene], dict[str, np.ndarray]]:
    """A function that renders into a multilayer file: (h, w) float32 by "Layer.Pass.Channel", row 0 at the top."""
    import OpenImageIO as oiio

    def render(scene: bpy.types.Scene) -> dict[str, np.ndarray]:
        settings, path = scene.render.image_settings, tmp_path / "layers.exr"
        if hasattr(settings, "media_type"):
            settings.media_type = "MULTI_LAYER_IMAGE"
        settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        image, index, found = oiio.ImageInput.open(str(path)), 0, {}
        while image.seek_subimage(index, 0):
            names = image.spec().channelnames
            pixels = image.read_image(index, 0, 0, len(names), "float")
            found.update({name: pixels[..., i].copy() for i, name in enumerate(names)})
            index += 1
        image.close()
        return found

    return render
