"""The kernel that goes in stages against the one that goes path by path: the same picture from the same numbers.

Calculated as written, and ray by ray, the two give the same bits: `test_same_bits` runs in a process of its own. As
users run it, packets of rays may meet a surface a rounding elsewhere, and a path may then decide otherwise.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
import scenes

import engine.pack.geometry as packing
from engine import Scene, Settings, World, render, tiles
from engine.kernels import batch
from engine.kernels.embree import ray_words
from engine.kernels.jit import AS_WRITTEN, CACHE_FOLDER
from engine.kernels.simd import WIDTH
from engine.pack import pack
from engine.passes import LIGHT
from engine.scene import Aperture, Material, Visibility
from engine.schedule import schedule
from tools.by_path import by_path

SIZE = 24
UNEVEN = 20  # samples: in a tile are more than a batch holds, which then ends within those of a pixel
ROUNDING = 1e-4  # relative, of a pixel
TURNED = 0.005  # of the pixels: a rounding may turn a decision of a path over. Here it turns none, elsewhere perhaps
GARBAGE = {"infinite": 0x7F800000, "no number": 0x7FC00000, "minus one": 0xBF800000, "all bits": 0xFFFFFFFF}
CLAMPED = {"clamp_direct": 2.0, "clamp_indirect": 0.2}
ADAPTIVE = {"use_adaptive_sampling": True, "adaptive_threshold": 0.05, "samples": 128}


def through_a_lens() -> Scene:
    scene = scenes.cornell(SIZE)
    scene.camera = replace(scene.camera, aperture=Aperture(0.05, 2.0, blades=5))
    scene.transparent_film = True
    return scene


def from_above() -> Scene:
    scene = scenes.sky_plate(SIZE)
    scene.camera = replace(scene.camera, orthographic=True)
    return scene


def under_a_sky() -> Scene:
    scene = scenes.lamp_room(["area", "sun"], SIZE)
    scene.world = World(color=(0.1, 0.2, 0.3))
    return scene


def behind_panes(**changes) -> Scene:
    """A Cornell box whose walls have a Phong lobe, behind two tinted panes that reflect a little, lamps before, between
    and behind them."""
    scene = scenes.cornell(SIZE)
    scene.materials[0] = Material("white", kd=(0.4,) * 3, ks=(0.4,) * 3, exponent=30.0)
    pane = Material("pane", kd=(0.1, 0.2, 0.3), emission=(0.01,) * 3, transparency=(0.7, 0.5, 0.0))
    scene.materials.append(replace(pane, **changes))
    for y in (-1.4, 0.0):
        scene.add_instance(scenes.quad_mesh((-0.8, y, -0.9), (1.6, 0, 0), (0, 0.2, 1.6)), materials=(4,))
    scene.lights = [scenes.lamp("sphere"), scenes.lamp("area"), scenes.lamp("wide_sun")]
    return scene


def with_holes(transparency: float) -> Scene:
    """The panes are holdouts that let through as much, before a film that shows no world."""
    scene = behind_panes(holdout=True, transparency=(transparency,) * 3)
    scene.transparent_film, scene.world = True, World(color=(0.1, 0.2, 0.3))
    return scene


def seen_by_some() -> Scene:
    """Each kind of ray sees other lamps, and not all see the world."""
    scene = behind_panes()
    kinds = Visibility.DIFFUSE, Visibility.GLOSSY, Visibility.CAMERA
    scene.lights = [
        replace(lamp, visibility=Visibility.ALL & ~kind) for lamp, kind in zip(scene.lights, kinds, strict=True)
    ]
    scene.world = World(color=(0.1, 0.2, 0.3), visibility=Visibility.ALL & ~Visibility.GLOSSY)
    return scene


def hidden_from_some() -> Scene:
    """A pane that shadow rays don't see, and another that diffuse ones don't."""
    scene = seen_by_some()
    scene.instances.visibility[-2:] = Visibility.ALL & ~Visibility.SHADOW, Visibility.ALL & ~Visibility.DIFFUSE
    return scene


SCENES = {
    "cornell": lambda: scenes.cornell(SIZE),
    "lens": through_a_lens,
    "orthographic": from_above,
    "phong": lambda: scenes.phong_plates(SIZE),
    "lamps": lambda: scenes.lamp_room(list(scenes.LAMP_KINDS), SIZE),
    "sky": under_a_sky,
    "panes": behind_panes,
    "holes": lambda: with_holes(0.3),
    "opaque holes": lambda: with_holes(0.0),
    "kinds of rays": seen_by_some,
    "unlike shadows": hidden_from_some,
}


def image_with_lamps() -> Scene:
    """An image and lamps, one of which casts no shadow, and a transparent film. The samples of a pass fill neither the
    last batch nor its last vector."""
    scene = scenes.sky_plate(SIZE - 1)
    scene.lights = [scenes.lamp("wide_sun"), replace(scenes.lamp("area"), cast_shadow=False), scenes.lamp("sphere")]
    scene.transparent_film = True
    return scene


def instanced(monkeypatch) -> Scene:
    """Two balls that share a mesh, one squeezed, under all kinds of lamps."""
    monkeypatch.setattr(packing, "BAKE_LIMIT", 0)
    scene = SCENES["lamps"]()
    scene.add_instance(scene.meshes[1], np.column_stack([np.diag((0.5, 0.8, 0.3)), (0.6, -0.4, 0.4)]))
    assert pack(scene, Settings()).features.instances
    return scene


def picture(scene: Scene, **changes):
    return render(scene, Settings(**{"samples": 15, "max_bounces": 4, "threads": 1, **changes}))


def path_by_path(scene: Scene, **changes):
    """As `picture`, by the other kernel."""
    with by_path():
        return picture(scene, **changes)


def assert_same(a: np.ndarray, b: np.ndarray) -> None:
    """Pictures of at least 15 samples. What a turned path changes in its pixel is its own light, which is bounded by
    what the brightest pixel shows."""
    off = np.abs(a - b).max(axis=-1)
    assert (off > ROUNDING * (1e-2 + np.abs(a).max(axis=-1))).mean() <= TURNED
    assert off.max() <= 2 * a.max() / 15
    assert np.allclose(a.mean(axis=(0, 1)), b.mean(axis=(0, 1)), rtol=1e-3)


@pytest.mark.parametrize("name", SCENES)
def test_both_kernels_give_the_same_picture(name):
    scene = SCENES[name]()
    one, other = picture(scene), path_by_path(scene)
    assert_same(one.pixels, other.pixels)
    assert one.rays == pytest.approx(other.rays, rel=1e-3)


def test_both_kernels_clamp():
    scene = SCENES["lamps"]()
    one = picture(scene, **CLAMPED).pixels
    assert_same(one, path_by_path(scene, **CLAMPED).pixels)
    assert one.mean() < 0.99 * picture(scene).pixels.mean()


def test_both_kernels_see_instances(monkeypatch):
    scene = instanced(monkeypatch)
    assert_same(picture(scene).pixels, path_by_path(scene).pixels)


def test_both_kernels_sample_adaptively():
    scene = SCENES["cornell"]()
    one, other = picture(scene, **ADAPTIVE), path_by_path(scene, **ADAPTIVE)
    assert one.samples < 126 and one.samples == pytest.approx(other.samples, rel=0.02)
    assert_same(one.pixels, other.pixels)


BITS = {
    **{name: (scene, {}) for name, scene in SCENES.items()},
    "image with lamps": (image_with_lamps, {}),
    "no bounce": (SCENES["lamps"], {"max_bounces": 0}),
    "one bounce": (SCENES["lamps"], {"max_bounces": 1}),
    "clamp": (SCENES["lamps"], CLAMPED),
    "clamp behind panes": (SCENES["panes"], CLAMPED),
    "kinds end apart": (SCENES["panes"], {"diffuse_bounces": 1, "glossy_bounces": 2}),
    "no bounce behind panes": (SCENES["panes"], {"max_bounces": 0}),
    "uniform hemisphere": (SCENES["cornell"], {"hemisphere_sampling": "UNIFORM"}),
    "rejection": (SCENES["panes"], {"hemisphere_sampling": "REJECTION"}),
    "adaptive": (SCENES["cornell"], ADAPTIVE),
    "batches that end in pixels": (SCENES["cornell"], {"samples": UNEVEN}),
    "batches that end in pixels behind panes": (SCENES["unlike shadows"], {"samples": UNEVEN}),
    "light passes": (SCENES["holes"], {"passes": LIGHT, **CLAMPED}),
}


def assert_same_bits(scene: Scene, changes: dict) -> None:
    one, other = picture(scene, **changes), path_by_path(scene, **changes)
    assert np.array_equal(one.pixels, other.pixels)
    assert all(np.array_equal(one.passes[name], other.passes[name]) for name in one.passes)
    assert (one.rays, one.samples, one.rejected) == (other.rays, other.samples, 0)


@pytest.mark.skipif(not AS_WRITTEN, reason="runs in a process of its own, below")
@pytest.mark.parametrize("name", BITS)
def test_same_bits(name):
    scene, changes = BITS[name]
    assert_same_bits(scene(), changes)


@pytest.mark.skipif(not AS_WRITTEN, reason="runs in a process of its own, below")
def test_same_bits_of_instances(monkeypatch):
    assert_same_bits(instanced(monkeypatch), {})


@pytest.mark.skipif(AS_WRITTEN, reason="this is that process")
def test_both_kernels_give_the_same_bits_of_what_is_calculated_as_written(pass_as_written):
    pass_as_written(__file__, "test_same_bits", len(BITS) + 1)


# What Embree says that it has code for is no more than packets of so many.
NARROW = """
import ctypes, sys
width, out, tests = int(sys.argv[1]), *sys.argv[2:]

