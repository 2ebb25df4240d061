"""Render passes: the parts of the light add up, data is what a ray cast in numpy says, and without them nothing is
compiled, stored or traced."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
import scenes
from sample_scenes import SCENES, sample_scene

import engine.pack.geometry as packing
from engine import PASSES, Scene, Settings, SettingsError, World, render, schedule, tiles
from engine.film import Film
from engine.kernels import first_hit
from engine.kernels.batch import new_batch
from engine.pack import pack
from engine.passes import COLOR_OF, LIGHT, MEAN, MIDDLE, NOTHING_THERE, PassFilm, divided
from engine.reference.camera import camera_rays
from engine.scene import Aperture, AreaLight, Material, Mist, PointLight, Visibility
from tools.by_path import by_path

ALL = tuple(PASSES)
ROUNDING = 2e-6  # of sums in float32, relative to the brightest of what is added
NARROW = 0.02  # of normals and texture coordinates, a hundredth of a pixel off
SIZE = 16


def picture(scene: Scene, passes: tuple[str, ...] = ALL, **changes):
    return render(scene, Settings(**{"samples": 9, "max_bounces": 4, "threads": 1, **changes}, passes=passes))


def total(passes: dict[str, np.ndarray]) -> np.ndarray:
    """As the manual says that passes are put together."""
    direct, indirect = (
        {lobe: passes[f"{lobe}_{part}"] for lobe in ("DIFFUSE", "GLOSSY")} for part in ("DIRECT", "INDIRECT")
    )
    light = sum(passes[f"{lobe}_COLOR"] * (direct[lobe] + indirect[lobe]) for lobe in ("DIFFUSE", "GLOSSY"))
    return light + passes["EMISSION"] + passes["ENVIRONMENT"]


def assert_adds_up(result) -> None:
    combined = result.pixels[..., :3]
    assert combined.max() > 0
    assert np.abs(total(result.passes) - combined).max() <= ROUNDING * combined.max()
    assert all(result.passes[name].min() >= -ROUNDING * combined.max() for name in LIGHT)


# --- parts of the light -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bounces", [0, 1, 2, 8])
@pytest.mark.parametrize("name", SCENES)
def test_parts_add_up_to_combined(name, bounces):
    """On the sample scenes; and Combined is as without passes, but for a rounding: another kernel, another order."""
    scene = sample_scene(name, width=24)
    result = picture(scene, max_bounces=bounces)
    assert_adds_up(result)
    np.testing.assert_allclose(result.pixels, picture(scene, (), max_bounces=bounces).pixels, rtol=2e-6, atol=1e-9)
    indirect = result.passes["DIFFUSE_INDIRECT"] + result.passes["GLOSSY_INDIRECT"]
    assert indirect.any() == (bounces > 0)


def test_a_holdout_is_nothing():
    scene = scenes.plate(Material("hole", kd=(0.5,) * 3, holdout=True, pass_index=3))
    passes = picture(scene).passes
    assert np.allclose(passes["DEPTH"], 1e10)
    for name in ("NORMAL", "MATERIAL_INDEX", "DIFFUSE_COLOR", "AMBIENT_OCCLUSION"):
        assert not passes[name].any(), name


def test_where_no_sample_is_there_is_nothing():
    """As Cycles writes a render that was stopped: far away, behind all of the mist. Never at the camera's own place."""
    scene, settings = shapes(), Settings(samples=1, passes=("DEPTH", "POSITION", "MIST", "SAMPLE_COUNT"))
    scene.mist = Mist(start=0.0, depth=50.0)
    film = Film(scene.render_region, 1.0, settings.passes)
    x0, y0, x1, y1 = scene.render_region
    middle = (x0 + x1) // 2
    half = tiles.Shared(iter([(x0, y0, middle, y1)]))
    tiles.render_tiles(pack(scene, settings), settings, film, None, half, 0, 1, np.zeros(1, np.uint8))
    passes = film.pass_pictures()
    reached = passes["SAMPLE_COUNT"][..., 0] > 0
    assert reached.sum() == (middle - x0) * (y1 - y0)
    whole = picture(scene, settings.passes, samples=1).passes
    for name in settings.passes:
        np.testing.assert_array_equal(passes[name][reached], whole[name][reached])
    assert passes["DEPTH"][reached].min() < NOTHING_THERE == np.float64(first_hit.NOTHING_THERE)
    assert np.all(passes["DEPTH"][~reached] == np.float32(1e10)) and np.all(passes["MIST"][~reached] == 1.0)


