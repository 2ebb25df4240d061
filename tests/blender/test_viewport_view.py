"""What a viewport looks at, from the matrices that Blender's 3D views hold: without a window these are made up."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe.addon.export import export_view
from bl_ext.user_default.lobe.addon.export.view import in_pixels, projected_window
from bl_ext.user_default.lobe.engine import Picture
from mathutils import Matrix

from tests.blender.export_checks import add_camera, depsgraph

WIDTH, HEIGHT = 320, 200


def look(perspective: str = "PERSP", projection: Matrix | None = None, view: Matrix | None = None, **space):
    """`export_view` of a made-up region."""
    defaults = {
        "clip_start": 0.01, "clip_end": 100.0, "use_render_border": False, "use_local_camera": False, "camera": None,
        "render_border_min_x": 0.25, "render_border_max_x": 0.5, "render_border_min_y": 0.1, "render_border_max_y": 1.0,
    }  # fmt: skip
    region_3d = SimpleNamespace(
        window_matrix=projection or Matrix.Identity(4), view_matrix=view or Matrix(), view_perspective=perspective
    )
    region = SimpleNamespace(width=WIDTH, height=HEIGHT)
    return export_view(depsgraph(), SimpleNamespace(**{**defaults, **space}), region, region_3d)


def through_camera(**space):
    """Through the scene's camera, whose frame fills a region of the picture's shape."""
    camera = bpy.context.scene.camera
    projection = camera.calc_matrix_camera(depsgraph(), x=WIDTH, y=HEIGHT)
    return look("CAMERA", projection, camera.matrix_world.inverted(), **space)


def set_picture(width: int = WIDTH, height: int = HEIGHT):
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    return render


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("fit", ["AUTO", "VERTICAL"])
def test_the_view_through_a_camera_is_the_final_renders(kind, fit):
    from bl_ext.user_default.lobe.addon.export import export_scene

    set_picture()
    camera = add_camera((1, 2, 3), (0.3, 0.4, 0.5), type=kind, sensor_fit=fit, lens=37.0, shift_x=0.2, shift_y=-0.1)
    camera.data.dof.use_dof, camera.data.dof.focus_distance = True, 3.0
    bpy.context.view_layer.update()
    view, final = through_camera(), export_scene(depsgraph()).camera
    assert view.camera.window == pytest.approx(final.window, rel=1e-5)
    assert view.camera.transform == pytest.approx(final.transform, abs=1e-5)
    assert view.camera.orthographic == final.orthographic == (kind == "ORTHO")
    assert (view.camera.clip_start, view.camera.clip_end) == (final.clip_start, final.clip_end)
    assert view.camera.aperture == final.aperture
    assert view.region == (0, 0, WIDTH, HEIGHT)


def test_a_free_view_has_its_own_clip_planes_and_no_lens():
    add_camera()
    bpy.context.scene.camera.data.dof.use_dof = True
    projection = bpy.context.scene.camera.calc_matrix_camera(depsgraph(), x=WIDTH, y=HEIGHT)
    camera = look("PERSP", projection).camera
    assert (camera.clip_start, camera.clip_end, camera.aperture) == (pytest.approx(0.01), 100.0, None)


def test_a_free_orthographic_view_sees_what_lies_behind_it():
    add_camera(type="ORTHO", ortho_scale=4.0)
    projection = bpy.context.scene.camera.calc_matrix_camera(depsgraph(), x=WIDTH, y=HEIGHT)
    camera = look("ORTHO", projection, Matrix.Translation((0, 0, -7))).camera
    assert camera.orthographic and camera.clip_start == 0
    assert camera.transform[:, 3] == pytest.approx((0, 0, 57))  # half of clip_end behind the view's own place
    assert camera.window == pytest.approx((-2, 2, -1.25, 1.25), rel=1e-6)


def test_a_projection_off_the_middle():
    near, far = 0.1, 10.0
    left, right, bottom, top = -0.3, 0.9, -0.2, 0.1  # on the plane one metre ahead
    projection = np.zeros((4, 4))
    projection[0, 0], projection[0, 2] = 2 / (right - left), (right + left) / (right - left)
    projection[1, 1], projection[1, 2] = 2 / (top - bottom), (top + bottom) / (top - bottom)
    projection[2, 2:], projection[3, 2] = (-(far + near) / (far - near), -2 * far * near / (far - near)), -1
    assert projected_window(projection) == pytest.approx((left, right, bottom, top))


def test_render_border_of_a_free_view():
    assert look(use_render_border=True).region == (80, 20, 160, 200)
    assert look(use_render_border=True, render_border_max_x=0.25).is_empty


def test_render_border_of_the_camera():
    render = set_picture()
    add_camera()
    assert through_camera(use_render_border=True).region == (0, 0, WIDTH, HEIGHT)  # that is the free view's
    render.use_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.5, 1.0
    assert through_camera().region == (80, 100, 240, 200)


def test_an_opaque_passepartout_cuts_the_view_to_the_cameras_frame():
    set_picture(200, 200)  # a square in the middle of the region
    data = add_camera(sensor_fit="VERTICAL").data
    bpy.context.view_layer.update()
    assert through_camera().region == (0, 0, WIDTH, HEIGHT)
    data.show_passepartout, data.passepartout_alpha = True, 1.0
    bpy.context.view_layer.update()
    assert through_camera().region == (60, 0, 260, 200)


def test_a_view_equals_itself_and_no_other():
    add_camera()
    bpy.context.view_layer.update()
    view = through_camera()
    assert view.same(through_camera()) and not view.same(None)
    assert not view.same(look("PERSP"))
    bpy.context.scene.camera.location.x += 1e-3
    bpy.context.view_layer.update()
    assert not view.same(through_camera())
    bpy.context.scene.camera.location.x -= 1e-3
    bpy.context.scene.camera.data.clip_end = 7
    bpy.context.view_layer.update()
    assert not view.same(through_camera())


def test_borders_outside_are_cut_off():
    assert in_pixels((-1.0, 0.2, 3.0, 0.5), 10, 10) == (0, 2, 10, 5)


def test_where_a_picture_is_drawn():
    pytest.importorskip("gpu")
    from bl_ext.user_default.lobe.addon.draw import placement

    def placed(region, size, view_region=(0, 0, 100, 50)):
        picture = Picture(np.zeros((1, 1, 4), np.float32), region, size, 1, 1)
        return placement(picture, look()._replace(width=100, height=50, region=view_region))

    assert placed((0, 0, 100, 50), (100, 50)) == ((0, 0, 100, 50), (0, 0, 1, 1))
    # Coarse pixels reach beyond the edge.
    assert placed((0, 0, 104, 56), (100, 50)) == ((0, 0, 100, 50), (0, 0, 100 / 104, 50 / 56))
    # From before a resize.
    assert placed((0, 0, 200, 200), (200, 200)) == ((0, 0, 100, 50), (0, 0, 1, 1))
    # A border.
    place, cut = placed((8, 8, 56, 32), (100, 50), (10, 10, 50, 30))
    assert place == (10, 10, 50, 30)
    assert cut == pytest.approx((2 / 48, 2 / 24, 42 / 48, 22 / 24))
