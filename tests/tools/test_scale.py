"""benchmarks/scale.py: its figures on made-up renders whose truth is known, its scenes' arrays, and one small run."""

from __future__ import annotations

import csv
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from engine.pack.lamps import MOST_LISTED_FLAT
from tools import metrics
from tools.lobe_blender import enable_lobe


@pytest.fixture(scope="module")
def scale(script):
    return script("scale")


def reports(*totals: float, **phases: float) -> list[dict]:
    return [{"seconds": {"export": 0.0, "build": 0.0, "total": total, "render": total, **phases}} for total in totals]


def test_logarithm_and_growth(scale):
    counts = [10, 100, 1000]
    assert metrics.logarithm(counts, [2.0, 2.5, 3.0]) == pytest.approx((2.0, 0.5, 0.0))
    assert metrics.logarithm(counts, [1.0, 2.0, 5.0])[2] > 0.2
    assert scale.growth(counts, [1.0, 10.0, 1000.0]) == pytest.approx([math.nan, 1.0, 2.0], nan_ok=True)


def test_steps_go_forth_and_back_after_a_warm_up(scale):
    order: list[str] = []

    def step(name: str):
        return lambda: order.append(name) or {"number": len(order)}

    found = scale.in_turn({"a": step("a"), "b": step("b")}, 2, "test")
    assert "".join(order) == "abbaab"
    assert found == {"a": [{"number": 4}, {"number": 5}], "b": [{"number": 3}, {"number": 6}]}


def test_numbers_are_short(scale):
    assert [scale.short(n) for n in (100, 500_000, 10**7)] == ["1e2", "5e5", "1e7"]


def test_preparation_leaves_out_what_blender_takes(scale):
    found = {"IDLE": reports(1.0, 1.0), "LOBE": reports(2.0, 3.0, export=0.25), "CYCLES": reports(3.0, 5.0)}
    row = scale.preparation(found)
    assert row["Lobe / Cycles"] == "0.50 (0.50 to 0.50)"
    assert (row["evaluation, s"], row["Lobe, s"], row["Cycles, s"]) == ("1.000", "1.500", "3.000")
    assert row["Lobe: export, s"] == "0.250"


def test_rows_of_triangles(scale):
    counts, options = (1000, 10_000), scale.parse(["triangles", "--runs", "2"])
    found = {}
    for name, idle, lobe, cycles, render in (("1e3", 1.0, 1.5, 2.0, 4.0), ("1e4", 1.0, 6.0, 3.5, 5.0)):
        found |= {(name, "IDLE"): reports(idle, idle), (name, "LOBE"): reports(lobe, lobe)}
        found |= {(name, "CYCLES"): reports(cycles, cycles), (name, "render"): reports(render, render)}
    first, second = scale.triangle_rows(counts, found, options)
    assert second["render / that of 1e3"] == "1.25 (1.25 to 1.25)"
    assert (first["Lobe / Cycles"], second["Lobe / Cycles"]) == ("0.50 (0.50 to 0.50)", "2.00 (2.00 to 2.00)")
    assert (first["Lobe grows with the power"], second["Lobe grows with the power"]) == ("", "1.00")
    assert first[scale.FULL] == second[scale.FULL] == ""
    found["1e4", scale.FULL] = reports(4.4, 4.4)
    _, second = scale.triangle_rows(counts, found, options)
    assert second[scale.FULL] == "1.10 (1.10 to 1.10)"
    assert "1.00 + 0.250 log10(triangles / 1e3)" in scale.triangle_note(counts, found)
    assert "1e5, 1e6, 1e7" in scale.triangle_note(counts, found)


def test_scenes_that_do_not_fit_are_left_out(scale):
    assert scale.affordable([10, 100, 1000], 100 * scale.BYTES_A_TRIANGLE) == [10, 100]
    assert scale.parse(["all", "--largest", "10000"]).triangles == [1000, 10_000]


@pytest.mark.parametrize("count", [1000, 10_000])
def test_the_terrain_has_about_so_many_triangles_and_one_shape(scale, count):
    scenes = scale.scenes
    assert abs(scenes.terrain_triangles(count) / count - 1) < 0.05
    vertices, faces = scenes.grid(scenes.quads_per_side(count))
    assert 2 * len(faces) == scenes.terrain_triangles(count)
    assert faces.max() == len(vertices) - 1
    x, y, z = vertices.T
    assert np.allclose(z, 0.15 * np.sin(4 * x + 1) * np.cos(3.5 * y), atol=1e-6)
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] > 0).all()


@pytest.mark.parametrize("count", [100, 5000])
def test_small_triangles_share_one_area(scale, count):
    vertices, faces = scale.scenes.small_triangles(count)
    a, b, c = vertices[faces].astype(float).transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    assert len(area) == count
    assert area.sum() == pytest.approx(scale.scenes.EMITTER_AREA, rel=1e-3)
    assert np.ptp(area) < 0.01 * area.mean()


