"""The table of goals says what the tables say."""

from __future__ import annotations

import pytest

from benchmarks import common, goals
from benchmarks.convergence import tables


def verdicts(folder) -> dict[str, str]:
    return {goal.text: goal.row(folder)["reached"] for goal in goals.GOALS}


def test_without_tables_nothing_is_measured(tmp_path):
    assert set(verdicts(tmp_path).values()) == {goals.UNKNOWN}


def write(folder, name: str, rows: list[dict]) -> None:
    common.update_table(name, ("scene",), rows, folder=folder)


@pytest.mark.parametrize(
    ("figures", "verdict", "measured"),
    [
        ({}, goals.YES, "1.25 (lamps); 6 of 6 reach it"),
        ({"world": "1.26 (1.20 to 1.30)"}, goals.NO, "1.26 (world); 5 of 6 reach it"),
        ({"world": ""}, goals.UNKNOWN, "1.25 (lamps); 5 of 5 reach it; not measured: world"),
        ({"world": "", "lamps": "9.0"}, goals.NO, "9.00 (lamps); 4 of 5 reach it; not measured: world"),
    ],
)
def test_the_worst_scene_decides(tmp_path, figures, verdict, measured):
    usual = dict.fromkeys(common.SCENES, "0.80 (0.70 to 2.00)") | {"lamps": "1.25 (1.00 to 2.00)"}
    usually = {"resolution": "384x256", "threads": "2"}
    rows = [{"scene": name, "render / replay": text} | usually for name, text in (usual | figures).items()]
    rows += [{"scene": "somebody's", "render / replay": "77"} | usually]
    rows += [{"scene": "lamps", "render / replay": "77", "resolution": "16x16", "threads": "2"}]
    common.update_table("ceiling", ("scene", "resolution"), rows, folder=tmp_path)
    goal = next(goal for goal in goals.GOALS if goal.table == "ceiling")
    row = goal.row(tmp_path)
    assert (row["reached"], row["measured"]) == (verdict, measured)


@pytest.mark.parametrize(
    ("means", "verdict"),
    [
        ({"of 6": "5.00", "of 3 without OSL": "5.00"}, goals.YES),
        ({"of 6": "5.00", "of 3 without OSL": "4.99"}, goals.NO),
        ({"of 6": "4.99", "of 3 without OSL": "7.00"}, goals.NO),
        ({"of 5": "7.00", "of 3 without OSL": "7.00"}, goals.UNKNOWN),
        ({"of 5": "3.00", "of 2 without OSL": "3.00"}, goals.UNKNOWN),
        ({"of 6": "7.00"}, goals.UNKNOWN),
        ({"of 6 without OSL": "7.00"}, goals.UNKNOWN),
    ],
)
def test_the_mean_is_of_all_samples_and_of_those_without_osl(tmp_path, means, verdict):
    rows = [scene_row(f"geometric mean {name}", ratio) for name, ratio in means.items()]
    write(tmp_path, "equal_error", [scene_row(scene) for scene in common.SCENES] + rows)
    found = goals.GOALS[0].row(tmp_path)
    assert found["reached"] == verdict
    assert all(f"{ratio} (1 to 9), geometric mean {name}" in found["measured"] for name, ratio in means.items())


def scene_row(scene: str, ratio: str = "9", worst: str = "1e-1", trimmed: str = "9.5") -> dict[str, str]:
    return {"scene": scene, tables.RATIO: ratio, tables.RATIO + tables.INTERVAL: "1 to 9", "resolution": "384x256",
            "threads": "2", "seeds": "8", "relMSE, from": "1e-2", "relMSE, to": worst,
            tables.TRIMMED_RATIO: trimmed, tables.TRIMMED_RATIO + tables.INTERVAL: "2 to 8"}  # fmt: skip


@pytest.mark.parametrize("column", ["ratio", "trimmed"])
def test_the_worse_of_whole_and_trimmed_errors_decides(tmp_path, column):
    rows = [scene_row(scene, **({column: "2.5"} if scene == "world" else {})) for scene in common.SCENES]
    rows += [scene_row("geometric mean of 6", **{column: "4.9"}), scene_row("geometric mean of 3 without OSL")]
    write(tmp_path, "equal_error", rows)
    mean, least = (goal.row(tmp_path) for goal in goals.GOALS[:2])
    assert (mean["reached"], least["reached"]) == (goals.NO, goals.NO)
    of_column = {"ratio": "1 to 9", "trimmed": "2 to 8"}[column]
    assert f"4.9 ({of_column}), geometric mean of 6" in mean["measured"]
    assert "9 (1 to 9), geometric mean of 3 without OSL" in mean["measured"]
    assert least["measured"] == "2.50 (world); 5 of 6 reach it"


def test_a_ratio_over_hardly_any_range_does_not_count(tmp_path):
    rows = [scene_row(scene, worst="9e-2" if scene == "lamps" else "1e-1") for scene in common.SCENES]
    means = [scene_row("geometric mean of 6"), scene_row("geometric mean of 3 without OSL")]
    write(tmp_path, "equal_error", [*rows, *means])
    mean, least = (goal.row(tmp_path) for goal in goals.GOALS[:2])
    assert (mean["reached"], least["reached"]) == (goals.UNKNOWN, goals.UNKNOWN)
    assert "not measured: lamps" in least["measured"]


