"""One statistical test for everything that draws and has a density: are the draws distributed as the density says?

A `Case` draws points and knows the density anywhere; `chi_squared` counts the draws in a grid that fits the problem,
integrates the density over each cell by adaptive quadrature in float64, and compares by Pearson's test. Draws that
failed are a cell of their own, so that the density's integral is held to what it leaves for them. In the style of
Mitsuba's chi2.py (Jakob et al., src/python/python/chi2.py); adapters to the engine are in adapters.py.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy import stats

SIGNIFICANCE = 0.01
MIN_EXPECTED = 5
PILOTS = 4000
RINGS, OUTER_RINGS, SECTORS = 16, 5, 16
THIN, WIDE = 1e-3, 4.0  # the first ring beyond the draws; largest ratio of a ring's radii
PLANE_CELLS = 20
# Quadrature: of a cell, as a part of the mean cell; parts of a side that may still be split.
TOLERANCE, MAX_SPLITS, MAX_BOXES = 1e-3, 7, 4000

Density = Callable[[np.ndarray], np.ndarray]
Edges = tuple[np.ndarray, np.ndarray]


class Case(Protocol):
    """What the test needs of a sampler.

    `draw`     (points (n, dimensions) float64, valid (n,) bool) from a seed: n draws, those not valid have failed
    `density`  (n, dimensions) -> (n,) float64: per steradian for directions, per area of the plane for points of one
    `extent`   of a plane: a half side of the square that holds all draws; None for directions
    """

    name: str
    extent: float | None

    def draw(self, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]: ...

    def density(self, points: np.ndarray) -> np.ndarray: ...


class Grid(Protocol):
    """Cells (a, b) over the domain, each the image of a rectangle of a plane of parameters, areas preserved."""

    edges: Edges

    def points(self, parameters: np.ndarray) -> np.ndarray: ...

    def parameters(self, points: np.ndarray) -> np.ndarray: ...


@dataclass
class Sphere:
    """Directions as (1 - cos theta, phi) about an axis. A steradian is a unit of area."""

    axis: np.ndarray
    edges: Edges

    def points(self, parameters: np.ndarray) -> np.ndarray:
        drop, phi = parameters.T
        sine = np.sqrt(drop * np.maximum(2 - drop, 0))
        return np.stack([sine * np.cos(phi), sine * np.sin(phi), 1 - drop], axis=1) @ frame(self.axis)

    def parameters(self, points: np.ndarray) -> np.ndarray:
        local = points @ frame(self.axis).T
        drop = np.clip(0.5 * np.sum((local - (0, 0, 1)) ** 2, axis=1), 0, 2)  # no cancellation about the axis
        return np.stack([drop, np.arctan2(local[:, 1], local[:, 0]) % (2 * np.pi)], axis=1)

    @classmethod
    def fit(cls, pilots: np.ndarray, density: np.ndarray) -> Sphere:
        """The whole sphere about where the pilot draws (n, 3) are densest, in rings that hold equal shares of them.

        Rings that would be too wide are divided, as what lies far out may be a broad lobe about a narrow one; and
        right beyond the last draw they are thin, as what was drawn may end there.
        """
        mean = density @ pilots
        length = np.linalg.norm(mean)
        axis = mean / length if length > 1e-3 * density.sum() else np.array([0.0, 0, 1])
        drops = cls(axis, (np.zeros(0), np.zeros(0))).parameters(pilots)[:, 0]
        inner = np.quantile(drops, np.arange(1, RINGS + 1) / RINGS) if len(pilots) else np.linspace(0, 1, RINGS + 1)[1:]
        last = inner[-1]
        edges = [0, *inner, *(last * (1 + THIN * 4.0 ** np.arange(OUTER_RINGS)))]
        wide = [a * WIDE ** np.arange(1, np.ceil(np.log(b / a) / np.log(WIDE))) for a, b in pairwise([*edges[1:], 2])]
        edges = np.unique(np.concatenate([edges, *wide]))
        return cls(axis, (np.append(edges[edges < 2 - 1e-6], 2), np.linspace(0, 2 * np.pi, SECTORS + 1)))


@dataclass
class Plane:
    """Points of a square about the origin, as they are."""

    edges: Edges

    def points(self, parameters: np.ndarray) -> np.ndarray:
        return parameters

    def parameters(self, points: np.ndarray) -> np.ndarray:
        return points

    @classmethod
    def of(cls, extent: float) -> Plane:
        edge = np.linspace(-extent, extent, PLANE_CELLS + 1)
        return cls((edge, edge))


@dataclass
class Result:
    """`observed` and `expected` counts (a, b) in the cells of `edges`, and `failed` draws against those expected.
    `total` is the integral of the density."""

    name: str
    p_value: float
    observed: np.ndarray
    expected: np.ndarray
    failed: tuple[float, float]
    total: float
    edges: Edges


def chi_squared(case: Case, count: int = 100_000) -> Result:
    seed = zlib.crc32(case.name.encode())
    pilots, valid = case.draw(PILOTS, seed + 1000)
    if case.extent is not None:
        grid: Grid = Plane.of(case.extent)
    else:
        grid = Sphere.fit(pilots[valid], case.density(pilots[valid]))
    points, valid = case.draw(count, seed)
    parameters = grid.parameters(points[valid])
    observed, _, _ = np.histogram2d(parameters[:, 0], parameters[:, 1], bins=grid.edges)
    masses = integrate(lambda p: case.density(grid.points(p)), grid.edges, draws=parameters)
    total = float(masses.sum())
    failed = count - observed.sum()  # outside the plane counts as failed, too
    rest = max(1 - total, 0.0)
    p = p_value(np.append(observed, failed), count * np.append(masses, rest))
    if total > 1 + 2e-3:
        p = 0.0  # no density: no set of draws follows it
    return Result(case.name, p, observed, count * masses, (failed, count * rest), total, grid.edges)


def p_value(counts: np.ndarray, expected: np.ndarray) -> float:
    """Of Pearson's test that `counts` come from `expected`; cells that expect too few are pooled."""
    counts, expected = np.ravel(counts).astype(float), np.ravel(expected).astype(float)
    order = np.argsort(expected)
    counts, expected = counts[order], expected[order]
    pooled = int(np.searchsorted(np.cumsum(expected), MIN_EXPECTED)) + 1
    pooled = max(pooled, int(np.searchsorted(expected, MIN_EXPECTED)))
    few, expected_few = counts[:pooled].sum(), expected[:pooled].sum()
    counts, expected = counts[pooled:], expected[pooled:]
    if expected_few >= MIN_EXPECTED:
        counts, expected = np.append(counts, few), np.append(expected, expected_few)
    elif stats.poisson.sf(few - 1, expected_few + 1e-9) < 1e-9:
        return 0.0  # many draws where next to none may be
    statistic = np.sum((counts - expected) ** 2 / expected)
    return float(stats.chi2.sf(statistic, max(len(expected) - 1, 1)))


