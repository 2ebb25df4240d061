"""LDR-FLIP: how different two pictures look to someone who flips between them. Pure numpy.

After P. Andersson, J. Nilsson, T. Akenine-Moeller, M. Oskarsson, K. Astroem, M. D. Fairchild: FLIP, A Difference
Evaluator for Alternating Images (2020), for a screen of 0.7 m and 3840 pixels seen from 0.7 m.
tests/tools/test_compare_figures.py holds it to the authors' own program.
"""

from __future__ import annotations

import numpy as np

PIXELS_PER_DEGREE = 0.7 * 3840 / 0.7 * np.pi / 180.0
# The contrast sensitivity of each channel, as sums of a sqrt(pi / b) exp(-pi^2 x^2 / b), x in degrees (table 1).
SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
WIDEST = 0.04
FEATURE_WIDTH = 0.082  # degrees
QC, QF, PC, PT = 0.7, 0.5, 0.4, 0.95

TO_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ],
    np.float32,
)
WHITE = TO_XYZ.sum(axis=1)
FROM_XYZ = np.linalg.inv(TO_XYZ.astype(np.float64)).astype(np.float32)


def flip_map(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 sRGB pictures to (h, w) float32: 0 alike, 1 as different as can be seen."""
    pictures = [_opponent(picture) for picture in (reference, test)]
    color = _color_difference(*(_hunt(_filtered(picture)) for picture in pictures))
    feature = _feature_difference(*((picture[0] + 16.0) / 116.0 for picture in pictures))
    return color ** (1.0 - feature)


def _opponent(picture: np.ndarray) -> np.ndarray:
    """sRGB bytes to the planes Y, Cx, Cz, (3, h, w)."""
    encoded = np.arange(256, dtype=np.float32) / np.float32(255)
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)
    x, y, z = _relative_xyz(linear[np.moveaxis(picture, -1, 0)])
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def _relative_xyz(linear: np.ndarray) -> np.ndarray:
    """Of linear RGB planes, over the white's."""
    return np.tensordot(TO_XYZ / WHITE[:, None], linear, 1)


def _filtered(planes: np.ndarray) -> np.ndarray:
    """What an eye resolves: each plane through its contrast sensitivity, then linear RGB within what a screen shows."""
    seen = [_sensitivity(plane, terms) for plane, terms in zip(planes, SENSITIVITY, strict=True)]
    y = (seen[0] + 16.0) / 116.0
    xyz = np.stack([y + seen[1] / 500.0, y, y - seen[2] / 200.0]) * WHITE[:, None, None]
    return np.clip(np.tensordot(FROM_XYZ, xyz, 1), 0.0, 1.0)


def _sensitivity(plane: np.ndarray, terms) -> np.ndarray:
    radius = int(np.ceil(3.0 * np.sqrt(WIDEST / (2.0 * np.pi**2)) * PIXELS_PER_DEGREE))
    x = np.arange(-radius, radius + 1) / PIXELS_PER_DEGREE
    total, result = 0.0, np.zeros_like(plane)
    for a, b in terms:
        kernel = np.exp(-(np.pi**2) * x**2 / b)
        weight = a * np.sqrt(np.pi / b) * kernel.sum() ** 2
        kernel /= kernel.sum()
        result += np.float32(weight) * _convolved(_convolved(plane, kernel, 0), kernel, 1)
        total += weight
    return result / np.float32(total)


def _convolved(plane: np.ndarray, kernel: np.ndarray, axis: int) -> np.ndarray:
    """Along one axis, as a correlation; the picture goes on beyond its edges as it is there."""
    radius, size = len(kernel) // 2, plane.shape[axis]
    padded = np.pad(plane, [(radius, radius) if i == axis else (0, 0) for i in range(2)], "edge")
    result = np.zeros_like(plane)
    for offset, weight in enumerate(kernel.astype(np.float32)):
        result += weight * (padded[offset : offset + size] if axis == 0 else padded[:, offset : offset + size])
    return result


def _hunt(linear: np.ndarray) -> np.ndarray:
    """Linear RGB planes to L*a*b*, with colours that are fainter in the dark (the Hunt effect)."""
    t = _relative_xyz(linear)
    delta = 6.0 / 29.0
    x, y, z = np.where(t > delta**3, np.cbrt(t), t / (3.0 * delta**2) + 4.0 / 29.0)
    lightness = 116.0 * y - 16.0
    return np.stack([lightness, 5.0 * lightness * (x - y), 2.0 * lightness * (y - z)])


def _hyab(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    apart = a - b
    return np.abs(apart[0]) + np.hypot(apart[1], apart[2])


def _color_difference(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    green, blue = (_hunt(np.array(rgb, np.float32)) for rgb in ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    largest = float(_hyab(green, blue)) ** QC
    power, knee = _hyab(reference, test) ** QC, PC * largest
    return np.where(power < knee, PT / knee * power, PT + (power - knee) / (largest - knee) * (1.0 - PT))


def _feature_difference(reference: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Edges and points that only one of two planes of luminance has."""
    found = [_features(plane) for plane in (reference, test)]
    apart = np.maximum(*(np.abs(a - b) for a, b in zip(*found, strict=True)))
    return (apart / np.sqrt(np.float32(2.0))) ** QF


def _features(plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much of an edge, and of a point, there is in each pixel."""
    deviation = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE
    radius = int(np.ceil(3.0 * deviation))
    x = np.arange(-radius, radius + 1, dtype=np.float64)
    bell = np.exp(-(x**2) / (2.0 * deviation**2))
    kernels = _balanced(-x * bell), _balanced((x**2 / deviation**2 - 1.0) * bell)
    smooth = [_convolved(plane, bell / bell.sum(), axis) for axis in (1, 0)]  # across each direction
    edge, point = (np.hypot(*(_convolved(smooth[axis], k, axis) for axis in (0, 1))) for k in kernels)
    return edge, point


def _balanced(kernel: np.ndarray) -> np.ndarray:
    """Positive weights that add up to 1, and negative ones to -1."""
    return np.where(kernel > 0.0, kernel / kernel[kernel > 0.0].sum(), -kernel / kernel[kernel < 0.0].sum())
