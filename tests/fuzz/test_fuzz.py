"""A bounded number of odd scenes on every run, 100,000 in the long part; `python tools/fuzz.py` for others."""

from __future__ import annotations

import os
import re
import sys

import numpy as np
import pytest
import scenes
from fuzz import odd_scenes

import engine.validate as validate
from engine import SceneError, Settings, render
from tools import fuzz
from tools.forcing import everything_on

CASES, MANY_CASES = 600, 100_000
# A child that goes wrong in each way that the parent has to notice, at its cases 2, 5 and 7.
BAD_CHILD = """
import ctypes, json, sys, time
for number in range(int(sys.argv[1]), int(sys.argv[1]) + int(sys.argv[2])):
    print(json.dumps({"number": number, "changed": f"change {number}"}), flush=True)
    if number == 2:
        ctypes.string_at(0)
    if number == 5:
        time.sleep(60)
    if number == 7:
        raise SystemExit("said on the way out")
    print(json.dumps({"number": number, "outcome": "picture", "changed": "", "text": ""}), flush=True)
"""


def test_odd_scenes_render_or_are_refused_by_name():
    report = fuzz.run(0, CASES)
    assert not report.findings, f"{report.findings[0]}\n{report.table()}"
    assert sum(report.counts.values()) == CASES
    assert min(report.counts[outcome] for outcome in fuzz.GOOD) > CASES / 10, report.table()


@pytest.mark.long
def test_a_hundred_thousand_odd_scenes(record):
    """A row of benchmarks/results/fuzz.md, written before the verdict."""
    report = fuzz.run(0, MANY_CASES, processes=min(os.cpu_count() or 1, 2))
    counts = {outcome: report.counts[outcome] for outcome in fuzz.OUTCOMES}
    record("fuzz", ("first", "cases"), {"first": 0, "cases": MANY_CASES, **counts, "seconds": round(report.seconds)})
    assert not report.findings, f"{report.findings[0]}\n{report.table()}"
    assert sum(report.counts.values()) == MANY_CASES


@pytest.mark.parametrize("processes", [1, 2])
def test_crashes_and_hangs_are_noticed_and_the_rest_is_run(processes):
    report = fuzz.run(0, 10, [sys.executable, "-c", BAD_CHILD], case_seconds=2.0, processes=processes)
    found = {finding["number"]: finding for finding in report.findings}
    assert {number: finding["outcome"] for number, finding in found.items()} == {2: "crash", 5: "hang", 7: "crash"}
    assert "SIGSEGV" in found[2]["text"] or sys.platform == "win32"
    assert found[5]["changed"] == "change 5"
    assert "said on the way out" in found[7]["text"]
    assert report.counts["picture"] == 7


def test_a_case_is_known_by_its_number_alone():
    one, two = odd_scenes.make_case(123), odd_scenes.make_case(123)
    assert one.changed == two.changed
    assert odd_scenes.make_case(124).changed != one.changed


@pytest.mark.parametrize(
    ("check", "outcomes"),
    [
        ("_check_types", {"escaped"}),
        ("_check_camera", {"escaped", "wrong picture"}),
        ("_check_light", {"escaped", "wrong picture"}),
        ("_check_world", {"escaped", "wrong picture"}),
        ("scene_error", {"unnamed"}),
    ],
)
def test_a_border_with_a_gap_is_noticed(monkeypatch, check, outcomes):
    """Each of these checks gone; the messages without their names. Not those without which the process would crash.

    One case in 500 gets by without the camera's: which depends on every field that there is."""
    nameless = validate.SceneError("something is wrong") if check == "scene_error" else None
    monkeypatch.setattr(validate, check, lambda *_: nameless)
    with np.errstate(all="ignore"):
        verdicts = (odd_scenes.judge(case) for case in odd_scenes.cases(0, 8 * CASES))
        assert any(verdict.outcome in outcomes for verdict in verdicts)


def hidden_indices(scene):
    """min and max of a masked array leave out what is masked; the kernels don't."""
    triangles = scene.meshes[0].triangles.copy()
    triangles[0, 0] = 10**6
    scene.meshes[0].triangles = np.ma.masked_array(triangles, mask=triangles > 3)


def unknown_rays(scene):
    """Bits above `Visibility` are those of lamps in Embree's masks."""
    scene.instances.visibility[0] = 255


def endless_vertices(scene):
    scene.meshes[0].vertices = np.broadcast_to(scene.meshes[0].vertices[:1], (2**40, 3))


def vast_picture(scene):
    scene.width = scene.height = 65536


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (hidden_indices, "mesh 'floor': triangles is a MaskedArray, it must be a numpy array"),
        (unknown_rays, "object 'floor': its visibility number 255 is not one of 16"),
        (endless_vertices, "mesh 'floor': vertices has 1099511627776 rows, and 2147483647 is the limit"),
        (vast_picture, "the picture of 65536 x 65536 pixels has more than 268 million"),
    ],
)
def test_what_fuzzing_found_is_refused(spoil, says):
    scene = scenes.lamp_room([])
    spoil(scene)
    with pytest.raises(SceneError, match=re.escape(says)):
        scene.validate()


def dark_image(scene):
    scene.world.__dict__["image"] = np.full((2, 4, 3), 1e-45, np.float32)


def vanishing_spot(scene):
    scene.lights[0].transform[:, :3] *= 1e-45


@pytest.mark.parametrize("spoil", [dark_image, vanishing_spot])
def test_what_fuzzing_found_is_rendered(spoil):
    scene = scenes.lamp_room(["spot_sphere"], 8)
    spoil(scene)
    with everything_on():
        assert render(scene, Settings(samples=8, threads=1)).rejected == 0
