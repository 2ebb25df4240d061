"""Rendering a scene that changes: what is packed again, what is seen meanwhile, and that threads and memory go."""

from __future__ import annotations

import gc
import mmap
import os
import threading
import time
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scenes

import engine.live as live
import engine.pack.again as again
from engine import Interactive, LobeError, Material, Picture, Prepared, Scene, SceneError, Settings, World, render
from engine.kernels.camera import pack_camera
from engine.pack import Packed, pack
from engine.pack.again import pack_again, pack_next

QUICK = Settings(samples=4, max_bounces=2, threads=2)
STATM = Path("/proc/self/statm")
PATIENCE = 120.0  # seconds: the first test of a fresh checkout compiles


class Watcher:
    """An `Interactive`, and the pictures that it has shown."""

    def __init__(self) -> None:
        self.pictures: list[Picture] = []
        self.messages: list[str] = []
        self._news = threading.Condition()
        self.interactive: Interactive | None = None
        self.interactive = Interactive(self._changed)

    def _changed(self) -> None:
        with self._news:
            if self.interactive is not None:
                self.messages.append(self.interactive.message)
                if (picture := self.interactive.picture) is not None:
                    self.pictures.append(picture)
            self._news.notify()

    def wait_for(self, condition) -> None:
        with self._news:
            assert self._news.wait_for(condition, PATIENCE)

    def show(self, scene: Scene, settings: Settings = QUICK) -> Picture:
        """Show it and wait for its last picture. Raises what it was told instead."""
        interactive = self.interactive
        picture, error = interactive.picture, interactive.error
        interactive.show(scene, settings)
        self.wait_for(
            lambda: (
                (interactive.error is not error and interactive.error is not None)
                or (interactive.picture is not picture and interactive.picture.samples == settings.samples)
            )
        )
        if interactive.error is not None:
            raise interactive.error
        return interactive.picture


@pytest.fixture
def watcher() -> Iterator[Watcher]:
    watcher = Watcher()
    yield watcher
    assert watcher.interactive.close(PATIENCE)


def room(size: int = 24) -> Scene:
    """A point and an area lamp, and a ball."""
    scene = scenes.lamp_room(["point", "area"], size)
    scene.add_instance(scenes.sphere_mesh(8, 0.3, smooth=True), scenes.place((0.2, 0.1, 0.5)))
    return scene


def moved_camera(scene: Scene, by: float) -> Scene:
    camera = scene.camera
    assert camera is not None
    transform = camera.transform + np.array([0, 0, 0, by])
    return replace(scene, camera=replace(camera, transform=transform))


def with_material(scene: Scene, **changes) -> Scene:
    return replace(scene, materials=[replace(scene.materials[0], **changes), *scene.materials[1:]])


def with_first_light(scene: Scene, **changes) -> Scene:
    return replace(scene, lights=[replace(scene.lights[0], **changes), *scene.lights[1:]])


def with_moved_object(scene: Scene) -> Scene:
    transforms = scene.instances.transforms.copy()
    transforms[-1, :, 3] += 0.1
    return replace(scene, instances=replace(scene.instances, transforms=transforms))


def tables(packed: Packed) -> list[bytes]:
    """All that a kernel reads but for Embree's address. As bytes: the tree's floats also hold whole numbers."""
    geometry = packed.geometry._replace(accel=np.zeros(1, np.uint64))
    groups = (geometry, packed.lights, packed.environment, packed.tree)
    return [table.tobytes() for group in (*groups, (packed.camera, packed.filter_table)) for table in group]


