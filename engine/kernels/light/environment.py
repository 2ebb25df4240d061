"""The equirectangular environment image: radiance by direction, and directions by importance.

Directions are in environment space (see `engine.scene.World`); the caller rotates, and multiplies by the world's
colour. `build_environment` makes the table once per scene; `engine/pack` calls it.

A direction is drawn with a density proportional to the bilinear interpolation of luminance x sin(theta) at the
texel centres, so the density is positive wherever the radiance is, and radiance / density stays nearly constant
even about a single hot pixel. The cells are those of the interpolation: between texel centres, wrapping around in
u, with half cells below the first row and above the last. A cell is chosen by inverting cumulative sums (a guide
table narrows the search), then the point in it in closed form, so that stratification survives.

Precision: float32 tables. A cell whose share of its row is below 6e-8 may be lost to rounding: so may as much of
the image's power.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..geom.elementary import sin_cos_turn
from ..geom.vec import (
    BLACK,
    BLUE,
    GREEN,
    HALF,
    INV_PI,
    INV_TWO_PI,
    LAST_BELOW_ONE,
    LUMINANCE,
    ONE,
    RED,
    SMALL,
    TINY,
    TWO,
    ZERO,
)
from ..jit import device
from ..simd import any_of, at, float32, floor, int32, select, words_at
from .spherical import atan2_upper

DARKEST = 1e-36  # mean radiance


class EnvironmentTable(NamedTuple):
    """H rows and W columns of texels; H + 1 rows of cells, row r between the texel rows r - 1 and r.

    image          (H, W, 3) float32, W/(m2 sr), row 0 looks straight down
    sines          (H + 2,) float32, sin(theta) of the texel rows, with 0 for both poles around them
    row_cdf        (1, H + 2) float32, cumulative shares of the rows of cells
    row_guide      (1, G + 1) int32, the row that holds the share k / G
    column_cdf     (H + 1, W + 1) float32, cumulative shares within each row
    column_guide   (H + 1, K + 1) int32, the column that holds the share k / K
    scale          (1,) float32: density = scale x interpolated (luminance x sin) / sin(theta); 0: all black
    """

    image: np.ndarray
    sines: np.ndarray
    row_cdf: np.ndarray
    row_guide: np.ndarray
    column_cdf: np.ndarray
    column_guide: np.ndarray
    scale: np.ndarray


# --- building ------------------------------------------------------------------------------------------------------


def build_environment(image: np.ndarray) -> EnvironmentTable:
    """image : (H, W, 3) float32, finite. Negative values count as black for the density."""
    image = np.ascontiguousarray(image, np.float32)
    height, width, _ = image.shape
    sines = np.zeros(height + 2)
    sines[1:-1] = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    # float32 here halves the memory of a large image; the sums below are float64.
    padded = np.zeros((height + 2, width), np.float32)  # weight at the lower and upper edge of each row of cells
    np.matmul(np.maximum(image, 0), LUMINANCE.astype(np.float32), out=padded[1:-1])
    padded *= sines[:, None].astype(np.float32)
    cells = padded[:-1] + padded[1:]
    cells += np.roll(cells, -1, axis=1)
    cells *= np.float32(0.25)  # mean of the four corners
    cells[[0, -1]] *= np.float32(0.5)  # half as high
    rows = cells.sum(axis=1, dtype=np.float64)
    total = rows.sum()
    # Density in (u, v) is weight / mean weight; a cell's area is 1 / (W H); d(omega) = 2 pi^2 sin(theta) du dv.
    # Of an image that is all but black the density does not fit float32: rays alone find its light.
    scale = width * height / (total * 2 * np.pi**2) if total > DARKEST * width * height else 0.0
    row_cdf = _cumulative(rows[None])
    column_cdf = _cumulative(cells)
    return EnvironmentTable(
        image=image,
        sines=sines.astype(np.float32),
        row_cdf=row_cdf,
        row_guide=_guide(row_cdf),
        column_cdf=column_cdf,
        column_guide=_guide(column_cdf),
        scale=np.array([scale], np.float32),
    )


def _cumulative(weights: np.ndarray) -> np.ndarray:
    """(N, M) -> (N, M + 1) float32 from 0 to 1. Rows without weight are 0 but for the last entry."""
    cdf = np.zeros((weights.shape[0], weights.shape[1] + 1), np.float32)
    for row, out in zip(weights, cdf, strict=True):  # row by row: no float64 copy of a large image
        sums = np.cumsum(row, dtype=np.float64)
        if sums[-1] > 0:
            out[1:] = sums / sums[-1]
        out[-1] = 1
    return cdf


def _guide(cdf: np.ndarray) -> np.ndarray:
    """(N, K + 1): the last index whose cumulative share is at most k / K. K is a power of two, so that u K is exact
    in float32."""
    size = 1 << max(int(math.log2(cdf.shape[1] - 1)) - 1, 0)
    shares = (np.arange(size + 1) / size).astype(np.float32)
    guide = np.stack([np.searchsorted(row, shares, side="right") - 1 for row in cdf])
    return np.minimum(guide, cdf.shape[1] - 2).astype(np.int32)


def environment_irradiance(table: EnvironmentTable) -> np.ndarray:
    """(4,) float64, W/m2 of luminance: a plane with the normal n receives about [0] + [1:4] . n. These are the first
    two bands of spherical harmonics: Ramamoorthi & Hanrahan 2001, "An Efficient Representation for Irradiance
    Environment Maps", equation 6 (pi and 2 pi / 3)."""
    if table.scale[0] == 0:
        return np.zeros(4)
    height, width = table.image.shape[:2]
    v = np.arange(height + 1) / height
    v[0], v[-1] = 0.25 / height, 1 - 0.25 / height  # the middles of the half cells
    theta, phi = np.pi * v, 2 * np.pi * (np.arange(width) + 1) / width
    circle = np.column_stack([-np.cos(phi), np.sin(phi)]).astype(np.float32)
    across = table.column_cdf[:, 1:] @ circle - table.column_cdf[:, :-1] @ circle  # (H + 1, 2), mean of each row
    share = np.diff(table.row_cdf[0].astype(np.float64))
    mean = np.array([*((share * np.sin(theta)) @ across), share @ -np.cos(theta)])
    power = 1 / float(table.scale[0])
    return power * np.array([0.25, *(0.5 * mean)])


