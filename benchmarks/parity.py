"""Is Lobe's picture the same as Cycles' (or as the reference road's)? Renders seeds of both and tests the difference.

    python benchmarks/parity.py cornell_diffuse --samples 64 --seeds 8
    python benchmarks/parity.py all --against REFERENCE --resolution 48x32 --samples 16

Both render with the fair settings of tools/cycles_peer.py, the box filter, equal bounces and samples; Phong surfaces
in Cycles are the exact Open Shading Language peer. The statistics are those of tools/metrics.py. A scene passes when
the relative difference of the means is below 0.2 %, or cannot be told from 0 (its 95 % interval holds 0), and when
99.75 % of pixels times channels pass Welch's test at the Sidak level. "bias" is the unbiased squared bias and "noise"
the error of one seed, both on the scale of relMSE. Results go to benchmarks/results/parity.csv and .md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import common
import numpy as np
from common import br

from tools import metrics
from tools.render import resolution, whole_number

KEYS = ("scene", "against", "resolution", "samples", "seeds", "settings")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="+", metavar="SCENE", help="sample scenes by name, files, or 'all'")
    parser.add_argument("--against", choices=("CYCLES", "REFERENCE"), default="CYCLES")
    parser.add_argument("--resolution", type=resolution, default=(96, 64), metavar="WxH")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), default=64, metavar="N")
    parser.add_argument("--seeds", type=whole_number(2, 1000), default=8, metavar="N")
    parser.add_argument("--threads", type=whole_number(0, 1024), default=2, metavar="N")
    parser.add_argument("--set", action="append", default=[], dest="assignments", metavar="scene.lobe.KEY=VALUE")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="keep mean pictures and the t values there")
    return parser.parse_args()


def replicates(scene, engine: str, options: argparse.Namespace, first_seed: int) -> np.ndarray:
    """(seeds, h, w, 3)."""
    pictures = []
    for seed in range(options.seeds):
        pictures.append(common.render(scene, engine, options.samples, first_seed + seed)[0])
        print(f"\r{engine} {seed + 1}/{options.seeds} ", end="", file=sys.stderr, flush=True)
    print("", file=sys.stderr)
    return np.stack(pictures)


def measure(name: str, options: argparse.Namespace) -> dict:
    scene = common.prepare(common.scene_path(name), options.resolution, options.threads)
    for assignment in options.assignments:
        br.set_value(scene, assignment)
    # Different seeds for the two: two engines that share a sequence would not be independent.
    a = replicates(scene, "LOBE", options, 1)
    b = replicates(scene, options.against, options, 1001)
    if options.pictures is not None:
        keep_pictures(options.pictures, Path(name).stem, a, b)
    return row(name, options, metrics.compare(a, b))


def row(name: str, options: argparse.Namespace, found: metrics.Comparison) -> dict:
    same_mean = abs(found.mean_difference) < 0.002 or abs(found.mean_difference) < found.mean_half_width
    passed = same_mean and found.pass_sidak >= 0.9975
    return {
        "scene": Path(name).stem,
        "against": options.against,
        "resolution": "{}x{}".format(*options.resolution),
        "samples": options.samples,
        "seeds": options.seeds,
        "settings": " ".join(options.assignments),
        "mean difference": f"{found.mean_difference:+.3%} ± {found.mean_half_width:.3%}",
        "pixels (Sidak)": f"{found.pass_sidak:.3%}",
        "pixels (3 sigma)": f"{found.pass_three_sigma:.3%}",
        "blocks (3 sigma)": f"{found.block_pass_three_sigma:.3%}",
        "worst block's p": f"{found.block_smallest_p:.2g}",
        "bias": f"{found.squared_bias:.2e}",
        "noise Lobe": f"{found.noise_a:.2e}",
        "noise other": f"{found.noise_b:.2e}",
        "verdict": "pass" if passed else "FAIL",
    }


def keep_pictures(folder: Path, stem: str, a: np.ndarray, b: np.ndarray) -> None:
    """Means of both, and Welch's t, positive where Lobe is brighter."""
    folder.mkdir(parents=True, exist_ok=True)
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    t, _, _ = metrics.welch(mean_a, a.var(axis=0, ddof=1), len(a), mean_b, b.var(axis=0, ddof=1), len(b))
    for kind, picture in (("lobe", mean_a), ("other", mean_b), ("t", t)):
        opaque = np.concatenate([picture, np.ones_like(picture[..., :1])], axis=-1).astype(np.float32)
        br.save_exr(folder / f"{stem}_{kind}.exr", opaque, {})


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
                table = common.update_table("parity", KEYS, rows)
        except br.ToolError as error:
            print(f"parity.py: {error}", file=sys.stderr)
            return 2
        say(table)
    return int(any(r["verdict"] != "pass" for r in rows))


if __name__ == "__main__":
    sys.exit(main())
