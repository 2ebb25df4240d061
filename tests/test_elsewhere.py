"""Compiling in another process: when one is started, how it ends, and that the cache says what is in it."""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from engine import LobeError, elsewhere

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
    assert not elsewhere.is_marked(KERNEL, tmp_path)
    elsewhere.mark(KERNEL, tmp_path)
    assert elsewhere.is_marked(KERNEL, tmp_path) and not elsewhere.is_marked(KERNEL, None)
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
    file = tmp_path / "pid"
    code = f"import os, time; open({str(file)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    elsewhere.compile_elsewhere([sys.executable, "-c", code])
    try:
        with pytest.raises(elsewhere.CompilationStopped):
            elsewhere.compiled(KERNEL, tmp_path, lambda: bool(file.exists() and file.read_text()))
    finally:
        elsewhere.compile_elsewhere(())
    with pytest.raises(ProcessLookupError):
        os.kill(int(file.read_text()), 0)


def test_two_threads_start_one_process(started: Path, tmp_path: Path, monkeypatch) -> None:
    run = elsewhere._run

    def run_and_mark(command, stop) -> int:
        code = run(command, stop)
        elsewhere.mark(KERNEL, tmp_path)
        return code

    monkeypatch.setattr(elsewhere, "_run", run_and_mark)
    threads = [threading.Thread(target=elsewhere.compiled, args=(KERNEL, tmp_path, NEVER)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(started.read_text().splitlines()) == 1


def test_who_waits_for_another_kernel_can_be_stopped(tmp_path: Path) -> None:
    elsewhere.compile_elsewhere([sys.executable, "-c", "pass"])
    try:
        with elsewhere._one_at_a_time, pytest.raises(elsewhere.CompilationStopped):
            elsewhere.compiled(KERNEL, tmp_path, lambda: True)
    finally:
        elsewhere.compile_elsewhere(())


@pytest.mark.parametrize("command", [["a program that is not there"], [sys.executable, "-c", "raise SystemExit(3)"]])
def test_where_the_process_fails_the_kernel_is_compiled_here(command: list[str], tmp_path: Path, monkeypatch) -> None:
    from engine import Camera, Scene, Settings, loading, render

    monkeypatch.setattr(loading, "CACHE_FOLDER", tmp_path)
    elsewhere.compile_elsewhere(command)
    try:
        render(Scene(camera=Camera(), width=4, height=4), Settings(samples=1))
    finally:
        elsewhere.compile_elsewhere(())
    assert len(list(tmp_path.glob("*.compiled"))) == 2  # and what Embree calls, which is always compiled here


def test_where_the_process_crashes_the_kernel_is_not_compiled_here(tmp_path: Path, monkeypatch) -> None:
    """As LLVM ends it: the same here would be the end of Blender. The next attempt is in another process again."""
    from llvmlite import binding

    from engine import Camera, Scene, Settings, loading, render

    monkeypatch.setattr(loading, "CACHE_FOLDER", tmp_path)
    monkeypatch.setattr(loading, "load_kernel", lambda *_: pytest.fail("compiled here"))
    elsewhere.compile_elsewhere([sys.executable, "-c", "import os; os.abort()"])
    try:
        for _ in range(2):
            with pytest.raises(LobeError, match=r"the compiler crashed .* please report this .* Reference") as error:
                render(Scene(camera=Camera(), width=4, height=4), Settings(samples=1))
            assert repr(binding.get_host_cpu_name()) in str(error.value)
    finally:
        elsewhere.compile_elsewhere(())
    assert len(list(tmp_path.iterdir())) == 1  # of what Embree calls, which was compiled before


@pytest.mark.parametrize(
    ("platform", "code", "killed"),
    [
        ("linux", -6, True), ("darwin", -9, True), ("linux", 0, False), ("linux", 1, False), ("linux", 3, False),
        ("win32", 3, True), ("win32", 0xC0000409, True), ("win32", 0xC0000005, True), ("win32", 1, False),
        ("win32", 0, False),
    ],
)  # fmt: skip
def test_a_crash_is_known_by_the_exit_code(monkeypatch, platform: str, code: int, killed: bool) -> None:
    monkeypatch.setattr(elsewhere.sys, "platform", platform)
    assert elsewhere.was_killed(code) == killed


def test_a_render_marks_the_kernel_by_the_name_that_compiles_it(tmp_path: Path, monkeypatch) -> None:
    from engine import Camera, Scene, Settings, loading, render
    from engine.kernels import jit

    names: list[dict] = []
    monkeypatch.setattr(elsewhere, "mark", lambda kernel, folder: names.append(kernel))
    monkeypatch.setattr(elsewhere, "compiled", lambda kernel, folder, stop: names.append(kernel))
    render(Scene(camera=Camera(), width=4, height=4), Settings(samples=1, passes=("DEPTH",)))
    asked, marked = (name for name in names if "features" in name)
    loading.precompile_one(asked)
    assert asked == marked == names[-1]
    assert asked["first_hits"] and not jit.lost_cache()


def test_the_builder_of_light_trees_is_compiled_by_its_name_too(started: Path, tmp_path: Path, monkeypatch) -> None:
    from engine import loading

    monkeypatch.setattr(loading, "CACHE_FOLDER", tmp_path)
    loading._get_builder(np.zeros(1, np.uint8))
    loading._get_builder(np.zeros(1, np.uint8))
    assert [json.loads(line) for line in started.read_text().splitlines()] == [loading.TREE_BUILDER]
