"""The active camera: what part of the plane before it the picture shows, its lens, and the picture's size in pixels.

The formulas are those of Blender's camera (blenkernel/intern/camera.cc) and of Cycles (blender/camera.cpp);
`tests/blender/test_export_camera.py` holds them against `Camera.view_frame` and `Object.calc_matrix_camera`.
"""

from __future__ import annotations

from math import pi

import numpy as np

from ...engine import Aperture, Camera, SceneError
from .notes import Notes
from .units import aperture_radius, spot_lens

MIN_FOCUS = 1e-5  # metres; a focus object at the camera itself would ask for zero
NEW_SPOT_SIZE = pi / 4
LIGHT_CLIP = 1e-5, 1e5  # metres, of a lamp as the camera; as in Cycles, blender/camera.cpp
NO_CAMERA = "the scene has no camera: add one, or make one the active camera"


def resolution(render) -> tuple[int, int]:
    """Pixels of the whole picture. Blender drops the fraction."""
    percentage = render.resolution_percentage
    return render.resolution_x * percentage // 100, render.resolution_y * percentage // 100


def border(render, width: int, height: int) -> tuple[int, int, int, int] | None:
    """The render border in pixels, rows from the bottom, None without one.

    Blender drops the fraction of float32 products (render/intern/pipeline.cc); with `use_crop_to_border` the same
    pixels are rendered into a picture of just their size.
    """
    if not render.use_border:
        return None
    low_x, high_x, low_y, high_y = np.float32(
        [render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y]
    ) * np.float32([width, width, height, height])
    return int(low_x), int(low_y), int(high_x), int(high_y)


def export_camera(scene, notes: Notes) -> Camera:
    """The scene's active camera, evaluated. Raises SceneError where there is none."""
    object_ = scene.camera
    if object_ is None:
        raise SceneError(NO_CAMERA)
    transform = np.array(object_.matrix_world, np.float64)[:3]
    transform[:, :3] = clear_scale(transform[:, :3])
    if object_.type == "LIGHT":
        return _light_as_camera(object_, transform, scene.render)
    if object_.type != "CAMERA":
        raise SceneError(f"object {object_.name_full!r} is the active camera, but is not a camera")
    data = object_.data
    if data.type not in ("PERSP", "ORTHO"):
        notes.warn("camera", object_.name_full, f"type {data.type.lower()} is not supported, drawn as perspective")
    orthographic = data.type == "ORTHO"
    camera = Camera(
        transform=transform,
        window=camera_window(data, scene.render, orthographic),
        orthographic=orthographic,
        clip_start=data.clip_start,
        clip_end=data.clip_end,
        aperture=export_aperture(data, transform, orthographic) if data.dof.use_dof else None,
    )
    if problem := problem_of(camera, scene.render):
        raise SceneError(f"camera {object_.name_full!r}: {problem}")
    return camera


def problem_of(camera: Camera, render) -> str:
    """Why nothing can be seen by a camera, in Blender's words; else empty, also where the picture has no pixels."""
    left, right, bottom, top = camera.window
    if all(resolution(render)) and (left >= right or bottom >= top):
        return "its view is empty: check its focal length, sensor size and orthographic scale"
    if camera.clip_start >= camera.clip_end:
        return f"its clip start ({camera.clip_start:g} m) must be nearer than its clip end ({camera.clip_end:g} m)"
    return ""


def clear_scale(matrix: np.ndarray) -> np.ndarray:
    """(3, 3) with columns of unit length; a column of length zero stays."""
    lengths = np.linalg.norm(matrix, axis=0)
    return matrix / np.where(lengths > 0, lengths, 1.0)


def camera_window(data, render, orthographic: bool) -> tuple[float, float, float, float]:
    """(left, right, bottom, top) on the plane one metre away, or in metres for an orthographic camera.

    The sensor (or the orthographic scale) spans the fitted side of the picture, which is counted in units of pixel
    aspect; the shift counts in units of that side, in both directions.
    """
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    span = data.ortho_scale if orthographic else sensor / data.lens
    return _window(span, data.sensor_fit, data.shift_x, data.shift_y, render)


def _window(span: float, fit: str, shift_x: float, shift_y: float, render) -> tuple[float, float, float, float]:
    width, height = resolution(render)
    across, upward = width * render.pixel_aspect_x, height * render.pixel_aspect_y
    fitted = across if fit == "HORIZONTAL" or (fit == "AUTO" and across >= upward) else upward
    fitted = fitted or 1.0  # A picture without pixels is refused by `Scene.validate`.
    half_x, half_y = span * across / fitted / 2.0, span * upward / fitted / 2.0
    x, y = shift_x * span, shift_y * span
    return x - half_x, x + half_x, y - half_y, y + half_y


def export_aperture(data, transform: np.ndarray, orthographic: bool) -> Aperture:
    dof = data.dof
    distance = dof.focus_distance
    if dof.focus_object is not None:
        towards = _focus_point(dof) - transform[:, 3]
        distance = abs(float(towards @ transform[:, 2]))
    return Aperture(
        radius=aperture_radius(data.lens, dof.aperture_fstop, orthographic),
        focus_distance=max(distance, MIN_FOCUS),
        blades=dof.aperture_blades,
        rotation=dof.aperture_rotation,
        ratio=dof.aperture_ratio,
    )


def _focus_point(dof) -> np.ndarray:
    """World position of the focus object, or of its bone."""
    matrix = np.array(dof.focus_object.matrix_world, np.float64)
    pose = dof.focus_object.pose
    bone = pose.bones.get(dof.focus_subtarget) if pose and dof.focus_subtarget else None
    if bone is not None:
        matrix = matrix @ np.array(bone.matrix, np.float64)
    return matrix[:3, 3]


def _light_as_camera(object_, transform: np.ndarray, render) -> Camera:
    """Blender lets one look through a lamp: a spot's cone sets the lens. Cycles reads it of any lamp, where it is what
    new lamps have: Python can't tell where a lamp was once a spot of another size."""
    lens = spot_lens(getattr(object_.data, "spot_size", NEW_SPOT_SIZE))
    start, end = LIGHT_CLIP
    window = _window(36.0 / lens, "AUTO", 0.0, 0.0, render)
    return Camera(transform=transform, window=window, clip_start=start, clip_end=end)
