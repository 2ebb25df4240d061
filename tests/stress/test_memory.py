"""Pictures that this computer has no memory for: a sentence, no traceback."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc

import little_memory
import numpy as np
import pytest
import scenes

import engine
from engine import memory
from engine.errors import LobeError, SceneError
from engine.film import Film
from engine.kernels.light.environment import build_environment
from engine.pack.geometry import pack_geometry
from engine.pack.lights import pack_lights
from engine.settings import Settings


class LittleMemory:
    """numpy where nothing has room. Patched into one module: elsewhere arrays are still made."""

    def __getattr__(self, name: str):
        return getattr(np, name)

    def zeros(self, *arguments):
        raise MemoryError

    empty = zeros


def test_the_largest_picture_that_blender_can_ask_for():
    scene = scenes.plate()
    scene.width = scene.height = 65536
    with pytest.raises(SceneError) as found:
        engine.render(scene, Settings(samples=1))
    assert str(found.value) == (
        "the picture of 65536 x 65536 pixels has more than 268 million: set a lower resolution, or render it in regions"
    )


def test_a_picture_whose_sums_find_no_memory(monkeypatch):
    scene = scenes.plate()
    scene.width, scene.height = 16384, 16000
    little_memory.leave(monkeypatch, memory, np.inf)
    monkeypatch.setattr("engine.film.np", LittleMemory())
    with pytest.raises(LobeError) as found:
        engine.render(scene, Settings(samples=1))
    assert str(found.value) == (
        "not enough memory to sum up the picture of 16384 x 16000 pixels, which takes 8.4 GB: set a lower resolution, "
        "or render it in regions"
    )


def test_a_picture_that_cannot_be_shown(monkeypatch):
    film = Film((10, 10, 1010, 510), 1.0)
    monkeypatch.setattr("engine.film.np", LittleMemory())
    with pytest.raises(LobeError) as found:
        film.pixels()
    assert str(found.value) == (
        "not enough memory to show the picture of 1000 x 500 pixels, which takes 0.0 GB: set a lower resolution, or "
        "render it in regions"
    )


@pytest.mark.parametrize("shape", [(1, 1), (540, 960), (3, 40_000), (40_000, 3), (0, 5)])
def test_strips_are_the_whole_picture(shape):
    """However many of them there are."""
    height, width = shape
    film = Film((0, 0, width, height), 1.3)
    random = np.random.default_rng(1)
    film.sums[:] = random.random((height, width, 4))
    film.samples[:] = random.integers(0, 5, (height, width))
    expected = film.sums / np.maximum(film.samples, 1)[:, :, None] * (1.3, 1.3, 1.3, 1.0)
    assert np.array_equal(film.pixels(), expected.astype(np.float32))


# --- foreseen ---------------------------------------------------------------------------------------------------

ROOM_FOR = 100_000  # bytes that there are in these tests
LESS = (
    "close other programs, use fewer triangles (lower levels of subdivision, instances instead of copies) or smaller "
    "images, or set a lower resolution"
)


def grid(side: int, smooth: bool = False) -> engine.Mesh:
    """(side, side) squares of two triangles, a wavy sheet over the unit square."""
    y, x = np.mgrid[: side + 1, : side + 1].astype(np.float32) / side
    vertices = np.stack([x, y, 0.05 * np.sin(20 * x)], axis=-1).reshape(-1, 3)
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    halves = [np.stack([first, first + a, first + b], 1) for a, b in ((1, side + 2), (side + 2, side + 1))]
    normals = np.tile(np.float32([0, 0, 1]), (len(vertices), 1)) if smooth else None
    return engine.Mesh("Sheet", vertices, np.concatenate(halves).astype(np.uint32), normals)


@pytest.mark.parametrize(
    ("make", "largest"),
    [
        (lambda scene: scene.add_instance(grid(60)), "7,202 triangles"),
        (lambda scene: [setattr(scene, side, 64) for side in ("width", "height")], "64 x 64 pixels"),
        (lambda scene: scattered(scene, 3000), "3,000 instances"),
        (lambda scene: setattr(scene, "world", sky(256, 128)), "the environment image of 256 x 128 pixels"),
    ],
    ids=["triangles", "pixels", "instances", "environment"],
)
def test_too_little_memory_is_known_before_the_build(monkeypatch, make, largest):
    scene, built = scenes.plate(), []
    make(scene)
    little_memory.leave(monkeypatch, memory, float(ROOM_FOR))
    monkeypatch.setattr("engine.pack.Accel", lambda *_: built.append(1))
    with pytest.raises(LobeError) as found:
        engine.render(scene, Settings(samples=1))
    said = str(found.value)
    assert said.startswith("not enough memory: rendering takes some 0.0 GB, 0.0 of it for ") and not built
    assert said.endswith(f" of it for {largest}, and 0.0 GB can be had: {LESS}")


def test_small_needs_are_not_asked_about(monkeypatch):
    """What there is takes a millisecond to find out, and Blender renders icons in few more."""
    asked: list[None] = []

    def available() -> float:
        asked.append(None)
        return 0.0

    monkeypatch.setattr(memory, "available", available)
    memory.foresee({"half of it": memory.SMALL / 2, "the other": memory.SMALL / 2})
    assert not asked
    with pytest.raises(LobeError, match=r"for more of it, and 0\.0 GB can be had"):
        memory.foresee({"more of it": memory.SMALL + 1})
    assert asked


def test_too_many_emissive_triangles_for_the_memory(monkeypatch):
    scene = scenes.plate()
    scene.materials[0] = engine.Material("Glow", emission=(1.0, 1.0, 1.0))
    scene.add_instance(grid(30))
    little_memory.leave(monkeypatch, memory, 400_000.0)
    with pytest.raises(LobeError, match=r"of it for 1,80[0-9] emissive triangles, "):
        engine.render(scene, Settings(samples=1))


def sky(width: int, height: int) -> engine.World:
    return engine.World((1.0, 1.0, 1.0), np.ones((height, width, 3), np.float32))


@pytest.mark.parametrize("size", [(512, 256), (700, 300), (1023, 64)])
def test_the_tables_of_an_environment_image_are_foreseen(size):
    """To the least that they and the first step of making them take."""
    world = sky(*size)
    tracemalloc.start()
    try:
        tables = build_environment(world.image)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    stay = sum(table.nbytes for table in tables) - world.image.nbytes
    (foreseen,) = memory.need_of_environment(world, memory.OF_TEXEL).values()
    assert foreseen <= stay < 1.3 * foreseen
    (foreseen,) = memory.need_of_environment(world, memory.OF_NEW_TEXEL).values()
    assert foreseen <= most < 1.5 * foreseen


def test_making_the_tables_of_an_environment_image_needs_room(monkeypatch):
    """Also where the surfaces are there already, as in a viewport and in an animation."""
    scene = scenes.plate()
    scene.world = sky(64, 32)
    geometry, need = pack_geometry(scene), memory.OF_NEW_TEXEL * 64 * 32
    little_memory.leave(monkeypatch, memory, float(need))
    environment = pack_lights(scene, geometry).environment
    little_memory.leave(monkeypatch, memory, need - 1.0)
    with pytest.raises(LobeError, match=" of it for the environment image of 64 x 32 pixels, "):
        pack_lights(scene, geometry)
    pack_lights(scene, geometry, environment)  # the same image


def test_an_image_that_does_not_shine_takes_no_tables():
    scene = scenes.plate()
    without = memory.need_of(scene, scene.meshes, 0)
    scene.world = engine.World((0.0, 0.0, 0.0), sky(64, 32).image)
    assert memory.need_of(scene, scene.meshes, 0) == without


def scattered(scene: engine.Scene, count: int) -> None:
    """So many placements of a mesh that is large enough to be shared."""
    scene.add_instance(grid(8))
    places = scene.instances
    rows = np.r_[0, np.ones(count, np.intp)]
    for name in ("mesh", "transforms", "material_offset", "slot_count", "visibility", "object"):
        setattr(places, name, getattr(places, name)[rows])


def test_where_there_is_enough_it_renders(monkeypatch):
    """What is foreseen is the least that is needed: no scene that fits is refused."""
    scene = scenes.plate()
    need = sum(memory.need_of(scene, scene.meshes, 0).values())
    little_memory.leave(monkeypatch, memory, float(need))
    assert engine.render(scene, Settings(samples=1)).samples == 1
    little_memory.leave(monkeypatch, memory, need - 1.0)
    with pytest.raises(LobeError):
        engine.render(scene, Settings(samples=1))


ALL_PASSES = tuple(engine.PASSES)


@pytest.mark.parametrize(
    "passes",
    [(), ("DEPTH",), ("SAMPLE_COUNT",), ("DIFFUSE_DIRECT", "DIFFUSE_INDIRECT"), ("EMISSION", "MIST", "UV"), ALL_PASSES],
)
def test_passes_are_foreseen_as_large_as_they_are(passes):
    """Their sums, their pictures, and as much again for Blender's."""
    film = Film((0, 0, 7, 5), 1.0, passes)
    sums = [array for array in (film.passes.parts, film.passes.data) if array.size > 1] if passes else []
    pictures = film.pass_pictures().values()
    taken = sum(array.nbytes for array in sums) + 2 * sum(picture.nbytes for picture in pictures)
    assert memory.bytes_a_pixel(passes) == taken / 35


