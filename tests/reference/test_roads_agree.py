"""The compiled road against the reference, and the reference against itself with everything drawn differently.

Pictures of 8 seeds each: pixel by pixel with Welch's t-test, and their means.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scenes
from scipy import stats

import engine
from engine.scene import Aperture, Material, Scene
from engine.settings import Settings

SEEDS = 8
SIZE = 16
PIXEL_LEVEL = 0.0025  # a pixel fails below this p-value; so 0.25 % of them do though all is right
MEAN_LEVEL = 1e-3


def bokeh() -> Scene:
    """A small square far behind the focus, which shows the lens's shape: a triangle, stretched and turned."""
    scene = Scene(width=SIZE, height=SIZE, camera=scenes.camera())
    scene.camera = replace(scene.camera, aperture=Aperture(1.0, 2.0, blades=3, rotation=0.3, ratio=1.25))
    scene.materials = [Material("lamp", emission=(1.0, 1.0, 1.0))]
    scene.add_instance(scenes.quad_mesh((-0.4, 8, -0.4), (0.8, 0, 0), (0, 0, 0.8), "lamp"))
    return scene


SCENES: dict[str, Callable[[], Scene]] = {
    "cornell": lambda: scenes.cornell(SIZE),
    "phong plates": lambda: scenes.phong_plates(SIZE),
    "sky": lambda: scenes.sky_plate(SIZE),
    "all lamps": lambda: scenes.lamp_room(list(scenes.LAMP_KINDS), SIZE),
    "three blades": bokeh,
    **{kind: lambda kind=kind: scenes.lamp_room([kind], SIZE) for kind in scenes.LAMP_KINDS},
}


def pictures(scene: Scene, **settings) -> np.ndarray:
    """(SEEDS, pixels, 3) float64"""
    chosen = {"samples": 64, "max_bounces": 4, "pixel_filter": "BOX", "threads": 1, **settings}
    results = [engine.render(scene, Settings(**chosen, seed=seed)) for seed in range(SEEDS)]
    assert not any(result.rejected for result in results)
    return np.array([result.pixels[..., :3].reshape(-1, 3) for result in results], np.float64)


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


@pytest.mark.parametrize("name", SCENES)
def test_compiled_agrees_with_reference(name):
    scene = SCENES[name]()
    assert_agree(pictures(scene, road="COMPILED"), pictures(scene, road="REFERENCE"))


@pytest.mark.parametrize("name", ["cornell", "phong plates", "all lamps"])
def test_reference_does_not_depend_on_how_directions_are_drawn(name):
    scene = SCENES[name]()
    one = pictures(scene, road="REFERENCE")
    other = pictures(scene, road="REFERENCE", lobe_selection="CLASSIC", hemisphere_sampling="UNIFORM")
    assert_agree(one, other)


def test_a_wrong_picture_is_noticed():
    """Three percent less light all over."""
    scene = SCENES["sun"]()
    one = pictures(scene, road="REFERENCE")
    dimmer = scenes.lamp_room(["sun"], SIZE)
    dimmer.exposure = 0.97
    with pytest.raises(AssertionError, match="differ"):
        assert_agree(one, pictures(dimmer, road="REFERENCE"))
