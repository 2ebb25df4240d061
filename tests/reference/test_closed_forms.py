"""Scenes whose picture is known from a formula, on both roads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes
from reference import slab
from reference.irradiance import polygon_irradiance, smoothstep
from reference.slab import Slab

from engine.scene import AreaLight, Camera, Material, PointLight, Scene, SpotLight, SunLight, World

DEEP = {"max_bounces": 64, "diffuse_bounces": 64, "glossy_bounces": 64}
WHITE = Material("white", kd=(1.0, 1.0, 1.0))
ONE = (1.0, 1.0, 1.0)
IDENTITY = np.eye(3)


# Furnaces: any closed surface, reflectance kd, emission Le


@pytest.mark.parametrize("bounces", [0, 1, 3])
@pytest.mark.parametrize("limit", ["max_bounces", "diffuse_bounces"])
def test_furnace_shows_one_more_term_than_bounces(measure, bounces, limit):
    """The bounce rule: Le * sum(kd^i, i = 0 .. bounces + 1), as Cycles has it."""
    picture = measure(scenes.furnace(kd=0.5, emission=0.5), samples=64, **{limit: bounces})
    picture.check(0.5 * sum(0.5**i for i in range(bounces + 2)))


def test_glossy_bounces_do_not_limit_a_diffuse_furnace(measure):
    measure(scenes.furnace(), samples=64, max_bounces=2, glossy_bounces=0).check(0.5 * (1 + 0.5 + 0.25 + 0.125))


@pytest.mark.parametrize("kd", [0.2, 0.8])
@pytest.mark.parametrize("mesh", [scenes.sphere_mesh(12), scenes.cube_mesh()], ids=["sphere", "cube"])
def test_furnace_in_the_limit(measure, mesh, kd):
    measure(scenes.furnace(kd, 1 - kd, mesh, size=4), samples=64, **DEEP).check(1)


@pytest.mark.parametrize("hemisphere", ["COSINE", "UNIFORM", "REJECTION"])
def test_furnace_for_each_hemisphere_sampling(measure, hemisphere):
    scene = scenes.furnace()
    measure(scene, samples=64, max_bounces=1, hemisphere_sampling=hemisphere).check(0.875)


@pytest.mark.parametrize(("total", "diffuse", "glossy"), [(2, 8, 8), (8, 1, 2)])
def test_plates_of_both_lobes(measure, total, diffuse, glossy):
    """Many bounces with a glossy lobe, and what each limit counts."""
    plates = Slab(0.3, 0.6, 10, 60)
    limits = {"max_bounces": total, "diffuse_bounces": diffuse, "glossy_bounces": glossy}
    picture = measure(slab.scene(plates, 8), samples=64, **limits)
    picture.check(slab.radiance(plates, total, diffuse, glossy))


def test_point_light_in_a_sphere(measure):
    """pbrt-v4's integrator test. The mesh lies a little inside the sphere, so its walls are a little brighter."""
    measure(scenes.lit_sphere(), samples=64, **DEEP).check(1, slack=2e-3)


@pytest.mark.parametrize(("wall", "factor"), [("ceiling", 0.1998249), ("side", 0.2000438)])
def test_form_factors_of_a_cube(measure, wall, factor):
    """An orthographic camera averages the floor of the unit cube under one emissive wall."""
    scene = Scene(width=8, height=8)
    scene.camera = Camera(
        transform=scenes.place((0, 0, 0.25)), window=(-0.5, 0.5, -0.5, 0.5), orthographic=True, clip_start=0.01
    )
    scene.materials = [WHITE, Material("lamp", emission=ONE)]
    scene.add_instance(scenes.quad_mesh((-0.5, -0.5, 0), (1, 0, 0), (0, 1, 0), "floor"))
    emitter = {
        "ceiling": scenes.quad_mesh((-0.5, -0.5, 1), (1, 0, 0), (0, 1, 0), "ceiling"),
        "side": scenes.quad_mesh((-0.5, -0.5, 0), (0, 1, 0), (0, 0, 1), "side"),
    }[wall]
    scene.add_instance(emitter, materials=(1,))
    measure(scene, samples=256, max_bounces=0).check(factor, slack=1e-4)


# Irradiance E of a white plate by one lamp: it shows E / pi


def plate_under(light, **kwargs) -> Scene:
    return scenes.lit_plate([light], WHITE, **kwargs)


SLANT = np.array([0.9, 0.4, 2.0])  # where the lamps stand, seen from the middle of the plate
DISTANCE = float(np.linalg.norm(SLANT))
COSINE = SLANT[2] / DISTANCE
AT_PLATE = scenes.place(SLANT, -SLANT)  # there, shining at the middle


def test_point(measure):
    light = PointLight("lamp", AT_PLATE, intensity=(3.0, 2.0, 1.0))
    measure(plate_under(light)).check(np.array([3, 2, 1]) * COSINE / DISTANCE**2 / np.pi)


