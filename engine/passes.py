"""Render passes: which there are, what the kernels sum up for them, and the pictures that these sums make.

Combined is the film's business. `PassFilm` has room for what the chosen passes need and for nothing else; where none is
chosen there is no `PassFilm`, and no kernel knows of passes.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

# Parts of the light, in the order of their rows in `kernels/rows.py`. They add up to Combined.
LIGHT = ("EMISSION", "ENVIRONMENT", "DIFFUSE_DIRECT", "GLOSSY_DIRECT", "DIFFUSE_INDIRECT", "GLOSSY_INDIRECT")
# What the first surface is: means over a pixel's samples, and their channels.
MEAN = {
    "MIST": 1,
    "NORMAL": 3,
    "UV": 3,
    "DIFFUSE_COLOR": 3,
    "GLOSSY_COLOR": 3,
    "AMBIENT_OCCLUSION": 3,
    "DENOISING_ALBEDO": 3,
    "DENOISING_NORMAL": 3,
}
# The same in the middle of the pixel: a mean of places or numbers would be none.
MIDDLE = {"DEPTH": 1, "POSITION": 3, "OBJECT_INDEX": 1, "MATERIAL_INDEX": 1}
SAMPLE_COUNT = "SAMPLE_COUNT"
# By which colour a part is divided, as in Cycles: colour x (direct + indirect) is the light.
COLOR_OF = {
    "DIFFUSE_DIRECT": "DIFFUSE_COLOR",
    "DIFFUSE_INDIRECT": "DIFFUSE_COLOR",
    "GLOSSY_DIRECT": "GLOSSY_COLOR",
    "GLOSSY_INDIRECT": "GLOSSY_COLOR",
}

# All but Combined, with their channels.
PASSES = {**MIDDLE, **MEAN, **dict.fromkeys(LIGHT, 3), SAMPLE_COUNT: 1}
# Places in `PassFilm.columns`.
DATA = (*MIDDLE, *MEAN)
_SUM, _SHOWN = 8, 4  # bytes of a channel: float64 while it is summed up, float32 in a picture
NOTHING_THERE = 1e10  # the depth where no surface is, as in Cycles
STRIP = 64  # rows of a picture that are worked out at a time: large ones leave no room for copies


class PassFilm:
    """What is summed up for the passes of a picture of (h, w) pixels.

    parts    (h, w, n) float64, radiance; part_columns: (6,) int64, where each of LIGHT begins, -1: left out
    data     (h, w, m) float64: what the first surfaces are, in the last column the number of samples; columns:
             (12,) int64, where each of DATA begins, -1: left out
    """

    def __init__(self, shape: tuple[int, int], wanted: Iterable[str]):
        self.wanted = tuple(wanted)
        needed = all_needed(self.wanted)
        self.part_columns, width = _columns(LIGHT, needed)
        self.parts = np.zeros((*shape, width) if width else (1, 1, 1))
        self.columns, width = _columns(DATA, needed)
        self.data = np.zeros((*shape, width + 1) if width else (1, 1, 1))
        if (depth := self.columns[DATA.index("DEPTH")]) >= 0:
            self.data[..., depth] = NOTHING_THERE  # until somebody has looked

    def pictures(self, samples: np.ndarray, exposure: float) -> dict[str, np.ndarray]:
        """(h, w, channels) float32 of each pass. samples (h, w), of the film."""
        return {name: self._picture(name, samples, exposure) for name in self.wanted}

    def _picture(self, name: str, samples: np.ndarray, exposure: float) -> np.ndarray:
        picture = np.empty((*samples.shape, PASSES[name]), np.float32)
        for first in range(0, len(picture), STRIP):
            rows = slice(first, first + STRIP)
            picture[rows] = self._strip(name, rows, samples[rows, :, None], exposure)
        return picture

    def _strip(self, name: str, rows: slice, samples: np.ndarray, exposure: float) -> np.ndarray:
        """Some rows of a pass, float64. samples (h, w, 1), of these rows."""
        if name == SAMPLE_COUNT:
            return samples
        if name in LIGHT:
            first = self.part_columns[LIGHT.index(name)]
            light = self.parts[rows, :, first : first + 3] * exposure / np.maximum(samples, 1)
            return divided(light, self._data(COLOR_OF[name], rows)) if name in COLOR_OF else light
        # What is summed up of mist is what shows through it.
        found = self._data(name, rows)
        return np.clip(1.0 - found, 0.0, 1.0) if name == "MIST" else found

    def _data(self, name: str, rows: slice) -> np.ndarray:
        first = self.columns[DATA.index(name)]
        found = self.data[rows, :, first : first + PASSES[name]]
        return found if name in MIDDLE else found / np.maximum(self.data[rows, :, -1:], 1)


def all_needed(wanted: Iterable[str]) -> set[str]:
    """The passes and the colours that they are divided by."""
    wanted = set(wanted)
    return wanted | {COLOR_OF[name] for name in wanted if name in COLOR_OF}


def bytes_a_pixel(wanted: Iterable[str]) -> int:
    """What passes take of memory for each pixel: the sums of a `PassFilm`, the pictures of them, and Blender's copy."""
    wanted = tuple(wanted)
    needed = all_needed(wanted)
    light, data = (sum(PASSES[name] for name in names if name in needed) for names in (LIGHT, DATA))
    sums = light + data + (1 if data else 0)  # beside data there is the number of samples
    return sums * _SUM + sum(PASSES[name] for name in wanted) * 2 * _SHOWN


def has_light_passes(wanted: Iterable[str]) -> bool:
    return not set(LIGHT).isdisjoint(wanted)


def has_data_passes(wanted: Iterable[str]) -> bool:
    return not set(DATA).isdisjoint(all_needed(wanted))


def divided(light: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Light before it met the colour. Where a channel of the colour is 0, no light tells: it gets the mean of the other
    channels, so that a red surface isn't lit by red light alone."""
    known = color > 0
    light = np.divide(light, color, out=np.zeros_like(light), where=known)
    mean = light.sum(axis=2, keepdims=True) / np.maximum(known.sum(axis=2, keepdims=True), 1)
    return np.where(known, light, mean)


def _columns(names: Iterable[str], needed: set[str]) -> tuple[np.ndarray, int]:
    """Where each of the names begins, -1 for those that aren't needed; and how many columns there are."""
    columns, width = [], 0
    for name in names:
        columns.append(width if name in needed else -1)
        width += PASSES[name] if name in needed else 0
    return np.array(columns, np.int64), width
