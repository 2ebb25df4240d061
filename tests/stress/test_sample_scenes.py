"""Every change of `CHANGES` to every sample scene, and what its picture must be.

The whole table is `long`: `make test-long` writes it to benchmarks/results/stress.csv and .md. One change of each kind
is tried each time. The changes and their expectations are in `changes.py`.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cache
from unittest import mock

import numpy as np
import pytest
from sample_scenes import SCENES, sample_scene
from stress import moves
from stress.changes import CHANGES, Change, SceneChange

from engine.scene import Scene

WIDEST = 0.01  # a confidence interval's half width, relative to the mean


@dataclass
class Outcome:
    """`difference` is None where the picture only has to be finite; `fault`: what is wrong, if anything."""

    difference: moves.Difference | None = None
    rejected: int = 0
    fault: str = ""

    def row(self, scene: str, change: str) -> dict:
        found = self.difference
        passed = "finite only" if found is None else "pass"
        return {
            "scene": scene,
            "change": change,
            "difference": "" if found is None else f"{np.abs(found.mean).max():.1e}",
            "half width": "" if found is None else f"{found.half_width.max():.1e}",
            "slack": "" if found is None else f"{CHANGES[change].slack:.1e}",
            "rejected": self.rejected,
            "verdict": f"FAIL: {self.fault}" if self.fault else passed,
        }


@cache
def expected_picture(name: str, change: SceneChange, settings: tuple) -> np.ndarray:
    return moves.render(change(sample_scene(name)), **dict(settings))


def outcome(name: str, change: Change) -> Outcome:
    stressed = change.stressed(sample_scene(name))
    found = Outcome()
    for samples in change.samples if change.expected else change.samples[:1]:
        found = compared(name, change, stressed, samples)
        if found.fault or found.difference is None or found.difference.half_width.max() <= max(WIDEST, change.slack):
            return found
    return replace(found, fault=f"tells nothing: {found.difference}")


def compared(name: str, change: Change, stressed: Scene, samples: int) -> Outcome:
    limit = change.bake_limit
    with mock.patch("engine.pack.geometry.BAKE_LIMIT", limit) if limit is not None else nullcontext():
        result = moves.rendered(stressed, samples=samples, **change.settings)
    fault = moves.faults(result)
    if fault or change.expected is None:
        return Outcome(None, result.rejected, fault)
    settings = {"samples": samples, **change.settings, **change.expected_settings}
    expected = expected_picture(name, change.expected, tuple(settings.items()))
    difference = moves.difference(moves.picture(result) / change.factor, expected)
    return Outcome(difference, 0, "" if difference.holds(change.slack) else f"differs by {difference}")


@pytest.mark.long
@pytest.mark.parametrize("name, change", [(name, change) for name in SCENES for change in CHANGES])
def test_stressed(record, name, change):
    found = outcome(name, CHANGES[change])
    record("stress", ("scene", "change"), found.row(name, change))
    assert not found.fault, found.fault


QUICK = [
    ("cornell_diffuse", "moved by 1e+06 m"),
    ("cornell_diffuse", "moved by 1000 m from a pebble that stays: as rounded there"),
    ("cornell_diffuse", "instances sheared, baked"),
    ("cornell_diffuse", "slivers of aspect 1e8"),
    ("cornell_diffuse", "albedo 1, flat, 1,000 bounces in a world of 1: 1"),
    ("plates_phong", "exponent 1e-06: as 0"),
    ("lamps", "scaled by 1e-06"),
    ("lamps", "area lights of 1e-06 m: as 0.001 m"),
    ("lamps", "a million coincident triangles"),
    ("world", "world 1e+30, alone"),
    ("world", "normals times 1e+06"),
    ("instances", "instances tiny, instanced"),
    ("instances", "camera in a closed object: dark"),
    ("many_lights", "a pebble 1e6 m away"),
    ("many_lights", "a lamp in a closed object: none"),
]


@pytest.mark.parametrize("name, change", QUICK)
def test_stressed_quickly(name, change):
    found = outcome(name, CHANGES[change])
    print(found.row(name, change))
    assert not found.fault, found.fault


def test_the_quick_ones_are_of_every_kind_and_scene():
    assert {CHANGES[change].kind for _, change in QUICK} == {change.kind for change in CHANGES.values()}
    assert {name for name, _ in QUICK} == set(SCENES)


def larger(scene: Scene) -> Scene:
    """One instance half as large again."""
    transforms = scene.instances.transforms.copy()
    transforms[-1, :, :3] *= 1.5
    return replace(scene, instances=replace(scene.instances, transforms=transforms))


def brighter(scene: Scene) -> Scene:
    materials = [replace(m, emission=tuple(1.01 * x for x in m.emission)) for m in scene.materials]
    return replace(scene, materials=materials)


@pytest.mark.parametrize("change", [larger, brighter])
def test_another_picture_is_refused(change):
    assert "differs by" in outcome("cornell_diffuse", Change("twin", change)).fault


def test_what_is_not_to_be_told_is_refused():
    """Another seed's picture at too few samples."""
    other = Change("twin", lambda scene: scene, settings={"seed": 7}, expected_settings={"seed": 8}, samples=(4,))
    assert "tells nothing" in outcome("cornell_diffuse", other).fault


@pytest.mark.parametrize("value, fault", [(np.nan, "not finite"), (np.inf, "not finite"), (-1e-9, "darker than black")])
def test_pixels_that_no_picture_has_are_refused(monkeypatch, value, fault):
    def rendered(scene: Scene, **settings):
        result = render(scene, **settings)
        result.pixels[3, 5, 1] = value
        return result

    render = moves.rendered
    monkeypatch.setattr(moves, "rendered", rendered)
    only_finite = Change("twin", lambda scene: scene, None, samples=(1,))
    assert fault in outcome("cornell_diffuse", only_finite).fault


def test_rejected_samples_are_refused(monkeypatch):
    result = moves.rendered(sample_scene("cornell_diffuse"), samples=1)
    result.rejected = 3
    monkeypatch.setattr(moves, "rendered", lambda scene, **settings: result)
    found = outcome("cornell_diffuse", Change("twin", lambda scene: scene, None))
    assert found.row("", "")["rejected"] == 3 and "3 samples" in found.fault
