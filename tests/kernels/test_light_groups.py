"""The choice among lamps, suns and the sky, and lamps in odd places: what `engine/pack` makes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes
from light_checks import assert_frequencies, vec

from engine import Scene, Settings, Visibility, World
from engine.features import Features
from engine.kernels.jit import kernel
from engine.kernels.light.emitters import sample_light, sun_seen_pdf, world_seen
from engine.kernels.light.groups import LEAST_SHARE, group_shares
from engine.kernels.light.sun import sun_probability
from engine.kernels.tables import DIFFUSE_RAY
from engine.pack import Packed, pack
from engine.pack.emitters import spot_reach
from engine.scene import PointLight, SpotLight, SunLight

FLOOR, UP = (0.3, -0.2, 0.0), (0.0, 0.0, 1.0)
COUNT = 20_000


class Draws:
    """`COUNT` light samples at p with normal n: arrays `wi`, `t`, `pdf`, the luminance of `light` per density, and
    `again`, the density that a ray along wi is told for what it sees of suns and sky."""

    def __init__(self, scene: Scene, p=FLOOR, n=UP) -> None:
        scene.validate()
        self.packed: Packed = pack(scene, Settings())
        f: Features = self.packed.features

        @kernel
        def draw(geometry, lights, environment, tree, p, n, u, out):
            shares = group_shares(f, lights, tree, p, n)
            for i in range(len(u)):
                s = sample_light(f, geometry, lights, environment, tree, p, n, np.int32(-1), u[i, 0], u[i, 1], u[i, 2])
                out[i, 0], out[i, 1], out[i, 2] = s.wi
                out[i, 3], out[i, 4] = s.t, s.pdf
                cosine = max(n[0] * s.wi[0] + n[1] * s.wi[1] + n[2] * s.wi[2], np.float32(0))
                out[i, 5] = s.radiance[1] * cosine / s.pdf if s.pdf > 0 else np.float32(0)
                out[i, 6] = world_seen(f, lights, shares, environment, s.wi, DIFFUSE_RAY)[1]
                for k in range(len(lights.suns)):
                    out[i, 7] += sun_seen_pdf(f, lights, shares, k, n, s.wi, DIFFUSE_RAY)[1]
            return shares

        @kernel
        def chances(suns, n, out):
            for k in range(len(out)):
                out[k] = sun_probability(suns, k, n)

        tables, out = self.packed, np.zeros((COUNT, 8), np.float32)
        u = np.random.default_rng(1).random((COUNT, 3)).astype(np.float32)
        u = np.minimum(u, np.float32(1 - 2**-24))
        lights, normal = tables.lights, vec(n)
        shares = draw(tables.geometry, lights, tables.environment, tables.tree, vec(p), normal, u, out)
        self.shares = np.array(shares, np.float64)
        self.sun_chances = np.zeros(len(lights.suns), np.float32)
        chances(lights.suns, normal, self.sun_chances)
        self.wi, self.t, self.pdf, self.light = out[:, :3], out[:, 3], out[:, 4], out[:, 5].astype(np.float64)
        self.world_pdf, self.sun_pdf = out[:, 6], out[:, 7]

    @property
    def variance(self) -> float:
        """Relative, of one sample."""
        return self.light.var() / self.light.mean() ** 2


def sun(irradiance: float, towards=(-0.4, 0.3, -0.8), angle: float = 0.0, **rest) -> SunLight:
    return SunLight("sun", scenes.place(towards=towards), irradiance=(irradiance,) * 3, angle=angle, **rest)


def lamps(count: int, intensity: float) -> list[PointLight]:
    """On a circle above the floor's middle, all alike, so that the choice among them adds no noise."""
    turns = 2 * np.pi * np.arange(count) / count
    places = [scenes.place((FLOOR[0] + np.cos(a), FLOOR[1] + np.sin(a), 2.0)) for a in turns]
    return [PointLight(f"lamp {i}", place, intensity=(intensity / count,) * 3) for i, place in enumerate(places)]


def room(lights, color=(0.0, 0.0, 0.0)) -> Scene:
    scene = scenes.lamp_room([], 8)
    scene.lights = list(lights)
    scene.world = World(color=color, image=scenes.sky_image())
    return scene


def test_the_densities_of_both_ways_are_one():
    """Each sample's group is told by its distance and direction; the seen density has to be that of the sample."""
    suns = [sun(2.0, angle=0.3), sun(1.0, (0.7, 0.2, -0.5), angle=0.2)]
    drawn = Draws(room([*lamps(5, 20.0), *suns], (0.7, 0.6, 0.5)))
    assert_densities(drawn, suns, 1.0, drawn.shares)
    # What is told wrongly by 5 %: densities, and shares.
    for told, shares in ((1.05, drawn.shares), (1.0, drawn.shares * (1.05, 0.95, 0.95))):
        with pytest.raises(AssertionError):
            assert_densities(drawn, suns, told, shares)