def threshold(tests: int) -> float:
    """Smallest p-value that passes when `tests` of them share the significance. Sidak 1967."""
    return 1 - (1 - SIGNIFICANCE) ** (1 / tests)


def assert_follows(case: Case, folder: Path, tests: int, count: int = 100_000) -> Result:
    result = chi_squared(case, count)
    if not result.p_value > threshold(tests):
        raise AssertionError(
            f"{case.name}: chi-squared p-value {result.p_value:.3g}, {threshold(tests):.3g} is wanted; the density "
            f"integrates to {result.total:.6f}, {result.failed[0]:.0f} draws of {count} failed. "
            f"Observed and expected: {plot(result, folder)}"
        )
    return result


def plot(result: Result, folder: Path) -> Path:
    """Observed, expected, and their difference in standard deviations; the picture's path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4), layout="constrained")
    deviation = (result.observed - result.expected) / np.sqrt(np.maximum(result.expected, 1))
    pictures = {"observed": result.observed, "expected": result.expected, "deviation / sigma": deviation}
    largest = max(result.observed.max(), result.expected.max())
    for axes, (title, values) in zip(figure.subplots(1, 3), pictures.items(), strict=True):
        limits = (-5, 5, "coolwarm") if title.startswith("dev") else (0, largest, "viridis")
        image = axes.imshow(values, vmin=limits[0], vmax=limits[1], cmap=limits[2], aspect="auto", origin="lower")
        axes.set(title=title, xlabel="cell of phi, or of y", ylabel="ring, or cell of x")
        figure.colorbar(image, ax=axes)
    figure.suptitle(f"{result.name}: p = {result.p_value:.3g}, failed {result.failed[0]:.0f} / {result.failed[1]:.0f}")
    path = folder / f"{''.join(c if c.isalnum() else '_' for c in result.name)}.png"
    figure.savefig(path)
    return path


# --- quadrature ----------------------------------------------------------------------------------------------------


def integrate(
    density: Density, edges: Edges, tolerance: float = TOLERANCE, draws: np.ndarray | None = None
) -> np.ndarray:
    """Integrals (a, b) of a density over the cells between `edges`.

    Gauss's rules of 3 x 3 and 5 x 5 points; a cell where they disagree is cut in four, over and over: what a jump in
    the density crosses is found to 2^-MAX_SPLITS of a side. The tolerance is of the mean cell's share of the whole.
    `draws` (n, 2), drawn by the density if all is right, show where both rules may have missed something narrow: there
    the cells are cut, too. That makes the integral better, and never moves it towards the draws.
    """
    x, y = (np.stack([e[:-1], e[1:]], axis=1) for e in edges)
    shape = len(x), len(y)
    owner = np.arange(shape[0] * shape[1])
    boxes = np.concatenate([x[owner // shape[1]], y[owner % shape[1]]], axis=1)  # x0, x1, y0, y1
    draws, at = _cells_of(np.zeros((0, 2)) if draws is None else draws, edges)
    count = max(len(draws), 1)
    masses = np.zeros(len(owner))
    for split in range(MAX_SPLITS + 1):
        coarse, fine = _gauss(density, boxes, 3), _gauss(density, boxes, 5)
        # Errors of parts have either sign: a part may be off by more than its share.
        excess = np.abs(coarse - fine) / (tolerance / masses.size * 2.0**-split)
        if len(draws):
            met = np.bincount(at, minlength=len(boxes))
            excess = np.maximum(excess, np.abs(met - count * fine) / (4 * np.sqrt(np.maximum(count * fine, 1))))
            excess[(met > 0) & (fine == 0)] = np.inf
        wrong = excess > 1
        if split == MAX_SPLITS:
            wrong[:] = False
        elif wrong.sum() > MAX_BOXES:
            wrong = excess >= np.partition(excess, -MAX_BOXES)[-MAX_BOXES]
        masses += np.bincount(owner[~wrong], fine[~wrong], minlength=masses.size)
        if not wrong.any():
            break
        draws, at = _follow(draws, at, boxes, wrong)
        boxes, owner = _quarters(boxes[wrong]), np.repeat(owner[wrong], 4)
    return masses.reshape(shape)


def _cells_of(draws: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """The draws inside the grid, and the cell of each."""
    i, j = (np.searchsorted(e, draws[:, k], side="right") - 1 for k, e in enumerate(edges))
    inside = (i >= 0) & (j >= 0) & (i < len(edges[0]) - 1) & (j < len(edges[1]) - 1)
    return draws[inside], (i * (len(edges[1]) - 1) + j)[inside]


def _follow(draws: np.ndarray, at: np.ndarray, boxes: np.ndarray, wrong: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The draws in the boxes that are cut, and the quarter of each, in the order of `_quarters`."""
    kept = wrong[at]
    draws, at = draws[kept], at[kept]
    x0, x1, y0, y1 = boxes[at].T
    quarter = 2 * (draws[:, 0] >= (x0 + x1) / 2) + (draws[:, 1] >= (y0 + y1) / 2)
    return draws, 4 * (np.cumsum(wrong) - 1)[at] + quarter


