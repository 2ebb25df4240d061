"""Denoising of a finished picture with the OpenImageDenoise library that Blender brings for Cycles and its compositor.

It is called through its C interface (version 2, https://www.openimagedenoise.org/documentation.html): Blender has no
Python module for it, and where the library lies isn't documented. So `is_missing` is asked before, and whatever else
goes wrong is a DenoiseError, for the user to read: the picture stays as it is.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from .. import engine as lobe

UNUSABLE = "Can't be used: this Blender lacks OpenImageDenoise"
MISSING = "Blender's OpenImageDenoise library can't be found or used here: the picture is rendered without denoising"
BYTES_A_PIXEL = 550  # that the library takes, measured at 1920 x 1080 with both guides
DEVICE_CPU = 1
FORMAT_FLOAT3 = 3

# The pattern of the library's file, in the folders below Blender's own that may hold it.
FILES = {"win32": "OpenImageDenoise.dll", "darwin": "libOpenImageDenoise*.dylib"}.get(
    sys.platform, "libOpenImageDenoise.so*"
)
FOLDERS = ("lib", "blender.shared", ".")
NAMES = {"win32": "OpenImageDenoise.dll", "darwin": "libOpenImageDenoise.2.dylib"}

_PROGRESS = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_double)
_POINTER, _TEXT, _SIZE = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t
# Result and arguments of what is called. Without them ctypes would cut pointers to 32 bits.
_FUNCTIONS: dict[str, tuple] = {
    "oidnNewDevice": (_POINTER, ctypes.c_int),
    "oidnSetDeviceInt": (None, _POINTER, _TEXT, ctypes.c_int),
    "oidnSetDeviceBool": (None, _POINTER, _TEXT, ctypes.c_bool),
    "oidnCommitDevice": (None, _POINTER),
    "oidnGetDeviceError": (ctypes.c_int, _POINTER, ctypes.POINTER(_TEXT)),
    "oidnReleaseDevice": (None, _POINTER),
    "oidnNewFilter": (_POINTER, _POINTER, _TEXT),
    "oidnSetSharedFilterImage": (
        None, _POINTER, _TEXT, _POINTER, ctypes.c_int, _SIZE, _SIZE, _SIZE, _SIZE, _SIZE
    ),
    "oidnSetFilterBool": (None, _POINTER, _TEXT, ctypes.c_bool),
    "oidnSetFilterProgressMonitorFunction": (None, _POINTER, _PROGRESS, _POINTER),
    "oidnCommitFilter": (None, _POINTER),
    "oidnExecuteFilter": (None, _POINTER),
    "oidnReleaseFilter": (None, _POINTER),
}  # fmt: skip


class DenoiseError(Exception):
    """The picture can't be denoised; the text says why."""


class DenoiseStopped(Exception):
    """`stop` has said so."""


@functools.cache
def is_missing() -> bool:
    """Whether no picture can be denoised, for want of the library. Tried once in a session."""
    try:
        _library()
    except DenoiseError:
        return True
    return False


@functools.cache
def print_what_was_tried() -> None:
    """On the console, once in a session, where the library is missing and denoising was asked for."""
    try:
        _library()
    except DenoiseError as error:
        print(f"Lobe: {error}")


def denoise(
    color: np.ndarray,
    albedo: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    threads: int = 0,
    stop: Callable[[], bool] | None = None,
) -> np.ndarray:
    """A denoised copy of `color`.

    color    (h, w, 3) float32, scene-linear
    albedo   (h, w, 3) float32, 0 to 1, or None; its noise is taken for detail
    normal   (h, w, 3) float32, -1 to 1, in any space, or None; only with an albedo
    threads  0: one for each core
    stop     asked while it works

    Raises DenoiseError and DenoiseStopped.
    """
    images = {"color": color, "albedo": albedo, "normal": normal}
    given = {name: _floats(image) for name, image in images.items() if image is not None}
    wrong = [name for name, image in given.items() if image.shape != color.shape or image.ndim != 3]
    if wrong or color.shape[2:] != (3,) or (normal is not None and albedo is None):
        raise ValueError(f"pictures of { ({name: image.shape for name, image in given.items()}) } can't be denoised")
    height, width, _ = color.shape
    try:
        lobe.foresee({f"denoising {width} x {height} pixels": BYTES_A_PIXEL * height * width})
    except lobe.LobeError as error:
        raise DenoiseError(str(error)) from error
    output = np.empty_like(given["color"])
    with _Device(_library(), threads) as device:
        device.run({**given, "output": output}, stop or (lambda: False))
    if not np.isfinite(output).all():
        raise DenoiseError("OpenImageDenoise gave back a picture that isn't finite")
    return output


