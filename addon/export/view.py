"""What a 3D viewport looks at: its camera, its size, and the part of it that is rendered.

The viewport's own projection is read, so that the picture lies under its overlays to the pixel, whatever zoom, offset,
shift or sensor has made that projection.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...engine import Aperture, Camera
from .camera import LIGHT_CLIP, camera_window, export_aperture

Rectangle = tuple[float, float, float, float]


class View(NamedTuple):
    """region: (x0, y0, x1, y1) in pixels, rows from the bottom; empty where the viewport sees nothing of the border."""

    camera: Camera
    width: int
    height: int
    region: tuple[int, int, int, int]

    @property
    def is_empty(self) -> bool:
        x0, y0, x1, y1 = self.region
        return x0 >= x1 or y0 >= y1

    def same(self, other: View | None) -> bool:
        if other is None or self[1:] != other[1:]:
            return False
        a, b = self.camera, other.camera
        return np.array_equal(a.transform, b.transform) and _numbers(a) == _numbers(b)


def _numbers(camera: Camera) -> tuple:
    return camera.window, camera.orthographic, camera.clip_start, camera.clip_end, camera.aperture


def export_view(depsgraph, space, region, region_3d) -> View:
    """Of a bpy `SpaceView3D`, its `Region` and its `RegionView3D`."""
    projection = np.array(region_3d.window_matrix, np.float64)
    transform = np.linalg.inv(np.array(region_3d.view_matrix, np.float64))[:3]
    orthographic = projection[3, 3] != 0
    window = projected_window(projection)
    looked_through = _camera_object(depsgraph, space) if region_3d.view_perspective == "CAMERA" else None
    clip, aperture = (space.clip_start, space.clip_end), None
    if looked_through is not None:
        clip, aperture = _of_camera(looked_through, transform, orthographic)
    elif orthographic:
        # It sees as far to the back as to the front: Cycles, blender/camera.cpp.
        transform[:, 3] += transform[:, 2] * (space.clip_end / 2)
        clip = (0.0, space.clip_end)
    camera = Camera(transform, window, orthographic, *clip, aperture)
    border = _border(depsgraph.scene_eval.render, space, looked_through, window)
    return View(camera, region.width, region.height, in_pixels(border, region.width, region.height))


def projected_window(projection: np.ndarray) -> Rectangle:
    """(left, right, bottom, top) of what a projection matrix shows, as in `engine.Camera`."""
    x, y = projection[0], projection[1]
    if projection[3, 3] == 0:  # a point one metre ahead is at (x, y) * scale - offset
        return (x[2] - 1) / x[0], (x[2] + 1) / x[0], (y[2] - 1) / y[1], (y[2] + 1) / y[1]
    return (-x[3] - 1) / x[0], (-x[3] + 1) / x[0], (-y[3] - 1) / y[1], (-y[3] + 1) / y[1]


def _camera_object(depsgraph, space):
    """Evaluated; None where there is none."""
    if space.use_local_camera:
        return space.camera and space.camera.evaluated_get(depsgraph)
    return depsgraph.scene_eval.camera


def _of_camera(object_, transform: np.ndarray, orthographic: bool) -> tuple[tuple[float, float], Aperture | None]:
    """Clip distances and lens of the object that one looks through."""
    data = object_.data
    if object_.type != "CAMERA":
        return LIGHT_CLIP, None
    aperture = export_aperture(data, transform, orthographic) if data.dof.use_dof else None
    return (data.clip_start, data.clip_end), aperture


def _border(render, space, looked_through, window: Rectangle) -> Rectangle:
    """(left, bottom, right, top) of what is rendered, in parts of the viewport. As in Cycles, blender/camera.cpp."""
    if looked_through is None:
        if not space.use_render_border:
            return 0.0, 0.0, 1.0, 1.0
        return (
            space.render_border_min_x,
            space.render_border_min_y,
            space.render_border_max_x,
            space.render_border_max_y,
        )
    data = looked_through.data
    opaque = looked_through.type == "CAMERA" and data.show_passepartout and data.passepartout_alpha == 1.0
    if looked_through.type != "CAMERA" or not (render.use_border or opaque):
        return 0.0, 0.0, 1.0, 1.0
    left, bottom, right, top = 0.0, 0.0, 1.0, 1.0
    if render.use_border:
        left, right, bottom, top = render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y
    frame = camera_window(data, render, data.type == "ORTHO")
    x, y = _part(frame[:2], window[:2]), _part(frame[2:], window[2:])
    return x(left), y(bottom), x(right), y(top)


def _part(inner: tuple[float, float], outer: tuple[float, float]):
    """A function from parts of an interval to parts of another."""
    scale = 1.0 / (outer[1] - outer[0])
    return lambda part: (inner[0] + (inner[1] - inner[0]) * part - outer[0]) * scale


def in_pixels(border: Rectangle, width: int, height: int) -> tuple[int, int, int, int]:
    left, bottom, right, top = np.clip(border, 0.0, 1.0)
    return round(left * width), round(bottom * height), round(right * width), round(top * height)
