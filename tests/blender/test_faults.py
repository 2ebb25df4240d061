"""What goes wrong inside of Lobe, or is cancelled there, in any phase: Blender goes on, the next render is whole."""

from __future__ import annotations

import gc
import importlib
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import addon_utils
import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe.addon.export import instances, kept, lights
from bl_ext.user_default.lobe.addon.export import scene as export
from bl_ext.user_default.lobe.addon.export.materials import material as materials

from tests import little_memory
from tests.blender.export_checks import add_object, new_material, plane_mesh
from tools.lobe_blender import MODULE, install

PHASES = ("export", "build", "compile", "render")


@pytest.fixture
def session():
    return importlib.import_module(f"{MODULE}.addon.session")


@pytest.fixture
def report():
    return importlib.import_module(f"{MODULE}.addon.report").last_report


@pytest.fixture
def scene(simple_scene) -> bpy.types.Scene:
    """The white world of `simple_scene`, and a table with a material under a lamp."""
    data = plane_mesh(5, "Plane")
    data.materials.append(new_material("Wood", "ShaderNodeBsdfDiffuse")[0])
    add_object("Table", data, (0, 10, -1))
    add_object("Lamp", bpy.data.lights.new("Lamp", "POINT"), (0, 8, 3)).data.energy = 100
    return simple_scene


def refused() -> str:
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.render.render()
    return str(caught.value).strip()


def on_purpose(*_arguments, **_options):
    raise ZeroDivisionError("on purpose")


def too_much(*_arguments, **_options):
    raise MemoryError


# --- Escape -----------------------------------------------------------------------------------------------------


@pytest.fixture
def escape(monkeypatch, session):
    """A function: Escape is pressed as soon as a phase is under way."""
    reached = threading.Event()
    pack, loading, schedule = (
        importlib.import_module(f"{MODULE}.engine.{name}") for name in ("pack", "loading", "schedule")
    )
    places = {
        "export": (instances, "export_mesh"), "build": (pack, "pack_lights"), "compile": (loading, "load_kernel"),
        "render": (schedule, "render_tiles"),
    }  # fmt: skip

    def arm(phase: str) -> None:
        module, name = places[phase]
        function = getattr(module, name)

        def noted(*arguments, **options):
            if phase != "render":  # in the midst of it
                reached.set()
                time.sleep(0.5)
            result = function(*arguments, **options)
            reached.set()
            return result

        monkeypatch.setattr(module, name, noted)
        monkeypatch.setattr(session.Session, "cancelled", lambda self: reached.is_set())

    return arm


def threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.lower().startswith("lobe")]


def assert_threads_end() -> None:
    deadline = time.perf_counter() + 10.0
    while threads() and time.perf_counter() < deadline:
        time.sleep(0.05)
    assert threads() == []


@pytest.mark.parametrize("persistent", [False, True])
@pytest.mark.parametrize("phase", PHASES)
def test_escape_in_any_phase(scene, rendered, report, escape, monkeypatch, capfd, phase: str, persistent) -> None:
    """Soon over, without an error; what was rendered is shown; the next render is as if nothing had been."""
    whole = rendered(scene)
    scene.render.use_persistent_data = persistent
    escape(phase)
    scene.lobe.samples = 1 << 20
    begun = time.perf_counter()
    if phase == "render":
        pixels = rendered(scene)
        assert 0 < report["samples"] < 1 << 20
        assert pixels[..., :3].min() > 0
    else:  # Blender writes no file of a render that Escape has ended, and crashes where it is made to write none
        bpy.ops.render.render()
    assert time.perf_counter() - begun < 5.0
    assert report["stopped"]
    monkeypatch.undo()
    scene.lobe.samples = 4
    assert np.array_equal(rendered(scene), whole)
    assert not report["stopped"]
    assert "Traceback" not in capfd.readouterr().err
    assert_threads_end()


@pytest.mark.parametrize("persistent", [False, True])
def test_escape_waits_for_a_picture_that_takes_long_to_make(
    scene, rendered, report, session, escape, monkeypatch, persistent: bool
) -> None:
    """As a large one does, and passes."""
    film, shown = importlib.import_module(f"{MODULE}.engine.film").Film, []
    whole, fill = film.pass_pictures, session._Picture.fill

    def slow(self):
        time.sleep(4 * session.PATIENCE)
        return whole(self)

    def noted(self, passes, *more):
        shown.append(passes)
        fill(self, passes, *more)

    monkeypatch.setattr(film, "pass_pictures", slow)
    monkeypatch.setattr(session._Picture, "fill", noted)
    scene.render.use_persistent_data = persistent
    scene.view_layers[0].use_pass_normal = scene.view_layers[0].use_pass_z = True
    scene.lobe.samples = 1 << 20
    escape("render")
    pixels = rendered(scene)
    assert report["stopped"] and 0 < report["samples"] < 1 << 20
    assert pixels[..., :3].min() > 0
    assert set(shown[0]) == {"NORMAL", "DEPTH"}