@pytest.mark.parametrize("radius", [0.01, 0.7])
def test_sphere(measure, radius):
    """pi L (r / d)^2 cos with L = I / (pi r^2): a sphere above the horizon lights like a point."""
    light = PointLight("lamp", AT_PLATE, intensity=ONE, radius=radius)
    measure(plate_under(light)).check(COSINE / DISTANCE**2 / np.pi, slack=1e-4)


def test_disk_that_faces_the_point(measure):
    """Soft falloff: pi L r^2 / (r^2 + d^2) along the axis."""
    light = PointLight("lamp", AT_PLATE, intensity=ONE, radius=0.7, soft_falloff=True)
    measure(plate_under(light)).check(COSINE / (DISTANCE**2 + 0.49) / np.pi, slack=1e-4)


@pytest.mark.parametrize("radius", [0.0, 1e-3])
@pytest.mark.parametrize("soft", [False, True])
def test_spot(measure, radius, soft):
    """Seen 0.3 rad off its axis, in a cone of 0.5 rad with a wide rim."""
    off = 0.3
    tilted = -SLANT / DISTANCE * np.cos(off) + np.cross(SLANT, (0, 0, 1)) / np.linalg.norm(SLANT[:2]) * np.sin(off)
    light = SpotLight(
        "lamp", scenes.place(SLANT, tilted), intensity=ONE, radius=radius, half_angle=0.5, blend=0.8, soft_falloff=soft
    )
    s = (np.cos(off) - np.cos(0.5)) / ((1 - np.cos(0.5)) * 0.8)
    expected = s * s * (3 - 2 * s) * COSINE / DISTANCE**2 / np.pi
    measure(plate_under(light)).check(expected, slack=5e-4)


@pytest.mark.parametrize(("off", "expected"), [(0.499, 1), (0.501, 0)])
def test_spot_with_a_hard_rim(measure, off, expected):
    side = np.array([0.0, 0.0, 1.0]) - COSINE * SLANT / DISTANCE
    tilted = -SLANT / DISTANCE * np.cos(off) + side / np.linalg.norm(side) * np.sin(off)
    light = SpotLight("lamp", scenes.place(SLANT, tilted), intensity=ONE, half_angle=0.5, blend=0.0)
    measure(plate_under(light)).check(expected * COSINE / DISTANCE**2 / np.pi)


def test_spot_cone_follows_the_scale_of_the_lamp(measure):
    """Scaled 2 in x, the cone is wider in x: 0.7 rad off the axis shrinks to atan(tan(0.7) / 2)."""
    wide = scenes.place((0, 0, 2), (np.sin(0.7), 0, -np.cos(0.7)), up=(0, 1, 0), scale=(2, 1, 1))
    light = SpotLight("lamp", wide, intensity=ONE, half_angle=0.5, blend=1.0)
    cosine = np.cos(np.arctan(np.tan(0.7) / 2))
    s = (cosine - np.cos(0.5)) / (1 - np.cos(0.5))
    measure(plate_under(light)).check(s * s * (3 - 2 * s) / 4 / np.pi, slack=5e-4)


def area_corners(light: AreaLight) -> np.ndarray:
    x, y = light.transform[:, 0] * light.size_x / 2, light.transform[:, 1] * light.size_y / 2
    return light.transform[:, 3] + np.array([-x - y, x - y, x + y, y - x])


@pytest.mark.parametrize("scale", [(1, 1, 1), (1.5, 0.5, 2), (-1, 1, 1)], ids=str)
def test_area_rectangle(measure, scale):
    light = AreaLight("lamp", scenes.place(SLANT, (-0.5, 0, -1), scale=scale), radiance=ONE, size_x=1.5, size_y=0.8)
    measure(plate_under(light)).check(polygon_irradiance(area_corners(light)) / np.pi, slack=2e-4)


def test_area_shines_to_one_side(measure):
    light = AreaLight("lamp", scenes.place(SLANT, (0.5, 0, 1)), radiance=ONE)
    measure(plate_under(light)).check(0)


def test_area_ellipse_as_coaxial_disk(measure):
    light = AreaLight("lamp", scenes.place((0, 0, 2)), radiance=ONE, size_x=1.4, size_y=1.4, ellipse=True)
    measure(plate_under(light)).check(0.49 / (0.49 + 4), slack=1e-4)


@pytest.mark.parametrize("spread", [0.05, 1.0, 3.0])
def test_area_spread(measure, spread):
    """A small lamp seen 0.4 h off its axis: L A cos / d^2 times the factor of the spread."""
    half = spread / 2
    theta = 0.4 * half
    tilted = np.array([np.sin(theta), 0, -np.cos(theta)])
    light = AreaLight("lamp", scenes.place((0, 0, 2), tilted), radiance=ONE, size_x=1e-3, size_y=1e-3, spread=spread)
    factor = (np.tan(half) - np.tan(theta)) / (np.tan(half) - half)
    measure(plate_under(light)).check(1e-6 * np.cos(theta) / 4 * factor / np.pi, slack=5e-3)