class Processor:
    def __call__(self, device, number):
        return number <= {4: 32, 8: 33}[width]

class Library(ctypes.CDLL):
    def __getattr__(self, name):
        return Processor() if name == "rtcGetDeviceProperty" else super().__getattr__(name)

whole, ctypes.CDLL = ctypes.CDLL, Library
from engine.kernels.embree import PACKET_WIDTH
ctypes.CDLL = whole
assert PACKET_WIDTH == width

sys.path.insert(0, tests)
import numpy as np
from test_staged import SCENES, picture
np.save(out, picture(SCENES["lamps"]()).pixels)
"""


@pytest.mark.parametrize("width", [4, 8])
def test_narrower_packets_give_the_same_picture(width, tmp_path, repository):
    """Kernels for them look alike to Numba's cache, so they are kept in a place of their own."""
    subprocess.run(
        [sys.executable, "-c", NARROW, str(width), tmp_path / "pixels.npy", repository / "tests"],
        cwd=repository,
        env={**os.environ, "LOBE_CACHE_DIR": str(CACHE_FOLDER / f"packets of {width}")},
        check=True,
    )
    assert_same(picture(SCENES["lamps"]()).pixels, np.load(tmp_path / "pixels.npy"))


def test_no_bit_depends_on_where_batches_end():
    scene = SCENES["cornell"]()
    whole = picture(scene, samples=UNEVEN).pixels
    with mock.patch.object(tiles, "TILE_SAMPLES", 200):
        assert np.array_equal(whole, picture(scene, samples=UNEVEN, threads=2).pixels)
    x0, y0, x1, y1 = next(tiles.tiles_of(scene.render_region, UNEVEN))
    assert (x1 - x0) * (y1 - y0) * UNEVEN > batch.BATCH and batch.BATCH % UNEVEN
    assert list(schedule(UNEVEN, scene.width * scene.height)) == [(0, UNEVEN)]


