"""Pictures of a comparison: from Blender's Render Result to arrays, as one sees them, as maps, and as PNG files."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from ..render_slots import render_result

GAP = 8  # pixels between the three pictures of the strip
RANGES = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # of the difference map, relative
OUTSIDE = 0.01  # the share of pixels that may lie beyond the map's range
# Stops of the maps' colours. The difference: Cycles brighter, equal, Lobe brighter. FLIP: alike to different.
SIGNS = ("#2166ac", "#67a9cf", "#f4f4f2", "#ef8a62", "#b2182b")
MAGMA = ("#000004", "#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#fcfdbf")


def rendered(scene, prefix: str = "lobe-") -> tuple[np.ndarray, dict]:
    """The Render Result: (h, w, 4) float32, row 0 at the top, scene-linear, premultiplied alpha; and its metadata.

    Through an uncompressed file: exact, and at 1920x1080 a tenth of the time of reading a Viewer node's pixels.
    prefix: of a folder in Blender's temporary one. Raises RuntimeError.
    """
    import OpenImageIO as oiio

    with _saved(scene, prefix, "OPEN_EXR", "RGBA", "32", exr_codec="NONE") as path:
        buffer = oiio.ImageBuf(path)
        pixels = buffer.get_pixels(oiio.FLOAT)
        if pixels is None or pixels.size == 0:
            raise RuntimeError(f"the rendered picture could not be read: {buffer.geterror()}")
        metadata = {attribute.name: attribute.value for attribute in buffer.spec().extra_attribs}
    return np.asarray(pixels, np.float32), metadata


def seen(scene) -> np.ndarray:
    """The Render Result through the scene's view transform: (h, w, 3) uint8, row 0 at the top."""
    import OpenImageIO as oiio

    with _saved(scene, "lobe-", "PNG", "RGB", "8", compression=0) as path:
        return np.asarray(oiio.ImageBuf(path).get_pixels(oiio.UINT8))[..., :3]


@contextlib.contextmanager
def _saved(scene, prefix: str, file_format: str, mode: str, depth: str, **others) -> Iterator[str]:
    """The path of a file with the Render Result, for the while."""
    others["color_management"] = "FOLLOW_SCENE"  # not a colour space of the output's own
    folder_in_blenders = tempfile.TemporaryDirectory(dir=bpy.app.tempdir, prefix=prefix)
    with folder_in_blenders as folder, image_settings(scene, file_format, mode, depth, **others):
        path = str(Path(folder, "picture." + ("png" if file_format == "PNG" else "exr")))
        image = render_result()
        if image is None:
            raise RuntimeError("nothing has been rendered")
        image.save_render(path, scene=scene)
        yield path


@contextlib.contextmanager
def image_settings(scene, file_format: str, mode: str, depth: str, **others) -> Iterator[None]:
    """Blender's output format, for the while."""
    settings = scene.render.image_settings
    wanted = {"file_format": file_format, "color_mode": mode, "color_depth": depth, **others}
    if hasattr(settings, "media_type"):  # 5.0 and later; decides which formats there are
        wanted = {"media_type": "IMAGE", **wanted}
    before = {key: getattr(settings, key) for key in wanted}
    try:
        for key, value in wanted.items():
            setattr(settings, key, value)
        yield
    finally:
        for key, value in before.items():
            setattr(settings, key, value)


def png(pixels: np.ndarray) -> bytes:
    """(h, w, 3) uint8 as the bytes of a PNG file."""
    import OpenImageIO as oiio

    height, width, channels = pixels.shape
    with tempfile.TemporaryDirectory(dir=bpy.app.tempdir) as folder:
        path = Path(folder, "picture.png")
        output = oiio.ImageOutput.create(str(path))
        spec = oiio.ImageSpec(width, height, channels, "uint8")
        if not output.open(str(path), spec) or not output.write_image(np.ascontiguousarray(pixels)):
            raise RuntimeError(f"a picture cannot be written: {output.geterror()}")
        output.close()
        return path.read_bytes()


def relative_difference(lobe: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """(2, h, w, 3) renders of each to (h, w): Lobe's less Cycles', relative as relMSE is."""
    a, b = (pair.mean(axis=(0, 3), dtype=np.float64) for pair in (lobe, cycles))
    return (a - b) / np.sqrt(((a + b) / 2.0) ** 2 + 0.01)


def map_range(difference: np.ndarray) -> float:
    """The smallest of RANGES that holds nearly all pixels of the map."""
    largest = np.quantile(np.abs(difference), 1.0 - OUTSIDE)
    return next((end for end in RANGES if largest <= end), RANGES[-1])


def colored(values: np.ndarray, low: float, high: float, stops: tuple[str, ...]) -> np.ndarray:
    """(h, w) to (h, w, 3) uint8, evenly through the stops from `low` to `high`."""
    colors = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in stops], float)
    at = np.clip((values - low) / (high - low), 0.0, 1.0) * (len(stops) - 1)
    channels = [np.interp(at, np.arange(len(stops)), colors[:, i]) for i in range(3)]
    return (np.stack(channels, axis=-1) + 0.5).astype(np.uint8)


def strip(*pictures: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 pictures side by side."""
    gap = np.full((pictures[0].shape[0], GAP, 3), 32, np.uint8)
    parts = [part for picture in pictures for part in (gap, picture)]
    return np.concatenate(parts[1:], axis=1)
