"""A user's first steps in a Blender with a window: install, choose Lobe, render, look around, read the panels.

Set LOBE_BLENDER_WINDOW to a command that opens Blender (4.2 or newer) in a window, where there are xdotool and
ImageMagick too; without, these tests are skipped. `make test-gui` runs them, and leaves the pictures in out/gui/.
"""

from __future__ import annotations

import json
import shutil
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.blender.real_blender import NO_WINDOW, WITH_WINDOW, cannot_look, read_bytes, runner, this_package

pytestmark = pytest.mark.skipif(not WITH_WINDOW, reason=NO_WINDOW)

LOOKED_AT = ("viewport", "freed", "orbited", "edited")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, repository) -> Path:
    """Where the script has left what it saw."""
    folder = tmp_path_factory.mktemp("gui")
    script, scene = folder / "gui_script.py", folder / "plates_phong.blend"
    shutil.copy(Path(__file__).with_name(script.name), script)
    shutil.copy(repository / "sample_blends" / scene.name, scene)
    package = this_package(tmp_path_factory.mktemp("package"))
    blender = runner(tmp_path_factory.mktemp("user"), WITH_WINDOW)
    said = blender("--window-geometry", 0, 0, 1280, 800, "--python", script, "--", package, scene)
    assert (folder / "seen.json").exists(), said
    seen = json.loads((folder / "seen.json").read_text())
    if seen["missing"]:
        cannot_look(f"where Blender runs there is no {' and no '.join(seen['missing'])}")
    kept = repository / "out" / "gui"
    shutil.rmtree(kept, ignore_errors=True)
    shutil.copytree(folder, kept, ignore=lambda _, names: [name for name in names if not name.endswith(".png")])
    assert "error" not in seen, seen["error"]
    assert "Traceback" not in said, said
    assert "property not found" not in said, f"a panel shows a property that isn't there:\n{said}"
    return folder


@pytest.fixture(scope="module")
def seen(folder) -> dict:
    return json.loads((folder / "seen.json").read_text())


def test_lobe_is_chosen(seen) -> None:
    assert "LOBE" in seen["engines"]
    assert seen["by script"] == "LOBE"
    assert seen["by mouse"] == "LOBE"


def test_f12_shows_the_picture(folder) -> None:
    """The saved picture is what the image editor shows, pixel by pixel, somewhere near its middle."""
    shown, saved = read_bytes(folder / "f12.png"), read_bytes(folder / "f12_saved.png")
    assert saved.std() > 20
    height, width = saved.shape[:2]
    middle = (shown.shape[0] - height) // 2, (shown.shape[1] - width) // 2
    nearby = [(middle[0] + y, middle[1] + x) for y in range(-40, 41) for x in range(-40, 41)]
    thin = saved[::8, ::8]
    y, x = min(nearby, key=lambda at: np.abs(shown[at[0] :, at[1] :][:height:8, :width:8] - thin).mean())
    difference = np.abs(shown[y : y + height, x : x + width] - saved)[2:-2, 2:-2]  # there is a frame around it
    assert np.mean(difference > 2) < 0.001


def test_the_viewport_follows(seen, folder) -> None:
    """Through the camera, from outside of it, orbited with the mouse, and with redder plates."""
    means = {name: np.array(seen["picture"][name]) for name in LOOKED_AT}
    assert all(np.all(mean > 0.01) for mean in means.values())
    for before, after in pairwise(LOOKED_AT):
        shots = [read_bytes(folder / f"{name}.png") for name in (before, after)]
        assert np.mean(np.abs(shots[0] - shots[1]).max(axis=2) > 16) > 0.01, f"{before}, {after}"
    red, green, _ = means["edited"] / means["orbited"]
    assert red > 1.01 * green


def test_panels_are_drawn(folder) -> None:
    """None is empty, and no two are the same."""
    shots = {path.stem: read_bytes(path) for path in sorted(folder.glob("panel_*.png"))}
    assert len(shots) >= 20
    assert [name for name, shot in shots.items() if shot.std() < 5] == []
    for one, other in combinations(shots, 2):
        if shots[one].shape == shots[other].shape:
            assert np.abs(shots[one] - shots[other]).max() > 32, f"{one}, {other}"


def test_previews_are_rendered_by_lobe(seen) -> None:
    assert {"material", "world", "lamp_point", "lamp_spot", "lamp_area", "lamp_sun"} <= set(seen["previews"])
