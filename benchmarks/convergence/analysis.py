"""From renders to figures: errors with their spread, slopes, and the ratio of times at equal error.

Errors are relMSE, times are seconds. Everything that is averaged over a range of errors or samples is averaged in the
logarithm: a curve's shape on log-log paper is what these figures describe.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import stats

from tools import metrics

from .plan import LEAST_OVERLAP
from .reference import MARGIN, Reference
from .runs import Render

PHASES = ("start", "export", "build", "compile", "render", "total")
BOOTSTRAP_RUNS = 2000
CONFIDENCE = 0.95
FLIP_SEEDS = 2  # FLIP takes half a second a picture and hardly differs between seeds
# Cycles tells its sampling time in hundredths of a second: what is shorter than this is rounded by over 10 %.
SHORTEST_SAMPLING = 0.05
# Time that goes like the samples gives the same slope over either; farther apart, other things moved the times.
SLOPES_APART = 0.15


@dataclass(frozen=True)
class Level:
    """One engine's renders at one number of samples. The arrays have one value for each seed."""

    samples: int
    whole: np.ndarray  # relMSE, the reference's noise taken off
    trimmed: np.ndarray
    total: np.ndarray  # seconds
    sampling: np.ndarray
    phases: dict[str, float | None]  # median seconds; None: the engine doesn't tell
    squared_bias: float  # against the reference, on the scale of relMSE; unbiased, so it may come out below zero
    mean_difference: tuple[float, float]  # of the picture's mean to the reference's, relative; half width of 95 %
    flip: float
    reference_noise: float

    @property
    def error(self) -> float:
        return float(self.whole.mean())

    @property
    def marked(self) -> bool:
        """Near the noise of the reference: to be read with care."""
        return self.error < MARGIN * self.reference_noise

    @property
    def usable(self) -> bool:
        """Below the noise of the reference a difference of two noises is left."""
        return self.error > self.reference_noise


def level(samples: int, renders: Sequence[Render], reference: Reference) -> Level:
    """The figures of one engine's renders at one number of samples."""
    pictures = np.stack([render.picture for render in renders])
    whole, trimmed = np.array([reference.errors(picture) for picture in pictures]).T
    return Level(
        samples=samples,
        whole=whole,
        trimmed=trimmed,
        total=np.array([render.total for render in renders]),
        sampling=np.array([render.sampling for render in renders]),
        phases=median_phases(renders),
        squared_bias=metrics.squared_bias(pictures, reference.replicates, reference.picture),
        mean_difference=metrics.mean_difference(pictures, reference.replicates),
        flip=float(np.mean([flip(picture, reference.picture) for picture in pictures[:FLIP_SEEDS]])),
        reference_noise=reference.noise,
    )


def median_phases(renders: Sequence[Render]) -> dict[str, float | None]:
    """Median seconds of each phase over the renders; None where the engine doesn't tell it."""
    rows = [{**render.report["seconds"], "start": render.start} for render in renders]
    return {
        p: None if any(row[p] is None for row in rows) else float(np.median([row[p] for row in rows])) for p in PHASES
    }


def flip(picture: np.ndarray, reference: np.ndarray) -> float:
    """Mean HDR-FLIP of a scene-linear picture: 0 alike, 1 as different as can be seen (Andersson et al. 2021)."""
    from flip_evaluator import evaluate

    as_input = (np.ascontiguousarray(np.maximum(p, 0.0), dtype=np.float32) for p in (reference, picture))
    _, mean, _ = evaluate(*as_input, "HDR", applyMagma=False)
    return float(mean)


def standard_error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def slope(x: Sequence[float], errors: Sequence[float]) -> float:
    """Exponent of the power law that fits best: least squares of log error over log x. -1 is plain Monte Carlo."""
    if len(x) < 2:
        return np.nan
    return float(np.polyfit(np.log(x), np.log(errors), 1)[0])


def timed(cycles: Sequence[Level]) -> list[Level]:
    """Those of Cycles' levels whose sampling is long enough to be known. Lobe's own clock is as fine as it needs."""
    return [lv for lv in cycles if np.median(lv.sampling) >= SHORTEST_SAMPLING]


def slopes(levels: Sequence[Level], error: str = "whole") -> tuple[float, float]:
    """Of the error against samples and against sampling time. error: "whole" or "trimmed"."""
    used = [lv for lv in levels if lv.usable]
    errors = [float(getattr(lv, error).mean()) for lv in used]
    return (
        slope([lv.samples for lv in used], errors),
        slope([float(np.median(lv.sampling)) for lv in used], errors),
    )


def suspect(levels: Sequence[Level], error: str = "whole") -> bool:
    """Whether the slopes over samples and over time tell different stories."""
    over_samples, over_time = slopes(levels, error)
    return bool(abs(over_time - over_samples) > SLOPES_APART)


def falls(levels: Sequence[Level]) -> bool:
    """Whether each level's whole error is below that of the level before by more than the standard error of that
    difference. With four times the samples it falls to a quarter; what hides that is a few bright pixels, which so few
    seeds meet or don't, and no mean of theirs is to be trusted."""
    used = [lv for lv in levels if lv.usable]
    return all(
        before.error - after.error > np.hypot(standard_error(before.whole), standard_error(after.whole))
        for before, after in pairwise(used)
    )


