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
        trials.edited(tmp_path, trials.Trial("old", [("engine/accel.py", "no such text", "other")]))


def test_names_are_checked(trials):
    assert [trial.name for trial in trials.chosen(["single rays"])] == ["single rays"]
    with pytest.raises(ToolError, match="no trial 'double rays'"):
        trials.chosen(["double rays"])
