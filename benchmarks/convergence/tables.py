"""The rows of the two tables: `convergence`, one a scene, engine and level, and `equal_error`, one a scene.

Seconds are there to see where time goes, on the machine of that run. What may be said of the engines are the ratios:
of times taken in turn, with their 95 % intervals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from .. import common
from . import analysis
from .analysis import PHASES, Level
from .campaign import Outcome, trial_costs
from .plan import ENGINES, Settings
from .reference import DIFFER

RATIO = "time to equal error, Cycles / Lobe"
SAMPLING_RATIO = "the same, sampling alone"
LOWEST_RATIO = "the same, at the lowest error"
TRIMMED_RATIO = "the same, trimmed errors"
INTERVAL = ": 95 % interval"
OSL = ", OSL"
WITHOUT_OSL = " without OSL"
NO_RATIO = (math.nan,) * 3

SETTINGS = """\
Both engines have the box filter, the same bounces, clamps (none in the samples), samples and threads; adaptive
sampling, denoising, time limits, soft falloff, light threshold, filter glossy and shadow terminator offsets are off,
caustics on, surfaces emit to both sides. Errors are of scene-linear pictures."""
AGREEMENT = """\
Long renders of the engines "agree" when the difference of their means and the half width of its 95 % interval are both
below 0.2 %, and 99.75 % of pixels and channels pass Welch's test at the Sidak level of 1 %. They DIFFER when the
difference is neither that nor within its 99.9 % interval, or fewer pixels pass; else it is "open": no difference is
shown, and one of more than 0.2 % isn't refuted."""
CONVERGENCE_NOTE = f"""\
{SETTINGS}
relMSE has the noise of the reference taken off; a star under "near it" marks one below 5 times that noise. "±" is the
standard error over the seeds; "bias" the unbiased squared bias against the reference, on the scale of relMSE; FLIP is
the mean of the first two seeds. At few samples Cycles' bias is real: it puts the first sample of each pixel in the
pixel's middle, so that at 1 sample edges are hard. Seconds are medians of warm renders on one machine, and only there
to see where time goes: they are no claim. The ratios of times taken in turn are in [equal_error.md](equal_error.md).
What Cycles doesn't tell is empty; its "export" holds its whole synchronisation, its "sampling" what it prepares on the
device, in hundredths of a second.

"""
EQUAL_ERROR_NOTE = f"""\
{SETTINGS} Times are of warm renders: Lobe's kernels are loaded, and each engine has rendered the scene before.
All figures are ratios of times of renders made in turn on the same machine, Cycles' over Lobe's at equal relMSE: above
1 Lobe is faster. They are geometric means over the range of errors that both reach, with 95 % intervals; no ratio is
given where that range spans less than a factor of 10 ("too few levels"). Errors are whole, but in the column of trimmed
errors, which are without the worst 0.1 % of values and have a range of their own. Where a few bright pixels make most
of the whole error, the means of so few seeds are a matter of chance; so what those values add is taken by the power law
through all levels, and the intervals are as wide as chance makes them. Intervals are of a bootstrap over the seeds,
its quantiles widened to Student's of so few. Each seed's renders are made in a process of their own, and each draw has
other replicates of the reference too: the intervals hold what processes and the reference's noise make uncertain.
Cycles' sampling time holds what it prepares on the device, and levels at which it is below 0.05 s are left out, as
Cycles tells it in hundredths. Cycles has those settings that a pilot of three seeds found best by error times the time
of the whole render: of light tree and guiding first, then, where the world has a texture, of the maps that it may
sample it by ("world map" and its width), then of sampling patterns ("tabulated Sobol"); what isn't named Cycles chooses
itself. At last one seed of as many samples as the budget allows, up to the file's, tries whether guiding pays once it
has learnt more. Trimmed errors decide where the pilot's whole errors scatter, or there is one seed. "Slopes apart"
names an engine whose slopes over time and over samples differ by more than 0.15: something else than samples moved its
times, so read its row with care. "OSL": Cycles shades the Phong surfaces of the scene with Open Shading Language, whose
cost by itself is in [osl.md](osl.md). Geometric means are of the sample scenes at the resolution and threads of
`make bench`, without those whose pictures DIFFER.
{AGREEMENT}

"""