def _gauss(density: Density, boxes: np.ndarray, order: int) -> np.ndarray:
    nodes, weights = np.polynomial.legendre.leggauss(order)
    u, v = (a.ravel() for a in np.meshgrid((nodes + 1) / 2, (nodes + 1) / 2, indexing="ij"))
    width, height = boxes[:, 1] - boxes[:, 0], boxes[:, 3] - boxes[:, 2]
    points = np.stack([boxes[:, :1] + np.outer(width, u), boxes[:, 2:3] + np.outer(height, v)], axis=-1)
    values = np.asarray(density(points.reshape(-1, 2)), np.float64).reshape(len(boxes), -1)
    return values @ np.outer(weights, weights).ravel() / 4 * width * height


def _quarters(boxes: np.ndarray) -> np.ndarray:
    x0, x1, y0, y1 = boxes.T
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    parts = [(x0, x, y0, y), (x0, x, y, y1), (x, x1, y0, y), (x, x1, y, y1)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 4)


# --- helpers of all tests of kernels -------------------------------------------------------------------------------


def frame(axis) -> np.ndarray:
    """(3, 3): rows x, y, z of an orthonormal frame with z along `axis`, float64."""
    z = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def sphere_points(side: int) -> np.ndarray:
    """(side^2, 3) directions all over the sphere, each for the same solid angle."""
    u, v = grid(side).astype(float).T
    z = 2 * u - 1
    return np.stack([np.sqrt(1 - z * z) * np.cos(2 * np.pi * v), np.sqrt(1 - z * z) * np.sin(2 * np.pi * v), z], axis=1)


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
