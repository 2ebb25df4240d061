"""The rules that both roads follow where no formula of physics decides: visibility, transparency, clamping, film."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes

from engine.scene import AreaLight, Camera, Material, PointLight, Scene, SunLight, Visibility, World

ONE = (1.0, 1.0, 1.0)
WHITE = Material("white", kd=ONE)
BLACK = Material("black")
DIFFUSE, GLOSSY, CAMERA, SHADOW, ALL = (
    Visibility.DIFFUSE,
    Visibility.GLOSSY,
    Visibility.CAMERA,
    Visibility.SHADOW,
    Visibility.ALL,
)
UP = scenes.place((0, 0, 2))


def roofed(roof: Material, visibility: Visibility = ALL, light=None) -> Scene:
    """A white plate lit from above through a roof at z = 1."""
    scene = scenes.lit_plate([light or PointLight("lamp", UP, intensity=(4 * np.pi,) * 3)], WHITE)
    scene.materials.append(roof)
    mesh = scenes.quad_mesh((-0.5, -0.5, 1), (1, 0, 0), (0, 1, 0), "roof")
    scene.add_instance(mesh, materials=(1,), visibility=visibility)
    return scene


# Shadows and transparency


def test_roof_casts_a_shadow(measure):
    measure(roofed(BLACK), max_bounces=0).check(0)


@pytest.mark.parametrize("light", ["point", "area"])
def test_transparent_roof_dims_the_shadow(measure, light):
    lamp = None
    if light == "area":
        lamp = AreaLight("lamp", UP, radiance=(4 * np.pi / 0.01**2,) * 3, size_x=0.01, size_y=0.01)
    scene = roofed(Material("film", transparency=(0.5, 0.25, 0.0)), light=lamp)
    measure(scene, max_bounces=0).check((0.5, 0.25, 0.0), slack=1e-4)


def test_roof_hidden_from_shadow_rays(measure):
    scene = roofed(BLACK, ALL & ~SHADOW, AreaLight("lamp", UP, radiance=(4 * np.pi,) * 3, size_x=1.0, size_y=1.0))
    free = scenes.lit_plate(scene.lights, WHITE)
    measure(scene, samples=128, max_bounces=0).check_same(measure(free, samples=128, max_bounces=0))


GLOSSY_FLOOR = Material("glossy", kd=(0.1,) * 3, ks=(0.8,) * 3, exponent=1000)
PANE = {"black": BLACK, "glass": Material("film", transparency=(0.5, 0.25, 0.0))}


def under_pane(kind: str, pane: Material, visibility: Visibility, emitter: Visibility = ALL) -> Scene:
    """A glossy floor that mirrors an emitter at z = 3 into the camera, and a pane at z = 0.5 between the two."""
    scene = scenes.plate(GLOSSY_FLOOR, towards=(0.0, 0.6, -0.8))
    scene.materials += [pane, Material("lamp", emission=(5.0,) * 3)]
    place = scenes.place((0, 2.25, 3))
    if kind == "mesh":
        scene.add_instance(scenes.quad_mesh((-1, 1.25, 3), (2, 0, 0), (0, 2, 0)), materials=(2,), visibility=emitter)
    elif kind == "area":
        scene.lights = [AreaLight("lamp", place, emitter, radiance=(5.0,) * 3, size_x=2.0, size_y=2.0)]
    elif kind == "sphere":
        scene.lights = [PointLight("lamp", place, emitter, intensity=(5 * np.pi,) * 3, radius=1.0)]
    elif kind == "sun":
        sun = scenes.place(towards=(0, -0.6, -0.8))
        scene.lights = [SunLight("sun", sun, emitter, irradiance=(5.0,) * 3, angle=0.3)]
    else:
        image = np.full((8, 16, 3), 5.0, np.float32)
        scene.world = World(color=ONE, image=image, visibility=emitter)
    # Beside the camera's line of sight, which enters under y = -0.5.
    scene.add_instance(scenes.quad_mesh((-3, 0.1, 0.5), (6, 0, 0), (0, 6, 0)), materials=(1,), visibility=visibility)
    return scene


@pytest.mark.parametrize("kind", ["mesh", "area", "sphere", "sun", "image"])
def test_gloss_sees_lights_through_what_is_hidden_from_shadow_rays(measure, kind):
    """As if the pane were not there, and with as little noise."""
    hidden = measure(under_pane(kind, BLACK, ALL & ~SHADOW), samples=64, max_bounces=0)
    free = measure(under_pane(kind, BLACK, Visibility(0)), samples=64, max_bounces=0)
    hidden.check_same(free)
    assert np.all(hidden.error < 1.5 * free.error + 1e-3 * free.mean)


@pytest.mark.parametrize("kind", ["mesh", "area", "sphere", "sun", "image"])
@pytest.mark.parametrize("pane", PANE)
def test_gloss_sees_lights_through_what_only_shadow_rays_meet(measure, kind, pane):
    """Half the scene's light hangs on shadow rays: all that they pass is dimmed, whichever way it was found."""
    only = measure(under_pane(kind, PANE[pane], SHADOW), samples=64, max_bounces=0)
    every = measure(under_pane(kind, PANE[pane], ALL), samples=64, max_bounces=0)
    only.check_same(every)


