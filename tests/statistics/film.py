"""Cases of lenses and of pixel filters: points of a plane."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from engine.kernels.camera import generate_ray, pack_camera
from engine.kernels.film.filter import build_filter_table, filter_density, sample_filter
from engine.kernels.jit import kernel
from engine.kernels.registry import Sampler
from engine.scene import Aperture, Camera
from tests.statistics import chi2
from tests.statistics.drawn import Drawn


@kernel
def draw_rays(camera, orthographic, lens, points, u, out):
    """out (n, 8): origin, direction, t_near, t_far"""
    for i in range(len(points)):
        o, d, near, far = generate_ray(camera, orthographic, lens, points[i, 0], points[i, 1], u[i, 0], u[i, 1])
        out[i, 0], out[i, 1], out[i, 2] = o
        out[i, 3], out[i, 4], out[i, 5] = d
        out[i, 6], out[i, 7] = near, far


class Lens(Drawn):
    """Where the rays of one pixel start, in half heights of the lens."""

    extent = 1.02

    def __init__(self, aperture: Aperture) -> None:
        self.aperture, self.name = aperture, f"lens of {aperture.blades} blades, ratio {aperture.ratio:g}"

    def draw(self, count: int, seed: int):
        out = np.empty((count, 8), np.float32)
        packed = pack_camera(Camera(aperture=self.aperture), 200, 100)
        draw_rays(packed, 0, 1, np.full((count, 2), 50, np.float32), chi2.uniforms(count, 2, seed), out)
        points = out[:, :2].astype(float) / self.aperture.radius
        return points, (np.abs(points) < self.extent).all(axis=1)

    def density(self, points: np.ndarray) -> np.ndarray:
        x, y = points[:, 0] * self.aperture.ratio, points[:, 1]
        blades = self.aperture.blades
        if blades < 3:
            return np.where(x * x + y * y < 1, self.aperture.ratio / np.pi, 0)
        # Cycles puts the middle of a side at the angle of rotation.
        middles = self.aperture.rotation + np.arange(blades)[:, None] * 2 * np.pi / blades
        inside = np.all(np.cos(middles) * x + np.sin(middles) * y < np.cos(np.pi / blades), axis=0)
        return np.where(inside, self.aperture.ratio / (blades / 2 * np.sin(2 * np.pi / blades)), 0)


def lenses(entry: Sampler) -> Iterator[chi2.Case]:
    yield from (Lens(replace(entry.example, ratio=ratio)) for ratio in (1.0, 2.0))


@kernel
def draw_filter(table, u, out):
    for i in range(len(u)):
        out[i, 0], out[i, 1] = sample_filter(table, u[i, 0], u[i, 1])


class Filter(Drawn):
    def __init__(self, name: str, width: float) -> None:
        self.filter, self.width, self.name = name, width, f"{name} filter of {width:g} pixels"
        self.extent = 1.05 * float(np.abs(self.draw(1000, 1)[0]).max())

    def draw(self, count: int, seed: int):
        out = np.empty((count, 2), np.float32)
        draw_filter(build_filter_table(self.filter, self.width), chi2.uniforms(count, 2, seed), out)
        return out.astype(float), np.ones(count, bool)

    def density(self, points: np.ndarray) -> np.ndarray:
        return filter_density(self.filter, self.width, points).prod(axis=1)


def filters(entry: Sampler) -> Iterator[chi2.Case]:
    yield from (Filter(entry.example, width) for width in (0.01, 1.5, 10.0))
