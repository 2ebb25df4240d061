"""The table sampler: nets in each dimension, no two dimensions or pixels in step, less error than by chance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from engine.kernels.jit import kernel
from engine.kernels.sampler import random, sobol
from tests.statistics import chi2

TABLE = sobol.build_sobol_table(0)
PIXELS = 400
f32 = np.float32


@kernel
def draw(table, seed, first, dimensions, out):
    """out (P, N, D, 2): samples first.. of P pixels in a row, in each of these dimensions."""
    for pixel in range(out.shape[0]):
        pixel_hash = sobol.hash_pixel(np.int32(pixel % 20), np.int32(pixel // 20), seed)
        for i in range(out.shape[1]):
            key, order = sobol.start_sample(pixel_hash, first + i)
            for d in range(out.shape[2]):
                x, y = sobol.sample_2d(table, key, order, dimensions[d])
                out[pixel, i, d, 0], out[pixel, i, d, 1] = x, y


@kernel
def draw_1d(table, seed, dimension, out):
    for pixel in range(out.shape[0]):
        pixel_hash = sobol.hash_pixel(np.int32(pixel % 20), np.int32(pixel // 20), seed)
        for i in range(out.shape[1]):
            key, order = sobol.start_sample(pixel_hash, i)
            out[pixel, i] = sobol.sample_1d(table, key, order, dimension)


@kernel
def draw_random(state, out):
    for i in range(len(out)):
        out[i], state = random.random_1d(state)


def samples(
    count: int, dimensions=(0,), pixels: int = PIXELS, first: int = 0, seed: int = 0, table=TABLE
) -> np.ndarray:
    """(pixels, count, len(dimensions), 2) float64"""
    out = np.empty((pixels, count, len(dimensions), 2), np.float32)
    draw(table, np.int32(seed), first, np.array(dimensions, np.int64), out)
    return out.astype(np.float64)


def independent(shape, seed: int = 7) -> np.ndarray:
    return np.random.default_rng(seed).random(shape)


@pytest.mark.parametrize("bits, first", [(4, 0), (6, 0), (6, 64 * 5), (8, 0), (8, 4096 + 256), (12, 0), (12, 4096)])
def test_aligned_blocks_are_nets(bits, first):
    assert_nets(samples(1 << bits, (0, 5, 11, 300), pixels=5, first=first), bits)


@pytest.mark.parametrize("bits, first", [(4, 8), (6, 7), (8, 1), (12, 2048)])
def test_blocks_that_are_not_aligned_are_no_nets(bits, first):
    with pytest.raises(AssertionError):
        assert_nets(samples(1 << bits, (0, 5, 11, 300), pixels=5, first=first), bits)


def test_one_number_that_is_rounded_away_is_caught():
    points = samples(1 << 8, (0,), pixels=5)
    points[3, 100] = points[3, 101]
    with pytest.raises(AssertionError):
        assert_nets(points, 8)


def assert_nets(points: np.ndarray, bits: int) -> None:
    """One point in each box of area 2^-bits, of every shape, in any dimension: a (0, bits, 2)-net."""
    for a in range(bits + 1):
        x = (points[..., 0] * (1 << a)).astype(int)
        y = (points[..., 1] * (1 << (bits - a))).astype(int)
        boxes = np.sort(x << (bits - a) | y, axis=1)
        assert np.array_equal(boxes, np.broadcast_to(np.arange(1 << bits)[None, :, None], boxes.shape))


def test_numbers_lie_in_the_open_interval_and_are_uniform():
    values = samples(64, range(20))
    assert values.min() > 0
    assert values.max() < 1
    counts, _ = np.histogram(values, bins=64, range=(0, 1))
    assert counts == pytest.approx(values.size / 64)  # exact, since each pixel's 64 are stratified
    low_bits = (values[:, 0] * 2**23).astype(np.int64) & 0xFF  # which the table does not hold
    assert chi2.p_value(np.bincount(low_bits.ravel(), minlength=256), np.full(256, low_bits.size / 256)) > 0.001


def test_one_number_is_the_first_of_two():
    out = np.empty((10, 64), np.float32)
    draw_1d(TABLE, np.int32(0), 3, out)
    assert np.array_equal(out, samples(64, (3,), pixels=10)[:, :, 0, 0].astype(np.float32))


def star_discrepancy(points: np.ndarray) -> np.ndarray:
    """L2 star discrepancy of (P, N, 2) points, by Warnock's formula."""
    n = points.shape[1]
    one = np.prod(1 - points**2, axis=2).sum(axis=1) * 2.0**-1 / n
    pairs = np.prod(1 - np.maximum(points[:, :, None], points[:, None, :]), axis=3).sum(axis=(1, 2)) / n**2
    return np.sqrt(np.maximum(1 / 9 - one + pairs, 0))