def write(outcomes: Sequence[Outcome], folder: Path) -> list[dict[str, str]]:
    """Put the outcomes into both tables; gives back all rows of `equal_error` with the geometric means, as they are
    when these outcomes are of one engine alone."""
    levels = [row for outcome in outcomes for row in level_rows(outcome)]
    keys = ("scene", "resolution", "threads")
    common.update_table("convergence", (*keys, "engine"), levels, folder=folder, note=CONVERGENCE_NOTE)
    scenes = [scene_row(outcome) for outcome in outcomes if len(outcome.settings.engines) == len(ENGINES)]
    if scenes:
        common.update_table("equal_error", keys, scenes, folder=folder, note=EQUAL_ERROR_NOTE, summary=summary)
    return common.read_table("equal_error", folder)


def level_rows(outcome: Outcome) -> list[dict[str, str]]:
    return [level_row(outcome, engine, level) for engine, levels in outcome.levels.items() for level in levels]


def level_row(outcome: Outcome, engine: str, level: Level) -> dict[str, str]:
    settings = outcome.settings
    difference, half_width = level.mean_difference
    row = {
        "scene": settings.scene.stem,
        "engine": common.engine_label(engine),
        "settings": str(outcome.variant) if engine == "CYCLES" else "",
        "resolution": "{}x{}".format(*settings.resolution),
        "threads": str(settings.threads),
        "seeds": str(settings.seeds),
        "samples": str(level.samples),
        "relMSE": f"{level.error:.3e}",
        "relMSE ±": f"{analysis.standard_error(level.whole):.1e}",
        "trimmed 0.1 %": f"{level.trimmed.mean():.3e}",
        "trimmed ±": f"{analysis.standard_error(level.trimmed):.1e}",
        "noise of the reference": f"{level.reference_noise:.1e}",
        "near it": "*" if level.marked else "",
        "bias": f"{level.squared_bias:+.1e}",
        "difference of means": f"{difference:+.3%} ± {half_width:.3%}",
        "FLIP": f"{level.flip:.4f}",
    }
    for phase in PHASES:
        seconds = level.phases[phase]
        row[f"{'sampling' if phase == 'render' else phase}, s"] = "" if seconds is None else f"{seconds:.4f}"
    return row


def scene_row(outcome: Outcome) -> dict[str, str]:
    settings, found = outcome.settings, outcome.reference.comparison
    lobe, cycles = outcome.levels["LOBE"], outcome.levels["CYCLES"]
    ratios, errors = ratios_and_range(lobe, cycles)
    by_name = {"Lobe": lobe, "Cycles": analysis.timed(cycles)}
    slopes = {name: analysis.slopes(levels) for name, levels in by_name.items()}
    return {
        "scene": settings.scene.stem,
        "resolution": "{}x{}".format(*settings.resolution),
        "threads": str(settings.threads),
        "seeds": str(settings.seeds),
        "samples, up to: Lobe": str(lobe[-1].samples),
        "samples, up to: Cycles": str(cycles[-1].samples),
        **{key: text for name, ratio in ratios.items() for key, text in ratio_columns(name, ratio).items()},
        "relMSE, from": number(errors[0], ".1e"),
        "relMSE, to": number(errors[1], ".1e"),
        **{
            f"slope over {over}: {engine}": number(slopes[engine][i], ".2f")
            for i, over in enumerate(("samples", "time"))
            for engine in slopes
        },
        "slopes apart": ", ".join(name for name, levels in by_name.items() if analysis.suspect(levels)),
        "Cycles' settings": str(outcome.variant) + (OSL if outcome.osl else ""),
        "pilot: time x error to the best": pilot(outcome),
        "engines' pictures": f"{outcome.reference.verdict}: {found.mean_difference:+.2%} ± {found.mean_half_width:.2%}",
        "noise of the reference": f"{outcome.reference.noise:.1e}",
    }


def ratios_and_range(lobe: list[Level], cycles: list[Level]) -> tuple[dict[str, tuple], tuple[float, float]]:
    """Each column's (ratio, low, high), and the range of errors, which is the same for all but the trimmed.

    So levels of Cycles that are too short for its clock are left out of all columns; where the rest is too few, of
    none, and there is no ratio of sampling alone.
    """

    def ratio(of_cycles: list[Level], seconds: str, error: str) -> analysis.TimeRatio:
        return analysis.time_ratio(analysis.curve(lobe, seconds, error), analysis.curve(of_cycles, seconds, error))

    long = analysis.timed(cycles)
    total, at_sampling = ratio(long, "total", "whole"), ratio(long, "sampling", "whole").mean
    if not total.enough and len(long) < len(cycles):
        long, at_sampling = cycles, NO_RATIO
        total = ratio(long, "total", "whole")
    ratios = {RATIO: total.mean, LOWEST_RATIO: total.at_lowest, SAMPLING_RATIO: at_sampling}
    if not total.enough:
        ratios = dict.fromkeys(ratios, NO_RATIO)
    trimmed = ratio(long, "total", "trimmed")
    return ratios | {TRIMMED_RATIO: trimmed.mean if trimmed.enough else NO_RATIO}, total.errors


