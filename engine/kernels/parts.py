"""The parts of a sample's light that render passes show apart: what surfaces and the world send straight to the camera,
and what comes by way of the first vertex's diffuse and glossy lobe, directly or after more bounces.

Nothing here adds light. The kernel adds it up as ever, and now and then says which part the growth since the last
time belongs to: so the parts of a sample add up to its light, and the picture doesn't depend on them. These functions
are called with `Features.light_passes` alone. `parts` is an array with the rows that `rows` names and a column for each
sample. What comes by way of the first vertex is shared out between its lobes by the value of each, whichever of them
drew the direction, as Cycles does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from . import rows
from .batch import at_3, put_at_3
from .embree import is_finite
from .geom.vec import BLACK, add, mul, sub
from .jit import device
from .simd import select


class PartSums(NamedTuple):
    """The film's sums of parts.

    sums     (h, w, 3 k) float64, of the k parts that are kept
    columns  (6,) int64: where each part of `engine.passes.LIGHT` begins in them, -1: it is not kept
    """

    sums: np.ndarray
    columns: np.ndarray


@device
def start_parts(parts, place, mask):
    """Nothing has arrived yet."""
    for row in range(0, rows.SHARE, 3):
        put_at_3(parts, row, place, BLACK, mask)


@device
def credit(parts, row, place, light, mask):
    """What has come to a sample's light since the last time belongs to one part."""
    _add(parts, row, place, _growth(parts, place, light, mask), mask)


@device
def credit_lobes(parts, direct, share, place, light, mask):
    """What has come was scattered, once if it is `direct`; the row `share` says how much of it the diffuse lobe
    scattered first."""
    _add_lobes(parts, direct, share, place, _growth(parts, place, light, mask), mask)


@device
def credit_lit(parts, first, place, light, mask):
    """What a light sample has brought to the `first` vertex or to another has its part."""
    _add_lit(parts, first, place, _growth(parts, place, light, mask), mask)


@device
def foresee(parts, row, place, light, mask):
    """This light, which the sample has or will have, belongs to one part."""
    _add(parts, row, place, light, mask)
    _add(parts, rows.SEEN, place, light, mask)


@device
def foresee_lit(parts, first, place, light, mask):
    """As `foresee`, of what a light sample brings."""
    _add_lit(parts, first, place, light, mask)
    _add(parts, rows.SEEN, place, light, mask)


@device
def _growth(parts, place, light, mask):
    """How much of a sample's light belongs to no part yet. From now on it does."""
    new = sub(light, at_3(parts, rows.SEEN, place))
    put_at_3(parts, rows.SEEN, place, light, mask)
    return new


@device
def _add(parts, row, place, light, mask):
    put_at_3(parts, row, place, add(at_3(parts, row, place), light), mask)


@device
def _add_lit(parts, first, place, light, mask):
    share = select(first, np.uint32(rows.LIGHT_SHARE), np.uint32(rows.SHARE))
    _add_lobes(parts, first, share, place, light, mask)


@device
def _add_lobes(parts, direct, share, place, light, mask):
    diffuse = mul(light, at_3(parts, share, place))
    row = select(direct, np.uint32(rows.DIRECT), np.uint32(rows.INDIRECT))
    _add(parts, row, place, diffuse, mask)
    _add(parts, row + 3, place, sub(light, diffuse), mask)


@device
def add_parts(film, row, column, parts, place, radiance):
    """Add a sample's parts to their sums. A sample that isn't finite is black, as in the picture."""
    if not is_finite(radiance[0] + radiance[1] + radiance[2]):
        return
    for part in range(len(film.columns)):
        first = film.columns[part]
        if first >= 0:
            for channel in range(3):
                film.sums[row, column, first + channel] += parts[3 * part + channel, place]
