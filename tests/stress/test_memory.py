"""Pictures that this computer has no memory for: a sentence, no traceback."""

from __future__ import annotations

import numpy as np
import pytest
import scenes

import engine
from engine.errors import LobeError, SceneError
from engine.film import Film
from engine.settings import Settings


class LittleMemory:
    """numpy where nothing has room. Patched into one module: elsewhere arrays are still made."""

    def __getattr__(self, name: str):
        return getattr(np, name)

    def zeros(self, *arguments):
        raise MemoryError

    empty = zeros


def test_the_largest_picture_that_blender_can_ask_for():
    scene = scenes.plate()
    scene.width = scene.height = 65536
    with pytest.raises(SceneError) as found:
        engine.render(scene, Settings(samples=1))
    assert str(found.value) == (
        "the picture of 65536 x 65536 pixels has more than 268 million: set a lower resolution, or render it in regions"
    )


def test_a_picture_whose_sums_find_no_memory(monkeypatch):
    scene = scenes.plate()
    scene.width, scene.height = 16384, 16000
    monkeypatch.setattr("engine.film.np", LittleMemory())
    with pytest.raises(LobeError) as found:
        engine.render(scene, Settings(samples=1))
    assert str(found.value) == (
        "not enough memory to sum up the picture of 16384 x 16000 pixels, which takes 8.4 GB: set a lower resolution, "
        "or render it in regions"
    )


def test_a_picture_that_cannot_be_shown(monkeypatch):
    film = Film((10, 10, 1010, 510), 1.0)
    monkeypatch.setattr("engine.film.np", LittleMemory())
    with pytest.raises(LobeError) as found:
        film.pixels()
    assert str(found.value) == (
        "not enough memory to show the picture of 1000 x 500 pixels, which takes 0.0 GB: set a lower resolution, or "
        "render it in regions"
    )


@pytest.mark.parametrize("shape", [(1, 1), (540, 960), (3, 40_000), (40_000, 3), (0, 5)])
def test_strips_are_the_whole_picture(shape):
    """However many of them there are."""
    height, width = shape
    film = Film((0, 0, width, height), 1.3)
    random = np.random.default_rng(1)
    film.sums[:] = random.random((height, width, 4))
    film.samples[:] = random.integers(0, 5, (height, width))
    expected = film.sums / np.maximum(film.samples, 1)[:, :, None] * (1.3, 1.3, 1.3, 1.0)
    assert np.array_equal(film.pixels(), expected.astype(np.float32))
