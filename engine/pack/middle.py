"""Where float32 has its digits: far scenes are moved to the world's origin, and tiny ones enlarged, before packing.

Both are done in float64 on the transforms, so that the kernels calculate with coordinates about as large as the
scene's own extent, wherever it stands and whatever its unit. The picture is the same: nothing in it depends on
absolute places, and radiance on no length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..scene import Camera, Instances, Lamp, PointLight, Scene
from .geometry import CHUNK

# A scene whose middle lies farther from the origin than this part of its size gains digits by a move.
FAR_OFF = 2.0
# Metres. Below, products of a few lengths leave float32.
SMALLEST_SCENE = 1e-2
MOST_ENLARGED = 2.0**60  # so that what lies metres away, a lamp, keeps to numbers that float32 can square


class Move(NamedTuple):
    """To coordinates that suit float32: by -middle, then scaled by the factor."""

    factor: float = 1.0
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def scene(self, scene: Scene) -> Scene:
        """`scene` itself where it stays, or the same elsewhere. Meshes and images are shared."""
        if self == STAY:
            return scene
        assert scene.camera is not None
        return replace(
            scene,
            instances=_instances(scene.instances, *self),
            camera=self.camera(scene.camera),
            lights=[_lamp(light, *self) for light in scene.lights],
        )

    def camera(self, camera: Camera) -> Camera:
        return camera if self == STAY else _camera(camera, *self)


STAY = Move()


def to_the_middle(scene: Scene) -> Scene:
    """`scene` itself, or the same in coordinates that suit float32. Meshes and images are shared."""
    return move_of(scene).scene(scene)


def move_of(scene: Scene) -> Move:
    """What brings the scene's surfaces to the middle."""
    bounds = surface_bounds(scene)
    if bounds is None:
        return STAY
    size, middle = (bounds[1] - bounds[0]).max(), bounds.mean(axis=0)
    factor = 1.0 if size >= SMALLEST_SCENE or size == 0 else min(2.0 ** -np.floor(np.log2(size)), MOST_ENLARGED)
    far = np.abs(middle).max() > FAR_OFF * size
    x, y, z = middle if far else np.zeros(3)
    return Move(float(factor), (float(x), float(y), float(z)))


def surface_bounds(scene: Scene) -> np.ndarray | None:
    """(2, 3) float64, of the boxes of all instances; of the lamps where there are none; None for neither."""
    instances = scene.instances
    if not len(instances):
        return None
    boxes = np.array([mesh.bounds() for mesh in scene.meshes], np.float64)
    # Axis by axis, in parts whose temporaries fit the cache: numpy is slow on rows of three.
    middles, halves = boxes.mean(axis=1).T.copy(), np.ptp(boxes, axis=1).T / 2
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for first in range(0, len(instances), CHUNK):
        rows = slice(first, first + CHUNK)
        mesh, columns = instances.mesh[rows], instances.transforms[rows].reshape(-1, 12).T.copy().reshape(3, 4, -1)
        middle, half = middles[:, mesh], halves[:, mesh]
        for axis, (x, y, z, origin) in enumerate(columns):
            center = x * middle[0] + y * middle[1] + z * middle[2] + origin
            reach = np.abs(x) * half[0] + np.abs(y) * half[1] + np.abs(z) * half[2]
            low[axis] = min(low[axis], (center - reach).min())
            high[axis] = max(high[axis], (center + reach).max())
    return np.array([low, high])


def _moved(transforms: np.ndarray, factor: float, middle: Sequence[float]) -> np.ndarray:
    """transforms (..., 3, 4)."""
    out = np.array(transforms, np.float64)
    out[..., 3] -= middle
    return out * factor


def _instances(instances: Instances, factor: float, middle: Sequence[float]) -> Instances:
    return replace(instances, transforms=_moved(instances.transforms, factor, middle))


def _camera(camera: Camera, factor: float, middle: Sequence[float]) -> Camera:
    lens, window = camera.aperture, camera.window
    if lens is not None:
        lens = replace(lens, radius=lens.radius * factor, focus_distance=lens.focus_distance * factor)
    if camera.orthographic:
        left, right, bottom, top = window
        window = left * factor, right * factor, bottom * factor, top * factor
    return replace(
        camera,
        transform=_moved(camera.transform, factor, middle),
        window=window,
        clip_start=camera.clip_start * factor,
        clip_end=camera.clip_end * factor,
        aperture=lens,
    )


def _lamp(lamp: Lamp, factor: float, middle: Sequence[float]) -> Lamp:
    """Radiance and irradiance stay; intensity is radiance times an area."""
    lamp = replace(lamp, transform=_moved(lamp.transform, factor, middle))
    if not isinstance(lamp, PointLight):
        return lamp
    red, green, blue = (value * factor**2 for value in lamp.intensity)
    return replace(lamp, radius=lamp.radius * factor, intensity=(red, green, blue))
