"""The trials of benchmarks/trials.py still fit the engine."""

from __future__ import annotations

import importlib

import pytest

from engine import Settings
from tools.blender_render import ToolError


@pytest.fixture(scope="module")
def trials(repository):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(repository / "benchmarks"))
        yield importlib.import_module("trials")


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
    rows = [
        {"instead": "no roulette", "geometric mean": "1.25"},
        {"instead": "balance heuristic", "geometric mean": "1.25"},
    ]
    lines = trials.list_of_tried(rows).splitlines()[2:]
    assert [line.split(" | ")[1:] for line in lines] == [
        ["1.25", "a random number for each vertex", "yes |"],
        ["0.80", "none", "no |"],
    ]


def test_the_readme_of_the_benchmarks_quotes_the_list(trials, repository):
    page = (repository / "benchmarks" / "README.md").read_text(encoding="utf-8")
    quoted = page.split(trials.MARKS[0])[1].split(trials.MARKS[1])[0]
    assert quoted == trials.list_of_tried(trials.common.read_table("trials", trials.common.RESULTS))
