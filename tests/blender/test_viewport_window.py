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

from tests.blender.real_blender import NO_WINDOW, WITH_WINDOW, install

pytestmark = pytest.mark.skipif(not WITH_WINDOW, reason=NO_WINDOW)

RINGS = 160  # of a ball of some 100,000 triangles
THREADS = "Lobe viewport"
MOST_GROWTH = 10.0  # MB
EDITS = ("moved", "material", "lamp", "hidden", "resized")


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> dict:
    blender = install(tmp_path_factory.mktemp, WITH_WINDOW)
    script = tmp_path_factory.mktemp("script") / "viewport_script.py"
    for name in (script.name, "left_behind.py"):
        shutil.copy(Path(__file__).with_name(name), script.parent / name)
    said = blender("--window-geometry", 0, 0, 800, 500, "--python", script, "--", RINGS)
    path = script.with_suffix(".json")
    assert path.exists(), said
    seen = json.loads(path.read_text())
    assert "error" not in seen, seen["error"]
    assert "Traceback" not in said, said
    return seen


def test_every_edit_changes_the_picture(seen) -> None:
    pictures = seen["picture"]
    order = [name for name in pictures if name not in ("samples", "again")]
    for before, after in pairwise(order):
        assert pictures[before]["mean"] != pictures[after]["mean"], f"{before}, {after}"
    assert pictures["lamp"]["mean"][0] > pictures["material"]["mean"][0]
    assert pictures["shown"]["mean"] == pictures["lamp"]["mean"]
    assert all(picture["samples"] == (8 if name in order[:6] else 12) for name, picture in pictures.items())


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


def test_resizing_goes_on_from_the_picture_that_is_there(seen) -> None:
    """What is drawn first in the new size is the picture of the old one, and the scene is not exported again."""
    size = seen["picture"]["resized"]["size"]
    assert size != seen["picture"]["orthographic"]["size"]
    is_old = [old for old, at in seen["draws"]["resized"] if at == size]
    assert is_old[0] and not is_old[-1]


def test_what_is_exported_again(seen) -> None:
    """How often all objects are walked: looking around is none of their business."""
    walks = seen["exports"]
    assert [name for name in walks if not walks[name]] == [
        "moved", "lamp", "samples", "camera", "frame", "orthographic", "resized"
    ]  # fmt: skip


def test_no_memory_is_kept_over_a_thousand_edits(seen, record) -> None:
    """Of transforms, materials, lamps, the world, visibility, settings and the view, in turn."""
    before, after = seen["memory"]
    what = "MB more in use after 1,000 edits of all kinds, after the first 200"
    record("viewport", ("Blender", "what"), {**where(seen), "what": what, "value": f"{after - before:+.1f}"})
    assert after - before < MOST_GROWTH


def test_twenty_times_on_and_off_leaves_nothing(seen) -> None:
    assert seen["enabled"]["property"] and seen["enabled"]["timers"] and seen["enabled"]["presets"]
    assert THREADS in seen["rendering"]["threads"]
    assert not any(seen["before"][key] for key in ("types", "property", "timers", "presets", "process", "threads"))
    assert "LOBE_CACHE_DIR" not in seen["before"]["variables"]
    assert seen["after"] == seen["before"]


def where(seen) -> dict:
    width, height = seen["picture"]["moved"]["size"]
    return {"Blender": seen["blender"], "viewport": f"{width} x {height}", "triangles": f"{seen['triangles']:,}"}


def test_figures(seen, record) -> None:
    """For the reader, of a window whose pixels may be drawn by the processor: what other work makes of them proves
    nothing."""
    figures = {
        f"ms from an edit to its first drawn picture: {name}": seen["milliseconds"][name]["drawn"] for name in EDITS
    }
    figures |= {f"ms of them until Lobe has the picture: {name}": seen["milliseconds"][name]["made"] for name in EDITS}
    figures["new pictures a second while orbiting"] = seen["orbit"]["drawn"]
    figures["pictures a second that Lobe makes while orbiting"] = seen["orbit"]["made"]
    figures["redraws a second while orbiting in Solid, which are Blender's alone"] = seen["orbit in Solid"]["ticks"]
    figures["s without any reaction, at most, while the first kernel compiles"] = seen["standstill"]["rendered"]
    figures["s of the processor for each second at rest"] = seen["idle"]
    assert all(value > 0 for value in figures.values()), "a figure that was never taken"
    for what, value in figures.items():
        record("viewport", ("Blender", "what"), {**where(seen), "what": what, "value": f"{value:.3g}"})


def test_threads_end(seen) -> None:
    threads = seen["threads"]
    assert THREADS in threads["rendered"] and THREADS in threads["again"]
    assert threads["before"] == threads["left"] == threads["another file"] == []


def test_preview_icons_are_rendered(seen) -> None:
    assert set(seen["preview"]) == {"Material", "World"}
    assert all(spread > 0.01 for spread in seen["preview"].values())
    assert all(seen["icons"][name] for name in seen["preview"]), "drawn by another engine"
    assert any("Material" in names for names in seen["icons"]["Material"])
