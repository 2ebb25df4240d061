"""The process that compiles in the background: what it is told, when it starts, and that it goes away."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.lobe_blender import MODULE


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
    assert not list(tmp_path.glob("precompiled-*"))


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


def test_it_runs_once_for_the_same_kernels(precompile, tmp_path: Path) -> None:
    Path(precompile._stamp(str(tmp_path))).touch()
    precompile.start()
    assert precompile._process is None


def test_it_compiles_under_the_names_that_blender_uses(precompile, tmp_path: Path) -> None:
    extension = tmp_path / "lobe"
    (extension / "engine").mkdir(parents=True)
    (extension / "__init__.py").touch()
    (extension / "engine" / "__init__.py").write_text("def precompile(kernel):\n    print(__name__, repr(kernel))\n")
    command = [sys.executable, precompile.__file__, MODULE, str(extension)]
    done = subprocess.run([*command, "", str(tmp_path / "stamp")], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"{MODULE}.engine ''"
    done = subprocess.run([*command, "a kernel"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"{MODULE}.engine 'a kernel'"
    assert (tmp_path / "stamp").exists()


def test_a_failure_leaves_no_stamp(precompile, tmp_path: Path) -> None:
    command = [sys.executable, precompile.__file__, MODULE, str(tmp_path / "nothing"), "", str(tmp_path / "stamp")]
    assert subprocess.run(command, capture_output=True).returncode != 0
    assert not (tmp_path / "stamp").exists()


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


def test_the_engine_has_a_kernel_compiled_by_the_same_process(precompile, tmp_path: Path) -> None:
    """As it is where there is a window: the kernel comes from a process that knows nothing but its name."""
    engine = sys.modules[f"{MODULE}.engine"]
    engine.compile_elsewhere(precompile._command(), {**precompile._environment(), "LOBE_CACHE_DIR": str(tmp_path)})
    elsewhere = sys.modules[f"{MODULE}.engine.elsewhere"]
    name = {"features": {"emitter_choice": 0}, "first_hits": False}
    try:
        elsewhere.compiled(name, tmp_path, bool)
    finally:
        engine.compile_elsewhere(())
    (folder,) = (tmp_path / "kernels").iterdir()
    assert list(folder.glob("*.compiled")), "the process marks what it has compiled"
    assert list(folder.rglob("*.nbc")), "and leaves the code"