# --- looking up ----------------------------------------------------------------------------------------------------


@device
def _locate(table, d):
    """(row of cells, column, fractions in u and v, sin(theta)) of a unit direction."""
    height, width = table.image.shape[0], table.image.shape[1]
    sine = math.sqrt(d[0] * d[0] + d[1] * d[1])
    y = atan2_upper(sine, -d[2]) * INV_PI * np.float32(height)
    row = min(int32(y + HALF), np.int32(height))
    low = max(float32(row) - HALF, ZERO)
    v = (y - low) * select((row == np.int32(0)) | (row == np.int32(height)), TWO, ONE)
    around = atan2_upper(abs(d[1]), d[0]) * INV_TWO_PI
    u = HALF - select(d[1] >= ZERO, around, -around)
    x = u * np.float32(width) - HALF
    left = floor(x)
    column = int32(left)
    column = min(select(column < np.int32(0), int32(column + np.int32(width)), column), np.int32(width - 1))
    return row, column, x - left, min(max(v, ZERO), ONE), sine


@device
def _luminance(c):
    return max(c[0], ZERO) * RED + max(c[1], ZERO) * GREEN + max(c[2], ZERO) * BLUE


@device
def _texel(table, row, column):
    return at(table.image, row, column, 0), at(table.image, row, column, 1), at(table.image, row, column, 2)


@device
def _corners(table, row, column):
    """The texels about a cell: lower left, lower right, upper left, upper right."""
    height, width = table.image.shape[0], table.image.shape[1]
    low, high = max(int32(row - np.int32(1)), np.int32(0)), min(row, np.int32(height - 1))
    # Of two texels side by side that the image goes on behind, all is one load.
    if width > 2 and not any_of(column > np.int32(width - 3)):
        c00, c01 = _two_texels(table, low, column)
        c10, c11 = _two_texels(table, high, column)
        return c00, c01, c10, c11
    right = int32(column + np.int32(1))
    right = select(right < np.int32(width), right, np.int32(0))
    return (
        _texel(table, low, column),
        _texel(table, low, right),
        _texel(table, high, column),
        _texel(table, high, right),
    )


@device
def _two_texels(table, row, column):
    """The texel there and its right neighbour."""
    first = int32((row * np.int32(table.image.shape[1]) + column) * np.int32(3))
    words = words_at(table.image, first, 8)
    return (words[0], words[1], words[2]), (words[3], words[4], words[5])


