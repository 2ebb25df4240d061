"""Closed forms are asked of both roads through one fixture, `measure`: it renders with several seeds and gives the
mean with its standard error, so that a test can say how sure it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats

import engine
from engine.result import Result
from engine.scene import Scene
from engine.settings import Settings

SEEDS = 4
QUANTILE = stats.norm.isf(0.5e-5)  # one comparison in 1e5 fails though all is right


@dataclass
class Measured:
    """Mean radiance of a picture over its pixels and over `SEEDS` seeds: (3,), its standard error, mean alpha.

    Every pixel of every seed counts as one independent estimate: no two of them share random numbers. Where pixels
    differ by more than noise the error comes out too large, never too small.
    """

    mean: np.ndarray
    error: np.ndarray
    alpha: float

    def check(self, expected, slack: float = 2e-5) -> None:
        """Fails unless `expected` (a number or RGB) lies in the confidence interval; `slack` is relative, for what
        is not noise: float32, a mesh that only approximates a sphere, a field of view that is not a single ray."""
        expected = np.broadcast_to(np.asarray(expected, np.float64), 3)
        margin = QUANTILE * self.error + slack * np.abs(expected) + 1e-9
        assert np.all(np.abs(self.mean - expected) <= margin), (
            f"measured {self.mean} +- {self.error}, expected {expected}"
        )

    def check_same(self, other: Measured, slack: float = 2e-5) -> None:
        error = np.hypot(self.error, other.error)
        margin = QUANTILE * error + slack * np.abs(self.mean) + 1e-9
        assert np.all(np.abs(self.mean - other.mean) <= margin), (
            f"{self.mean} +- {self.error} and {other.mean} +- {other.error} differ"
        )


@pytest.fixture(params=["REFERENCE", "COMPILED"])
def road(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def render(road: str) -> Callable[..., Result]:
    """`render(scene, samples=..., **settings)` on one road, box filter unless told otherwise."""

    def run(scene: Scene, **settings) -> Result:
        chosen = Settings(**{"samples": 32, "pixel_filter": "BOX", "road": road, "threads": 1, **settings})
        result = engine.render(scene, chosen)
        assert result.rejected == 0
        assert np.isfinite(result.pixels).all()
        return result

    return run


@pytest.fixture
def measure(render: Callable[..., Result]) -> Callable[..., Measured]:
    def run(scene: Scene, **settings) -> Measured:
        pixels = np.array([render(scene, **settings, seed=seed).pixels for seed in range(SEEDS)], np.float64)
        estimates = pixels.reshape(-1, 4)
        return Measured(
            mean=estimates[:, :3].mean(axis=0),
            error=estimates[:, :3].std(axis=0, ddof=1) / np.sqrt(len(estimates)),
            alpha=float(estimates[:, 3].mean()),
        )

    return run
