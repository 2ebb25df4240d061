"""The profile's table: which part of the kernel an address counts for."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

from hotspots import OTHER, PARTS, part_of  # noqa: E402

KERNELS = ROOT / "engine" / "kernels"


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
def test_a_sample_counts_for_the_part_that_asked(chain: list[str], part: str) -> None:
    assert part_of(chain) == part


def test_every_part_is_of_files_that_are_there() -> None:
    files = [path.relative_to(KERNELS).as_posix() for path in KERNELS.rglob("*.py")]
    for starts in PARTS.values():
        for start in starts:
            assert any(file.startswith(start) for file in files), start