# --- times at equal error -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Curve:
    """errors, seconds: (levels, seeds), of levels with more and more samples."""

    errors: np.ndarray
    seconds: np.ndarray

    def over(self, seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """log of mean error and of median time of these seeds, errors strictly falling.

        A level that isn't better than a shorter one is left out: whoever waits would have taken the shorter.
        """
        if not len(self.errors):
            return np.empty(0), np.empty(0)
        error, seconds = self.errors[:, seeds].mean(axis=1), np.median(self.seconds[:, seeds], axis=1)
        best = np.minimum.accumulate(np.concatenate([[np.inf], error[:-1]]))
        kept = (error < best) & (error > 0.0) & (seconds > 0.0)
        return np.log(error[kept]), np.log(seconds[kept])


@dataclass(frozen=True)
class TimeRatio:
    """Cycles' time over Lobe's at equal error: medians and 95 % intervals of the bootstrap; nan where there is none."""

    mean: tuple[float, float, float]  # geometric mean over the errors that both reach: median, low, high
    at_lowest: tuple[float, float, float]  # at the lowest error that both reach
    errors: tuple[float, float]  # that range

    @property
    def enough(self) -> bool:
        """Whether the range is wide enough to say something: curves that just touch give any ratio."""
        return bool(self.errors[1] >= LEAST_OVERLAP * self.errors[0])


def log_ratio(lobe: Curve, cycles: Curve, seeds: np.ndarray) -> tuple[float, float, float, float]:
    """log of (mean ratio, ratio at the lowest error), and the range of log errors that both curves reach.

    Both curves are straight between their levels on log-log paper. The mean is that of log(Cycles' time / Lobe's) over
    the log error, from the lowest to the highest error that both have reached.
    """
    (error_l, time_l), (error_c, time_c) = lobe.over(seeds), cycles.over(seeds)
    if len(error_l) == 0 or len(error_c) == 0:
        return (np.nan,) * 4
    low, high = max(error_l[-1], error_c[-1]), min(error_l[0], error_c[0])
    if low >= high:
        return (np.nan,) * 4
    at = np.linspace(low, high, 65)
    ratio = np.interp(at, error_c[::-1], time_c[::-1]) - np.interp(at, error_l[::-1], time_l[::-1])
    return float(ratio.mean()), float(ratio[0]), low, high


def time_ratio(lobe: Curve, cycles: Curve, seed: int = 0) -> TimeRatio:
    """How many times longer Cycles takes to the same error, with a 95 % interval from a bootstrap over the runs.

    A run is a round of one seed, both engines' renders of all levels in turn, and is drawn as a whole: a slow minute
    of the machine hits both engines, and a longer render continues a shorter one's random numbers. A bootstrap of few
    runs scatters too little; so wider quantiles than 95 % are taken, see `tail`.
    """
    rng = np.random.default_rng(seed)
    runs = lobe.errors.shape[1]
    drawn = rng.integers(0, runs, (BOOTSTRAP_RUNS, runs))
    found = np.array([log_ratio(lobe, cycles, seeds) for seeds in drawn])
    low, high = log_ratio(lobe, cycles, np.arange(runs))[2:]
    mean, at_lowest = (_quantiles(found[:, column], tail(runs)) for column in (0, 1))
    return TimeRatio(mean, at_lowest, (float(np.exp(low)), float(np.exp(high))))


def tail(runs: int) -> float:
    """What to leave out at either end of a bootstrap of so few runs, so that what is between covers 95 %.

    The expanded percentile interval of Hesterberg 2015, "What Teachers Should Know About the Bootstrap". Of the mean of
    a normal variable it is Student's: what a bootstrap finds for its variance lacks a factor of n / (n - 1), and the
    quantile is that of t with n - 1 degrees of freedom.
    """
    quantile = stats.t.ppf((1 - CONFIDENCE) / 2, runs - 1)
    return float(stats.norm.cdf(np.sqrt(runs / (runs - 1)) * quantile))


def _quantiles(logs: np.ndarray, tail: float) -> tuple[float, float, float]:
    logs = logs[np.isfinite(logs)]
    if len(logs) == 0:
        return (np.nan,) * 3
    median, low, high = np.exp(np.quantile(logs, [0.5, tail, 1 - tail]))
    return float(median), float(low), float(high)


def curve(levels: Sequence[Level], seconds: str, error: str = "whole") -> Curve:
    """seconds: "total" or "sampling"; error: "whole" or "trimmed"."""
    used = [lv for lv in levels if lv.usable]
    runs = len(levels[0].whole) if levels else 0
    shape = len(used), runs
    errors = np.array([getattr(lv, error) for lv in used]).reshape(shape)
    return Curve(errors, np.array([getattr(lv, seconds) for lv in used]).reshape(shape))


def geometric_mean(ratios: Sequence[tuple[float, float, float]]) -> tuple[float, float, float]:
    """Of independent (ratio, low, high), whose intervals are taken for symmetric in the logarithm."""
    logs = np.log(np.array(ratios, float))
    half = np.sqrt((((logs[:, 2] - logs[:, 1]) / 2) ** 2).sum()) / len(logs)
    middle = logs[:, 0].mean()
    return float(np.exp(middle)), float(np.exp(middle - half)), float(np.exp(middle + half))
