"""Compiling in another process: when one is started, how it ends, and that the cache says what is in it."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from engine import elsewhere

KERNEL = {"features": {"phong": 1}, "first_hits": False}
NEVER = bool  # what `stop` says: False


@pytest.fixture
def started(tmp_path: Path):
    """Starts are written into this file. At the end kernels are compiled here again, as for other tests."""
    file = tmp_path / "started"
    code = f"import sys; open({str(file)!r}, 'a').write(sys.argv[1] + '\\n')"
    elsewhere.compile_elsewhere([sys.executable, "-c", code])
    yield file
    elsewhere.compile_elsewhere(())


def test_the_process_is_told_which_kernel(started: Path, tmp_path: Path) -> None:
    elsewhere.compiled(KERNEL, tmp_path, NEVER)
    assert started.read_text() == '{"features": {"phong": 1}, "first_hits": false}\n'


def test_what_the_cache_has_starts_no_process(started: Path, tmp_path: Path) -> None:
    elsewhere.mark(KERNEL, tmp_path)
    elsewhere.compiled(KERNEL, tmp_path, NEVER)
    assert not started.exists()
    elsewhere.compiled({**KERNEL, "first_hits": True}, tmp_path, NEVER)
    assert started.exists()


def test_without_a_command_or_a_cache_it_compiles_here(started: Path, tmp_path: Path) -> None:
    elsewhere.compiled(KERNEL, None, NEVER)
    elsewhere.mark(KERNEL, None)
    elsewhere.compile_elsewhere(())
    elsewhere.compiled(KERNEL, tmp_path, NEVER)
    assert not started.exists()


def test_stopping_ends_the_process_at_once(tmp_path: Path) -> None:
    elsewhere.compile_elsewhere([sys.executable, "-c", "import time; time.sleep(60)"])
    begun = time.perf_counter()
    try:
        with pytest.raises(elsewhere.CompilationStopped):
            elsewhere.compiled(KERNEL, tmp_path, lambda: True)
    finally:
        elsewhere.compile_elsewhere(())
    assert time.perf_counter() - begun < 30


@pytest.mark.parametrize("command", [["a program that is not there"], [sys.executable, "-c", "raise SystemExit(3)"]])
def test_where_the_process_fails_nothing_is_lost(command: list[str], tmp_path: Path) -> None:
    elsewhere.compile_elsewhere(command)
    try:
        elsewhere.compiled(KERNEL, tmp_path, NEVER)
    finally:
        elsewhere.compile_elsewhere(())
    assert not list(tmp_path.iterdir())  # so that this process marks it once it has compiled it


def test_a_render_marks_the_kernel_by_the_name_that_compiles_it(tmp_path: Path, monkeypatch) -> None:
    from engine import Camera, Scene, Settings, render, schedule
    from engine.kernels import jit

    names: list[dict] = []
    monkeypatch.setattr(elsewhere, "mark", lambda kernel, folder: names.append(kernel))
    monkeypatch.setattr(elsewhere, "compiled", lambda kernel, folder, stop: names.append(kernel))
    render(Scene(camera=Camera(), width=4, height=4), Settings(samples=1, passes=("DEPTH",)))
    asked, marked = names
    schedule.precompile_one(asked)
    assert asked == marked == names[-1]
    assert asked["first_hits"] and not jit.lost_cache()


def test_the_builder_of_light_trees_is_compiled_by_its_name_too(started: Path, tmp_path: Path, monkeypatch) -> None:
    from engine import schedule

    monkeypatch.setattr(schedule, "CACHE_FOLDER", tmp_path)
    schedule._get_builder(np.zeros(1, np.uint8))
    schedule._get_builder(np.zeros(1, np.uint8))
    assert [json.loads(line) for line in started.read_text().splitlines()] == [schedule.TREE_BUILDER]
