"""F12 from Blender's side: where pixels land, what is reported, and how a render is cancelled.

The tracing is replaced where the picture's content doesn't matter: these tests are about the road to and from it.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import threading
import time
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

import engine
from tests.blender.export_checks import add_object, new_material, plane_mesh
from tools import blender_render
from tools.lobe_blender import MODULE


@pytest.fixture
def session():
    """The add-on's session module, loaded as the first render would."""
    return importlib.import_module(f"{MODULE}.addon.session")


@pytest.fixture
def report():
    return importlib.import_module(f"{MODULE}.addon.report").last_report


def coordinates(scene) -> np.ndarray:
    """A picture whose red and green are the pixel's place in the whole picture."""
    x0, y0, x1, y1 = scene.render_region
    y, x = np.mgrid[y0:y1, x0:x1].astype(np.float32)
    return np.stack([x, y, np.zeros_like(x), np.ones_like(x)], axis=-1)


@pytest.fixture
def fake(session, monkeypatch):
    """Replaces the tracing by `coordinates`, in as many steps as there are samples."""
    calls = []

    def render(scene, settings, *, progress=None, stop=None, prepared=None):
        calls.append((scene, settings))
        done = 0
        while done < settings.samples and not stop():
            done += 1
            time.sleep(0.002)
            progress(engine.Progress(done, settings.samples, 0.0, 1.0, "rendering", lambda: coordinates(scene) * 0.5))
        return engine.Result(
            coordinates(scene),
            done,
            {"build": 0.0, "compile": 0.0, "render": 0.1},
            rays=1000,
            warnings=["material 'Glass': not supported"],
            stopped=done < settings.samples,
        )

    monkeypatch.setattr(session.lobe, "render", render)
    return calls


# --- pixels -----------------------------------------------------------------------------------------------------


def test_rows_and_columns(simple_scene, fake, rendered) -> None:
    pixels = rendered(simple_scene)
    assert pixels.shape == (24, 32, 4)
    y, x = np.mgrid[:24, :32]
    assert np.array_equal(pixels[..., 0], x)
    assert np.array_equal(pixels[..., 1], y)
    assert np.all(pixels[..., 3] == 1.0)


@pytest.mark.parametrize("crop", [False, True])
def test_border(simple_scene, fake, rendered, crop: bool) -> None:
    render = simple_scene.render
    render.use_border, render.use_crop_to_border = True, crop
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.63, 0.1, 0.5
    pixels = rendered(simple_scene)
    y, x = np.mgrid[2:12, 8:20]
    inside = pixels if crop else pixels[2:12, 8:20]
    assert pixels.shape == ((10, 12, 4) if crop else (24, 32, 4))
    assert np.array_equal(inside[..., 0], x)
    assert np.array_equal(inside[..., 1], y)
    if not crop:
        assert pixels[..., 3].sum() == 120


def test_resolution_percentage(simple_scene, fake, rendered) -> None:
    simple_scene.render.resolution_percentage = 50
    assert rendered(simple_scene).shape == (12, 16, 4)


def test_each_view_layer_gets_its_own_picture(simple_scene, fake, session, tmp_path, monkeypatch) -> None:
    import OpenImageIO as oiio

    scene = simple_scene
    scene.view_layers[0].name = "First"
    scene.view_layers.new("Second")
    original = session.lobe.render

    def render(*arguments, **options):
        result = original(*arguments, **options)
        result.pixels[..., 2] = len(fake)
        return result

    monkeypatch.setattr(session.lobe, "render", render)
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.filepath = str(tmp_path / "layers.exr")
    bpy.ops.render.render(write_still=True)
    found = {}
    image = oiio.ImageInput.open(scene.render.filepath)
    index = 0
    while image.seek_subimage(index, 0):
        channels = image.spec().channelnames
        pixels = image.read_image(index, 0, 0, len(channels), "float")
        found.update({name: pixels[0, 0, i] for i, name in enumerate(channels)})
        index += 1
    image.close()
    assert found["First.Combined.B"] == 1
    assert found["Second.Combined.B"] == 2


def test_the_picture_grows_while_it_renders(simple_scene, fake, session, monkeypatch) -> None:
    shown = []
    show = session._Picture.show
    monkeypatch.setattr(session, "show_progress", True)
    monkeypatch.setattr(session, "refresh_interval", lambda elapsed: 0.0)
    monkeypatch.setattr(session._Picture, "show", lambda self, pixels: (shown.append(pixels.max()), show(self, pixels)))
    simple_scene.lobe.samples = 300
    bpy.ops.render.render()
    assert len(shown) >= 3
    assert shown[0] == 15.5  # the growing picture's half of the last column
    assert shown[-1] == 31.0