# Of each edit: how, and whether triangles and the ray tracing structure stay.
EDITS = {
    "camera": (lambda scene: moved_camera(scene, 0.01), True, True),
    "material": (lambda scene: with_material(scene, kd=(0.1, 0.2, 0.3)), True, True),
    "first phong material": (lambda scene: with_material(scene, ks=(0.1,) * 3, exponent=9.0), True, True),
    "transparency": (lambda scene: with_material(scene, transparency=(0.5,) * 3), True, True),
    "emission": (lambda scene: with_material(scene, emission=(1.0,) * 3), False, False),
    "world": (lambda scene: replace(scene, world=World(color=(0.3, 0.2, 0.1))), True, True),
    "fewer lamps": (lambda scene: replace(scene, lights=scene.lights[:1]), True, True),
    "more lamps than are listed": (lambda scene: replace(scene, lights=scene.lights * 20), True, False),
    "lamp off": (lambda scene: with_first_light(scene, intensity=(0.0,) * 3), True, True),
    "lamp moved": (lambda scene: with_first_light(scene, transform=scenes.place((0.1, 0.2, 0.9))), True, True),
    "object": (with_moved_object, False, False),
    "film": (lambda scene: replace(scene, transparent_film=True, exposure=2.0), True, True),
    "size": (lambda scene: replace(scene, width=40, region=(3, 4, 30, 15)), True, True),
}


@pytest.mark.parametrize("far", [0.0, 1e4], ids=["here", "far off"])
@pytest.mark.parametrize("edit", EDITS)
def test_what_is_packed_again_is_what_would_be_packed_anew(edit, far):
    scene = room()
    scene.instances.transforms[:, :, 3] += far
    scene.camera.transform[:, 3] += far
    scene.lights = [replace(light, transform=light.transform + np.array([0, 0, 0, far])) for light in scene.lights]
    before = pack(scene, QUICK)
    change, keeps_triangles, keeps_accel = EDITS[edit]
    changed = change(scene)
    packed, anew = pack_again(before, changed, QUICK), pack(changed, QUICK)
    assert packed.features == anew.features
    assert tables(packed) == tables(anew)
    assert (packed.geometry.vertices is before.geometry.vertices) == keeps_triangles
    assert (packed.accel is before.accel) == keeps_accel


def test_what_changed_is_seen_through_several_edits():
    """Also where an edit takes over what another has taken over."""
    packed, scene = pack(room(), QUICK), room()
    for change, _, _ in EDITS.values():
        scene = change(scene)
        packed = pack_again(packed, scene, QUICK)
    assert tables(packed) == tables(pack(scene, QUICK))


def test_a_camera_far_from_the_lamps_gets_shapes_that_suit_it():
    """Their distance from the surface behind them grows with the largest coordinate. Not at every move, though."""
    scene = scenes.lamp_room(["area"], 16)
    scene.lights *= 20  # more than are listed: their shapes are Embree's
    packed = pack(scene, QUICK)
    far = pack_again(packed, moved_camera(scene, 1e3), QUICK)
    assert far.accel is not packed.accel
    assert far.parts.lights.reach == pytest.approx(again.ROOM * 1e3, rel=0.01)
    assert pack_again(far, moved_camera(scene, 1.5e3), QUICK).accel is far.accel


def test_frames_are_packed_as_if_each_was_the_only_one():
    """Also where the camera has left the lamps, or has come back to them."""
    prepared, scene = Prepared(), scenes.lamp_room(["point", "area"], 16)
    scene.add_instance(scenes.sphere_mesh(8, 0.3, smooth=True), scenes.place((0.2, 0.1, 0.5)))
    frames = [scene]
    for change, _, _ in EDITS.values():
        frames.append(change(frames[-1]))
    frames += [moved_camera(scene, by) for by in (1e3, 2e3, 0.0)]
    for frame in frames:
        assert tables(pack_next(prepared, frame, QUICK)) == tables(pack(frame, QUICK))


def test_what_a_frame_has_no_use_for_is_freed_before_it_is_built(monkeypatch):
    prepared, scene, gone = Prepared(), room(), []
    first = weakref.ref(pack_next(prepared, scene, QUICK).accel)
    monkeypatch.setattr(again, "pack", lambda *arguments: gone.append(first() is None) or pack(*arguments))
    pack_next(prepared, moved_camera(scene, 0.1), QUICK)
    assert first() is not None and not gone
    pack_next(prepared, with_moved_object(scene), QUICK)
    assert gone == [True]


def test_an_undisturbed_picture_is_that_of_a_final_render(watcher):
    scene = room()
    scene.region = (2, 3, 20, 24)
    picture = watcher.show(scene)
    assert np.array_equal(picture.pixels, render(scene, QUICK).pixels)
    assert picture.region == scene.region and picture.size == (24, 24)
    assert watcher.pictures[0].samples == 0  # a coarse one came first
    sizes = [p.pixels.size for p in watcher.pictures]
    assert sizes == sorted(sizes)