@pytest.mark.parametrize("angle", [0.0, 0.0092, 0.6])
def test_sun(measure, angle):
    light = SunLight("lamp", AT_PLATE, irradiance=(2.0, 1.0, 0.5), angle=angle)
    measure(plate_under(light)).check(np.array([2, 1, 0.5]) * COSINE / np.pi)


def test_emissive_mesh(measure):
    corner, u, v = np.array([0.5, -0.3, 1.5]), np.array([1.0, 0.2, 0.1]), np.array([-0.1, 0.6, 0.5])
    scene = scenes.plate(WHITE, towards=(0.0, 0.6, -0.8))
    scene.materials.append(Material("lamp", emission=(1.0, 2.0, 4.0)))
    scene.add_instance(scenes.quad_mesh(corner, u, v), materials=(1,))
    e = polygon_irradiance(np.array([corner, corner + u, corner + u + v, corner + v]))
    measure(scene, samples=64, max_bounces=0).check(np.array([1, 2, 4]) * e / np.pi, slack=2e-4)


# The Phong lobe under a constant world of radiance 1 shows its directional albedo (shared table, by quadrature)

ALBEDO = {
    (0, 0): 1.0,
    (0, 60): 0.75,
    (1, 45): 0.7554092,
    (2, 75): 0.3961563,
    (10, 60): 0.5047359,
    (10, 85): 0.1712746,
    (100, 0): 1.0,
    (100, 75): 0.2589454,
    (1000, 45): 0.7071068,
}


def plate_at(degrees: float, material: Material) -> Scene:
    angle = np.radians(degrees)
    scene = scenes.plate(material, towards=(np.sin(angle), 0, -np.cos(angle)))
    scene.camera = replace(scene.camera, window=(-1e-5, 1e-5, -1e-5, 1e-5))
    scene.world = World(color=ONE)
    return scene


@pytest.mark.parametrize(("exponent", "degrees"), ALBEDO)
@pytest.mark.parametrize("selection", ["ALBEDO", "CLASSIC"])
def test_phong_albedo(measure, exponent, degrees, selection):
    kd, ks = 0.3, np.array([0.7, 0.4, 0.1])
    scene = plate_at(degrees, Material("phong", kd=(kd,) * 3, ks=tuple(ks), exponent=exponent))
    picture = measure(scene, samples=128, lobe_selection=selection, max_bounces=0)
    picture.check(kd + ks * ALBEDO[exponent, degrees], slack=2e-4)


@pytest.mark.parametrize("exponent", [1e4, 1e6])
def test_sharp_phong_is_a_mirror(measure, exponent):
    """Directional albedo cos(theta) in the limit."""
    scene = plate_at(60, Material("phong", ks=ONE, exponent=exponent))
    measure(scene, samples=64, max_bounces=0).check(0.5, slack=2e-4)


@pytest.mark.parametrize("hemisphere", ["COSINE", "UNIFORM", "REJECTION"])
def test_hemisphere_sampling_with_both_lobes(measure, hemisphere):
    scene = plate_at(60, Material("phong", kd=(0.4,) * 3, ks=(0.5,) * 3, exponent=10))
    measure(scene, samples=128, hemisphere_sampling=hemisphere).check(0.4 + 0.5 * ALBEDO[10, 60], slack=2e-4)


# World images


def image_of(function, height: int = 128) -> np.ndarray:
    """(height, 2 height, 3) radiance `function(x, y, z)` of the direction in environment space."""
    u, v = np.meshgrid((np.arange(2 * height) + 0.5) / (2 * height), (np.arange(height) + 0.5) / height)
    phi, theta = (2 * u - 1) * np.pi, v * np.pi
    value = function(-np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta))
    return np.repeat(value[..., None], 3, axis=2).astype(np.float32)


def under_image(function, rotation=IDENTITY) -> Scene:
    scene = scenes.plate(WHITE, towards=(0.0, 0.6, -0.8))
    scene.world = World(color=(1.0, 0.5, 2.0), image=image_of(function), rotation=rotation)
    return scene


def test_constant_image_is_a_constant_world(measure):
    scene = under_image(lambda x, y, z: np.ones_like(x))
    measure(scene, samples=128).check((1, 0.5, 2), slack=1e-4)


