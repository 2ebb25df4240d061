"""The pixel filter, drawn by importance: a sample's place in the picture is its pixel's centre plus a random offset.

Samples then count alike and belong to one pixel only. What is drawn is Cycles' Blackman-Harris window
(src/scene/film.cpp), which is zero beyond `width` pixels from the centre (Cycles doubles it: 1.5 makes a support of 3
pixels across), or the box of one pixel.
"""

from __future__ import annotations

import math

import numpy as np

from ..geom.vec import ONE, TWO
from ..jit import device
from ..simd import at, float32, int32, select

TABLE_INTERVALS = 512
# Harris 1978, the four-term window: sum of a_k cos(2 pi k x / width) about its centre.
COEFFICIENTS = (0.35875, 0.48829, 0.14128, 0.01168)

_HALF = np.float32(0.5)
_INTERVALS = np.float32(TABLE_INTERVALS)
_LAST = np.int32(TABLE_INTERVALS - 1)


def blackman_harris_cdf(x: np.ndarray, width: float) -> np.ndarray:
    """Share of the window's weight left of x, for x within +-width, in pixels."""
    y = np.asarray(x, np.float64) / (2 * width)
    integral = COEFFICIENTS[0] * y
    for k in range(1, 4):
        integral = integral + COEFFICIENTS[k] / (2 * math.pi * k) * np.sin(2 * math.pi * k * y)
    return 0.5 + integral / COEFFICIENTS[0]


def filter_density(pixel_filter: str, width: float, x: np.ndarray) -> np.ndarray:
    """Per pixel, at x pixels from the centre, along either axis: the slope of the window's distribution function."""
    if pixel_filter == "BOX":
        return np.where(np.abs(x) <= 0.5, 1.0, 0.0)
    t = np.pi * np.asarray(x, np.float64) / width
    window = sum(a * np.cos(k * t) for k, a in enumerate(COEFFICIENTS))
    return np.where(np.abs(x) < width, window / (2 * width * COEFFICIENTS[0]), 0.0)


def build_filter_table(pixel_filter: str, width: float) -> np.ndarray:
    """float32: distances from the centre, in pixels; empty for the box.

    Entry i is the distance beyond which lies the share (i / TABLE_INTERVALS)^2 of the weight: the square spends the
    entries on the window's long tails.
    """
    if pixel_filter == "BOX":
        return np.zeros(0, np.float32)
    if pixel_filter != "BLACKMAN_HARRIS":
        raise ValueError(f"unknown pixel filter {pixel_filter!r}")
    share = (np.arange(TABLE_INTERVALS + 1) / TABLE_INTERVALS) ** 2
    low, high = np.zeros_like(share), np.full_like(share, width)
    for _ in range(50):
        middle = (low + high) / 2
        beyond = 2 * (1 - blackman_harris_cdf(middle, width)) > share
        low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
    return low.astype(np.float32)


@device
def _offset(table, u):
    beyond = TWO * min(u, ONE - u)
    place = math.sqrt(beyond) * _INTERVALS
    index = min(int32(place), _LAST)
    inner, outer = at(table, index), at(table, index + np.int32(1))
    distance = inner + (outer - inner) * (place - float32(index))
    return select(u < _HALF, -distance, distance)


@device
def sample_filter(table, u1, u2):
    """(dx, dy) from the pixel's centre, in pixels, for u1, u2 in [0, 1]."""
    if table.size == 0:
        return u1 - _HALF, u2 - _HALF
    return _offset(table, u1), _offset(table, u2)
