"""The tables that the benchmarks leave in benchmarks/results/."""

from __future__ import annotations

import importlib.util

import pytest


@pytest.fixture
def common(repository, tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("benchmarks_common", repository / "benchmarks" / "common.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "RESULTS", tmp_path / "results")
    return module


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


def test_scene_paths(common, repository):
    assert common.scene_path("lamps") == repository / "sample_blends" / "lamps.blend"
    assert str(common.scene_path("some/file.blend")) == "some/file.blend"