@pytest.mark.parametrize("edit", EDITS)
def test_an_edited_picture_is_that_of_a_final_render(watcher, edit):
    scene = room()
    watcher.show(scene)
    changed = EDITS[edit][0](scene)
    assert np.array_equal(watcher.show(changed).pixels, render(changed, QUICK).pixels)


def test_a_camera_move_neither_packs_nor_builds(watcher, monkeypatch):
    scene = room()
    watcher.show(scene)

    def never(*_):
        raise AssertionError("packed again")

    for place in ("engine.pack.again.pack", "engine.pack.again.pack_lights", "engine.pack.Accel"):
        monkeypatch.setattr(place, never)
    checked: list = []
    monkeypatch.setattr("engine.validate._check_mesh", lambda mesh: checked.append(mesh))
    watcher.show(moved_camera(scene, 0.01))
    assert not checked


def test_more_samples_go_on_where_the_picture_was(watcher):
    scene = room()
    watcher.show(scene)
    seen = len(watcher.pictures)
    more = replace(QUICK, samples=16)
    assert np.array_equal(watcher.show(scene, more).pixels, render(scene, more).pixels)
    assert all(picture.samples > 4 for picture in watcher.pictures[seen:])


def test_it_may_be_closed_by_what_it_tells(monkeypatch) -> None:
    """Blender may drop a viewport while its thread asks for a redraw: its end then comes on that thread."""
    crashes: list = []
    monkeypatch.setattr(threading, "excepthook", crashes.append)
    closed: list[bool] = []
    interactive = Interactive(lambda: closed.append(interactive.close()))
    interactive.show(scenes.furnace(), QUICK)
    interactive._thread.join(PATIENCE)
    assert not interactive._thread.is_alive() and interactive.error is None
    assert closed and not any(closed) and crashes == []
    assert interactive.close()


def test_fewer_samples_than_there_are_end_at_once(watcher):
    scene = room()
    watcher.show(scene)
    watcher.interactive.show(scene, replace(QUICK, samples=2))
    watcher.wait_for(lambda: watcher.interactive.picture.total == 2)
    assert watcher.interactive.picture.samples == 4


def test_while_the_camera_moves_there_are_pictures_of_every_place(watcher):
    """Requests come faster than passes: each pass is finished all the same, and the last place is refined."""
    scene = room(128)
    watcher.show(scene)
    seen, requests = len(watcher.pictures), 0
    while len(watcher.pictures) < seen + 10:
        requests += 1
        watcher.interactive.show(moved_camera(scene, 1e-4 * requests), QUICK)
        time.sleep(0.001)
    last = moved_camera(scene, 0.1)
    assert np.array_equal(watcher.show(last).pixels, render(last, QUICK).pixels)


def test_a_long_pass_is_interrupted(watcher, monkeypatch):
    monkeypatch.setattr(live, "PASS_SECONDS", 1e9)
    scene = room(64)
    endless = replace(QUICK, samples=1 << 24)
    watcher.interactive.show(scene, endless)
    watcher.wait_for(lambda: watcher.interactive.picture is not None and watcher.interactive.picture.samples > 8)
    picture = watcher.show(moved_camera(scene, 0.1))
    assert np.array_equal(picture.pixels, render(moved_camera(scene, 0.1), QUICK).pixels)


def test_what_cannot_be_rendered_is_told_and_over_with_the_next_change(watcher):
    scene = room()
    watcher.show(scene)
    kept = watcher.interactive.picture
    with pytest.raises(SceneError, match="diffuse colour kd is negative"):
        watcher.show(with_material(scene, kd=(-1.0, 0.0, 0.0)))
    assert watcher.interactive.picture is kept
    watcher.show(moved_camera(scene, 0.1))
    assert watcher.interactive.error is None
    with pytest.raises(SceneError, match="no camera"):
        watcher.show(replace(scene, camera=None))


