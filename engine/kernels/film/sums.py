"""The film's sums."""

from __future__ import annotations

from ..embree import is_finite
from ..jit import device
from ..records import REJECTED


@device
def add_sample(row, column, index, radiance, alpha, sums, samples, half, adaptive, counters):
    """Add sample `index` of a pixel to its sums, and every second one to `half`, which `engine/adaptive.py` compares
    with them. What isn't finite is counted, and is black."""
    samples[row, column] += 1
    if not is_finite(radiance[0] + radiance[1] + radiance[2]):
        counters[REJECTED] += 1
        return
    sums[row, column, 0] += radiance[0]
    sums[row, column, 1] += radiance[1]
    sums[row, column, 2] += radiance[2]
    sums[row, column, 3] += alpha
    if adaptive and index % 2 == 0:
        half[row, column, 0] += radiance[0]
        half[row, column, 1] += radiance[1]
        half[row, column, 2] += radiance[2]