def test_escape_in_a_large_film_keeps_it(scene, rendered, report, escape) -> None:
    scene.render.resolution_x, scene.render.resolution_y = 2560, 1440
    for box in ("z", "normal", "position", "uv", "diffuse_direct", "diffuse_color", "emit", "environment"):
        setattr(scene.view_layers[0], f"use_pass_{box}", True)
    scene.lobe.samples = 1 << 20
    escape("render")
    pixels = rendered(scene)
    assert report["stopped"] and pixels[..., :3].max() > 0


def test_escape_gives_up_a_build_that_takes_long(scene, report, session, monkeypatch) -> None:
    schedule = importlib.import_module(f"{MODULE}.engine.schedule")
    whole, begun, end = schedule.pack_next, threading.Event(), threading.Event()

    def endless(*arguments):
        begun.set()
        assert end.wait(60.0)
        return whole(*arguments)

    monkeypatch.setattr(schedule, "pack_next", endless)
    monkeypatch.setattr(session.Session, "cancelled", lambda self: begun.is_set())
    try:
        bpy.ops.render.render()
        assert threads() and report["stopped"] and report["samples"] == 0
    finally:
        end.set()
    assert_threads_end()


# --- defects and memory -----------------------------------------------------------------------------------------

EXPORTS = {
    "mesh": (instances, "export_mesh", "object 'Table'"),
    "object": (instances, "subdivides_adaptively", "object 'Table'"),
    "material": (materials, "export_material", "material 'Wood'"),
    "lamp": (lights, "lamp_kind", "light 'Lamp'"),
    "placed lamp": (lights, "export_light", "light 'Lamp'"),
    "world": (kept, "export_world", "world 'World'"),
    "camera": (export, "export_camera", "camera 'Camera'"),
}


@pytest.mark.parametrize("persistent", [False, True])
@pytest.mark.parametrize("what", EXPORTS)
def test_a_defect_in_an_export_names_what_it_happened_at(scene, rendered, what, persistent, monkeypatch, capfd) -> None:
    whole = rendered(scene)
    scene.render.use_persistent_data = persistent
    module, function, named = EXPORTS[what]
    monkeypatch.setattr(module, function, on_purpose)
    assert refused() == (
        f"Error: Lobe failed at {named} (ZeroDivisionError: on purpose). This is a bug: the console has the details"
    )
    assert "in on_purpose" in capfd.readouterr().err
    monkeypatch.undo()
    assert np.array_equal(rendered(scene), whole)


@pytest.mark.parametrize("phase", ["settings", "export", "render"])
def test_after_a_defect_no_report_is_of_the_render_before(scene, rendered, report, session, phase, monkeypatch) -> None:
    scene_report = importlib.import_module(f"{MODULE}.addon.scene_report")
    rendered(scene)
    assert report["samples"] and not scene_report.report_of(scene).of_level("ERROR")
    places = {"settings": (session, "export_settings"), "export": (instances, "export_mesh")}
    monkeypatch.setattr(*places.get(phase, (session, "fill_passes")), on_purpose)
    said = refused().removeprefix("Error: ")
    assert not report
    assert [group.what for group in scene_report.report_of(scene).of_level("ERROR")] == [said]
    monkeypatch.undo()
    rendered(scene)
    assert report["samples"] and not scene_report.report_of(scene).of_level("ERROR")


@pytest.mark.parametrize("what", EXPORTS)
def test_an_export_that_finds_no_memory_names_what_it_was_for(scene, what, monkeypatch, capfd) -> None:
    module, function, named = EXPORTS[what]
    monkeypatch.setattr(module, function, too_much)
    assert refused() == (
        f"Error: {named}: not enough memory to export it: use fewer faces, for instance with lower levels of "
        "subdivision, or smaller images"
    )
    assert "Traceback" not in capfd.readouterr().err


def test_too_little_memory_for_many_objects_is_no_bug(scene, monkeypatch, capfd) -> None:
    """Where no single datablock is at fault."""
    for name in ("matrices_at_once", "matrices_one_by_one"):
        monkeypatch.setattr(instances, name, too_much)
    said = refused()
    assert said == "Error: not enough memory: close other programs, or show fewer objects"
    notes = importlib.import_module(f"{MODULE}.addon.scene_report").report_of(scene).of_level("ERROR")
    assert [note.what for note in notes] == [said.removeprefix("Error: ")]
    assert "Traceback" not in capfd.readouterr().err


def test_too_little_memory_to_denoise_keeps_the_noisy_picture(scene, rendered, session, report, monkeypatch) -> None:
    whole = rendered(scene)
    scene.lobe.use_denoising = True
    monkeypatch.setattr(session, "denoise", too_much)
    assert np.array_equal(rendered(scene), whole)
    assert "the picture is not denoised: not enough memory" in report["warnings"]


