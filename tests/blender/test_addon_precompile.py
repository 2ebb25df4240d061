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


def test_it_runs_once_for_the_same_kernels(precompile, tmp_path: Path) -> None:
    Path(precompile._stamp(str(tmp_path))).touch()
    precompile.start()
    assert precompile._process is None


def test_it_compiles_under_the_names_that_blender_uses(precompile, tmp_path: Path) -> None:
    extension = tmp_path / "lobe"
    (extension / "engine").mkdir(parents=True)
    (extension / "__init__.py").touch()
    (extension / "engine" / "__init__.py").write_text("def precompile():\n    print(__name__)\n")
    command = [sys.executable, precompile.__file__, MODULE, str(extension), str(tmp_path / "stamp")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"{MODULE}.engine"
    assert (tmp_path / "stamp").exists()


def test_a_failure_leaves_no_stamp(precompile, tmp_path: Path) -> None:
    command = [sys.executable, precompile.__file__, MODULE, str(tmp_path / "nothing"), str(tmp_path / "stamp")]
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