@pytest.mark.parametrize(("times", "verdict"), [((1.0, 1.2, 1.4), goals.YES), ((1.0, 1.2, 8.0), goals.NO)])
def test_growth_with_the_logarithm(tmp_path, times, verdict):
    rows = [{"triangles": count, "threads": "2", "render / that of 1e3": f"{time} (0 to 9)"}
            for count, time in zip(("1e3", "1e5", "1e7"), times, strict=True)]  # fmt: skip
    common.update_table("scale_triangles", ("triangles",), rows, folder=tmp_path)
    goal = next(goal for goal in goals.GOALS if goal.judge is goals.logarithmic)
    assert goal.row(tmp_path)["reached"] == verdict
    others = [goal for goal in goals.GOALS if goal.table == "scale_triangles" and goal.judge is not goals.logarithmic]
    assert {goal.row(tmp_path)["reached"] for goal in others} == {goals.UNKNOWN}  # their columns are missing


def viewport_rows(blender: str, *, seen: str, rate: str, median: str = "1") -> list[dict]:
    figures = {"ms from a camera move to its first picture, longest": seen, "new pictures a second while moving": rate,
               "ms from a camera move to its first picture, median": median}  # fmt: skip
    return [{"Blender": blender, "what": what, "value": value} for what, value in figures.items()]


@pytest.mark.parametrize(
    ("rows", "verdicts"),
    [
        (viewport_rows("none", seen="99", rate="11"), [goals.UNKNOWN, goals.UNKNOWN]),
        (viewport_rows("none", seen="101", rate="9"), [goals.NO, goals.NO]),
        (viewport_rows("none", seen="99", rate="11", median="500") + viewport_rows("5.0.1", seen="98", rate="10"),
         [goals.YES, goals.YES]),
        (viewport_rows("none", seen="99", rate="11") + viewport_rows("5.0.1", seen="1.2e+03", rate="9"),
         [goals.NO, goals.NO]),
    ],
)  # fmt: skip
def test_the_viewport_is_judged_by_its_longest_and_in_a_window(tmp_path, rows, verdicts):
    common.update_table("viewport", ("Blender", "what"), rows, folder=tmp_path)
    found = [goal.row(tmp_path) for goal in goals.GOALS if goal.table == "viewport"]
    assert [row["reached"] for row in found] == verdicts
    windowed = any(row["Blender"] != "none" for row in rows)
    assert all(("not measured: in a window" in row["measured"]) != windowed for row in found)


def test_what_grows(tmp_path):
    """From 1 s to 3 s: Embree from 0.5 to 0.6, the light tree from 0.1 to 1.5, the rest from 0.4 to 0.9."""
    assert goals.what_grows(tmp_path) == "Not measured yet.\n"
    shares = {
        "1e2": ("1.0", "50%", "10%", "40%"),
        "1e5": ("3.0", "20%", "50%", "30%"),
        "1e3": ("9", "0%", "0%", "100%"),
    }
    columns = "s a render", "Embree", "light tree", "rest"
    rows = [{"scene": "lamps", "number": number, **dict(zip(columns, row, strict=True))}
            for number, row in shares.items()]  # fmt: skip
    common.update_table("hotspots_scale", ("scene", "number"), rows, folder=tmp_path)
    said = goals.what_grows(tmp_path)
    assert "| lamps, 1e2 to 1e5 | 3.00 times as long | light tree 70%, rest 25%, Embree 5% |" in said
    assert "(results/hotspots_scale.md)" in said


def test_the_readme_of_the_benchmarks_quotes_the_table():
    page = goals.PAGE.read_text(encoding="utf-8")
    quoted = page.split(goals.MARKS[0])[1].split(goals.MARKS[1])[0]
    # A change of the engine makes tables old, and fails no test.
    present, written = (text.replace(goals.PRESENT, goals.OLDER) for text in (goals.table(), quoted))
    assert written == present, "write it anew: python benchmarks/goals.py"
    quoted = page.split(goals.TIME_MARKS[0])[1].split(goals.TIME_MARKS[1])[0]
    assert quoted == goals.where_time_goes(), "write it anew: python benchmarks/goals.py"
    quoted = page.split(goals.GROWTH_MARKS[0])[1].split(goals.GROWTH_MARKS[1])[0]
    assert quoted == goals.what_grows(), "write it anew: python benchmarks/goals.py"


def test_verdicts_say_when_the_engine_has_changed_since(tmp_path, monkeypatch):
    def said() -> str:
        goal = next(goal for goal in goals.GOALS if goal.table == "ceiling")
        return goal.row(tmp_path)["engine"]

    assert said() == ""
    usual = {"render / replay": "1", "resolution": "384x256", "threads": "2"}
    for name in common.SCENES[:2]:
        common.update_table("ceiling", ("scene",), [{"scene": name} | usual], folder=tmp_path)
        assert said() == goals.PRESENT
    monkeypatch.setattr(common, "engine_digest", lambda: "another")
    assert said() == goals.OLDER
    common.update_table("ceiling", ("scene",), [{"scene": common.SCENES[0]} | usual], folder=tmp_path)
    assert said() == goals.OLDER  # the other row
    (tmp_path / "made_by.csv").unlink()
    assert said() == common.UNRECORDED


def test_where_the_time_goes_names_the_largest_parts(tmp_path):
    assert goals.where_time_goes(tmp_path) == ""
    row = {"scene": "lamps", "samples": "100", "Embree": "50%", "a": "9%", "b": "20%", "c": "1%", "d": "20%"}
    common.update_table("hotspots", ("scene",), [row], folder=tmp_path)
    assert "| lamps | 50% | b 20%, d 20%, a 9% |" in goals.where_time_goes(tmp_path)
