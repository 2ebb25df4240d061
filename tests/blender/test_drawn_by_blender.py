"""What Blender itself puts over the picture of any engine: Freestyle's lines and Grease Pencil. Cycles is the measure.

Blender needs a graphics driver for either, and ends the process where it finds none: these tests are then skipped.
"""

from __future__ import annotations

import subprocess
import sys

import bpy
import numpy as np
import pytest

from tools import blender_render
from tools.lobe_blender import MODULE

from .export_checks import add_object, new_material, plane_mesh

CHANGED = 0.05  # of a pixel that shows a line or a stroke
DRAW_A_SPHERE = """
import bpy
bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = 4
bpy.context.scene.render.engine = "BLENDER_WORKBENCH"
bpy.ops.render.render()
"""


@pytest.fixture(scope="module", autouse=True)
def _graphics() -> None:
    if subprocess.run([sys.executable, "-c", DRAW_A_SPHERE], capture_output=True).returncode:
        pytest.skip("Blender finds no graphics driver")


@pytest.fixture
def scene(simple_scene):
    """A grey square that shines, before a darker world, so that neither engine has noise but at its edges."""
    simple_scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.1, 0.1, 0.1, 1.0)
    material, _ = new_material("Grey", "ShaderNodeEmission", Color=(0.5, 0.5, 0.5, 1.0))
    square = add_object("Square", plane_mesh(1.5), (0, 10, 0), (np.pi / 2, 0, 0))
    square.data.materials.append(material)
    simple_scene.cycles.samples = simple_scene.lobe.samples = 16
    simple_scene.cycles.pixel_filter_type = "BOX"
    simple_scene.render.resolution_x, simple_scene.render.resolution_y = 64, 48
    return simple_scene


@pytest.fixture
def by_both(scene, rendered):
    """A function: the picture (h, w, 4) by Lobe, and by Cycles."""

    def render() -> tuple[np.ndarray, np.ndarray]:
        scene.render.engine = "LOBE"
        lobe = rendered(scene)
        scene.render.engine = "CYCLES"
        cycles = rendered(scene)
        scene.render.engine = "LOBE"
        return lobe, cycles

    return render


def draw_lines(scene, **style) -> None:
    """Along what Freestyle finds by itself: outlines and creases."""
    scene.render.use_freestyle = bpy.context.view_layer.use_freestyle = True
    lines = bpy.context.view_layer.freestyle_settings.linesets
    line = lines[0] if len(lines) else lines.new("Lines")
    line.linestyle = bpy.data.linestyles.new("Style")
    for key, value in {"color": (1.0, 0.0, 0.0), "thickness": 4.0, **style}.items():
        setattr(line.linestyle, key, value)


def draw_strokes(distance: float = 5.0) -> None:
    """A head in Grease Pencil, so far from the camera. Seen from there the left side of it is where the square is, at
    10, and the right side is not."""
    add = bpy.ops.object.grease_pencil_add if bpy.app.version >= (4, 3) else bpy.ops.object.gpencil_add
    add(type="MONKEY", location=(0.15 * distance, distance, 0))
    object_ = bpy.context.object
    object_.scale = (distance / 10.0,) * 3  # equally large in the picture
    object_.show_in_front = object_.use_grease_pencil_lights = False


def notes() -> list[tuple[str, str]]:
    """(level, what) of the newest report."""
    report = sys.modules[f"{MODULE}.addon.scene_report"].report_of(bpy.context.scene)
    return [(group.level, group.what) for group in report.groups]


def changed(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    return np.abs(after - before).max(axis=2) > CHANGED


def test_freestyles_lines_are_drawn(scene, by_both) -> None:
    """Those that one can see through are EEVEE's, grainy, where Cycles' own are not: named. In one picture, as the
    next that EEVEE draws lines into takes minutes without a graphics card."""
    plain = by_both()
    draw_lines(scene)
    assert blender_render.check(scene).is_honoured
    draw_lines(scene, alpha=0.5, thickness=8.0)
    drawn = by_both()
    lobe, cycles = (changed(after, before) for after, before in zip(drawn, plain, strict=True))
    assert lobe.sum() > 200 and (lobe & cycles).sum() > 0.8 * max(lobe.sum(), cycles.sum())
    # Along a side of the square, where one line alone passes.
    red = (drawn[1][..., 0] > drawn[1][..., 1] + 0.1)[20:28]
    columns = np.flatnonzero(red.all(axis=0))
    lobe, cycles = (picture[20:28, columns, 1] for picture in drawn)
    assert len(columns) > 2
    assert lobe.std(axis=0).mean() > 3.0 * cycles.std(axis=0).mean()
    assert abs(lobe.mean() - cycles.mean()) < 0.05
    assert [level for level, what in notes() if "Freestyle" in what and "grainy" in what] == ["APPROXIMATED"]


@pytest.mark.parametrize("distance", [5.0, 20.0])
def test_grease_pencil_is_drawn(scene, by_both, distance: float) -> None:
    """Where it is behind something a part of it is hidden, given the pass that Blender knows the depth by."""
    bpy.context.view_layer.use_pass_z = True
    plain = by_both()
    draw_strokes(distance)
    drawn = by_both()
    lobe, cycles = (changed(after, before) for after, before in zip(drawn, plain, strict=True))
    assert lobe.sum() > 50 and (lobe ^ cycles).sum() < 0.02 * lobe.sum()
    assert np.abs(drawn[0] - drawn[1])[lobe & cycles].mean() < 0.02
    square = plain[0][..., 0] > 0.45
    assert (lobe & ~square).sum() > 20 and (lobe & square).any() == (distance < 10.0)
    assert notes() == []


def test_grease_pencil_alone(scene, rendered) -> None:
    """Nothing is missing where no object has faces, nor where nothing gives light."""
    bpy.data.objects.remove(bpy.data.objects["Square"])
    scene.world = None
    assert not rendered(scene)[..., :3].any()
    assert [level for level, what in notes() if "nothing to render" in what] == ["WARNING"]
    draw_strokes()
    assert rendered(scene)[..., :3].any()
    assert notes() == []
    assert blender_render.check(scene).is_honoured
    if hasattr(bpy.context.view_layer, "use_grease_pencil"):
        bpy.context.view_layer.use_grease_pencil = False
        assert not blender_render.check(scene).is_honoured


def test_the_pass_of_grease_pencil(scene, layers) -> None:
    if not hasattr(bpy.context.view_layer, "use_pass_grease_pencil"):
        pytest.skip("Blender has it from 5.0 on")
    draw_strokes()
    bpy.context.view_layer.use_pass_grease_pencil = True
    alpha = layers(scene)["ViewLayer.Grease Pencil.A"]
    assert alpha.max() > 0.9 and (alpha == 0.0).any()
    assert notes() == []


def test_a_comparison_of_what_blender_draws(scene) -> None:
    """Both engines are asked for the same. Lines take each of them its own time: they are left out."""
    operators = sys.modules[f"{MODULE}.addon.compare.operators"]
    draw_strokes()
    draw_lines(scene)
    assert bpy.ops.lobe.compare_with_cycles() == {"FINISHED"}
    outcome = operators.outcome_of(scene)
    assert outcome.different == [] and "Freestyle is left out" in outcome.unmatched
    assert scene.render.use_freestyle
    assert ("Blender: Use Freestyle", "on", "off") in outcome.changed or any(
        "Freestyle" in what for what, *_ in outcome.changed
    )
