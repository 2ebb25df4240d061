"""Drawing into a 3D viewport: a rendered picture, and sentences."""

from __future__ import annotations

import textwrap
import threading

import blf
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ..engine import Picture
from .export import View

TEXT_SIZE = 16.0  # pixels
TEXT_COLUMNS = 80


# By threads that may not free them: the next drawing of any viewport does, or the next that ends.
_dropped: list[gpu.types.GPUTexture] = []


class Drawing:
    """The graphics card's copy of the newest picture."""

    def __init__(self) -> None:
        self._picture: Picture | None = None
        self._texture: gpu.types.GPUTexture | None = None

    def draw(self, picture: Picture, view: View) -> None:
        """Where it belongs in the view's region. A picture of another size, from before a resize, is stretched until
        the next one is there."""
        if picture is not self._picture:
            _dropped.clear()
            self._texture, self._picture = _texture(picture.pixels), picture
        place, cut = placement(picture, view)
        shader = gpu.shader.from_builtin("IMAGE")
        batch = batch_for_shader(
            shader, "TRIS", {"pos": _corners(place), "texCoord": _corners(cut)}, indices=((0, 1, 2), (2, 3, 0))
        )
        gpu.state.blend_set("ALPHA_PREMULT")
        shader.bind()
        shader.uniform_sampler("image", self._texture)
        batch.draw(shader)
        gpu.state.blend_set("NONE")

    def close(self) -> None:
        """On another thread than Blender's own, where there is no graphics context, the texture waits for the next
        drawing of any viewport."""
        if threading.current_thread() is threading.main_thread():
            _dropped.clear()
        elif self._texture is not None:
            _dropped.append(self._texture)
        self._texture = self._picture = None


def _texture(pixels: np.ndarray) -> gpu.types.GPUTexture:
    height, width, channels = pixels.shape
    flat = np.ascontiguousarray(pixels).reshape(-1)
    buffer = gpu.types.Buffer("FLOAT", width * height * channels, flat)
    return gpu.types.GPUTexture((width, height), format="RGBA32F", data=buffer)


def placement(picture: Picture, view: View) -> tuple[tuple, tuple]:
    """(the rectangle of the region that a picture fills, the part of the picture that goes there), each as x0, y0, x1,
    y1; in pixels and in [0, 1]. A coarse picture reaches beyond what was rendered: that is cut off."""
    place, cut = [], []
    for axis, size in ((0, view.width), (1, view.height)):
        scale = size / picture.size[axis]
        low, high = picture.region[axis] * scale, picture.region[axis + 2] * scale
        first, last = max(low, view.region[axis]), min(high, view.region[axis + 2])
        place.append((first, last))
        cut.append(((first - low) / (high - low), (last - low) / (high - low)))
    (x0, x1), (y0, y1) = place
    (u0, u1), (v0, v1) = cut
    return (x0, y0, x1, y1), (u0, v0, u1, v1)


def _corners(rectangle: tuple) -> tuple:
    x0, y0, x1, y1 = rectangle
    return (x0, y0), (x1, y0), (x1, y1), (x0, y1)


def message(region, text: str) -> None:
    """Write `text` into the middle of the region."""
    blf.size(0, TEXT_SIZE)
    blf.color(0, 0.9, 0.9, 0.9, 1.0)
    lines = textwrap.wrap(text, TEXT_COLUMNS)
    for number, line in enumerate(lines):
        width, _ = blf.dimensions(0, line)
        blf.position(0, (region.width - width) / 2.0, region.height / 2.0 - 1.5 * TEXT_SIZE * number, 0.0)
        blf.draw(0, line)
