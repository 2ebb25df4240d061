"""Where everything of a packed camera lies in its float32 array. All vectors are in world space.

The matrices are multiplied out in float64 here, once; the kernels only add.
"""

from __future__ import annotations

import numpy as np

from ...scene import Camera

# Offsets of 3-vectors ...
ORIGIN = 0  # of the camera
CORNER = 3  # from the camera to the picture's lower left corner, on the plane one metre ahead
PIXEL_X, PIXEL_Y = 6, 9  # from one pixel to the next
FORWARD = 12  # unit axis
LENS_X, LENS_Y = 15, 18  # half axes of the lens
# ... and of numbers
NEAR, FAR = 21, 22  # clip distances along the axis
FOCUS = 23  # distance of the focal plane along the axis
BLADES, BLADE_ROTATION = 24, 25  # 0 blades: a disk
CAMERA_WORDS = 26


def pack_camera(camera: Camera, width: int, height: int) -> np.ndarray:
    """(CAMERA_WORDS,) float32 for a picture of width x height pixels."""
    transform = np.asarray(camera.transform, np.float64)
    axes = transform[:3, :3] / np.linalg.norm(transform[:3, :3], axis=0)  # the scale is ignored, as in Cycles
    right, up, forward = axes[:, 0], axes[:, 1], -axes[:, 2]
    left, right_edge, bottom, top = camera.window

    packed = np.zeros(CAMERA_WORDS)
    packed[ORIGIN : ORIGIN + 3] = transform[:3, 3]
    packed[CORNER : CORNER + 3] = left * right + bottom * up + (0.0 if camera.orthographic else 1.0) * forward
    packed[PIXEL_X : PIXEL_X + 3] = right * ((right_edge - left) / width)
    packed[PIXEL_Y : PIXEL_Y + 3] = up * ((top - bottom) / height)
    packed[FORWARD : FORWARD + 3] = forward
    packed[NEAR], packed[FAR] = camera.clip_start, camera.clip_end
    packed[FOCUS] = 1.0
    if camera.aperture is not None:
        aperture = camera.aperture
        packed[LENS_X : LENS_X + 3] = right * (aperture.radius / aperture.ratio)
        packed[LENS_Y : LENS_Y + 3] = up * aperture.radius
        packed[FOCUS] = aperture.focus_distance
        if aperture.blades >= 3:
            packed[BLADES] = aperture.blades
            # Cycles (kernel/sample/mapping.h) puts the middle of a side, not a corner, at the rotation's angle.
            packed[BLADE_ROTATION] = aperture.rotation - np.pi / aperture.blades
    return packed.astype(np.float32)
