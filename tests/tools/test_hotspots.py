"""The profile's table: which part of the kernel an address counts for."""

from __future__ import annotations

import importlib.util
import shutil
import time
from collections import Counter
from pathlib import Path

import pytest

from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

OTHER = "everything else"


@pytest.fixture(scope="module")
def hotspots(script):
    return script("hotspots")


@pytest.mark.parametrize(
    ("chain", "part"),
    [
        (["simd/memory.py:10", "light/tree.py:7", "light/emitters.py:1", "staged.py:3"], "light tree"),
        (["geom/vec.py:10", "bsdf/phong.py:7", "light/area.py:1", "staged.py:3"], "BSDFs"),
        (["light/environment.py:7"], "environment"),
        (["sampler/warp.py:3", "light/point.py:1"], "other light sampling"),
        (["staged.py:3"], "paths, their states"),
        (["simd/memory.py:10"], OTHER),
        ([], OTHER),
    ],
)
def test_a_sample_counts_for_the_part_that_asked(hotspots, chain: list[str], part: str) -> None:
    assert hotspots.part_of(chain) == part


def test_scenes_of_few_and_of_many(hotspots) -> None:
    """The same camera and light, exported for one thread, their number in the row."""
    numbers = hotspots.few_and_many(10**4)
    assert ("lamps", 100) in numbers and ("lamps", 10**4) in numbers and ("triangles", 10**4) in numbers
    assert ("triangles", 10**7) in hotspots.few_and_many(hotspots.parse([]).largest)
    scene, settings = hotspots.exported(["lamps", 100], (8, 6))  # a list after its way through JSON
    assert len(scene.lights) == 100 and (scene.width, scene.height, settings.threads) == (8, 6, 1)
    counted = Counter({hotspots.EMBREE: 60, "light tree": 30, hotspots.OTHER: 10})
    others = Counter({"f of libx.so": 7, "no line of the kernel": 3})
    row = hotspots.row(("lamps", 10**5), counted, others, 0.25, hotspots.parse([]))
    assert (row["scene"], row["number"], row["s a render"], row["samples"]) == ("lamps", "1e5", "0.2500", "100")
    assert (row["Embree"], row["light tree"], row["BSDFs"]) == ("60%", "30%", "0%")
    assert row["most of everything else"] == "f of libx.so (7.0%), no line of the kernel (3.0%)"
    assert "number" not in hotspots.row("lamps", counted, others, 0.25, hotspots.parse([]))


PERF = """\
 100.500000000:     7f0000001008 [unknown] (/tmp/perf-1.map)
 100.600000000:     7f0000001008 [unknown] (/tmp/perf-1.map)
  99.999999999:     7f0000001008 [unknown] (/tmp/perf-1.map)
 100.700000000:     7f0000002004 [unknown] (/tmp/perf-1.map)
 100.800000000:     7f0000009000 [unknown] (/tmp/perf-1.map)
 100.900000000:     7f1000000000 rtcIntersect8 (/a place/embreex.libs/libembree4-4aef.so.4)
 101.000000001:     7f1000000000 rtcIntersect8 (/a place/embreex.libs/libembree4-4aef.so.4)
 102.500000000:     7f2000000000 _PyEval_EvalFrameDefault (/lib/libpython3.11.so.1.0)
 102.500000000:     7f2000000000 PyArray_MultiplyList (/site-packages/numpy/core/_multiarray_umath.cpython-311.so)
 102.500000000:     7f3000000000 malloc (/usr/lib/libc.so.6)
 102.500000000: ffffffff81000000 handle_softirqs ([kernel.kallsyms])
 102.600000000:     7f4000000000 operator new(unsigned long) (/usr/lib/libstdc++.so.6)
what isn't a sample
"""


def test_samples_count_while_samples_are_taken_and_for_whose_code_they_are_in(hotspots, monkeypatch) -> None:
    """The kernel by its lines, the filter of lamps as a whole, the rest by its library; what is in none is named."""
    codes = [
        hotspots.Code("kernel.o", 0x7F0000001000, 0x1000, ""),
        hotspots.Code("noting.o", 0x7F0000002000, 0x100, hotspots.NOTING),
    ]
    monkeypatch.setattr(hotspots, "_chains", lambda file, offsets: {k: ["light/tree.py:1"] for k in offsets})
    samples = list(hotspots.parsed(PERF.splitlines()))
    assert len(samples) == 12 and samples[-1].symbol == "operator new(unsigned long)"
    counted, others = hotspots.parts(samples, codes, [(100.0, 101.0), (102.0, 103.0)])
    assert counted == {
        "light tree": 2, hotspots.NOTING: 1, hotspots.EMBREE: 1, "Python": 2, "C library": 1, "operating system": 1,
        OTHER: 2,
    }  # fmt: skip
    assert others == {"[unknown] of perf-1.map": 1, "operator new(unsigned long) of libstdc++.so.6": 1}


def test_what_a_method_does_is_noted(hotspots) -> None:
    class Render:
        def passes(self, seconds: float) -> float:
            time.sleep(seconds)
            return seconds

    with hotspots.noted_phases(Render, "passes") as phases:
        before = time.perf_counter()
        assert Render().passes(0.01) == 0.01
        after = time.perf_counter()
    Render().passes(0.0)
    ((begun, ended),) = phases
    assert before <= begun <= ended - 0.01 < ended <= after


@pytest.mark.skipif(not shutil.which("addr2line") or not shutil.which("nm"), reason="binutils are not installed")
def test_addresses_lead_to_the_files_that_were_inlined(hotspots, tmp_path: Path) -> None:
    """A small kernel in two files of a folder `kernels`: every address is in one of them, some of the inner one."""
    folder = tmp_path / "kernels"
    folder.mkdir()
    (folder / "inner.py").write_text(INNER)
    (folder / "outer.py").write_text(OUTER)
    inner = loaded(folder / "inner.py")
    outer = loaded(folder / "outer.py").made(inner.root)
    outer(2.0)
    (compiled,) = outer.overloads.values()
    file, name = tmp_path / "kernel.o", compiled.fndesc.llvm_func_name
    file.write_bytes(compiled.library._get_compiled_object())
    address = compiled.library.get_pointer_to_function(name)
    code = hotspots.code_of(file, name, address, "")
    offset = address - code.address
    assert 0 <= offset < code.size < file.stat().st_size
    chains = hotspots._chains(file, list(range(offset, code.size)))
    files = {tuple(line.partition(":")[0] for line in chain) for chain in chains.values()}
    assert ("inner.py", "outer.py") in files and ("outer.py",) in files


INNER = """
import math, numba
@numba.njit(forceinline=True, debug=True)
def root(x):
    return math.sqrt(x) * x
"""
OUTER = """
import numba
def made(root):
    @numba.njit(debug=True)
    def outer(x):
        total = x
        for i in range(int(x)):
            total += root(total + i)
        return total
    outer.enable_caching()
    return outer
"""


def loaded(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_part_is_of_files_that_are_there(hotspots, repository) -> None:
    kernels = repository / "engine" / "kernels"
    files = [path.relative_to(kernels).as_posix() for path in kernels.rglob("*.py")]
    for starts in hotspots.PARTS.values():
        for start in starts:
            assert any(file.startswith(start) for file in files), start
