"""The film: sums of samples, and the picture that they make."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np

from .errors import LobeError
from .passes import PassFilm

RETRIES = 8  # of reading pixels that are being written
STRIP_PIXELS = 1 << 14  # are read at a time: a large picture has no room for copies, and a strip fits the cache


class Film:
    """Sums over the samples of each pixel of a region.

    sums     (h, w, 4) float64: radiance and alpha. Float64, as a sum over a million samples in float32 is not one
    samples  the number of samples in every pixel
    passes   what the passes sum up, None without any
    """

    def __init__(self, region: tuple[int, int, int, int], exposure: float, passes: tuple[str, ...] = ()):
        x0, y0, x1, y1 = region
        self.region = region
        self.exposure = exposure
        with self._memory("sum up", np.float64):
            self.sums = np.zeros((y1 - y0, x1 - x0, 4))
            self.samples = np.zeros((y1 - y0, x1 - x0), np.int32)
            self.passes = PassFilm((y1 - y0, x1 - x0), passes) if passes else None

    def pixels(self) -> np.ndarray:
        """(h, w, 4) float32, scene-linear, premultiplied; black where there is no sample yet.

        May be called while threads add to the film: pixels that changed while they were read are read again.
        """
        height, width = self.samples.shape
        with self._memory("show", np.float32):
            picture = np.empty((height, width, 4), np.float32)
            strip = max(STRIP_PIXELS // max(width, 1), 1)
            for first in range(0, height, strip):
                picture[first : first + strip] = self._strip(slice(first, first + strip))
        return picture

    def pass_pictures(self) -> dict[str, np.ndarray]:
        """(h, w, channels) float32 of each pass. Not while threads add to the film."""
        with self._memory("show", np.float32):
            return self.passes.pictures(self.samples, self.exposure) if self.passes else {}

    def _strip(self, rows: slice) -> np.ndarray:
        """Some rows of `pixels`, float64."""
        samples, sums = self.samples[rows], self.sums[rows]
        before, picture = samples.copy(), sums.copy()
        for _ in range(RETRIES):
            torn = samples != before
            if not torn.any():
                break
            before[torn], picture[torn] = samples[torn], sums[torn]
        divisor = np.maximum(before, 1)
        for channel in range(4):  # numpy takes four times as long for all at once: the last axis is too short
            picture[:, :, channel] /= divisor
            if channel < 3:
                picture[:, :, channel] *= self.exposure
            else:  # a sample's alpha is right in the mean alone
                np.clip(picture[:, :, channel], 0.0, 1.0, out=picture[:, :, channel])
        return picture

    @contextlib.contextmanager
    def _memory(self, purpose: str, dtype: type) -> Iterator[None]:
        """Says what the user can do where there is too little of it to `purpose` the picture in numbers of a type."""
        try:
            yield
        except MemoryError:
            x0, y0, x1, y1 = self.region
            size = (x1 - x0) * (y1 - y0) * 4 * np.dtype(dtype).itemsize / 1e9
            raise LobeError(
                f"not enough memory to {purpose} the picture of {x1 - x0} x {y1 - y0} pixels, which takes {size:.1f} "
                "GB: set a lower resolution, or render it in regions"
            ) from None
