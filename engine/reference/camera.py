"""Camera rays and the pixel filter."""

from __future__ import annotations

import numpy as np

from ..scene import Camera
from ..settings import Settings
from .vectors import disk, dot, unit


def filter_offsets(settings: Settings, count: int, rng: np.random.Generator) -> np.ndarray:
    """Where in the plane samples of a pixel fall, relative to its centre, in pixels: (count, 2).

    They are drawn from the filter itself, so every sample counts the same.
    """
    u = rng.random((count, 2))
    if settings.pixel_filter == "BOX":
        return u - 0.5
    # Blackman-Harris is a sum of cosines, so its integral is known. As in Cycles it reaches `filter_width` pixels
    # to either side (scene/film.cpp doubles the width).
    x = np.linspace(-0.5, 0.5, 4097)
    t = 2 * np.pi * (x + 0.5)
    cdf = 0.35875 * t - 0.48829 * np.sin(t) + 0.14128 / 2 * np.sin(2 * t) - 0.01168 / 3 * np.sin(3 * t)
    return 2 * settings.filter_width * np.interp(u, cdf / cdf[-1], x)


def camera_rays(
    camera: Camera, position: np.ndarray, size: tuple[int, int], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rays through `position` (n, 2), in pixels of a picture of `size` (width, height), (0, 0) at the bottom left.

    Returns origin (n, 3), direction (n, 3), and the distances (n,) at which clipping starts and ends.
    """
    left, right, bottom, top = camera.window
    x = left + (right - left) * position[:, 0] / size[0]
    y = bottom + (top - bottom) * position[:, 1] / size[1]
    zero, one = np.zeros_like(x), np.ones_like(x)
    if camera.orthographic:
        origin, direction = np.column_stack([x, y, zero]), np.column_stack([zero, zero, -one])
    else:
        origin, direction = np.zeros((len(x), 3)), np.column_stack([x, y, -one])

    lens = camera.aperture
    if lens is not None and lens.radius > 0:
        focus = origin + direction * lens.focus_distance
        u, v = _aperture(len(x), lens.blades, lens.rotation, rng)
        origin = origin + np.column_stack([u / lens.ratio, v, zero]) * lens.radius
        direction = focus - origin

    direction = unit(direction)
    near, far = camera.clip_start / -direction[:, 2], camera.clip_end / -direction[:, 2]
    matrix = np.asarray(camera.transform, np.float64)
    axes = matrix[:, :3] / np.sqrt(dot(matrix[:, :3].T, matrix[:, :3].T))
    return origin @ axes.T + matrix[:, 3], unit(direction @ axes.T), near, far


def _aperture(count: int, blades: int, rotation: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points in the unit disk, or in the regular polygon within it."""
    if blades < 3:
        return disk(count, rng)
    # A triangle between the centre and one side, then a uniform point in it. The middle of side 0 lies at `rotation`.
    corner = rng.integers(blades, size=count)
    s, t = np.sqrt(rng.random(count)), rng.random(count)
    start, end = (2 * np.pi / blades * (corner + k - 0.5) + rotation for k in (0, 1))
    return (
        s * ((1 - t) * np.cos(start) + t * np.cos(end)),
        s * ((1 - t) * np.sin(start) + t * np.sin(end)),
    )
