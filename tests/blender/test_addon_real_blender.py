"""The package with its wheels, installed and run by a Blender program instead of the bpy module.

Set LOBE_BLENDER to a command that runs Blender (4.2 or newer); without it these tests are skipped.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.blender.real_blender import BLENDER, Run, install

# Blender 4.4 and older can't read what bpy 5.0 writes, so the program under test makes the file itself.
MAKE_FILE = """
import bpy
scene = bpy.context.scene
scene.render.engine = "CYCLES"  # -E LOBE has to change it
for thing in list(bpy.data.objects):
    if thing.type != "CAMERA":
        bpy.data.objects.remove(thing)
scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
scene.render.resolution_x, scene.render.resolution_y = 32, 24
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_mode = "RGBA"
scene.lobe.samples = 4
CHANGE
bpy.ops.wm.save_as_mainfile(filepath=PATH)
"""

pytestmark = pytest.mark.skipif(not BLENDER, reason="no Blender program: set LOBE_BLENDER to a command that runs one")


@pytest.fixture(scope="module")
def blender(tmp_path_factory) -> Run:
    return install(tmp_path_factory.mktemp)


def make_file(blender: Run, path: Path, change: str = "") -> None:
    script = path.with_suffix(".py")
    script.write_text(MAKE_FILE.replace("CHANGE", change).replace("PATH", "__file__.replace('.py', '.blend')"))
    blender("-b", "--python-exit-code", "1", "--python", script)


def test_a_file_renders_from_the_command_line(blender, tmp_path) -> None:
    import OpenImageIO as oiio

    make_file(blender, tmp_path / "white.blend")
    said = blender("-b", tmp_path / "white.blend", "-E", "LOBE", "-o", tmp_path / "out", "-f", "1")
    assert "Error" not in said, said
    image = oiio.ImageInput.open(str(tmp_path / "out0001.exr"))
    pixels = image.read_image("float")
    metadata = image.spec().get_string_attribute("lobe.samples")
    image.close()
    assert pixels.shape == (24, 32, 4)
    assert np.allclose(pixels, 1.0, rtol=1e-3)
    assert metadata == "4"


ANIMATED = """
bpy.ops.mesh.primitive_cube_add()
bpy.context.object.driver_add("location", 0).driver.expression = "frame / 2"
scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
scene.frame_end, scene.render.use_persistent_data, scene.render.use_overwrite = 4, PERSISTENT, False
"""


def test_an_animation_from_the_command_line(blender, tmp_path) -> None:
    """With and without what Blender keeps from frame to frame, and gone on with after two frames."""
    import OpenImageIO as oiio

    found = []
    for persistent, ends in ((False, ["4"]), (True, ["2", "4"])):
        folder = tmp_path / str(persistent)
        folder.mkdir()
        make_file(blender, folder / "moving.blend", ANIMATED.replace("PERSISTENT", str(persistent)))
        for end in ends:
            said = blender("-b", folder / "moving.blend", "-E", "LOBE", "-o", f"{folder}/", "-e", end, "-a")
            assert "Error" not in said, said
        found.append([oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT) for path in sorted(folder.glob("*.exr"))])
    assert len(found[0]) == len(found[1]) == 4
    assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True))
    assert not np.array_equal(found[0][0], found[0][3])


def test_a_scene_without_a_camera_says_so(blender, tmp_path) -> None:
    make_file(blender, tmp_path / "blind.blend", "scene.camera = None")
    said = blender("-b", tmp_path / "blind.blend", "-E", "LOBE", "-o", tmp_path / "out", "-f", "1", code=1)
    assert "Cannot render, no camera" in said


def test_check_scene(blender, tmp_path) -> None:
    """Without a window, in a file of Blender's own; the list is what the panel and the command line show."""
    script = tmp_path / "check.py"
    script.write_text(
        "import sys, bpy\n"
        "bpy.context.scene.render.engine = 'LOBE'\n"
        "bpy.context.scene.render.use_motion_blur = True\n"
        "assert bpy.ops.lobe.check_scene() == {'FINISHED'}\n"
        "report = sys.modules['bl_ext.user_default.lobe.addon.scene_report']\n"
        "for line in report.lines(report.report_of(bpy.context.scene)): print(line)\n"
    )
    said = blender("-b", "--python-exit-code", "1", "--python", script)
    assert "Not drawn as asked:\n" in said
    assert "      -  scene       motion blur is not supported and left out\n" in said
