"""`tools/bench.py --ceiling`: the rays of a render, recorded and traced again."""

from __future__ import annotations

import csv
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tools.blender_render import ToolError
from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

from benchmarks import ceiling  # noqa: E402


def test_rays_are_recorded_whole_and_replayed(repository: Path, tmp_path: Path) -> None:
    """The tool itself refuses a recording that isn't as long as the render says."""
    words = ["cornell_diffuse", "lamps", "--ceiling", "--resolution", "64x64", "--seeds", "2"]
    command = [sys.executable, "tools/bench.py", *words, "--results", str(tmp_path)]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "ceiling.csv").open(newline="") as file:
        rows = {row["scene"]: row for row in csv.DictReader(file)}
    assert set(rows) == {"cornell_diffuse", "lamps"}
    for row in rows.values():
        assert float(row["M rays"]) >= 0.06  # of the camera alone 64 * 64 * 16 samples
        assert 10 < int(row["shadow rays"].rstrip("%")) < 60
        assert float(row["rays that end otherwise"]) < 1e-3
        assert 0 < float(row["copying, taken off the replay"].rstrip("%")) < 100
        assert float(row["render / replay"].split()[0]) > 0.0
        assert row["wanted: at most"] == "1.25"


@pytest.fixture(scope="module")
def recorded():
    """(recording, packed scene, the render's own count of rays) of a few samples of `lamps`."""
    from bl_ext.user_default.lobe.engine import render
    from bl_ext.user_default.lobe.engine.pack import pack

    scene, settings = ceiling.export("lamps", (16, 16), 4, 2)
    return ceiling.record(scene, settings), pack(scene, settings), render(scene, settings).rays


def test_the_replay_traces_the_rays_of_the_render(recorded) -> None:
    recording, packed, rays = recorded
    assert len(recording.records) == rays
    assert 0 < recording.hits < rays
    assert set(recording.records[:, ceiling.CALL]) == {ceiling.INTERSECT_NOTING_LAMPS, ceiling.OCCLUDED}
    others = ceiling.differing(recording, packed)
    assert others < 1e-3 * rays
    ceiling.replay(recording, packed, 2, others)


def test_rays_that_end_otherwise_are_counted_each(recorded) -> None:
    """Of both kinds: some that hit nothing as if they had hit, and the reverse."""
    recording, packed, _ = recorded
    before, records = ceiling.differing(recording, packed), recording.records.copy()
    turned = np.arange(0, len(records), len(records) // 50)
    records[turned, ceiling.HIT] = records[turned, ceiling.HIT] == 0
    assert abs(ceiling.differing(ceiling.Recording(records), packed) - before - len(turned)) <= 2 * before


def test_too_many_rays_that_end_otherwise_are_refused() -> None:
    recording = ceiling.Recording(np.zeros((10_000, ceiling.RECORD_WORDS), np.uint32))
    assert ceiling.agreeing(10, recording) == 10
    with pytest.raises(ToolError, match="11 of 10000 rays end otherwise when they are traced again"):
        ceiling.agreeing(11, recording)


def test_copying_reads_each_ray_and_meets_nothing(recorded) -> None:
    """The loop without Embree leaves the last ray where Embree would have found it."""
    from bl_ext.user_default.lobe.engine.kernels.embree import new_ray

    recording, packed, _ = recorded
    ray = new_ray(packed.lights.shape_count)
    words, trace = ray.view(np.uint32), ceiling._replay_kernel(False, traces=False)
    shadows = recording.records[recording.records[:, ceiling.CALL] == ceiling.OCCLUDED]
    for records in (recording.records, shadows):
        assert trace(packed.accel.address, records, ray, words) == 0
        assert np.array_equal(words[: ceiling.RAY_WORDS], records[-1, : ceiling.RAY_WORDS])
    assert ceiling.copying(recording, packed, 2) > 0


def test_copying_is_taken_off_by_the_least_that_it_takes(monkeypatch) -> None:
    assert list(ceiling.without_copying([3.0, 4.0], [1.0, 2.0])) == [2.0, 3.0]
    with pytest.raises(ToolError, match="a larger picture"):
        ceiling.without_copying([3.0, 1.0], [1.0, 2.0])
    monkeypatch.setattr(ceiling, "replay", lambda *_: 3.0)
    monkeypatch.setattr(ceiling, "copying", lambda *_: 1.0)
    monkeypatch.setattr(ceiling.metrics, "median_ratio", lambda a, b: (b[0], 0.0, 0.0))
    row = ceiling.measure("lamps", (16, 16), 1, 1, 2)
    assert row["copying, taken off the replay"] == "33.3%"
    assert row["render / replay"].startswith("2.00 ")


@pytest.mark.parametrize("fault", ["lost", "shortened", "masked"])
def test_a_replay_of_other_rays_is_refused(recorded, monkeypatch, fault: str) -> None:
    """Some are left out, or end before what they met, or see nothing."""
    recording, packed, _ = recorded
    others = ceiling.differing(recording, packed)
    met = np.flatnonzero(recording.records[:, ceiling.HIT])[: others + 1]
    records = recording.records.copy()
    if fault == "lost":
        records = np.delete(records, met, axis=0)
    elif fault == "shortened":
        records[met, ceiling.TFAR] = 0
    else:
        records[met, MASK] = 0
    monkeypatch.setattr(ceiling.Recording, "hits", recording.hits)
    with pytest.raises(RuntimeError, match="met something when they were replayed"):
        ceiling.replay(ceiling.Recording(records), packed, 2, others)


MASK = 9  # of a record, as in Embree's RTCRay


def test_a_ray_that_is_not_recorded_is_noticed(monkeypatch) -> None:
    scene, settings = ceiling.export("lamps", (16, 16), 1, 1)
    whole = ceiling._instead_of_embree

    @contextmanager
    def losing_one(records, count):
        with whole(records, count):
            yield
        count[0] -= 1

    monkeypatch.setattr(ceiling, "_instead_of_embree", losing_one)
    with pytest.raises(RuntimeError, match="rays were recorded of"):
        ceiling.record(scene, settings)
    monkeypatch.setattr(ceiling, "_instead_of_embree", whole)
    monkeypatch.setattr(ceiling, "MOST_RAYS", 100)
    with pytest.raises(RuntimeError, match="take fewer samples, or a smaller picture"):
        ceiling.record(scene, settings)
