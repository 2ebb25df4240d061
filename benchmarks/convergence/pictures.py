"""Arrays to small PNGs: pictures as one would see them, and maps of differences."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from tools import metrics

from ..common import br

LARGEST = (192, 128)  # pixels shown of a picture: its middle, since noise that is scaled down is no noise
STEPS = 13  # of a map's colours: few, so that the file stays small; an odd number, so that one is for zero


def visible(picture: np.ndarray, exposure: float) -> np.ndarray:
    """(h, w, 3) scene-linear to uint8 sRGB, after the file's exposure in stops; no other view transform."""
    linear = np.clip(picture.astype(np.float64) * 2.0**exposure, 0.0, 1.0)
    # IEC 61966-2-1
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return (255 * encoded + 0.5).astype(np.uint8)


def middle(picture: np.ndarray) -> np.ndarray:
    """The middle of a picture that is larger than LARGEST."""
    height, width = picture.shape[:2]
    w, h = min(width, LARGEST[0]), min(height, LARGEST[1])
    y, x = (height - h) // 2, (width - w) // 2
    return picture[y : y + h, x : x + w]


def png(pixels: np.ndarray) -> bytes:
    """(h, w, 3) uint8 as the bytes of a PNG file."""
    import OpenImageIO as oiio

    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, "uint8")
    spec.attribute("png:compressionLevel", 9)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "picture.png")
        output = oiio.ImageOutput.create(str(path))
        if not output.open(str(path), spec) or not output.write_image(np.ascontiguousarray(pixels)):
            raise br.ToolError(f"a picture for the page cannot be written: {output.geterror()}")
        output.close()
        return path.read_bytes()


def colored(values: np.ndarray, low: float, high: float, colors: str) -> np.ndarray:
    """(h, w) to uint8 colours of a matplotlib map, in STEPS steps from `low` to `high`."""
    from matplotlib import colormaps

    step = np.clip(np.floor((values - low) / (high - low) * STEPS), 0, STEPS - 1).astype(int)
    table = colormaps[colors](np.linspace(0, 1, STEPS))[:, :3]
    return (255 * table[step] + 0.5).astype(np.uint8)


def error_map(picture: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Relative error of each pixel, log10, mean over channels before the root; see ERROR_RANGE."""
    squared = metrics.rel_errors(picture, reference).mean(axis=-1)
    return np.log10(np.sqrt(squared) + 1e-9)


ERROR_RANGE = (-2.5, 0.5)  # 0.3 % to 300 %
Z_RANGE = (-6.0, 6.0)


def legend(colors: str, low: float, high: float, width: int = 180) -> bytes:
    """A bar of the map's colours, PNG."""
    ramp = np.tile(np.linspace(low, high, width, endpoint=False), (10, 1))
    return png(colored(ramp, low, high, colors))
