"""What two renders of each engine, that differ in nothing but the seed, tell about noise and difference. Pure numpy.

No reference is needed. Two renders a, b of one engine have the same expectation, so the mean of (a - b)^2 / 2 is the
variance of one of them: its noise. The product (L1 - C1) (L2 - C2) of differences of the engines' renders of different
seeds has no noise term, so its mean is the square of the true difference. tools/metrics.py has the same for more seeds.

All are relative as relMSE is: divided by R^2 + 0.01 in each pixel and channel. R is the mean of all four renders, and
of 5 x 5 pixels: that of a pixel alone goes along with its noise, which would tilt every figure.

Noise falls like 1 / samples, and time grows with them. So to the error that Lobe's picture has, Cycles needs
noise(Cycles) / noise(Lobe) times its sampling time, whichever samples the two were rendered with.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

EPSILON = 1e-2  # as in tools/metrics.py
SMOOTHED = 2  # pixels to each side
SHORTEST = 0.05  # seconds: Cycles tells its sampling in hundredths, of which less than this is known too badly
T_95 = (12.71, 4.303)  # Student's t that 5 % exceed, up or down, at one degree of freedom and at two


@dataclass(frozen=True)
class Timing:
    """Seconds of one engine's render, the quicker of two; Lobe's compilation, which happens once, is left out."""

    total: float  # from pressing F12 to the picture
    sampling: float  # of it

    @property
    def preparation(self) -> float:
        return max(self.total - self.sampling, 0.0)


@dataclass(frozen=True)
class Figures:
    """Lobe's against Cycles'. nan: not known, as an engine's renders are the same, or too short to be timed."""

    mean_difference: float  # of the pictures' means, relative to Cycles'
    mean_difference_margin: float  # half the width of its 95 % interval, from two renders of each
    rel_mse: float  # of the two pictures that are shown: the difference, and the noise of both
    difference: float  # on that scale, the noise taken off; chance may put it below zero
    difference_error: float  # its standard error, from its spread over the pixels
    noise_lobe: float
    noise_cycles: float
    flip: float
    speedup: float  # to the error of Lobe's picture: Cycles' time over Lobe's, preparation included
    speedup_sampling: float  # the same, of the sampling alone
    ratio_error: float  # standard error of both speed-ups, relative: of noise_cycles / noise_lobe and of the times


def measure(
    lobe: np.ndarray, cycles: np.ndarray, times: tuple[Timing, Timing], flip: float, times_error: float = 0.0
) -> Figures:
    """lobe, cycles: (2, h, w, 3) scene-linear renders of two seeds each, the one that is shown first; times of both,
    and the standard error of their ratio, relative."""
    lobe, cycles = lobe.astype(np.float64), cycles.astype(np.float64)
    scale = 1.0 / (brightness(lobe, cycles) ** 2 + EPSILON)
    (noise_lobe, error_lobe), (noise_cycles, error_cycles) = (_noise(pair, scale) for pair in (lobe, cycles))
    apart = lobe - cycles
    products = (apart[0] * apart[1] * scale).mean(axis=-1)
    difference, margin = _mean_difference(lobe, cycles)
    speedup, speedup_sampling = speedups(noise_lobe, noise_cycles, *times)
    return Figures(
        mean_difference=difference,
        mean_difference_margin=margin,
        rel_mse=float((apart[0] ** 2 * scale).mean()),
        difference=float(products.mean()),
        difference_error=float(products.std() / math.sqrt(products.size)),
        noise_lobe=noise_lobe,
        noise_cycles=noise_cycles,
        flip=flip,
        speedup=speedup,
        speedup_sampling=speedup_sampling,
        ratio_error=math.hypot(error_lobe, error_cycles, times_error),
    )


def brightness(lobe: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """R: (h, w, 3). Beyond its edges the picture goes on as it is there."""
    mean = (lobe.mean(axis=0) + cycles.mean(axis=0)) / 2.0
    for axis in (0, 1):
        around = [(SMOOTHED, SMOOTHED) if i == axis else (0, 0) for i in range(3)]
        padded = np.moveaxis(np.pad(mean, around, "edge"), axis, 0)
        size, width = mean.shape[axis], 2 * SMOOTHED + 1
        mean = np.moveaxis(sum(padded[i : i + size] for i in range(width)) / width, 0, axis)
    return mean


def speedups(noise_lobe: float, noise_cycles: float, lobe: Timing, cycles: Timing) -> tuple[float, float]:
    """Cycles' time over Lobe's, to the noise that Lobe's picture has: with the preparation, which doesn't depend on the
    samples, and of the sampling alone."""
    if not (noise_lobe > 0.0 and noise_cycles > 0.0 and lobe.sampling > 0.0 and cycles.sampling >= SHORTEST):
        return math.nan, math.nan
    needed = cycles.sampling * noise_cycles / noise_lobe
    return (cycles.preparation + needed) / lobe.total, needed / lobe.sampling


def wander(pairs: Sequence[tuple[Timing, Timing]]) -> float:
    """Standard error of the ratio of the engines' times, relative, from two renders of each: by their sampling, as what
    is prepared only once takes the first of them longer. nan where one was too short for the clock.

    The difference of two times, over the root of 2, is the scatter of one; the quicker of them has hardly less.
    """
    if not all(timing.sampling > 0.0 for pair in pairs for timing in pair):
        return math.nan
    return math.hypot(*(math.log(a.sampling / b.sampling) / math.sqrt(2.0) for a, b in pairs))


def _noise(pair: np.ndarray, scale: np.ndarray) -> tuple[float, float]:
    """The relMSE that one of two renders has from its noise alone, nan when they are the same; and its standard error,
    relative, from the spread over the pixels: large where a few bright specks make most of the noise."""
    squares = ((pair[0] - pair[1]) ** 2 * scale).mean(axis=-1) / 2.0
    mean = float(squares.mean())
    if mean == 0.0:
        return math.nan, math.nan
    return mean, float(squares.std() / math.sqrt(squares.size) / mean)


def _mean_difference(lobe: np.ndarray, cycles: np.ndarray) -> tuple[float, float]:
    """(mean of Lobe's - mean of Cycles') / mean of Cycles', and half the width of its 95 % interval."""
    means = [pair.reshape(2, -1).mean(axis=1) for pair in (lobe, cycles)]
    of_lobe, of_cycles = (float(m.mean()) for m in means)
    if of_cycles == 0.0:
        return (0.0 if of_lobe == 0.0 else math.inf), 0.0
    margin = _margin(*(float(m.var(ddof=1)) / 2.0 for m in means))
    return (of_lobe - of_cycles) / abs(of_cycles), margin / abs(of_cycles)


def _margin(variance_a: float, variance_b: float) -> float:
    """Half the width of the 95 % interval of the difference of two means, each of two values, whose variances these
    are: by Welch's t, as one engine may be far noisier than the other.

    Satterthwaite's degrees of freedom are n = (a + b)^2 / (a^2 + b^2), from 1 to 2, so 2 / n - 1, which is
    ((a - b) / (a + b))^2, goes from 1 to 0. Over it log t is nearly a straight line, and as one it is never too small.
    """
    both = variance_a + variance_b
    if both == 0.0:
        return 0.0
    of_one, of_two = T_95
    return math.sqrt(both) * of_two * (of_one / of_two) ** (((variance_a - variance_b) / both) ** 2)