@pytest.mark.parametrize("place", ["pack_again", "Film", "render_tiles"])
def test_too_little_memory_is_told_as_by_a_render(watcher, monkeypatch, place):
    scene = room()
    watcher.show(scene)

    def too_much(*_):
        raise MemoryError

    monkeypatch.setattr(live, place, too_much)
    with pytest.raises(LobeError, match="not enough memory to render this scene: close other programs"):
        watcher.show(with_material(scene, kd=(0.5, 0.0, 0.0)))
    monkeypatch.undo()
    changed = with_material(scene, kd=(0.0, 0.5, 0.0))
    assert np.array_equal(watcher.show(changed).pixels, render(changed, QUICK).pixels)


def test_parts_that_were_checked_are_not_checked_again_but_others_are(watcher):
    scene = room()
    watcher.show(scene)
    bad = with_moved_object(scene)
    bad.instances.transforms[-1, 0, 3] = np.nan
    with pytest.raises(SceneError, match="its transform holds values that are not finite"):
        watcher.show(bad)
    with pytest.raises(SceneError, match="material number"):
        watcher.show(replace(scene, materials=[Material("only")]))
    with pytest.raises(SceneError, match="the world"):
        watcher.show(replace(scene, world=World(color=(np.nan, 0.0, 0.0))))


def test_a_pause_goes_on_where_it_was(watcher):
    scene, settings = room(), replace(QUICK, samples=1 << 11)
    watcher.interactive.show(scene, settings)
    watcher.wait_for(lambda: watcher.pictures and watcher.pictures[-1].samples > 0)
    watcher.interactive.pause()
    while (seen := len(watcher.pictures)) != (time.sleep(1.0) or len(watcher.pictures)):
        pass  # the pass that was under way
    before = watcher.pictures[-1].samples
    assert 0 < before < settings.samples and watcher.interactive.waiting
    watcher.interactive.resume()
    assert not watcher.interactive.waiting
    watcher.wait_for(lambda: watcher.pictures[-1].samples == settings.samples)
    assert watcher.pictures[seen].samples > before
    assert np.array_equal(watcher.pictures[-1].pixels, render(scene, settings).pixels)


@pytest.mark.parametrize(("at", "left"), [(1, True), (2, False)])
def test_a_pause_that_comes_in_the_last_pass_leaves_nothing_to_wait_for(at, left):
    """Pictures have 1, 2 and 4 samples."""
    seen, paused = [], threading.Event()

    def changed() -> None:
        if paused.is_set():
            seen.append(interactive.waiting)
        elif interactive.picture is not None and interactive.picture.samples == at:
            paused.set()
            interactive.pause()

    interactive = Interactive(changed)
    try:
        interactive.show(room(), QUICK)
        assert paused.wait(PATIENCE)
        deadline = time.perf_counter() + PATIENCE
        while not seen:
            assert time.perf_counter() < deadline
            time.sleep(0.01)
        assert seen == [left] and interactive.waiting == left
    finally:
        assert interactive.close(PATIENCE)


def test_what_is_shown_in_a_pause_is_rendered_after_it(watcher):
    scene = room()
    watcher.show(scene)
    watcher.interactive.pause()
    assert not watcher.interactive.waiting
    seen, moved = len(watcher.pictures), moved_camera(scene, 0.1)
    watcher.interactive.show(moved, QUICK)
    time.sleep(0.5)
    assert len(watcher.pictures) == seen and watcher.interactive.waiting
    watcher.interactive.resume()
    watcher.wait_for(lambda: len(watcher.pictures) > seen and watcher.pictures[-1].samples == QUICK.samples)
    assert np.array_equal(watcher.pictures[-1].pixels, render(moved, QUICK).pixels)


def test_close_ends_the_threads():
    before = set(threading.enumerate())
    watcher = Watcher()
    watcher.interactive.show(room(256), replace(QUICK, samples=1 << 20))
    watcher.wait_for(lambda: watcher.pictures or watcher.interactive.error)
    assert set(threading.enumerate()) - before
    assert watcher.interactive.close(PATIENCE)
    assert not set(threading.enumerate()) - before
    watcher.interactive.show(room(), QUICK)  # too late, and harmless
    assert watcher.interactive.close()


