"""Warps: continuous, and in single precision. Their densities: tests/statistics."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.jit import kernel
from engine.kernels.sampler import warp
from tests.statistics import chi2

DISK, UNIFORM = range(2)
f32 = np.float32


@kernel
def draw(kind, u, out):
    """Rows of `out` (n, 3) from rows of `u` (n, 2)."""
    for i in range(len(u)):
        x, y, z = f32(0), f32(0), f32(0)
        if kind == DISK:
            x, y = warp.concentric_disk(u[i, 0], u[i, 1])
        else:
            x, y, z = warp.uniform_hemisphere(u[i, 0], u[i, 1])
        out[i, 0], out[i, 1], out[i, 2] = x, y, z


SIDE = 256


def assert_continuous(out: np.ndarray) -> None:
    """out (SIDE^2, 3) of the points of a grid."""
    image = out.reshape(SIDE, SIDE, 3)
    for axis in (0, 1):
        assert np.linalg.norm(np.diff(image, axis=axis), axis=2).max() < 10 / SIDE


def test_warps_are_continuous():
    """Neighbours stay neighbours, so that well-spread numbers stay well-spread: no seam inside the square."""
    for kind in (DISK, UNIFORM):
        out = np.empty((SIDE * SIDE, 3), np.float32)
        draw(kind, chi2.grid(SIDE), out)
        assert_continuous(out)


def test_a_seam_is_caught():
    """The disk by polar coordinates, one half of it turned by 1 % of a half turn."""
    u1, u2 = chi2.grid(SIDE).astype(float).T
    phi = 2 * np.pi * u2 * np.where(u2 < 0.5, 1, 1.01)
    with pytest.raises(AssertionError):
        assert_continuous(np.stack([np.sqrt(u1) * np.cos(phi), np.sqrt(u1) * np.sin(phi), 0 * phi], axis=1))


def test_single_precision():
    u = f32(0.3)
    for function, count in [
        (warp.concentric_disk, 2),
        (warp.cosine_hemisphere, 2),
        (warp.cosine_hemisphere_pdf, 1),
        (warp.uniform_hemisphere, 2),
        (warp.uniform_hemisphere_pdf, 1),
        (warp.regular_polygon, 4),
    ]:
        chi2.assert_single_precision(function, *[u] * count)
    chi2.assert_single_precision(warp.rejection_hemisphere, np.uint32(1))
