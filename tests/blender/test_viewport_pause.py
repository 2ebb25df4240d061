"""Viewports beside a final render: they rest, and say so, for as long as one traces."""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator

import pytest

from tools.lobe_blender import MODULE

pytest.importorskip("gpu")
PATIENCE = 120.0  # seconds: the first test of a fresh checkout compiles


class Engine:
    """What Blender keeps for a 3D viewport; counts the redraws that it is asked for."""

    def __init__(self) -> None:
        self.viewport = None
        self.redraws = 0

    def tag_redraw(self) -> None:
        self.redraws += 1


def wait_for(condition) -> None:
    deadline = time.perf_counter() + PATIENCE
    while not condition():
        assert time.perf_counter() < deadline
        time.sleep(0.01)


@pytest.fixture
def engine() -> Engine:
    return Engine()


@pytest.fixture
def viewport(engine) -> Iterator:
    viewport = importlib.import_module(f"{MODULE}.addon.viewport").Viewport(engine)
    yield viewport
    viewport.close()


def test_a_viewport_says_that_it_waits_where_it_does(engine, viewport) -> None:
    """Blender draws it again whenever that changes, though there is no new picture."""
    lobe = importlib.import_module(f"{MODULE}.engine")
    settings = lobe.Settings(samples=4, threads=1)

    def scene() -> lobe.Scene:
        return lobe.Scene(width=8, height=8, camera=lobe.Camera(), world=lobe.World(color=(0.5, 0.5, 0.5)))

    def said() -> str:
        return viewport._status(viewport._renderer.picture, None)[1]

    viewport._renderer.show(scene(), settings)
    wait_for(lambda: said() == "Sample 4/4")
    time.sleep(0.1)
    drawn = engine.redraws
    viewport.pause()
    assert said() == "Sample 4/4" and engine.redraws > drawn
    viewport._renderer.show(scene(), settings)
    assert said() == "Waiting for the render"
    drawn, before = engine.redraws, viewport._renderer.picture
    viewport.resume()
    assert engine.redraws > drawn
    wait_for(lambda: viewport._renderer.picture is not before and said() == "Sample 4/4")