@pytest.mark.parametrize("make", [image_with_lamps, hidden_from_some])
@pytest.mark.parametrize("word", GARBAGE.values(), ids=GARBAGE)
def test_what_lies_in_lanes_that_take_no_part_changes_no_bit(word, make, monkeypatch):
    """Every pass begins with new memory, and its samples fill only a part of that."""
    scene = make()
    scene.transparent_film = False  # through it the last pixels' paths, beside the garbage, would bring nothing
    one = picture(scene, samples=3)

    def dirty(features, lamp_count=0):
        memory = batch.new_batch(features, lamp_count)
        memory[: -ray_words(lamp_count, WIDTH)].view(np.uint32)[:] = word
        return memory

    monkeypatch.setattr(tiles, "new_batch", dirty)
    other = picture(scene, samples=3)
    assert np.array_equal(one.pixels, other.pixels)
    assert (one.rays, one.rejected) == (other.rays, other.rejected)


@pytest.mark.parametrize("slot", [2**31 - 1, 10**8])
def test_material_slots_beyond_all_are_looked_up_for_no_ray_that_misses(slot, monkeypatch):
    """The process would end with a lookup far outside of its memory."""
    monkeypatch.setattr(packing, "BAKE_LIMIT", 0)

    def balls(slot: int) -> Scene:
        scene = Scene(width=16, height=16, camera=scenes.camera(origin=(0, -4, 0)))
        scene.materials = [Material("grey", kd=(0.5, 0.5, 0.5))]
        scene.lights = [scenes.lamp("point")]
        mesh = scenes.sphere_mesh(8)
        mesh.material_slots = np.full(len(mesh.triangles), slot, np.int32)
        for x in (-1, 1):
            scene.add_instance(mesh, np.column_stack([np.eye(3) / 2, (x, 0, 0)]))
        return scene

    first, last = (picture(balls(chosen)).pixels for chosen in (0, slot))
    assert np.array_equal(first, last) and (first == 0).any() and (first > 0).any()
