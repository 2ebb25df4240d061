"""Kernels become machine code for every processor that Lobe is shipped for, not only for the one that runs the tests.

LLVM ends the process where it can't, so each runs in a process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from llvmlite import binding

from engine.features import EVERYTHING, Features

# Of those without AVX, with AVX2, with AVX-512, and Apple's.
PROCESSORS = {
    "x86-64": "x86_64-unknown-linux-gnu",
    "nehalem": "x86_64-pc-windows-msvc",
    "haswell": "x86_64-pc-windows-msvc",
    "znver3": "x86_64-unknown-linux-gnu",
    "skylake-avx512": "x86_64-unknown-linux-gnu",
    "znver5": "x86_64-unknown-linux-gnu",
    "apple-m1": "arm64-apple-darwin22",
    "apple-m4": "arm64-apple-darwin22",
}

EMIT = """
from llvmlite import binding
binding.initialize_all_targets()
binding.initialize_all_asmprinters()
for code in codes:
    module = binding.parse_assembly(code)
    machine = binding.Target.from_triple({triple!r}).create_target_machine(cpu={cpu!r}, opt=3)
    module.triple, module.data_layout = {triple!r}, str(machine.target_data)
    print(len(machine.emit_object(module)))
"""

VECTORS = """
import sys
sys.path.insert(0, "tests/kernels")
import numpy as np
import test_simd as vectors
x, out = np.zeros((3, vectors.N), np.float32), np.zeros((6, vectors.N), np.float32)
vectors.arithmetic(x, out)
vectors.moved(x, np.float32(0), out)
vectors.in_parts(x, np.zeros((2, 3, 8), np.float32), np.zeros((4, 3, 4), np.float32), out)
kernels = vectors.arithmetic, vectors.moved, vectors.in_parts
"""

# The largest kernel: with all that a scene may have, and where shadow rays see other objects, what that takes besides.
LARGEST = Features(**EVERYTHING, holdout=1, transparent_film=1, light_passes=1, shared_light=0)
ALIKE = ("orthographic", "hemisphere", "lobe_selection", "shared_light")  # either choice is as much code, or less

WHOLE = """
from engine import loading, tiles
from engine.features import Features
features = Features(**{features})
loading.precompile_one({{"features": features._asdict(), "first_hits": True}})
kernels = tiles.tile_kernel(features), tiles.first_hit_kernel(tiles.seen_first(features))
"""

RENDER = """
import sys
sys.path.insert(0, "tests")
import numpy as np
import scenes
from engine import Settings, render
np.save(sys.argv[1], render(scenes.phong_plates(), Settings(samples=4, threads=2)).pixels)
"""


def run(code: str, repository, folder, *arguments, **environment: str) -> str:
    """What a fresh Python without compiled kernels prints."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        cwd=repository,
        env={**os.environ, "LOBE_CACHE_DIR": str(folder), **environment},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def emitted(repository, tmp_path_factory):
    """Function from a script that makes `kernels`, a processor and its triple to the bytes of machine code of each.
    The intermediate code is made once for each script."""
    made = {}

    def emit(script: str, cpu: str, triple: str) -> list[int]:
        if script not in made:
            made[script] = tmp_path_factory.mktemp("code")
            save = """
for number, one in enumerate(kernels):
    with open(f"{sys.argv[1]}/{number}.ll", "w") as file:
        file.write(next(iter(one.inspect_llvm().values())))
"""
            run("import sys\n" + script + save, repository, tmp_path_factory.mktemp("cache"), made[script])
        read = f"import pathlib\ncodes = [p.read_text() for p in sorted(pathlib.Path({str(made[script])!r}).iterdir())]"
        return [int(size) for size in run(read + EMIT.format(cpu=cpu, triple=triple), repository, made[script]).split()]

    return emit


@pytest.mark.parametrize("cpu", PROCESSORS)
def test_vectors_become_machine_code(emitted, cpu) -> None:
    sizes = emitted(VECTORS, cpu, PROCESSORS[cpu])
    assert len(sizes) == 3 and min(sizes) > 1000


def test_nothing_is_missing_from_the_largest_kernel() -> None:
    for name in {*Features._fields} - {*ALIKE}:
        assert getattr(LARGEST, name), name


@pytest.mark.long
@pytest.mark.parametrize("cpu", PROCESSORS)
def test_the_largest_kernel_becomes_machine_code(emitted, cpu) -> None:
    sizes = emitted(WHOLE.format(features=LARGEST._asdict()), cpu, PROCESSORS[cpu])
    assert len(sizes) == 2 and min(sizes) > 10_000


@pytest.mark.long
@pytest.mark.parametrize("cpu", ["x86-64", "haswell"])
def test_the_picture_is_that_of_another_processor(repository, tmp_path, cpu) -> None:
    import numpy as np

    if "x86_64" not in binding.get_process_triple() or not binding.get_host_cpu_features().get("avx2"):
        pytest.skip("this processor runs no code of the other")
    run(RENDER, repository, tmp_path / "own", tmp_path / "own.npy")
    run(RENDER, repository, tmp_path / cpu, tmp_path / "other.npy", NUMBA_CPU_NAME=cpu, NUMBA_CPU_FEATURES="")
    own, other = np.load(tmp_path / "own.npy"), np.load(tmp_path / "other.npy")
    differ = ~np.isclose(own, other, rtol=1e-3, atol=1e-4).all(-1)
    assert differ.mean() < 0.01  # roundings send a few paths elsewhere
    assert own.mean() == pytest.approx(other.mean(), rel=0.01)
