"""One statistical test for everything that draws and has a density: are the draws distributed as the density says?

A `Case` draws points and knows the density anywhere; `chi_squared` counts the draws in a grid that fits the problem,
integrates the density over each cell by adaptive quadrature in float64, and compares by Pearson's test. Draws that
failed are a cell of their own, so that the density's integral is held to what it leaves for them. In the style of
Mitsuba's chi2.py (Jakob et al., src/python/python/chi2.py); adapters to the engine are in adapters.py.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from scipy import stats

from engine.kernels.jit import kernel

SIGNIFICANCE = 0.01
MIN_EXPECTED = 5
PILOTS = 4000
RINGS, OUTER_RINGS, SECTORS = 16, 5, 16
THIN, WIDE = 1e-3, 4.0  # the first ring beyond the draws; largest ratio of a ring's radii
CORE = 0.005  # share of the draws that the innermost ring may hold
PLANE_CELLS = 20
CHUNK = 500_000  # draws at a time
GUIDED = 4.0  # standard deviations by which draws differ where the quadrature has to look again
# The density's integral and the share of failed draws have to make 1, but for so many standard deviations of the
# share, and for what quadrature and float32 leave.
MASS_SIGMAS, MASS_SLACK = 4.0, 2e-4


class Effort(NamedTuple):
    """Of the quadrature.

    tolerance    of a cell, as a part of the mean cell
    halved       how often every side is halved, whatever the rules say: a narrow lobe may pass between the points
    splits       how often it may be; rims: where the density begins
    boxes        that are split at a time, at most
    guides       draws that show where to look, at most
    """

    tolerance: float
    halved: int
    splits: int
    rims: int
    boxes: int
    guides: int


QUICK, THOROUGH = Effort(4e-4, 0, 9, 4, 3000, 100_000), Effort(1e-4, 2, 12, 7, 20_000, 10_000_000)
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
        out = np.empty((len(points), 2))
        _about_axis(np.ascontiguousarray(points, np.float64), frame(self.axis), out)
        return out

    @classmethod
    def fit(cls, pilots: np.ndarray, density: np.ndarray) -> Sphere:
        """The whole sphere about where the pilot draws (n, 3) are densest, in rings that hold equal shares of them.

        Rings that would be too wide are divided, as what lies far out may be a broad lobe about a narrow one, and so
        is the first; right beyond the last draw they are thin, as what was drawn may end there.
        """
        mean = density @ pilots
        length = np.linalg.norm(mean)
        axis = mean / length if length > 1e-3 * density.sum() else np.array([0.0, 0, 1])
        drops, phi = cls(axis, (np.zeros(0), np.zeros(0))).parameters(pilots).T
        inner = np.quantile(drops, np.arange(1, RINGS + 1) / RINGS) if len(pilots) else np.linspace(0, 1, RINGS + 1)[1:]
        first, last = (np.quantile(drops, CORE) if len(pilots) else 1.0), inner[-1]
        steps = np.arange(1, np.log(inner[0] / first) / np.log(WIDE)) if first > 0 else np.zeros(0)
        edges = [0, *(inner[0] / WIDE**steps), *inner, *(last * (1 + THIN * 4.0 ** np.arange(OUTER_RINGS)))]
        wide = [a * WIDE ** np.arange(1, np.ceil(np.log(b / a) / np.log(WIDE))) for a, b in pairwise([*inner, 2])]
        edges = np.unique(np.concatenate([edges, *wide]))
        sectors = np.linspace(0, 2 * np.pi, 5)
        if len(pilots):  # the same shares of a strip, which lies along two of them
            sectors = np.unique([*sectors, *np.quantile(phi, np.arange(1, SECTORS) / SECTORS)])
        return cls(axis, (np.append(edges[edges < 2 - 1e-6], 2), sectors))


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


@kernel
def _about_axis(points, axes, out):
    """(1 - cos theta, phi) of directions; without cancellation about the axis."""
    for i in range(len(points)):
        x, y, z = points[i]
        a = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
        b = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
        c = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z - 1.0
        phi = math.atan2(b, a)
        out[i, 0] = min(0.5 * (a * a + b * b + c * c), 2.0)
        out[i, 1] = phi if phi >= 0.0 else min(phi + 2.0 * math.pi, 2.0 * math.pi)


@kernel
def _count(parameters, edges_a, edges_b, counts):
    """Add to the cells (a, b); what lies outside of all is left out."""
    for i in range(len(parameters)):
        a = np.searchsorted(edges_a, parameters[i, 0], side="right") - 1
        b = np.searchsorted(edges_b, parameters[i, 1], side="right") - 1
        # The last edges belong to the last cells.
        a -= a == len(edges_a) - 1 and parameters[i, 0] == edges_a[-1]
        b -= b == len(edges_b) - 1 and parameters[i, 1] == edges_b[-1]
        if 0 <= a < len(edges_a) - 1 and 0 <= b < len(edges_b) - 1:
            counts[a, b] += 1


@dataclass
class Result:
    """`observed` and `expected` counts (a, b) in the cells of `edges`, and `failed` draws against those expected.
    `total` is the integral of the density, `count` the number of draws."""

    name: str
    p_value: float
    observed: np.ndarray
    expected: np.ndarray
    failed: tuple[float, float]
    total: float
    count: int
    edges: Edges

    @property
    def excess(self) -> float:
        """Of the density's integral over the share of draws that it stands for."""
        return self.total + self.failed[0] / self.count - 1

    @property
    def excess_allowed(self) -> float:
        share = self.failed[0] / self.count
        return MASS_SIGMAS * float(np.sqrt(share * (1 - share) / self.count)) + MASS_SLACK

    def passes(self, tests: int) -> bool:
        return self.p_value > threshold(tests) and abs(self.excess) < self.excess_allowed


