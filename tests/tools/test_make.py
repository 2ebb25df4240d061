"""What `make` says where it can't do what it is asked for, and what it tells the tests."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.blender.real_blender import cannot_look

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make")


def test_test_gui_fails_without_a_window(repository: Path) -> None:
    """Where pytest would skip everything and be content. Nothing is installed for it."""
    unset = {"LOBE_BLENDER", "LOBE_BLENDER_WINDOW", "DISPLAY"}
    environment = {key: value for key, value in os.environ.items() if key not in unset}
    done = subprocess.run(
        ["make", "--old-file=.venv/installed", f"RUN={sys.executable}", "test-gui"],
        cwd=repository,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0 and "set LOBE_BLENDER_WINDOW" in done.stderr and "pytest" not in done.stdout


def test_test_gui_names_the_window_to_the_tests(repository: Path, tmp_path: Path) -> None:
    """Then they fail where they can't look, see `real_blender.cannot_look`."""
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\n[ "$1" = -c ] && exec {sys.executable} "$@"\necho "told: $LOBE_BLENDER_WINDOW"\n')
    python.chmod(0o755)
    environment = {**os.environ, "LOBE_BLENDER": "some blender", "DISPLAY": ":77"}
    environment.pop("LOBE_BLENDER_WINDOW", None)
    command = ["make", "--old-file=.venv/installed", f"RUN={python}", "test-gui"]
    done = subprocess.run(command, cwd=repository, env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and "told: some blender\n" in done.stdout, done.stdout + done.stderr


def test_make_alone_prints_what_there_is(repository: Path) -> None:
    done = subprocess.run(["make"], cwd=repository, capture_output=True, text=True)
    lines = [line.split()[:2] for line in done.stdout.splitlines()]
    assert done.returncode == 0 and ["make", "test"] in lines and ["make", "clean"] in lines
    assert not any(line.startswith("#") for line in done.stdout.splitlines())


@pytest.mark.parametrize(("window", "outcome"), [("", pytest.skip.Exception), ("blender", pytest.fail.Exception)])
def test_a_window_that_was_named_has_to_be_looked_at(monkeypatch, window, outcome) -> None:
    monkeypatch.setenv("LOBE_BLENDER_WINDOW", window)
    with pytest.raises(outcome, match="no xdotool"):
        cannot_look("there is no xdotool")