def _floats(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image, np.float32)


class _Device:
    """The library's device for the CPU, for the time of one picture."""

    def __init__(self, library: ctypes.CDLL, threads: int) -> None:
        self._library = library
        self._device = library.oidnNewDevice(DEVICE_CPU)
        if not self._device:
            raise DenoiseError("OpenImageDenoise does not run on this processor")
        if threads:
            library.oidnSetDeviceInt(self._device, b"numThreads", threads)
        library.oidnSetDeviceBool(self._device, b"setAffinity", False)  # Blender's threads would stay on their cores
        library.oidnCommitDevice(self._device)

    def __enter__(self) -> _Device:
        return self

    def __exit__(self, *_) -> None:
        self._library.oidnReleaseDevice(self._device)

    def run(self, images: dict[str, np.ndarray], stop: Callable[[], bool]) -> None:
        """The filter for ray traced pictures, by the names that it has for them; fills "output"."""
        library = self._library
        self._check()
        stopped = False

        @_PROGRESS  # must live for as long as the filter does
        def monitor(_, done: float) -> bool:
            nonlocal stopped
            stopped = stopped or stop()
            return not stopped

        filter_ = library.oidnNewFilter(self._device, b"RT")
        try:
            for name, image in images.items():
                height, width, _ = image.shape
                place = image.ctypes.data
                library.oidnSetSharedFilterImage(
                    filter_, name.encode(), place, FORMAT_FLOAT3, width, height, 0, 12, 12 * width
                )
            library.oidnSetFilterBool(filter_, b"hdr", True)
            library.oidnSetFilterProgressMonitorFunction(filter_, monitor, None)
            library.oidnCommitFilter(filter_)
            library.oidnExecuteFilter(filter_)  # without Python's lock
            if stopped:  # version 2.3.0 doesn't always say so, nor stop
                raise DenoiseStopped
            self._check()
        finally:
            library.oidnReleaseFilter(filter_)

    def _check(self) -> None:
        message = _TEXT()
        code = self._library.oidnGetDeviceError(self._device, ctypes.byref(message))
        if code:
            raise DenoiseError(f"OpenImageDenoise failed: {(message.value or b'').decode(errors='replace')}")


@functools.cache
def _library() -> ctypes.CDLL:
    """The library, with its functions declared. A failure isn't remembered."""
    tried = []
    for candidate in _candidates():
        try:
            library = ctypes.CDLL(candidate)
            for name, (result, *arguments) in _FUNCTIONS.items():
                function = getattr(library, name)
                function.restype, function.argtypes = result, arguments
        except (OSError, AttributeError) as error:  # there is none, it doesn't load, or it is another version
            tried.append(f"{candidate} ({error})")
        else:
            return library
    raise DenoiseError("this Blender has no OpenImageDenoise library that can be used: tried " + "; ".join(tried))


def _candidates() -> Iterator[str]:
    """The one that Blender has loaded already is found by its bare name, others of the system too."""
    import bpy

    yield NAMES.get(sys.platform, "libOpenImageDenoise.so.2")
    blender = Path(bpy.utils.resource_path("LOCAL")).parent  # beside the program, or in the bpy module
    for folder in FOLDERS:
        yield from sorted(str(path) for path in (blender / folder).glob(FILES) if "_" not in path.name)
