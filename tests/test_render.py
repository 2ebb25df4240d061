"""The compiled road's schedule: bits don't depend on threads, a stop takes effect, nothing is left uncounted."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
import scenes
from hypothesis import given, settings
from hypothesis import strategies as st

from engine import AreaLight, Material, Scene, SceneError, Settings, SettingsError, Visibility, World, render
from engine.accel import Accel, BuildStopped
from engine.kernels.embree import is_finite
from engine.kernels.jit import kernel
from engine.pack.geometry import pack_geometry
from engine.schedule import PASS_SAMPLES, schedule

QUICK = Settings(samples=8, threads=2)


def picture(scene, **settings):
    return render(scene, replace(QUICK, **settings)).pixels


def test_same_bits_on_one_and_on_two_threads():
    scene = scenes.cornell(48)
    assert np.array_equal(picture(scene, threads=1), picture(scene, threads=2))


def test_seed_changes_the_noise_and_only_that():
    scene = scenes.cornell(32)
    one, two = picture(scene, seed=1, samples=64), picture(scene, seed=2, samples=64)
    assert not np.array_equal(one, two)
    assert one.mean() == pytest.approx(two.mean(), rel=0.02)


def test_region_is_the_same_part_of_the_whole():
    scene = scenes.cornell(48)
    whole = picture(scene)
    scene.region = (8, 16, 40, 29)
    assert np.array_equal(picture(scene), whole[16:29, 8:40])


def test_stop_takes_effect_at_once_and_keeps_the_picture():
    """Within half a second, as benchmarks/startup.py measures; here, long before the end."""
    scene = scenes.cornell(256)
    picture(scene, samples=1)
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    result = render(scene, replace(QUICK, samples=1 << 20), stop=stop.is_set)
    assert result.stopped and result.samples < 1 << 20
    assert result.pixels[..., :3].max() > 0


@settings(deadline=None, derandomize=True)
@given(total=st.integers(1, 5000), pixels=st.integers(1, 1 << 26))
def test_passes_have_each_sample_once_and_never_more_than_a_tile_holds(total, pixels):
    passes = list(schedule(total, pixels))
    assert [sample for first, count in passes for sample in range(first, first + count)] == list(range(total))
    assert max(count for _, count in passes) <= PASS_SAMPLES


def test_a_large_picture_stands_after_one_sample_a_pixel():
    assert list(schedule(64, 1920 * 1080)) == [(0, 1), (1, 1), (2, 2), (4, 4), (8, 8), (16, 16), (32, 32)]


def test_a_small_picture_begins_with_a_pass_worth_its_time():
    assert list(schedule(64, 256 * 256)) == [(0, 8), (8, 8), (16, 16), (32, 32)]


def test_a_build_ends_when_it_is_told_to():
    mesh = scenes.sphere_mesh(100)
    packed = pack_geometry(scenes.furnace(mesh=mesh))
    halt = np.zeros(1, np.uint8)
    Accel(packed.shapes, halt)
    halt[0] = 1
    for threads in (1, 2):
        with pytest.raises(BuildStopped):
            Accel(packed.shapes, halt, threads)


def test_progress_ends_at_all_samples():
    seen = []
    render(scenes.cornell(64), replace(QUICK, samples=100), progress=lambda p: seen.append((p.samples, p.message)))
    assert seen[0][1] == "building"
    assert [s for s, _ in seen] == sorted(s for s, _ in seen)


def test_time_limit_ends_the_render():
    scene = scenes.cornell(128)
    picture(scene, samples=1)
    result = render(scene, replace(QUICK, samples=1 << 20, time_limit=0.3))
    assert not result.stopped
    assert 0 < result.samples < 1 << 20


def test_adaptive_sampling_saves_samples_and_keeps_the_mean():
    scene = scenes.cornell(32)
    full = render(scene, replace(QUICK, samples=1024))
    adapted = render(scene, replace(QUICK, samples=1024, use_adaptive_sampling=True, adaptive_threshold=0.1))
    assert adapted.samples < 0.9 * full.samples
    assert adapted.pixels.mean() == pytest.approx(full.pixels.mean(), rel=0.01)


def test_report_counts_rays_and_names_what_was_skipped():
    result = render(scenes.cornell(16), QUICK)
    assert result.rejected == 0
    assert result.rays > 16 * 16 * 8 * 2
    assert any("Phong" in line for line in result.skipped)
    assert set(result.seconds) == {"build", "compile", "render"}


def test_baked_and_instanced_give_the_same_picture(monkeypatch):
    import engine.pack.geometry as packing

    scene = scenes.phong_plates(32)
    scene.meshes[0].normals = None
    ball = scenes.sphere_mesh(8, smooth=True, name="many")
    for i, mirror in enumerate((1, -1, 1)):
        matrix = np.column_stack([np.diag([0.2 * mirror, 0.3, 0.1 + 0.1 * i]), (i - 1.0, -0.5, 0.6)])
        scene.add_instance(ball, matrix, materials=(1,), name=f"instance {i}")
    baked = picture(scene, samples=256)
    monkeypatch.setattr(packing, "BAKE_LIMIT", 0)
    instanced = render(scene, replace(QUICK, samples=256))
    assert not any("instance transforms" in line for line in instanced.skipped)
    assert np.abs(instanced.pixels - baked).mean() < 0.01 * baked.mean()


def test_instances_whose_matrices_lie_transposed_in_memory(monkeypatch):
    """As Blender hands them out."""
    import engine.pack.geometry as packing

    monkeypatch.setattr(packing, "BAKE_LIMIT", 0)
    scene = scenes.phong_plates(32)
    for x in (-1.0, 0.0, 1.0):
        scene.add_instance(scenes.sphere_mesh(8, name="ball"), scenes.place((x, -0.5, 0.6), scale=(0.2, 0.3, 0.2)))
    expected = picture(scene)
    rows = scene.instances.transforms
    scene.instances.transforms = np.ascontiguousarray(rows.transpose(0, 2, 1)).transpose(0, 2, 1)
    assert np.array_equal(picture(scene), expected)


@pytest.mark.parametrize("turned", [0.0, 0.3, 1.1])
def test_lamp_in_the_plane_of_a_ceiling_makes_no_hole(turned):
    """A dim lamp in the ceiling of a closed box, and a bright sky outside."""
    cos, sin = np.cos(turned), np.sin(turned)
    turn = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])

    def turned_too(matrix):
        return np.column_stack([turn @ matrix[:, :3], turn @ matrix[:, 3] + (0.7, -1.3, 2.1)])

    camera = scenes.camera((0.1, 0.2, -1.0), (0.2, 0.13, 1.0), half_width=0.12)
    camera.transform[:] = turned_too(camera.transform)
    scene = Scene(camera=camera, width=32, height=32, materials=[Material("wall", kd=(0.5,) * 3)])
    scene.add_instance(scenes.cube_mesh(2.0), turned_too(np.eye(3, 4)))
    place = turned_too(scenes.place((0.0, 0.0, 2.0), (0.0, 0.0, -1.0)))
    scene.lights = [AreaLight("lamp", place, radiance=(1e-3,) * 3, size_x=3.0, size_y=3.0)]
    scene.world = World(color=(100.0,) * 3)
    radiance = picture(scene, samples=16, max_bounces=0)[..., :3]
    assert radiance.min() > 0.99e-3 and radiance.max() < 2e-3


@pytest.mark.parametrize("towards", [(0.0, 0.0, 1.0), (0.3, 0.5, 0.7)])
def test_lamp_in_the_plane_of_a_face_is_seen_from_everywhere(towards):
    """At the world's origin, where the lamp's own coordinates say nothing of how far away it is seen from."""
    direction = np.array(towards) / np.linalg.norm(towards)
    place = scenes.place((0, 0, 0), direction)
    scene = Scene(width=32, height=32, materials=[Material("face", kd=(0.5,) * 3)])
    scene.add_instance(scenes.quad_mesh(-2 * place[:, 0] - 2.2 * place[:, 1], 4 * place[:, 0], 4.4 * place[:, 1]))
    scene.lights = [AreaLight("lamp", place, radiance=(1.0,) * 3)]
    for distance in (1.0, 3.0, 10.0, 30.0):
        scene.camera = scenes.camera(distance * direction + 0.01 * place[:, 0], -direction, half_width=0.4 / distance)
        assert picture(scene, samples=4, max_bounces=0)[..., :3].mean() > 0.999


def test_transparent_film_has_no_alpha_where_nothing_is():
    scene = scenes.lamp_room(["point"], 32)
    scene.transparent_film = True
    alpha = picture(scene)[..., 3]
    assert alpha.min() == 0
    assert alpha.max() == 1


def test_transparent_material_lets_light_through():
    scene = scenes.plate(Material("floor", kd=(0.5,) * 3))
    scene.world = World(color=(1.0, 1.0, 1.0))
    scene.materials.append(Material("film", transparency=(0.25, 0.5, 1.0)))
    scene.add_instance(scenes.quad_mesh((-10, -10, 0.1), (20, 0, 0), (0, 20, 0), "film"), materials=(1,))
    mean = picture(scene, samples=512, max_bounces=0)[..., :3].mean(axis=(0, 1))
    # The film is passed twice: towards the floor by the light, and by the camera.
    assert mean == pytest.approx(0.5 * np.array([0.25, 0.5, 1.0]) ** 2, rel=0.03)


def test_bad_settings_and_scenes_are_refused():
    with pytest.raises(SettingsError, match="setting 'samples' is 0: it must lie between 1 and"):
        render(scenes.cornell(8), replace(QUICK, samples=0))
    with pytest.raises(SceneError, match="no camera"):
        scene = scenes.cornell(8)
        scene.camera = None
        render(scene, QUICK)


def test_light_close_to_a_surface_is_not_blocked_by_itself():
    """A 2 x 2 square 0.01 above a plate: below its middle it fills the sky. Lambert's formula for the polygon."""
    scene = scenes.plate(Material("white", kd=(1.0,) * 3), towards=(0.0, 0.0, -1.0))
    scene.materials.append(Material("lamp", emission=(1.0,) * 3))
    # Seen only by light sampling and diffuse rays, so that the camera looks through it.
    lamp = scenes.quad_mesh((-1, -1, 0.01), (2, 0, 0), (0, 2, 0), "lamp")
    scene.add_instance(lamp, materials=(1,), visibility=Visibility.ALL & ~Visibility.CAMERA)
    side = np.arctan(1 / np.hypot(1, 0.01)) / np.hypot(1, 0.01)
    irradiance = 4 * side  # L/2 * 4 edges * angle * cosine, doubled by symmetry of the half angles
    mean = picture(scene, samples=64, max_bounces=0)[..., :3].mean()
    assert mean == pytest.approx(irradiance / np.pi, rel=2e-3)


