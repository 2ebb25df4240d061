"""What holds for every scene: random ones, drawn by hypothesis.

They are rendered with every feature on (`forcing`), which spares the compilation of a kernel for each; for the features
themselves they are brought down to what one of a few kernels has, and rendered by that one, too. The examples are the
same in every run, so a failure is one that the code has made.
"""

from __future__ import annotations

import threading
from contextlib import nullcontext
from dataclasses import replace
from typing import NamedTuple
from unittest import mock

import numpy as np
import pytest
import scenes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from properties.strategies import small_scenes

import engine.pack.geometry as packing
from engine import Lamp, Material, Scene, Settings, Visibility, World, render, schedule, tiles
from engine.features import (
    CONSTANT_WORLD,
    DARK_WORLD,
    EMITTER_TREE,
    EVERYTHING,
    IMAGE_WORLD,
    LISTED_LAMPS,
    ONE_EMITTER,
    RECTANGLE,
    SPHERE,
    Features,
)
from engine.kernels.jit import AS_WRITTEN
from tools.forcing import everything_alike_on, everything_on, forced
from tools.metrics import block_means, pixel_p_values

SEEDS = 8
ROADS_EXAMPLES, BITS_EXAMPLES, KERNEL_EXAMPLES = 20, 40, 16
FEATURE_SETS = [everything_on, everything_alike_on]
# What a feature adds lies among the other multiplications and additions, and LLVM may contract and reorder those, so
# that some pixels move by a rounding; other tiles make other packets of rays, which Embree may meet with another.
# Where kernels calculate as is written (kernels/jit.py) none moves.
ROUNDING = 1e-5  # relative
TURNED = 0.02  # of the pixels: a rounding may turn a decision of a path over
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


@pytest.mark.parametrize("features_on", FEATURE_SETS)
@given(scene=small_scenes(), instanced=st.booleans())
@settings(max_examples=ROADS_EXAMPLES, **EXAMPLE)
def test_both_roads_give_the_same_picture(features_on, scene, instanced):
    baking = mock.patch.object(packing, "BAKE_LIMIT", 0) if instanced else nullcontext()
    with features_on(), baking:
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


# Adaptive sampling looks at the picture as it goes, and rejection takes as many numbers as it needs.
WAYS = {
    "adaptive": {"samples": 64, "use_adaptive_sampling": True, "adaptive_threshold": 0.2},
    "rejection": {"hemisphere_sampling": "REJECTION"},
}


def assert_same_picture(scene: Scene, seed: int, x: int, y: int, **way) -> None:
    """On any number of threads to the bit; of other tiles or a region but for roundings (`ROUNDING`)."""
    whole = picture(scene, seed=seed, **way)
    assert np.array_equal(whole, picture(scene, seed=seed, **way))
    with mock.patch.object(tiles, "TILE_SAMPLES", 1):  # four tiles in place of one
        cut = picture(scene, seed=seed, **way)
        assert np.array_equal(cut, picture(scene, seed=seed, threads=2, **way))
    assert_same_but_for_roundings(whole, cut)
    if not way.get("use_adaptive_sampling"):  # which goes by a pixel's neighbours, too
        part = picture(with_region(scene, (x, y, 7, 8)), seed=seed, **way)
        assert_same_but_for_roundings(whole[y:8, x:7], part)


def assert_same_but_for_roundings(a: np.ndarray, b: np.ndarray) -> None:
    if AS_WRITTEN:
        assert np.array_equal(a, b)
    assert np.mean(np.any(np.abs(a - b) > ROUNDING * np.maximum(a, 1e-6), axis=-1)) <= TURNED


A_PLACE = {"seed": st.integers(-(2**31), 2**31 - 1), "x": st.integers(0, 6), "y": st.integers(0, 6)}


