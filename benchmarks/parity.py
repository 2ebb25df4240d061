"""Is Lobe's picture the same as Cycles' (or as the reference road's)? Renders seeds of both and tests the difference.

    python benchmarks/parity.py all
    python benchmarks/parity.py many_lights --against REFERENCE --samples 1024 --seeds 16

Both render with the fair settings of addon/compare/peer.py, the box filter, equal bounces and samples; Phong surfaces
in Cycles are the exact Open Shading Language peer. The statistics are those of tools/metrics.py. Resolution and samples
are those of PLANS unless given.

Indirect light is compared by itself: pictures at the file's bounce limit less pictures at limit 0, with the same seeds.
In each of the engines direct light takes the same random numbers at both limits and so goes out of the difference.

Verdicts, the worst of:
- mean, indirect: "pass" is shown, that is, difference and half width of the 95 % interval are both below what is
  tolerated (TOLERANCE); "FAIL" is refuted: the difference is neither that nor within its 99.9 % interval; else "open";
- pixels: FAIL unless 99.75 % of pixels times channels pass Welch's test at the Sidak level;
- bias: FAIL if the squared bias is above 3 of its standard errors and above the square of the mean's tolerance.
The exit code is 1 if there is a FAIL. Results go to benchmarks/results/parity.csv and .md, one row for each scene,
peer and list of settings.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path
from typing import NamedTuple

import common
import numpy as np
from common import br

from tools import metrics
from tools.render import resolution, whole_number

KEYS = ("scene", "against", "settings")


class Plan(NamedTuple):
    """How a scene is rendered unless the command line says otherwise."""

    resolution: tuple[int, int]
    samples: int


class Tolerance(NamedTuple):
    """Relative differences of the picture's mean and of the indirect light's mean that pass."""

    mean: float
    indirect: float


# Against Cycles samples are such that the half width of the mean is some 0.15 % at most. Where small emitters are seen
# (plates, lamps, world) they make nearly all of its noise. The reference road takes 10 to 70 times the time, so it
# gets what some ten minutes allow; on Cornell its picture leaves out the lamp, which else would be all of the noise.
PLANS = {
    "CYCLES": {
        "cornell_diffuse": Plan((32, 32), 4096),
        "plates_phong": Plan((48, 32), 16384),
        "lamps": Plan((48, 32), 8192),
        "world": Plan((48, 32), 16384),
        "instances": Plan((48, 32), 1024),
        "many_lights": Plan((48, 32), 2048),
    },
    "REFERENCE": {
        "cornell_diffuse": Plan((24, 16), 2048),
        "plates_phong": Plan((24, 16), 8192),
        "lamps": Plan((24, 16), 2048),
        "world": Plan((24, 16), 2048),
        "instances": Plan((24, 16), 1024),
        "many_lights": Plan((24, 16), 1536),
    },
}
OTHER_SCENES = Plan((96, 64), 64)
# Indirect light has much less noise than the whole, so that this part of the samples is enough for it.
INDIRECT_PART = {"CYCLES": 8, "REFERENCE": 1}
TOLERANCE = {"CYCLES": Tolerance(0.002, 0.02), "REFERENCE": Tolerance(0.01, 0.02)}


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="+", metavar="SCENE", help="sample scenes by name, files, or 'all'")
    parser.add_argument("--against", choices=("CYCLES", "REFERENCE"), default="CYCLES")
    parser.add_argument("--resolution", type=resolution, metavar="WxH", help="by default for each scene what PLANS has")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), metavar="N", help="as --resolution")
    parser.add_argument("--seeds", type=whole_number(3, 1000), default=8, metavar="N")
    parser.add_argument("--threads", type=whole_number(0, 1024), default=2, metavar="N")
    parser.add_argument("--set", action="append", default=[], dest="assignments", metavar="scene.lobe.KEY=VALUE")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="keep mean pictures and the t values there")
    common.add_results(parser)
    return parser.parse_args(arguments)


def plan_of(name: str, options: argparse.Namespace) -> Plan:
    plan = PLANS[options.against].get(name, OTHER_SCENES)
    return Plan(options.resolution or plan.resolution, options.samples or plan.samples)


def indirect_samples(plan: Plan, against: str) -> int:
    return max(1, plan.samples // INDIRECT_PART[against])


# --- pictures -------------------------------------------------------------------------------------------------


def replicates(scene, engine: str, samples: int, seeds: range) -> np.ndarray:
    """(seeds, h, w, 3)."""
    what = f"{engine}, {samples} samples, {scene.lobe.max_bounces} bounces"
    pictures = []
    for done, seed in enumerate(seeds, 1):
        pictures.append(common.render(scene, engine, samples, seed)[0])
        print(f"\r{what}: {done}/{len(seeds)} ", end="", file=sys.stderr, flush=True)
    print("", file=sys.stderr)
    return np.stack(pictures)


def whole_and_indirect(scene, engine: str, plan: Plan, against: str, seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """Pictures (seeds, h, w, 3), and others of the light that came by one bounce or more."""
    whole = replicates(scene, engine, plan.samples, seeds)
    samples, limit = indirect_samples(plan, against), scene.lobe.max_bounces
    beginning = whole if samples == plan.samples else replicates(scene, engine, samples, seeds)
    scene.lobe.max_bounces = 0
    direct = replicates(scene, engine, samples, seeds)
    scene.lobe.max_bounces = limit
    return whole, beginning - direct


def measure(name: str, options: argparse.Namespace) -> dict:
    plan, begin = plan_of(name, options), time.perf_counter()
    scene = common.prepare(common.scene_path(name), plan.resolution, options.threads)
    for assignment in options.assignments:
        br.set_value(scene, assignment)
    # Different seeds for the two: two engines that share a sequence would not be independent.
    seeds = range(1, 1 + options.seeds), range(1001, 1001 + options.seeds)
    a, indirect_a = whole_and_indirect(scene, "LOBE", plan, options.against, seeds[0])
    b, indirect_b = whole_and_indirect(scene, options.against, plan, options.against, seeds[1])
    print(f"{time.perf_counter() - begin:.0f} s", file=sys.stderr)
    if options.pictures is not None:
        keep_pictures(options.pictures, Path(name).stem, a, b)
        keep_pictures(options.pictures, f"{Path(name).stem}_indirect", indirect_a, indirect_b)
    return row(name, options, a, b, indirect_a, indirect_b)


def keep_pictures(folder: Path, stem: str, a: np.ndarray, b: np.ndarray) -> None:
    """Means of both, and Welch's t, positive where Lobe is brighter."""
    folder.mkdir(parents=True, exist_ok=True)
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    t, _, _ = metrics.welch(mean_a, a.var(axis=0, ddof=1), len(a), mean_b, b.var(axis=0, ddof=1), len(b))
    for kind, picture in (("lobe", mean_a), ("other", mean_b), ("t", t)):
        opaque = np.concatenate([picture, np.ones_like(picture[..., :1])], axis=-1).astype(np.float32)
        br.save_exr(folder / f"{stem}_{kind}.exr", opaque, {})