def test_passes_of_another_size_are_refused_before_they_are_written(simple_scene, fake, session, monkeypatch) -> None:
    """The message is the same as for the picture, and nothing was copied for it."""
    original, written = session.lobe.render, []

    def render(*arguments, **options):
        result = original(*arguments, **options)
        result.passes = {"MIST": np.zeros((3, 5, 1), np.float32)}
        return result

    monkeypatch.setattr(session.lobe, "render", render)
    monkeypatch.setattr(session, "fill_passes", lambda *_: written.append(1))
    with pytest.raises(RuntimeError, match=r"the picture is \(3, 5\) pixels high and wide, Blender expects \(24, 32\)"):
        bpy.ops.render.render()
    assert not written


def test_persistent_data_renders_again(simple_scene, fake, rendered) -> None:
    simple_scene.render.use_persistent_data = True
    rendered(simple_scene)
    simple_scene.lobe.samples = 7
    assert rendered(simple_scene)[3, 5, :2].tolist() == [5.0, 3.0]
    assert [settings.samples for _, settings in fake] == [4, 7]


# --- report -----------------------------------------------------------------------------------------------------


def test_report(simple_scene, fake, report) -> None:
    bpy.ops.mesh.primitive_plane_add()
    simple_scene.view_layers.new("Second")
    bpy.ops.render.render()
    assert json.loads(json.dumps(report)) == report
    assert report["engine"] == "LOBE"
    assert report["samples"] == 4
    assert report["rays"] == 2000  # both view layers
    assert report["warnings"] == ["material 'Glass': not supported"]  # once
    assert set(report["seconds"]) == {"export", "build", "compile", "render", "total"}
    assert report["seconds"]["render"] == pytest.approx(0.2)
    assert report["peak_memory_mb"] > 10.0
    assert report["skipped"] == [] and report["rejected"] == 0 and not report["stopped"]


def test_a_warning_of_several_materials_is_told_once(simple_scene, fake, session, report, monkeypatch) -> None:
    """As in the scene report: for the command line too."""
    original = session.lobe.render

    def render(*arguments, **options):
        result = original(*arguments, **options)
        result.warnings = ["material 'Pane': not supported", "object 'Ink': left out", "material 'Jar': not supported"]
        return result

    monkeypatch.setattr(session.lobe, "render", render)
    bpy.ops.mesh.primitive_plane_add()
    told = blender_render.render(simple_scene)["warnings"]
    assert told == report["warnings"] == ["object 'Ink': left out", "material 'Pane', 'Jar': not supported"]


def test_rejected_samples_are_told_once(simple_scene, fake, session, report, monkeypatch, capfd) -> None:
    original = session.lobe.render
    sentence = "7 samples were not finite numbers and count as black"

    def render(*arguments, **options):
        result = original(*arguments, **options)
        result.rejected, result.warnings = 7, [sentence]  # as engine/schedule.py has it
        return result

    monkeypatch.setattr(session.lobe, "render", render)
    told = blender_render.render(simple_scene)["warnings"]
    assert [warning for warning in told if "not finite" in warning] == [sentence]
    lines = [line for line in capfd.readouterr().out.splitlines() if "finite" in line]
    assert lines == [
        f"Warning: Lobe: {sentence}",
        "Warning: Lobe: samples that are not finite come from a light or an emission too strong to calculate with. "
        "Where there is none, this is a bug in Lobe",
    ]


def test_what_is_true_of_many_is_told_in_one_line(simple_scene, capfd) -> None:
    for number in range(11):
        material, _ = new_material(f"Shiny {number}", "ShaderNodeBsdfPrincipled")
        add_object(f"Plate {number}", plane_mesh()).data.materials.append(material)
    bpy.ops.render.render()
    (line,) = [line for line in capfd.readouterr().out.splitlines() if "towards the edges" in line]
    assert line.startswith("Info: Lobe: material 'Shiny 0', 'Shiny 1', ") and "'Shiny 7' and 3 more: " in line