@pytest.mark.parametrize("count, factor", [(16, 2.0), (64, 3.5), (256, 6.0)])
def test_discrepancy_is_far_below_that_of_independent_points(count, factor):
    pixels = 40
    ours = star_discrepancy(samples(count, pixels=pixels)[:, :, 0]).mean()
    assert star_discrepancy(independent((pixels, count, 2))).mean() > factor * ours


# Integrands of one dimension's two numbers, and of two dimensions' (x of one, x of the other).
def smooth(u):
    return u[..., 0] * u[..., 1]


def disk(u):
    return (u[..., 0] ** 2 + u[..., 1] ** 2 < 1).astype(float)


def edge(u):
    return (u[..., 0] + 0.7 * u[..., 1] < 0.8).astype(float)


EDGE_MEAN = 0.45


def variance(points: np.ndarray, f) -> float:
    """Over the pixels, of each pixel's mean."""
    return f(points).mean(axis=1).var()


@pytest.mark.parametrize("count", [16, 64, 256])
@pytest.mark.parametrize(
    "f, gain", [(smooth, (50, 500, 4000)), (disk, (3, 5, 10)), (edge, (3, 5, 10))], ids=["smooth", "disk", "edge"]
)
def test_variance_within_a_dimension(f, gain, count):
    """By how much the error of a mean falls below that of independent numbers: more, the more samples."""
    ours = variance(samples(count)[:, :, 0], f)
    assert variance(independent((PIXELS * 4, count, 2)), f) > gain[(16, 64, 256).index(count)] * ours


@pytest.mark.parametrize("count", [16, 64, 256])
@pytest.mark.parametrize("pair", [(0, 1), (2, 3), (0, 4), (1, 9), (3, 17)])
def test_dimensions_are_independent_of_each_other(pair, count):
    assert_independent(samples(count, pair))


@pytest.mark.parametrize("count", [16, 64, 256])
def test_dimensions_in_step_are_caught(count):
    """One dimension twice; and two that are in step in a tenth of the pixels."""
    points = samples(count, (2, 3))
    partly = np.where(np.arange(PIXELS)[:, None, None, None] % 10 == 0, points[:, :, :1], points)
    for wrong in (samples(count, (2, 2)), partly):
        with pytest.raises(AssertionError):
            assert_independent(wrong)


def assert_independent(points: np.ndarray) -> None:
    """Between two dimensions: no correlation, and an integrand of both has no more error than by chance."""
    count = points.shape[1]
    x, y = points[:, :, 0, 0] - 0.5, points[:, :, 1, 0] - 0.5
    correlation = 12 * (x * y).mean()
    assert abs(correlation) < 4 / np.sqrt(PIXELS * count)
    both = np.stack([points[:, :, 0, 0], points[:, :, 1, 0]], axis=-1)
    by_chance = variance(independent((PIXELS * 4, count, 2)), edge)
    assert variance(both, edge) < 0.7 * by_chance  # each dimension alone is still well spread
    interaction = ((x > 0) == (y > 0)).mean(axis=1)  # all that neither dimension alone explains
    assert interaction.mean() == pytest.approx(0.5, abs=4 * interaction.std() / np.sqrt(PIXELS))
    # A nested shuffle keeps pairs of samples together, which doubles the variance of this one: not more.
    assert interaction.var() < 2.5 * 0.25 / count


def test_pixels_are_independent_of_each_other():
    """The errors of neighbouring pixels, and one pixel's numbers and the next one's, are uncorrelated."""
    for dimension in (0, 6):
        assert_pixels_independent(samples(64, (dimension,))[:, :, 0])


