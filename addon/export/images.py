"""Pixels of Blender's images: read from their files with OpenImageIO, or from Blender where there is no file.

Pixels come out scene-linear, row 0 at the bottom. Missing files give None: the caller draws them magenta, as Blender
does, and names them.
"""

from __future__ import annotations

import os
from typing import NamedTuple

import bpy
import numpy as np

from .stop import Stop
from .units import srgb_to_linear

MISSING = (1.0, 0.0, 1.0)

# Colour spaces whose pixels are scene-linear already, or are no colours at all.
LINEAR_SPACES = {"Linear", "Linear Rec.709", "Non-Color", "Raw", "Generic Data", "scene_linear", ""}
SRGB_SPACES = {"sRGB"}


class Pixels(NamedTuple):
    """color : (H, W, 3) float32, scene-linear, not multiplied with alpha; alpha : (H, W) float32 or None."""

    color: np.ndarray
    alpha: np.ndarray | None


class Images:
    """The images of one export, each read once. `notes` hears of colour spaces that could not be honoured."""

    def __init__(self, notes, stop: Stop) -> None:
        self._notes = notes
        self._stop = stop
        self._pixels: dict = {}
        self._averages: dict = {}

    def pixels(self, node) -> Pixels | None:
        """Of the image that a texture node shows, None where it is missing."""
        key = self._key(node)
        if key not in self._pixels:
            self._pixels[key] = None if node.image is None else self._read(node)
        return self._pixels[key]

    def average(self, node) -> np.ndarray | None:
        """(4,) mean colour, weighted by alpha, and mean alpha. The pixels are not kept."""
        key = self._key(node)
        if key not in self._averages:
            pixels = self._pixels.get(key) or (None if node.image is None else self._read(node))
            self._averages[key] = None if pixels is None else _average(pixels)
        return self._averages[key]

    @staticmethod
    def _key(node) -> tuple:
        return (node.image.as_pointer(), node.image_user.frame_current) if node.image else (0, 0)

    def _read(self, node) -> Pixels | None:
        self._stop.check()
        image = node.image
        path = image_path(image, node.image_user)
        from_file = image.source in ("FILE", "SEQUENCE", "TILED") and not image.packed_files
        pixels = None
        if from_file:
            if not os.path.isfile(path):
                return None
            pixels = read_file(path)
        if pixels is None:
            pixels = read_datablock(image)
            if pixels is None:
                return None
            if image.is_float:  # Blender has converted these already.
                return pixels
        return Pixels(self._to_linear(image, pixels.color), pixels.alpha)

    def _to_linear(self, image, color: np.ndarray) -> np.ndarray:
        """(H, W, 3) float32, of float values or of bytes."""
        space = image.colorspace_settings.name
        in_bytes = color.dtype == np.uint8
        if space in SRGB_SPACES and in_bytes:
            return srgb_to_linear(np.arange(256, dtype=np.float32) / np.float32(255))[color]
        if in_bytes:
            color = color / np.float32(255)
        if space in LINEAR_SPACES or image.colorspace_settings.is_data:
            return color
        if space in SRGB_SPACES:
            return srgb_to_linear(color)
        converted = _convert(color, space)
        if converted is None:
            self._notes.warn("image", image.name, f"colour space '{space}' is not supported, read as sRGB")
            return srgb_to_linear(color)
        return converted


def image_path(image, user=None) -> str:
    """Absolute path of the file of the current frame; of the first tile of a tiled image."""
    path = image.filepath_from_user(image_user=user) if user is not None else image.filepath_from_user()
    path = bpy.path.abspath(path or image.filepath, library=image.library)
    if image.source == "TILED" and len(image.tiles):
        path = path.replace("<UDIM>", str(image.tiles[0].number))
    return os.path.normpath(path) if path else ""


def read_file(path: str) -> Pixels | None:
    """Through OpenImageIO, bytes as bytes; None where the module or the format is missing: Blender then reads it."""
    try:
        import OpenImageIO as oiio
    except ImportError:
        return None
    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(path, hints)
    if source is None:
        oiio.geterror()
        return None
    spec = source.spec()
    data = source.read_image(0, 0, 0, min(spec.nchannels, 4), "uint8" if str(spec.format) == "uint8" else "float")
    source.close()
    if data is None:
        return None
    return _split(data.reshape(spec.height, spec.width, -1)[::-1])


def read_datablock(image) -> Pixels | None:
    """Through Blender: packed, generated and painted images. Slow for byte images (0.6 s for 4096 x 4096)."""
    image = image.original
    width, height = image.size
    channels = image.channels
    if not width or not height or not channels:
        return None
    flat = np.empty(width * height * channels, np.float32)
    image.pixels.foreach_get(flat)
    return _split(flat.reshape(height, width, channels))


def _split(data: np.ndarray) -> Pixels:
    channels = data.shape[2]
    color = data[..., :3] if channels >= 3 else np.repeat(data[..., :1], 3, axis=2)
    alpha = data[..., channels - 1] if channels in (2, 4) else None
    if alpha is not None and alpha.dtype == np.uint8:
        alpha = alpha / np.float32(255)
    return Pixels(np.ascontiguousarray(color), alpha)


def _average(pixels: Pixels) -> np.ndarray:
    color = np.nan_to_num(pixels.color.reshape(-1, 3), posinf=0.0, neginf=0.0)
    if pixels.alpha is None or pixels.alpha.max() <= 0.0:
        return np.array([*color.mean(axis=0, dtype=np.float64), 1.0])
    weight = pixels.alpha.reshape(-1).astype(np.float64)
    return np.array([*(weight @ color / weight.sum()), weight.mean()])


def _convert(color: np.ndarray, space: str) -> np.ndarray | None:
    """From any colour space of Blender's OpenColorIO configuration, None where that can't be done."""
    try:
        import OpenImageIO as oiio
    except ImportError:
        return None
    config = os.path.join(bpy.utils.resource_path("LOCAL"), "datafiles", "colormanagement", "config.ocio")
    if not os.path.isfile(config):
        return None
    buffer = oiio.ImageBuf(np.ascontiguousarray(color))
    converted = oiio.ImageBufAlgo.colorconvert(buffer, space, "scene_linear", colorconfig=config)
    if converted.has_error:
        converted.geterror()
        return None
    return np.asarray(converted.get_pixels(oiio.FLOAT), np.float32).reshape(color.shape)
