"""Tables for the kernels: of one type whatever the scene's arrays are like, without lights that shine on nothing."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest
import scenes

import engine.pack as packing
from engine import Material, Mesh, Scene, SceneError, Settings, SunLight, Visibility, World, render
from engine.features import POINT
from engine.kernels.light.tree import POWER
from engine.kernels.tables import EXPONENT, SPREAD_NORM
from engine.pack import Packed, pack
from engine.pack.geometry import pack_geometry, pack_materials
from engine.pack.lights import pack_lights
from engine.scene import AreaLight, PointLight

CAMERA_ONLY = Visibility.CAMERA


def types(packed: Packed) -> list:
    tables = [
        *packed.geometry,
        *packed.lights,
        *packed.environment,
        *packed.tree,
        packed.camera,
        packed.filter_table,
        packed.sampler,
    ]
    return [numba.typeof(table) for table in tables]


def odd(array: np.ndarray, how: str) -> np.ndarray:
    """The same values in another guise."""
    if how == "strided":
        array = np.repeat(array, 2, axis=0)[::2]
    elif how == "Fortran":
        array = np.asfortranarray(array)
    else:
        array = array.copy()
        array.flags.writeable = False
    return array


def scene_of_everything() -> Scene:
    scene = scenes.lamp_room(list(scenes.LAMP_KINDS), 8)
    scene.world = World(color=(1.0, 1.0, 1.0), image=scenes.sky_image())
    scene.materials.append(Material("glow", emission=(1.0, 1.0, 1.0)))
    ball = scenes.sphere_mesh(6, 0.1, smooth=True)
    ball.normal_indices, ball.material_slots = ball.triangles.copy(), np.zeros(len(ball.triangles), np.int32)
    for materials in ((0,), (0,), (len(scene.materials) - 1,)):
        scene.add_instance(ball, np.column_stack([2 * np.eye(3), (0, 0, 1)]), materials)
    return scene


@pytest.mark.parametrize("how", ["strided", "Fortran", "read-only"])
def test_tables_have_one_type_whatever_the_arrays_of_the_scene(how, monkeypatch):
    monkeypatch.setattr("engine.pack.geometry.BAKE_LIMIT", 100)
    expected = types(pack(scene_of_everything(), Settings()))
    scene = scene_of_everything()
    for record in (scene.instances, *scene.meshes):
        for name, value in vars(record).items():
            if isinstance(value, np.ndarray):
                setattr(record, name, odd(value, how))
    world = scene.world
    scene.world = replace(world, image=odd(world.image, how), rotation=odd(world.rotation, how))
    scene.validate()
    packed = pack(scene, Settings())
    assert packed.features.instances
    assert types(packed) == expected
    tables = [*packed.geometry, *packed.lights, *packed.environment]
    assert all(table.flags.c_contiguous and table.flags.writeable for table in tables)
    assert not np.shares_memory(packed.geometry.slots, scene.instances.material_table)


def packed_lights(scene: Scene):
    scene.validate()
    return pack_lights(scene, pack_geometry(scene))


def test_lamps_that_no_ray_finds_are_left_out():
    panel = AreaLight("panel", scenes.place((0, 0, 2)), radiance=(1.0, 1.0, 1.0))
    dark = [replace(panel, radiance=(0.0, 0.0, 0.0)), replace(panel, visibility=Visibility.SHADOW)]
    suns = [SunLight("dark"), SunLight("hidden", visibility=Visibility.SHADOW, irradiance=(1.0, 1.0, 1.0))]
    packed = packed_lights(scenes.lit_plate([*dark, panel, *suns]))
    assert len(packed.tables.lamps) == 1
    assert len(packed.tables.suns) == 0
    assert packed.features["suns"] == 0


@pytest.mark.parametrize("count", [1, 3])
def test_lights_that_only_the_camera_sees_are_seen_and_not_drawn(count):
    """The camera looks down through panels on an emissive square above the plate."""
    scene = scenes.plate(Material("white", kd=(1.0, 1.0, 1.0)))
    scene.lights = [
        AreaLight(f"panel {i}", scenes.place((0, 0, 0.2 * (i + 1)), (0, 0, 1)), CAMERA_ONLY, radiance=(2.0, 2.0, 2.0))
        for i in range(count)
    ]
    scene.materials.append(Material("glow", emission=(3.0, 3.0, 3.0)))
    scene.add_instance(scenes.quad_mesh((-1, -1, 0.1), (2, 0, 0), (0, 2, 0)), materials=(1,), visibility=CAMERA_ONLY)
    assert not np.any(packed_lights(scene).tree.nodes[:, POWER])
    lit = render(scene, Settings(samples=4, threads=1, pixel_filter="BOX"))
    assert lit.pixels[..., 0] == pytest.approx(3.0 + 2.0 * count, rel=1e-5)


@pytest.mark.parametrize(
    ("triangles", "rectangles", "emitters"), [(1, 0, 1), (2, 1, 1), (3, 1, 2), (4, 2, 2), (5, 2, 3)]
)
@pytest.mark.parametrize("strips", [1, 2])
def test_neighbours_make_rectangles_and_no_triangle_is_in_two(strips, triangles, rectangles, emitters):
    """Strips of right-angled triangles, each of which makes a rectangle with the one before and the one after."""
    scene = scenes.plate(Material("white", kd=(1.0, 1.0, 1.0)))
    scene.materials.append(Material("glow", emission=(3.0, 3.0, 3.0)))
    corners = np.array([(i // 2, i % 2, 1.0) for i in range(triangles + 2)], np.float32)
    rows = np.arange(triangles)[:, None] + (0, 1, 2)
    for strip in range(strips):
        scene.add_instance(Mesh("strip", corners + np.float32([0, 0, strip]), rows.astype(np.uint32)), materials=(1,))
    lights = packed_lights(scene)
    assert len(lights.tables.emitter_triangle) == strips * emitters
    assert np.count_nonzero(lights.tables.emitter_rectangle.any(axis=1)) == strips * rectangles


@pytest.mark.parametrize("spread", [1e-4, 1.9e-3, 2.1e-3, 0.05, 0.099, 0.101, 1.0])
def test_spread_keeps_the_power(spread):
    """The factor that makes up for what the slats take: 1 / (tan h - h), by its series where that cancels."""
    h = np.longdouble(spread) / 2
    expected = 3 / (h**3 * (1 + h**2 * (0.4 + h**2 * 17 / 105))) if h < 0.03 else 1 / (np.tan(h) - h)
    panel = AreaLight("panel", scenes.place((0, 0, 2)), radiance=(1.0, 1.0, 1.0), spread=spread)
    lamps = packed_lights(scenes.lit_plate([panel])).tables.lamps
    assert lamps[0, SPREAD_NORM] == pytest.approx(float(expected), rel=1e-6)


def test_sizes_too_small_for_float32_count_as_none():
    lamp = PointLight("lamp", scenes.place((0, 0, 2)), intensity=(4.0, 4.0, 4.0), radius=1e-20)
    sun = SunLight("sun", irradiance=(1.0, 1.0, 1.0), angle=1e-20)
    packed = packed_lights(scenes.lit_plate([lamp, sun]))
    assert packed.features["lamp_kinds"] == POINT
    assert packed.features["sun_disks"] == 0
    assert np.isfinite(packed.tables.lamps).all()
    assert np.isfinite(packed.tables.suns).all()


def test_exponent_is_capped():
    table = pack_materials(Scene(materials=[Material("mirror", exponent=1e39), Material("dull", exponent=7.0)]))
    assert table[:, EXPONENT].tolist() == [1e8, 7.0]


def test_tables_too_large_for_the_kernels_are_refused(monkeypatch):
    scene = scenes.cornell(8)
    count = len(pack_geometry(scene).tables.vertices)
    monkeypatch.setattr(packing, "MOST_NUMBERS", 3 * count)
    pack(scene, Settings())
    monkeypatch.setattr(packing, "MOST_NUMBERS", 3 * count - 1)
    with pytest.raises(SceneError) as caught:
        pack(scene, Settings())
    assert str(caught.value) == (
        f"the scene has {count} vertices, and {count - 1} can be rendered: use fewer, for instance with "
        "lower levels of subdivision or with instances of a mesh"
    )