def test_passes_count_before_there_is_a_film(monkeypatch):
    """The memory that suffices for a picture without passes is too little with them, which takes none to see."""
    scene, passes, made = scenes.plate(), ALL_PASSES, []
    need = float(sum(memory.need_of(scene, scene.meshes, 0).values()))
    little_memory.leave(monkeypatch, memory, need)
    monkeypatch.setattr("engine.schedule.Film", lambda *_: made.append(1))
    with pytest.raises(LobeError, match=f"of it for {len(passes)} passes of {scene.width} x {scene.height} pixels, "):
        engine.render(scene, Settings(samples=1, passes=passes))
    assert not made


def test_surfaces_and_passes_are_counted_together(monkeypatch):
    """Where each of them has room, and both have not."""
    scene = scenes.plate()
    scene.add_instance(grid(60))
    with_passes = sum(memory.need_of(scene, scene.meshes, 0, ALL_PASSES).values())
    without = sum(memory.need_of(scene, scene.meshes, 0).values())
    film = sum(memory.need_of_film(scene, ALL_PASSES).values())
    assert max(without, film) < with_passes - 1
    little_memory.leave(monkeypatch, memory, with_passes - 1.0)
    with pytest.raises(LobeError, match="not enough memory"):
        engine.render(scene, Settings(samples=1, passes=ALL_PASSES))


