"""tools/render.py's options: what is refused, with which words. Nothing renders here."""

from __future__ import annotations

import io

import pytest
from tqdm import tqdm

from tests import little_memory
from tools import blender_render as br
from tools import render
from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

import bpy  # noqa: E402


@pytest.fixture
def scene():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--resolution", "640"], "'640' is not of the form WIDTHxHEIGHT, such as 640x480"),
        (["--resolution", "0x480"], "'0x480': Blender renders pictures of 4 to 65536 pixels a side"),
        (["--resolution", "axb"], "'axb' is not of the form WIDTHxHEIGHT, such as 640x480"),
        (["--samples", "0"], "0 does not lie between 1 and 16777216"),
        (["--samples", "many"], "'many' is not a whole number"),
        (["--threads", "-1"], "-1 does not lie between 0 and 1024"),
        (["--engine", "EEVEE"], "invalid choice: 'EEVEE' (choose from 'LOBE', 'CYCLES')"),
        (["--frame", "one"], "'one' is not a whole number"),
        (["--frame", "2000000"], "2000000 does not lie between -1048574 and 1048574"),
        (["-o", "picture.jpg"], "'picture.jpg': the name of a picture ends in .png or .exr"),
    ],
)
def test_refused_arguments(arguments, message, capsys):
    with pytest.raises(SystemExit) as stopped:
        render.parse(["scene.blend", "-o", "a.png", *arguments])
    assert stopped.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("render.py: argument ") and message in line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "the following arguments are required: -o/--output"),
        (["--check", "-o", "a.png"], "--check renders nothing: it goes without -o"),
        (["--check", "--engine", "CYCLES"], "--check says what Lobe does not draw"),
    ],
)
def test_check_or_render(arguments, message, capsys):
    with pytest.raises(SystemExit) as stopped:
        render.parse(["scene.blend", *arguments])
    assert stopped.value.code == 2
    assert message in capsys.readouterr().err
    assert render.parse(["scene.blend", "--check"]).output == []


def test_a_picture_that_is_named_twice_is_written_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = render.parse(["scene.blend", "-o", "a.exr", "-o", "a.png", "-o", str(tmp_path / "a.exr")])
    assert [path.name for path in options.output] == ["a.exr", "a.png"]


def test_more_pixels_than_there_is_memory_for_are_refused(scene, monkeypatch):
    from bl_ext.user_default.lobe.engine import memory

    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    br.set_resolution(scene, 65536, 65536)
    little_memory.leave(monkeypatch, memory, 1e9)
    with pytest.raises(br.ToolError) as error:
        br.check_renderable(scene)
    assert "for 65536 x 65536 pixels, and 1.0 GB can be had" in str(error.value)
    scene.render.use_border, scene.render.border_max_x, scene.render.border_max_y = True, 0.01, 0.01
    br.check_renderable(scene)


def test_the_time_left_is_reckoned_from_the_first_samples_on():
    """Not from the compilation before them."""
    bar = tqdm(total=1, file=io.StringIO())
    bar.start_t -= 1e6
    bar.last_print_t -= 1e6
    render.show(bar, 4, 64)
    assert bar.format_dict["elapsed"] < 1e5
    assert (bar.n, bar.initial, bar.total) == (4, 4, 64)  # those four took no time that is known
    render.show(bar, 8, 64)
    assert (bar.n, bar.initial) == (8, 4)


def test_accepted_arguments():
    words = "a.blend --engine CYCLES --samples 4 --seed -3 --resolution 64x32 --frame 7 --threads 2 --as-is"
    settings = "--set scene.lobe.max_bounces=3 --set scene.lobe.road=REFERENCE -o a.png -o b.EXR"
    options = render.parse([*words.split(), *settings.split()])
    assert options.resolution == (64, 32) and options.seed == -3 and options.as_is
    assert options.assignments == ["scene.lobe.max_bounces=3", "scene.lobe.road=REFERENCE"]
    assert [path.name for path in options.output] == ["a.png", "b.EXR"]


@pytest.mark.parametrize("name", ["lobe", "Cycles", "CYCLES"])
def test_the_engines_name_in_any_case(name):
    assert render.parse(["a.blend", "-o", "a.png", "--engine", name]).engine == name.upper()


@pytest.mark.parametrize(
    ("assignment", "path", "value"),
    [
        ("scene.lobe.max_bounces=3", "lobe.max_bounces", 3),
        ("scene.lobe.clamp_direct = 2.5", "lobe.clamp_direct", 2.5),
        ("scene.lobe.use_adaptive_sampling=true", "lobe.use_adaptive_sampling", True),
        ("scene.lobe.pixel_filter=BOX", "lobe.pixel_filter", "BOX"),
        ("scene.view_settings.exposure=-1", "view_settings.exposure", -1.0),
        ("scene.render.film_transparent=1", "render.film_transparent", True),
    ],
)
def test_set(scene, assignment, path, value):
    br.set_value(scene, assignment)
    owner, key = path.split(".")
    assert getattr(getattr(scene, owner), key) == value


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("samples=3", "expected scene.lobe.KEY=VALUE"),
        ("scene.lobe.samples", "expected scene.lobe.KEY=VALUE"),
        ("scene.lob.samples=3", "the scene has nothing called 'lob'"),
        ("scene.lobe.sample=3", "there is no setting 'sample': there are adaptive_threshold, clamp_direct"),
        ("scene.lobe.samples=0", "0 does not lie between 1 and"),
        ("scene.lobe.samples=2.5", "'2.5' is not a whole number"),
        ("scene.lobe.samples=lots", "'lots' is not a value of type int"),
        ("scene.lobe.use_adaptive_sampling=2", "'2' is neither True nor False"),
        ("scene.lobe.road=FAST", "'FAST' is not one of COMPILED, REFERENCE"),
        ("scene.lobe.clamp_direct=-1", "-1 does not lie between 0 and"),
    ],
)
def test_refused_set(scene, assignment, message):
    with pytest.raises(br.ToolError) as error:
        br.set_value(scene, assignment)
    assert str(error.value).startswith(f"--set {assignment!r}: ") and message in str(error.value)


def test_unknown_scene(repository):
    with pytest.raises(br.ToolError, match="has no scene 'Plate': there are 'Plates', 'Plates, high exposure'"):
        br.open_blend(repository / "sample_blends" / "plates_phong.blend", "Plate")


def test_resolution_is_of_the_picture(scene):
    scene.render.resolution_percentage = 25
    br.set_resolution(scene, 64, 48)
    assert (scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage) == (64, 48, 100)