@pytest.mark.parametrize("emitter", [ALL & ~SHADOW, ALL & ~DIFFUSE, ALL & ~GLOSSY, SHADOW | CAMERA], ids=str)
def test_emitter_that_some_rays_do_not_see_under_a_hidden_pane(measure, emitter):
    """Its visibility decides which lobes it lights; whether shadow rays meet it decides nothing."""
    mesh = measure(under_pane("mesh", BLACK, ALL & ~SHADOW, emitter), samples=1024, max_bounces=0)
    lamp = measure(under_pane("area", BLACK, ALL & ~SHADOW, emitter), samples=1024, max_bounces=0)
    mesh.check_same(lamp, slack=1e-3)


@pytest.mark.parametrize("visibility", [DIFFUSE | GLOSSY, SHADOW], ids=str)
def test_world_of_one_colour_is_found_by_rays_alone_where_objects_differ_in_shadows(measure, visibility):
    """A black roof of side 3, 0.4 above a grey plate: what rays meet counts, what shadow rays meet does not. The sky
    that a rectangle leaves free, as seen from below its middle; Cycles shows 0.0275 and 0.5."""
    scene = scenes.plate(Material("grey", kd=(0.5,) * 3), towards=(0.0, 0.6, -0.8))
    scene.world = World(color=ONE)
    scene.materials.append(BLACK)
    scene.add_instance(scenes.quad_mesh((-1.5, -1.5, 0.4), (3, 0, 0), (0, 3, 0)), materials=(1,), visibility=visibility)
    far = np.hypot(1.5, 0.4)
    covered = 4 / np.pi * 1.5 / far * np.arctan(1.5 / far)
    sky = measure(scene, samples=512, max_bounces=0)
    sky.check(0.5 if visibility == SHADOW else 0.5 * (1 - covered), slack=5e-4)


@pytest.mark.parametrize("ks", [0.0, 0.5])
def test_lamp_that_casts_no_shadow(measure, ks):
    lamp = AreaLight("lamp", UP, radiance=(np.pi,) * 3, cast_shadow=False)
    scene = roofed(BLACK, ALL, lamp)
    scene.materials[0] = Material("plate", kd=(0.5,) * 3, ks=(ks,) * 3, exponent=20)
    free = scenes.lit_plate([lamp], scene.materials[0])
    measure(scene, samples=128, max_bounces=0).check_same(measure(free, samples=128, max_bounces=0))


def test_camera_looks_through_transparent_layers(measure):
    """Four layers before a white world, each adding its own emission."""
    scene = Scene(width=4, height=4, camera=scenes.camera(half_width=0.1), world=World(color=ONE))
    scene.materials = [Material("film", emission=(0.1,) * 3, transparency=(0.9, 0.5, 0.0))]
    for y in range(1, 5):
        scene.add_instance(scenes.quad_mesh((-9, y, -9), (18, 0, 0), (0, 0, 18), f"film {y}"))
    t = np.array([0.9, 0.5, 0.0])
    measure(scene, samples=1024).check(t**4 + 0.1 * (1 + t + t**2 + t**3))