def test_memory_that_runs_out_all_the_same_is_named(monkeypatch):
    monkeypatch.setattr("engine.pack.pack_geometry", lambda *_: np.empty(1 << 57))
    with pytest.raises(LobeError) as found:
        engine.render(scenes.plate(), Settings(samples=1))
    assert str(found.value) == f"not enough memory to render this scene: {LESS}"


# In a process of its own: what packing a sheet takes, and what was foreseen, in bytes.
MEASURED = """
import sys
sys.path[:0] = [{folder!r}, {folder!r} + "/tests", {folder!r} + "/tests/stress"]
import resource, scenes
from engine import Settings, memory
from engine.pack import pack
from test_memory import grid
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()
pack(scenes.plate(), Settings())
scene = scenes.plate()
scene.add_instance(grid({side}, smooth={smooth}))
before = resident()
packed = pack(scene, Settings())
need = memory.need_of(scene, scene.meshes, 0)
print(resident() - before, next(iter(need.values())))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="measured on Linux")
@pytest.mark.parametrize("smooth", [False, True])
def test_what_is_foreseen_is_what_is_taken(repository, smooth):
    code = MEASURED.format(folder=str(repository), side=1400, smooth=smooth)
    taken, foreseen = map(int, run_alone(code).split())
    assert 0.85 * taken < foreseen < 1.15 * taken


# The same process, with an end to its memory before it renders: 7 million triangles, 0.3 GB.
LIMITED = """
import sys
sys.path[:0] = [{folder!r}, {folder!r} + "/tests", {folder!r} + "/tests/stress"]
import resource, scenes
from engine import LobeError, Settings, render
from test_memory import grid
settings = Settings(samples=1, max_bounces=0, threads=1)
assert render(scenes.plate(), settings).samples == 1
scene = scenes.plate()
scene.add_instance(grid(1870))
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (200 << 20), -1))
try:
    render(scene, settings)
except LobeError as error:
    print(error)
assert render(scenes.plate(), settings).samples == 1
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
def test_a_scene_too_large_for_the_process_is_refused_and_others_go_on(repository):
    said = run_alone(LIMITED.format(folder=str(repository)))
    assert said.startswith("not enough memory: rendering takes some 0.3 GB, 0.3 of it for 6,993,80")
    assert said.strip().endswith(LESS)


