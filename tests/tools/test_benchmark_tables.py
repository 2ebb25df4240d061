"""The tables that the benchmarks leave in benchmarks/results/."""

from __future__ import annotations

import pytest

from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

REQUIRED = {"parity": ["lamps"]}  # arguments


@pytest.fixture
def common(script, tmp_path, monkeypatch):
    monkeypatch.setattr(script("common"), "RESULTS", tmp_path / "results")
    return script("common")


def test_a_row_takes_the_place_of_its_predecessor(common):
    common.update_table("t", ("scene",), [{"scene": "b", "x": 1}, {"scene": "a", "x": 2}])
    new = common.update_table("t", ("scene",), [{"scene": "b", "x": 3}])
    assert new == "| scene | x |\n| --- | --- |\n| b | 3 |\n"
    assert (common.RESULTS / "t.csv").read_text() == "scene,x\na,2\nb,3\n"
    written = (common.RESULTS / "t.md").read_text()
    assert written.startswith("| scene | x |\n| --- | --- |\n| a | 2 |\n| b | 3 |\n\nMeasured on: 2 of 2 rows: ")


def test_a_table_says_what_its_rows_were_measured_on(common, monkeypatch):
    def last_line() -> str:
        return (common.RESULTS / "t.md").read_text().splitlines()[-1]

    def update(*scenes: str) -> None:
        rows = [{"scene": scene, "x": 1} for scene in scenes]
        common.update_table("t", ("scene", "x"), rows, summary=lambda _: [{"scene": "geometric mean", "x": 1}])

    monkeypatch.setattr(common, "engine_digest", lambda: "e1")
    monkeypatch.setattr(common, "processor", lambda: "old, AVX2")
    common.update_table("other", ("scene",), [{"scene": "a", "x": 1}])
    update("a", "b", "c")
    assert last_line() == "Measured on: 3 of 3 rows: old, AVX2, engine e1."
    monkeypatch.setattr(common, "engine_digest", lambda: "e2")
    update("b")
    assert last_line() == "Measured on: 2 of 3 rows: old, AVX2, engine e1; 1 of 3 rows: old, AVX2, engine e2."
    made_by = common.RESULTS / "made_by.csv"
    assert 'other,a,"old, AVX2",e1\n' in made_by.read_text() and 't,b; 1,"old, AVX2",e2\n' in made_by.read_text()
    made_by.unlink()  # a table of before there was such a note
    update("b")
    assert last_line() == "Measured on: 1 of 3 rows: old, AVX2, engine e2; 2 of 3 rows: not recorded."


def test_rows_that_share_their_keys_are_counted_each(common, monkeypatch):
    """As the levels of a curve do."""
    monkeypatch.setattr(common, "engine_digest", lambda: "e1")
    monkeypatch.setattr(common, "processor", lambda: "old, AVX2")
    for scene in "ab":
        common.update_table("t", ("scene",), [{"scene": scene, "samples": samples} for samples in (1, 4)])
    assert (common.RESULTS / "t.md").read_text().splitlines()[-1] == "Measured on: 4 of 4 rows: old, AVX2, engine e1."


def test_rows_stand_in_the_order_of_their_numbers(common):
    common.update_table("t", ("lamps", "number"), [{"lamps": "sun", "number": n} for n in (100, 20, 1.5)])
    common.update_table("t", ("lamps", "number"), [{"lamps": "area", "number": 3}])
    assert (common.RESULTS / "t.csv").read_text() == "lamps,number\narea,3\nsun,1.5\nsun,20\nsun,100\n"


def test_processor_and_engine_have_names(common):
    assert common.processor().strip() and len(common.engine_digest()) == 10


def test_rows_of_another_form_are_dropped(common):
    common.update_table("t", ("scene",), [{"scene": "a", "old": 1}])
    common.update_table("t", ("scene",), [{"scene": "b", "x": 3}])
    assert (common.RESULTS / "t.csv").read_text() == "scene,x\nb,3\n"


@pytest.mark.parametrize("name", [
    "classic", "denoise", "hotspots", "materials", "packages", "parity", "passes", "scale", "startup", "trials",
    "viewport",
])  # fmt: skip
def test_a_trial_run_can_write_elsewhere(script, repository, tmp_path, name):
    """Than into the tables that the pages quote."""
    parse, arguments = script(name).parse, REQUIRED.get(name, [])
    assert parse(arguments).results == repository / "benchmarks" / "results"
    assert parse([*arguments, "--results", str(tmp_path)]).results == tmp_path
    source = (repository / "benchmarks" / f"{name}.py").read_text()
    assert source.count("update_table(") == source.count("folder=options.results"), "a table that goes elsewhere"


def test_turns_go_forth_and_back(common):
    assert list(common.in_turn("ab", 3)) == [(0, "a"), (0, "b"), (1, "b"), (1, "a"), (2, "a"), (2, "b")]


def test_scene_paths(common, repository):
    assert common.scene_path("lamps") == repository / "sample_blends" / "lamps.blend"
    assert str(common.scene_path("some/file.blend")) == "some/file.blend"
    assert str(common.scene_path("elsewhere/lamps.blend")) == "elsewhere/lamps.blend"
    assert common.scene_path(str(common.SAMPLES / "lamps.blend")) == common.scene_path("lamps")