def test_a_render_that_is_stopped_before_it_begins_shows_nothing(monkeypatch):
    def stop(_render):
        raise schedule.Stopped

    monkeypatch.setattr(schedule._Render, "_build", stop)
    result = picture(shapes(), ("DEPTH", "MIST"))
    assert result.stopped and result.samples == 0
    assert np.all(result.passes["DEPTH"] == np.float32(1e10)) and np.all(result.passes["MIST"] == 1.0)


def unshadowed() -> Scene:
    scene = scenes.lamp_room(["area", "sphere", "wide_sun"], SIZE)
    scene.lights = [replace(scene.lights[0], cast_shadow=False), *scene.lights[1:]]
    return scene


def behind_a_pane() -> Scene:
    """A tinted pane that reflects and glows before a room with lamps that the camera sees."""
    scene = scenes.lamp_room(["area", "sphere", "wide_sun"], SIZE)
    scene.materials.append(Material("pane", kd=(0.1, 0.2, 0.3), emission=(0.01,) * 3, transparency=(0.7, 0.5, 0.4)))
    scene.add_instance(scenes.quad_mesh((-3, -2, -1), (6, 0, 0), (0, 0, 6)), materials=(2,))
    return scene


def behind_a_hole() -> Scene:
    """The same with the pane as a holdout, behind a pane that isn't, and lamps before and behind both."""
    scene = behind_a_pane()
    scene.materials.append(replace(scene.materials[2], name="hole", holdout=True))
    scene.add_instance(scenes.quad_mesh((-3, -1.5, -1), (6, 0, 0), (0, 0, 6)), materials=(3,))
    return scene


def glossy_sees_less() -> Scene:
    scene = scenes.lamp_room(["area", "sphere"], SIZE)
    scene.lights = [replace(scene.lights[0], visibility=Visibility.ALL & ~Visibility.GLOSSY), *scene.lights[1:]]
    return scene


def hidden_from_shadow_rays() -> Scene:
    scene = glossy_sees_less()
    scene.instances.visibility[1] = Visibility.ALL & ~Visibility.SHADOW
    return scene


def through_a_lens() -> Scene:
    scene = scenes.lamp_room(["area", "wide_sun"], SIZE)
    scene.camera = replace(scene.camera, aperture=Aperture(0.2, 4.0))
    scene.transparent_film = True
    return scene


CORNERS: dict[str, tuple[Callable[[], Scene], dict]] = {
    "every lamp": (lambda: scenes.lamp_room(list(scenes.LAMP_KINDS), SIZE), {}),
    "image": (lambda: scenes.sky_plate(SIZE), {}),
    "unshadowed": (unshadowed, {}),
    "pane": (behind_a_pane, {}),
    "hole": (behind_a_hole, {}),
    "hole, clamps": (behind_a_hole, {"clamp_direct": 0.5, "clamp_indirect": 0.1}),
    "kinds of rays": (glossy_sees_less, {}),
    "kinds end apart": (lambda: scenes.phong_plates(SIZE), {"glossy_bounces": 1}),
    "unlike shadows": (hidden_from_shadow_rays, {}),
    "lens, transparent film": (through_a_lens, {}),
    "clamps": (lambda: scenes.lamp_room(["area", "sphere"], SIZE), {"clamp_direct": 0.5, "clamp_indirect": 0.1}),
    "rejection": (lambda: scenes.cornell(SIZE), {"hemisphere_sampling": "REJECTION"}),
    "adaptive": (
        lambda: scenes.cornell(SIZE),
        {"use_adaptive_sampling": True, "adaptive_threshold": 0.1, "samples": 96},
    ),
}


@pytest.mark.parametrize("name", CORNERS)
def test_parts_add_up_whatever_the_scene_needs(name):
    scene, changes = CORNERS[name][0](), CORNERS[name][1]
    result = picture(scene, **changes)
    assert_adds_up(result)
    assert np.allclose(result.pixels, picture(scene, (), **changes).pixels, rtol=1e-5, atol=1e-6)


