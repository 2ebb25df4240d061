"""One statistical test for every sampler: are the samples distributed as the density says?

An adapter gives the points that were drawn, mapped to the unit square, and the density there; `assert_follows`
counts points in a grid of cells, integrates the density over each, and compares by Pearson's chi-squared test.
Where the maps below lead, a sampler's own formulas are not used: they are plain float64 geometry.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import stats

SIGNIFICANCE = 0.01
MIN_EXPECTED = 5


def p_value(counts: np.ndarray, expected: np.ndarray) -> float:
    """Of Pearson's test that `counts` come from `expected`, both of the same total; small cells are pooled."""
    counts, expected = np.ravel(counts).astype(float), np.ravel(expected).astype(float)
    order = np.argsort(expected)
    counts, expected = counts[order], expected[order]
    pooled = int(np.searchsorted(np.cumsum(expected), MIN_EXPECTED)) + 1
    pooled = max(pooled, int(np.searchsorted(expected, MIN_EXPECTED)))
    counts = np.append(counts[pooled:], counts[:pooled].sum())
    expected = np.append(expected[pooled:], expected[:pooled].sum())
    if expected[-1] < MIN_EXPECTED and counts[-1] > 10 * MIN_EXPECTED:
        return 0.0  # many samples where next to none may be
    statistic = np.sum((counts - expected) ** 2 / np.maximum(expected, 1e-9))
    return float(stats.chi2.sf(statistic, max(len(expected) - 1, 1)))


def threshold(tests: int) -> float:
    """Smallest p-value that passes when `tests` of them share the significance. Sidak 1967."""
    return 1 - (1 - SIGNIFICANCE) ** (1 / tests)


def cell_masses(density: Callable[[np.ndarray], np.ndarray], cells: tuple[int, int], inner: int) -> np.ndarray:
    """Integral over each cell of a density (n, 2) -> (n,) on the unit square, by inner x inner midpoints."""
    x, y = ((np.arange(c * inner) + 0.5) / (c * inner) for c in cells)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    values = np.asarray(density(points), np.float64)
    return values.reshape(cells[0], inner, cells[1], inner).mean(axis=(1, 3)) / (cells[0] * cells[1])


def fit_p_value(
    points: np.ndarray,
    drawn: int,
    density: Callable[[np.ndarray], np.ndarray],
    cells: tuple[int, int] = (16, 32),
    inner: int = 8,
) -> float:
    """p-value for points (n, 2) of the unit square, what is left of `drawn` samples after the failed ones.

    The failures are a cell of their own, which the density must leave room for: its integral is then right, too.
    """
    masses = cell_masses(density, cells, inner)
    total = masses.sum()
    assert total <= 1 + 2e-3, f"the density integrates to {total}"
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=cells, range=((0, 1), (0, 1)))
    failed = drawn - len(points)
    expected = np.append(masses.ravel(), max(1 - total, 0.0)) * drawn
    return p_value(np.append(counts.ravel(), failed), expected * (drawn / expected.sum()))


def assert_follows(points, drawn, density, *, tests: int = 1, **options) -> None:
    p = fit_p_value(points, drawn, density, **options)
    assert p > threshold(tests), f"chi-squared p-value {p:.3g}"


def frame(axis) -> np.ndarray:
    """(3, 3): rows x, y, z of an orthonormal frame with z along `axis`, float64."""
    z = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def sphere_to_square(directions: np.ndarray, axis=(0, 0, 1)) -> np.ndarray:
    """((1 + cos theta) / 2, phi / 2 pi) about the axis: equal areas, density 4 pi per steradian."""
    x, y, z = frame(axis) @ np.asarray(directions, np.float64).T
    return np.stack([np.clip((1 + z) / 2, 0, 1), np.arctan2(y, x) / (2 * np.pi) % 1], axis=1)


def square_to_sphere(points: np.ndarray, axis=(0, 0, 1)) -> np.ndarray:
    """The inverse, (n, 3)."""
    z = 2 * points[:, 0] - 1
    return _around(axis, np.sqrt(1 - z * z), z, 2 * np.pi * points[:, 1])


SPHERE_AREA = 4 * np.pi


def lobe_to_square(directions: np.ndarray, axis, exponent: float) -> np.ndarray:
    """(cos^(n+1) alpha, phi / 2 pi) about the axis, which spreads a lobe of any exponent; behind the axis: 0."""
    local = np.asarray(directions, np.float64) @ frame(axis).T
    drop = 0.5 * np.sum((local - (0, 0, 1)) ** 2, axis=1)
    with np.errstate(divide="ignore"):
        spread = np.exp((exponent + 1) * np.log1p(-np.minimum(drop, 1)))
    return np.stack([np.clip(spread, 0, 1), np.arctan2(local[:, 1], local[:, 0]) / (2 * np.pi) % 1], axis=1)


def square_to_lobe(points: np.ndarray, axis, exponent: float) -> tuple[np.ndarray, np.ndarray]:
    """The inverse: (directions (n, 3), steradians per unit of the square (n,))."""
    log_cos = np.log(points[:, 0]) / (exponent + 1)
    cosine, sine = np.exp(log_cos), np.sqrt(-np.expm1(2 * log_cos))
    area = 2 * np.pi / ((exponent + 1) * np.exp(exponent * log_cos))
    return _around(axis, sine, cosine, 2 * np.pi * points[:, 1]), area


def _around(axis, sine, cosine, phi) -> np.ndarray:
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], axis=1) @ frame(axis)


def uniforms(count: int, columns: int, seed: int = 1) -> np.ndarray:
    """(count, columns) float32 independent numbers in the open interval (0, 1)."""
    bits = np.random.default_rng(seed).integers(0, 1 << 23, (count, columns))
    return ((2 * bits + 1) * 2.0**-24).astype(np.float32)


def grid(side: int) -> np.ndarray:
    """(side^2, 2) float32: the midpoints of side x side cells of the unit square, for quadrature through a sampler."""
    x = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)


def vec(v) -> tuple:
    """A vector as kernels take it."""
    return tuple(np.float32(x) for x in v)


def assert_single_precision(function, *arguments) -> None:
    """A device function compiled for such arguments returns float32 and integers of 32 bits, nothing wider."""
    from numba import typeof

    types = tuple(typeof(a) for a in arguments)
    function.compile(types)
    result = function.overloads[types].signature.return_type
    assert "64" not in str(result), f"{function.__name__} returns {result}"
