"""What is said while kernels are compiled: which functions they need, and how many of them are there."""

from __future__ import annotations

import threading
from functools import cache
from pathlib import Path

import numba
import numpy as np
import pytest
import scenes

from engine import Interactive, PointLight, Progress, Settings, compilation, loading, render, tiles
from engine.compilation import ONCE, PREPARING, Compilation, functions_of
from engine.kernels.staged import make_staged_kernel
from engine.pack import pack
from engine.pack.lamps import MOST_LISTED_ROUND
from engine.result import Doing

PATIENCE = 120.0  # seconds: the first test of a fresh checkout compiles


@numba.njit
def third(x):
    return x + 1


@numba.njit
def second(x):
    return third(x) if x < 3 else first(x - 1)


@numba.njit
def first(x):
    return second(x)


@numba.njit
def unused(x):
    return x


def make_kernel(function):
    @numba.njit
    def kernel(x):
        return function(x) + third(x)

    return kernel


def test_functions_are_found_through_globals_and_closures():
    """Also where they call each other in a circle."""
    kernel, alone = make_kernel(first), make_kernel(unused)
    assert functions_of([kernel]) == {kernel, first, second, third}
    assert functions_of([kernel, alone]) == {kernel, alone, first, second, third, unused}
    assert functions_of([]) == set()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch) -> Path:
    """Where a file named as a function says that it is compiled."""
    monkeypatch.setattr(compilation, "_file", lambda function: str(tmp_path / function.py_func.__name__))
    return tmp_path


def test_steps_are_the_functions_that_are_there(folder):
    (folder / "third").touch()
    doing = Compilation([make_kernel(first)], is_kept=False)
    assert doing(0.0) == Doing(f"compiling: 1 of 4 functions, 0 s {ONCE}", (1, 4))
    (folder / "second").touch()
    assert doing(12.3) == Doing(f"compiling: 2 of 4 functions, 12 s {ONCE}", (2, 4))
    (folder / "first").touch()
    (folder / "kernel").touch()  # of other features, as far as one can see
    assert doing(75.0) == Doing(f"compiling: 3 of 4 functions, 75 s {ONCE}", (3, 4))


def test_a_compilation_of_its_own_says_what_it_is_of(folder):
    doing = Compilation([make_kernel(first)], is_kept=False, what=("compiling what sorts lights", "(once)"))
    assert doing(2.0) == Doing("compiling what sorts lights: 0 of 4 functions, 2 s (once)", (0, 4))


def test_what_is_kept_or_here_is_not_compiled(folder):
    kernel = make_kernel(unused)
    assert Compilation([kernel], is_kept=True)(1.0) == PREPARING
    assert Compilation([kernel], is_kept=True)(99.0) == PREPARING
    assert Compilation([kernel], is_kept=False)(1.0).steps == (0, 3)
    kernel(1)
    assert Compilation([kernel], is_kept=False)(1.0) == PREPARING
    assert Compilation([kernel, make_kernel(unused)], is_kept=False)(1.0).steps == (0, 4)


@pytest.fixture
def slow(tmp_path: Path, monkeypatch) -> threading.Event:
    """No kernel is kept or loaded, and it takes until this is set to have one."""
    told, load = threading.Event(), loading.load_kernel
    monkeypatch.setattr(loading, "CACHE_FOLDER", tmp_path)
    monkeypatch.setattr(tiles, "tile_kernel", cache(make_staged_kernel))

    def slowly(*arguments) -> None:
        assert told.wait(PATIENCE)
        load(*arguments)

    monkeypatch.setattr(loading, "load_kernel", slowly)
    return told


