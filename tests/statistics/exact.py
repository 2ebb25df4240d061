"""Densities of lights in float64, from solid angles and areas: what the float32 kernels are compared with."""

from __future__ import annotations

import numpy as np

from engine.kernels.light.spherical import FAR_RATIO
from engine.reference.lights import Area, make_lamp
from engine.scene import AreaLight, PointLight, SunLight, World


def density(case, wi: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(n,) per steradian, of directions (n, 3) in which the light lies at distances (n,)."""
    scene = case.scene
    if scene.world.image is not None:
        return of_world(scene.world, wi)
    if not scene.lights:
        corners = scene.meshes[0].vertices.astype(float) - case.p
        return of_polygon(corners, t) if len(corners) == 4 else of_triangle(corners, t)
    lamp = scene.lights[0]
    if isinstance(lamp, SunLight):
        return np.full(len(wi), 1 / (4 * np.pi * np.sin(lamp.angle / 4) ** 2))
    if isinstance(lamp, PointLight):
        return of_sphere(lamp, case.p, case.n, wi)
    assert isinstance(lamp, AreaLight)
    emitter = make_lamp(lamp, 1.0)
    assert isinstance(emitter, Area)
    if lamp.ellipse:
        return emitter.meet(np.tile(case.p, (len(wi), 1)), np.tile(case.n, (len(wi), 1)), wi)[2]
    return of_polygon(visible_corners(emitter, case.p), t)


def of_sphere(lamp: PointLight, p: np.ndarray, n: np.ndarray, wi: np.ndarray) -> np.ndarray:
    """Uniform in the cone in which the sphere, or the disk that faces p, is seen; a cosine from within the sphere."""
    distance2 = np.sum((np.asarray(lamp.transform)[:, 3] - p) ** 2)
    across = lamp.radius**2 / (distance2 + (lamp.radius**2 if lamp.soft_falloff else 0))
    if across >= 1:
        return np.maximum(wi @ n, 0) / np.pi
    return np.full(len(wi), (1 + np.sqrt(1 - across)) / (2 * np.pi * across))


def visible_corners(emitter: Area, p: np.ndarray) -> np.ndarray:
    """(4, 3) from p: of the part of a rectangle whose light may reach p, by the box about the circle of its spread."""
    low, high = np.full(2, -1.0), np.full(2, 1.0)
    if emitter.spread < np.pi:
        reach = (p - emitter.position) @ emitter.beam * np.tan(emitter.spread / 2)
        at = emitter.to_local @ (p - emitter.position)
        reach = reach * np.linalg.norm(emitter.to_local, axis=1)
        low, high = np.maximum(low, at - reach), np.minimum(high, at + reach)
    around = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.array([emitter.position + x * emitter.x + y * emitter.y - p for x, y in around])


def solid_angle(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Of a triangle. Van Oosterom & Strackee 1983."""
    a, b, c = (v / np.linalg.norm(v) for v in (a, b, c))
    return 2 * np.arctan2(abs(a @ np.cross(b, c)), 1 + a @ b + b @ c + c @ a)


def of_polygon(corners: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Of a rectangle, corners (4, 3) from p: uniform in solid angle, or in area where it is far or no rectangle."""
    x, y = corners[1] - corners[0], corners[3] - corners[0]
    area, height = area_and_height(x, y, corners[0])
    skew = abs(x @ y) > 1e-4 * np.linalg.norm(x) * np.linalg.norm(y)
    if skew or FAR_RATIO * max(np.linalg.norm(x), np.linalg.norm(y)) < height:
        return t**3 / (area * height)
    return np.full(len(t), 1 / (solid_angle(*corners[:3]) + solid_angle(*corners[[0, 2, 3]])))


def of_triangle(corners: np.ndarray, t: np.ndarray) -> np.ndarray:
    area, height = area_and_height(corners[1] - corners[0], corners[2] - corners[0], corners[0])
    longest = max(np.linalg.norm(corners[i] - corners[i - 1]) for i in range(3))
    if FAR_RATIO * longest < height:
        return 2 * t**3 / (area * height)
    return np.full(len(t), 1 / solid_angle(*corners))


def area_and_height(x: np.ndarray, y: np.ndarray, corner: np.ndarray) -> tuple[float, float]:
    """Of the parallelogram, and of p over its plane."""
    across = np.cross(x, y)
    area = float(np.linalg.norm(across))
    return area, abs(float(corner @ across)) / area


LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def of_world(world: World, wi: np.ndarray) -> np.ndarray:
    """In proportion to the interpolated luminance; in rows, to what sines there are at the middles of the pixels.

    The cells lie between the pixels' middles; those at the poles are half as high, and constant along v in the image.
    """
    assert world.image is not None
    light = world.image.astype(float) @ LUMINANCE
    height, width = light.shape
    v = np.concatenate([[0], (np.arange(height) + 0.5) / height, [1]])
    rows = np.concatenate([light[:1], light, light[-1:]]) * np.sin(np.pi * v)[:, None]
    mean = (rows + np.roll(rows, -1, axis=1)) / 2
    total = np.sum((mean[:-1] + mean[1:]) / 2 * np.diff(v)[:, None]) / width * 2 * np.pi**2
    d = wi @ np.asarray(world.rotation).T
    x = (1 - np.arctan2(d[:, 1], d[:, 0]) / np.pi) / 2 * width - 0.5
    sine = np.hypot(d[:, 0], d[:, 1])
    y = np.arctan2(sine, -d[:, 2]) / np.pi
    row = np.clip(np.searchsorted(v, y, side="right") - 1, 0, height)
    s, r = (x - np.floor(x)), (y - v[row]) / (v[row + 1] - v[row])
    left, right = np.floor(x).astype(int) % width, (np.floor(x).astype(int) + 1) % width
    low, high = ((1 - s) * rows[k, left] + s * rows[k, right] for k in (row, row + 1))
    return ((1 - r) * low + r * high) / (total * sine)