def test_passing_through_is_no_bounce(measure):
    """A furnace with an object of pure transparency in it stays a furnace at every bounce limit."""
    scene = scenes.furnace()
    scene.materials.append(Material("air", transparency=ONE))
    scene.add_instance(scenes.sphere_mesh(12, 0.4, name="bubble"), materials=(1,))
    measure(scene, samples=64, max_bounces=1).check(0.875)


# Visibility


@pytest.mark.parametrize("bits", [ALL & ~CAMERA, Visibility(0)], ids=str)
def test_object_hidden_from_the_camera(measure, bits):
    scene = Scene(width=4, height=4, camera=scenes.camera(half_width=0.1), world=World(color=(0.25,) * 3))
    scene.materials = [Material("lamp", emission=ONE)]
    scene.add_instance(scenes.quad_mesh((-9, 1, -9), (18, 0, 0), (0, 0, 18)), visibility=bits)
    measure(scene).check(0.25)


def lamp_over(material: Material, lamp) -> Scene:
    scene = scenes.lit_plate([], material)
    if isinstance(lamp, World):
        scene.world = lamp
    elif isinstance(lamp, Visibility):
        scene.materials.append(Material("lamp", emission=(5.0,) * 3))
        scene.add_instance(scenes.quad_mesh((-1, -1, 2), (2, 0, 0), (0, 2, 0)), materials=(1,), visibility=lamp)
    else:
        scene.lights = [lamp]
    return scene


LAMPS = {
    "point": lambda v: PointLight("lamp", UP, v, intensity=(9.0,) * 3),
    "sphere": lambda v: PointLight("lamp", UP, v, intensity=(9.0,) * 3, radius=0.5),
    "area": lambda v: AreaLight("lamp", UP, v, radiance=(5.0,) * 3, size_x=2.0, size_y=2.0),
    "sun": lambda v: SunLight("lamp", UP, v, irradiance=(5.0,) * 3, angle=0.5),
    "world": lambda v: World(color=ONE, visibility=v),
    "mesh": lambda v: v,
}


@pytest.mark.parametrize("kind", LAMPS)
@pytest.mark.parametrize("hidden", [DIFFUSE, GLOSSY], ids=str)
def test_lamp_hidden_from_one_lobe_lights_the_other(measure, kind, hidden):
    both = Material("both", kd=(0.5, 0.2, 0.1), ks=(0.1, 0.2, 0.4), exponent=8)
    other = replace(both, kd=(0, 0, 0)) if hidden is DIFFUSE else replace(both, ks=(0, 0, 0))
    seen = measure(lamp_over(both, LAMPS[kind](ALL & ~hidden)), samples=64, max_bounces=0)
    seen.check_same(measure(lamp_over(other, LAMPS[kind](ALL)), samples=64, max_bounces=0))


@pytest.mark.parametrize("kind", ["sphere", "area", "sun", "world"])
@pytest.mark.parametrize("visible", [True, False])
def test_camera_sees_a_lamp_if_it_may(measure, kind, visible):
    lamp = LAMPS[kind](ALL if visible else ALL & ~CAMERA)
    scene = Scene(width=4, height=4, camera=scenes.camera(towards=(0, 0, 1), half_width=0.01))
    if kind == "world":
        scene.world = lamp
    else:
        scene.lights = [lamp]
    radiance = {"sphere": 9 / (np.pi * 0.25), "area": 5, "sun": 5 / (np.pi * np.sin(0.25) ** 2), "world": 1}[kind]
    measure(scene, samples=4).check(radiance * visible)


def test_lamps_are_no_obstacles(measure):
    """The camera looks at the world through a lamp that adds its light."""
    scene = Scene(width=4, height=4, camera=scenes.camera(towards=(0, 0, 1), half_width=0.01), world=World(color=ONE))
    scene.lights = [LAMPS["area"](ALL)]
    measure(scene, samples=4).check(6)


