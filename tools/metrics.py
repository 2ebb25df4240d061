"""How far one set of pictures is from another: error figures and tests. Pure numpy (and scipy's distributions).

Pictures are (h, w, channels), sets of independent replicates (seeds) are (n, h, w, channels). Low-discrepancy samples
make the variance within one render a wrong estimate of its error, so every interval here comes from the variance
BETWEEN replicates. Which statistic decides what:

- the mean of the picture: Welch's t interval of the relative difference (`mean_difference`);
- each pixel: Welch's t test per pixel and channel (`pixel_p_values`), at two levels. The Sidak level makes the chance
  that ANY of them fails under equality 1 %, as Mitsuba 3 tests its renders (src/tests/test_renders.py), which lets
  0.25 % of them fail all the same, because rare bright paths make few replicates far from normal. The 3 sigma level
  (0.27 % fail under equality) has more power and no allowance for that, so it is reported beside it;
- blocks of pixels: the same test on block means, where noise is smaller and nearer to normal: finds faint bias that
  no single pixel shows;
- size of a bias: `squared_bias`, unbiased, on the scale of relMSE, beside its standard error
  (`squared_bias_error`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

REL_MSE_EPSILON = 1e-2
THREE_SIGMA = 0.0027
SIDAK_SIGNIFICANCE = 0.01
PIXELS = 0.9975  # share of them that has to pass at the Sidak level
SURE = 0.999  # confidence of the interval that refutes: a table has some two dozen, and most of them should not fail
PASS, OPEN, FAIL = "pass", "open", "FAIL"
# Differences below this, relative, are float32 rounding of values that don't vary (a lamp seen by the camera).
ROUNDING = 1e-4


def rel_errors(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(I - R)^2 / (R^2 + 1e-2) of each pixel and channel; its mean is the relMSE."""
    image, reference = image.astype(np.float64), reference.astype(np.float64)
    return (image - reference) ** 2 / (reference**2 + REL_MSE_EPSILON)


def rel_mse(image: np.ndarray, reference: np.ndarray, trim: float = 0.0) -> float:
    """mean((I - R)^2 / (R^2 + 1e-2)); `trim` leaves out that share of the pixels, those of largest error."""
    error = rel_errors(image, reference).ravel()
    if trim:
        error = np.sort(error)[: kept_by_trimming(error.size, trim)]
    return float(error.mean())


def kept_by_trimming(size: int, trim: float) -> int:
    """How many of `size` values are left when the share `trim` of them is left out."""
    return max(1, math.ceil(size * (1.0 - trim)))


def joined(halves) -> tuple[np.ndarray, float]:
    """The mean of two renders of equal samples and other seeds, and the relMSE that this mean has itself: half their
    difference has the variance of their mean."""
    a, b = (half.astype(np.float64) for half in halves)
    mean = (a + b) / 2
    return mean, rel_mse(mean + (a - b) / 2, mean)


def noise(images: np.ndarray, reference: np.ndarray) -> float:
    """The relMSE that one replicate has from its noise alone, from the variance between replicates."""
    variance = images.astype(np.float64).var(axis=0, ddof=1)
    return float((variance / (reference.astype(np.float64) ** 2 + REL_MSE_EPSILON)).mean())


def squared_bias(a: np.ndarray, b: np.ndarray, reference: np.ndarray) -> float:
    """The mean of (E[A] - E[B])^2 / (R^2 + 1e-2), unbiased, so it may come out below zero.

    Every replicate of A minus one of B estimates the difference; products of different replicates carry no noise term:
    ((sum d)^2 - sum d^2) / (n (n - 1)) is their average.
    """
    d = _pairs(a, b)
    return _mean_product(d.sum(axis=0), (d**2).sum(axis=0), len(d), reference)


def squared_bias_error(a: np.ndarray, b: np.ndarray, reference: np.ndarray) -> float:
    """The standard error of `squared_bias`, by the jackknife over pairs of replicates (three at least).

    Where there is no bias it comes out too large, by 1.4 for normal noise, so that 3 of them are exceeded by chance
    about once in a thousand times (Efron & Stein 1981: on average the jackknife is never too small).
    """
    d = _pairs(a, b)
    n, total, squares = len(d), d.sum(axis=0), (d**2).sum(axis=0)
    without = np.array([_mean_product(total - one, squares - one**2, n - 1, reference) for one in d])
    return float(np.sqrt((n - 1) * without.var()))


