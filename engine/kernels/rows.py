"""The rows of a batch's arrays, see `batch`: where a vector of the path's begins it takes three.

Whoever uses them says `rows.PDF`, since the fields of rays, random numbers and Embree have the same names.
"""

from __future__ import annotations

import numpy as np


def _rows(*heights: int) -> tuple:
    """The first rows of things so many rows high, and how many that are together. See `tables.words`."""
    starts = np.cumsum((0, *heights))
    return (*(np.int64(row) for row in starts[:-1]), int(starts[-1]))


# Of a sample, by its place in the batch: pixel, number, what has arrived at the camera.
X, Y, INDEX, LIGHT, ALPHA, SAMPLE_ROWS = _rows(1, 1, 1, 3, 1)
# Of a live path: where its random numbers come from, its place in the batch, throughput, the ray (see `records.Ray`)
# and the `Stretch` of it that is yet to be followed.
_RAY_ROWS = (3, 3, 3, 1, 3, 1, 1)
KEY, ORDER, PLACE, THROUGHPUT, P, N, WI, PDF, START, T_NEAR, T_FAR, _OWN = _rows(1, 1, 1, 3, *_RAY_ROWS)
# And where those of one stage differ in it, see `batch.is_mixed`: scatterings, how many of them were diffuse, the ray's
# kind, and what the stretch begins behind.
BOUNCES, DIFFUSE, KIND, BEGINS, PATH_ROWS = (_OWN + row for row in _rows(1, 1, 1, 1))
# Of its ray's hit: whether there is one, then `surface.Hit`, and how far from the ray's start it is.
MET, TRIANGLE, INSTANCE, U, V, T, HIT_ROWS = _rows(1, 1, 1, 1, 1, 1)
# Of a shadow ray: the place of its path, the ray, the light that it brings, and whether it left the first vertex.
TO, FROM, DIRECTION, END, BRINGS, FIRST, SHADOW_ROWS = _rows(1, 3, 3, 1, 3, 1)
# Of a sample's light, see `parts`: the parts by `engine.passes.LIGHT`, each lobe's glossy row behind the diffuse one,
# what of it has its part already, and the diffuse lobe's share of what the path's next ray brings and of what the first
# vertex's light sample brings.
EMISSION, ENVIRONMENT, DIRECT, _, INDIRECT, _, SEEN, SHARE, LIGHT_SHARE, PART_ROWS = _rows(3, 3, 3, 3, 3, 3, 3, 3, 3)
