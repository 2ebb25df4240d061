"""What the tests of the light kernels share: the test of frequencies, solid angles in float64, and the check that no
float64 creeps into a kernel's results."""

from __future__ import annotations

import numba
import numpy as np

from tests.statistics import chi2


def assert_frequencies(observed: np.ndarray, expected: np.ndarray, tests: int = 1) -> None:
    """Chi-squared test of counts. `tests`: how many share the significance (Sidak)."""
    observed, expected = np.ravel(observed).astype(float), np.ravel(expected).astype(float)
    assert np.all(observed[expected == 0] == 0), "samples where the density is zero"
    p_value = chi2.p_value(observed, expected * observed.sum() / expected.sum())
    assert p_value > chi2.threshold(tests), f"chi-squared p-value {p_value}"


def triangle_solid_angles(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Steradians of triangles with vertices (..., 3) as seen from p, float64. Van Oosterom & Strackee 1983."""
    a, b, c = (np.asarray(v, np.float64) - np.asarray(p, np.float64) for v in (a, b, c))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    volume = np.abs(np.sum(a * np.cross(b - a, c - a), axis=-1))
    real = la * lb * lc + np.sum(a * b, -1) * lc + np.sum(a * c, -1) * lb + np.sum(b * c, -1) * la
    return 2 * np.arctan2(volume, real)


def mean_direction_of_polygon(p: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Integral of the unit direction over the solid angle of a polygon (K, 3) as seen from p: Lambert's formula."""
    directions = np.asarray(vertices, np.float64) - np.asarray(p, np.float64)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    total = np.zeros(3)
    for a, b in zip(directions, np.roll(directions, -1, axis=0), strict=True):
        axis = np.cross(a, b)
        sine = np.linalg.norm(axis)
        if sine > 0:
            total += 0.5 * np.arctan2(sine, a @ b) * axis / sine
    middle = directions.mean(axis=0)
    return total if total @ middle >= 0 else -total


def assert_float32(function, *arguments) -> None:
    """`function`, from `from_python`, returns float32 and integers for these arguments, nothing wider."""
    function(*arguments)
    for signature in function.nopython_signatures:
        assert "float64" not in str(signature.return_type), str(signature)


def vec(v) -> tuple:
    """A vector as kernels take it."""
    return tuple(np.float32(x) for x in v)


def from_python(function):
    """A kernel's `device` function, callable from Python. It is compiled anew in each run: for tests only."""
    return numba.njit(lambda *arguments: function(*arguments))
