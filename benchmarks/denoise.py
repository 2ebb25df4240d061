"""What *Denoise* costs and gains: relMSE and time of a denoised picture beside the noisy one, and beside what the same
time buys in samples.

    python benchmarks/denoise.py

Each sample scene is rendered noisy, denoised, denoised with *Denoising Data* ticked, and noisy with as many samples as
the time of the denoised picture allows, in turn, from the same seeds. Times are of everything from pressing F12 on;
ratios are of one round, and a column gives their median with the smallest and the largest. Errors are means over the
rounds, against the mean of two long renders with other seeds, whose own noise is taken off. Then the library
alone denoises pictures of full HD: seconds, and how far the process's memory grows. Writes denoise.csv,
denoise_large.csv and the same as .md to benchmarks/results/, and the errors into docs/settings.md.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import common
import numpy as np
from common import br
from scale import Rounds, forget_peak, in_turn, peak_mb, ratio_text, seconds
from tqdm import tqdm

from benchmarks.convergence.tables import quote
from tools import metrics
from tools.render import resolution, whole_number

NOISY, DENOISED, GUIDED, MORE = "noisy", "denoised", "with Denoising Data", "more samples"
REFERENCE_SEEDS = 1001, 1002
PILOT_ROUNDS = 3
LARGE = 1920, 1080
PAGE = common.ROOT / "docs" / "settings.md"
MARKS = "<!-- the table of denoise.py -->\n", "<!-- its end -->\n"


def shoot(scene, way: str, samples: int, seeds: Iterator[int], reference: np.ndarray, noise: float) -> dict:
    """The report of a render, and in it the picture's relMSE, less the `noise` that the reference adds to it."""
    scene.lobe.use_denoising = way in (DENOISED, GUIDED)
    scene.view_layers[0].lobe.denoising_data = way == GUIDED
    picture, report = common.render(scene, "LOBE", samples, next(seeds))
    for warning in report["warnings"]:
        if "not denoised" in warning:
            raise br.ToolError(warning)
    return {**report, "relMSE": metrics.rel_mse(picture, reference) - noise}


def measure(name: str, options: argparse.Namespace) -> dict:
    """A scene's row."""
    scene = common.prepare(common.scene_path(name), options.resolution, options.threads)
    half = options.reference_samples // 2
    reference, noise = metrics.joined([common.render(scene, "LOBE", half, seed)[0] for seed in REFERENCE_SEEDS])

    def steps(ways: dict[str, int]) -> dict[Hashable, Callable[[], dict]]:
        """Each has a count of its own, so that all have the same seed in a round."""
        return {way: partial(shoot, scene, way, n, itertools.count(1), reference, noise) for way, n in ways.items()}

    pilot = in_turn(steps({NOISY: options.samples, DENOISED: options.samples}), PILOT_ROUNDS, f"{name}, pilot")
    more = samples_for(pilot, options.samples)
    ways = dict.fromkeys((NOISY, DENOISED, GUIDED), options.samples) | {MORE: more}
    return row(name, in_turn(steps(ways), options.runs, name), more, noise, options)


def samples_for(pilot: Rounds, samples: int) -> int:
    """How many samples take as long as denoising a picture of `samples`, by a pilot of both.

    What denoising takes longer buys samples alone: export, build and start take as long for any number of them.
    """
    longer = np.median(seconds(pilot[DENOISED], "total") - seconds(pilot[NOISY], "total"))
    return max(round(samples * (1.0 + float(longer / np.median(seconds(pilot[NOISY], "render"))))), samples)


