"""The sample scenes themselves, moved and scaled: minutes, so they are `long`. `make test-long` writes what they find
to benchmarks/results/stress.csv and .md."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from sample_scenes import SCENES, sample_scene
from stress import moves

from engine.scene import Scene

pytestmark = pytest.mark.long
ALONG = np.array([0.6, -0.7, 0.39])


@cache
def unstressed(name: str) -> np.ndarray:
    return moves.render(sample_scene(name))


@pytest.fixture
def check(record) -> Callable[[str, str, Scene], None]:
    def run(name: str, change: str, stressed: Scene) -> None:
        found = moves.difference(moves.render(stressed), unstressed(name))
        same = bool(found.half_width.max() < 0.1 and found.holds())
        record("stress", ("scene", "change"), row(name, change, found, same))
        assert same, f"{found}"

    return run


def row(name: str, change: str, found: moves.Difference, same: bool) -> dict:
    return {
        "scene": name,
        "change": change,
        "difference of mean": f"{np.abs(found.mean).max():.1e}",
        "half width": f"{found.half_width.max():.1e}",
        "verdict": "pass" if same else "FAIL",
    }


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1e3, 1e6])
def test_scaled(check, name, factor):
    check(name, f"scaled by {factor:g}", moves.scaled(sample_scene(name), factor))


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("distance", [1e3, 1e4, 1e5, 1e6])
def test_moved(check, name, distance):
    check(name, f"moved by {distance:g} m", moves.moved(sample_scene(name), distance * ALONG))
