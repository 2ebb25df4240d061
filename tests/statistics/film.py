"""Cases of lenses and of pixel filters: points of a plane."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from engine import Settings
from engine.kernels.camera import generate_ray, pack_camera
from engine.kernels.film.filter import build_filter_table, filter_density, sample_filter
from engine.kernels.jit import kernel
from engine.kernels.registry import Sampler
from engine.reference.camera import camera_rays, filter_offsets
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


WIDTH, HEIGHT = 200, 100  # pixels


class Lens(Drawn):
    """Where the rays of one pixel start, in half heights of the lens."""

    extent = 1.02

    def __init__(self, aperture: Aperture, orthographic: bool = False, reference: bool = False) -> None:
        self.aperture, self.reference = aperture, reference
        self.camera = Camera(aperture=aperture, orthographic=orthographic)
        self.name = f"lens of {aperture.blades} blades, ratio {aperture.ratio:g}"
        self.name += ", orthographic" * orthographic + ", reference" * reference

    def rays(self, points: np.ndarray, seed: int) -> np.ndarray:
        """(n, 8): origin, direction, t_near, t_far of rays through these points of the picture."""
        if self.reference:
            rays = camera_rays(self.camera, points, (WIDTH, HEIGHT), np.random.default_rng(seed))
            return np.column_stack(rays)
        out, u = np.empty((len(points), 8), np.float32), chi2.uniforms(len(points), 2, seed)
        packed = pack_camera(self.camera, WIDTH, HEIGHT)
        draw_rays(packed, int(self.camera.orthographic), 1, np.asarray(points, np.float32), u, out)
        return out.astype(float)

    def draw(self, count: int, seed: int):
        middle = np.tile([WIDTH / 2, HEIGHT / 2], (count, 1))
        points = self.rays(middle, seed)[:, :2] / self.aperture.radius
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
    for ratio in (1.0, 2.0):
        yield Lens(replace(entry.example, ratio=ratio))
        yield Lens(replace(entry.example, ratio=ratio), reference=True)
    yield Lens(replace(entry.example, rotation=1.1), orthographic=True)


@kernel
def draw_filter(table, u, out):
    for i in range(len(u)):
        out[i, 0], out[i, 1] = sample_filter(table, u[i, 0], u[i, 1])


class Filter(Drawn):
    def __init__(self, name: str, width: float, reference: bool = False) -> None:
        self.filter, self.width, self.reference = name, width, reference
        self.name = f"{name} filter of {width:g} pixels" + ", reference" * reference
        self.table = build_filter_table(name, width)
        # Where the box ends lies an edge of the grid.
        self.extent = 0.5 * chi2.PLANE_CELLS / 16 if name == "BOX" else 1.02 * width

    def draw(self, count: int, seed: int):
        if self.reference:
            settings = Settings(pixel_filter=self.filter, filter_width=self.width)
            return filter_offsets(settings, count, np.random.default_rng(seed)), np.ones(count, bool)
        out = np.empty((count, 2), np.float32)
        draw_filter(self.table, chi2.uniforms(count, 2, seed), out)
        return out.astype(float), np.ones(count, bool)

    def density(self, points: np.ndarray) -> np.ndarray:
        return filter_density(self.filter, self.width, points).prod(axis=1)


def filters(entry: Sampler) -> Iterator[chi2.Case]:
    for width in (0.01, 1.5, 10.0):
        yield from (Filter(entry.example, width, reference) for reference in (False, True))
