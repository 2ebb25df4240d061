"""Pixels of Blender's images: read from their files with OpenImageIO, or from Blender where there is no file.

Pixels come out scene-linear, row 0 at the bottom. Images that can't be shown give None: the caller draws them magenta,
as Blender does, and says what `Images.problem` says. An image of which only the average counts is read in strips of
rows, so that a large one needs little memory.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import bpy
import numpy as np

from ...engine import LobeError, foresee
from .changes import uid_of
from .stop import Stop
from .units import srgb_to_linear

MISSING = (1.0, 0.0, 1.0)

# Colour spaces whose pixels are scene-linear already, or are no colours at all.
LINEAR_SPACES = {"Linear", "Linear Rec.709", "Non-Color", "Raw", "Generic Data", "scene_linear", ""}
SRGB_SPACES = {"sRGB"}


FILES = ("FILE", "SEQUENCE", "TILED", "MOVIE")
MOVING = ("SEQUENCE", "MOVIE")
LAYERS = "several layers or views in one image are not supported, only the first is read"
STEREO = "the views of a stereo image are not supported, it is read as one picture"
PACKED_LAYERS = "has several layers or views and is packed into the .blend, which is not supported: unpack it"
UNREADABLE = "cannot be read: its file is damaged or of an unknown format"
TOO_LARGE = "needs more memory than can be had (as a file of its own it would need little)"
# Alpha modes that leave the colour alone.
APART = ("NONE", "CHANNEL_PACKED")
PAINTED = ("painted",)  # the `version` of pixels that are in no file: nothing tells them from those painted next
STRIP = 1 << 20  # pixels
OF_COLOR = 12  # bytes a pixel of (H, W, 3) float32


class Unreadable(Exception):
    """OpenImageIO can't read a file, or isn't there: Blender then reads it."""


class Pixels(NamedTuple):
    """What `Images` gives, and what it reads before that: then the colour is in its own space, bytes as uint8.

    color     (H, W, 3) float32, scene-linear
    alpha     (H, W) float32, or None
    straight  whether the colour is not multiplied with alpha
    """

    color: np.ndarray
    alpha: np.ndarray | None
    straight: bool = True


class Images:
    """The images of one export, each read once. `notes` hears of colour spaces that could not be honoured."""

    def __init__(self, notes, stop: Stop) -> None:
        """To be made on Blender's own thread."""
        self._notes = notes
        self._stop = stop
        self._color_config = _color_config()
        self._environments: dict = {}
        self._asked: set = set()  # for these
        self._averages: dict = {}
        self._environment_averages: dict = {}
        self._problems: dict = {}
        self._moving = False

    def lasting(self) -> bool:
        """Whether every image that was asked for since this was called last is the same in all frames. Blender doesn't
        list what shows the others as changed."""
        moving, self._moving = self._moving, False
        return not moving

    def environment(self, node) -> np.ndarray | None:
        """(H, W, 3) float32 of the image that a texture node shows, multiplied with alpha, as Cycles does with
        environment images; None where it can't be shown."""
        key = self._key(node)
        self._asked.add(key)
        if key not in self._environments:
            self._environments[key] = (
                None if node.image is None else self._read(node, self._color_of_file, self._color_of_datablock)
            )
        return self._environments[key]

    def forget_unused(self) -> None:
        """Environments that nobody has asked for since this was called last: a sequence has one for each frame."""
        self._environments = {key: self._environments[key] for key in self._asked}
        self._asked = set()

    def average(self, node) -> np.ndarray | None:
        """(4,) mean colour, weighted by alpha, and mean alpha; None where it can't be had. Never raises LobeError."""
        return self._mean(node, self._averages, self.mean_of_file, self._mean_of_datablock)

    def environment_average(self, node) -> np.ndarray | None:
        """(3,) mean of what `environment` gives; else like `average`."""
        return self._mean(node, self._environment_averages, self._lit_by_file, self._lit_by_datablock)

    def _mean(self, node, known: dict, of_file: Callable, of_datablock: Callable) -> np.ndarray | None:
        key = self._key(node)
        if key not in known:
            mean = None
            try:
                if node.image is not None:
                    mean = self._read(node, of_file, of_datablock)
            except LobeError:  # its pixels can be had from Blender alone, all at once
                self._problems[key] = TOO_LARGE
            known[key] = mean
        return known[key]

    def problem(self, node) -> str:
        """Why a node's image can't be shown: "image 'a.png' is missing"."""
        return f"image {node.image.name!r} {self._problems.get(self._key(node), 'has no pixels')}"

    def _key(self, node) -> tuple:
        """Another one when the pixels are others, but for those of images that somebody paints."""
        if node.image is None:
            return 0, 0
        self._moving |= node.image.source in MOVING
        return uid_of(node.image), node.image_user.frame_current, version(node.image, node.image_user)

    def forget_painted(self) -> None:
        """What was painted may look otherwise by now."""
        for known in (self._environments, self._averages, self._environment_averages):
            for key in [key for key in known if PAINTED in key]:
                del known[key]

    def _read(self, node, of_file: Callable, of_datablock: Callable) -> np.ndarray | None:
        """What these make of a node's image: of_file(image, path) of its file, which may raise Unreadable, and
        of_datablock(image, source) of what Blender has, in whichever datablock."""
        self._stop.check()
        image = node.image
        from_file = is_read_from_file(image)
        if image.source == "TILED" and len(image.tiles) > 1:
            self._notes.warn("image", image.name_full, "UDIM tiles are not supported, only the first is read")
        path = image_path(image, node.image_user) if from_file else ""
        problem = file_problem(path) if from_file else ""
        found, several = None, False
        if from_file and not problem and image.source != "MOVIE":
            with contextlib.suppress(Unreadable):
                found = of_file(image, path)
                several = has_layers(path)
        if found is None and not problem:
            with read_again(image, path, node.image_user) if from_file else contextlib.nullcontext(image) as source:
                found = None if source is None else of_datablock(image, source)
            problem = UNREADABLE if image.source in FILES else "has no pixels"
            if image.original.type == "MULTILAYER":  # as Blender knows once it has tried
                problem = PACKED_LAYERS
        if found is None:
            of_frame = image.source == "SEQUENCE" and from_file
            self._problems[self._key(node)] = f"shows {path!r}, which {problem}" if of_frame else problem
            return None
        self._note_parts(image, several)
        return found

    def _color_of_file(self, image, path: str) -> np.ndarray:
        return self._converted(image, read_file(path), multiplied=True).color

    def _color_of_datablock(self, image, source) -> np.ndarray | None:
        pixels = read_datablock(source)
        return None if pixels is None else self._of_datablock(image, source, pixels, multiplied=True).color

    def mean_of_file(self, image, path: str) -> np.ndarray:
        """As `average` has it. On any thread, with an `image` that has but the properties that tell how to take the
        file's pixels. Raises Unreadable."""
        return mean_color(self._converted(image, strip, multiplied=False) for strip in file_strips(path))

    def _mean_of_datablock(self, image, source) -> np.ndarray | None:
        strips = datablock_strips(source)
        if strips is None:
            return None
        return mean_color(self._of_datablock(image, source, strip, multiplied=False) for strip in strips)

    def _lit_by_file(self, image, path: str) -> np.ndarray:
        return plain_mean(self._converted(image, strip, multiplied=True) for strip in file_strips(path))

    def _lit_by_datablock(self, image, source) -> np.ndarray | None:
        strips = datablock_strips(source)
        if strips is None:
            return None
        return plain_mean(self._of_datablock(image, source, strip, multiplied=True) for strip in strips)

    def _of_datablock(self, image, source, pixels: Pixels, multiplied: bool) -> Pixels:
        """Blender has converted float images already."""
        return pixels if source.is_float else self._converted(image, pixels, multiplied)

    def _note_parts(self, image, several: bool) -> None:
        if several:
            self._notes.warn("image", image.name_full, LAYERS)
        elif image.use_multiview:
            self._notes.warn("image", image.name_full, STEREO)

    def _converted(self, image, pixels: Pixels, multiplied: bool) -> Pixels:
        """Scene-linear. Cycles multiplies sRGB with alpha before it decodes it, bytes as bytes; others afterwards."""
        self._stop.check()  # between strips
        color, alpha, straight = pixels
        apart = image.alpha_mode in APART or image.colorspace_settings.is_data
        if not multiplied or alpha is None or not straight or apart:
            return pixels._replace(color=self._to_linear(image, color))
        if image.colorspace_settings.name not in SRGB_SPACES:
            return Pixels(self._to_linear(image, color) * alpha[..., None], alpha, straight=False)
        if color.dtype == np.uint8:
            color = (color * np.rint(alpha * 255).astype(np.uint16)[..., None] // 255).astype(np.uint8)
        else:
            color = color * alpha[..., None]
        return Pixels(self._to_linear(image, color), alpha, straight=False)

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
        converted = _convert(color, space, self._color_config)
        if converted is None:
            self._notes.warn("image", image.name_full, f"colour space '{space}' is not supported, read as sRGB")
            return srgb_to_linear(color)
        return converted


def is_read_from_file(image) -> bool:
    return image.source in FILES and not image.packed_files


def version(image, user=None) -> tuple:
    """Of an image's pixels, to be compared: Blender doesn't list every image whose file it has read again, and none
    that a script has written pixels into."""
    image = image.original
    if is_read_from_file(image):
        try:
            status = os.stat(image_path(image, user))
        except (OSError, ValueError):
            return ()
        return status.st_mtime_ns, status.st_size
    if image.is_dirty:
        return PAINTED
    return tuple(packed.packed_file.size for packed in image.packed_files if packed.packed_file is not None)


def file_problem(path: str) -> str:
    """What is wrong with a file before anybody reads it; empty if nothing is."""
    if os.path.isdir(path):
        return "is a folder"
    if not os.path.isfile(path):
        return "is missing"
    return "" if os.path.getsize(path) else "is an empty file"


def image_path(image, user=None) -> str:
    """Absolute path of the file of the current frame; of the first tile of a tiled image."""
    path = image.filepath_from_user(image_user=user) if user is not None else image.filepath_from_user()
    path = bpy.path.abspath(path or image.filepath, library=image.library)
    if image.source == "TILED" and len(image.tiles):
        path = path.replace("<UDIM>", str(image.tiles[0].number))
    return os.path.normpath(path) if path else ""


def read_file(path: str) -> Pixels:
    """Through OpenImageIO, bytes as bytes. Raises Unreadable, or LobeError where there is no memory for it."""
    with _opened(path) as file:
        width, height = file.spec.width, file.spec.height
        _foresee(os.path.basename(path), width, height, file.channels * (1 if file.type == "uint8" else 4) + OF_COLOR)
        return file.pixels(file.source.read_image(0, 0, 0, file.channels, file.type))


def file_strips(path: str) -> Iterator[Pixels]:
    """The same as `read_file`, strip by strip from the top on."""
    with _opened(path) as file:
        spec, source = file.spec, file.source
        tile = spec.tile_height or 1
        rows = max(STRIP // spec.width // tile, 1) * tile
        for start in range(spec.y, spec.y + spec.height, rows):
            end = min(start + rows, spec.y + spec.height)
            if spec.tile_width:  # OpenImageIO has no scanlines of these
                columns = spec.x, spec.x + spec.width
                data = source.read_tiles(0, 0, *columns, start, end, 0, 1, 0, file.channels, file.type)
            else:
                data = source.read_scanlines(0, 0, start, end, 0, 0, file.channels, file.type)
            yield file.pixels(data)


class _File(NamedTuple):
    """A file that OpenImageIO has opened, and how its first picture is read."""

    source: object
    spec: object
    channels: int
    type: str

    def pixels(self, data: np.ndarray | None) -> Pixels:
        """Of rows from above, which it has read; None where it couldn't."""
        if data is None:
            raise Unreadable
        straight = bool(self.spec.get_int_attribute("oiio:UnassociatedAlpha", 0))
        return _split(data.reshape(-1, self.spec.width, self.channels)[::-1], straight)


@contextlib.contextmanager
def _opened(path: str) -> Iterator[_File]:
    try:
        import OpenImageIO as oiio
    except ImportError as error:
        raise Unreadable from error
    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(path, hints)
    if source is None:
        oiio.geterror()
        raise Unreadable
    try:
        spec = source.spec()
        yield _File(source, spec, min(spec.nchannels, 4), "uint8" if str(spec.format) == "uint8" else "float")
    finally:
        source.close()


def has_layers(path: str) -> bool:
    """Whether an OpenEXR file holds several pictures: as parts, or as groups of channels ("Layer.Combined.R")."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(path)
    if source is None:
        oiio.geterror()
        return False
    try:
        if source.format_name() != "openexr":
            return False
        groups = {name.rpartition(".")[0] for name in source.spec().channelnames}
        return len(groups) > 1 or source.seek_subimage(1, 0)
    finally:
        source.close()


@contextlib.contextmanager
def read_again(image, path: str, user) -> Iterator[bpy.types.Image | None]:
    """For the while, a datablock whose pixels are what an image user shows of a file; None where Blender can't read it.

    The image's own pixels are of the frame that Blender has read last, for whatever picture. So the file of a movie or
    sequence is read by itself, apart from the user's data.
    """
    if image.source not in MOVING:
        yield image
        return
    try:
        with bpy.data.temp_data() as data:
            yield _load(data, image, path, user.frame_current)
    finally:
        data = None  # Blender takes it for that of the next time, if that has the same address and this is still there


def _load(data, image, path: str, frame: int) -> bpy.types.Image | None:
    try:
        again = data.images.load(path)
    except RuntimeError:
        return None
    tuple(image.size)  # asks Blender to read it: before that a movie has no colour space
    if space := image.colorspace_settings.name:
        again.colorspace_settings.name = space
    again.alpha_mode = image.alpha_mode
    if again.source == "MOVIE" and again.size[0]:
        again.scale(*again.size, frame=frame)  # to the size that it has: of all that reads, this takes a frame
    return again


def read_datablock(image) -> Pixels | None:
    """Through Blender: packed, generated and painted images. Slow for byte images (0.6 s for 4096 x 4096). None where
    there are no pixels; raises LobeError where there is no memory for them."""
    data = _data(image.original, OF_COLOR)
    return None if data is None else _of_data(image, data)


def datablock_strips(image) -> Iterator[Pixels] | None:
    """The same, strip by strip; Blender gives its pixels all at once, as floats."""
    data = _data(image.original, 0)
    if data is None:
        return None
    rows = max(STRIP // data.shape[1], 1)
    return (_of_data(image, data[start : start + rows]) for start in range(0, len(data), rows))


def _data(image, beside: int) -> np.ndarray | None:
    """(H, W, channels) float32. beside: bytes a pixel of what will be made of it."""
    width, height = image.size
    channels = image.channels
    if not width or not height or not channels:
        return None
    _foresee(image.name, width, height, 4 * channels + beside)
    flat = np.empty(width * height * channels, np.float32)
    image.pixels.foreach_get(flat)
    return flat.reshape(height, width, channels)


def _of_data(image, data: np.ndarray) -> Pixels:
    is_float = image.original.is_float
    return _split(data if is_float else np.rint(data * 255).astype(np.uint8), straight=not is_float)


def _foresee(name: str, width: int, height: int, bytes_a_pixel: int) -> None:
    """Raises LobeError where there is no memory for an image of so many bytes."""
    foresee({f"image {name!r} of {width} x {height} pixels": bytes_a_pixel * width * height})


def _split(data: np.ndarray, straight: bool) -> Pixels:
    channels = data.shape[2]
    color = data[..., :3] if channels >= 3 else np.repeat(data[..., :1], 3, axis=2)
    alpha = data[..., channels - 1] if channels in (2, 4) else None
    if alpha is not None and alpha.dtype == np.uint8:
        alpha = alpha / np.float32(255)
    return Pixels(np.ascontiguousarray(color), alpha, straight)


def mean_color(strips: Iterable[Pixels]) -> np.ndarray:
    """(4,) mean of an image's linear colours, weighted by alpha, and mean alpha; where nothing is visible as if there
    were no alpha."""
    count, plain, weighted, weights = 0, np.zeros(3), np.zeros(3), 0.0
    for strip in strips:
        color = np.nan_to_num(strip.color.reshape(-1, 3), posinf=0.0, neginf=0.0).astype(np.float64)
        weight = np.ones(len(color)) if strip.alpha is None else strip.alpha.reshape(-1).astype(np.float64)
        count += len(color)
        plain += color.sum(axis=0)
        weighted += weight @ color
        weights += weight.sum()
    return np.array([*(weighted / weights), weights / count]) if weights > 0.0 else np.array([*(plain / count), 1.0])


def plain_mean(strips: Iterable[Pixels]) -> np.ndarray:
    """(3,) mean of an image's linear colours, whatever their alpha."""
    return mean_color(strip._replace(alpha=None) for strip in strips)[:3]


def _color_config() -> str:
    """The path of Blender's OpenColorIO configuration."""
    return os.path.join(bpy.utils.resource_path("LOCAL"), "datafiles", "colormanagement", "config.ocio")


def _convert(color: np.ndarray, space: str, config: str) -> np.ndarray | None:
    """From any colour space of an OpenColorIO configuration, None where that can't be done."""
    try:
        import OpenImageIO as oiio
    except ImportError:
        return None
    if not os.path.isfile(config):
        return None
    buffer = oiio.ImageBuf(np.ascontiguousarray(color))
    converted = oiio.ImageBufAlgo.colorconvert(buffer, space, "scene_linear", colorconfig=config)
    if converted.has_error:
        converted.geterror()
        return None
    return np.asarray(converted.get_pixels(oiio.FLOAT), np.float32).reshape(color.shape)
