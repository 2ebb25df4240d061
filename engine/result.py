"""What a render reports while it runs and gives back when it is done, the same for both roads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

RENDERING = "rendering"  # the message of the phase that makes samples


class Doing(NamedTuple):
    """What is being done. steps: how many are done, and of how many, where they are counted."""

    message: str
    steps: tuple[int, int] | None = None


@dataclass(frozen=True)
class Progress:
    """A look at a running render. `pixels()` makes the picture so far, shaped as `Result.pixels`, or None.
    steps: (done, of how many) of what the message says, where they are counted."""

    samples: int
    total: int
    seconds: float
    remaining: float | None
    message: str
    pixels: Callable[[], np.ndarray | None]
    steps: tuple[int, int] | None = None

    @property
    def fraction(self) -> float:
        """Of the phase."""
        done, total = self.steps or (self.samples, self.total)
        return done / total if total else 0.0

    @property
    def is_tracing(self) -> bool:
        """Whether building and compiling are over."""
        return self.message == RENDERING


@dataclass(frozen=True)
class Picture:
    """What an interactive render shows.

    pixels   (h, w, 4) float32, as in `Result`; each may stand for several pixels of the picture
    region   (x0, y0, x1, y1), the pixels of the picture that it covers; it may reach beyond its edges
    size     width and height of the whole picture
    samples  per pixel, of `total`; 0 while pixels are coarse
    """

    pixels: np.ndarray
    region: tuple[int, int, int, int]
    size: tuple[int, int]
    samples: int
    total: int


@dataclass
class Result:
    """A picture and how it came about.

    pixels    (h, w, 4) float32 of the render region, row 0 at the bottom, scene-linear, premultiplied alpha
    samples   per pixel (the mean, where they differ)
    seconds   by phase: "build", "compile", "render"
    rays      all that were traced, shadow rays included
    road      that rendered it, which is not the one asked for where Numba is missing
    passes    (h, w, channels) float32 of each pass that the settings name, see `engine.PASSES`
    rejected  samples that were not finite and count as black: of light too strong to calculate
              with, else a defect
    draws_per_direction  points that rejection sampling of the hemisphere drew for a direction, 12 / pi expected; 0
              with the other ways of sampling
    """

    pixels: np.ndarray
    samples: float
    seconds: dict[str, float] = field(default_factory=dict)
    rays: int = 0
    rejected: int = 0
    draws_per_direction: float = 0.0
    skipped: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    stopped: bool = False
    road: str = "COMPILED"
    passes: dict[str, np.ndarray] = field(default_factory=dict)