def _pairs(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    n = min(len(a), len(b))
    return a[:n].astype(np.float64) - b[:n]


def _mean_product(total: np.ndarray, squares: np.ndarray, n: int, reference: np.ndarray) -> float:
    """Mean over the picture of the products of different ones of n pictures, given their sum and that of their
    squares, on the scale of relMSE."""
    product = (total**2 - squares) / (n * (n - 1))
    return float((product / (reference.astype(np.float64) ** 2 + REL_MSE_EPSILON)).mean())


def welch(mean_a, var_a, n_a: int, mean_b, var_b, n_b: int):
    """Welch's t and its degrees of freedom (Satterthwaite). var: of a single replicate. 0 where nothing varies."""
    se_a, se_b = np.asarray(var_a) / n_a, np.asarray(var_b) / n_b
    se2 = se_a + se_b
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (np.asarray(mean_a) - mean_b) / np.sqrt(se2)
        dof = se2**2 / (se_a**2 / (n_a - 1) + se_b**2 / (n_b - 1))
    still = se2 == 0
    return np.where(still, 0.0, t), np.where(still, n_a + n_b - 2.0, dof), se2


def mean_difference(a: np.ndarray, b: np.ndarray, confidence: float = 0.95) -> tuple[float, float]:
    """(mean A - mean B) / mean B over the whole picture, and the half width of its t interval."""
    from scipy import stats

    means_a, means_b = (x.reshape(len(x), -1).mean(axis=1, dtype=np.float64) for x in (a, b))
    _, dof, se2 = welch(means_a.mean(), means_a.var(ddof=1), len(a), means_b.mean(), means_b.var(ddof=1), len(b))
    scale = abs(means_b.mean())
    if scale == 0.0:
        return (0.0 if means_a.mean() == 0.0 else math.inf), 0.0
    half = float(stats.t.ppf(0.5 + confidence / 2, dof) * np.sqrt(se2))
    return float((means_a.mean() - means_b.mean()) / scale), half / scale


def pixel_p_values(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Two-sided p of Welch's t test for each pixel and channel, shape (h, w, channels)."""
    from scipy import stats

    a, b = a.astype(np.float64), b.astype(np.float64)
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    t, dof, se2 = welch(mean_a, a.var(axis=0, ddof=1), len(a), mean_b, b.var(axis=0, ddof=1), len(b))
    p = 2.0 * stats.t.sf(np.abs(t), dof)
    difference = np.abs(mean_a - mean_b)
    equal = difference <= ROUNDING * np.maximum(np.abs(mean_a), np.abs(mean_b)) + 1e-7
    return np.where(equal, 1.0, np.where(se2 == 0, 0.0, p))


def sidak(significance: float, tests: int) -> float:
    """The level for each of `tests` tests that gives `significance` for all of them together."""
    return -math.expm1(math.log1p(-significance) / tests)


def block_means(images: np.ndarray, size: int) -> np.ndarray:
    """Means over blocks of `size` x `size` pixels; what does not fill a block at the far edges is left out."""
    n, h, w, channels = images.shape
    rows, columns = h // size, w // size
    trimmed = images[:, : rows * size, : columns * size].astype(np.float64)
    return trimmed.reshape(n, rows, size, columns, size, channels).mean(axis=(2, 4))


@dataclass(frozen=True)
class Comparison:
    """What `compare` finds. Shares are of pixels times channels (or blocks times channels)."""

    mean_difference: float
    mean_half_width: float
    pass_sidak: float
    pass_three_sigma: float
    block_pass_three_sigma: float
    block_smallest_p: float  # corrected for the number of blocks: below 0.01 is a find
    squared_bias: float
    squared_bias_error: float  # nan with fewer than three replicates
    noise_a: float
    noise_b: float


def compare(a: np.ndarray, b: np.ndarray, block: int = 8) -> Comparison:
    """All the figures for two sets of replicates of the same picture."""
    reference = (a.mean(axis=0, dtype=np.float64) + b.mean(axis=0, dtype=np.float64)) / 2
    p = pixel_p_values(a, b)
    block = min(block, *p.shape[:2])
    block_p = pixel_p_values(block_means(a, block), block_means(b, block))
    difference, half_width = mean_difference(a, b)
    return Comparison(
        mean_difference=difference,
        mean_half_width=half_width,
        pass_sidak=float((p > sidak(SIDAK_SIGNIFICANCE, p.size)).mean()),
        pass_three_sigma=float((p > THREE_SIGMA).mean()),
        block_pass_three_sigma=float((block_p > THREE_SIGMA).mean()),
        block_smallest_p=min(1.0, -math.expm1(block_p.size * math.log1p(-min(block_p.min(), 1 - 1e-16)))),
        squared_bias=squared_bias(a, b, reference),
        squared_bias_error=squared_bias_error(a, b, reference) if min(len(a), len(b)) > 2 else math.nan,
        noise_a=noise(a, reference),
        noise_b=noise(b, reference),
    )


def judge_mean(a: np.ndarray, b: np.ndarray, tolerated: float) -> str:
    """Whether the means of two sets (seeds, h, w, 3) are equal: "pass" is shown, that is, difference and half width of
    the 95 % interval are both below what is tolerated; "FAIL" is refuted, "open" neither."""
    difference, half_width = mean_difference(a, b)
    if abs(difference) < tolerated and half_width < tolerated:
        return PASS
    _, sure = mean_difference(a, b, SURE)
    return OPEN if abs(difference) <= sure else FAIL


def judge_pixels(found: Comparison) -> str:
    return PASS if found.pass_sidak >= PIXELS else FAIL


def median_ratio(numerators, denominators) -> tuple[float, float, float]:
    """Median of the ratios of pairs measured one after the other, and the smallest and the largest of them."""
    ratios = np.asarray(numerators, float) / np.asarray(denominators, float)
    return float(np.median(ratios)), float(ratios.min()), float(ratios.max())


def logarithm(counts, values) -> tuple[float, float, float]:
    """(start, growth with each factor of ten, largest relative distance from a value) of the straight line over
    log10(count / counts[0]) with the least squares."""
    decades = np.log10(np.asarray(counts, float) / counts[0])
    slope, start = np.polyfit(decades, values, 1)
    line = start + slope * decades
    return float(start), float(slope), float(np.abs(line / np.asarray(values, float) - 1).max())