# Film


@pytest.mark.parametrize("transparent", [False, True])
def test_alpha(measure, transparent):
    """A plate that half of the light passes, before a white world."""
    scene = Scene(width=4, height=4, camera=scenes.camera(half_width=0.1), world=World(color=ONE))
    scene.transparent_film = transparent
    scene.materials = [Material("film", emission=(0.5,) * 3, transparency=(0.5,) * 3)]
    scene.add_instance(scenes.quad_mesh((-9, 1, -9), (18, 0, 0), (0, 0, 18)))
    picture = measure(scene, samples=64)
    picture.check(0.5 if transparent else 1.0)
    assert picture.alpha == pytest.approx(0.5 if transparent else 1.0, abs=1e-4)


@pytest.mark.parametrize("reflected", [0.0, 0.5])
def test_alpha_behind_coloured_films(measure, reflected):
    """Red light passes all of them, the other colours are reflected or absorbed, by chance."""
    scene = Scene(width=4, height=4, camera=scenes.camera(half_width=0.1), world=World(color=ONE))
    scene.transparent_film = True
    scene.materials = [Material("film", kd=(0.0, reflected, reflected), transparency=(1.0, 0.0, 0.0))]
    for y in (1, 2, 3):
        scene.add_instance(scenes.quad_mesh((-9, y, -9), (18, 0, 0), (0, 0, 18)))
    assert measure(scene, samples=1024).alpha == pytest.approx(2 / 3, abs=0.02)


@pytest.mark.parametrize(("height", "gap"), [(2.7, 0.01), (3.0, 0.003), (5.3, 0.02)])
def test_a_clear_pane_just_before_a_light_is_not_seen(measure, height, gap):
    """However short the rest of a shadow ray's way behind it."""
    scenes_of = [scenes.plate(Material("grey", kd=(0.5,) * 3)) for _ in range(2)]
    for scene in scenes_of:
        scene.materials += [Material("lamp", emission=ONE), Material("pane", transparency=ONE)]
        scene.add_instance(scenes.quad_mesh((-0.5, -0.5, height), (0, 1, 0), (1, 0, 0)), materials=(1,))
    scenes_of[1].add_instance(scenes.quad_mesh((-4, -4, height - gap), (8, 0, 0), (0, 8, 0)), materials=(2,))
    plain, behind = (measure(scene, samples=64, max_bounces=0) for scene in scenes_of)
    behind.check_same(plain)
    assert plain.mean[0] > 0.001


def test_transparent_film_still_lights(measure):
    scene = scenes.plate(Material("grey", kd=(0.5,) * 3))
    scene.world, scene.transparent_film = World(color=ONE), True
    picture = measure(scene, samples=64)
    picture.check(0.5)
    assert picture.alpha == 1


@pytest.mark.parametrize("transparent", [False, True])
@pytest.mark.parametrize(("through", "film"), [(0.0, 1.0), (0.25, 1.0), (0.25, 0.5)])
def test_a_holdout_is_a_hole(measure, transparent, through, film):
    """In a white world, behind a film: nothing of it is seen but what it lets through, as alpha too."""
    scene = Scene(width=4, height=4, camera=scenes.camera(half_width=0.1), world=World(color=ONE))
    scene.transparent_film = transparent
    scene.materials = [
        Material("hole", kd=(0.2,) * 3, emission=ONE, transparency=(through,) * 3, holdout=True),
        Material("film", transparency=(film,) * 3),
    ]
    for y, material in ((2, 0), (1, 1)):
        scene.add_instance(scenes.quad_mesh((-9, y, -9), (18, 0, 0), (0, 0, 18)), materials=(material,))
    picture = measure(scene, samples=16)
    left = film * through
    picture.check(0.0 if transparent else left)
    assert picture.alpha == pytest.approx(1 - film * (1 - through) - (left if transparent else 0), abs=1e-4)


