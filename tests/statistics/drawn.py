"""What the cases of all families have in common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.statistics import chi2

UP = np.array([0.0, 0, 1])
TILTED = np.array([0.48, -0.6, 0.64])  # a normal
BENT = (0.3 * chi2.frame(TILTED)[0] + TILTED) / np.linalg.norm(0.3 * chi2.frame(TILTED)[0] + TILTED)


class Drawn:
    """What cases have in common: float32 numbers in, float64 points out."""

    name = ""
    extent: float | None = None

    def __str__(self) -> str:
        return self.name


@dataclass
class Crossed:
    """Draws of one case, density of another: a sampler that is wrong on purpose."""

    drawn: chi2.Case
    told: chi2.Case

    @property
    def name(self) -> str:
        return f"{self.drawn.name} told as {self.told.name}"

    @property
    def extent(self) -> float | None:
        return self.drawn.extent

    def draw(self, count: int, seed: int):
        return self.drawn.draw(count, seed)

    def density(self, points: np.ndarray) -> np.ndarray:
        return self.told.density(points)


@dataclass
class Scaled:
    """A case whose density is too large by a factor, which leaves its shape."""

    case: chi2.Case
    factor: float

    @property
    def name(self) -> str:
        return f"{self.case.name} x {self.factor:g}"

    @property
    def extent(self) -> float | None:
        return self.case.extent

    def draw(self, count: int, seed: int):
        return self.case.draw(count, seed)

    def density(self, points: np.ndarray) -> np.ndarray:
        return self.factor * self.case.density(points)
