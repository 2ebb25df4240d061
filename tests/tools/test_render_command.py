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
PHASES = {"export", "build", "compile", "render", "total"}


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


def test_not_a_blend(repository, tmp_path):
    path = tmp_path / "junk.blend"
    path.write_text("no scene here")
    fails(command(repository, path, "-o", tmp_path / "a.png"), f"render.py: {str(path)!r} cannot be opened: ")


def test_a_folder_that_cannot_be_made_or_written(repository, tmp_path):
    """Said before anything renders."""
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder.png").mkdir()
    for name in ("file/a.png", "folder.png"):
        path = tmp_path / name
        done = command(repository, "sample_blends/cornell_diffuse.blend", "-o", path)
        fails(done, f"render.py: {str(path)!r} cannot be written: ")


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
        done = command(repository, tmp_path / "empty.blend", "--engine", engine, "-o", tmp_path / "a.png")
        fails(done, "render.py: the render failed: ")
        assert "camera" in done.stderr.lower()


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
    assert report["seconds"]["total"] > 0 and report["seconds"]["render"] is not None
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
