"""The profile's table: which part of the kernel an address counts for."""

from __future__ import annotations

from collections import Counter

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
    row = hotspots.row(("lamps", 10**5), counted, 0.25, hotspots.parse([]))
    assert (row["scene"], row["number"], row["s a render"], row["samples"]) == ("lamps", "1e5", "0.2500", "100")
    assert (row["Embree"], row["light tree"], row["BSDFs"]) == ("60%", "30%", "0%")
    assert "number" not in hotspots.row("lamps", counted, 0.25, hotspots.parse([]))


def test_every_part_is_of_files_that_are_there(hotspots, repository) -> None:
    kernels = repository / "engine" / "kernels"
    files = [path.relative_to(kernels).as_posix() for path in kernels.rglob("*.py")]
    for starts in hotspots.PARTS.values():
        for start in starts:
            assert any(file.startswith(start) for file in files), start
