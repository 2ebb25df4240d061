"""Orthonormal frames about a normal, local z = n."""

from __future__ import annotations

import math

from ..jit import device
from .vec import ONE


@device
def basis(n):
    """(x, y) such that (x, y, n) is right-handed and orthonormal, for a unit n.

    Duff et al. 2017, "Building an Orthonormal Basis, Revisited", JCGT 6(1), listing 3: exact at both poles.
    """
    sign = math.copysign(ONE, n[2])
    a = -ONE / (sign + n[2])
    b = n[0] * n[1] * a
    return (ONE + sign * n[0] * n[0] * a, sign * b, -sign * n[0]), (b, sign + n[1] * n[1] * a, -n[1])


@device
def to_world(v, n):
    """The local direction v (z along n) in the space of n."""
    x, y = basis(n)
    return (
        x[0] * v[0] + y[0] * v[1] + n[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + n[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + n[2] * v[2],
    )
