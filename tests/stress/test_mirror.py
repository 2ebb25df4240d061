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


def replicates(scene: Scene, seeds: range, **settings) -> np.ndarray:
    """(seeds, h, w), means of the channels."""
    return np.stack([moves.render(scene, seed=seed, **settings).mean(axis=-1) for seed in seeds])


def check(make: Callable[[], Scene], most: float, seeds: int = SEEDS, **settings) -> tuple[float, float]:
    """`most`: how wide the mean's interval may be, relative. Gives the mean's difference and half width."""
    picture = replicates(make(), range(seeds), **settings)
    in_mirror = replicates(moves.mirrored(make()), range(seeds, 2 * seeds), **settings)[:, :, ::-1]
    groups = {"mean": (1, 2), "rows": 2, "columns": 1}
    means = {what: (picture.mean(axis=axes), in_mirror.mean(axis=axes)) for what, axes in groups.items()}
    found = np.nan, np.nan
    for what, (a, b) in means.items():
        difference = b.mean(axis=0) - a.mean(axis=0)
        quantile = stats.t.isf(0.5e-5 / len(means) / difference.size, 2 * seeds - 2)  # one run in 1e5 fails by chance
        half_width = quantile * np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / seeds)
        if what == "mean":
            found = float(difference / a.mean()), float(half_width / a.mean())
            print(f"mirrored: {found[0]:.2g} +- {found[1]:.2g}")
            assert found[1] < most, f"tells nothing: {found[1]:.2g}"
        slack = moves.ROUNDING * a.mean()
        assert np.all(np.abs(difference) <= half_width + slack), f"{what} differ by {difference} +- {half_width}"
    return found


@pytest.mark.parametrize("name", MADE)
def test_mirrored(name):
    check(lambda: MADE[name](SIZE), most=0.06, samples=64)


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_mirrored_sample_scene(record, name):
    """Many seeds, since of few the variance itself is uncertain."""
    samples = {"plates_phong": 1024, "lamps": 128, "world": 128}
    difference, half_width = check(lambda: sample_scene(name), most=0.01, seeds=32, samples=samples.get(name, 64))
    row = {
        "difference": f"{abs(difference):.1e}",
        "half width": f"{half_width:.1e}",
        "slack": f"{moves.ROUNDING:.1e}",
        "rejected": 0,
        "verdict": "pass",
    }
    record("stress", ("scene", "change"), {"scene": name, "change": "the world in a mirror", **row})


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
