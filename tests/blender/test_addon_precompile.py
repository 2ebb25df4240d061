"""The process that compiles in the background: what it is told, when it starts, and that it goes away."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import time
from pathlib import Path

import bpy
import pytest

from tools.lobe_blender import MODULE

PATIENCE = 60.0  # seconds


@pytest.fixture
def precompile(tmp_path, monkeypatch):
    """The module, with a cache folder of its own and no process."""
    module = sys.modules[f"{MODULE}.addon.precompile"]
    monkeypatch.setenv(module.CACHE_VARIABLE, str(tmp_path))
    assert module._process is None  # without a window it isn't started
    yield module
    module.stop()


def test_it_can_be_stopped_at_once(precompile, tmp_path: Path) -> None:
    precompile.start()
    process = precompile._process
    assert process.poll() is None
    precompile.stop()
    assert process.returncode not in (None, 0)
    assert precompile._process is None
    assert not (tmp_path / precompile.FAILED).exists()


def test_a_cache_folder_that_is_not_there_is_made(precompile, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv(precompile.CACHE_VARIABLE, str(tmp_path / "new" / "cache"))
    precompile.start()
    assert precompile._process is not None
    precompile.stop()


def test_a_cache_folder_that_cannot_be_is_no_error(precompile, tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv(precompile.CACHE_VARIABLE, str(tmp_path / "file" / "cache"))
    precompile.start()
    assert precompile._process is None


@pytest.mark.parametrize("executable", ["", None, "/usr/bin/blender"])
def test_without_a_python_there_is_no_process(precompile, executable, monkeypatch) -> None:
    monkeypatch.setattr(sys, "executable", executable)
    precompile.start()
    assert precompile._process is None


def runs(precompile, monkeypatch, code: str) -> None:
    """In place of what compiles."""
    monkeypatch.setattr(precompile, "_command", lambda: [sys.executable, "-c", code])


def test_one_process_for_all_blenders(precompile, tmp_path: Path, monkeypatch) -> None:
    """The second one starts none, and leaves the first one's log alone."""
    runs(precompile, monkeypatch, "print('first', flush=True); import time; time.sleep(60)")
    precompile.start()
    log, first = tmp_path / precompile.LOG, precompile._process
    deadline = time.perf_counter() + PATIENCE
    while "first" not in log.read_text() and time.perf_counter() < deadline:
        time.sleep(0.01)
    assert precompile._locked(str(log)) is None
    assert log.read_text().strip() == "first"
    precompile.stop()
    assert first.returncode not in (None, 0)
    with precompile._locked(str(log)) as other:
        precompile.start()
        assert precompile._process is None
    assert other.closed and log.read_text() == ""
    precompile.start()
    assert precompile._process is not None


@pytest.mark.skipif(sys.platform == "win32", reason="there the lock ends with Blender")
def test_a_process_that_outlives_its_blender_stays_the_only_one(precompile, tmp_path: Path, monkeypatch) -> None:
    runs(precompile, monkeypatch, "import time; time.sleep(60)")
    precompile.start()
    precompile._close_log()
    assert precompile._locked(str(tmp_path / precompile.LOG)) is None


def ended(precompile) -> str:
    """What is said once the process has ended."""
    precompile._process.wait(PATIENCE)
    assert precompile._look() is None and precompile._process is None
    return precompile.said()


@pytest.mark.parametrize("failure", ["raise SystemExit('why')", "print('why', flush=True); import os; os.abort()"])
def test_a_failure_is_told_and_its_log_kept(precompile, tmp_path: Path, monkeypatch, failure: str) -> None:
    runs(precompile, monkeypatch, failure)
    precompile.start()
    kept = tmp_path / precompile.FAILED
    assert ended(precompile) == f"Compiling in the background failed, see {kept}"
    assert kept.read_text().strip() == "why"
    precompile.stop()
    assert precompile.said() == ""


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such signals there")
def test_who_logs_out_is_told_of_no_failure(precompile, tmp_path: Path, monkeypatch) -> None:
    runs(precompile, monkeypatch, "import os, signal; os.kill(os.getpid(), signal.SIGTERM)")
    precompile.start()
    assert ended(precompile) == "" and not (tmp_path / precompile.FAILED).exists()


def test_it_says_how_far_it_is(precompile, tmp_path: Path, monkeypatch) -> None:
    """While it runs, and panels are drawn again whenever that changes."""
    more, drawn = tmp_path / "more", []
    code = f"""
import os, sys, time
def wait_for(path):
    while not os.path.exists(path):
        time.sleep(0.01)
print("numba says something", flush=True)
wait_for({str(more)!r})
print({precompile.DONE.format(0, 11)!r}, {precompile.DONE.format(4, 11)!r}, sep="\\n", flush=True)
wait_for({str(more)!r} + " and more")
"""
    runs(precompile, monkeypatch, code)
    report = importlib.import_module(f"{MODULE}.addon.scene_report")
    monkeypatch.setattr(report, "redraw_properties", lambda: drawn.append(precompile.said()))
    assert precompile.said() == ""
    precompile.start()
    assert bpy.app.timers.is_registered(precompile._look)
    assert precompile._look() and precompile._look() and precompile.said() == ""  # it may have nothing to do
    more.touch()
    deadline = time.perf_counter() + PATIENCE
    while precompile.said() == "" and time.perf_counter() < deadline:
        assert precompile._look()
    Path(f"{more} and more").touch()
    assert precompile._process.wait(PATIENCE) == 0
    assert precompile._look() is None and precompile.said() == ""
    assert drawn == ["Compiling in the background: 4 of 11", ""]


