"""Compare with Cycles in a Blender program with a window, where renders run beside it and Escape ends them.

Set LOBE_BLENDER_WINDOW to a command that opens Blender (4.2 or newer) in a window, or LOBE_BLENDER where there is a
display; without either these tests are skipped.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.blender.real_blender import NO_WINDOW, WITH_WINDOW, cannot_look, install

pytestmark = pytest.mark.skipif(not WITH_WINDOW, reason=NO_WINDOW)


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> dict:
    blender = install(tmp_path_factory.mktemp, WITH_WINDOW)
    script = tmp_path_factory.mktemp("script") / "compare_script.py"
    shutil.copy(Path(__file__).with_name(script.name), script)
    said = blender("--window-geometry", 0, 0, 800, 500, "--python", script, "--")
    path = script.with_suffix(".json")
    assert path.exists(), said
    seen = json.loads(path.read_text())
    assert "error" not in seen, seen["error"] + said
    assert "Traceback" not in said, said
    return seen


def test_a_comparison_beside_the_window(seen) -> None:
    assert seen["returned"] == ["RUNNING_MODAL"]
    assert seen["changed meanwhile"] and seen["as before"]
    assert (seen["said meanwhile"], seen["said afterwards"]) == ("Comparing: Lobe, 1 of 2", "")
    assert seen["size"] == [64, 48] and all(noise > 0.0 for noise in seen["noise"])


def test_no_window_reaches_other_operators_meanwhile(seen) -> None:
    """Also not the one that Blender opens for the render."""
    assert len(seen["held meanwhile"]) > 1
    assert all(len(listeners) == 1 for listeners in seen["held meanwhile"]), seen["held meanwhile"]
    assert not any(seen["held afterwards"]), seen["held afterwards"]
    if "undo" not in seen:
        cannot_look("where Blender runs there is no xdotool")
    assert seen["undo"] == {"heard": False, "changed": False, "running": True}


def test_the_pictures_are_shown(seen) -> None:
    assert "Lobe | Cycles | difference" in seen["shown"]
    assert {"Lobe", "Cycles"} < set(seen["slots"])


def test_escape(seen) -> None:
    if "escape" not in seen:
        cannot_look("where Blender runs there is no xdotool")
    assert seen["escape"]["as before"] and not seen["escape"]["outcome"]
    assert seen["escape"]["seconds"] < 30.0