@pytest.mark.parametrize("features_on", FEATURE_SETS)
@given(scene=small_scenes(), **A_PLACE)
@settings(max_examples=BITS_EXAMPLES, **EXAMPLE)
def test_the_picture_does_not_depend_on_threads_tiles_or_regions(features_on, scene, seed, x, y):
    with features_on():
        assert_same_picture(scene, seed, x, y)


@given(scene=small_scenes(), **A_PLACE)
@settings(max_examples=BITS_EXAMPLES // 5, **EXAMPLE)
def test_nor_does_it_with_adaptive_sampling(scene, seed, x, y):
    with everything_on():
        assert_same_picture(scene, seed, x, y, **WAYS["adaptive"])


@given(scene=small_scenes(), **A_PLACE)
@settings(max_examples=BITS_EXAMPLES // 2, **EXAMPLE)
def test_nor_does_it_with_rejection_sampling(scene, seed, x, y):
    """By the smallest of kernels, as it is one more to compile."""
    with forced(lambda own: raised("plain", own)):
        assert_same_picture(brought_down("plain", scene), seed, x, y, **WAYS["rejection"])


@pytest.mark.skipif(not AS_WRITTEN, reason="runs in a process of its own, below")
@given(scene=small_scenes(), **A_PLACE)
@settings(max_examples=BITS_EXAMPLES // 2, **EXAMPLE)
def test_no_bit_depends_on_tiles_or_regions(scene, seed, x, y):
    with everything_on():
        assert_same_picture(scene, seed, x, y)


def test_a_picture_that_depends_on_its_threads_is_noticed(monkeypatch):
    def work(self, packed, film, adaptive, tiles, first, count, threads=set(), whole=schedule._Render._work):  # noqa: B006
        threads.add(threading.get_ident())
        return whole(self, packed, film, adaptive, tiles, first + len(threads) - 1, count)

    monkeypatch.setattr(schedule._Render, "_work", work)
    with pytest.raises(AssertionError):
        test_the_picture_does_not_depend_on_threads_tiles_or_regions.hypothesis.inner_test(
            everything_on, scenes.lamp_room(["area"], 8), 0, 0, 0
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


class Kept(NamedTuple):
    """What a kernel has, and so what is left of a random scene that it renders. Features that are not named are off."""

    features: dict[str, int]
    lamps: tuple[str, ...] = ()  # of scenes.LAMP_KINDS
    world: int = DARK_WORLD


# Each feature is on in one of these and off in another.
KERNELS = {
    "plain": Kept({"lamp_kinds": RECTANGLE, "lamp_shapes": LISTED_LAMPS, "emitter_choice": ONE_EMITTER}, ("area",)),
    "emissive": Kept({"mesh_emitters": 1, "rectangle_emitters": 1, "emitter_choice": EMITTER_TREE}),
    "emissive under a sky": Kept(
        {"mesh_emitters": 1, "rectangle_emitters": 1, "emitter_choice": EMITTER_TREE, "transparency": 1, "lens": 1},
        world=CONSTANT_WORLD,
    ),
    "glossy": Kept(
        {
            "phong": 1, "smooth": 1, "lamp_kinds": SPHERE, "lamp_shapes": LISTED_LAMPS, "emitter_choice": EMITTER_TREE,
            "unshadowed": 1, "suns": 1, "sun_disks": 1,
        },
        ("sphere", "wide_sun"),
    ),
    "image": Kept({"phong": 1, "instances": 1, "ray_kinds": 1, "clamp": 1}, world=IMAGE_WORLD),
}  # fmt: skip


def brought_down(name: str, scene: Scene) -> Scene:
    """What the kernel can render of the scene: the rest is taken out or made plain."""
    kept = KERNELS[name]
    has = kept.features.get
    black, seen = (0.0, 0.0, 0.0), Visibility.ALL
    scene.lights = [lamp for kind in kept.lamps for lamp in lamps_like(scene, kind, bool(has("unshadowed")))]
    scene.materials = [
        replace(
            material,
            ks=material.ks if has("phong") else black,
            emission=material.emission if has("mesh_emitters") else black,
            transparency=material.transparency if has("transparency") else black,
        )
        for material in scene.materials
    ]
    scene.meshes = [mesh if has("smooth") else replace(mesh, normals=None) for mesh in scene.meshes]
    if not has("lens"):
        scene.camera = replace(scene.camera, aperture=None)
    # Shadow rays see what all others see: where not is no feature, but a way to calculate (kernels/mis.py).
    scene.instances.visibility |= np.uint8(Visibility.SHADOW if has("ray_kinds") else seen)
    if not has("ray_kinds"):
        scene.world = replace(scene.world, visibility=seen)
    color = scene.world.color if kept.world != DARK_WORLD else black
    image = scenes.sky_image(4, 8) if kept.world == IMAGE_WORLD else None
    scene.world = replace(scene.world, color=color, image=image)
    return scene


def lamps_like(scene: Scene, kind: str, unshadowed: bool) -> list[Lamp]:
    """One of this kind, where the first lamp of the scene stands."""
    like = [scenes.lamp(kind)]
    for lamp in scene.lights[:1]:
        like = [replace(like[0], transform=lamp.transform, cast_shadow=lamp.cast_shadow or not unshadowed)]
    return like


def raised(name: str, own: Features) -> Features:
    """The kernel's features; those of the scene that it leaves open are the scene's."""
    kept = KERNELS[name]
    closed = {feature: kept.features.get(feature, 0) for feature in EVERYTHING if feature != "world"}
    return own._replace(**{**closed, "world": max(own.world, kept.world)})


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


def changed_bits(name: str, scene: Scene, names) -> bool:
    before, after = (drawn_by(name, scene, chosen) for chosen in ((), names))
    return bool((before != after).any())


def drawn_by(name: str, scene: Scene, names) -> np.ndarray:
    with forced(lambda own: switched_on(names, raised(name, own))):
        return picture(scene)


@pytest.mark.skipif(not AS_WRITTEN, reason="runs in a process of its own, below")
@pytest.mark.parametrize("name", KERNELS)
def test_no_bit(name):
    @given(scene=small_scenes())
    @settings(max_examples=KERNEL_EXAMPLES, **EXAMPLE)
    def holds(scene):
        scene = brought_down(name, scene)
        if changed_bits(name, scene, EVERYTHING):
            guilty = [feature for feature in EVERYTHING if changed_bits(name, scene, [feature])]
            pytest.fail(f"{guilty or 'several together'} change the picture of a scene without them")

    holds()


@pytest.mark.skipif(not AS_WRITTEN, reason="runs in a process of its own, below")
def test_no_bit_can_be_changed_unseen(monkeypatch):
    limits = tiles.limits_of
    monkeypatch.setattr(tiles, "limits_of", lambda *given: limits(*given)._replace(clamp_indirect=np.float32(1e-4)))
    with pytest.raises(pytest.fail.Exception, match="clamp"):
        test_no_bit("emissive under a sky")


@pytest.mark.skipif(AS_WRITTEN, reason="this is that process")
def test_features_that_a_scene_does_not_use_change_no_bit_of_what_is_calculated_as_written(pass_as_written):
    pass_as_written(__file__, "test_no_bit", len(KERNELS) + 2)


def test_a_feature_that_changes_the_picture_is_noticed(monkeypatch):
    """Clamping, switched on at a limit that the scene has not asked for."""
    limits = tiles.limits_of
    monkeypatch.setattr(tiles, "limits_of", lambda *given: limits(*given)._replace(clamp_indirect=np.float32(0.05)))
    assert share_of_changed(FIXED["emissive"](), ["clamp"]) > TURNED


def test_every_feature_is_forced_or_is_a_choice():
    choices = {
        "shared_light",
        "orthographic",
        "transparent_film",
        "holdout",
        "hemisphere",
        "lobe_selection",
        "light_passes",
    }
    assert set(Features._fields) == {*EVERYTHING} | choices
