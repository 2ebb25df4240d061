"""The pixel filter: Cycles' Blackman-Harris window, and the box of one pixel. How it is drawn: tests/statistics."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.film.filter import (
    COEFFICIENTS,
    blackman_harris_cdf,
    build_filter_table,
    filter_density,
    sample_filter,
)
from engine.settings import PIXEL_FILTERS
from tests.statistics import chi2
from tests.statistics.film import draw_filter


def offsets(pixel_filter: str, width: float, u: np.ndarray) -> np.ndarray:
    out = np.empty((len(u), 2), np.float32)
    draw_filter(build_filter_table(pixel_filter, width), u, out)
    return out.astype(np.float64)


def blackman_harris(x: np.ndarray) -> np.ndarray:
    """The window over [0, 1], normalised to an integral of 1, as in Cycles' src/scene/film.cpp."""
    a0, a1, a2, a3 = COEFFICIENTS
    v = 2 * np.pi * x
    return (a0 - a1 * np.cos(v) + a2 * np.cos(2 * v) - a3 * np.cos(3 * v)) / a0


def test_distribution_function_is_the_integral_of_the_window():
    x = np.linspace(-1.5, 1.5, 2001)
    slope = np.gradient(blackman_harris_cdf(x, 1.5), x)
    window = blackman_harris(x / 3 + 0.5) / 3
    assert slope[1:-1] == pytest.approx(window[1:-1], abs=1e-5)
    assert slope[1:-1] != pytest.approx(blackman_harris(x / 3.001 + 0.5)[1:-1] / 3.001, abs=1e-5)  # of another width
    assert filter_density("BLACKMAN_HARRIS", 1.5, x) == pytest.approx(window, abs=1e-4)  # 6e-5 at the ends, cut off
    assert filter_density("BOX", 1.5, np.array([-0.6, -0.4, 0.4, 0.6])).tolist() == [0, 1, 1, 0]
    assert blackman_harris_cdf(np.array([-1.5, 0, 1.5]), 1.5) == pytest.approx([0, 0.5, 1], abs=1e-12)


def test_sampling_inverts_the_distribution_function():
    u = np.linspace(2.0**-24, 1 - 2.0**-24, 10_001).astype(np.float32)
    drawn = offsets("BLACKMAN_HARRIS", 1.5, np.stack([u, u[::-1]], axis=1))
    assert (np.diff(drawn[:, 0]) >= 0).all()
    assert np.abs(blackman_harris_cdf(drawn[:, 0], 1.5) - u).max() < 2e-5
    assert np.abs(blackman_harris_cdf(drawn[:, 0], 1.5005) - u).max() > 2e-5  # another width is seen
    assert drawn[:, 1] == pytest.approx(drawn[::-1, 0])


def test_box_is_one_pixel_wide_whatever_the_width():
    u = chi2.uniforms(1000, 2)
    assert np.array_equal(offsets("BOX", 3.0, u), (u - np.float32(0.5)).astype(np.float64))


def test_every_setting_has_a_table():
    for name in PIXEL_FILTERS:
        assert build_filter_table(name, 1.5).dtype == np.float32
    with pytest.raises(ValueError, match="unknown pixel filter 'GAUSSIAN'"):
        build_filter_table("GAUSSIAN", 1.5)


def test_single_precision():
    table = build_filter_table("BLACKMAN_HARRIS", 1.5)
    chi2.assert_single_precision(sample_filter, table, np.float32(0.2), np.float32(0.3))
