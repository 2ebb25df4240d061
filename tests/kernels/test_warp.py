"""Warps: each drawn as its density says, and the rejection sampler's number of draws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.kernels.jit import kernel
from engine.kernels.sampler import warp
from tests.kernels import chi2

COUNT = 200_000
DISK, COSINE, UNIFORM, POLYGON, REJECTION = range(5)
f32 = np.float32


@kernel
def draw(kind, parameter, u, out):
    """Rows of `out` (n, 3) from rows of `u` (n, 2); returns the draws that rejection needed."""
    state, draws = np.uint32(12345), 0
    for i in range(len(u)):
        u1, u2 = u[i, 0], u[i, 1]
        x, y, z = f32(0), f32(0), f32(0)
        if kind == DISK:
            x, y = warp.concentric_disk(u1, u2)
        elif kind == COSINE:
            x, y, z = warp.cosine_hemisphere(u1, u2)
        elif kind == UNIFORM:
            x, y, z = warp.uniform_hemisphere(u1, u2)
        elif kind == POLYGON:
            x, y = warp.regular_polygon(parameter, f32(0.3), u1, u2)
        else:
            (x, y, z), state, needed = warp.rejection_hemisphere(state)
            draws += needed
        out[i, 0], out[i, 1], out[i, 2] = x, y, z
    return draws


@kernel
def densities(kind, z, out):
    for i in range(len(z)):
        if kind == COSINE:
            out[i] = warp.cosine_hemisphere_pdf(z[i])
        else:
            out[i] = warp.uniform_hemisphere_pdf(z[i])


def samples(kind: int, parameter: float = 0.0, count: int = COUNT) -> tuple[np.ndarray, int]:
    out = np.empty((count, 3), np.float32)
    draws = draw(kind, f32(parameter), chi2.uniforms(count, 2, seed=kind + 1), out)
    return out, draws


def density(kind: int, z: np.ndarray) -> np.ndarray:
    out = np.empty(len(z), np.float32)
    densities(kind, np.ascontiguousarray(z, np.float32), out)
    return out


@pytest.mark.parametrize("kind", [COSINE, UNIFORM, REJECTION])
def test_directions_follow_their_density(kind):
    directions, _ = samples(kind)
    assert np.abs(np.linalg.norm(directions.astype(np.float64), axis=1) - 1).max() < 3e-7
    chi2.assert_follows(
        chi2.sphere_to_square(directions),
        COUNT,
        lambda p: density(kind, chi2.square_to_sphere(p)[:, 2]) * chi2.SPHERE_AREA,
        tests=3,
    )


@pytest.mark.parametrize("kind, blades", [(DISK, 0), (POLYGON, 3), (POLYGON, 5), (POLYGON, 8)])
def test_shapes_are_filled_evenly(kind, blades):
    points, _ = samples(kind, blades)

    def area_density(p):
        x, y = 2 * p.T - 1
        if kind == DISK:
            inside = x * x + y * y < 1
        else:  # inside every side's half plane
            middles = 0.3 + (np.arange(blades)[:, None] + 0.5) * 2 * np.pi / blades
            inside = np.all(np.cos(middles) * x + np.sin(middles) * y < math.cos(np.pi / blades), axis=0)
        area = np.pi if kind == DISK else blades * math.sin(2 * np.pi / blades) / 2
        return np.where(inside, 4 / area, 0)

    square = (points[:, :2].astype(np.float64) + 1) / 2
    chi2.assert_follows(square, COUNT, area_density, tests=4, cells=(20, 20), inner=40)


def test_rejection_needs_12_over_pi_draws():
    _, draws = samples(REJECTION)
    accepted = math.pi / 12
    deviation = math.sqrt((1 - accepted) / accepted**2 / COUNT)
    assert abs(draws / COUNT - 12 / math.pi) < 2.58 * deviation


def test_warps_are_continuous():
    """Neighbours stay neighbours, so that well-spread numbers stay well-spread: no seam inside the square."""
    for kind in (DISK, UNIFORM):
        side = 256
        out = np.empty((side * side, 3), np.float32)
        draw(kind, f32(0), chi2.grid(side), out)
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