# --- verdicts -------------------------------------------------------------------------------------------------


def judge_bias(squared: float, error: float, tolerated: float) -> str:
    """tolerated: relative; a bias this small all over the picture passes even if it is known to be there."""
    return "pass" if squared <= max(3 * error, tolerated**2) else "FAIL"


def verdict(parts: dict[str, str]) -> str:
    """The worst of them, and whose it is: "pass", "open: mean", "FAIL: indirect, bias"."""
    for worst in ("FAIL", "open"):
        names = [name for name, found in parts.items() if found == worst]
        if names:
            return f"{worst}: {', '.join(names)}"
    return "pass"


def row(name: str, options: argparse.Namespace, a, b, indirect_a, indirect_b) -> dict:
    """The table's row for Lobe's pictures (seeds, h, w, 3) and the other's, of all light and of indirect light."""
    plan, tolerated = plan_of(name, options), TOLERANCE[options.against]
    found = metrics.compare(a, b)
    indirect_difference, indirect_half_width = metrics.mean_difference(indirect_a, indirect_b)
    parts = {
        "mean": metrics.judge_mean(a, b, tolerated.mean),
        "indirect": metrics.judge_mean(indirect_a, indirect_b, tolerated.indirect),
        "pixels": metrics.judge_pixels(found),
        "bias": judge_bias(found.squared_bias, found.squared_bias_error, tolerated.mean),
    }
    return {
        "scene": Path(name).stem,
        "against": options.against,
        "settings": " ".join(options.assignments),
        "resolution": "{}x{}".format(*plan.resolution),
        "samples": plan.samples,
        "seeds": options.seeds,
        "mean difference": f"{found.mean_difference:+.3%} ± {found.mean_half_width:.3%}",
        "indirect share": f"{indirect_b.mean() / (b.mean() or math.inf):.1%}",
        "indirect samples": indirect_samples(plan, options.against),
        "indirect difference": f"{indirect_difference:+.2%} ± {indirect_half_width:.2%}",
        "pixels (Sidak)": f"{found.pass_sidak:.3%}",
        "pixels (3 sigma)": f"{found.pass_three_sigma:.3%}",
        "blocks (3 sigma)": f"{found.block_pass_three_sigma:.3%}",
        "worst block's p": f"{found.block_smallest_p:.2g}",
        "bias": f"{found.squared_bias:.2e}",
        "error of bias": f"{found.squared_bias_error:.1e}",
        "noise Lobe": f"{found.noise_a:.2e}",
        "noise other": f"{found.noise_b:.2e}",
        "verdict": verdict(parts),
    }


def failed(rows: list[dict]) -> bool:
    return any(row["verdict"].startswith("FAIL") for row in rows)


def main() -> int:
    options = parse()
    names = [n for name in options.scenes for n in (common.SCENES if name == "all" else (name,))]
    with br.quiet_stdout() as say:
        try:
            common.enable_lobe()
            rows = []
            for name in names:
                print(name, file=sys.stderr)
                rows.append(measure(name, options))
                table = common.update_table("parity", KEYS, rows, folder=options.results)
        except br.ToolError as error:
            print(f"parity.py: {error}", file=sys.stderr)
            return 2
        say(table)
    return int(failed(rows))


if __name__ == "__main__":
    sys.exit(main())
