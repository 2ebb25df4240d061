"""What Open Shading Language costs Cycles by itself: `python tools/bench.py SCENE... --osl`.

Cycles needs it for the exact Phong closure (addon/compare/peer.py). So scenes without Phong surfaces are rendered with
and without, at equal samples: the rest of what it is slower by on scenes with them is Phong.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from benchmarks import common
from benchmarks.common import br
from tools import metrics

SAMPLES = 16
SCATTERED = 1.5  # of the pairs' ratios, the largest over the smallest: from there on something else moved the times
ATTEMPTS = 3
NOTE = f"""\
Cycles with Open Shading Language over Cycles without, on scenes that don't need it, at equal samples: time of the whole
render and of the sampling alone, median of pairs made in turn, smallest and largest. The pictures are the same but for
noise: the ratio of their means says so. Where the largest ratio is more than {SCATTERED} times the smallest, something
else moved the times: they are measured again, up to {ATTEMPTS} times in all. Those that scatter least stand here, with
a star where they still do.

"""


def measure(path: Path, resolution: tuple[int, int], threads: int, runs: int) -> dict[str, str]:
    """A row of the table. Raises ToolError for a scene with Phong surfaces, which Cycles renders in no other way."""
    scene = common.prepare(path, resolution, threads)
    br.set_engine(scene, "CYCLES")
    if br.cycles_peer.phong_groups():
        raise br.ToolError(f"{path.stem} has Phong surfaces: Cycles needs Open Shading Language for them")
    for on in (True, False):  # its shaders are compiled, caches, pages
        render(scene, on, 1, 0)
    total, sampling, means = steadiest(lambda: in_pairs(scene, runs))
    return {
        "scene": path.stem,
        "resolution": "{}x{}".format(*resolution),
        "threads": str(threads),
        "samples": str(SAMPLES),
        "pairs": str(runs),
        "time with it / without": "{:.2f} ({:.2f} to {:.2f})".format(*total),
        "the same, sampling alone": "{:.2f} ({:.2f} to {:.2f})".format(*sampling),
        "scattered": "*" if scatter(total) > SCATTERED else "",
        "means of the pictures": f"{means:.4f}",
    }


class Pairs(NamedTuple):
    """With Open Shading Language over without. total, sampling: of seconds, median, smallest and largest."""

    total: tuple[float, float, float]
    sampling: tuple[float, float, float]
    means: float  # of the pictures


def in_pairs(scene, runs: int) -> Pairs:
    seconds: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    means: dict[bool, list[float]] = {True: [], False: []}
    for run, on in common.in_turn((True, False), runs):
        picture, report = render(scene, on, SAMPLES, run + 1)
        seconds[on].append((report["seconds"]["total"], report["seconds"]["render"]))
        means[on].append(float(picture.mean()))
    total, sampling = (
        metrics.median_ratio(with_it, without)
        for with_it, without in zip(np.transpose(seconds[True]), np.transpose(seconds[False]), strict=True)
    )
    return Pairs(total, sampling, float(np.mean(means[True]) / np.mean(means[False])))


def steadiest(measured: Callable[[], Pairs]) -> Pairs:
    """What is measured, again while it scatters and attempts are left: that which scatters least, whatever it says."""
    found = [measured()]
    while scatter(found[-1].total) > SCATTERED and len(found) < ATTEMPTS:
        found.append(measured())
    return min(found, key=lambda pairs: scatter(pairs.total))


def scatter(ratio: tuple[float, float, float]) -> float:
    _, smallest, largest = ratio
    return largest / smallest


def render(scene, osl: bool, samples: int, seed: int) -> tuple[np.ndarray, dict]:
    """As `common.render` does it."""
    scene.lobe.samples, scene.lobe.seed = samples, seed
    br.set_engine(scene, "CYCLES")
    scene.cycles.shading_system = osl
    report = br.render(scene)
    return br.picture(scene, report)[..., :3], report


def table(paths: list[Path], resolution: tuple[int, int], threads: int, runs: int, folder: Path) -> str:
    """Measure these scenes, and write osl.csv and .md into `folder`."""
    rows = []
    for path in tqdm(paths, file=sys.stderr):
        rows.append(measure(path, resolution, threads, runs))
        written = common.update_table("osl", ("scene", "resolution", "threads"), rows, folder=folder, note=NOTE)
    return written
