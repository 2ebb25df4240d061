"""Irradiance at the origin of shapes of radiance 1, by the formulas of radiometry's textbooks. Float64."""

from __future__ import annotations

import numpy as np

UP = (0.0, 0.0, 1.0)


def polygon_irradiance(corners, normal=UP) -> float:
    """Lambert: from a simple polygon (k, 3) above the horizon of the origin, W/m2."""
    v = np.asarray(corners, np.float64)
    v = v / np.linalg.norm(v, axis=1)[:, None]
    total = 0.0
    for a, b in zip(v, np.roll(v, -1, axis=0), strict=True):
        across = np.cross(a, b)
        total += np.arccos(a @ b) * (across @ np.asarray(normal)) / np.linalg.norm(across)
    return float(abs(total) / 2)


def above_horizon(corners, normal=UP) -> np.ndarray:
    """(k, 3) what is above the horizon of the origin of a polygon of which one stretch is below. Sutherland and
    Hodgman 1974."""
    v = np.asarray(corners, np.float64)
    heights = v @ np.asarray(normal)
    kept = []
    for a, b, h, k in zip(v, np.roll(v, -1, axis=0), heights, np.roll(heights, -1), strict=True):
        if h >= 0:
            kept.append(a)
        if (h >= 0) != (k >= 0):
            kept.append(a + (b - a) * h / (h - k))
    return np.array(kept)


def smoothstep(angle: float, half: float, blend: float) -> float:
    s = np.clip((np.cos(angle) - np.cos(half)) / ((1 - np.cos(half)) * blend), 0, 1)
    return float(s * s * (3 - 2 * s))


def spread_disk(radius: float, height: float, spread: float) -> float:
    """E / pi of a coaxial disk of radiance 1 with `spread`: 2 L int (tan h - tan t) sin t cos t dt / (tan h - h)."""
    h = spread / 2
    a = min(h, np.arctan(radius / height))
    return float((np.tan(h) * np.sin(a) ** 2 - a + np.sin(2 * a) / 2) / (np.tan(h) - h))


RAYS, NODES = 10_000, 32


def spread_rectangle(corners, axis, spread: float, normal=UP) -> float:
    """E of a rectangle or parallelogram (4, 3) above the horizon that shines along `axis` with `spread`.

    In polar coordinates (r, phi) of its plane about the foot of the perpendicular from the origin, where the tangent
    of the angle to the axis is r / H: E = int int f(r) cos_lamp cos_receiver / d^2 r dr dphi. Each ray from the foot
    crosses the shape in one piece, on which the integrand is smooth. Good to 4e-7 for shapes that span some 0.2 rad as
    seen from the foot.
    """
    corners, axis = np.asarray(corners, np.float64), np.asarray(axis, np.float64) / np.linalg.norm(axis)
    height = -(corners[0] @ axis)
    foot = -height * axis
    x = (corners[1] - corners[0]) / np.linalg.norm(corners[1] - corners[0])
    flat = (corners - foot) @ np.stack([x, np.cross(axis, x)], axis=1)  # (4, 2)
    phi = (np.arange(RAYS) + 0.5) * 2 * np.pi / RAYS
    rays = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    near, far = np.zeros(RAYS), np.full(RAYS, height * np.tan(spread / 2))
    turned = np.sign(np.cross(flat[1] - flat[0], flat[2] - flat[0]))
    for a, b in zip(flat, np.roll(flat, -1, axis=0), strict=True):
        inward = turned * np.array([a[1] - b[1], b[0] - a[0]])
        across, start = rays @ inward, a @ inward
        with np.errstate(divide="ignore"):
            at = start / across
        near = np.where(across > 0, np.maximum(near, at), near)
        far = np.where(across < 0, np.minimum(far, at), far)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    width = np.maximum(far - near, 0)[:, None]
    r = near[:, None] + width * (nodes + 1) / 2
    points = foot + r[..., None] * (rays @ np.stack([x, np.cross(axis, x)]))[:, None]
    squared = height**2 + r**2
    fading = (np.tan(spread / 2) - r / height) / (np.tan(spread / 2) - spread / 2)
    values = fading * height * (points @ np.asarray(normal)) / squared**2 * r
    return float((values * weights / 2 * width).sum() * 2 * np.pi / RAYS)