def test_flat_emitter_gives_itself_no_light():
    """In its own plane rounding decides on which side of itself a point lies; off the origin it often errs."""
    scene = scenes.plate(Material("lamp", kd=(0.8,) * 3, emission=(2.0,) * 3), towards=(0.0, 0.6, -0.8), size=32)
    scene.camera.transform[:, 3] += (3.3, 1.7, 5.488)
    scene.meshes[0].vertices += np.array([3.3, 1.7, 5.488], np.float32)
    assert picture(scene)[..., :3] == pytest.approx(2.0, rel=1e-6)


def test_rejection_sampling_counts_its_draws():
    """12 / pi points of the cube for a direction. Their number is geometric: its deviation is sqrt(1 - p) / p."""
    result = render(scenes.furnace(size=32), replace(QUICK, samples=64, hemisphere_sampling="REJECTION"))
    p = np.pi / 12
    directions = 32 * 32 * 64  # at least one for each path
    assert result.draws_per_direction == pytest.approx(1 / p, abs=4 * np.sqrt(1 - p) / p / np.sqrt(directions))
    assert render(scenes.furnace(size=4), QUICK).draws_per_direction == 0


@kernel
def finite(values, out):
    for i in range(len(values)):
        out[i] = is_finite(values[i])


def test_the_guard_against_values_that_are_not_finite_survives_fastmath():
    values = np.array([0, -1, 3e38, np.nan, np.inf, -np.inf], np.float32)
    out = np.zeros(len(values), np.bool_)
    finite(values, out)
    assert out.tolist() == [True, True, True, False, False, False]


