"""Camera rays of the float32 kernels beside those of the float64 reference: the same through the same point."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.registry import SAMPLERS
from engine.reference.camera import camera_rays
from engine.scene import Camera
from tests.statistics.adapters import ADAPTERS
from tests.statistics.film import HEIGHT, WIDTH, Lens

LENSES = [case for e in SAMPLERS if e.family == "lens" for case in ADAPTERS["lens"](e) if not case.reference]
ROUNDING = 1e-6  # of unit directions and of lengths, relative. Measured: 2e-7


def places(count: int) -> np.ndarray:
    return np.random.default_rng(5).random((count, 2)) * (WIDTH, HEIGHT)


def wanted(camera: Camera, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(direction, near, far) of rays that start at `origin` on the lens and meet the reference's unbent rays on the
    plane of focus. In float64."""
    unbent = Camera(window=camera.window, orthographic=camera.orthographic)
    start, along, _, _ = camera_rays(unbent, points, (WIDTH, HEIGHT), np.random.default_rng(0))
    assert camera.aperture is not None
    focus = start + along * (camera.aperture.focus_distance / -along[:, 2:])
    direction = focus - origin
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return direction, camera.clip_start / -direction[:, 2], camera.clip_end / -direction[:, 2]


def largest_difference(case: Lens, camera: Camera) -> float:
    points = places(2000).astype(np.float32).astype(float)
    rays = case.rays(points, seed=1)
    direction, near, far = wanted(camera, points, rays[:, :3])
    off = [np.abs(rays[:, 3:6] - direction), rays[:, 6] / near - 1, rays[:, 7] / far - 1]
    return max(np.abs(x).max() for x in off)


@pytest.mark.parametrize("case", LENSES, ids=str)
def test_float32_rays_are_those_of_the_reference(case):
    assert largest_difference(case, case.camera) < ROUNDING


def test_the_comparison_can_fail():
    """A window that is wider by 1e-5."""
    case = LENSES[0]
    wider = Camera(window=tuple(x * (1 + 1e-5) for x in case.camera.window), aperture=case.aperture)
    assert largest_difference(case, wider) > ROUNDING