STAGED = ["every lamp", "image", "unshadowed", "pane", "hole", "kinds of rays", "kinds end apart", "unlike shadows"]


@pytest.mark.parametrize("name", STAGED)
def test_light_is_shared_out_as_path_by_path(name):
    scene = CORNERS[name][0]()
    staged = picture(scene, samples=32).passes
    with by_path():
        others = picture(scene, samples=32).passes
    for key in LIGHT:
        assert np.allclose(staged[key].mean(axis=(0, 1)), others[key].mean(axis=(0, 1)), rtol=2e-3, atol=1e-6), key


def test_light_that_is_too_strong_is_left_out_of_all_passes():
    scene = scenes.lit_plate([PointLight("lamp", scenes.place((0, 0, 1e-15)), intensity=(1e30,) * 3)], size=SIZE)
    scene.world = World(color=(1.0, 1.0, 1.0))
    result = picture(scene)
    assert result.rejected > 0
    assert all(np.isfinite(result.passes[name]).all() for name in LIGHT)


def test_what_the_camera_sees_shining():
    """Emission is what surfaces and lamps send to the camera, Environment what the world does."""
    scene = scenes.furnace(kd=0.5, emission=0.5)
    passes = picture(scene, filter_width=0.01).passes
    assert np.allclose(passes["EMISSION"], 0.5) and not passes["ENVIRONMENT"].any()
    scene = Scene(width=8, height=8, camera=scenes.camera(), world=World(color=(0.5, 0.25, 0.125)))
    scene.lights = [AreaLight("lamp", scenes.place((0, 3, 0), (0, -1, 0)), radiance=(3.0, 2.0, 1.0))]
    passes = picture(scene, pixel_filter="BOX").passes
    assert np.allclose(passes["ENVIRONMENT"], (0.5, 0.25, 0.125), rtol=1e-6)
    assert np.allclose(passes["EMISSION"][4, 4], (3.0, 2.0, 1.0), rtol=1e-6) and not passes["EMISSION"][0, 0].any()


def test_direct_light_of_a_diffuse_plate():
    """4 pi W/sr from 2 m above: E / pi = 4 pi / 4 / pi = 1 W/(m2 sr) of white. Divided by its colour, whatever that."""
    lamp = PointLight("lamp", scenes.place((0, 0, 2)), intensity=(4 * np.pi,) * 3)
    scene = scenes.lit_plate([lamp], Material("red", kd=(0.5, 0.25, 0.0)))
    passes = picture(scene).passes
    assert np.allclose(passes["DIFFUSE_DIRECT"], 1.0, rtol=1e-3)
    assert np.allclose(passes["DIFFUSE_COLOR"], (0.5, 0.25, 0.0)) and not passes["DIFFUSE_INDIRECT"].any()


def test_indirect_light_of_a_furnace():
    """Radiance 0.5 + 0.5 (0.5 + 0.5 (...)): direct light is the walls' own 0.5, indirect the rest of the series."""
    passes = picture(scenes.furnace(kd=0.5, emission=0.5), samples=256, max_bounces=12).passes
    assert np.allclose(passes["DIFFUSE_DIRECT"].mean(axis=(0, 1)), 0.5, rtol=0.01)
    assert np.allclose(passes["DIFFUSE_INDIRECT"].mean(axis=(0, 1)), 0.5 - 0.5**13, rtol=0.01)


def test_lobes_share_the_light_by_their_values():
    """Each lobe's part is what a surface with that lobe alone shows."""
    lamp = AreaLight("lamp", scenes.place((0, 0.6, 1)), radiance=(5.0,) * 3, size_x=1.0, size_y=1.0)
    grey, gloss = Material("d", kd=(0.3, 0.2, 0.1)), Material("g", ks=(0.6, 0.5, 0.4), exponent=20.0)
    both = picture(scenes.lit_plate([lamp], replace(gloss, kd=grey.kd)), samples=4096).passes
    for material, lobe in ((grey, "DIFFUSE"), (gloss, "GLOSSY")):
        alone = picture(scenes.lit_plate([lamp], material), samples=4096).passes[f"{lobe}_DIRECT"].mean(axis=(0, 1))
        assert np.allclose(both[f"{lobe}_DIRECT"].mean(axis=(0, 1)), alone, rtol=5e-3), lobe