def assert_pixels_independent(points: np.ndarray) -> None:
    values = points.reshape(PIXELS, -1) - 0.5
    for step in (1, 20, 21):
        correlation = 12 * (values[step:] * values[:-step]).mean()
        assert abs(correlation) < 4 / np.sqrt(values[step:].size)
    errors = edge(points).mean(axis=1)
    errors = (errors - errors.mean()) / errors.std()
    for step in (1, 20):
        assert abs((errors[step:] * errors[:-step]).mean()) < 4 / np.sqrt(PIXELS)


@pytest.mark.parametrize("step", [1, 20])
def test_pixels_in_step_are_caught(step):
    """A third of them has the numbers of a neighbour."""
    points = samples(64, (0,))[:, :, 0]
    copied = np.arange(step, PIXELS, 3)
    points[copied] = points[copied - step]
    with pytest.raises(AssertionError):
        assert_pixels_independent(points)


def test_samples_continue_beyond_the_table():
    """Nothing repeats in three tables' worth, and the error goes on falling at least as by chance."""
    count = sobol.TABLE_SIZE
    points = samples(3 * count, pixels=64)[:, :, 0]
    assert all(len(np.unique(p, axis=0)) == len(p) for p in points)
    one, three = (((edge(points[:, :n]).mean(axis=1) - EDGE_MEAN) ** 2).mean() for n in (count, 3 * count))
    assert three < 0.6 * one


def test_seeds_differ_and_repeat():
    first = samples(16, (0, 1), pixels=10)
    assert np.array_equal(first, samples(16, (0, 1), pixels=10))
    for other in (samples(16, (0, 1), pixels=10, seed=1), samples(16, (0, 1), pixels=10, seed=-1)):
        assert np.abs(first - other).min() > 0


def means_by_seed(seeds: int = 24, count: int = 16) -> np.ndarray:
    """(seeds, pixels) errors of each pixel's mean of an integrand."""
    points = (samples(count, (0,), seed=seed)[:, :, 0] for seed in range(seeds))
    return np.array([edge(p).mean(axis=1) - EDGE_MEAN for p in points])


def assert_seeds_independent(errors: np.ndarray) -> None:
    """Though all take their numbers from one table: the errors of two seeds aren't correlated, and the mean over the
    pixels wanders from seed to seed as it does if all are independent, no less and no more."""
    seeds, pixels = errors.shape
    correlation = np.corrcoef(errors)[np.triu_indices(seeds, 1)]
    assert abs(correlation.mean()) < 4 / np.sqrt(len(correlation) * pixels)
    statistic = (seeds - 1) * errors.mean(axis=1).var(ddof=1) / (errors.var() / pixels)
    assert 1e-4 < stats.chi2.sf(statistic, seeds - 1) < 1 - 1e-4


def test_seeds_are_independent():
    assert_seeds_independent(means_by_seed())


def test_seeds_in_step_are_caught():
    """A third of the pixels has the same numbers with all seeds."""
    errors = means_by_seed()
    errors[:, ::3] = errors[0, ::3]
    with pytest.raises(AssertionError):
        assert_seeds_independent(errors)


def test_table_is_small():
    assert sobol.build_sobol_table(3).nbytes <= 1 << 16  # to stay in the cache nearest to the core


def test_random_numbers_are_uniform_and_serially_independent():
    out = np.empty(1 << 18, np.float32)
    draw_random(np.uint32(1), out)
    assert out.min() > 0
    assert out.max() < 1
    triples = (out[: len(out) // 3 * 3].reshape(-1, 3).astype(np.float64) * 16).astype(int)
    counts = np.bincount(triples @ (256, 16, 1), minlength=4096)
    assert chi2.p_value(counts, np.full(4096, len(triples) / 4096)) > chi2.SIGNIFICANCE


def test_single_precision():
    key, order = np.uint32(5), np.uint32(1 << 31)
    chi2.assert_single_precision(random.random_1d, key)
    chi2.assert_single_precision(sobol.hash_pixel, np.int32(3), np.int32(4), np.int32(-1))
    chi2.assert_single_precision(sobol.start_sample, key, np.int32(5))
    chi2.assert_single_precision(sobol.sample_1d, TABLE, key, order, np.int32(3))
    chi2.assert_single_precision(sobol.sample_2d, TABLE, key, order, np.int32(3))
