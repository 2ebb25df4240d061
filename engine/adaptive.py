"""Adaptive sampling: which pixels still need samples.

The error of a pixel is judged by how far the mean of its even samples lies from the mean of all, against the square
root of its brightness, which roughly follows the eye (Dammertz et al. 2010, "A Hierarchical Automatic Stopping
Condition for Monte Carlo Global Illumination", the per-pixel part). A pixel stops with its neighbourhood, so that a
lucky pixel does not stop alone.
"""

from __future__ import annotations

import numpy as np

from .film import Film

MIN_SAMPLES = 32  # before them the estimate says little


class AdaptiveSampling:
    """half (h, w, 3) float64: sums over the even samples. active (h, w) bool: pixels that get more samples."""

    def __init__(self, film: Film, threshold: float):
        self.film, self.threshold = film, threshold
        self.half = np.zeros((*film.samples.shape, 3))
        self.active = np.ones(film.samples.shape, np.bool_)

    def update(self) -> bool:
        """After a pass: drop the pixels that are good enough. True when none is left."""
        if self.film.samples.max(initial=0) < MIN_SAMPLES:
            return False
        count = np.maximum(self.film.samples, 1)[:, :, None]
        mean = self.film.sums[:, :, :3] / count * self.film.exposure
        half = self.half / ((count + 1) // 2) * self.film.exposure
        error = np.abs(mean - half).sum(axis=2) / (1e-4 + np.sqrt(np.maximum(mean.sum(axis=2), 0)))
        self.active &= _with_neighbours(error > self.threshold)
        return not self.active.any()


def _with_neighbours(mask: np.ndarray) -> np.ndarray:
    """Also what touches a set pixel."""
    for axis in (0, 1):
        grown = mask.copy()
        before = [slice(None)] * 2
        after = [slice(None)] * 2
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        grown[tuple(before)] |= mask[tuple(after)]
        grown[tuple(after)] |= mask[tuple(before)]
        mask = grown
    return mask
