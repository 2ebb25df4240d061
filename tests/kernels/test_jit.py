"""Where compiled kernels are kept: never a crash for want of a folder, nor a folder that grows without end."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numba
import pytest
from numba.core.registry import cpu_target

from engine.kernels import jit

SHOW = "from engine.kernels import jit; print(jit.CACHE_FOLDER)"
OTHER = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}  # as Numba takes every processor's to be


def run(code: str, repository: Path, **environment: str) -> str:
    """What a fresh Python prints."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=repository,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def unwritable(tmp_path: Path) -> Path:
    """A path where no folder can be made, not even by root: a file stands in the way."""
    (tmp_path / "file").touch()
    return tmp_path / "file"


def test_the_folder_is_the_one_that_was_chosen(repository, tmp_path) -> None:
    folder = Path(run(SHOW, repository, LOBE_CACHE_DIR=str(tmp_path)))
    assert folder.parent == tmp_path / "kernels"
    assert folder.is_dir()
    assert not jit.lost_cache()  # of this process


def test_a_folder_that_cannot_be_written_is_replaced(repository, tmp_path) -> None:
    folder = Path(run(SHOW, repository, LOBE_CACHE_DIR=str(unwritable(tmp_path)), TMPDIR=str(tmp_path)))
    assert folder.is_relative_to(tmp_path)
    assert folder.is_dir()


def test_kernels_compile_where_no_folder_can_be_kept(repository, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("LOBE_CACHE_DIR", str(unwritable(tmp_path)))
    monkeypatch.setattr(jit, "_is_writable", lambda folder: False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    folder = jit._cache_folder()
    assert folder.is_dir()
    assert folder.parent == tmp_path
    monkeypatch.setattr(jit, "CACHE_FOLDER", folder)
    assert jit.kernel(lambda x: x + 1)(1) == 2
    assert jit.lost_cache() == (
        f"compiled kernels are lost at the end, as {str(tmp_path / 'file')!r} and {str(tmp_path)!r} can't be written to"
    )
    jit._prune(folder)  # which has no brothers to delete
    assert folder.is_dir()


def test_the_temporary_folder_is_the_users_alone(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(jit.tempfile, "tempdir", str(tmp_path))
    monkeypatch.delenv("LOBE_CACHE_DIR", raising=False)
    folder = jit._cache_folder()
    (ours,) = tmp_path.iterdir()
    assert folder.is_relative_to(ours) and ours.stat().st_mode & 0o777 == 0o700


def test_what_others_put_there_is_not_used(tmp_path, monkeypatch) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / f"lobe-cache-{jit._user()}").symlink_to(tmp_path / "elsewhere")
    monkeypatch.setattr(jit.tempfile, "tempdir", str(tmp_path))
    monkeypatch.delenv("LOBE_CACHE_DIR", raising=False)
    folder = jit._cache_folder()
    assert folder.is_dir() and not folder.is_relative_to(tmp_path / f"lobe-cache-{jit._user()}")


def test_old_versions_are_deleted(tmp_path) -> None:
    folders = [tmp_path / "kernels" / f"version {i}" for i in range(6)]
    for i, folder in enumerate(folders):
        folder.mkdir(parents=True)
        (folder / "kernel.nbi").touch()
        os.utime(folder, (i, i))
    jit._prune(folders[1])  # in use, so the newest
    assert sorted(f.name for f in (tmp_path / "kernels").iterdir()) == ["version 1", "version 4", "version 5"]


@pytest.mark.parametrize("package", ["numba", "llvmlite", "embreex"])
def test_another_version_of_a_package_is_another_folder(monkeypatch, package: str) -> None:
    before = jit._source_hash()
    monkeypatch.setattr(getattr(jit, package), "__version__", "0.0")
    assert jit._source_hash() != before


@pytest.mark.parametrize("variable", ["NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"])
def test_another_processor_is_another_folder(repository, tmp_path, variable: str) -> None:
    """So that what says that a kernel is kept speaks of code for this one."""
    name, features = jit.cpu_target.target_context.codegen().magic_tuple()[1:]
    others = {"NUMBA_CPU_NAME": name, "NUMBA_CPU_FEATURES": features}
    same = run(SHOW, repository, LOBE_CACHE_DIR=str(tmp_path), **others)
    other = run(SHOW, repository, LOBE_CACHE_DIR=str(tmp_path), **{**others, variable: OTHER[variable]})
    assert Path(same).name == jit._source_hash() != Path(other).name


def test_the_cache_of_others_stays_their_own() -> None:
    before = numba.config.CACHE_DIR
    assert str(jit.CACHE_FOLDER) != before
    compiled = jit.kernel(test_the_cache_of_others_stays_their_own)
    assert compiled.stats.cache_path.startswith(str(jit.CACHE_FOLDER))
    assert before == numba.config.CACHE_DIR


def test_functions_for_kernels_get_no_machine_code() -> None:
    """It would never run, and makes the first compilation take a third longer. What others compile keeps theirs."""

    def called(x):
        return x * x + 1.0

    inner = jit.device(called)
    outer = numba.njit(lambda x: inner(x) + 2.0)
    assert outer(3.0) == 12.0
    engine = cpu_target.target_context.codegen()._engine

    def has_machine_code(dispatcher) -> bool:
        (compiled,) = dispatcher.overloads.values()
        return engine.is_symbol_defined(compiled.fndesc.mangled_name)

    assert has_machine_code(outer)
    assert not has_machine_code(inner)


def test_two_that_write_at_once_get_files_of_their_own() -> None:
    """Numba looks for a free number and takes it later, as two processes that compile may do at the same moment."""
    file = jit.kernel(lambda x: x + 2)._cache._cache_file
    load_index = file._load_index

    def load_slowly():
        index = load_index()
        time.sleep(0.1)
        return index

    file._load_index = load_slowly
    threads = [threading.Thread(target=file.save, args=(key, f"code of {key}")) for key in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [file.load(key) for key in "abc"] == ["code of a", "code of b", "code of c"]
