"""The tables that the benchmarks leave in benchmarks/results/."""

from __future__ import annotations

import pytest

from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

REQUIRED = {"speed": ["lamps"], "parity": ["lamps"]}  # arguments


@pytest.fixture
def common(script, tmp_path, monkeypatch):
    monkeypatch.setattr(script("common"), "RESULTS", tmp_path / "results")
    return script("common")


def test_a_row_takes_the_place_of_its_predecessor(common):
    common.update_table("t", ("scene",), [{"scene": "b", "x": 1}, {"scene": "a", "x": 2}])
    new = common.update_table("t", ("scene",), [{"scene": "b", "x": 3}])
    assert new == "| scene | x |\n| --- | --- |\n| b | 3 |\n"
    assert (common.RESULTS / "t.csv").read_text() == "scene,x\na,2\nb,3\n"
    assert (common.RESULTS / "t.md").read_text() == "| scene | x |\n| --- | --- |\n| a | 2 |\n| b | 3 |\n"


def test_rows_of_another_form_are_dropped(common):
    common.update_table("t", ("scene",), [{"scene": "a", "old": 1}])
    common.update_table("t", ("scene",), [{"scene": "b", "x": 3}])
    assert (common.RESULTS / "t.csv").read_text() == "scene,x\nb,3\n"


@pytest.mark.parametrize("name", [
    "classic", "denoise", "export_build", "hotspots", "materials", "packages", "parity", "passes", "scale", "speed",
    "startup", "trials", "viewport",
])  # fmt: skip
def test_a_trial_run_can_write_elsewhere(script, repository, tmp_path, name):
    """Than into the tables that the pages quote."""
    parse, arguments = script(name).parse, REQUIRED.get(name, [])
    assert parse(arguments).results == repository / "benchmarks" / "results"
    assert parse([*arguments, "--results", str(tmp_path)]).results == tmp_path
    source = (repository / "benchmarks" / f"{name}.py").read_text()
    assert source.count("update_table(") == source.count("folder=options.results"), "a table that goes elsewhere"


def test_scene_paths(common, repository):
    assert common.scene_path("lamps") == repository / "sample_blends" / "lamps.blend"
    assert str(common.scene_path("some/file.blend")) == "some/file.blend"
