"""Warps: continuous, and in single precision. Their densities: tests/statistics."""

from __future__ import annotations

import numpy as np

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


def test_warps_are_continuous():
    """Neighbours stay neighbours, so that well-spread numbers stay well-spread: no seam inside the square."""
    for kind in (DISK, UNIFORM):
        side = 256
        out = np.empty((side * side, 3), np.float32)
        draw(kind, chi2.grid(side), out)
        image = out.reshape(side, side, 3)
        for axis in (0, 1):
            assert np.linalg.norm(np.diff(image, axis=axis), axis=2).max() < 10 / side


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