@pytest.mark.parametrize("phase", PHASES[1:])
def test_a_defect_in_the_engine_leaves_the_next_render_whole(scene, rendered, phase, monkeypatch) -> None:
    whole = rendered(scene)
    scene.render.use_persistent_data = True
    places = {"build": "schedule.pack_next", "compile": "loading.load_kernel", "render": "schedule.render_tiles"}
    module, function = places[phase].split(".")
    monkeypatch.setattr(importlib.import_module(f"{MODULE}.engine.{module}"), function, on_purpose)
    assert refused().startswith("Error: Lobe failed (ZeroDivisionError: on purpose)")
    monkeypatch.undo()
    assert np.array_equal(rendered(scene), whole)


def test_memory_that_is_foreseen_to_be_short(scene, monkeypatch, rendered) -> None:
    whole = rendered(scene)
    memory = importlib.import_module(f"{MODULE}.engine.memory")
    little_memory.leave(monkeypatch, memory, 1000.0)
    said = refused()
    assert said.startswith("Error: not enough memory: rendering takes some 0.0 GB, ") and said.endswith(memory.ADVICE)
    notes = importlib.import_module(f"{MODULE}.addon.scene_report").report_of(scene).of_level("ERROR")
    assert [note.what for note in notes] == [said.removeprefix("Error: ")]
    monkeypatch.undo()
    assert np.array_equal(rendered(scene), whole)


# --- the add-on itself ------------------------------------------------------------------------------------------


def test_renders_between_enabling_and_disabling_leave_nothing_behind(scene) -> None:
    """Also of what Blender keeps for the next frame."""
    scene.render.use_persistent_data = True
    layers = importlib.import_module(f"{MODULE}.addon.export").KeptLayers
    before = {key: value for key, value in os.environ.items() if key != "LOBE_CACHE_DIR"}
    for _ in range(20):
        bpy.ops.render.render()
        addon_utils.disable(MODULE)
        assert not hasattr(scene, "lobe")
        addon_utils.enable(MODULE, default_set=True)
        scene.render.engine, scene.lobe.samples, scene.lobe.pixel_filter = "LOBE", 4, "BOX"
    addon_utils.disable(MODULE)
    gc.collect()
    try:
        assert not [
            thing for thing in gc.get_objects() if type(thing) is layers
        ]  # `isinstance` asks proxies of what is gone
        assert threads() == []
        assert {key: value for key, value in os.environ.items() if key != "LOBE_CACHE_DIR"} == before
    finally:
        addon_utils.enable(MODULE, default_set=True)


# Run in a Python of its own, with the folders that stand before it.
IN_A_PROCESS = f"""
import os, sys
sys.path.insert(0, {str(Path(__file__).resolve().parents[2])!r})
import tools.lobe_blender
from tools.lobe_blender import MODULE, enable_lobe
tools.lobe_blender.install = lambda: os.environ["BLENDER_USER_RESOURCES"]
enable_lobe()
import bpy
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
scene = bpy.context.scene
scene.render.engine, scene.lobe.samples = "LOBE", 1
scene.render.resolution_x = scene.render.resolution_y = 8
scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
scene.collection.objects.link(scene.camera)
bpy.ops.render.render()
print("CACHE", sys.modules[MODULE + ".engine.kernels.jit"].CACHE_FOLDER)
"""


def contents(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(path): (path.stat().st_size, path.stat().st_mtime_ns) for path in sorted(folder.rglob("*"))}


def test_an_addon_folder_that_is_read_only_and_a_cache_that_is_missing(tmp_path) -> None:
    """Nothing is written beside the code, and the cache's folder is made. Compiles: some ten seconds."""
    user = tmp_path / "user"
    addon = user / "extensions" / "user_default" / "lobe"
    shutil.copytree(install() / "extensions" / "user_default" / "lobe", addon, ignore=shutil.ignore_patterns("__py*"))
    folders = [addon, *(path for path in addon.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    before = contents(addon)
    environment = {key: value for key, value in os.environ.items() if key != "LOBE_CACHE_DIR"}
    environment |= {"BLENDER_USER_RESOURCES": str(user), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-c", IN_A_PROCESS], env=environment, capture_output=True, text=True, check=True
        )
        assert contents(addon) == before
    finally:
        for folder in folders:
            folder.chmod(0o755)
    assert "Error" not in done.stdout + done.stderr
    assert done.stdout.count("Warning") == 1  # that there is nothing to see but the world
    cache = Path(done.stdout.split("CACHE ")[1].strip())
    assert user in cache.parents and addon not in cache.parents
    assert any(path.suffix == ".nbc" for path in cache.rglob("*"))
