"""The two classic pictures: how soon Lobe's error is that of 16,384 plain samples, `python benchmarks/classic.py`.

Plain samples are those of a path tracer without light sampling: light counts where the BSDF's own rays meet it. The
same kernel renders them, without its light sampling. Both roads render the scene anew for each point of their curves;
the plain road, which takes an hour, has one seed and few points. Errors are taken against a long render with other
random numbers, in two halves that tell its noise, seconds from the scene's description to its picture. "plain mean" is
how far the mean of the plain picture is off the reference's: where light sampling alone finds some of the light, as
that of points, the plain road never gets to the picture. Writes classic.csv, classic.md, classic_curves.csv and a plot
of the curves of each scene to benchmarks/results/.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import common
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from engine import Scene, Settings, render
from engine.features import NO_EMITTER
from tools import metrics
from tools.exported import exported
from tools.forcing import forced
from tools.render import resolution, whole_number

SCENES = "cornell_diffuse", "plates_phong"
LEVEL_FACTOR, PLAIN_LEVEL_FACTOR = 4, 16
SEED, REFERENCE_SEED = 1, 1001
WANTED = 10.0  # seconds, at most, at 768 x 512


@dataclass(frozen=True)
class Curve:
    """Of one road, arrays with a number for each level: samples, seconds, relMSE. brighter: the last level's mean over
    the reference's, less 1."""

    samples: np.ndarray
    seconds: np.ndarray
    error: np.ndarray
    brighter: float = 0.0

    def seconds_to(self, error: float) -> float:
        """When the error first was this one, between levels along the line on log-log paper. NaN if it never was."""
        below = np.flatnonzero(self.error <= error)
        if not len(below):
            return float("nan")
        if not (i := int(below[0])):
            return float(self.seconds[0])
        around = slice(i - 1, i + 1)
        x, y = np.log(self.seconds[around]), np.log(self.error[around])
        return float(np.exp(x[0] + (x[1] - x[0]) * (np.log(error) - y[0]) / (y[1] - y[0])))


def typical(curves: Sequence[Curve]) -> Curve:
    """Of one road's curves from several seeds: median seconds, mean errors."""
    return Curve(
        curves[0].samples,
        np.median([one.seconds for one in curves], axis=0),
        np.mean([one.error for one in curves], axis=0),
        float(np.mean([one.brighter for one in curves])),
    )


def rows_of(name: str, where: str, road: str, curves: Sequence[Curve]) -> list[dict]:
    """Of classic_curves.csv: one a seed and level."""
    return [
        {"scene": name, "resolution": where, "road": road, "seed": seed, "samples": f"{samples:.0f}",
         "seconds": f"{seconds:.4f}", "relMSE": f"{error:.4e}"}
        for seed, one in enumerate(curves, SEED)
        for samples, seconds, error in zip(one.samples, one.seconds, one.error, strict=True)
    ]  # fmt: skip


