"""The camera and the picture, against Blender's own `view_frame`, `calc_matrix_camera` and render result sizes."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe import engine
from bl_ext.user_default.lobe.addon.export import export_scene
from mathutils import Matrix

from tests.blender.export_checks import add_camera, add_object, depsgraph, in_render


def picture(width: int, height: int, percentage: int = 100, aspect=(1.0, 1.0)):
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, percentage
    render.pixel_aspect_x, render.pixel_aspect_y = aspect
    return render


PICTURES = [(640, 480, (1, 1)), (480, 640, (1, 1)), (300, 300, (1, 1)), (320, 300, (1, 2)), (300, 301, (1.5, 1))]


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", PICTURES)
def test_window_is_blenders(kind, fit, size):
    render = picture(*size[:2], aspect=size[2])
    camera = add_camera((1, 2, 3), (0.3, 0.4, 0.5), type=kind, sensor_fit=fit, lens=37.0, ortho_scale=2.5)
    camera.data.sensor_width, camera.data.sensor_height = 30.0, 17.0
    camera.data.shift_x, camera.data.shift_y = 0.2, -0.35
    exported = export_scene(depsgraph()).camera
    assert exported.orthographic == (kind == "ORTHO")

    frame = np.array(camera.data.view_frame(scene=bpy.context.scene))
    if kind == "PERSP":
        frame = frame / -frame[:, 2:]
    left, right, bottom, top = exported.window
    assert (left, right) == pytest.approx((frame[:, 0].min(), frame[:, 0].max()), rel=1e-5)
    assert (bottom, top) == pytest.approx((frame[:, 1].min(), frame[:, 1].max()), rel=1e-5)

    matrix = camera.calc_matrix_camera(
        depsgraph(), x=size[0], y=size[1], scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
    )
    corner = matrix @ Matrix.Translation((left, bottom, -1.0)).col[3]
    assert (corner.x / corner.w, corner.y / corner.w) == pytest.approx((-1, -1), abs=1e-5)


def test_scale_of_the_camera_does_not_matter():
    camera = add_camera((1, 2, 3), (0.3, 0.4, 0.5))
    plain = export_scene(depsgraph()).camera.transform
    camera.scale = (2, 3, 0.5)
    assert export_scene(depsgraph()).camera.transform == pytest.approx(plain, abs=1e-6)


@pytest.mark.parametrize("width, percentage", [(101, 50), (33, 99), (7, 150), (1920, 33)])
def test_resolution_percentage(width, percentage):
    picture(width, width, percentage)
    add_camera()
    scene = export_scene(depsgraph())
    assert scene.width == scene.height == width * percentage // 100
    assert scene.region is None


@pytest.mark.parametrize("crop", [True, False])
@pytest.mark.parametrize(
    "edges", [(0.333, 0.777, 0.21, 0.83), (0.1999, 0.8, 0.0, 1.0), (0.5, 0.52, 0.5, 0.6), (0.0, 0.0999, 0.9, 1.0)]
)
def test_border_is_the_render_results(edges, crop):
    """The size that Blender gives the engine's result is the size of the exported region."""
    render = picture(101, 77)
    render.use_border, render.use_crop_to_border = True, crop
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = edges
    add_camera()
    x0, y0, x1, y1 = export_scene(depsgraph()).region
    assert (x0, y0) == (int(np.float32(edges[0]) * 101), int(np.float32(edges[2]) * 77))
    assert result_size() == (x1 - x0, y1 - y0)


def result_size() -> tuple[int, int]:
    """What `begin_result` clamps a far too large result to."""

    def ask(probe, _depsgraph):
        result = probe.begin_result(0, 0, 10000, 10000)
        size = result.resolution_x, result.resolution_y
        probe.end_result(result)
        return size

    return in_render(ask, "render")


def test_no_camera():
    with pytest.raises(engine.SceneError) as error:
        export_scene(depsgraph())
    assert str(error.value) == "the scene has no camera: add one, or make one the active camera"


def test_an_empty_as_camera():
    bpy.context.scene.camera = add_object("Aim", None)
    with pytest.raises(engine.SceneError) as error:
        export_scene(depsgraph())
    assert str(error.value) == "object 'Aim' is the active camera, but is not a camera"


def test_empty_picture():
    picture(4, 4, 1)
    add_camera()
    with pytest.raises(engine.SceneError) as error:
        export_scene(depsgraph()).validate()
    assert str(error.value) == "the resolution is 0 x 0 pixels: set both to 1 or more"


def test_empty_border():
    render = picture(100, 100)
    render.use_border = True
    render.border_min_x, render.border_max_x = 0.501, 0.502
    add_camera()
    with pytest.raises(engine.SceneError) as error:
        export_scene(depsgraph()).validate()
    message = "the render region (50, 0) to (50, 100) is empty: make it at least one pixel large"
    assert str(error.value) == message


def test_depth_of_field():
    camera = add_camera((0, 0, 10), lens=80.0)
    assert export_scene(depsgraph()).camera.aperture is None
    dof = camera.data.dof
    dof.use_dof, dof.focus_distance, dof.aperture_fstop = True, 4.0, 2.0
    dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio = 6, 0.5, 2.0
    aperture = export_scene(depsgraph()).camera.aperture
    assert aperture.radius == pytest.approx(0.02)
    assert (aperture.focus_distance, aperture.blades, aperture.rotation, aperture.ratio) == (4.0, 6, 0.5, 2.0)
    camera.data.type = "ORTHO"
    assert export_scene(depsgraph()).camera.aperture.radius == pytest.approx(0.25)


def test_focus_object_counts_along_the_axis():
    camera = add_camera((0, 0, 10))
    camera.data.dof.use_dof = True
    camera.data.dof.focus_object = add_object("Focus", None, (3, 4, 2.5))
    assert export_scene(depsgraph()).camera.aperture.focus_distance == pytest.approx(7.5)


def test_panorama_is_named():
    add_camera(type="PANO")
    scene = export_scene(depsgraph())
    assert scene.warnings == ["camera 'Camera': type pano is not supported, drawn as perspective"]
    assert not scene.camera.orthographic


def test_looking_through_a_spot():
    picture(100, 100)
    lamp = bpy.data.lights.new("Spot", "SPOT")
    lamp.spot_size = 1.0
    bpy.context.scene.camera = add_object("Spot", lamp)
    window = export_scene(depsgraph()).camera.window
    frame = 36 / (16 / np.tan(0.5)) / 2
    assert window == pytest.approx((-frame, frame, -frame, frame))


def test_looking_through_another_lamp():
    """As through a spot that is as wide as a new one."""
    picture(100, 100)
    bpy.context.scene.camera = add_object("Sun", bpy.data.lights.new("Sun", "SUN"))
    through_sun = export_scene(depsgraph()).camera
    bpy.context.scene.camera = add_object("Spot", bpy.data.lights.new("Spot", "SPOT"))
    through_spot = export_scene(depsgraph()).camera
    assert through_sun.window == pytest.approx(through_spot.window)
    assert (through_sun.clip_start, through_sun.clip_end) == (1e-5, 1e5)
