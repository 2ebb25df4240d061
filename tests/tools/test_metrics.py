"""The statistics of tools/metrics.py on made-up pictures whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from tools import metrics as m

SHAPE = (8, 32, 32, 3)


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def noisy(rng, mean=1.0, spread=0.1):
    return rng.normal(mean, spread, SHAPE)


def test_rel_mse_by_hand():
    image, reference = np.array([[1.0, 2.0]]), np.array([[1.0, 1.0]])
    assert m.rel_mse(image, reference) == pytest.approx(0.5 / 1.01)


def test_trimming_leaves_out_the_worst_pixel():
    image, reference = np.ones((1000, 1)), np.ones((1000, 1))
    image[7] = 100
    assert m.rel_mse(image, reference) > 1
    assert m.rel_mse(image, reference, trim=0.001) == 0


def test_noise_is_the_error_of_one_replicate(rng):
    assert m.noise(noisy(rng), np.ones(SHAPE[1:])) == pytest.approx(0.01 / 1.01, rel=0.05)


def test_squared_bias_does_not_count_noise(rng):
    one = np.ones(SHAPE[1:])
    assert abs(m.squared_bias(noisy(rng), noisy(rng), one)) < 2e-4
    assert m.squared_bias(noisy(rng, 1.1), noisy(rng), one) == pytest.approx(0.01 / 1.01, rel=0.05)


def test_standard_error_of_squared_bias_by_hand():
    """Three pairs whose differences are 1, 2 and 3: without one of them the products are 2*3, 1*3 and 1*2."""
    a, b = np.array([1.0, 2.0, 3.0]).reshape(3, 1, 1, 1), np.zeros((3, 1, 1, 1))
    scale = 100.0  # of a black reference
    assert m.squared_bias(a, b, b[0]) == pytest.approx((2 + 3 + 6) / 3 * scale)
    assert m.squared_bias_error(a, b, b[0]) == pytest.approx(np.sqrt(2 * np.var([6, 3, 2])) * scale)


def test_standard_error_of_squared_bias_tells_noise_from_bias(rng):
    """Noise alone is hardly ever above 3 of them; a bias far too small for a single pixel is."""
    one, found = np.ones((16, 16, 3)), {0.0: 0, 0.05: 0}
    for _ in range(200):
        for bias in found:
            a, b = (rng.normal(mean, 0.1, (8, 16, 16, 3)) for mean in (1 + bias, 1))
            found[bias] += m.squared_bias(a, b, one) > 3 * m.squared_bias_error(a, b, one)
    assert found[0.0] <= 2
    assert found[0.05] >= 195


def test_mean_interval_covers_the_truth_about_as_often_as_it_says(rng):
    hits = 0
    for _ in range(300):
        a, b = (rng.normal(mean, 1, (8, 2, 2, 1)) for mean in (5.5, 5.0))
        difference, half_width = m.mean_difference(a, b)
        hits += abs(difference - 0.1) <= half_width
    assert 0.91 < hits / 300 < 0.99


def test_equal_sets_pass_and_the_levels_hold(rng):
    found = m.compare(noisy(rng), noisy(rng))
    assert found.pass_sidak > 0.999
    assert found.pass_three_sigma == pytest.approx(1 - m.THREE_SIGMA, abs=0.003)
    assert found.block_smallest_p > 0.001


def test_a_wrong_corner_is_found(rng):
    a, b = noisy(rng), noisy(rng)
    a[:, :8, :8] += 0.05  # half a standard deviation: no single pixel shows it
    found = m.compare(a, b)
    assert found.pass_sidak > 0.999
    assert found.block_smallest_p < 0.01


def test_constant_pixels_pass_only_when_equal():
    a, b = np.full(SHAPE, 17.0), np.full(SHAPE, 17.0)
    b[:, 0, 0, 0] = 17.0 * (1 + 1e-6)  # rounding
    b[:, 1, 1, 1] = 17.1
    p = m.pixel_p_values(a, b)
    assert p[1, 1, 1] < 1e-20
    assert (p == 1).sum() == p.size - 1


def test_sidak():
    assert m.sidak(0.01, 1) == pytest.approx(0.01)
    assert 1 - (1 - m.sidak(0.01, 1000)) ** 1000 == pytest.approx(0.01)


def test_block_means():
    images = np.arange(2 * 5 * 4 * 1, dtype=float).reshape(2, 5, 4, 1)
    blocks = m.block_means(images, 2)
    assert blocks.shape == (2, 2, 2, 1)
    assert blocks[0, 0, 0, 0] == np.mean([0, 1, 4, 5])


def test_median_ratio():
    assert m.median_ratio([2, 9, 4], [1, 3, 1]) == (3.0, 2.0, 4.0)


def test_noise_of_a_reference_from_its_halves():
    """Of the mean of two it is half of either's."""
    rng = np.random.default_rng(1)
    truth = rng.uniform(0.5, 2.0, (64, 64, 3))
    halves = [truth + rng.normal(0.0, 0.1, truth.shape) for _ in range(2)]
    mean, noise = m.joined(halves)
    np.testing.assert_allclose(mean, (halves[0] + halves[1]) / 2)
    assert noise == pytest.approx(0.1**2 / 2 * np.mean(1 / (truth**2 + 0.01)), rel=0.1)