def test_metadata_in_the_file(simple_scene, fake, rendered, tmp_path) -> None:
    import OpenImageIO as oiio

    rendered(simple_scene)
    image = oiio.ImageInput.open(str(tmp_path / "render.exr"))
    spec = image.spec()
    image.close()
    assert spec.get_string_attribute("lobe.samples") == "4"
    assert spec.get_string_attribute("lobe.rays") == "1000"
    assert spec.get_string_attribute("lobe.road") == "compiled"


def test_the_last_line_tells_compiling_apart(session) -> None:
    """Loading a kernel is part of the render's time."""
    told = importlib.import_module(f"{MODULE}.addon.report")
    data = told.start_report(is_preview=True)
    data |= {"samples": 128.0, "rays": 20_000_000}
    data["seconds"] |= {"build": 1.0, "compile": 0.5, "render": 10.0, "total": 12.0}
    assert told.summary(data) == "Lobe: 128 samples in 12.00 s, 2.0 million rays per second"
    data["seconds"] |= {"compile": 77.6, "total": 89.1}
    expected = "Lobe: 128 samples in 11.50 s, 2.0 million rays per second (and 78 s of compiling, once)"
    assert told.summary(data) == expected


# --- progress ---------------------------------------------------------------------------------------------------

COMPILING = engine.Progress(0, 4, 9.0, None, "compiling: 3 of 4 functions, 1 s", lambda: None, (3, 4))


def test_a_compilation_moves_the_bar_and_the_text(session) -> None:
    told: list[tuple] = []
    names = "update_memory_stats", "update_progress", "update_stats"
    blender = SimpleNamespace(**{name: lambda *values, name=name, **_: told.append((name, *values)) for name in names})
    session.Session._say(SimpleNamespace(engine=blender, layer="ViewLayer"), COMPILING)
    assert told[1:] == [("update_progress", 0.75), ("update_stats", "", "Compiling: 3 of 4 functions, 1 s")]


def test_a_new_phase_is_told_at_once_and_a_step_in_its_turn(session) -> None:
    """Without a window each is a line on the console."""
    building = dataclasses.replace(COMPILING, message="building", steps=None)
    rendering = dataclasses.replace(building, message="rendering")
    assert session._is_news(building, None) and session._is_news(rendering, COMPILING)
    assert not session._is_news(rendering, rendering)
    assert not session._is_news(COMPILING, building) and not session._is_news(COMPILING, None)


# --- cancel -----------------------------------------------------------------------------------------------------


@pytest.fixture
def break_after(session, monkeypatch):
    """A function: as if Escape were pressed after so many seconds."""

    def arm(seconds: float) -> None:
        start = time.perf_counter()
        monkeypatch.setattr(session.Session, "cancelled", lambda self: time.perf_counter() - start > seconds)

    return arm


def test_cancel_keeps_what_was_rendered(simple_scene, fake, rendered, report, break_after) -> None:
    simple_scene.lobe.samples = 100000
    break_after(0.3)
    pixels = rendered(simple_scene)
    assert pixels[3, 5].tolist() == [5.0, 3.0, 0.0, 1.0]
    assert report["stopped"] and 0 < report["samples"] < 100000


def test_cancel_does_not_wait_for_a_compilation(simple_scene, session, break_after, monkeypatch) -> None:
    deaf, ended = threading.Event(), threading.Event()

    def render(scene, settings, *, progress=None, stop=None, prepared=None):
        progress(COMPILING)
        assert deaf.wait(60.0)  # as a compiler is
        assert stop()
        ended.set()
        return engine.Result(coordinates(scene), 0, stopped=True)

    monkeypatch.setattr(session.lobe, "render", render)
    break_after(0.1)
    bpy.ops.render.render()
    assert not ended.is_set()
    deaf.set()
    assert ended.wait(5.0)  # and it was told to stop


# --- bad input --------------------------------------------------------------------------------------------------


def message_of(render=lambda: bpy.ops.render.render()) -> str:
    """What a failing render says, which must not be a traceback."""
    with pytest.raises(RuntimeError) as caught:
        render()
    assert "Traceback" not in str(caught.value)
    return str(caught.value).strip()


def test_no_camera(simple_scene) -> None:
    simple_scene.camera = None
    assert message_of() == "Error: Cannot render, no camera"


def test_no_pixels(simple_scene) -> None:
    simple_scene.render.resolution_x = simple_scene.render.resolution_y = 4
    simple_scene.render.resolution_percentage = 1
    assert message_of() == "Error: Image too small"


