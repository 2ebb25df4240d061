"""benchmarks/first_sample.py: where a process is, by made-up stacks, and one real look."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import pytest


@pytest.fixture(scope="module")
def first_sample(script):
    return script("first_sample")


def stack(*functions: tuple[str, str]):
    """Frames, the innermost first, each by file and function."""
    frame = None
    for file, function in reversed(functions):
        frame = SimpleNamespace(f_code=SimpleNamespace(co_filename=file, co_name=function), f_back=frame)
    return frame


def test_the_innermost_function_of_lobe_counts(first_sample):
    numpy, export = ("/site-packages/numpy/x.py", "sum"), ("/ext/lobe/addon/export/meshes.py", "export_mesh")
    session = ("/ext/lobe/addon/session.py", "update")
    assert first_sample.working({1: stack(numpy, export, session)}, 1) == "Blender's data to arrays"
    assert first_sample.working({1: stack(("/bpy/ops.py", "call"))}, 1) == first_sample.BLENDER


def test_where_one_waits_another_counts(first_sample):
    waits = stack(("/ext/lobe/engine/schedule.py", "wait_for"), ("/ext/lobe/addon/session.py", "render"))
    builds = stack(("/ext/lobe/engine/accel.py", "_join"), ("/ext/lobe/engine/pack/pack.py", "pack"))
    idle = stack(("/python/threading.py", "wait"))
    assert first_sample.working({1: waits, 2: idle, 3: builds}, 1) == "Embree's structure"
    assert first_sample.working({1: waits, 2: idle}, 1) == "kernel and its threads"


def test_all_time_is_spent_somewhere(first_sample):
    begun = time.perf_counter()
    with first_sample.Profile() as found:
        threading.Event().wait(0.05)
    took = time.perf_counter() - begun
    assert set(found.spent) == {first_sample.BLENDER}
    assert 0 < found.spent.total() <= took
