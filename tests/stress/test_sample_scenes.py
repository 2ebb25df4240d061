"""The sample scenes themselves, moved and scaled: minutes, so they are `long`."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from sample_scenes import SCENES, sample_scene
from stress import moves

pytestmark = pytest.mark.long
ALONG = np.array([0.6, -0.7, 0.39])


@cache
def unstressed(name: str) -> np.ndarray:
    return moves.render(sample_scene(name))


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1e3, 1e6])
def test_scaled(name, factor):
    found = moves.difference(moves.render(moves.scaled(sample_scene(name), factor)), unstressed(name))
    print(f"{name} scaled by {factor:g}: {found}")
    assert found.half_width.max() < 0.1 and found.holds(), f"{found}"


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("distance", [1e3, 1e4, 1e5, 1e6])
def test_moved(name, distance):
    found = moves.difference(moves.render(moves.moved(sample_scene(name), distance * ALONG)), unstressed(name))
    print(f"{name} moved by {distance:g}: {found}")
    assert found.half_width.max() < 0.1 and found.holds(), f"{found}"
