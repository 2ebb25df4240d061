"""tools/render.py as a command: standard output, standard error, exit code and the files it leaves."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

KEYS = {"engine", "samples", "seconds", "rays", "peak_memory_mb", "skipped", "warnings"}
PHASES = {"export", "build", "compile", "render", "denoise", "other", "total"}
NO_CAMERA = "the scene has no camera: add one, or make one the active camera"


def command(repository: Path, *arguments: str | Path) -> subprocess.CompletedProcess:
    words = [sys.executable, "tools/render.py", *map(str, arguments)]
    return subprocess.run(words, cwd=repository, capture_output=True, text=True)


def fails(done: subprocess.CompletedProcess, message: str) -> None:
    assert done.returncode == 2
    assert done.stdout == ""
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert sum(line.startswith("render.py: ") for line in done.stderr.splitlines()) == 1


def test_missing_file(repository, tmp_path):
    done = command(repository, "no.blend", "-o", tmp_path / "a.png")
    fails(done, "render.py: 'no.blend' does not exist: expected a .blend file")


def test_a_folder_in_place_of_the_file(repository, tmp_path):
    done = command(repository, tmp_path, "-o", tmp_path / "a.png")
    fails(done, f"render.py: {str(tmp_path)!r} is a folder: expected a .blend file")


def test_options_that_contradict_each_other(repository, tmp_path):
    words = ("sample_blends/cornell_diffuse.blend", "-o", tmp_path / "a.png")
    fails(command(repository, *words, "--as-is"), "it needs --engine CYCLES")
    fails(command(repository, *words, "--set", "scene.render.engine=CYCLES"), "choose the engine with --engine LOBE")


def test_check(repository, tmp_path):
    """Prints and does nothing else."""
    before = {path.name for path in tmp_path.iterdir()}
    scene = "sample_blends/cornell_diffuse.blend"
    done = command(repository, scene, "--check")
    assert (done.returncode, done.stdout) == (0, "Nothing: Lobe draws all of this scene as asked.\n")
    done = command(repository, scene, "--check", "--set", "scene.render.use_motion_blur=1")
    assert done.returncode == 1
    head, *lines = done.stdout.splitlines()
    assert head == "Scene report of cornell_diffuse.blend:"
    assert lines == ["Not drawn as asked:", "      -  scene       motion blur is not supported and left out"]
    fails(command(repository, scene, "--check", "--scene", "Nowhere"), "the file has no scene 'Nowhere'")
    assert {path.name for path in tmp_path.iterdir()} == before


def test_check_of_what_is_drawn_nearly_as_asked(repository, tmp_path):
    """Blender's own first scene: its Principled BSDF is named in nearly every file."""
    path = tmp_path / "a.blend"
    script = (
        "import bpy; bpy.ops.wm.read_homefile(use_factory_startup=True); "
        f"bpy.ops.wm.save_as_mainfile(filepath={str(path)!r})"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    done = command(repository, path, "--check")
    assert done.stdout.splitlines()[:2] == ["Scene report of a.blend:", "Drawn nearly as asked:"]
    assert done.returncode == 0


def test_not_a_blend(repository, tmp_path):
    path = tmp_path / "junk.blend"
    path.write_text("no scene here")
    fails(command(repository, path, "-o", tmp_path / "a.png"), f"render.py: {str(path)!r} cannot be opened: ")


def test_a_folder_that_cannot_be_made_or_written(repository, tmp_path):
    """Said before anything renders."""
    file = tmp_path / "file"
    file.write_text("in the way")
    (tmp_path / "folder.png").mkdir()
    for name, why in (
        ("file/a.png", f"{str(file)!r} is not a folder"),
        ("file/new/a.png", f"{str(file)!r} is not a folder"),
        ("folder.png", "it is a folder"),
    ):
        path = tmp_path / name
        done = command(repository, "sample_blends/cornell_diffuse.blend", "-o", path)
        fails(done, f"render.py: {str(path)!r} cannot be written: {why}")


def test_a_wrong_setting(repository, tmp_path):
    done = command(repository, "sample_blends/cornell_diffuse.blend", "--set", "scene.lobe.sample=3", "-o",
                   tmp_path / "a.png")  # fmt: skip
    fails(done, "render.py: --set 'scene.lobe.sample=3': there is no setting 'sample': there are adaptive_threshold")


def test_a_picture_without_a_folder(repository, tmp_path):
    """Blender takes a bare name for a file without a place."""
    scene = repository / "sample_blends/cornell_diffuse.blend"
    words = [sys.executable, repository / "tools/render.py", scene, "--samples", "1", "--resolution", "8x8"]
    done = subprocess.run([*words, "-o", "bare.png", "-o", "bare.exr"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "bare.png").stat().st_size
    assert (tmp_path / "bare.exr").stat().st_size


def test_no_camera(repository, tmp_path):
    script = (
        "import bpy; bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True); "
        f"bpy.ops.wm.save_as_mainfile(filepath={str(tmp_path / 'empty.blend')!r})"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    for engine in ("LOBE", "CYCLES"):
        done = command(repository, tmp_path / "empty.blend", "--engine", engine, "-o", tmp_path / "new" / "a.png")
        fails(done, f"render.py: {NO_CAMERA}")
    done = command(repository, tmp_path / "empty.blend", "--check")
    assert done.returncode == 1 and NO_CAMERA in done.stdout
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("engine", ["LOBE", "CYCLES"])
def test_pictures_and_report(repository, tmp_path, engine):
    png, exr = tmp_path / "new" / "a.png", tmp_path / "new" / "a.exr"
    done = command(repository, "sample_blends/cornell_diffuse.blend", "--engine", engine, "--samples", 4, "--seed", 3,
                   "--resolution", "24x24", "--frame", 2, "--threads", 1, "--set", "scene.lobe.max_bounces=2",
                   "--set", "scene.render.film_transparent=True", "-o", png, "-o", exr)  # fmt: skip
    assert done.returncode == 0, done.stderr
    *lines, last = done.stdout.splitlines()
    assert lines == [f"Wrote {png}", f"Wrote {exr}"]
    assert done.stderr.splitlines().count(f"Made the folder {png.parent}") == 1
    report = json.loads(last)
    assert set(report) == KEYS and set(report["seconds"]) == PHASES
    assert report["engine"] == engine and report["samples"] == 4 and report["peak_memory_mb"] > 100
    seconds = report["seconds"]
    assert seconds["total"] > 0 and seconds["render"] is not None
    named = sum(value or 0.0 for phase, value in seconds.items() if phase != "total")
    assert named == pytest.approx(seconds["total"], abs=0.02)  # Cycles tells hundredths
    assert "4/4" in done.stderr  # the progress bar

    buffer = oiio.ImageBuf(str(exr))
    spec = buffer.spec()
    assert (spec.width, spec.height, spec.format, list(spec.channelnames)) == (24, 24, "float", ["R", "G", "B", "A"])
    assert spec.get_string_attribute("lobe:engine") == engine and spec.get_float_attribute("lobe:samples") == 4
    pixels = buffer.get_pixels(oiio.FLOAT)
    assert np.isfinite(pixels).all() and 5 < pixels[..., 0].max() < 20  # the lamp, not clipped
    assert pixels[..., 3].min() < 1 and pixels[..., 3].max() == 1  # the box does not fill the picture
    assert pixels[:8, :, 0].max() > 5 * pixels[8:, :, 0].max()  # row 0 is the top: the lamp is up there
    assert oiio.ImageBuf(str(png)).spec().nchannels == 4
    for path in (png, exr):  # the file's name and nothing of where it lies
        told = {a.name: str(a.value) for a in oiio.ImageBuf(str(path)).spec().extra_attribs}
        assert "cornell_diffuse.blend" in told.values()
        assert not [value for value in told.values() if str(repository) in value]


def test_as_is_keeps_the_files_cycles_settings(repository, tmp_path):
    """Seen from outside: the file's 3 samples, where Lobe's settings hold 64."""
    path = tmp_path / "a.blend"
    script = (
        f"import bpy; bpy.ops.wm.open_mainfile(filepath={str(repository / 'sample_blends/cornell_diffuse.blend')!r}); "
        f"bpy.context.scene.cycles.samples = 3; bpy.ops.wm.save_as_mainfile(filepath={str(path)!r})"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    done = command(repository, path, "--engine", "CYCLES", "--as-is", "--resolution", "8x8", "-o", tmp_path / "a.png")
    assert json.loads(done.stdout.splitlines()[-1])["samples"] == 3
    assert "Made the folder" not in done.stderr


def test_an_exr_has_the_passes_that_are_ticked(repository, tmp_path):
    path, exr = tmp_path / "a.blend", tmp_path / "a.exr"
    script = (
        f"import bpy; bpy.ops.wm.open_mainfile(filepath={str(repository / 'sample_blends/cornell_diffuse.blend')!r}); "
        "layer = bpy.context.scene.view_layers[0]; layer.use_pass_z = layer.use_pass_normal = True; "
        f"bpy.ops.wm.save_as_mainfile(filepath={str(path)!r})"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    done = command(repository, path, "--samples", 2, "--resolution", "8x6", "-o", exr)
    assert done.returncode == 0, done.stderr
    buffer = oiio.ImageBuf(str(exr))
    names, pixels = list(buffer.spec().channelnames), buffer.get_pixels(oiio.FLOAT)
    assert names[:4] == ["R", "G", "B", "A"] and (buffer.spec().width, buffer.spec().height) == (8, 6)
    channels = {name.partition(".")[2]: pixels[..., i] for i, name in enumerate(names[4:], 4)}
    combined = [f"Combined.{channel}" for channel in "RGBA"]
    assert set(channels) == {*combined, "Depth.Z", "Normal.X", "Normal.Y", "Normal.Z"}
    assert np.array_equal(np.dstack([channels[name] for name in combined]), pixels[..., :4])
    assert 1 < np.median(channels["Depth.Z"]) < 100
    normals = np.dstack([channels[f"Normal.{axis}"] for axis in "XYZ"])
    assert np.linalg.norm(normals[3, 4]) == pytest.approx(1.0, abs=0.1)
