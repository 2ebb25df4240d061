"""Small helpers for (n, 3) float64 arrays of vectors."""

from __future__ import annotations

import numpy as np


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)


def length(a: np.ndarray) -> np.ndarray:
    return np.sqrt(dot(a, a))


def unit(a: np.ndarray) -> np.ndarray:
    """Vectors of length 1; a zero vector stays one."""
    return a / np.maximum(length(a), 1e-300)[..., None]


def around(axis: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Directions given relative to z, (n, 3), turned so that z becomes the unit vector `axis`, (n, 3) or (3,).

    The frame is that of Duff et al. 2017 (JCGT 6(1)), exact at both poles.
    """
    x, y, z = np.broadcast_to(axis, local.shape).T
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    tangent = np.column_stack([1 + sign * x * x * a, sign * b, -sign * x])
    bitangent = np.column_stack([b, sign + y * y * a, -y])
    return local[:, 0:1] * tangent + local[:, 1:2] * bitangent + local[:, 2:3] * axis


def random_angle(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Cosine and sine of uniform angles."""
    phi = 2 * np.pi * rng.random(count)
    return np.cos(phi), np.sin(phi)


def cone(count: int, one_minus_cos: np.ndarray | float, rng: np.random.Generator) -> np.ndarray:
    """Uniform directions in cones about z, (count, 3), half-angle given by 1 - cos so that a thin one keeps digits."""
    w = rng.random(count) * one_minus_cos
    sine = np.sqrt(w * (2 - w))
    x, y = random_angle(count, rng)
    return np.column_stack([sine * x, sine * y, 1 - w])


def disk(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Uniform points in the unit disk."""
    r = np.sqrt(rng.random(count))
    x, y = random_angle(count, rng)
    return r * x, r * y
