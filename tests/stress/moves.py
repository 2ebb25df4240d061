"""The same scene elsewhere: moved, scaled, mirrored. And what two pictures of one scene may differ by.

Every function gives a new `engine.Scene`; meshes and images are shared with the old one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

import engine
import engine.scene
from engine.result import Result
from engine.scene import Camera, Lamp, PointLight, Scene
from engine.settings import Settings

QUANTILE = float(stats.norm.isf(0.5e-5))  # one comparison in 1e5 fails though all is right
ROUNDING = 2e-5  # relative: float32 at other coordinates


def scaled(scene: Scene, factor: float) -> Scene:
    """Everything `factor` times as large, and lamps so bright that the picture stays the same."""
    return _mapped(scene, lambda m: m * factor, factor)


def moved(scene: Scene, by) -> Scene:
    """Everything moved by `by` (3,), metres."""
    offset = np.column_stack([np.zeros((3, 3)), by])
    return _mapped(scene, lambda m: m + offset, 1.0)


def baked_at(scene: Scene, by) -> Scene:
    """Everything moved by `by`, meshes with their vertices: float32 there, so that shapes lose digits."""
    meshes = []
    for mesh in scene.meshes:
        meshes.append(replace(mesh, vertices=(mesh.vertices + np.asarray(by)).astype(np.float32)))
    out = moved(scene, by)
    out.meshes = meshes
    # M (v + by) + t = M v + t + by
    linear = scene.instances.transforms[:, :, :3]
    transforms = scene.instances.transforms.copy()
    transforms[:, :, 3] += np.asarray(by) - linear @ np.asarray(by)
    out.instances = replace(scene.instances, transforms=transforms)
    return out


def rounded_at(scene: Scene, by) -> Scene:
    """What `baked_at` makes of the shapes, back at the origin: the differences of such float32 numbers are exact."""
    out = replace(scene)
    by = np.asarray(by)
    out.meshes = [
        replace(m, vertices=((m.vertices + by).astype(np.float32) - by).astype(np.float32)) for m in scene.meshes
    ]
    return out


def turned(scene: Scene, turn: np.ndarray) -> Scene:
    """Everything turned by a rotation (3, 3). For worlds that are alike from all sides."""
    return _mapped(scene, lambda m: turn @ m, 1.0)


MIRROR = np.diag([-1.0, 1.0, 1.0])


def mirrored(scene: Scene) -> Scene:
    """The whole world in a mirror at x = 0: its picture is the old one from right to left."""
    out = _mapped(scene, lambda m: MIRROR @ m, 1.0)
    assert out.camera is not None
    out.camera = _right_handed(out.camera)
    if scene.world.image is not None:
        # Mirrored in y as well, where the image's columns run backwards, the rotation stays one.
        rotation = np.diag([1.0, -1.0, 1.0]) @ scene.world.rotation @ MIRROR
        out.world = replace(scene.world, image=np.ascontiguousarray(scene.world.image[:, ::-1]), rotation=rotation)
    return out


def _right_handed(camera: Camera) -> Camera:
    """A mirrored camera as one that sees the same from right to left."""
    transform = camera.transform.copy()
    transform[:, 0] *= -1
    left, right, bottom, top = camera.window
    aperture = camera.aperture
    if aperture is not None:
        aperture = replace(aperture, rotation=np.pi - aperture.rotation)
    return replace(camera, transform=transform, window=(-right, -left, bottom, top), aperture=aperture)


def _mapped(scene: Scene, change: Callable[[np.ndarray], np.ndarray], factor: float) -> Scene:
    out = replace(scene)
    out.instances = replace(scene.instances, transforms=change(scene.instances.transforms))
    assert scene.camera is not None
    out.camera = _camera(scene.camera, change, factor)
    out.lights = [_lamp(light, change, factor) for light in scene.lights]
    return out


def _camera(camera: Camera, change, factor: float) -> Camera:
    window = tuple(x * factor for x in camera.window) if camera.orthographic else camera.window
    aperture = camera.aperture
    if aperture is not None:
        aperture = replace(aperture, radius=aperture.radius * factor, focus_distance=aperture.focus_distance * factor)
    return replace(
        camera, transform=change(camera.transform), window=window, aperture=aperture,
        clip_start=camera.clip_start * factor, clip_end=camera.clip_end * factor,
    )  # fmt: skip


def _lamp(light: Lamp, change, factor: float) -> Lamp:
    light = replace(light, transform=change(light.transform))
    if isinstance(light, PointLight):
        intensity = tuple(x * factor**2 for x in light.intensity)
        light = replace(light, radius=light.radius * factor, intensity=intensity)
    return light


def render(scene: Scene, **settings) -> np.ndarray:
    """(h, w, 3) float64. Fails for anything that is not a finite, non-negative number, and for rejected samples."""
    result = rendered(scene, **settings)
    problem = faults(result)
    assert not problem, problem
    return picture(result)


def rendered(scene: Scene, **settings) -> Result:
    return engine.render(scene, Settings(**{"samples": 64, "pixel_filter": "BOX", "threads": 2, **settings}))


def picture(result: Result) -> np.ndarray:
    """(h, w, 3) float64."""
    return result.pixels[..., :3].astype(np.float64)


def faults(result: Result) -> str:
    """What no picture may have, whatever it shows; nothing if all is well."""
    if result.rejected:
        return f"{result.rejected} samples were not finite"
    if not np.isfinite(result.pixels).all():
        return "pixels are not finite"
    return f"darker than black: {result.pixels.min():g}" if (result.pixels < 0).any() else ""


@dataclass
class Difference:
    """Of two pictures' means, relative to the second: (3,), and the half width of its confidence interval."""

    mean: np.ndarray
    half_width: np.ndarray

    def __str__(self) -> str:
        return f"{np.abs(self.mean).max():.2g} +- {self.half_width.max():.2g}"

    def holds(self, slack: float = ROUNDING) -> bool:
        return bool(np.all(np.abs(self.mean) <= self.half_width + slack))


def difference(a: np.ndarray, b: np.ndarray) -> Difference:
    """Paired by pixel: the same random numbers make both, and pixels share none. Where the paths are the same, the
    interval is as narrow as float32 allows."""
    d = (a - b).reshape(-1, 3)
    mean = b.reshape(-1, 3).mean(axis=0)
    scale = np.where(mean > 0, mean, 1.0)  # nothing is relative to black
    return Difference(d.mean(axis=0) / scale, QUANTILE * d.std(axis=0, ddof=1) / np.sqrt(len(d)) / scale)