def run_alone(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


# --- what there is ----------------------------------------------------------------------------------------------


def test_there_is_some_memory():
    assert 1e6 < memory.available() < 1e14


def test_a_container_may_have_less(tmp_path):
    (tmp_path / "memory.max").write_text("5000000\n")
    (tmp_path / "memory.current").write_text("3000000\n")
    assert memory._control_group(tmp_path) == 2e6
    (tmp_path / "memory.stat").write_text("anon 7\ninactive_file 500000\nodd\n")
    assert memory._control_group(tmp_path) == 2.5e6
    stat = "active_file 400000\ninactive_file 500000\nfile_mapped {}\nslab_reclaimable 20000\nslab_unreclaimable 9\n"
    (tmp_path / "memory.stat").write_text(stat.format(300000))
    assert memory._control_group(tmp_path) == 2.62e6
    (tmp_path / "memory.stat").write_text(stat.format(2000000))  # shared memory, which is mapped and no copy of a file
    assert memory._control_group(tmp_path) == 2.02e6
    (tmp_path / "memory.max").write_text("max\n")
    assert memory._control_group(tmp_path) == np.inf
    assert memory._control_group(tmp_path / "none") == np.inf


@pytest.mark.parametrize(
    ("most", "used", "there"),
    [("700000", "200000", 5e5), ("max", "200000", 8.192e6), ("9000000", "0", 8.192e6), ("10", "20", 0), ("0", "0", 0)],
)
def test_a_container_swaps_as_much_as_it_may_and_as_there_is(tmp_path, monkeypatch, most, used, there):
    (tmp_path / "meminfo").write_text("MemAvailable: 100000 kB\nSwapFree: 8000 kB\n")
    monkeypatch.setattr(memory, "MEMORY", tmp_path / "meminfo")
    (tmp_path / "memory.max").write_text("5000000\n")
    (tmp_path / "memory.current").write_text("3000000\n")
    assert memory._control_group(tmp_path) == 2e6  # without a word about swap space
    (tmp_path / "memory.swap.max").write_text(most)
    (tmp_path / "memory.swap.current").write_text(used)
    assert memory._control_group(tmp_path) == 2e6 + there
    assert memory._linux() == 1024 * 108000


def new_group(folder, most: int, used: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "memory.max").write_text(f"{most}\n")
    (folder / "memory.current").write_text(f"{used}\n")


@pytest.mark.parametrize(
    ("own", "there"),
    [
        ("0::/user.slice/blender.scope\n", 1e6),
        ("0::/user.slice/other.scope\n", 2e6),
        ("0::/system.slice\n", 4e6),
        ("0::/\n", 4e6),
        ("0::/docker/0123\n", 4e6),  # not to be seen from within the container, whose own group is where the root is
        ("0::/../outside\n", 4e6),
        ("12:cpu,cpuacct:/user.slice\n0::/user.slice\n", 2e6),
        ("odd\n", np.inf),
    ],
)
def test_the_tightest_group_counts_that_the_process_is_in(tmp_path, monkeypatch, own, there):
    root = tmp_path / "cgroup"
    new_group(root, 5_000_000, 1_000_000)
    new_group(root / "user.slice", 3_000_000, 1_000_000)
    new_group(root / "user.slice" / "blender.scope", 1_500_000, 500_000)
    new_group(root / "user.slice" / "other.scope", 90_000_000, 0)
    (tmp_path / "own").write_text(own)
    assert memory._control_groups(tmp_path / "own", root) == there
    assert memory._control_groups(tmp_path / "none", root) == np.inf


def test_what_groups_leave_is_what_there_is(tmp_path, monkeypatch):
    new_group(tmp_path / "a", 3_000_000, 1_000_000)
    (tmp_path / "own").write_text("0::/a\n")
    monkeypatch.setattr(memory, "CONTROL_GROUPS", tmp_path)
    monkeypatch.setattr(memory, "OWN_GROUPS", tmp_path / "own")
    monkeypatch.setattr(sys, "platform", "linux")
    assert memory.available() == 2e6


def test_groups_of_version_1(tmp_path, monkeypatch):
    """The limit with swap space is one for both together; without it there is as much swap space as the system has."""
    (tmp_path / "meminfo").write_text("SwapFree: 2000 kB\n")
    monkeypatch.setattr(memory, "MEMORY", tmp_path / "meminfo")
    (tmp_path / "own").write_text("9:name=systemd:/\n4:memory:/jobs/7\n0::/\n")
    folder = tmp_path / "memory" / "jobs" / "7"
    folder.mkdir(parents=True)

    def left(folder=folder, **numbers: int) -> float:
        for name, number in numbers.items():
            (folder / f"memory.{name}_in_bytes").write_text(f"{number}\n")
        return memory._control_groups(tmp_path / "own", tmp_path)

    assert left() == np.inf
    assert left(limit=5_000_000, usage=3_000_000) == 2e6 + 2_048_000
    assert left(**{"memsw.limit": 6_000_000, "memsw.usage": 3_500_000}) == 2.5e6
    (folder / "memory.stat").write_text("active_file 1\ntotal_active_file 300000\ntotal_inactive_file 200000\n")
    assert left() == 3e6
    (folder / "memory.stat").write_text("total_active_file 300000\ntotal_mapped_file 900000\n")
    assert left() == 2.5e6
    assert left(folder.parent, limit=1_000_000, usage=900_000) == 1e5 + 2_048_000
    unlimited = {"limit": 9223372036854771712, "usage": 1, "memsw.limit": 9223372036854771712, "memsw.usage": 1}
    assert left(folder, **unlimited) == 1e5 + 2_048_000
    assert left(folder.parent, **unlimited) > 1e18