@device
def _mix(a, b, t):
    return a + (b - a) * t


@device
def _mix_color(c00, c01, c10, c11, u, v):
    w00, w01, w10, w11 = (ONE - u) * (ONE - v), u * (ONE - v), (ONE - u) * v, u * v
    return (
        w00 * c00[0] + w01 * c01[0] + w10 * c10[0] + w11 * c11[0],
        w00 * c00[1] + w01 * c01[1] + w10 * c10[1] + w11 * c11[1],
        w00 * c00[2] + w01 * c01[2] + w10 * c10[2] + w11 * c11[2],
    )


@device
def environment_lookup(table, d):
    """(radiance, pdf per steradian) for the unit direction d."""
    row, column, u, v, sine = _locate(table, d)
    c00, c01, c10, c11 = _corners(table, row, column)
    low = at(table.sines, row) * _mix(_luminance(c00), _luminance(c01), u)
    high = at(table.sines, row + np.int32(1)) * _mix(_luminance(c10), _luminance(c11), u)
    pdf = table.scale[0] * _mix(low, high, v) / max(sine, SMALL)
    return _mix_color(c00, c01, c10, c11, u, v), pdf


# --- sampling ------------------------------------------------------------------------------------------------------


@device
def _invert(cdf, guide, row, u):
    """(index, u within the cell in [0, 1)): cdf[row, index] <= u < cdf[row, index + 1]."""
    k = int32(u * np.float32(guide.shape[1] - 1))
    low, high = words_at(guide, int32(row * np.int32(guide.shape[1])) + k, 2)
    while any_of(low < high):
        middle = int32(int32(low + high + np.int32(1)) >> np.int32(1))
        above = at(cdf, row, middle) <= u
        low, high = select(above, middle, low), select(above, high, int32(middle - np.int32(1)))
    start, end = words_at(cdf, int32(row * np.int32(cdf.shape[1])) + low, 2)
    return low, min((u - start) / max(end - start, SMALL), LAST_BELOW_ONE)


@device
def _sample_linear(a, b, u):
    """x in [0, 1] with density proportional to a (1 - x) + b x. Pharr et al. 2023, PBR 4e, section 2.3.2."""
    total = a + b
    uniform = (a == b) | (total < TINY)  # the reciprocal of less is infinite; nobody sees how so little is spread
    c, d = a / total, b / total  # shares, as the squares of an image's values may leave float32
    return select(uniform, u, u / max(c + math.sqrt(_mix(c * c, d * d, u)), SMALL))


@device
def sample_environment(table, u1, u2):
    """(d, radiance, pdf): a unit direction, its radiance and the density per steradian. u1, u2 in [0, 1).

    pdf == 0: the image is black.
    """
    if table.scale[0] == ZERO:
        return (ZERO, ZERO, ONE), BLACK, ZERO
    height, width = table.image.shape[0], table.image.shape[1]
    row, u1 = _invert(table.row_cdf, table.row_guide, np.int32(0), u1)
    column, u2 = _invert(table.column_cdf, table.column_guide, row, u2)
    c00, c01, c10, c11 = _corners(table, row, column)
    sine_low, sine_high = at(table.sines, row), at(table.sines, row + np.int32(1))
    w00, w01 = sine_low * _luminance(c00), sine_low * _luminance(c01)
    w10, w11 = sine_high * _luminance(c10), sine_high * _luminance(c11)
    v = _sample_linear(w00 + w01, w10 + w11, u1)
    left, right = _mix(w00, w10, v), _mix(w01, w11, v)
    u = _sample_linear(left, right, u2)

    # theta from the nearer pole, where 1 - v would have lost its digits.
    low = max(float32(row) - HALF, ZERO)
    step = v * select((row == np.int32(0)) | (row == np.int32(height)), HALF, ONE)
    upper = row + row > np.int32(height)
    from_pole = select(upper, np.float32(height) - low - step, low + step)
    sine, cosine = sin_cos_turn(HALF * from_pole / np.float32(height))
    sin_phi, cos_phi = sin_cos_turn((float32(column) + HALF + u) / np.float32(width))
    d = -cos_phi * sine, sin_phi * sine, select(upper, cosine, -cosine)
    pdf = table.scale[0] * _mix(left, right, u) / max(sine, SMALL)
    return d, _mix_color(c00, c01, c10, c11, u, v), pdf
