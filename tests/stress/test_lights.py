"""Lights where they are awkward: touching the receiver, in its plane, around it, of any size."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import scenes
from stress import moves

from engine.errors import SceneError
from engine.kernels.jit import kernel
from engine.kernels.light.environment import build_environment, sample_environment
from engine.scene import AreaLight, Material, PointLight, Scene, SpotLight, Visibility, World

WHITE = Material("white", kd=(1.0, 1.0, 1.0))
ONE = (1.0, 1.0, 1.0)
UNSEEN = Visibility.ALL & ~Visibility.CAMERA


def plate(lights=(), slant=(0.0, 0.6, -0.8)) -> Scene:
    """A white plate at z = 0, of which one camera ray's width about the origin is seen."""
    scene = scenes.plate(WHITE, towards=slant)
    scene.camera = replace(scene.camera, window=(-1e-6, 1e-6, -1e-6, 1e-6))
    scene.lights = list(lights)
    return scene


def check(scene: Scene, expected: float, slack: float = 2e-4, **settings) -> None:
    picture = moves.render(scene, **{"samples": 256, **settings}).reshape(-1, 3)
    margin = moves.QUANTILE * picture.std(axis=0, ddof=1) / np.sqrt(len(picture)) + slack * expected
    assert np.all(np.abs(picture.mean(axis=0) - expected) <= margin), (
        f"measured {picture.mean(axis=0)} +- {margin}, expected {expected}"
    )


def sphere(radius: float, height: float, **more) -> PointLight:
    return PointLight("lamp", scenes.place((0, 0, height)), UNSEEN, intensity=ONE, radius=radius, **more)


@pytest.mark.parametrize("radius", [0.0, 1e-30, 1e-16, 1e-12, 1e-6, 1e-3, 0.5, 0.999, 0.9999999, 1.0])
def test_sphere_of_any_radius_above_the_receiver(radius):
    """Up to touching it: pi L (r / d)^2 = I / d^2."""
    check(plate([sphere(radius, 1.0)]), 1 / np.pi)


@pytest.mark.parametrize("radius", [1.001, 2.0, 1e3, 1e6])
@pytest.mark.parametrize("height", [1.0, 0.0, -0.5])
def test_receiver_inside_the_lamp(radius, height):
    """Radiance I / (pi r^2) from everywhere."""
    check(plate([sphere(radius, height)]), 1 / (np.pi * radius**2))


@pytest.mark.parametrize("radius", [1e-12, 1e-3, 1.0, 1e2, 1e3, 1e6])
def test_soft_lamp_of_any_radius(radius):
    """The disk that faces the receiver is a cone of sin^2 = r^2 / (r^2 + d^2), whether it lies within the sphere or
    not. By area instead of by solid angle, its noise at 100 m would be a thousand times as much."""
    lamp = sphere(radius, 1.0, soft_falloff=True)
    check(plate([lamp], slant=(0, 0, -1)), 1 / (np.pi * (1 + radius**2)))


@pytest.mark.parametrize("height", [1e-2, 1e-4])
def test_point_light_next_to_the_receiver(height):
    check(plate([sphere(0.0, height)], slant=(0, 0, -1)), 1 / (np.pi * height**2), slack=2e-3)


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("radius", [0.0, 1e-12, 1e-3, 1.0])
def test_lamp_in_the_point_that_is_seen(radius, soft):
    """Whatever is right there is finite and not negative."""
    moves.render(plate([sphere(radius, 0.0, soft_falloff=soft)]))
    spot = SpotLight("spot", scenes.place((0, 0, 0)), UNSEEN, intensity=ONE, radius=radius, soft_falloff=soft)
    moves.render(plate([spot]))


@pytest.mark.parametrize("towards", [(0, 0, 1), (0, 0, -1)])
@pytest.mark.parametrize("ellipse", [False, True])
def test_area_light_in_the_plane_of_the_receiver(towards, ellipse):
    light = AreaLight("lamp", scenes.place((1.0, 0, 0), towards), UNSEEN, radiance=ONE, ellipse=ellipse)
    check(plate([light]), 0.0)


@pytest.mark.parametrize(("height", "ellipse"), [*product([1.0, 1e-2, 1e-4], [False, True]), (1e-6, False)])
def test_area_light_that_comes_down_on_the_receiver(height, ellipse):
    """A disk of radius r at height h: r^2 / (r^2 + h^2); a square by Lambert, here with sides of 2. Still closer, light
    sampling alone finds the light (`found_by_rays`), and draws the disk by its area: right, but without end."""
    light = AreaLight("lamp", scenes.place((0, 0, height)), UNSEEN, radiance=ONE, size_x=2, size_y=2, ellipse=ellipse)
    root = np.hypot(1, height)
    square = 4 / root * np.arctan(1 / root) / np.pi
    check(plate([light]), 1 / root**2 if ellipse else square, slack=2e-3)