def test_a_render_tells_how_far_its_compilation_is(slow):
    seen: list[Progress] = []

    def progress(state: Progress) -> None:
        seen.append(state)
        if state.steps is not None:
            slow.set()

    render(scenes.plate(), Settings(samples=2), progress=progress)
    compiling = [state for state in seen if state.steps is not None]
    total = len(functions_of([tiles.tile_kernel(pack(scenes.plate(), Settings()).features)]))
    for state in compiling:
        done, of = state.steps
        assert 0 <= done < of == total and state.fraction == done / of
        assert state.message.startswith(f"compiling: {done} of {of} functions, ") and not state.is_tracing
    assert compiling and seen[-1].is_tracing and seen[-1].steps is None and seen[-1].fraction == 0.5 * seen[-1].samples


def test_once_it_is_kept_nothing_is_compiled(slow):
    slow.set()
    packed = pack(scenes.plate(), Settings())
    assert loading.compiling(packed)(1.0).steps is not None
    loading.load_kernel(packed, Settings())
    tiles.tile_kernel.cache_clear()  # as in another process
    assert loading.compiling(packed)(1.0) == PREPARING


def test_a_pass_counts_the_functions_of_both_kernels(slow):
    alone, both = (loading.compiling(pack(scenes.plate(), Settings(passes=names))) for names in ((), ("DEPTH",)))
    assert both(0.0).steps[1] > alone(0.0).steps[1]


def test_a_viewport_says_how_far_its_compilation_is(slow):
    said: list[str] = []
    finished = threading.Event()

    def changed() -> None:
        said.append(interactive.message)
        if interactive.message.startswith("compiling: "):
            slow.set()
        if interactive.picture is not None or interactive.error is not None:
            finished.set()

    interactive = Interactive(changed)
    try:
        interactive.show(scenes.plate(), Settings(samples=1))
        assert finished.wait(PATIENCE) and interactive.error is None
    finally:
        assert interactive.close(PATIENCE)
    assert any(text.endswith(ONCE) and " functions, " in text for text in said) and interactive.message == ""


def test_functions_for_c_are_compiled_once(monkeypatch, tmp_path: Path):
    """The first of all: that it is a compilation is said from its beginning on."""
    monkeypatch.setattr(loading, "CACHE_FOLDER", tmp_path)
    lamp = PointLight("lamp", scenes.place((0, 0, 1)), intensity=(1.0, 1.0, 1.0))
    scene = scenes.lit_plate([lamp] * (MOST_LISTED_ROUND + 1))
    for said in (Doing("compiling, 12 s (once)"), PREPARING):
        needed = list(loading.small_functions(scene, np.zeros(1, np.uint8)))[:2]  # and what builds light trees
        assert [doing(12.3) for doing, _ in needed] == [said, said]
        for _, load in needed:
            load()


def test_common_kernels_are_counted(monkeypatch, tmp_path: Path):
    """As the process in the background does, which Blender listens to. Once they are kept nothing is done."""
    monkeypatch.setattr(loading, "CACHE_FOLDER", tmp_path)
    done: list[tuple[int, int]] = []
    loaded: list[int] = []
    monkeypatch.setattr(loading, "load_kernel", lambda packed, settings: loaded.append(len(done)))
    monkeypatch.setattr(loading, "precompile_one", lambda name: loaded.append(len(done)))
    loading.precompile_common(lambda *counts: done.append(counts))
    total = len(done)
    assert done == [(number, total) for number in range(total)]
    assert loaded == [*range(1, total + 1), total]
    loading.precompile_common(lambda *counts: pytest.fail("compiled once more"))
    assert len(loaded) == total + 1


def test_common_kernels_that_fail_are_not_marked(monkeypatch, tmp_path: Path):
    def fail(packed, settings) -> None:
        raise MemoryError

    monkeypatch.setattr(loading, "CACHE_FOLDER", tmp_path)
    monkeypatch.setattr(loading, "load_kernel", fail)
    with pytest.raises(MemoryError):
        loading.precompile_common(lambda *_: None)
    assert not loading.elsewhere.is_marked(loading.COMMON, tmp_path)


def test_without_a_cache_nothing_is_compiled_for_it(monkeypatch):
    monkeypatch.setattr(loading, "lost_cache", lambda: "there is none")
    loading.precompile_common(lambda *_: pytest.fail("compiled for nothing"))
