"""benchmarks/viewport.py: its scene shows what it says, and its figures are there."""

from __future__ import annotations

import numpy as np
import pytest

from engine import Settings, render


@pytest.fixture(scope="module")
def bench(script):
    return script("viewport")


def test_the_scene_is_a_lit_ball_of_a_hundred_thousand_triangles(bench):
    scene = bench.scene_of(bench.RINGS)
    assert sum(len(mesh.triangles) for mesh in scene.meshes) > 100_000
    small = bench.scene_of(16)
    small.width, small.height = 64, 36
    pixels = render(small, Settings(samples=4)).pixels[..., :3]
    assert pixels[18, 32].mean() > 0.05  # the ball
    assert pixels[2].mean() > 0.05 and np.all(pixels[-1] == 0.0)  # the floor, and nothing behind it


def test_figures(bench, monkeypatch):
    monkeypatch.setattr(bench, "MOVES", 2)
    scene = bench.scene_of(16)
    scene.width, scene.height = 64, 36
    found = bench.measure(scene, Settings(samples=4), 0.5)
    assert len(found) == 3 and all(value > 0.0 for value in found.values())
