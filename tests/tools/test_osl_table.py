"""The table of what Open Shading Language costs Cycles: it is really on and off, and scenes with Phong are refused."""

from __future__ import annotations

import pytest

from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

from benchmarks import common, osl  # noqa: E402


def test_it_is_switched_on_and_off_in_turn(tmp_path, monkeypatch):
    systems = []
    whole = common.br.render

    def render(scene):
        systems.append(bool(scene.cycles.shading_system))
        return whole(scene)

    monkeypatch.setattr(common.br, "render", render)
    monkeypatch.setattr(osl, "SAMPLES", 4)
    written = osl.table([common.scene_path("cornell_diffuse")], (16, 16), 1, 2, tmp_path)
    again = len(systems[2:]) // 4
    assert systems == [True, False] + again * [True, False, False, True]  # warm, then two pairs, or these again
    (row,) = common.read_table("osl", tmp_path)
    assert written.count("cornell_diffuse") == 1
    assert float(row["means of the pictures"]) == pytest.approx(1.0, abs=0.05)
    assert "at equal samples" in (tmp_path / "osl.md").read_text()


@pytest.mark.parametrize(
    ("scatters", "attempts", "kept"), [([1.4, 9.0], 1, 1.4), ([9.0, 1.2], 2, 1.2), ([9.0, 2.0, 3.0, 1.0], 3, 2.0)]
)
def test_times_that_scatter_are_measured_again(scatters, attempts, kept):
    measured = iter([osl.Pairs((1.0, 1.0, scatter), (1.0, 1.0, 1.0), 1.0) for scatter in scatters])
    assert osl.scatter(osl.steadiest(lambda: next(measured)).total) == kept
    assert len(list(measured)) == len(scatters) - attempts


def test_scenes_with_phong_need_it(tmp_path):
    with pytest.raises(common.br.ToolError, match="lamps has Phong surfaces"):
        osl.table([common.scene_path("lamps")], (16, 16), 1, 2, tmp_path)


def test_make_bench_measures_it(repository):
    recipe = (repository / "Makefile").read_text().split("\nbench:")[1].split("\n\n")[0]
    assert "tools/bench.py cornell_diffuse --osl" in recipe and "tools/bench.py all" in recipe
