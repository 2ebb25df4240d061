"""The film: sums of samples, and the picture that they make."""

from __future__ import annotations

import numpy as np


class Film:
    """Sums over the samples of each pixel of a region.

    sums     (h, w, 4) float64: radiance and alpha. Float64, as a sum over a million samples in float32 is not one
    samples  the number of samples in every pixel
    """

    def __init__(self, region: tuple[int, int, int, int], exposure: float):
        x0, y0, x1, y1 = region
        self.region = region
        self.exposure = exposure
        self.sums = np.zeros((y1 - y0, x1 - x0, 4))
        self.samples = np.zeros((y1 - y0, x1 - x0), np.int32)

    def pixels(self) -> np.ndarray:
        """(h, w, 4) float32, scene-linear, premultiplied; black where there is no sample yet."""
        picture = self.sums / np.maximum(self.samples, 1)[:, :, None]
        picture[:, :, :3] *= self.exposure
        return picture.astype(np.float32)
