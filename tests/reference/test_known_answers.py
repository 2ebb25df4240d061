"""Pictures with known answers through the whole engine, each to its 99 % confidence interval.

`make test-long` renders all of known_answers.py and writes benchmarks/results/accuracy.csv and .md. A few cases with
fewer samples belong to every run.

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
from reference.known_answers import CASES, Case
from scipy import stats

import engine
from engine.scene import Scene
from engine.settings import Settings

WANTED = 1e-4  # half width of the 99 % interval, relative
PILOT = 8  # seeds from which the number of seeds is found
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


def render(scene: Scene, seeds: range, bounces: int, samples: int) -> np.ndarray:
    """(seeds, pixels, 3) float64"""
    chosen = Settings(
        samples, max_bounces=bounces, diffuse_bounces=bounces, glossy_bounces=bounces, pixel_filter="BOX", threads=1
    )
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
    pictures = render(scene, range(first, first + PILOT), bounces, samples)
    found = summary(pictures)
    excess = np.max(found.half_width(0.01) / np.maximum(np.abs(found.mean), 1e-30)) / WANTED
    seeds = min(MOST // samples if few == 1 else PILOT, int(np.ceil(PILOT * 1.1 * excess**2)))
    if seeds > PILOT:
        more = render(scene, range(first + PILOT, first + seeds), bounces, samples)
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


@pytest.mark.long
@pytest.mark.parametrize(("case", "bounces"), [pytest.param(c, b, id=f"{c.name}-{b}") for c in CASES for b in c.limits])
def test_known_answer(case: Case, bounces: int, record: Callable[..., None]) -> None:
    found = measure(case, bounces)
    line = row(case, bounces, found)
    record("accuracy", KEYS, line)
    assert line["verdict"] == "pass", f"{found}, expected {case.expected(bounces)}"


# In every run: fewer seeds, so wider intervals

BY_NAME = {case.name: case for case in CASES}
LAMPS = ("lamp: point", "lamp: spot", "lamp: narrow spot", "lamp: area", "lamp: sun")
QUICK = [
    *(("furnace, cube", bounces) for bounces in (0, 1, 4)),
    ("lit sphere", 2),
    ("cube's form factor, adjacent", 0),
    *((name, 0) for name in BY_NAME if name.startswith(LAMPS)),
    *((name, 0) for name in ("mesh, ball", "white plate, white sky", "white plate, white image")),
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