def chi_squared(case: Case, count: int = 100_000, effort: Effort = QUICK) -> Result:
    seed = zlib.crc32(case.name.encode())
    pilots, valid = case.draw(PILOTS, seed + 1000)
    if case.extent is not None:
        grid: Grid = Plane.of(case.extent)
    else:
        grid = Sphere.fit(pilots[valid], case.density(pilots[valid]))
    observed, guides = np.zeros([len(e) - 1 for e in grid.edges], np.int64), []
    for i, first in enumerate(range(0, count, CHUNK)):
        points, valid = case.draw(min(CHUNK, count - first), seed + 7919 * i)
        parameters = np.ascontiguousarray(grid.parameters(points[valid]))
        _count(parameters, *grid.edges, observed)
        guides.append(parameters[: max(effort.guides - i * CHUNK, 0)])
    masses = integrate(lambda p: case.density(grid.points(p)), grid.edges, draws=np.concatenate(guides), effort=effort)
    total = float(masses.sum())
    failed = float(count - observed.sum())  # outside the plane counts as failed, too
    rest = max(1 - total, 0.0)
    p = p_value(np.append(observed, failed), count * np.append(masses, rest))
    return Result(case.name, p, observed, count * masses, (failed, count * rest), total, count, grid.edges)


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
    if not result.passes(tests):
        raise AssertionError(
            f"{case.name}: chi-squared p-value {result.p_value:.3g}, {threshold(tests):.3g} is wanted; the density "
            f"integrates to {result.total:.6f}, {result.failed[0]:.0f} draws of {count} failed: together too much by "
            f"{result.excess:.6f}, {result.excess_allowed:.6f} is allowed. "
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
    density: Density,
    edges: Edges,
    tolerance: float | None = None,
    draws: np.ndarray | None = None,
    effort: Effort = QUICK,
) -> np.ndarray:
    """Integrals (a, b) of a density over the cells between `edges`.

    Gauss's rules of 3 x 3 and 5 x 5 points; a cell where they disagree is cut in four, over and over: what a jump in
    the density crosses is found to 2^-splits of a side. So is one where there is something at some of the points or
    corners and nothing at others, down to 2^-rims. The tolerance is of the mean cell's share of the whole.
    `draws` (n, 2), drawn by the density if all is right, show where both rules may have missed something narrow: there
    the cells are cut, too. That makes the integral better, and never moves it towards the draws.
    """
    x, y = (np.stack([e[:-1], e[1:]], axis=1) for e in edges)
    shape = len(x), len(y)
    owner = np.arange(shape[0] * shape[1])
    boxes = np.concatenate([x[owner // shape[1]], y[owner % shape[1]]], axis=1)  # x0, x1, y0, y1
    draws, at = _cells_of(np.zeros((0, 2)) if draws is None else draws, edges)
    count = max(len(draws), 1)
    masses, tolerance = np.zeros(len(owner)), tolerance or effort.tolerance
    for split in range(effort.splits + 1):
        (coarse, some, every), (fine, _, _) = _gauss(density, boxes, 3), _gauss(density, boxes, 5)
        # Errors of parts have either sign: a part may be off by more than its share.
        excess = np.abs(coarse - fine) / (tolerance / masses.size * 2.0**-split)
        if len(draws):
            met = np.bincount(at, minlength=len(boxes))
            excess = np.maximum(excess, np.abs(met - count * fine) / (GUIDED * np.sqrt(np.maximum(count * fine, 1))))
            excess[(met > 0) & (fine == 0)] = np.inf
        if split < effort.rims:
            excess[some & ~every] = np.inf
        wrong = (excess > 1) | (split < effort.halved)
        if split == effort.splits:
            wrong[:] = False
        elif wrong.sum() > effort.boxes:
            wrong = excess >= np.partition(excess, -effort.boxes)[-effort.boxes]
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


def _gauss(density: Density, boxes: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The integral over each box, and whether the density is above 0 at some of the points and corners, and at all."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    places, weights = np.array([*(nodes + 1) / 2, 0, 1]), np.array([*weights, 0, 0])
    u, v = (a.ravel() for a in np.meshgrid(places, places, indexing="ij"))
    both = np.outer(weights, weights).ravel()
    used = (both > 0) | ((u % 1 == 0) & (v % 1 == 0))
    width, height = boxes[:, 1] - boxes[:, 0], boxes[:, 3] - boxes[:, 2]
    points = np.stack([boxes[:, :1] + np.outer(width, u[used]), boxes[:, 2:3] + np.outer(height, v[used])], axis=-1)
    values = np.asarray(density(points.reshape(-1, 2)), np.float64).reshape(len(boxes), -1)
    return values @ both[used] / 4 * width * height, (values > 0).any(axis=1), (values > 0).all(axis=1)


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
