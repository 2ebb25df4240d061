"""Camera rays against float64 geometry: projection, clipping, and the thin lens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.kernels.camera import generate_ray, pack_camera
from engine.scene import Aperture, Camera
from tests.statistics import chi2
from tests.statistics.film import draw_rays

f32 = np.float32
WIDTH, HEIGHT = 200, 100


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def placed(scale=(1, 1, 1), seed: int = 2) -> np.ndarray:
    return np.column_stack([rotation(seed) * scale, (3.0, -4.0, 5.0)])


def rays(camera: Camera, points, u=None):
    """(origins, directions, t_near, t_far), float64"""
    points = np.asarray(points, np.float32).reshape(-1, 2)
    u = np.full((len(points), 2), 0.3, np.float32) if u is None else u
    out = np.empty((len(points), 8), np.float32)
    packed = pack_camera(camera, WIDTH, HEIGHT)
    assert packed.dtype == np.float32
    draw_rays(packed, int(camera.orthographic), int(camera.aperture is not None), points, u, out)
    out = out.astype(np.float64)
    return out[:, :3], out[:, 3:6], out[:, 6], out[:, 7]


def to_camera(camera: Camera, points: np.ndarray, direction: bool = False) -> np.ndarray:
    """World space to the camera's own, its scale ignored."""
    axes = camera.transform[:, :3] / np.linalg.norm(camera.transform[:, :3], axis=0)
    return (points if direction else points - camera.transform[:, 3]) @ axes


def places(count: int = 50) -> np.ndarray:
    return np.random.default_rng(1).random((count, 2)) * (WIDTH, HEIGHT)


def on_window(camera: Camera, points: np.ndarray) -> np.ndarray:
    left, right, bottom, top = camera.window
    return np.array((left, bottom)) + points / (WIDTH, HEIGHT) * np.array((right - left, top - bottom))


WINDOW = (-0.9, 1.1, -0.3, 0.7)  # shifted, with pixels that are not square


def assert_projects(camera: Camera, told: Camera) -> None:
    """The rays of `camera` are those of `told` by float64 geometry."""
    points = places()
    origin, direction, near, far = rays(camera, points)
    assert origin == pytest.approx(np.broadcast_to(told.transform[:, 3], origin.shape))
    assert np.abs(np.linalg.norm(direction, axis=1) - 1).max() < 3e-7
    local = to_camera(told, direction, direction=True)
    assert np.abs(local[:, :2] / -local[:, 2:] - on_window(told, points)).max() < 5e-7
    # The clip planes stand across the axis.
    assert near * -local[:, 2] == pytest.approx(told.clip_start, rel=1e-6)
    assert far * -local[:, 2] == pytest.approx(told.clip_end, rel=1e-6)


@pytest.mark.parametrize("scale", [(1, 1, 1), (2, 0.5, 7), (1, 1, -1)])
def test_perspective(scale):
    camera = Camera(transform=placed(scale), window=WINDOW, clip_start=0.25, clip_end=80)
    assert_projects(camera, camera)


@pytest.mark.parametrize(
    "change",
    [
        {"window": (-0.899999, 1.1, -0.3, 0.7)},
        {"clip_start": 0.250001},
        {"clip_end": 80.0001},
        {"transform": placed((1, 1, -1))},
        {"transform": placed() + 1e-5},
    ],
    ids=lambda change: next(iter(change)),
)
def test_another_projection_is_caught(change):
    camera = Camera(transform=placed(), window=WINDOW, clip_start=0.25, clip_end=80)
    with pytest.raises(AssertionError):
        assert_projects(camera, replace(camera, **change))


def test_row_0_is_at_the_bottom():
    camera = Camera(window=(-1, 1, -0.5, 0.5))
    _, direction, _, _ = rays(camera, [(0, 0), (WIDTH, 0), (0, HEIGHT), (WIDTH / 2, HEIGHT / 2)])
    slopes = direction[:, :2] / -direction[:, 2:]
    assert slopes == pytest.approx(np.array([(-1, -0.5), (1, -0.5), (-1, 0.5), (0, 0)]), abs=1e-6)


def test_orthographic():
    camera = Camera(transform=placed((3, 3, 3)), window=WINDOW, orthographic=True, clip_start=-2, clip_end=10)
    points = places()
    origin, direction, near, far = rays(camera, points)
    assert to_camera(camera, direction, direction=True) == pytest.approx(np.broadcast_to((0, 0, -1), (50, 3)), abs=1e-6)
    local = to_camera(camera, origin)
    assert local[:, :2] == pytest.approx(on_window(camera, points), abs=2e-6)
    assert local[:, 2] == pytest.approx(0, abs=2e-6)
    assert (near, far) == (pytest.approx(-2), pytest.approx(10))


@pytest.mark.parametrize("orthographic", [False, True])
def test_all_rays_of_a_pixel_meet_on_the_focal_plane(orthographic):
    aperture = Aperture(radius=0.2, focus_distance=6, ratio=2)
    camera = Camera(
        transform=placed((1, 2, 3)),
        window=WINDOW,
        orthographic=orthographic,
        clip_start=1,
        clip_end=9,
        aperture=aperture,
    )
    u = chi2.uniforms(500, 2)
    point = np.array((37.5, 80.25))
    origin, direction, near, far = rays(camera, np.broadcast_to(point, (500, 2)), u)
    start, along = to_camera(camera, origin), to_camera(camera, direction, direction=True)

    def meeting_at(distance: float) -> np.ndarray:
        return start + ((-distance - start[:, 2]) / along[:, 2])[:, None] * along

    meeting = meeting_at(6)
    assert np.ptp(meeting, axis=0).max() < 5e-6
    assert np.ptp(meeting_at(6.001), axis=0).max() > 2e-5  # a little behind, they don't
    window = on_window(camera, point)
    assert meeting[0] == pytest.approx([*(window * (1 if orthographic else 6)), -6], abs=1e-5)
    lens = start[:, :2] - (window if orthographic else 0)
    assert np.abs(start[:, 2]).max() < 1e-6
    assert np.hypot(lens[:, 0] * 2, lens[:, 1]).max() == pytest.approx(0.2, rel=0.02)  # a ratio of 2 halves the width
    assert near * -along[:, 2] == pytest.approx(1, rel=1e-6)
    assert far * -along[:, 2] == pytest.approx(9, rel=1e-6)


def test_without_an_aperture_nothing_is_bent():
    camera = Camera(window=WINDOW)
    points = places()
    first = rays(camera, points, chi2.uniforms(50, 2, seed=1))
    second = rays(camera, points, chi2.uniforms(50, 2, seed=2))
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_matrices_are_multiplied_out_in_float64():
    """A long lens: neighbouring pixels differ by 1e-6 in direction, and still follow each other evenly."""
    camera = Camera(transform=placed(seed=5), window=(0.3, 0.3002, -0.2, -0.1999))
    _, direction, _, _ = rays(camera, [(0.5, 50), (WIDTH - 0.5, 50)])
    local = to_camera(camera, direction, direction=True)
    slope = local[:, 0] / -local[:, 2]
    assert slope[1] - slope[0] == pytest.approx(0.0002 * (WIDTH - 1) / WIDTH, abs=3e-7)


def test_single_precision():
    packed = pack_camera(Camera(aperture=Aperture(0.1, 5.0, 6)), WIDTH, HEIGHT)
    for orthographic in (0, 1):
        chi2.assert_single_precision(generate_ray, packed, orthographic, 1, f32(3), f32(4), f32(0.2), f32(0.3))
