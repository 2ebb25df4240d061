"""Lobe against Cycles on the same file: samples per second, and error at equal samples.

    python benchmarks/speed.py cornell_diffuse --resolution 512x512 --samples 64 --runs 5

The engines render in turn, so that a slower minute of the machine hits both. "render" counts the phase in which
samples are taken (Cycles' own "render_time", which contains its preparations on the device), "total" everything
from pressing F12. The reference for relMSE is the mean of both engines' long renders, so it favours neither, and its
own noise (given beside it) is to stay far below the errors that it measures.
Results go to benchmarks/results/speed.csv and .md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import common
import numpy as np
from common import br

from tools import metrics
from tools.render import resolution, whole_number

KEYS = ("scene", "resolution", "samples", "threads")


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="+", metavar="SCENE", help="sample scenes by name, files, or 'all'")
    parser.add_argument("--resolution", type=resolution, default=(512, 512), metavar="WxH")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), default=64, metavar="N")
    parser.add_argument("--runs", type=whole_number(1, 1000), default=5, metavar="N", help="pairs of renders")
    parser.add_argument("--threads", type=whole_number(0, 1024), default=2, metavar="N")
    parser.add_argument("--reference-samples", type=whole_number(0, 1 << 24), default=1024, metavar="N",
                        help="of each engine; 0: no error figures")  # fmt: skip
    parser.add_argument("--set", action="append", default=[], dest="assignments", metavar="scene.lobe.KEY=VALUE")
    common.add_results(parser)
    return parser.parse_args(arguments)


def measure(name: str, options: argparse.Namespace) -> dict:
    scene = common.prepare(common.scene_path(name), options.resolution, options.threads)
    for assignment in options.assignments:
        br.set_value(scene, assignment)
    for engine in ("LOBE", "CYCLES"):  # compilation, caches, pages
        common.render(scene, engine, 1, 0)
    pictures: dict[str, list] = {"LOBE": [], "CYCLES": []}
    reports: dict[str, list] = {"LOBE": [], "CYCLES": []}
    for run in range(options.runs):
        for engine in ("LOBE", "CYCLES") if run % 2 == 0 else ("CYCLES", "LOBE"):
            picture, report = common.render(scene, engine, options.samples, run + 1)
            pictures[engine].append(picture)
            reports[engine].append(report)
            print(f"\r{engine} run {run + 1}/{options.runs}  ", end="", file=sys.stderr, flush=True)
    return row(name, scene, options, reports) | errors(scene, options, pictures)


def seconds(reports: list[dict], phase: str) -> list[float]:
    return [report["seconds"][phase] for report in reports]


def row(name: str, scene, options: argparse.Namespace, reports: dict[str, list]) -> dict:
    paths = options.resolution[0] * options.resolution[1] * options.samples
    result: dict = {
        "scene": Path(name).stem,
        "resolution": "{}x{}".format(*options.resolution),
        "samples": options.samples,
        "threads": options.threads,
        "bounces": scene.lobe.max_bounces,
        "pairs": options.runs,
    }
    for phase in ("render", "total"):
        lobe, cycles = seconds(reports["LOBE"], phase), seconds(reports["CYCLES"], phase)
        median, low, high = metrics.median_ratio(cycles, lobe)
        result[f"speed ratio, {phase}"] = f"{median:.2f} ({low:.2f} to {high:.2f})"
        result[f"M samples/s, {phase}: Lobe"] = f"{paths / np.median(lobe) / 1e6:.2f}"
        result[f"M samples/s, {phase}: Cycles"] = f"{paths / np.median(cycles) / 1e6:.2f}"
    rays = np.median([r["rays"] / r["seconds"]["render"] for r in reports["LOBE"]])
    result["M rays/s: Lobe"] = f"{rays / 1e6:.1f}"
    return result


def errors(scene, options: argparse.Namespace, pictures: dict[str, list]) -> dict:
    """relMSE of each engine, whole and trimmed by 0.1 %, and Lobe's over Cycles'."""
    keys = ("relMSE: Lobe", "relMSE: Cycles", "relMSE ratio", "relMSE ratio, trimmed", "noise of the reference")
    if not options.reference_samples:
        return dict.fromkeys(keys, "")
    print("\rreference      ", file=sys.stderr, flush=True)
    long = [common.render(scene, e, options.reference_samples, 9001)[0] for e in ("LOBE", "CYCLES")]
    reference, own_noise = metrics.joined(long)
    whole = {e: np.mean([metrics.rel_mse(p, reference) for p in pictures[e]]) for e in pictures}
    trimmed = {e: np.mean([metrics.rel_mse(p, reference, 0.001) for p in pictures[e]]) for e in pictures}
    values = (
        f"{whole['LOBE']:.5f} ({trimmed['LOBE']:.5f})",
        f"{whole['CYCLES']:.5f} ({trimmed['CYCLES']:.5f})",
        f"{whole['LOBE'] / whole['CYCLES']:.3f}",
        f"{trimmed['LOBE'] / trimmed['CYCLES']:.3f}",
        f"{own_noise:.1e}",
    )
    return dict(zip(keys, values, strict=True))


def main() -> int:
    return common.run(work, parse())


def work(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    names = [n for name in options.scenes for n in (common.SCENES if name == "all" else (name,))]
    rows = []
    for name in names:
        print(name, file=sys.stderr)
        rows.append(measure(name, options))
        table = common.update_table("speed", KEYS, rows, folder=options.results)
    say(table)
    for line in rows:
        say("\n".join(f"{key}: {value}" for key, value in line.items()) + "\n")


if __name__ == "__main__":
    sys.exit(main())
