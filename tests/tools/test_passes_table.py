"""benchmarks/passes.py: which boxes it ticks, and its figures on made-up renders."""

from __future__ import annotations

import pytest

from engine.passes import PASSES, bytes_a_pixel
from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

import bpy  # noqa: E402
from bl_ext.user_default.lobe.addon.passes import wanted_passes  # noqa: E402


@pytest.fixture(scope="module")
def passes(script):
    return script("passes")


def reports(*seconds: float) -> list[dict]:
    return [{"seconds": {"render": value, "total": 2.0 * value + 1.0}} for value in seconds]


def test_each_box_is_ticked_by_itself(passes):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    layer = bpy.context.view_layer
    known = passes.boxes(layer)
    assert sorted(name for box in known.values() for name in box.passes) == sorted(PASSES)
    for label, box in known.items():
        passes.tick(layer, [label])
        assert sorted(wanted_passes(layer)) == sorted(box.passes)
    passes.tick(layer, list(known))
    assert set(wanted_passes(layer)) == set(PASSES)
    passes.tick(layer, [])
    assert wanted_passes(layer) == ()


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ([], 0),
        (["SAMPLE_COUNT"], 0),
        (["DEPTH"], 8 + 8),
        (["EMISSION"], 24),
        (["DIFFUSE_DIRECT"], 24 + 24 + 8),  # with the colour and the number of samples
        (["DIFFUSE_DIRECT", "DIFFUSE_COLOR"], 24 + 24 + 8),
    ],
)
def test_bytes_are_those_of_the_sums(passes, names, expected):
    """As docs/settings.md has them; those at the end are the engine's own, which has a picture and a copy more."""
    assert round(passes.bytes_while_rendering(names)) == expected
    assert bytes_a_pixel(names) == expected + 8 * sum(PASSES[name] for name in names)


def test_a_row_has_ratios_of_rounds(passes):
    options = passes.parse(["--runs", "3"])
    row = passes.row("my/lamps.blend", "Mist", reports(2, 3, 8), reports(1, 2, 4), ["MIST"], options)
    assert (row["scene"], row["box"], row[passes.TIME]) == ("lamps", "Mist", "2.00 (1.50 to 2.00)")
    assert row["total, with / without"] == "1.67 (1.40 to 1.89)"
    assert (row[passes.WHILE], row[passes.END]) == ("16", "24")


def test_the_short_table_spans_the_scenes(passes):
    def row(scene: str, box: str, time: str) -> dict[str, str]:
        return {"scene": scene, "box": box, passes.TIME: time, passes.WHILE: "16", passes.END: "24"}

    rows = [row("a", "Mist", "1.20 (1.00 to 9.00)"), row("a", "UV", "1.10 (1.00 to 1.20)"),
            row("b", "Mist", "1.05 (0.50 to 1.10)"), row("b", "UV", "1.30 (1.00 to 1.50)")]  # fmt: skip
    assert [line.split(" | ")[:2] for line in passes.short(rows).splitlines()[2:]] == [
        ["| Mist", "1.05 to 1.20"], ["| UV", "1.10 to 1.30"],
    ]  # fmt: skip
    assert passes.short([]) == ""


def test_the_settings_page_quotes_the_table(passes):
    quoted = passes.PAGE.read_text(encoding="utf-8").split(passes.MARKS[0])[1].split(passes.MARKS[1])[0]
    kept = passes.common.read_table("passes", passes.common.RESULTS)
    assert kept and quoted == passes.short(kept), "write it anew: python benchmarks/passes.py"
