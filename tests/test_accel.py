"""Building ray tracing structures: on how many threads."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import scenes

from engine import Settings, accel
from engine.accel import Accel
from engine.pack import pack
from engine.pack.geometry import pack_geometry


@pytest.mark.parametrize(("threads", "processors", "most"), [(1, 8, 1), (3, 8, 3), (5, 2, 2)])
def test_a_scene_is_built_by_as_many_threads_as_are_asked_for(monkeypatch, threads, processors, most):
    """And by none of Embree's own, which would know nothing of that number."""
    packed = pack_geometry(scenes.furnace(mesh=scenes.sphere_mesh(200)))
    assert len(packed.shapes) == 1 and len(packed.shapes[0].triangles) > most * accel.PRIMITIVES_PER_THREAD
    joined = []
    monkeypatch.setattr(accel, "usable_processors", lambda: processors)
    join = accel._join
    monkeypatch.setattr(accel, "_join", lambda scene: joined.append(scene) or join(scene))
    built = Accel(packed.shapes, None, threads)
    assert joined == [built.address] * most


def test_few_triangles_are_built_by_one_thread(monkeypatch):
    joined = []
    join = accel._join
    monkeypatch.setattr(accel, "_join", lambda scene: joined.append(scene) or join(scene))
    Accel(pack_geometry(scenes.furnace()).shapes, None, 2)
    assert len(joined) == 1


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="only Linux lists a process's threads")
def test_embree_starts_no_threads_of_its_own(repository):
    """In a fresh process, with an Embree that believes in more processors than there may be."""
    code = """
import os, sys
sys.path.insert(0, "tests")
import scenes
from engine import accel
from engine.pack.geometry import pack_geometry
accel.usable_processors = lambda: 8
shapes = pack_geometry(scenes.furnace(mesh=scenes.sphere_mesh(300))).shapes
before = set(os.listdir("/proc/self/task"))
accel.Accel(shapes, None, 1)
print(len(set(os.listdir("/proc/self/task")) - before))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=repository, capture_output=True, text=True, check=True)
    assert done.stdout == "0\n"


def test_the_render_builds_with_its_threads(monkeypatch):
    asked = []
    monkeypatch.setattr("engine.pack.Accel", lambda shapes, halt, threads: asked.append(threads) or Accel(shapes))
    pack(scenes.cornell(8), Settings(threads=3))
    monkeypatch.setattr("engine.settings.usable_processors", lambda: 7)
    pack(scenes.cornell(8), Settings(threads=0))
    assert asked == [3, 7]