def test_one_pixel(simple_scene, fake, rendered) -> None:
    simple_scene.render.resolution_x = simple_scene.render.resolution_y = 4
    simple_scene.render.resolution_percentage = 25
    assert rendered(simple_scene).shape == (1, 1, 4)


def test_an_error_of_the_scene_is_shown_as_it_stands(simple_scene, session, monkeypatch, capfd) -> None:
    lobe_error = session.lobe.SceneError

    def render(*arguments, **options):
        raise lobe_error("light 'Key': radius is negative (-1 m)")

    monkeypatch.setattr(session.lobe, "render", render)
    simple_scene.view_layers.new("Second")  # where it isn't said again
    assert message_of() == "Error: light 'Key': radius is negative (-1 m)"
    assert "Traceback" not in capfd.readouterr().err


def test_a_bug_is_named_and_traced(simple_scene, session, monkeypatch, capfd) -> None:
    def render(*arguments, **options):
        raise ZeroDivisionError("on purpose")

    monkeypatch.setattr(session.lobe, "render", render)
    text = "Lobe failed (ZeroDivisionError: on purpose). This is a bug: the console has the details"
    assert message_of() == f"Error: {text}"
    assert "ZeroDivisionError: on purpose" in capfd.readouterr().err


@pytest.mark.parametrize("is_preview", [True, False])
def test_an_icon_leaves_the_report_of_the_last_render_alone(report, session, is_preview: bool, monkeypatch) -> None:
    """As Blender calls an engine; the bpy module draws no icons."""
    engine_type = importlib.import_module(f"{MODULE}.addon.render_engine").LobeRenderEngine
    reports = []
    monkeypatch.setattr(session, "Session", lambda *_: SimpleNamespace(render=reports.append))
    engine_object = SimpleNamespace(frame_report=None, failed=False, is_preview=is_preview)
    report["samples"] = 7.0
    engine_type.update(engine_object, None, None)
    engine_type.render(engine_object, None)
    if is_preview:
        engine_type.render_frame_finish(engine_object)
    assert reports[0]["samples"] == 0.0
    assert report == ({"samples": 7.0} if is_preview else {})


def test_a_failed_frame_does_not_spoil_the_next(simple_scene, fake, session, rendered, monkeypatch) -> None:
    simple_scene.render.use_persistent_data = True  # then one engine object renders both
    good = session.lobe.render

    def bad(*arguments, **options):
        raise session.lobe.SceneError("on purpose")

    monkeypatch.setattr(session.lobe, "render", bad)
    message_of()
    monkeypatch.setattr(session.lobe, "render", good)
    assert rendered(simple_scene)[3, 5, :2].tolist() == [5.0, 3.0]


# --- with the real tracing --------------------------------------------------------------------------------------


def glowing_quarter() -> None:
    """A plane of radiance (1, 2, 3) that fills the upper right quarter of the picture, 10 m before the camera."""
    camera = bpy.context.scene.camera.data
    camera.type, camera.ortho_scale = "ORTHO", 32.0  # one pixel for each metre
    bpy.ops.mesh.primitive_plane_add(size=1, location=(8, 10, 6), rotation=(np.pi / 2, 0, 0))
    bpy.context.object.scale = (16, 12, 1)
    material = bpy.data.materials.new("Glow")
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    tree = material.node_tree
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (1 / 3, 2 / 3, 1, 1)
    emission.inputs["Strength"].default_value = 3.0
    tree.links.new(emission.outputs[0], tree.get_output_node("ALL").inputs["Surface"])
    bpy.context.object.data.materials.append(material)


@pytest.mark.parametrize("transparent", [False, True])
def test_a_picture_by_the_engine(simple_scene, rendered, report, transparent: bool) -> None:
    glowing_quarter()
    simple_scene.render.film_transparent = transparent
    pixels = rendered(simple_scene)
    assert np.allclose(pixels[12:, 16:], (1, 2, 3, 1), rtol=1e-5)
    background = (0, 0, 0, 0) if transparent else (1, 1, 1, 1)
    assert np.allclose(pixels[:12], background, rtol=1e-5)
    assert np.allclose(pixels[:, :16], background, rtol=1e-5)
    assert report["rays"] >= 32 * 24 * 4


def test_an_empty_scene_shows_the_world(simple_scene, rendered) -> None:
    assert np.allclose(rendered(simple_scene), 1.0)