def row(name: str, found: Rounds, more: int, noise: float, options: argparse.Namespace) -> dict:
    total = {way: seconds(reports, "total") for way, reports in found.items()}
    error = {way: float(np.mean([report["relMSE"] for report in reports])) for way, reports in found.items()}
    line = {
        "scene": Path(name).stem,
        "resolution": "{}x{}".format(*options.resolution),
        "samples": options.samples,
        "threads": options.threads,
        "rounds": options.runs,
        "relMSE": f"{error[NOISY]:.2e}",
        "denoising, s": f"{np.median(total[DENOISED] - total[NOISY]):.2f}",
        "samples in that time": more,
    }
    for way in (DENOISED, GUIDED, MORE):
        line |= {
            f"{way}: relMSE / noisy": f"{error[way] / error[NOISY]:.3f}",
            f"{way}: time / noisy": ratio_text(total[way], total[NOISY]),
        }
    return line | {"noise of the reference": f"{noise:.1e}"}


def short(rows: Sequence[Mapping[str, str]]) -> str:
    """What docs/settings.md quotes: errors and times as multiples of the noisy picture's, times by their medians."""
    table = []
    for line in rows:
        cells = {"scene": line["scene"], "samples": line["samples"]}
        for way in (DENOISED, GUIDED, MORE):
            time_taken = line[f"{way}: time / noisy"].split()[0]
            cells[f"{way}: relMSE (time)"] = f"{line[f'{way}: relMSE / noisy']} ({time_taken})"
        table.append(cells)
    return common.markdown(table) if table else ""


def large(options: argparse.Namespace) -> list[dict]:
    """Rows of the library alone, of noise without a scene: what it does takes as long for any picture."""
    from bl_ext.user_default.lobe.addon.denoise import BYTES_A_PIXEL, DenoiseError, denoise

    width, height = LARGE
    rng = np.random.default_rng(1)
    color, albedo, normal = (rng.random((height, width, 3), np.float32) for _ in range(3))
    rows = []
    for name, guides in (("none", ()), ("Denoising Data", (albedo, normal))):
        taken, grown = [], []
        for run in tqdm(range(options.runs + 1), desc=f"{width} x {height}, guides: {name}", file=sys.stderr):
            forget_peak()
            before, begun = peak_mb(), time.perf_counter()
            try:
                denoise(color, *guides, threads=options.threads)
            except DenoiseError as error:
                raise br.ToolError(str(error)) from error
            if run:
                taken.append(time.perf_counter() - begun)
                grown.append(peak_mb() - before)
        rows.append({
            "resolution": f"{width}x{height}",
            "guides": name,
            "threads": options.threads,
            "rounds": options.runs,
            "seconds": f"{np.median(taken):.2f} ({min(taken):.2f} to {max(taken):.2f})",
            "memory, MB": f"{max(grown) * (1 << 20) / 1e6:.0f}",
            "memory foreseen, MB": f"{BYTES_A_PIXEL * width * height / 1e6:.0f}",
        })  # fmt: skip
    return rows


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=list(common.SCENES), metavar="SCENE", help="default: the samples")
    parser.add_argument("--runs", type=whole_number(1, 1000), default=5, metavar="N", help="rounds; default: 5")
    parser.add_argument("--threads", type=whole_number(1, 1024), default=2, metavar="N", help="default: 2")
    parser.add_argument("--resolution", type=resolution, default=(384, 256), metavar="WxH", help="default: 384x256")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), default=16, metavar="N", help="default: 16")
    parser.add_argument("--reference-samples", type=whole_number(2, 1 << 24), default=2048, metavar="N",
                        help="default: 2048")  # fmt: skip
    common.add_results(parser)
    return parser.parse_args(arguments)


def main() -> int:
    return common.run(work, parse())


def work(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    rows = []
    for name in options.scenes:
        rows.append(measure(name, options))
        table = common.update_table("denoise", ("scene",), rows, folder=options.results)
    say(table)
    keys = "resolution", "guides", "threads"
    say(common.update_table("denoise_large", keys, large(options), folder=options.results))
    if options.results == common.RESULTS:
        quote(PAGE, short(common.read_table("denoise", common.RESULTS)), MARKS)


if __name__ == "__main__":
    sys.exit(main())