def levels(most: int, factor: int) -> list[int]:
    """Numbers of samples that grow by the factor up to `most`."""
    return [most // factor**k for k in range(most.bit_length()) if factor**k <= most][::-1]


def curve(scene: Scene, settings: list[Settings], reference: np.ndarray, bar: tqdm) -> Curve:
    points = []
    for setting in settings:
        result = render(scene, setting)
        error = metrics.rel_mse(result.pixels[..., :3], reference)
        points.append((setting.samples, sum(result.seconds.values()), error))
        bar.update(setting.samples)
    samples, seconds, errors = np.array(points).T
    return Curve(samples, seconds, errors, float(result.pixels[..., :3].mean(dtype=float) / reference.mean() - 1))


def plain_road() -> contextlib.AbstractContextManager[None]:
    """Within, renders are without light sampling."""
    return forced(lambda features: features._replace(emitter_choice=NO_EMITTER))


def measure(name: str, options: argparse.Namespace) -> tuple[dict, list[Curve], Curve]:
    """A row of the table, Lobe's curves and the plain one."""
    common.prepare(common.scene_path(name), options.resolution, options.threads)
    scene = exported()

    def settings(samples: int, seed: int = SEED) -> Settings:
        return Settings(samples=samples, seed=seed, threads=options.threads, pixel_filter="BOX")

    ours, theirs = levels(options.samples, LEVEL_FACTOR), levels(options.plain_samples, PLAIN_LEVEL_FACTOR)
    half = options.reference_samples // 2
    total = 2 * half + options.seeds * sum(ours) + sum(theirs)
    with tqdm(total=total, desc=name, unit="spp", file=sys.stderr) as bar:
        render(scene, settings(1))  # compiles
        halves = []
        for seed in (REFERENCE_SEED, REFERENCE_SEED + 1):
            halves.append(render(scene, settings(half, seed)).pixels[..., :3])
            bar.update(half)
        reference, noise = metrics.joined(halves)
        lobe = [
            curve(scene, [settings(n, seed) for n in ours], reference, bar)
            for seed in range(SEED, SEED + options.seeds)
        ]
        with plain_road():
            render(scene, settings(1))
            plain_curve = curve(scene, [settings(n) for n in theirs], reference, bar)
    goal = float(plain_curve.error[-1])
    soon = sorted(one.seconds_to(goal) for one in lobe)
    middle = float(np.median(soon))
    row = {
        "scene": name,
        "resolution": "{}x{}".format(*options.resolution),
        "threads": options.threads,
        "plain samples": options.plain_samples,
        "their relMSE": f"{goal:.2e}",
        "their seconds": f"{plain_curve.seconds[-1]:.0f}",
        "seeds": options.seeds,
        "Lobe's seconds to it": f"{middle:.1f} ({soon[0]:.1f} to {soon[-1]:.1f})",
        "wanted: at most, s": f"{WANTED:g}",
        "ratio": f"{plain_curve.seconds[-1] / middle:.0f}",
        "plain mean": f"{plain_curve.brighter:+.2%}",
        "noise of the reference": f"{noise:.1e}",
    }
    return row, lobe, plain_curve


def plot(name: str, lobe: Curve, plain: Curve, path: Path) -> None:
    figure = Figure(figsize=(6, 4), dpi=110, layout="constrained")  # without pyplot there is no screen to look for
    axes = figure.subplots()
    for label, road, color in (("Lobe", lobe, "C0"), ("BSDF sampling alone", plain, "C3")):
        axes.loglog(road.seconds, road.error, "o-", color=color, label=label, markersize=4)
        axes.annotate(f"{road.samples[-1]:,.0f} samples", (road.seconds[-1], road.error[-1]), (-4, -12),
                      textcoords="offset points", ha="right", fontsize=8)  # fmt: skip
    axes.axhline(plain.error[-1], color="0.6", linewidth=0.8, linestyle=":")
    axes.set(title=name, xlabel="seconds", ylabel="relMSE")
    axes.grid(True, which="major", color="0.9")
    axes.legend(frameon=False)
    figure.savefig(path, metadata={"Software": None})


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "scenes", nargs="*", default=list(SCENES), metavar="SCENE", help="default: the two classic ones"
    )
    parser.add_argument("--resolution", type=resolution, default=(768, 512), metavar="WxH")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), default=256, metavar="N", help="Lobe's most")
    parser.add_argument("--plain-samples", type=whole_number(1, 1 << 24), default=16_384, metavar="N")
    parser.add_argument("--reference-samples", type=whole_number(2, 1 << 24), default=2048, metavar="N")
    parser.add_argument("--seeds", type=whole_number(1, 1000), default=3, metavar="N", help="Lobe's")
    parser.add_argument("--threads", type=whole_number(1, 1024), default=2, metavar="N")
    common.add_results(parser)
    return parser.parse_args(arguments)


def main() -> int:
    return common.run(work, parse())


def work(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    for name in options.scenes:
        row, lobe, plain = measure(name, options)
        table = common.update_table("classic", ("scene", "resolution", "plain samples"), [row], folder=options.results)
        where = row["resolution"]
        rows = rows_of(name, where, "Lobe", lobe) + rows_of(name, where, "plain", [plain])
        common.update_table("classic_curves", ("scene", "resolution"), rows, folder=options.results)
        plot(name, typical(lobe), plain, options.results / f"classic_{name}.png")
        say(table)


if __name__ == "__main__":
    sys.exit(main())