def ratio_columns(name: str, ratio: tuple[float, float, float]) -> dict[str, str]:
    middle, low, high = ratio
    interval = f"{low:.2f} to {high:.2f}" if math.isfinite(middle) else ""
    return {name: number(middle, ".2f"), name + INTERVAL: interval}


def number(value: float, form: str) -> str:
    """Empty for what could not be found: too few levels, or errors that only one engine reaches."""
    return format(value, form) if math.isfinite(value) else ""


def pilot(outcome: Outcome) -> str:
    """Every variant's time x error over that of the best of those that it was tried beside."""
    texts = []
    for trials in outcome.trials:
        costs = trial_costs(trials)
        least = min(costs.values()) or math.nan
        texts.append("; ".join(f"{variant}: {cost / least:.2f}" for variant, cost in costs.items()))
    return "; then ".join(texts)


def summary(rows: Sequence[Mapping[str, str]]) -> list[dict[str, str]]:
    """The last rows: geometric means over the scenes that count, and over those of them that Cycles renders without
    Open Shading Language, where it is at its best."""
    counting = [
        row for row in rows if row[RATIO] and is_headline(row) and not row["engines' pictures"].startswith(DIFFER)
    ]
    without_osl = [row for row in counting if not row["Cycles' settings"].endswith(OSL)]
    found = [(counting, ""), (without_osl, WITHOUT_OSL)]
    return [mean_row(kept, f"{common.SUMMARY} of {len(kept)}{suffix}") for kept, suffix in found if kept]


def is_headline(row: Mapping[str, str]) -> bool:
    """Whether it is one of what the README quotes: a sample scene, as `make bench` renders it, or what sums them up."""
    usual = Settings(Path())
    return row["scene"].startswith(common.SUMMARY) or (
        row["scene"] in common.SCENES
        and row["resolution"] == "{}x{}".format(*usual.resolution)
        and row["threads"] == str(usual.threads)
        and int(row["seeds"]) >= usual.seeds
    )


def mean_row(rows: Sequence[Mapping[str, str]], name: str) -> dict[str, str]:
    """Geometric means of those of the rows that have the ratio, intervals from theirs."""
    mean = dict.fromkeys(rows[0], "") | {"scene": name}
    for column in (RATIO, LOWEST_RATIO, SAMPLING_RATIO, TRIMMED_RATIO):
        ratios = [(float(r[column]), *map(float, r[column + INTERVAL].split(" to "))) for r in rows if r[column]]
        if ratios:
            mean |= ratio_columns(column, analysis.geometric_mean(ratios))  # type: ignore[arg-type]
    return mean


def short(rows: Sequence[Mapping[str, str]]) -> list[dict[str, str]]:
    """As narrow as a README's table: of rows of `equal_error` ratios with their intervals."""

    def with_interval(row: Mapping[str, str], name: str) -> str:
        return f"{row[name]} ({row[name + INTERVAL]})" if row[name] else "too few levels"

    return [
        {
            "scene": row["scene"],
            **{name: with_interval(row, name) for name in (RATIO, TRIMMED_RATIO, LOWEST_RATIO, SAMPLING_RATIO)},
            "Cycles' settings": row["Cycles' settings"],
            "engines' pictures": row["engines' pictures"],
        }
        for row in rows
    ]


QUOTED = "<!-- the table of make bench -->\n", "<!-- its end -->\n"


def quote(page: Path, table: str, marks: tuple[str, str] = QUOTED) -> None:
    """Put the table between the two lines that mark its place in a page of Markdown."""
    text = page.read_text(encoding="utf-8")
    before, rest = text.split(marks[0])
    _, after = rest.split(marks[1], 1)
    page.write_text(f"{before}{marks[0]}{table}{marks[1]}{after}", encoding="utf-8")
