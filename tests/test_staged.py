"""The kernel that goes in stages against the one that goes path by path: the same picture from the same numbers."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
import scenes

import engine.pack.geometry as packing
import engine.schedule as schedule
from engine import Scene, Settings, World, render
from engine.features import Features
from engine.kernels import batch
from engine.kernels.embree import new_ray
from engine.kernels.path import make_path_kernel
from engine.kernels.staged import covers
from engine.scene import Aperture

SIZE = 24
ROUNDING = 1e-4  # relative, of a pixel
TURNED = 0.02  # of the pixels: a rounding may turn a decision of a path over


def through_a_lens() -> Scene:
    scene = scenes.cornell(SIZE)
    scene.camera = replace(scene.camera, aperture=Aperture(0.05, 2.0, blades=5))
    scene.transparent_film = True
    return scene


def from_above() -> Scene:
    scene = scenes.sky_plate(SIZE)
    scene.camera = replace(scene.camera, orthographic=True)
    return scene


def under_a_sky() -> Scene:
    scene = scenes.lamp_room(["area", "sun"], SIZE)
    scene.world = World(color=(0.1, 0.2, 0.3))
    return scene


SCENES = {
    "cornell": lambda: scenes.cornell(SIZE),
    "lens": through_a_lens,
    "orthographic": from_above,
    "phong": lambda: scenes.phong_plates(SIZE),
    "lamps": lambda: scenes.lamp_room(list(scenes.LAMP_KINDS), SIZE),
    "sky": under_a_sky,
}


def picture(scene: Scene, **changes):
    return render(scene, Settings(**{"samples": 15, "max_bounces": 4, "threads": 1, **changes}))


def by_path(scene: Scene, **changes):
    """As `picture`, with the other kernel."""
    with ExitStack() as patches:
        patches.enter_context(mock.patch.object(schedule, "tile_kernel", make_path_kernel))
        patches.enter_context(mock.patch.object(schedule, "new_memory", lambda _, lamps=0: new_ray(lamps)))
        return picture(scene, **changes)


def assert_same(a: np.ndarray, b: np.ndarray) -> None:
    off = np.abs(a - b).max(axis=-1) > ROUNDING * (1e-2 + np.abs(a).max(axis=-1))
    assert off.mean() <= TURNED
    assert np.allclose(a.mean(axis=(0, 1)), b.mean(axis=(0, 1)), rtol=1e-3)


@pytest.mark.parametrize("name", SCENES)
def test_both_kernels_give_the_same_picture(name):
    scene = SCENES[name]()
    one, other = picture(scene), by_path(scene)
    assert_same(one.pixels, other.pixels)
    assert one.rays == pytest.approx(other.rays, rel=1e-3)


def test_both_kernels_clamp():
    scene, clamps = SCENES["lamps"](), {"clamp_direct": 2.0, "clamp_indirect": 0.2}
    one = picture(scene, **clamps).pixels
    assert_same(one, by_path(scene, **clamps).pixels)
    assert one.mean() < 0.99 * picture(scene).pixels.mean()


def test_both_kernels_see_instances(monkeypatch):
    monkeypatch.setattr(packing, "BAKE_LIMIT", 0)
    scene = SCENES["lamps"]()
    assert_same(picture(scene).pixels, by_path(scene).pixels)


def test_both_kernels_sample_adaptively():
    scene, changes = SCENES["cornell"](), {"use_adaptive_sampling": True, "adaptive_threshold": 0.05, "samples": 128}
    one, other = picture(scene, **changes), by_path(scene, **changes)
    assert one.samples < 126 and one.samples == pytest.approx(other.samples, rel=0.02)


def test_no_bit_depends_on_where_batches_end():
    scene = SCENES["cornell"]()
    whole = picture(scene).pixels
    with mock.patch.object(schedule, "TILE_SAMPLES", 200):
        assert np.array_equal(whole, picture(scene, threads=2).pixels)
    assert SIZE * SIZE * 8 > 3 * batch.BATCH  # of the longest pass


def test_what_is_covered():
    assert covers(Features())
    for missing in ({"transparency": 1}, {"ray_kinds": 1}, {"shared_light": 0}, {"hemisphere": 2}):
        assert not covers(Features(**missing))