def test_colour_of_0_is_lit_by_the_mean_of_the_others():
    light, color = np.array([[[1.0, 0.5, 0.0]]]), np.array([[[0.5, 0.5, 0.0]]])
    assert np.allclose(divided(light, color), [[[2.0, 1.0, 1.5]]])
    assert np.array_equal(divided(light, np.zeros((1, 1, 3))), np.zeros((1, 1, 3)))


def test_exposure_is_for_light_alone():
    scene = scenes.cornell(SIZE)
    once = picture(scene).passes
    scene.exposure = 2.0
    for name, found in picture(scene).passes.items():
        assert np.allclose(found, once[name] * (2.0 if name in LIGHT else 1.0), rtol=1e-6), name


# --- data -------------------------------------------------------------------------------------------------------------


def shapes() -> Scene:
    """Balls, one smooth and squeezed, and a plate with texture coordinates, each with an index of its own."""
    scene = Scene(width=40, height=30, camera=scenes.camera(origin=(0, -4, 1), towards=(0, 4, -0.8), aspect=4 / 3))
    scene.materials = [
        Material(f"m{i}", kd=(0.1 * i, 0.2, 0.3), ks=(0, 0, 0.05 * i), pass_index=10 + i) for i in range(3)
    ]
    plate = scenes.quad_mesh((-2, -2, 0), (4, 0, 0), (0, 4, 0), "plate")
    plate.uvs = (plate.vertices[plate.triangles][:, :, :2] / 4 + 0.5).astype(np.float32)
    scene.add_instance(plate)
    ball = scenes.sphere_mesh(12, 0.5, smooth=True)
    scene.add_instance(ball, np.column_stack([np.diag((1.0, 0.5, 0.8)), (-0.6, 0, 0.5)]), materials=(1,))
    scene.add_instance(ball, np.column_stack([np.eye(3), (0.7, 0.3, 0.4)]), materials=(2,))
    scene.instances.pass_index = np.array([5, 7, 6], np.int32)
    scene.mist = Mist(2.0, 4.0, 2.0)
    return scene


def ray_cast(scene: Scene) -> dict[str, np.ndarray]:
    """By numpy, in double precision, triangle by triangle: what the middle of each pixel shows. Rows are pixels."""
    y, x = np.mgrid[: scene.height, : scene.width] + 0.5
    middles = np.column_stack([x.ravel(), y.ravel()])
    origin, way, near, _ = camera_rays(scene.camera, middles, (scene.width, scene.height), np.random.default_rng(0))
    count = len(way)
    found = {"t": np.full(count, np.inf), "instance": np.full(count, -1), "NORMAL": np.zeros((count, 3))}
    found["UV"] = np.zeros((count, 3))
    for row, index in enumerate(scene.instances.mesh):
        mesh, matrix = scene.meshes[index], scene.instances.transforms[row]
        points = mesh.vertices.astype(float) @ matrix[:, :3].T + matrix[:, 3]
        for number, (a, b, c) in enumerate(points[mesh.triangles]):
            # Moeller & Trumbore 1997
            p = np.cross(way, c - a)
            scale = 1 / (p @ (b - a))
            to_origin = origin - a
            q = np.cross(to_origin, b - a)
            u, v, t = np.sum(to_origin * p, 1) * scale, np.sum(way * q, 1) * scale, q @ (c - a) * scale
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > near) & (t < found["t"])
            weights = np.column_stack([1 - u - v, u, v])
            normal = np.cross(b - a, c - a)[None]
            if mesh.normals is not None:
                normal = weights @ mesh.normals[mesh.triangles[number]] @ np.linalg.inv(matrix[:, :3])
            normal = normal * np.where(np.sum(normal * way, 1) > 0, -1, 1)[:, None]
            normal /= np.linalg.norm(normal, axis=1)[:, None]
            found["NORMAL"] = np.where(hit[:, None], normal, found["NORMAL"])
            uv = np.zeros((count, 3))
            if mesh.uvs is not None:
                uv = np.column_stack([weights @ mesh.uvs[number], np.ones(count)])
            found["UV"] = np.where(hit[:, None], uv, found["UV"])
            found["instance"], found["t"] = np.where(hit, row, found["instance"]), np.where(hit, t, found["t"])
    found["met"] = found["instance"] >= 0
    t = np.where(found["met"], found["t"], 0)[:, None]
    found["POSITION"] = np.where(found["met"][:, None], origin + way * t, 0)
    return found


