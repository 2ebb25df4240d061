"""The trials of benchmarks/trials.py still fit the engine."""

from __future__ import annotations

import numpy as np
import pytest

from engine import Settings
from tools.blender_render import ToolError


@pytest.fixture(scope="module")
def trials(script):
    return script("trials")


def test_each_edit_finds_its_text(trials, tmp_path):
    for k, trial in enumerate(trials.TRIALS):
        trials.edited(tmp_path / str(k), trial)
        Settings(**trial.settings).validate()
        assert trial.edits or trial.settings


def test_an_edit_of_what_is_gone_is_refused(trials, tmp_path):
    with pytest.raises(ToolError, match="write the trial 'old' anew"):
        trials.edited(
            tmp_path, trials.Trial("old", "new", True, "none", [("engine/accel.py", "no such text", "other")])
        )


def test_names_are_checked(trials):
    assert [trial.name for trial in trials.chosen(["single rays"])] == ["single rays"]
    with pytest.raises(ToolError, match="no trial 'double rays'"):
        trials.chosen(["double rays"])


def test_the_list_of_what_was_tried_turns_gains_about(trials):
    """A technique that the engine has gains what its trial lost; one that it hasn't, what its trial gained."""
    lines = trials.list_of_tried([row("no roulette", 1.25, 1.25), row("balance heuristic", 1.25, 1.25)]).splitlines()
    assert [line.split(" | ")[1:] for line in lines[2:]] == [
        ["1.25 (1.17 to 1.33)", "1.25 on scene 0, 1.25 on scene 0", "a random number for each vertex", "yes |"],
        ["0.80 (0.75 to 0.85)", "0.80 on scene 0, 0.80 on scene 0", "none", "no |"],
    ]


def row(name: str, *costs: float) -> dict[str, str]:
    """Of trials.csv."""
    scenes = {f"scene {k}": f"{cost:.2f} (1.00 x {cost:.2f} ± 0.01)" for k, cost in enumerate(costs)}
    return {"instead": name, **scenes, "geometric mean": "not looked at"}


def test_a_gain_that_noise_could_be_is_none(trials):
    """Two scenes: what is uncertain about each is TIME_NOISE of its seconds and its relMSE's standard error."""
    found = trials.costs(row("no roulette", 0.9, 1.5))
    assert found["scene 1"] == (1.5, pytest.approx(np.hypot(0.01 / 1.5, trials.TIME_NOISE)))
    gain, scenes = trials.gain_of(found, True)
    middle = (0.9 * 1.5) ** 0.5
    half = 1.96 * np.hypot(np.hypot(0.01 / 0.9, trials.TIME_NOISE), np.hypot(0.01 / 1.5, trials.TIME_NOISE)) / 2
    assert gain == f"{middle:.2f} ({middle * np.exp(-half):.2f} to {middle * np.exp(half):.2f})"
    assert scenes == "0.90 on scene 0, 1.50 on scene 1"
    assert trials.gain_of(found, False)[1] == "0.67 on scene 1, 1.11 on scene 0"
    assert trials.gain_of(trials.costs(row("no roulette", 0.97, 1.05)), True)[0].endswith(": no difference")


def test_the_list_is_written_from_the_kept_rows_alone(trials, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{trials.MARKS[0]}old\n{trials.MARKS[1]}after\n")
    rows = [row("no roulette", 1.25, 1.25)]
    trials.common.update_table("trials", ("instead",), rows, folder=tmp_path)
    trials.quote_list(page, tmp_path)
    table = trials.section(rows)
    assert "| Russian roulette by throughput |" in table and "(results/trials.md)" in table
    assert page.read_text() == f"before\n{trials.MARKS[0]}{table}{trials.MARKS[1]}after\n"
    trials.quote_list(page, tmp_path / "nothing")
    assert "Not measured yet" in page.read_text() and "](" not in page.read_text()


def test_the_readme_of_the_benchmarks_quotes_the_list(trials, repository):
    page = (repository / "benchmarks" / "README.md").read_text(encoding="utf-8")
    quoted = page.split(trials.MARKS[0])[1].split(trials.MARKS[1])[0]
    kept = trials.common.read_table("trials", trials.common.RESULTS)
    assert quoted == trials.section(kept), "write it anew: python benchmarks/trials.py --list"
    names = [trial.name for trial in trials.TRIALS]
    assert [row["instead"] for row in kept if row["instead"] not in names] == []