def test_once_it_is_stopped_nothing_is_said(precompile, monkeypatch) -> None:
    monkeypatch.setattr(precompile, "_said", "Compiling in the background: 4 of 11")
    precompile.start()
    precompile.stop()
    assert precompile.said() == "" and not bpy.app.timers.is_registered(precompile._look)


def test_without_its_log_it_runs_on(precompile, tmp_path: Path) -> None:
    precompile.start()
    (tmp_path / precompile.LOG).unlink()
    assert precompile._look() and precompile.said() == ""


def test_it_compiles_under_the_names_that_blender_uses(precompile, tmp_path: Path) -> None:
    extension = tmp_path / "lobe"
    (extension / "engine").mkdir(parents=True)
    (extension / "__init__.py").touch()
    (extension / "engine" / "__init__.py").write_text(
        "def precompile(kernel, progress):\n    progress(3, 11)\n    print(__name__, repr(kernel))\n"
        "def kernel_folder():\n    return 'folder of these kernels'\n"
    )

    def said(kernel: str) -> list[str]:
        command = [sys.executable, precompile.__file__, MODULE, str(extension), kernel]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()

    title, *lines = said("")
    assert title.endswith(", folder of these kernels")
    assert lines == [precompile.DONE.format(3, 11), f"{MODULE}.engine ''"]
    # Where the same has failed it isn't tried again; what a scene needs is.
    failed = tmp_path / precompile.FAILED
    failed.write_text(f"{title}\nno memory\n")
    assert said("") == []
    assert said("a kernel")[-1] == f"{MODULE}.engine 'a kernel'"
    failed.write_text(f"{title} of before\nno memory\n")
    assert said("")[1:] == lines


def test_the_cache_folder_is_set_and_taken_back(precompile, monkeypatch) -> None:
    monkeypatch.delenv(precompile.CACHE_VARIABLE)
    precompile.register()
    folder = os.environ[precompile.CACHE_VARIABLE]
    assert Path(folder).is_dir()
    assert Path(folder).is_relative_to(os.environ["BLENDER_USER_RESOURCES"])
    precompile.unregister()
    assert precompile.CACHE_VARIABLE not in os.environ


def test_a_cache_folder_that_the_user_chose_stays(precompile, tmp_path: Path) -> None:
    precompile.register()
    precompile.unregister()
    assert os.environ[precompile.CACHE_VARIABLE] == str(tmp_path)


@pytest.fixture(scope="module")
def compilation():
    """The engine's module. It is loaded here, before another test's cache folder is set: it would be the engine's."""
    importlib.import_module(f"{MODULE}.engine.loading")
    return sys.modules[f"{MODULE}.engine.compilation"]


def test_the_engine_has_a_kernel_compiled_by_the_same_process(
    compilation, precompile, tmp_path: Path, monkeypatch
) -> None:
    """As it is where there is a window: the kernel comes from a process that knows nothing but its name. Meanwhile one
    sees how many functions it has compiled, which are those that were expected."""
    engine, loading = (sys.modules[f"{MODULE}.{name}"] for name in ("engine", "engine.loading"))
    kernel = loading.tiles.make_staged_kernel(loading.Features())
    needed, own = compilation.functions_of([kernel]), compilation._file

    def there(function) -> str:
        return str(tmp_path / "kernels" / Path(own(function)).relative_to(loading.CACHE_FOLDER.parent))

    monkeypatch.setattr(compilation, "_file", there)
    doing = compilation.Compilation([kernel], is_kept=False)
    steps = [doing(0.0).steps]
    engine.compile_elsewhere(precompile._command(), {**precompile._environment(), "LOBE_CACHE_DIR": str(tmp_path)})
    elsewhere = sys.modules[f"{MODULE}.engine.elsewhere"]
    name = {"features": {"emitter_choice": 0}, "first_hits": False}
    try:
        elsewhere.compiled(name, tmp_path, lambda: steps.append(doing(0.0).steps))
    finally:
        engine.compile_elsewhere(())
    (folder,) = (tmp_path / "kernels").iterdir()
    assert list(folder.glob("*.compiled")), "the process marks what it has compiled"
    assert list(folder.rglob("*.nbc")), "and leaves the code"
    total = len(needed)
    assert steps[0] == (0, total) and steps == sorted(steps) and len(set(steps)) > 3
    assert doing(0.0).steps == (total - 1, total)
    others = {path.name for path in folder.rglob("*.nbi")} - {Path(there(function)).name for function in needed}
    assert not others
