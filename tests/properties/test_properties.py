"""What holds for every scene: random ones, drawn by hypothesis, and for the features a list of fixed ones.

Random scenes are rendered with every feature on (`forcing`), which spares the compilation of a kernel for each; the
examples are the same in every run, so a failure is one that the code has made.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from contextlib import nullcontext
from unittest import mock

import numpy as np
import pytest
import scenes
from forcing import EVERYTHING, everything_on, forced
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from properties.strategies import small_scenes

import engine.pack.geometry as packing
import engine.schedule as schedule
from engine import Material, Scene, Settings, World, render
from engine.features import DARK_WORLD, Features
from engine.kernels.jit import AS_WRITTEN
from tools.metrics import block_means, pixel_p_values

SEEDS = 8
ROADS_EXAMPLES, BITS_EXAMPLES = 20, 40
ROADS_LEVEL = 1e-6  # p of the least probable quarter of a picture, over all examples and channels
EXAMPLE = {"deadline": None, "derandomize": True, "suppress_health_check": list(HealthCheck)}


# --- the two roads ---------------------------------------------------------------------------------------------------


def replicates(scene: Scene, **changes) -> np.ndarray:
    """(SEEDS, h, w, 3)"""
    chosen = {"samples": 32, "max_bounces": 2, "pixel_filter": "BOX", "threads": 1, **changes}
    results = [render(scene, Settings(seed=seed, **chosen)) for seed in range(SEEDS)]
    assert not any(result.rejected for result in results)
    return np.array([result.pixels[..., :3] for result in results], np.float64)


def smallest_p(a: np.ndarray, b: np.ndarray) -> float:
    """Of the quarters of the picture, whose means are nearly normal."""
    return float(pixel_p_values(block_means(a, 4), block_means(b, 4)).min())


@given(scene=small_scenes(), instanced=st.booleans())
@settings(max_examples=ROADS_EXAMPLES, **EXAMPLE)
def test_both_roads_give_the_same_picture(scene, instanced):
    baking = mock.patch.object(packing, "BAKE_LIMIT", 0) if instanced else nullcontext()
    with everything_on(), baking:
        compiled = replicates(scene)
    assert smallest_p(compiled, replicates(scene, road="REFERENCE")) > ROADS_LEVEL


def test_a_road_that_is_wrong_by_ten_percent_is_noticed():
    scene = scenes.lamp_room(["sphere", "sun"], 8)
    with everything_on():
        one = replicates(scene)
        scene.exposure = 1.1
        assert smallest_p(one, replicates(scene)) < ROADS_LEVEL


# --- bits ------------------------------------------------------------------------------------------------------------


def picture(scene: Scene, **changes) -> np.ndarray:
    return render(scene, Settings(**{"samples": 7, "max_bounces": 3, "threads": 1, **changes})).pixels


def with_region(scene: Scene, region) -> Scene:
    scene.region = region
    return scene


@given(scene=small_scenes(), seed=st.integers(-(2**31), 2**31 - 1), x=st.integers(0, 6), y=st.integers(0, 6))
@settings(max_examples=BITS_EXAMPLES, **EXAMPLE)
def test_the_picture_does_not_depend_on_threads_tiles_or_regions(scene, seed, x, y):
    with everything_on():
        whole = picture(scene, seed=seed)
        assert np.array_equal(whole, picture(scene, seed=seed))
        with mock.patch.object(schedule, "TILE_SAMPLES", 1):  # four tiles in place of one
            assert np.array_equal(whole, picture(scene, seed=seed, threads=2))
        assert np.array_equal(whole[y:8, x:7], picture(with_region(scene, (x, y, 7, 8)), seed=seed))


def test_a_picture_that_depends_on_its_threads_is_noticed(monkeypatch):
    def work(self, packed, adaptive, tiles, first, count, threads=set(), whole=schedule._Render._work):  # noqa: B006
        threads.add(threading.get_ident())
        return whole(self, packed, adaptive, tiles, first + len(threads) - 1, count)

    monkeypatch.setattr(schedule._Render, "_work", work)
    with pytest.raises(AssertionError):
        test_the_picture_does_not_depend_on_threads_tiles_or_regions.hypothesis.inner_test(
            scenes.lamp_room(["area"], 8), 0, 0, 0
        )


# --- features --------------------------------------------------------------------------------------------------------


def plain() -> Scene:
    scene = scenes.lamp_room(["area"], 12)
    scene.materials = [Material("floor", kd=(0.5, 0.4, 0.3)), Material("ball", kd=(0.2, 0.4, 0.6))]
    scene.meshes[1].normals = None
    return scene


def bright() -> Scene:
    scene = scenes.cornell(12)
    scene.world = World(color=(0.1, 0.2, 0.3))
    return scene


FIXED = {
    "plain": plain,
    "emissive": lambda: scenes.cornell(12),
    "emissive under a sky": bright,
    "glossy": lambda: scenes.lamp_room(["sphere", "wide_sun"], 12),
    "image": lambda: scenes.sky_plate(12),
}
# What a feature adds lies among the other multiplications and additions, and LLVM may contract and reorder those, so
# that some pixels move by a rounding. Where it calculates as is written (kernels/jit.py) none does.
ROUNDING = 1e-5  # relative
TURNED = 0.02  # of the pixels: a rounding may turn a decision of a path over


def unused(name: str, features: Features) -> bool:
    """Of the two with consequences: kinds of rays are drawn where a surface is glossy, and a constant world is used."""
    if name == "ray_kinds":
        return not features.phong
    if name == "world":
        return features.world == DARK_WORLD
    return getattr(features, name) != EVERYTHING[name]


def switched_on(names, features: Features) -> Features:
    return features._replace(**{name: EVERYTHING[name] for name in names if unused(name, features)})


def different(scene: Scene, names) -> np.ndarray:
    """(pixels,) relative difference that these features make."""
    before = picture(scene)[..., :3]
    with forced(lambda features: switched_on(names, features)):
        after = picture(scene)[..., :3]
    return (np.abs(after - before) / np.maximum(before, 1e-6)).max(axis=-1).ravel()


def share_of_changed(scene: Scene, names) -> float:
    return float(np.mean(different(scene, names) > ROUNDING))


@pytest.mark.parametrize("name", FIXED)
def test_features_that_a_scene_does_not_use_change_no_more_than_roundings(name):
    scene = FIXED[name]()
    if share_of_changed(scene, EVERYTHING) > TURNED:
        guilty = [feature for feature in EVERYTHING if share_of_changed(scene, [feature]) > TURNED]
        pytest.fail(f"{guilty or 'several together'} change the picture of a scene without them")


@pytest.mark.skipif(not AS_WRITTEN, reason="runs in a process of its own, below")
@pytest.mark.parametrize("name", FIXED)
def test_no_bit(name):
    scene = FIXED[name]()
    if different(scene, EVERYTHING).any():
        guilty = [feature for feature in EVERYTHING if different(scene, [feature]).any()]
        pytest.fail(f"{guilty or 'several together'} change the picture of a scene without them")


@pytest.mark.skipif(AS_WRITTEN, reason="this is that process")
def test_features_that_a_scene_does_not_use_change_no_bit_of_what_is_calculated_as_written():
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-k", "test_no_bit", __file__],
        env={**os.environ, "LOBE_CALCULATE_AS_WRITTEN": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and f"{len(FIXED)} passed" in done.stdout, done.stdout


def test_a_feature_that_changes_the_picture_is_noticed(monkeypatch):
    """Clamping, switched on at a limit that the scene has not asked for."""
    limits = schedule._limits
    monkeypatch.setattr(schedule, "_limits", lambda *given: limits(*given)._replace(clamp_indirect=np.float32(0.05)))
    assert share_of_changed(FIXED["emissive"](), ["clamp"]) > TURNED


def test_every_feature_is_forced_or_is_a_choice():
    choices = {"shared_light", "orthographic", "transparent_film", "hemisphere", "lobe_selection"}
    assert set(Features._fields) == {*EVERYTHING} | choices