@pytest.mark.parametrize("pixels", [1, 100, 10_000, 2_000_000, 8_300_000])
@pytest.mark.parametrize("sample_seconds", [1e-8, 1e-7, 1e-6, 1e-5])
def test_the_first_pass_is_as_fine_as_its_time_allows(pixels, sample_seconds):
    coarse = live.coarseness(pixels, sample_seconds)
    assert 1 <= coarse <= live.COARSEST
    assert coarse == live.COARSEST or pixels / coarse**2 * sample_seconds <= live.FIRST_SECONDS
    assert coarse == 1 or pixels / (coarse - 1) ** 2 * sample_seconds > live.FIRST_SECONDS


def test_a_coarse_camera_sees_the_same_picture():
    camera = room().camera
    coarse, fine = live.coarser(pack_camera(camera, 64, 48), 4), pack_camera(camera, 16, 12)
    assert coarse == pytest.approx(fine, rel=1e-6)


def test_coarse_pixels_cover_the_region():
    """Of a picture whose sides four doesn't divide: the lower left corners agree."""
    region = (5, 3, 30, 17)
    x0, y0, x1, y1 = live._divided(region, 4)
    assert (x0, y0, x1, y1) == (1, 0, 8, 5)
    assert x0 * 4 <= region[0] and y0 * 4 <= region[1] and x1 * 4 >= region[2] and y1 * 4 >= region[3]


def test_how_soon_and_how_often_there_are_pictures(watcher, figure):
    """Figures for the reader, on a scene of 100,000 triangles; what a busy machine makes of them proves nothing."""
    scene = scenes.lamp_room(["area"])
    scene.add_instance(scenes.sphere_mesh(158, 0.5, smooth=True, name="fine"), scenes.place((0.5, -0.6, 0.5)))
    scene.width, scene.height = 1280, 720
    triangles = sum(len(mesh.triangles) for mesh in scene.meshes)
    assert triangles > 100_000
    watcher.show(scene)
    delays = []
    for number in range(20):
        seen, begun = len(watcher.pictures), time.perf_counter()
        watcher.interactive.show(moved_camera(scene, 1e-3 * number), replace(QUICK, samples=64))
        watcher.wait_for(lambda seen=seen: len(watcher.pictures) > seen)
        delays.append(time.perf_counter() - begun)
        time.sleep(0.1)
    seen, begun, moves = len(watcher.pictures), time.perf_counter(), 0
    while time.perf_counter() - begun < 2.0:
        moves += 1
        watcher.interactive.show(moved_camera(scene, 1e-4 * moves), QUICK)
        time.sleep(1 / 60)
    rate = (len(watcher.pictures) - seen) / 2.0
    assert len(watcher.pictures) > seen
    figure(
        f"interactive: {triangles:,} triangles, {scene.width} x {scene.height} pixels: first picture of a camera move "
        f"after {1e3 * np.median(delays):.0f} ms (longest {1e3 * max(delays):.0f}), {rate:.0f} pictures a second while "
        f"it moves, load {os.getloadavg()[0]:.1f}"
    )


def resident_bytes() -> int:
    return int(STATM.read_text().split()[1]) * mmap.PAGESIZE


@pytest.mark.skipif(not STATM.exists(), reason="reads Linux's own numbers")
def test_a_thousand_edits_leave_no_memory_behind(watcher, figure):
    """Of all kinds in turn. A mesh of 8,000 triangles and its tables take a megabyte: if each edit kept one, a
    gigabyte would stay."""
    scene = room(16)
    scene.add_instance(scenes.sphere_mesh(64, 0.2, name="fine"))
    settings = replace(QUICK, samples=1)
    rounds = [change for change, _, _ in EDITS.values()]

    def edit(count: int) -> int:
        for number in range(count):
            watcher.show(rounds[number % len(rounds)](scene), settings)
            watcher.pictures.clear()
        gc.collect()
        return resident_bytes()

    before = edit(200)
    grown = edit(1000) - before
    figure(f"interactive: {grown / 1e6:+.1f} MB over 1,000 edits")
    assert grown < 10e6