def assert_densities(drawn: Draws, suns: list[SunLight], told: float, shares: np.ndarray) -> None:
    """`told`: a factor of what rays are told, `shares` of the groups as they are told."""
    far = np.isinf(drawn.t)
    cosines = drawn.wi @ np.array([light.transform[:, 2] for light in suns]).T
    in_disk = (cosines > np.cos([0.15, 0.1])).any(axis=1)
    assert drawn.shares.sum() == pytest.approx(1, rel=1e-6)
    observed = np.array([(~far).sum(), far.sum()])
    assert_frequencies(observed, np.array([shares[0], shares[1:].sum()]) * COUNT)
    # Directions in a sun's disk may be drawn as that sun or as sky: the pdf is one of the two that rays are told.
    sky = far & ~in_disk
    assert np.allclose(drawn.pdf[sky], told * drawn.world_pdf[sky], rtol=1e-2)
    both = far & in_disk
    assert both.sum() > 1000
    as_sun = np.isclose(drawn.pdf[both], told * drawn.sun_pdf[both], rtol=1e-4)
    as_sky = np.isclose(drawn.pdf[both], told * drawn.world_pdf[both], rtol=1e-2)
    assert np.all(as_sun | as_sky)
    assert as_sun.sum() == pytest.approx(drawn.shares[1] * COUNT, rel=0.05)
    assert drawn.sun_chances.sum() == pytest.approx(1, rel=1e-5)


@pytest.mark.parametrize(
    "lights, most",
    [
        ([*lamps(100, 0.5), sun(20.0)], 0.4),
        ([*lamps(100, 100.0), sun(0.1)], 0.4),
        ([sun(20.0), sun(0.2, (0.5, 0.1, -0.5)), sun(0.1, (0.1, -0.9, -0.2))], 1e-6),
    ],
    ids=["strong sun", "strong lamps", "suns"],
)
def test_what_shines_most_is_sampled_most(lights, most):
    """Even shares give a variance of 1 with two groups, of 2 with three suns."""
    assert Draws(room(lights)).variance < most


def test_the_weaker_group_keeps_its_share():
    shares = Draws(room([*lamps(3, 1e-6), sun(1e6)])).shares
    least = LEAST_SHARE / (1 + LEAST_SHARE)
    assert shares == pytest.approx([least, 1 - least, 0], rel=1e-3)


@pytest.mark.parametrize(
    "hidden", [sun(5.0, (0.1, 0.0, 0.9)), sun(5.0, visibility=Visibility.CAMERA)], ids=["below", "camera only"]
)
def test_suns_that_cannot_light_the_point_are_never_drawn(hidden):
    drawn = Draws(room([*lamps(3, 1.0), hidden]))
    assert drawn.shares == pytest.approx([1, 0, 0])
    assert np.all(np.isfinite(drawn.t)) and np.all(drawn.pdf > 0)


def test_a_wide_sun_that_is_half_below_the_horizon_is_drawn():
    drawn = Draws(room([*lamps(3, 0.01), sun(5.0, (1.0, 0.0, 0.05), angle=0.5)]))
    assert drawn.shares[1] > 0.2 and np.all(drawn.wi[np.isinf(drawn.t)] @ (-1.0, 0.0, -0.05) > 0.9)


def test_a_sky_that_only_the_camera_sees_is_never_drawn():
    scene = room(lamps(3, 1.0), (1.0, 1.0, 1.0))
    scene.world = replace(scene.world, visibility=Visibility.CAMERA)
    assert Draws(scene).shares == pytest.approx([1, 0, 0])


def test_the_sky_counts_by_where_it_is_bright():
    """A turned sky, bright towards the world's +y only, and a lamp that lights both sides alike."""
    image = np.full((16, 32, 3), 0.1, np.float32)
    image[12:] = 5.0  # about the environment's +z
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
    share = {}
    for side in (1.0, -1.0):
        scene = room([PointLight("lamp", scenes.place((FLOOR[0], FLOOR[1] + 2 * side, 0)), intensity=(8.0,) * 3)])
        scene.world = World(color=(1.0, 1.0, 1.0), image=image, rotation=turn)
        share[side] = Draws(scene, n=(0.0, side, 0.0)).shares[2]
    assert share[1.0] > 1.5 * share[-1.0]


def test_the_reach_of_a_spot_holds_its_whole_cone():
    random = np.random.default_rng(4)
    turns = 2 * np.pi * np.arange(720) / 720
    slack = []
    for k in range(300):
        matrix = random.normal(size=(3, 3)) * random.uniform(0.2, 1, 3) if k else np.diag([3.0, 1.0, 0.5])
        half = random.uniform(0.1, 1.5) if k else 0.7
        rim = np.stack([np.sin(half) * np.cos(turns), np.sin(half) * np.sin(turns), -np.full(720, np.cos(half))])
        world = matrix @ rim
        axis = -matrix[:, 2] / np.linalg.norm(matrix[:, 2])
        widest = np.arccos(np.clip(axis @ world / np.linalg.norm(world, axis=0), -1, 1)).max()
        light = SpotLight("spot", np.column_stack([matrix, np.zeros(3)]), half_angle=half)
        slack.append(spot_reach(light) - widest)
    assert min(slack) > -1e-9
    assert abs(slack[0]) < 1e-4, "exact without a shear"
