"""tools/compare.py as a command: standard output, standard error, exit code and the files it leaves."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import OpenImageIO as oiio

SCENE = "sample_blends/cornell_diffuse.blend"


def command(repository: Path, *arguments: str | Path) -> subprocess.CompletedProcess:
    words = [sys.executable, "tools/compare.py", *map(str, arguments)]
    return subprocess.run(words, cwd=repository, capture_output=True, text=True)


def fails(done: subprocess.CompletedProcess, message: str) -> None:
    assert done.returncode == 2 and done.stdout == ""
    assert message in done.stderr and "Traceback" not in done.stderr
    assert sum(line.startswith("compare.py: ") for line in done.stderr.splitlines()) == 1


def test_what_cannot_be_done_is_said_in_a_line(repository, tmp_path):
    fails(command(repository, "no.blend", "-o", tmp_path), "'no.blend' does not exist: expected a .blend file")
    fails(command(repository, SCENE), "the following arguments are required: -o/--output")
    fails(command(repository, SCENE, "-o", tmp_path, "--seconds", "soon"), "'soon' is not a number of seconds")
    fails(command(repository, SCENE, "-o", tmp_path, "--seconds", "nan"), "nan s does not lie between")
    fails(command(repository, SCENE, "-o", tmp_path, "--seconds", 2, "--samples", 2), "what is equal is one of the two")
    for setting, why in (("render.engine=CYCLES", "renders with both engines"), ("cycles.seed = 3", "follow --seed")):
        fails(command(repository, SCENE, "-o", tmp_path, "--set", f"scene.{setting}"), why)
    (tmp_path / "file").write_text("in the way")
    fails(command(repository, SCENE, "-o", tmp_path / "file" / "in"), "cannot be written: ")
    fails(command(repository, SCENE, "-o", tmp_path / "file"), f"{str(tmp_path / 'file')!r} is not a folder")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_comparison(repository, tmp_path):
    folder = tmp_path / "new"
    done = command(repository, SCENE, "-o", folder, "--samples", 16, "--resolution", "48x32", "--threads", 1,
                   "--set", "scene.render.film_transparent=1", "--set", "scene.cycles.film_transparent_glass=1",
                   "--set", "scene.render.use_motion_blur=1", "--set", "scene.cycles.blur_glossy=2")  # fmt: skip
    assert done.returncode == 0, done.stderr
    *lines, last = done.stdout.splitlines()
    told = json.loads(last)
    assert told == json.loads((folder / "comparison.json").read_text())
    assert told["samples"] == {"LOBE": 16.0, "CYCLES": 16.0} and told["size"] == [48, 32] and told["threads"] == "1"
    assert told["figures"]["noise_lobe"] > 0.0 and told["times"]["CYCLES"]["total"] > 0.0
    assert "Motion blur is left out" in told["unmatched"] and len(told["different"]) == 1
    assert "(1 reason" in lines[0] and lines[0].endswith("so no speed-up is said") and "Not matched:" in lines
    assert "  Cycles: Filter Glossy: 2 -> 0" in lines[lines.index("Changed for the comparison:") :]
    assert told["headline"] == lines[0] and told["figures"]["speedup"] is None
    assert not any(line.startswith("Speed-up") for line in lines)
    assert "4/4" in done.stderr and "Lobe, 1 of 2" in done.stderr and "Cycles, 2 of 2" in done.stderr
    assert f"Made the folder {folder}" in done.stderr.splitlines()
    names = {"comparison.html", "comparison.json", "lobe.png", "cycles.png", "difference.png", "flip.png"}
    assert {path.name for path in folder.iterdir()} == names
    assert {line for line in lines if line.startswith("Wrote ")} == {f"Wrote {folder / name}" for name in names}
    for name in ("lobe", "cycles", "difference", "flip"):
        spec = oiio.ImageBuf(str(folder / f"{name}.png")).spec()
        assert (spec.width, spec.height) == (48, 32)
    page = (folder / "comparison.html").read_text(encoding="utf-8")
    assert "http" not in page and str(repository) not in page and "Motion blur" in page


def test_equal_time(repository, tmp_path):
    done = command(repository, SCENE, "-o", tmp_path, "--seconds", "0.3", "--resolution", "16x16")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["seconds"] == 0.3 and told["samples"]["LOBE"] > 64
    assert ["Cycles: Time Limit", "0", "0.3"] in told["changed"]


def test_no_camera(repository, tmp_path):
    script = (
        "import bpy; bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True); "
        f"bpy.ops.wm.save_as_mainfile(filepath={str(tmp_path / 'empty.blend')!r})"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    done = command(repository, tmp_path / "empty.blend", "-o", tmp_path / "out")
    fails(done, "compare.py: the scene has no camera: add one, or make one the active camera")
    assert not (tmp_path / "out").exists()