def test_image_that_brightens_upwards(measure):
    scene = under_image(lambda x, y, z: np.maximum(z, 0))
    measure(scene, samples=128).check(np.array([1, 0.5, 2]) * 2 / 3, slack=1e-3)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_image_is_rotated(measure, axis):
    """Bright around the world's +x, stored along another axis of environment space: E = 2/3."""
    scene = under_image(lambda *d: np.maximum(d[axis], 0), np.roll(np.eye(3), axis, axis=0))
    measure(scene, samples=128).check(np.array([1, 0.5, 2]) * 2 / 3 / np.pi, slack=1e-3)


def test_camera_sees_the_image_where_it_is(render):
    """A direction d in environment space has u = (1 - atan2(d.y, d.x) / pi) / 2 and v = acos(-d.z) / pi."""
    image = np.random.default_rng(1).random((8, 16, 3)).astype(np.float32)
    for row, column in [(0, 3), (4, 0), (5, 15), (7, 8)]:
        phi, theta = (1 - 2 * (column + 0.5) / 16) * np.pi, (row + 0.5) / 8 * np.pi
        d = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta))
        scene = Scene(width=1, height=1, camera=scenes.camera(towards=d, half_width=1e-6))
        scene.world = World(color=ONE, image=image)
        pixel = render(scene, samples=1).pixels[0, 0, :3]
        np.testing.assert_allclose(pixel, image[row, column], rtol=2e-4, atol=2e-4)


# What is broken is caught: each scene has one thing that its formula doesn't have


def dim(lamp: str, **change) -> Scene:
    """A plate under a lamp that is as the formulas above have it, but for `change`."""
    side = np.cross(SLANT, (0, 0, 1)) / np.linalg.norm(SLANT[:2])
    tilted = scenes.place(SLANT, -SLANT / DISTANCE * np.cos(0.3) + side * np.sin(0.3))
    made = {
        "point": PointLight("lamp", AT_PLATE, intensity=ONE),
        "spot": SpotLight("lamp", tilted, intensity=ONE, half_angle=0.5, blend=0.8),
        "area": AreaLight("lamp", scenes.place((0, 0, 2)), radiance=ONE, size_x=1.4, size_y=1.4, ellipse=True),
        "sun": SunLight("lamp", AT_PLATE, irradiance=ONE, angle=0.6),
    }[lamp]
    return plate_under(replace(made, **change), size=4)


def phong(exponent: float) -> Scene:
    return plate_at(60, Material("phong", ks=ONE, exponent=exponent))


RIGHT = {
    "furnace": (lambda: scenes.furnace(size=4), 0.875),
    "point": (lambda: dim("point"), COSINE / DISTANCE**2 / np.pi),
    "spot": (lambda: dim("spot"), smoothstep(0.3, 0.5, 0.8) * COSINE / DISTANCE**2 / np.pi),
    "area": (lambda: dim("area"), 0.49 / (0.49 + 4)),
    "sun": (lambda: dim("sun"), COSINE / np.pi),
    "phong": (lambda: phong(10), ALBEDO[10, 60]),
    "image": (lambda: under_image(lambda x, y, z: np.maximum(z, 0)), np.array([1, 0.5, 2]) * 2 / 3),
}
WRONG = {
    "furnace": lambda: scenes.furnace(kd=0.51, size=4),
    "point": lambda: dim("point", transform=scenes.place(SLANT * 1.002, -SLANT)),
    "spot": lambda: dim("spot", blend=0.81),
    "area": lambda: dim("area", size_x=1.45),
    "sun": lambda: dim("sun", transform=scenes.place(SLANT, -SLANT - (0, 0, 0.05))),
    "phong": lambda: phong(5),
    "image": lambda: under_image(lambda x, y, z: np.maximum(z, 0), np.roll(np.eye(3), 1, axis=0)),
}


@pytest.mark.parametrize("form", RIGHT)
def test_what_the_formula_does_not_have_is_caught(measure, form):
    right, expected = RIGHT[form]
    measure(right(), samples=128, max_bounces=1).check(expected, slack=1e-3)
    with pytest.raises(AssertionError):
        measure(WRONG[form](), samples=128, max_bounces=1).check(expected, slack=1e-3)


def test_a_bounce_too_many_is_caught(measure):
    with pytest.raises(AssertionError):
        measure(scenes.furnace(size=4), samples=64, max_bounces=2).check(0.875)


def test_a_camera_that_mirrors_the_sky_is_caught(render):
    image = np.random.default_rng(1).random((8, 16, 3)).astype(np.float32)
    phi, theta = (1 - 2 * 3.5 / 16) * np.pi, 2.5 / 8 * np.pi
    d = (np.sin(theta) * np.cos(phi), -np.sin(theta) * np.sin(phi), -np.cos(theta))
    scene = Scene(width=1, height=1, camera=scenes.camera(towards=d, half_width=1e-6))
    scene.world = World(color=ONE, image=image)
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(render(scene, samples=1).pixels[0, 0, :3], image[2, 3], rtol=2e-4, atol=2e-4)
