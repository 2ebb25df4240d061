"""Whether two sets of pictures show the same, by replicates: pixel by pixel with Welch's t-test, and their means."""

from __future__ import annotations

from unittest import mock

import numpy as np
from scipy import stats

import engine
from engine.reference import integrator
from engine.reference.geometry import Geometry
from engine.scene import Scene
from engine.settings import Settings

SEEDS = 8
PIXEL_LEVEL = 0.0025  # a pixel fails below this p-value; so 0.25 % of them do though all is right
MEAN_LEVEL = 1e-3


def pictures(scene: Scene, **settings) -> np.ndarray:
    """(SEEDS, pixels, 3) float64"""
    chosen = {"samples": 64, "max_bounces": 4, "pixel_filter": "BOX", "threads": 1, **settings}
    with mock.patch.object(integrator, "Geometry", BuiltOnce()):
        results = [engine.render(scene, Settings(**chosen, seed=seed)) for seed in range(SEEDS)]
    assert not any(result.rejected for result in results)
    return np.array([result.pixels[..., :3].reshape(-1, 3) for result in results], np.float64)


class BuiltOnce:
    """The reference road's geometry, kept for renders of the same scene: where there is much of it, building it takes
    far longer than these few pixels do."""

    def __init__(self) -> None:
        self.geometry: Geometry | None = None

    def __call__(self, scene: Scene) -> Geometry:
        if self.geometry is None:
            self.geometry = Geometry(scene)
        return self.geometry


def assert_agree(one: np.ndarray, other: np.ndarray) -> None:
    # A pixel that is the same in all seeds has no variance: what float32 rounds off is allowed in its place.
    difference = one.mean(axis=0) - other.mean(axis=0)
    variance = (one.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / SEEDS
    t = difference / np.sqrt(variance + (1e-5 * (np.abs(one.mean(axis=0)) + 1e-5)) ** 2)
    failing = np.count_nonzero(2 * stats.t.sf(np.abs(t), SEEDS - 1) < PIXEL_LEVEL)
    allowed = stats.binom.ppf(0.9999, t.size, PIXEL_LEVEL)
    assert failing <= allowed, f"{failing} of {t.size} pixels differ, {allowed:g} may"

    a, b = one.mean(axis=(1, 2)), other.mean(axis=(1, 2))
    p_value = stats.ttest_ind(a, b, equal_var=False).pvalue
    assert p_value > MEAN_LEVEL, f"means {a.mean()} and {b.mean()} differ, p = {p_value}"
