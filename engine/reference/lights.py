"""Everything that emits, seen from batches of n points.

Each emitter answers two questions. `sample`: draw a direction `wi` (n, 3) towards it. `meet`: what does a ray that
leaves `point` along `wi` see of it, and with which density (per steradian) would `sample` have drawn `wi`? Sampling
ends by asking `meet`, so that the two densities cannot drift apart. Emitters of no size (`delta`) are never met.

`normal` is the shading normal at `point`; only emitters that surround the point make use of it. The distance says
where the light comes from, infinite for the sun and the world. Radiance in W/(m2 sr); for `delta` emitters it stands
for the irradiance on a plane that faces them.
"""

from __future__ import annotations

import numpy as np

from ..scene import AreaLight, Lamp, PointLight, SpotLight, SunLight, Visibility, World
from .geometry import Geometry, areas
from .vectors import around, cone, disk, dot, length, random_angle, unit

Seen = tuple[np.ndarray, np.ndarray, np.ndarray]  # distance (n,), radiance (n, 3), density (n,)
Drawn = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # the direction (n, 3), and what is seen there


class Emitter:
    """`power`: watts, roughly; it decides how often the emitter is chosen."""

    delta = False
    power = 0.0

    def __init__(self, visibility: Visibility, cast_shadow: bool = True) -> None:
        self.visibility = visibility
        self.cast_shadow = cast_shadow

    def draw(self, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        raise NotImplementedError

    def meet(self, point: np.ndarray, normal: np.ndarray, wi: np.ndarray) -> Seen:
        raise NotImplementedError

    def sample(self, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> Drawn:
        wi = self.draw(point, normal, rng)
        return wi, *self.meet(point, normal, wi)


class Lit(Emitter):
    """A lamp: reads its place. Its beam goes along local -z; `axis` is its +z."""

    def __init__(self, lamp: Lamp) -> None:
        super().__init__(lamp.visibility, lamp.cast_shadow)
        matrix = np.asarray(lamp.transform, np.float64)
        self.axes, self.position = matrix[:, :3], matrix[:, 3]


class Point(Lit):
    """A point, a sphere, or a disk that faces whoever looks at it; a spot if the lamp is one."""

    def __init__(self, lamp: PointLight) -> None:
        super().__init__(lamp)
        self.intensity = np.array(lamp.intensity, np.float64)
        self.radius = lamp.radius
        self.spot = lamp if isinstance(lamp, SpotLight) else None
        self.is_disk = lamp.soft_falloff
        self.delta = lamp.radius == 0
        opening = 2 * np.sin(lamp.half_angle / 2) ** 2 if isinstance(lamp, SpotLight) else 2
        self.power = 2 * np.pi * opening * self.intensity.mean()
        self.to_local = np.linalg.pinv(self.axes)

    def _dimmed(self, wi: np.ndarray) -> np.ndarray:
        """(n,) the spot's factor for light that travels along -wi; the cone is round in the lamp's own space."""
        if self.spot is None:
            return np.ones(len(wi))
        cosine = unit(wi @ self.to_local.T)[:, 2]
        edge = np.cos(self.spot.half_angle)
        s = np.clip((cosine - edge) / max((1 - edge) * self.spot.blend, 1e-12), 0, 1)
        return s * s * (3 - 2 * s)

    def sample(self, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> Drawn:
        if not self.delta:
            return super().sample(point, normal, rng)
        offset = self.position - point
        distance2 = np.maximum(dot(offset, offset), 1e-30)
        wi = unit(offset)
        irradiance = self.intensity * (self._dimmed(wi) / distance2)[:, None]
        return wi, np.sqrt(distance2), irradiance, np.ones(len(wi))

    def draw(self, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        to_centre = self.position - point
        axis = unit(to_centre)
        if self.is_disk:
            x, y = disk(len(point), rng)
            return unit(to_centre + self.radius * around(axis, np.column_stack([x, y, np.zeros_like(x)])))
        one_minus_cos, inside = self._cone(point)
        wi = around(axis, cone(len(point), one_minus_cos, rng))
        wi[inside] = around(normal[inside], _cosine_lobe(np.count_nonzero(inside), rng))
        return wi

    def meet(self, point: np.ndarray, normal: np.ndarray, wi: np.ndarray) -> Seen:
        to_centre = self.position - point
        radiance = self.intensity / (np.pi * self.radius**2)
        if self.is_disk:
            axis = unit(to_centre)
            cosine = dot(axis, wi)
            distance = length(to_centre) / np.maximum(cosine, 1e-12)
            off = wi * distance[:, None] - to_centre
            hit = (cosine > 0) & (dot(off, off) <= self.radius**2)
            density = distance**2 / (np.maximum(cosine, 1e-12) * np.pi * self.radius**2)
            dimmed = self._dimmed(wi)
        else:
            along = dot(to_centre, wi)
            off = to_centre - along[:, None] * wi
            half_chord2 = self.radius**2 - dot(off, off)
            one_minus_cos, inside = self._cone(point)
            half_chord = np.sqrt(np.maximum(half_chord2, 0))
            distance = np.where(inside, along + half_chord, along - half_chord)
            hit = (half_chord2 >= 0) & (distance > 0)
            cosine = np.maximum(dot(normal, wi), 0)
            density = np.where(inside, cosine / np.pi, 1 / (2 * np.pi * np.maximum(one_minus_cos, 1e-300)))
            dimmed = np.where(inside, 1, self._dimmed(wi))
        return distance, radiance * (hit * dimmed)[:, None], density * hit

    def _cone(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """1 - cos of the half-angle of the sphere, and whether the point lies inside it."""
        offset = self.position - point
        sine2 = self.radius**2 / np.maximum(dot(offset, offset), 1e-300)
        inside = sine2 >= 1
        sine2 = np.minimum(sine2, 1)
        return sine2 / (1 + np.sqrt(1 - sine2)), inside


class Area(Lit):
    """A rectangle or an ellipse, drawn uniformly by area, that shines to one side."""

    def __init__(self, lamp: AreaLight) -> None:
        super().__init__(lamp)
        self.x, self.y = self.axes[:, 0] * lamp.size_x / 2, self.axes[:, 1] * lamp.size_y / 2
        self.ellipse, self.spread = lamp.ellipse, lamp.spread
        across = np.cross(self.x, self.y)
        self.area = float(np.linalg.norm(across)) * (np.pi if lamp.ellipse else 4)
        self.to_local = np.linalg.pinv(np.column_stack([self.x, self.y]))
        # Light leaves along local -z, also if the lamp is mirrored.
        self.beam = unit(-across if np.linalg.det(self.axes) >= 0 else across)
        self.radiance = np.array(lamp.radiance, np.float64)
        self.power = np.pi * self.area * self.radiance.mean()

    def draw(self, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        x, y = disk(len(point), rng) if self.ellipse else rng.uniform(-1, 1, (2, len(point)))
        return unit(self.position + x[:, None] * self.x + y[:, None] * self.y - point)

    def meet(self, point: np.ndarray, normal: np.ndarray, wi: np.ndarray) -> Seen:
        cosine = -(wi @ self.beam)
        towards = (cosine > 0) & (self.area > 0)
        distance = np.where(towards, ((self.position - point) @ -self.beam) / np.where(towards, cosine, 1), -1)
        inplane = point + wi * distance[:, None] - self.position
        x, y = self.to_local @ inplane.T
        # The rim is widened by a rounding error: a direction that was drawn on it must meet it again.
        rim = 1 + 1e-9
        within = x * x + y * y <= rim if self.ellipse else (np.abs(x) <= rim) & (np.abs(y) <= rim)
        hit = towards & within & (distance > 0)
        density = distance**2 / (np.where(towards, cosine, 1) * max(self.area, 1e-300))
        return distance, self.radiance * (hit * self._spread(cosine))[:, None], density * hit

    def _spread(self, cosine: np.ndarray) -> np.ndarray:
        """(n,) what a grid of slats in front of the lamp lets through (Cycles, D10594)."""
        half = self.spread / 2
        if half >= np.pi / 2:
            return np.ones_like(cosine)
        cosine = np.clip(cosine, 1e-9, 1)
        tangent = np.sqrt(1 - cosine**2) / cosine
        norm = half**3 / 3 * (1 + 0.4 * half**2) if half < 1e-3 else np.tan(half) - half
        return np.maximum(np.tan(half) - tangent, 0) / norm


class Sun(Lit):
    """Light from one direction, or from a uniform cone of them."""

    def __init__(self, lamp: SunLight, scene_radius: float) -> None:
        super().__init__(lamp)
        self.towards = unit(self.axes[:, 2])
        self.irradiance = np.array(lamp.irradiance, np.float64)
        self.delta = lamp.angle == 0
        self.one_minus_cos = 2 * np.sin(lamp.angle / 4) ** 2
        self.solid_sine2 = np.sin(lamp.angle / 2) ** 2
        self.power = np.pi * scene_radius**2 * self.irradiance.mean()

    def draw(self, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return around(self.towards, cone(len(point), self.one_minus_cos, rng))

    def sample(self, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> Drawn:
        if not self.delta:
            return super().sample(point, normal, rng)
        n = len(point)
        wi = np.broadcast_to(self.towards, (n, 3))
        return wi, np.full(n, np.inf), np.broadcast_to(self.irradiance, (n, 3)), np.ones(n)

    def meet(self, point: np.ndarray, normal: np.ndarray, wi: np.ndarray) -> Seen:
        off = wi - self.towards
        hit = dot(off, off) / 2 <= self.one_minus_cos * (1 + 1e-9)
        radiance = self.irradiance / (np.pi * self.solid_sine2)
        density = np.full(len(wi), 1 / (2 * np.pi * self.one_minus_cos))
        return np.full(len(wi), np.inf), radiance * hit[:, None], density * hit


class ConstantWorld(Emitter):
    """The same radiance from everywhere, drawn in proportion to the cosine at the surface."""

    def __init__(self, world: World, scene_radius: float) -> None:
        super().__init__(world.visibility)
        self.color = np.array(world.color, np.float64)
        self.power = 4 * np.pi**2 * scene_radius**2 * self.color.mean()

    def draw(self, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return around(normal, _cosine_lobe(len(point), rng))

    def meet(self, point: np.ndarray, normal: np.ndarray, wi: np.ndarray) -> Seen:
        n = len(wi)
        return np.full(n, np.inf), np.broadcast_to(self.color, (n, 3)), np.maximum(dot(normal, wi), 0) / np.pi


class ImageWorld(Emitter):
    """An equirectangular image: a pixel is drawn by its brightness and its solid angle, then a point within it."""

    def __init__(self, world: World, scene_radius: float) -> None:
        super().__init__(world.visibility)
        assert world.image is not None
        self.image = world.image.astype(np.float64) * np.array(world.color, np.float64)
        self.rotation = np.asarray(world.rotation, np.float64)
        height, width, _ = self.image.shape

        # A lookup mixes four pixels: the density of a pixel must not vanish where a neighbour shines into it.
        brightness = np.abs(self.image).mean(axis=2)
        rows = np.pad(brightness, ((1, 1), (0, 0)), mode="edge")
        brightness = rows[:-2] + rows[1:-1] + rows[2:]
        brightness = brightness + np.roll(brightness, 1, axis=1) + np.roll(brightness, -1, axis=1)
        sine = np.sin((np.arange(height) + 0.5) * np.pi / height)
        weight = brightness * sine[:, None]
        total = weight.sum()
        self.share = weight / total if total > 0 else np.full_like(weight, 1 / weight.size)
        self.cdf = np.cumsum(self.share.ravel())
        mean = (self.image.mean(axis=2) * sine[:, None]).sum() / (sine.sum() * width)
        self.power = 4 * np.pi**2 * scene_radius**2 * mean

    def draw(self, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        height, width = self.share.shape
        pixel = np.searchsorted(self.cdf, rng.random(len(point)) * self.cdf[-1], side="right")
        row, column = np.divmod(np.minimum(pixel, self.share.size - 1), width)
        u = (column + rng.random(len(point))) / width
        v = (row + rng.random(len(point))) / height
        phi, theta = (1 - 2 * u) * np.pi, v * np.pi
        local = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)])
        return local @ self.rotation

    def meet(self, point: np.ndarray, normal: np.ndarray, wi: np.ndarray) -> Seen:
        local = wi @ self.rotation.T
        height, width = self.share.shape
        u = (1 - np.arctan2(local[:, 1], local[:, 0]) / np.pi) / 2
        v = np.arccos(np.clip(-local[:, 2], -1, 1)) / np.pi
        column = np.minimum((u * width).astype(int), width - 1)
        row = np.minimum((v * height).astype(int), height - 1)
        sine = np.maximum(np.sqrt(np.maximum(1 - local[:, 2] ** 2, 0)), 1e-9)
        density = self.share[row, column] * self.share.size / (2 * np.pi**2 * sine)
        return np.full(len(wi), np.inf), self._lookup(u, v), density

    def _lookup(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(n, 3) bilinear; wraps around in u, ends in v."""
        height, width, _ = self.image.shape
        x, y = u * width - 0.5, np.clip(v * height - 0.5, 0, height - 1)
        left, low = np.floor(x).astype(int), np.floor(y).astype(int)
        s, t = (x - left)[:, None], (y - low)[:, None]
        right, left, high = (left + 1) % width, left % width, np.minimum(low + 1, height - 1)
        bottom = self.image[low, left] * (1 - s) + self.image[low, right] * s
        top = self.image[high, left] * (1 - s) + self.image[high, right] * s
        return bottom * (1 - t) + top * t


class MeshLight(Emitter):
    """All triangles that emit, chosen by area and radiance, each uniform by area. They shine to both sides.

    Rays meet them as geometry, so there is no `meet`: the integrator asks for `density` where a ray ends on one.
    """

    def __init__(self, geometry: Geometry, emission: np.ndarray) -> None:
        super().__init__(Visibility.ALL)
        self.geometry, self.emission = geometry, emission
        watts = 2 * np.pi * areas(geometry.corners) * emission[geometry.material].mean(axis=1)
        watts = np.where(geometry.visibility & (Visibility.DIFFUSE | Visibility.GLOSSY), watts, 0)
        self.power = float(watts.sum())
        self.triangles = np.flatnonzero(watts > 0)
        # Per square metre: the chance of a triangle over its area.
        self.density_area = watts / np.maximum(areas(geometry.corners), 1e-300) / max(self.power, 1e-300)
        self.cdf = np.cumsum(watts[self.triangles])

    def density(self, triangle: np.ndarray, distance: np.ndarray, wi: np.ndarray) -> np.ndarray:
        cosine = np.abs(dot(self.geometry.flat[triangle], wi))
        return self.density_area[triangle] * distance**2 / np.maximum(cosine, 1e-12)

    def sample_triangles(self, point: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, Drawn]:
        """The triangles chosen (n,), and what is seen there."""
        n = len(point)
        index = np.searchsorted(self.cdf, rng.random(n) * self.cdf[-1], side="right")
        triangle = self.triangles[np.minimum(index, len(self.triangles) - 1)]
        s, t = np.sqrt(rng.random(n)), rng.random(n)
        weights = np.column_stack([1 - s, s * (1 - t), s * t])
        offset = np.einsum("nk,nki->ni", weights, self.geometry.corners[triangle]) - point
        distance, wi = length(offset), unit(offset)
        radiance = self.emission[self.geometry.material[triangle]]
        return triangle, (wi, distance, radiance, self.density(triangle, distance, wi))


def make_lamp(lamp: Lamp, scene_radius: float) -> Emitter:
    if isinstance(lamp, PointLight):
        return Point(lamp)
    if isinstance(lamp, AreaLight):
        return Area(lamp)
    assert isinstance(lamp, SunLight)
    return Sun(lamp, scene_radius)


def make_world(world: World, scene_radius: float) -> Emitter:
    return ConstantWorld(world, scene_radius) if world.image is None else ImageWorld(world, scene_radius)


def _cosine_lobe(count: int, rng: np.random.Generator) -> np.ndarray:
    u = rng.random(count)
    x, y = random_angle(count, rng)
    return np.column_stack([np.sqrt(u) * x, np.sqrt(u) * y, np.sqrt(1 - u)])