def test_a_small_run_leaves_its_tables(repository: Path, tmp_path: Path) -> None:
    """Every question but the one about the sample scenes, with the smallest scene of each."""
    for question in ("triangles", "instances", "emitters"):
        words = [question, "--runs", "1", "--largest", "1000", "--resolution", "16x16", "--samples", "1"]
        command = [sys.executable, "benchmarks/scale.py", *words, "--results", str(tmp_path)]
        done = subprocess.run(command, cwd=repository, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        with (tmp_path / f"scale_{question}.csv").open(newline="") as file:
            assert list(csv.DictReader(file))


def test_lamps_are_listed_and_traced_on_both_sides_of_each_limit(repository: Path, tmp_path: Path) -> None:
    """A row for each number up to the largest that was asked for; every render really takes its way."""
    words = ["--runs", "1", "--largest", "100", "--resolution", "8x8", "--samples", "1", "--results", str(tmp_path)]
    done = subprocess.run([sys.executable, "-c", LISTED, *words], cwd=repository, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "scale_listed.csv").open(newline="") as file:
        rows = [(row["lamps"], int(row["number"]), row["the engine"] == "lists them") for row in csv.DictReader(file)]
    flat = [("area lamps", count, count <= MOST_LISTED_FLAT) for count in (4, 8, 16, 32, 64)]
    assert sorted(rows) == sorted([*flat, ("lamps", 32, True), ("lamps", 64, True)])
    packed = [line.split() for line in done.stderr.splitlines() if line.startswith("packed ")]
    assert len(packed) == 2 * 2 * len(rows)  # both ways, in the round that warms up and in the one that counts
    for _, lamps, most in packed:
        assert most in (lamps, "0")


# Says of each render how many lamps are listed, and how many may be.
LISTED = """
import sys
sys.path[:0] = ["benchmarks", "."]
import scale
sys.argv[1:1] = ["listed"]
def told(scene, most, options, render=scale.render_with_lists):
    from unittest import mock
    from bl_ext.user_default.lobe.engine.pack import lights
    pack = lights.lamps_that_rays_meet
    def packed(kinds, rows, masks):
        listed, traced = pack(kinds, rows, masks)
        assert (len(listed), len(traced)) == ((most, 0) if most else (0, len(kinds)))
        seen.append(f"packed {len(kinds)} {len(listed)}")
        return listed, traced
    with mock.patch.object(lights, "lamps_that_rays_meet", packed):
        return render(scene, most, options)
seen = []
scale.render_with_lists = told
code = scale.main()
print("\\n".join(seen), file=sys.stderr)  # Blender has taken standard output
sys.exit(code)
"""


def test_leaves_of_huge_meshes_are_rendered_full_too(scale, monkeypatch):
    """Where the engine takes the compact ones; and only in that render."""
    enable_lobe()
    from bl_ext.user_default.lobe.engine import accel

    asked: list[tuple[str, float]] = []
    monkeypatch.setattr(scale, "render", lambda scene, *_: asked.append((scene, accel._MOST_IN_FULL)))
    assert [count for count in scale.TRIANGLES if scale.has_compact_leaves(count)] == [10**7]
    usual = accel._MOST_IN_FULL
    scale.render_with_full_leaves("terrain", scale.parse(["triangles"]))
    assert asked == [("terrain", math.inf)] and usual == accel._MOST_IN_FULL


def test_tiles_without_pixels_are_all_taken(scale, monkeypatch):
    """By one thread and by many; the render's own are counted."""
    enable_lobe()
    from bl_ext.user_default.lobe.engine import tiles

    taken: list[int] = []
    one_thread = tiles.render_tiles

    def counting(packed, settings, film, adaptive, shared, *rest):
        own = list(shared)
        taken.append(len(own))
        return one_thread(packed, settings, film, adaptive, iter(own), *rest)

    monkeypatch.setattr(tiles, "render_tiles", counting)
    options = scale.parse(["threads", "--runs", "1", "--resolution", "64x64", "--samples", "2"])
    count, by_one, by_many = scale.handing_out("lamps", options)
    assert count == 4  # a batch of paths in each
    assert sum(taken) == 3 * scale.EMPTY_TILES and len(taken) == 2 + scale.CROWD
    assert by_one > 0 and by_many > 0


def test_two_processes_take_as_long_as_the_slower(scale):
    told: list[str] = []

    class Made:
        def __init__(self, seconds: float):
            self._seconds = seconds

        def begin(self) -> None:
            told.append("begin")

        def end(self) -> float:
            told.append("end")
            return self._seconds

    assert scale.longest([Made(1.0), Made(3.0)]) == {"seconds": {"render": 3.0}}
    assert told == ["begin", "begin", "end", "end"]  # both are at work at the same time