def test_others_see_a_holdout_as_it_is(measure):
    """Its light falls on a plate that the camera sees."""
    scenes_of = [scenes.plate(Material("grey", kd=(0.5,) * 3)) for _ in range(2)]
    for scene, holdout in zip(scenes_of, (False, True), strict=True):
        scene.materials.append(Material("lamp", emission=ONE, holdout=holdout))
        scene.add_instance(scenes.quad_mesh((1, -1, 0.5), (0, 2, 0), (0, 0, 2)), materials=(1,))
    plain, held = (measure(scene, samples=64) for scene in scenes_of)
    held.check_same(plain)
    assert held.mean[0] > 0.01 and held.alpha == 1


def test_exposure_scales_colour_and_not_alpha(measure):
    scene = scenes.furnace()
    scene.exposure = 3.0
    picture = measure(scene, samples=64, max_bounces=1)
    picture.check(3 * 0.875)
    assert picture.alpha == 1


def test_clamping_counts_one_scattering_as_direct(measure):
    """In a furnace every contribution is known: Le, kd Le, kd^2 Le (the last two by two ways of sampling)."""
    free = scenes.furnace()
    measure(free, samples=64, max_bounces=1, clamp_indirect=100.0, clamp_direct=100.0).check(0.875)
    clamped = measure(free, samples=64, max_bounces=1, clamp_direct=0.1, clamp_indirect=1e-6)
    assert np.all(clamped.mean >= 0.1)
    assert np.all(clamped.mean <= 0.31)


def test_clamping_keeps_the_hue(measure):
    scene = Scene(width=2, height=2, camera=scenes.camera(), world=World(color=(6.0, 3.0, 0.0)))
    measure(scene, samples=2, clamp_direct=1.0).check((2.0, 1.0, 0.0))


def test_empty_scene_shows_the_world(measure):
    measure(Scene(width=4, height=4, camera=scenes.camera(), world=World(color=(1, 2, 3))), samples=2).check((1, 2, 3))


def test_black_scene_is_black(measure):
    measure(Scene(width=4, height=4, camera=scenes.camera()), samples=2).check(0)


# Camera: four quarters of different brightness behind the picture


def quarters(**camera) -> Scene:
    scene = Scene(width=6, height=4, camera=Camera(transform=scenes.place(), **camera))
    scene.materials = [Material(str(k), emission=(float(k),) * 3) for k in range(1, 5)]
    for k, (x, y) in enumerate([(-9, -9), (0, -9), (-9, 0), (0, 0)]):
        scene.add_instance(scenes.quad_mesh((x, y, -2), (9, 0, 0), (0, 9, 0), str(k)), materials=(k,))
    return scene


EXPECTED = np.array([[1, 1, 1, 2, 2, 2]] * 2 + [[3, 3, 3, 4, 4, 4]] * 2, float)  # row 0 at the bottom
WINDOW = (-0.6, 0.6, -0.4, 0.4)


@pytest.mark.parametrize("orthographic", [False, True])
def test_picture_is_the_right_way_up(render, orthographic):
    pixels = render(quarters(window=WINDOW, orthographic=orthographic), samples=4).pixels
    assert pixels.shape == (4, 6, 4)
    np.testing.assert_allclose(pixels[..., 0], EXPECTED, rtol=1e-6)


def test_region_is_the_same_part_of_the_picture(render):
    scene = quarters(window=WINDOW)
    scene.region = (2, 1, 5, 4)
    pixels = render(scene, samples=4).pixels
    assert pixels.shape == (3, 3, 4)
    np.testing.assert_allclose(pixels[..., 0], EXPECTED[1:4, 2:5], rtol=1e-6)


def test_window_shifts_the_view(render):
    pixels = render(quarters(window=(0.1, 1.3, 0.1, 0.9)), samples=4).pixels
    np.testing.assert_allclose(pixels[..., 0], 4, rtol=1e-6)


@pytest.mark.parametrize(("clip", "seen"), [((1.9, 2.1), True), ((2.1, 9.0), False), ((0.1, 1.9), False)])
def test_clipping(render, clip, seen):
    pixels = render(quarters(window=WINDOW, clip_start=clip[0], clip_end=clip[1]), samples=4).pixels
    np.testing.assert_allclose(pixels[..., 0], EXPECTED * seen, rtol=1e-6)


