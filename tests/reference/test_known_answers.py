"""Pictures with known answers through the whole engine, each to its 99 % confidence interval.

`make test-long` renders all of known_answers.py and writes benchmarks/results/accuracy.csv and .md. A few cases with
fewer samples belong to every run. The formulas of polygons and plates are checked by themselves at the end.

A case fails when it misses its answer by more than an interval of which one in 1e5 fails though all is right, plus the
case's slack. All of the noise comes from seeds: the pixels of one seed share no random numbers, and each pixel is
compared with itself under other seeds, so that differences between pixels are no noise.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from reference.irradiance import above_horizon, polygon_irradiance, spread_disk, spread_rectangle
from reference.known_answers import BOTH, CASES, ENDS, EVERY, SLABS, Case
from scipy import stats

import engine
from engine.scene import Scene
from engine.settings import Settings

WANTED = 1e-4  # half width of the 99 % interval, relative
PILOT = 8  # seeds from which the number of seeds is found
FEW = 2  # part of a case's samples at limits that are rendered with the pilot's seeds alone
MOST = 200 * 4096  # samples of a pixel, over all seeds: some 20 s
FAILURE = 1e-5  # how often a comparison may fail though all is right
KEYS = ("case", "bounces")


@dataclass
class Found:
    """Mean radiance (3,), its standard error (3,), and how many degrees of freedom that has."""

    mean: np.ndarray
    error: np.ndarray
    freedom: int

    def half_width(self, level: float) -> np.ndarray:
        """(3,) of the interval that misses with probability `level`."""
        return stats.t.isf(level / 2, self.freedom) * self.error


def render(case: Case, scene: Scene, seeds: range, bounces: int, samples: int) -> np.ndarray:
    """(seeds, pixels, 3) float64"""
    chosen = Settings(samples, pixel_filter="BOX", threads=1, **case.bounces(bounces), **case.settings)
    results = [engine.render(scene, replace(chosen, seed=seed)) for seed in seeds]
    assert not any(result.rejected for result in results)
    return np.array([result.pixels[..., :3].reshape(-1, 3) for result in results], np.float64)


def summary(pictures: np.ndarray) -> Found:
    seeds, pixels, _ = pictures.shape
    variance = pictures.var(axis=0, ddof=1).mean(axis=0)
    return Found(pictures.mean(axis=(0, 1)), np.sqrt(variance / (seeds * pixels)), pixels * (seeds - 1))


def measure(case: Case, bounces: int, few: int = 1) -> Found:
    """As many seeds as the interval needs by the pilot's variance, the same on every machine; or the
    pilot alone with one sample in `few`. Every row has seeds of its own, so that no two are the same luck."""
    scene, samples = case.scene(), case.samples // few
    first = zlib.crc32(f"{case.name} {bounces}".encode()) >> 2
    pictures = render(case, scene, range(first, first + PILOT), bounces, samples)
    found = summary(pictures)
    excess = np.max(found.half_width(0.01) / np.maximum(np.abs(found.mean), 1e-30)) / WANTED
    seeds = min(MOST // samples if few == 1 else PILOT, int(np.ceil(PILOT * 1.1 * excess**2)))
    if seeds > PILOT:
        more = render(case, scene, range(first + PILOT, first + seeds), bounces, samples)
        pictures = np.concatenate([pictures, more])
    return summary(pictures)


def holds(found: Found, expected: np.ndarray, slack: float) -> bool:
    return bool(np.all(np.abs(found.mean - expected) <= found.half_width(FAILURE) + slack * np.abs(expected)))


def row(case: Case, bounces: int, found: Found) -> dict:
    """Figures of the channel with the widest interval; the verdict is on all three."""
    expected = np.broadcast_to(np.asarray(case.expected(bounces), np.float64), 3)
    half_width = found.half_width(0.01) / expected
    k = int(np.argmax(half_width))
    return {
        "case": case.name,
        "bounces": bounces,
        "measured": f"{found.mean[k]:.7g}",
        "expected": f"{expected[k]:.7g}",
        "difference": f"{found.mean[k] / expected[k] - 1:+.1e}",
        "99 % half width": f"{half_width[k]:.1e}",
        "slack": f"{case.slack:.1e}",
        "verdict": "pass" if holds(found, expected, case.slack) else "FAIL",
        "source": case.source,
    }


ROWS = [pytest.param(c, b, id=f"{c.name}-{b}") for c in CASES for b in sorted(c.limits + c.others)]


@pytest.mark.long
@pytest.mark.parametrize(("case", "bounces"), ROWS)
def test_known_answer(case: Case, bounces: int, record: Callable[..., None]) -> None:
    found = measure(case, bounces, 1 if bounces in case.limits else FEW)
    line = row(case, bounces, found)
    record("accuracy", KEYS, line)
    assert line["verdict"] == "pass", f"{found}, expected {case.expected(bounces)}"


# In every run: fewer seeds, so wider intervals

BY_NAME = {case.name: case for case in CASES}
LAMPS = ("lamp: point", "lamp: spot", "lamp: narrow spot", "lamp: area", "lamp: sun")
QUICK = [
    *(("furnace, cube", bounces) for bounces in (0, 1, 4)),
    *((f"plates, {slab}", bounces) for slab in (SLABS[0], BOTH) for bounces in (1, 4)),
    ("lit sphere", 2),
    ("cube's form factor, adjacent", 0),
    *((name, 0) for name in BY_NAME if name.startswith(LAMPS)),
    *((name, 0) for name in BY_NAME if name.startswith("mesh, ")),
    *((name, 0) for name in ("white plate, white sky", "white plate, white image")),
    *((f"Phong, n = {n}, 60 degrees", 0) for n in (0, 100, 10000)),
    ("diffuse and Phong, n = 10, 60 degrees", 0),
]


@pytest.mark.parametrize(("name", "bounces"), QUICK)
def test_known_answer_with_few_samples(name: str, bounces: int) -> None:
    case, found = BY_NAME[name], measure(BY_NAME[name], bounces, few=16)
    assert row(case, bounces, found)["verdict"] == "pass", f"{found}, expected {case.expected(bounces)}"


# What is broken is caught


@pytest.mark.parametrize(
    "name", ["lamp: point", "lamp: area, disk", "white plate, white sky", "Phong, n = 10, 60 degrees"]
)
def test_an_answer_that_is_off_by_3e_4_is_caught(name: str) -> None:
    case, found = BY_NAME[name], measure(BY_NAME[name], 0)
    for factor, verdict in ((1 - 3e-4, "FAIL"), (1, "pass"), (1 + 3e-4, "FAIL")):
        wrong = replace(case, expected=lambda bounces, factor=factor: np.asarray(case.expected(bounces)) * factor)
        assert row(wrong, 0, found)["verdict"] == verdict


def test_a_reflectance_that_is_off_by_3e_4_is_caught() -> None:
    case = BY_NAME["white plate, white sky"]
    scene = case.scene()
    scene.materials = [replace(scene.materials[0], kd=(1 - 3e-4,) * 3)]
    assert row(case, 0, measure(replace(case, scene=lambda: scene), 0))["verdict"] == "FAIL"


def test_a_bounce_too_many_is_caught() -> None:
    case = BY_NAME["furnace, cube"]
    assert row(case, 4, measure(case, 5, few=16))["verdict"] == "FAIL"


@pytest.mark.parametrize("slab", [SLABS[0], BOTH], ids=str)
def test_a_bounce_too_few_is_caught_between_plates(slab) -> None:
    case = BY_NAME[f"plates, {slab}"]
    for bounces in (1, 4):
        fewer = replace(case, expected=lambda limit: case.expected(limit - 1))
        assert row(fewer, bounces, measure(case, bounces, few=16))["verdict"] == "FAIL"


def test_limits_that_are_mixed_up_are_caught() -> None:
    """Glossy bounces counted as diffuse ones."""
    glossy, diffuse = (BY_NAME[f"plates, {BOTH}, {name}_bounces alone"] for name in ("glossy", "diffuse"))
    mixed = replace(glossy, expected=diffuse.expected)
    assert row(mixed, 1, measure(glossy, 1, few=16))["verdict"] == "FAIL"


# Where there is nothing to bounce off, a limit is no matter of intervals: the picture is the same to the bit


def fingerprint(case: Case, bounces: int) -> bytes:
    return render(case, case.scene(), range(1), bounces, 64).tobytes()


ALONE = [case for case in CASES if case.limits in (ENDS, (0,)) and not case.name.startswith("Cornell")]


@pytest.mark.long
@pytest.mark.parametrize("case", ALONE, ids=lambda case: case.name)
def test_no_limit_changes_what_cannot_bounce(case: Case) -> None:
    assert len({fingerprint(case, bounces) for bounces in EVERY}) == 1


def test_a_limit_that_changes_the_picture_is_caught() -> None:
    case = BY_NAME["furnace, cube"]
    assert len({fingerprint(case, bounces) for bounces in (0, 1)}) == 2


# The formulas by themselves


def test_a_polygon_cut_by_the_horizon_is_that_without_what_is_below() -> None:
    """A square that stands on the horizon, and the same one reaching below it; then one that lies below."""
    upper = np.array([(1, -1, 0), (1, 1, 0), (1, 1, 1), (1, -1, 1)], float)
    lower = np.where(upper[:, 2:] == 0, upper - (0, 0, 0.7), upper)
    assert polygon_irradiance(above_horizon(lower)) == pytest.approx(polygon_irradiance(upper), rel=1e-12)
    assert polygon_irradiance(lower) != pytest.approx(polygon_irradiance(upper), rel=0.1)
    assert not len(above_horizon(upper - (0, 0, 2)))


def test_the_spread_of_a_rectangle_is_that_of_a_disk_of_many_corners() -> None:
    turns = np.arange(400) / 400 * 2 * np.pi
    disk = np.column_stack([0.7 * np.cos(turns), 0.7 * np.sin(turns), np.full(400, 2.0)])
    for spread in (0.4, 1.0, 3.0):
        shown = spread_rectangle(disk, (0, 0, -1), spread) / np.pi
        assert shown == pytest.approx(spread_disk(0.7, 2.0, spread), rel=2e-4)