@pytest.mark.parametrize("height", [1.0, 1e-2, 1e-4, 1e-6])
def test_emissive_mesh_that_comes_down_on_the_receiver(height):
    scene = plate()
    scene.materials.append(Material("lamp", emission=ONE))
    quad = scenes.quad_mesh((-1, -1, height), (2, 0, 0), (0, 2, 0), "lamp")
    scene.add_instance(quad, materials=(1,), visibility=UNSEEN)
    root = np.hypot(1, height)
    check(scene, 4 / root * np.arctan(1 / root) / np.pi, slack=2e-3, max_bounces=0)


def test_emissive_mesh_in_the_plane_of_the_receiver():
    scene = plate()
    scene.materials.append(Material("lamp", emission=ONE))
    scene.add_instance(scenes.quad_mesh((1, -1, 0), (2, 0, 0), (0, 2, 0), "beside"), materials=(1,))
    check(scene, 0.0)


def test_wall_that_stands_on_the_receiver():
    """Its lower edge in the plane, half a metre from the point: Lambert's polygon, its horizontal edges."""
    light = AreaLight("lamp", scenes.place((0, 0.5, 0.5), (0, -1, 0)), UNSEEN, radiance=ONE, size_x=4, size_y=1)
    angles = np.arctan(2 / 0.5) * 1.0, np.arctan(2 / np.hypot(0.5, 1)) * 0.5 / np.hypot(0.5, 1)
    check(plate([light]), (angles[0] - angles[1]) / np.pi)


@pytest.mark.parametrize("radius", [1e1, 1e3, 1e6])
def test_emissive_mesh_around_everything(radius):
    scene = plate()
    scene.materials.append(Material("lamp", emission=ONE))
    scene.add_instance(scenes.sphere_mesh(16, radius=radius + 20, name="sky"), materials=(1,))
    check(scene, 1.0, max_bounces=0)


@pytest.mark.parametrize("brightness", [1e30, 1e-30, 1e-37])
@pytest.mark.parametrize("make", [scenes.sky_plate, lambda size: scenes.lamp_room([], size)])
def test_worlds_of_any_brightness(make, brightness):
    """The picture is as many times as bright."""
    scene = make(16)
    scene.world = replace(scene.world, color=ONE)
    expected = moves.render(scene)
    scene.world = replace(scene.world, color=(brightness,) * 3)
    found = moves.difference(moves.render(scene) / brightness, expected)
    assert found.half_width.max() < 0.02 and found.holds(1e-5 if brightness > 1e-31 else 1e-2), f"{found}"


def test_image_world_of_any_brightness():
    scene = scenes.sky_plate(16)
    expected = moves.render(scene)
    for brightness in (1e30, 1e-30):
        image = (scene.world.image * brightness).astype(np.float32)
        dim = replace(scene, world=World(scene.world.color, image, scene.world.rotation))
        found = moves.difference(moves.render(dim) / brightness, expected)
        assert found.half_width.max() < 0.02 and found.holds(1e-5), f"{found}"


def test_world_whose_image_has_negative_pixels():
    """As resampled HDR images do. The add-on has made them black before; here nobody guesses."""
    scene = scenes.sky_plate(8)
    image = scene.world.image.copy()
    image[3, 5, 1] = -1e-3
    scene.world = replace(scene.world, image=image)
    message = (
        r"the world: pixel (5, 3) of its image, counted from the bottom left, is negative "
        f"({image[3, 5, 0]:g}, -0.001, {image[3, 5, 2]:g}); set every channel to 0 or more"
    )
    for road in ("COMPILED", "REFERENCE"):
        with pytest.raises(SceneError) as found:
            moves.render(scene, road=road, samples=1)
        assert str(found.value) == message


NEARLY_BLACK = np.full((8, 16, 3), 2e-39, np.float32)  # in all but a pixel, so little that 1 / it is infinite
NEARLY_BLACK[:, ::2] *= 1.5
NEARLY_BLACK[3, 5] = 3e-34


@kernel
def draw_from_world(table, u, out):
    for i in range(len(u)):
        d, radiance, pdf = sample_environment(table, u[i, 0], u[i, 1])
        out[i, 0] = d[0] + d[1] + d[2] + pdf * radiance[0]


def test_directions_towards_an_image_that_is_nearly_black():
    """Every sum of neighbouring pixels that a sample divides by is a number whose reciprocal is one, or isn't used."""
    table = build_environment(NEARLY_BLACK)
    assert table.scale[0] > 0
    u = np.random.default_rng(1).random((1_000_000, 2), np.float32)
    out = np.zeros((len(u), 1), np.float32)
    draw_from_world(table, u, out)
    assert np.isfinite(out).all(), f"{np.count_nonzero(~np.isfinite(out))} of {len(out)}"


def test_a_lamp_that_is_a_little_too_bright_is_caught():
    with pytest.raises(AssertionError, match="expected"):
        check(plate([sphere(0.5, 1.0)]), 1.01 / np.pi)