def rows(image: np.ndarray) -> np.ndarray:
    return image.reshape(-1, image.shape[2])


def far(scene: Scene) -> Scene:
    """The same 100 km off, in all directions."""
    off = np.array([1e5, -1e5, 1e5])
    scene.instances.transforms[:, :, 3] += off
    scene.camera.transform[:, 3] += off
    return scene


@pytest.mark.parametrize("how", ["baked", "instanced", "far", "orthographic"])
def test_data_is_what_numpy_casts(how, monkeypatch):
    if how == "instanced":
        monkeypatch.setattr(packing, "BAKE_LIMIT", 0)
    scene = far(shapes()) if how == "far" else shapes()
    if how == "orthographic":
        scene.camera = replace(scene.camera, orthographic=True, window=(-2, 2, -1.5, 1.5))
    expected = ray_cast(scene)
    passes = {key: rows(image) for key, image in picture(scene, samples=1, filter_width=0.01).passes.items()}
    assert pack(scene, Settings()).features.instances == (how == "instanced")
    met, row = expected["met"], expected["instance"]
    assert met.any() and not met.all()
    for key, of_row in (("OBJECT_INDEX", [5, 7, 6]), ("MATERIAL_INDEX", [10, 11, 12])):
        assert np.array_equal(passes[key][:, 0], np.where(met, np.array(of_row)[row], 0)), key
    assert np.allclose(passes["POSITION"], expected["POSITION"], rtol=1e-7, atol=1e-5)
    origin, axis = scene.camera.transform[:, 3], -scene.camera.transform[:, 2]
    from_camera = expected["POSITION"] - origin
    depth = np.where(met, from_camera @ axis, 1e10)
    assert np.allclose(passes["DEPTH"][:, 0], depth, rtol=1e-6, atol=1e-5)
    # Within a hundredth of a pixel: edges may be met or not.
    inside = inner(expected["instance"].reshape(scene.height, scene.width)).ravel()
    for key in ("NORMAL", "UV"):
        assert np.allclose(passes[key][inside], expected[key][inside], atol=NARROW), key
    way = np.abs(from_camera @ axis) if how == "orthographic" else np.linalg.norm(from_camera, axis=1)
    mist = np.where(met, np.clip((way - 2) / 4, 0, 1) ** 2, 1)
    assert np.allclose(passes["MIST"][inside, 0], mist[inside], atol=2e-3)
    for key, which in (("DIFFUSE_COLOR", "kd"), ("GLOSSY_COLOR", "ks")):
        colors = np.array([getattr(material, which) for material in scene.materials])
        assert np.allclose(passes[key][inside], np.where(met[:, None], colors[row], 0)[inside], atol=1e-6), key
    right, up = scene.camera.transform[:, 0], scene.camera.transform[:, 1]
    turned = expected["NORMAL"] @ np.column_stack([right, up, axis])
    assert np.allclose(passes["DENOISING_NORMAL"][inside], turned[inside], atol=NARROW)


def inner(numbers: np.ndarray) -> np.ndarray:
    """Pixels whose neighbours show the same."""
    same = np.ones(numbers.shape, bool)
    for axis in (0, 1):
        for step in (1, -1):
            same &= np.roll(numbers, step, axis) == numbers
    return same


@pytest.mark.parametrize(("falloff", "expected"), [(1.0, 0.25), (2.0, 0.0625), (0.5, 0.5)])
def test_mist(falloff, expected):
    """A plate at 1 m, mist from 0.5 m on and 2 m deep."""
    scene = scenes.plate()
    scene.mist = Mist(0.5, 2.0, falloff)
    assert np.allclose(picture(scene).passes["MIST"], expected, atol=1e-4)


