"""The world in a mirror, camera and all, shows the mirrored picture.

No pixel draws the numbers that its mirror image draws, so the means of the picture, of every row and of every column
are compared by the variance between independent renders.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scenes
from sample_scenes import SCENES, sample_scene
from scipy import stats
from stress import moves

from engine.scene import Aperture, Scene

SIZE, SEEDS = 24, 8
MADE = {
    "cornell": scenes.cornell,
    "phong": scenes.phong_plates,
    "lamps": lambda size: scenes.lamp_room(list(scenes.LAMP_KINDS), size),
    "sky": scenes.sky_plate,
    "lens": lambda size: through_a_lens(scenes.lamp_room(["sphere"], size)),
}


def through_a_lens(scene: Scene) -> Scene:
    lens = Aperture(radius=0.3, focus_distance=3.0, blades=3, rotation=0.4)
    scene.camera = replace(scene.camera, aperture=lens, window=(-0.2, 0.4, -0.3, 0.3))
    return scene


def replicates(scene: Scene, first: int, **settings) -> np.ndarray:
    """(SEEDS, h, w), means of the channels, by seeds from `first` on."""
    return np.stack([moves.render(scene, seed=first + k, **settings).mean(axis=-1) for k in range(SEEDS)])


def check(make: Callable[[], Scene], most: float, **settings) -> None:
    """`most`: how wide the mean's interval may be, relative."""
    picture = replicates(make(), 1, **settings)
    in_mirror = replicates(moves.mirrored(make()), 1 + SEEDS, **settings)[:, :, ::-1]
    groups = {"mean": (1, 2), "rows": 2, "columns": 1}
    means = {what: (picture.mean(axis=axes), in_mirror.mean(axis=axes)) for what, axes in groups.items()}
    tests = sum(a[0].size for a, _ in means.values())
    quantile = stats.t.isf(0.5e-5 / tests, 2 * SEEDS - 2)
    for what, (a, b) in means.items():
        difference = b.mean(axis=0) - a.mean(axis=0)
        half_width = quantile * np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / SEEDS)
        if what == "mean":
            print(f"mirrored: {difference / a.mean():.2g} +- {half_width / a.mean():.2g}")
            assert half_width < most * a.mean(), f"tells nothing: {half_width / a.mean():.2g}"
        slack = moves.ROUNDING * a.mean()
        assert np.all(np.abs(difference) <= half_width + slack), f"{what} differ by {difference} +- {half_width}"


@pytest.mark.parametrize("name", MADE)
def test_mirrored(name):
    check(lambda: MADE[name](SIZE), most=0.06, samples=64)


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_mirrored_sample_scene(name):
    check(lambda: sample_scene(name), most=0.2, samples=16)


def test_a_picture_that_is_not_mirrored_is_caught(monkeypatch):
    """The camera looks at the mirrored world from where it stood, and an image whose columns stayed in place."""
    mirrored = moves.mirrored

    def but_for_the_camera(scene: Scene) -> Scene:
        return replace(mirrored(scene), camera=scene.camera)

    def but_for_the_image(scene: Scene) -> Scene:
        out = mirrored(scene)
        return replace(out, world=replace(out.world, image=scene.world.image))

    monkeypatch.setattr(moves, "mirrored", but_for_the_camera)
    with pytest.raises(AssertionError, match="differ"):
        check(lambda: MADE["lens"](SIZE), most=0.06, samples=64)
    monkeypatch.setattr(moves, "mirrored", but_for_the_image)
    with pytest.raises(AssertionError, match="differ"):
        check(lambda: scenes.sky_plate(SIZE), most=0.06, samples=64)