def test_pure_phong_seen_from_behind_its_shading_normal():
    """No lobe answers there; with kinds of rays told apart this once was 0 / 0."""
    scene = scenes.lamp_room(["area"], 32)
    scene.materials[1] = Material("mirror", ks=(0.8,) * 3, exponent=50)
    ball = scenes.sphere_mesh(5, radius=0.5, smooth=True, name="coarse")
    scene.add_instance(ball, np.column_stack([np.eye(3), (0.5, -0.6, 0.5)]), materials=(1,))
    result = render(scene, replace(QUICK, samples=64, max_bounces=4, diffuse_bounces=2))
    assert result.rejected == 0
    assert np.isfinite(result.pixels).all()


def test_wall_right_behind_a_lamp_hides_the_world():
    scene = scenes.Scene(width=8, height=8, camera=scenes.camera(half_width=1e-3), world=World(color=(7.0,) * 3))
    scene.camera.transform[:, 3] = (0, -300, 0)
    scene.materials = [Material("black")]
    scene.add_instance(scenes.quad_mesh((-9, 0.0005, -9), (18, 0, 0), (0, 0, 18)))
    scene.lights = [AreaLight("lamp", scenes.place((0, 0, 0), (0, -1, 0)), radiance=(1.0,) * 3, size_x=9, size_y=9)]
    assert picture(scene)[..., :3] == pytest.approx(1.0, rel=1e-5)


def test_instances_of_a_mesh_far_from_its_own_origin(monkeypatch):
    """A white ball under a white world is lit by what its horizon leaves: the same however it is stored."""
    import engine.pack.geometry as packing

    monkeypatch.setattr(packing, "BAKE_LIMIT", 0)
    pictures = []
    for offset in (0.0, 1e4):
        scene = scenes.Scene(width=32, height=32, camera=scenes.camera(origin=(0, -4, 0), half_width=0.3))
        scene.materials, scene.world = [Material("grey", kd=(0.5,) * 3)], World(color=(1.0,) * 3)
        ball = scenes.sphere_mesh(16)
        ball.vertices = (ball.vertices + np.float32([offset, 0, 0])).astype(np.float32)
        matrix = np.eye(3, 4)
        matrix[0, 3] = -offset
        for _ in range(2):  # a single instance would be baked; the second lies out of sight
            scene.add_instance(ball, matrix)
            matrix = matrix + np.array([[0, 0, 0, 0], [0, 0, 0, 50], [0, 0, 0, 0]])
        pictures.append(picture(scene)[..., :3].mean())
    assert pictures[1] == pytest.approx(pictures[0], rel=3e-3)
