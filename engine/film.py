"""The film: sums of samples, and the picture that they make."""

from __future__ import annotations

import numpy as np

RETRIES = 8  # of reading pixels that are being written


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
        """(h, w, 4) float32, scene-linear, premultiplied; black where there is no sample yet.

        May be called while threads add to the film: pixels that changed while they were read are read again.
        """
        before, sums = self.samples.copy(), self.sums.copy()
        for _ in range(RETRIES):
            torn = self.samples != before
            if not torn.any():
                break
            before[torn], sums[torn] = self.samples[torn], self.sums[torn]
        picture = sums / np.maximum(before, 1)[:, :, None]
        picture[:, :, :3] *= self.exposure
        return picture.astype(np.float32)