def test_occlusion_under_a_roof():
    """As much of the hemisphere as a square roof leaves free, weighed by the cosine; all of it where the distance ends
    before the roof. The form factor is that of tests/reference/test_rules.py."""
    scene = scenes.plate(towards=(0.0, 0.6, -0.8))
    roof = scenes.quad_mesh((-1.5, -1.5, 0.4), (3, 0, 0), (0, 3, 0))
    scene.add_instance(roof, visibility=Visibility.ALL & ~Visibility.CAMERA)
    edge = np.hypot(1.5, 0.4)
    covered = 4 / np.pi * 1.5 / edge * np.arctan(1.5 / edge)
    free = picture(scene, samples=1024).passes["AMBIENT_OCCLUSION"].mean(axis=(0, 1))
    assert np.allclose(free, 1 - covered, atol=2e-3)
    scene.occlusion_distance = 0.39
    assert np.allclose(picture(scene).passes["AMBIENT_OCCLUSION"], 1.0)
    scene.materials.append(Material("film", transparency=(0.5, 0.25, 0.0)))
    scene.occlusion_distance = 10.0
    scene.instances.material_table[1] = 1
    free = picture(scene, samples=1024).passes["AMBIENT_OCCLUSION"].mean(axis=(0, 1))
    assert np.allclose(free, 1 - covered * (1 - np.array((0.5, 0.25, 0.0))), atol=2e-3)


@pytest.mark.parametrize(
    ("lets_through", "threshold", "behind"),
    [(0.75, 0.5, True), (0.25, 0.5, False), (0.75, 0.25, False), (0.75, 0.0, False), (0.25, 0.8, True)],
)
def test_data_behind_a_pane(lets_through, threshold, behind):
    """What has one value is that of the first surface that covers enough; means are weighed by what each covers."""
    scene = scenes.plate(Material("white", kd=(1.0,) * 3, pass_index=1))
    scene.materials.append(Material("pane", kd=(0.1, 0.0, 0.0), transparency=(lets_through,) * 3, pass_index=2))
    scene.add_instance(scenes.quad_mesh((-1, -1, 0.5), (2, 0, 0), (0, 2, 0)), materials=(1,))
    scene.mist, scene.alpha_threshold = Mist(0.0, 1.0), threshold
    passes = picture(scene).passes
    assert np.allclose(passes["MATERIAL_INDEX"], 1 if behind else 2)
    assert np.allclose(passes["DEPTH"], 1.0 if behind else 0.5, rtol=1e-5)
    assert np.allclose(passes["DIFFUSE_COLOR"][0, 0], np.array([0.1, 0, 0]) + lets_through, rtol=1e-5)
    assert np.allclose(passes["MIST"], 1 - (1 - lets_through) * 0.5, atol=1e-5)  # at 1 m all is mist


def test_nothing_there():
    scene = Scene(width=4, height=4, camera=scenes.camera(), world=World(color=(0.5, 0.25, 0.125)))
    passes = picture(scene).passes
    assert np.allclose(passes["DEPTH"], 1e10) and np.allclose(passes["MIST"], 1.0)
    assert np.allclose(passes["DENOISING_ALBEDO"], (0.5, 0.25, 0.125))
    left = set(passes) - {"DEPTH", "MIST", "DENOISING_ALBEDO", "ENVIRONMENT", "SAMPLE_COUNT"}
    assert not any(passes[key].any() for key in left)


def test_sample_count_is_of_each_pixel():
    scene = scenes.cornell(SIZE)
    result = picture(scene, ("SAMPLE_COUNT",), samples=96, use_adaptive_sampling=True, adaptive_threshold=0.1)
    counts = result.passes["SAMPLE_COUNT"]
    assert counts.mean() == pytest.approx(result.samples) and 32 <= counts.min() < counts.max() <= 96


# --- the same bits, and nothing without them --------------------------------------------------------------------------


