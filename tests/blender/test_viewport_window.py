"""The viewport in a Blender program with a window: pictures change with edits, and threads end.

Set LOBE_BLENDER_WINDOW to a command that opens Blender (4.2 or newer) in a window, or LOBE_BLENDER where there is a
display; without either these tests are skipped. LOBE_BLENDER alone installs the extension.
"""

from __future__ import annotations

import json
import shutil
from itertools import pairwise
from pathlib import Path

import pytest

from tests.blender.real_blender import WITH_WINDOW, install

pytestmark = pytest.mark.skipif(not WITH_WINDOW, reason="no Blender with a window: set LOBE_BLENDER_WINDOW")

RINGS = 160  # of a ball of some 100,000 triangles
THREADS = "Lobe viewport"


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> dict:
    blender = install(tmp_path_factory.mktemp, WITH_WINDOW)
    script = tmp_path_factory.mktemp("script") / "viewport_script.py"
    shutil.copy(Path(__file__).with_name(script.name), script)
    said = blender("--window-geometry", 0, 0, 800, 500, "--python", script, "--", RINGS)
    path = script.with_suffix(".json")
    assert path.exists(), said
    seen = json.loads(path.read_text())
    assert "error" not in seen, seen["error"]
    assert "Traceback" not in said, said
    return seen


def test_every_edit_changes_the_picture(seen, figure) -> None:
    pictures = seen["picture"]
    order = [name for name in pictures if name not in ("samples", "again")]
    for before, after in pairwise(order):
        assert pictures[before]["mean"] != pictures[after]["mean"], f"{before}, {after}"
    assert pictures["lamp"]["mean"][0] > pictures["material"]["mean"][0]
    assert pictures["shown"]["mean"] == pictures["lamp"]["mean"]
    assert all(picture["samples"] == (8 if name in order[:6] else 12) for name, picture in pictures.items())
    times = ", ".join(f"{name} {value:.0f}" for name, value in seen["milliseconds"].items())
    figure(f"viewport: milliseconds from an edit to its first drawn picture: {times}")
    figure(f"viewport: no reaction for {seen['standstill']['rendered']:.2f} s at most while the first kernel compiles")
    figure(f"viewport: {seen['orbit']['updates']:.1f} new pictures a second while orbiting, {seen['idle']:.2f} s idle")


def test_what_is_drawn_is_the_picture(seen) -> None:
    """Read back from the graphics card, before Blender's view transform."""
    for name, picture in seen["picture"].items():
        x0, y0, x1, y1 = picture["region"]
        part = (x1 - x0) * (y1 - y0) / (picture["size"][0] * picture["size"][1])
        expected = [part * channel for channel in picture["mean"][:3]]
        assert picture["seen"] == pytest.approx(expected, rel=2e-3), name


def test_what_cannot_be_rendered_is_said_in_the_viewport(seen) -> None:
    assert any("set it to 1e30 or less" in problem for problem in seen["problem"])
    assert not any(seen["problem after"])


def test_where_it_is_rendered(seen) -> None:
    pictures = seen["picture"]
    width, height = pictures["camera"]["size"]
    assert pictures["camera"]["region"] == [0, 0, width, height]
    x0, y0, x1, y1 = pictures["frame"]["region"]  # of the camera: 16 to 9, in the middle
    assert 0 < x0 < x1 < width and 0 < y0 < y1 < height
    assert (x1 - x0) / (y1 - y0) == pytest.approx(16 / 9, rel=0.02)
    assert (x0 + x1) / 2 == pytest.approx(width / 2, abs=2)
    assert pictures["resized"]["size"][0] < pictures["orthographic"]["size"][0]


def test_threads_end(seen) -> None:
    threads = seen["threads"]
    assert THREADS in threads["rendered"] and THREADS in threads["again"]
    assert threads["before"] == threads["left"] == threads["another file"] == []


def test_preview_icons_are_rendered(seen) -> None:
    assert set(seen["preview"]) == {"Material", "World"}
    assert all(spread > 0.01 for spread in seen["preview"].values())