def test_blackman_harris_reaches_filter_width_pixels(render):
    """The edge between two brightnesses runs between two pixels: what crosses it is the filter's tail."""
    sharp = render(quarters(window=WINDOW), samples=4).pixels[0, :, 0]
    soft = render(quarters(window=WINDOW), samples=4096, pixel_filter="BLACKMAN_HARRIS", filter_width=1.5).pixels[
        0, :, 0
    ]
    x = np.linspace(-1.5, 1.5, 100001)
    t = 2 * np.pi * (x / 3 + 0.5)
    window = 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)
    tail = window[x > 0.5].sum() / window.sum()
    np.testing.assert_allclose(soft, sharp + np.array([0, 0, tail, -tail, 0, 0]), atol=0.04)


# Samples and stopping


def test_same_seed_gives_the_same_picture(render):
    a, b, c = (render(scenes.cornell(8), samples=4, seed=seed).pixels for seed in (7, 7, -3))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


# What is broken is caught: scenes that break the rule of a test above


def layers(count: int) -> Scene:
    scene = Scene(width=4, height=4, camera=scenes.camera(half_width=0.1), world=World(color=ONE))
    scene.materials = [Material("film", transparency=(0.9,) * 3)]
    for y in range(1, count + 1):
        scene.add_instance(scenes.quad_mesh((-9, y, -9), (18, 0, 0), (0, 0, 18), f"film {y}"))
    return scene


def brighter(scene: Scene, exposure: float) -> Scene:
    scene.exposure = exposure
    return scene


BROKEN = {
    "a roof without a shadow": (lambda: roofed(BLACK, ALL & ~SHADOW), 0),
    "a film that passes more": (lambda: roofed(Material("film", transparency=(0.505,) * 3)), 0.5),
    "a layer too few": (lambda: layers(3), 0.9**4),
    "exposed otherwise": (lambda: brighter(scenes.furnace(size=4), 3.1), 3 * 0.875),
    "a lamp that hides the sky": (lambda: layers(0), 6),
    "an object that the camera sees": (lambda: layers(1), 1),
}
ROOM = Material("both", kd=(0.5, 0.2, 0.1), ks=(0.1, 0.2, 0.4), exponent=8)
UNLIKE = {
    "a lamp that no lobe misses": (
        lambda: lamp_over(ROOM, LAMPS["area"](ALL)), lambda: lamp_over(ROOM, LAMPS["area"](ALL & ~GLOSSY)),
    ),
    "a pane that shadow rays meet": (
        lambda: under_pane("area", BLACK, ALL), lambda: under_pane("area", BLACK, ALL & ~SHADOW),
    ),
    "a pane of glass for a black one": (
        lambda: under_pane("mesh", PANE["glass"], SHADOW), lambda: under_pane("mesh", BLACK, ALL),
    ),
    "an emitter of one lobe": (
        lambda: under_pane("area", BLACK, ALL & ~SHADOW, ALL & ~GLOSSY),
        lambda: under_pane("area", BLACK, ALL & ~SHADOW),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_rule_is_caught(measure, name):
    scene, expected = BROKEN[name]
    with pytest.raises(AssertionError):
        measure(scene(), samples=64, max_bounces=1).check(expected)


@pytest.mark.parametrize("name", UNLIKE)
def test_scenes_that_are_not_alike_are_caught(measure, name):
    one, other = (measure(scene(), samples=128, max_bounces=0) for scene in UNLIKE[name])
    with pytest.raises(AssertionError):
        one.check_same(other)


def test_what_is_not_clamped_and_a_picture_upside_down_are_caught(measure, render):
    free = measure(scenes.furnace(size=4), samples=64, max_bounces=1)
    assert not np.all(free.mean <= 0.31)
    pixels = render(quarters(window=WINDOW), samples=4).pixels
    for wrong in (EXPECTED[::-1], EXPECTED[:, ::-1]):
        with pytest.raises(AssertionError):
            np.testing.assert_allclose(pixels[..., 0], wrong, rtol=1e-6)