def test_passes_depend_neither_on_threads_nor_on_tiles_nor_on_the_region():
    scene = scenes.lamp_room(["area", "sphere", "wide_sun"], 24)
    whole = picture(scene).passes
    with mock.patch.object(tiles, "TILE_SAMPLES", 200):
        other = picture(scene, threads=2).passes
    scene.region = (5, 3, 20, 17)
    part = picture(scene, threads=2).passes
    for key, found in whole.items():
        assert np.array_equal(found, other[key]), key
        # Packets of rays begin elsewhere: a camera ray that meets two surfaces at once may meet the other.
        assert np.allclose(found[3:17, 5:20], part[key], rtol=1e-4, atol=1e-5), key


def test_without_passes_nothing_is_made_for_them(monkeypatch):
    def forbidden(*_):
        raise AssertionError("made without a pass that asks for it")

    monkeypatch.setattr(tiles, "first_hit_kernel", forbidden)
    monkeypatch.setattr("engine.film.PassFilm", forbidden)
    scene = scenes.cornell(SIZE)
    packed = pack(scene, Settings())
    assert packed.surfaces is None and packed.features.light_passes == 0
    result = picture(scene, ())
    assert result.passes == {} and "parts of the light: no pass shows one" in result.skipped


def test_light_passes_alone_trace_nothing_more():
    scene = scenes.cornell(SIZE)
    without = picture(scene, ())
    assert picture(scene, ("EMISSION", "ENVIRONMENT")).rays == without.rays
    assert pack(scene, Settings(passes=("EMISSION",))).surfaces is None
    features = pack(scene, Settings()).features
    assert new_batch(features).size < new_batch(features._replace(light_passes=1)).size


@pytest.mark.parametrize(
    ("passes", "per_pixel", "per_sample"),
    [
        (("DEPTH",), 1, 0),
        (("NORMAL",), 0, 1),
        (("DEPTH", "POSITION", "NORMAL", "UV"), 1, 1),
        (("DIFFUSE_DIRECT",), 0, 1),
    ],
)
def test_rays_are_traced_only_for_what_needs_them(passes, per_pixel, per_sample):
    scene = scenes.cornell(SIZE)
    more = picture(scene, passes).rays - picture(scene, ()).rays
    assert more == SIZE * SIZE * (per_pixel + 9 * per_sample)


def test_only_what_is_needed_is_stored():
    assert PassFilm((2, 3), ("EMISSION",)).parts.shape == (2, 3, 3)
    film = PassFilm((2, 3), ("DIFFUSE_DIRECT", "DEPTH"))
    assert film.parts.shape == (2, 3, 3) and film.data.shape == (2, 3, 1 + 3 + 1)  # depth, colour, samples
    scene = shapes()
    none = pack(scene, Settings(passes=("NORMAL",))).surfaces
    assert not len(none.uvs) and not len(none.triangle_index) and not len(none.material_index)
    assert len(pack(scene, Settings(passes=("UV",))).surfaces.uvs) == 2


def test_names_are_known():
    assert set(COLOR_OF.values()) <= set(MEAN) and set(PASSES) == {*MIDDLE, *MEAN, *LIGHT, "SAMPLE_COUNT"}
    with pytest.raises(SettingsError, match="'SHADOW'"):
        Settings(passes=("SHADOW",)).validate()
    with pytest.raises(SettingsError, match="a tuple of texts"):
        Settings(passes="DEPTH").validate()


def test_the_reference_road_says_that_it_has_none():
    result = render(scenes.furnace(size=2), Settings(samples=1, road="REFERENCE", passes=("DEPTH",)))
    assert result.passes == {} and any("passes" in warning for warning in result.warnings)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda scene: setattr(scene, "mist", Mist(depth=-1.0)), "mist"),
        (lambda scene: setattr(scene, "mist", Mist(falloff=3.0)), "falloff"),
        (lambda scene: setattr(scene, "occlusion_distance", float("nan")), "occlusion"),
        (lambda scene: setattr(scene, "alpha_threshold", 1.1), "alpha threshold"),
        (lambda scene: setattr(scene.instances, "pass_index", np.zeros(7, np.int32)), "pass_index"),
        (lambda scene: setattr(scene.meshes[0], "uvs", np.zeros((1, 3, 2), np.float32)), "uvs"),
    ],
)
def test_what_passes_need_is_checked(change, problem):
    scene = shapes()
    change(scene)
    with pytest.raises(Exception, match=problem):
        scene.validate()
