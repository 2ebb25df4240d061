"""Vectors, frames and the elementary functions against float64."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.geom import elementary, frame, vec
from engine.kernels.jit import kernel
from tests.statistics import chi2

f32 = np.float32


@kernel
def frames(normals, out):
    """Rows x, y of the frame of each normal, and a vector taken to the world."""
    for i in range(len(normals)):
        n = (normals[i, 0], normals[i, 1], normals[i, 2])
        x, y = frame.basis(n)
        v = (f32(0.1), f32(-0.7), f32(0.5))
        w = frame.to_world(v, n)
        for k in range(3):
            out[i, 0, k], out[i, 1, k], out[i, 2, k] = x[k], y[k], w[k]


def assert_frames(normals: np.ndarray, out: np.ndarray) -> None:
    assert np.isfinite(out).all()
    rows = np.concatenate([out[:, :2], normals[:, None]], axis=1).astype(np.float64)
    assert np.abs(rows @ rows.transpose(0, 2, 1) - np.eye(3)).max() < 1e-6
    assert np.linalg.det(rows).min() > 0.999
    v = np.array([0.1, -0.7, 0.5])
    assert np.abs(out[:, 2] - np.einsum("nij,i->nj", rows, v)).max() < 1e-6


def test_frames_are_orthonormal_and_right_handed_everywhere():
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(20_000, 3))
    normals[:5000, :2] *= 1e-4  # about the poles
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    special = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (1e-20, 0, -1), (0, 1e-7, -1), (1, 0, -0.0)]
    normals = np.concatenate([normals, special]).astype(np.float32)
    out = np.empty((len(normals), 3, 3), np.float32)
    frames(normals, out)
    assert_frames(normals, out)
    for wrong in (out[:, [1, 0, 2]], out * (1, -1, 1), out * (1 + 2e-6)):  # left-handed, mirrored, too long
        with pytest.raises(AssertionError):
            assert_frames(normals, wrong)


@kernel
def elementary_values(x, u, angle, out):
    for i in range(len(x)):
        out[i, 0] = elementary.log_one_minus(x[i])
        out[i, 1] = elementary.one_minus_exp(-angle[i])
        out[i, 2], out[i, 3] = elementary.sin_cos_turn(u[i])


def errors(out: np.ndarray, x: np.ndarray, t: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(4,) the largest of each function: relative of the first two."""
    x, t, u = (a.astype(np.float64) for a in (x, t, u))
    exact = np.stack([np.log1p(-x), -np.expm1(-t), np.sin(2 * np.pi * u), np.cos(2 * np.pi * u)], axis=1)
    scale = np.where([True, True, False, False], np.abs(exact), 1)
    return (np.abs(out - exact) / scale).max(axis=0)


def test_elementary_functions():
    rng = np.random.default_rng(5)
    count = 100_000
    x = np.where(rng.random(count) < 0.5, rng.random(count), 10.0 ** rng.uniform(-12, 0, count)).astype(np.float32)
    x = np.minimum(x, f32(1 - 2**-24))
    t = (10.0 ** rng.uniform(-12, 2, count)).astype(np.float32)
    u = np.concatenate([rng.random(count - 5), [0, 0.25, 0.5, 0.75, 1]]).astype(np.float32)
    out = np.empty((count, 4), np.float32)
    elementary_values(x, u, t, out)
    assert errors(out, x, t, u).max() < 3e-7
    # As they are written first: float32 cancels in 1 - x and 1 - exp(-t), and rounds the angle of a turn.
    with np.errstate(divide="ignore"):
        plain = [np.log(f32(1) - x), f32(1) - np.exp(-t), np.sin(f32(2 * np.pi) * u), np.cos(f32(2 * np.pi) * u)]
    assert errors(np.stack(plain, axis=1), x, t, u).min() > 3e-7


@kernel
def vector_values(a, b):
    return (
        vec.add(a, b),
        vec.sub(a, b),
        vec.mul(a, b),
        vec.scale(a, b[0]),
        vec.add_scaled(a, b, a[1]),
        vec.negate(a),
        vec.cross(a, b),
        vec.normalize(a),
        vec.reflect(a, vec.normalize(b)),
    )


def test_vectors():
    a, b = np.array([0.2, -1.5, 3.0]), np.array([-0.7, 0.1, 0.4])
    n = b / np.linalg.norm(b)
    expected = [a + b, a - b, a * b, a * b[0], a + b * a[1], -a, np.cross(a, b), a / np.linalg.norm(a)]
    expected += [2 * (a @ n) * n - a]
    for result, wanted in zip(vector_values(chi2.vec(a), chi2.vec(b)), expected, strict=True):
        assert result == pytest.approx(wanted, rel=1e-6)


@kernel
def scalar_values(a):
    unit, distance = vec.direction_and_length(a)
    return (
        vec.length(a),
        distance,
        unit[0],
        vec.average(a),
        vec.max_component(a),
        vec.normalize(a)[0],
    )


def test_scalars_of_vectors():
    a = np.array([2.0, 3.0, 6.0])
    assert scalar_values(chi2.vec(a)) == pytest.approx([7, 7, 2 / 7, 11 / 3, 6, 2 / 7], rel=1e-6)
    assert scalar_values(chi2.vec((0, 0, 0))) == (0,) * 6


def test_single_precision():
    v, s = chi2.vec((0.6, 0, 0.8)), f32(0.5)
    for function in (vec.normalize, vec.direction_and_length, vec.length, vec.average, frame.basis):
        chi2.assert_single_precision(function, v)
    for function in (vec.add, vec.dot, vec.cross, vec.reflect, frame.to_world):
        chi2.assert_single_precision(function, v, v)
    for function in (elementary.log_one_minus, elementary.one_minus_exp, elementary.sin_cos_turn):
        chi2.assert_single_precision(function, s)
