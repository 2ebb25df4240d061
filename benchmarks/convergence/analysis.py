"""From renders to figures: errors with their spread, slopes, and the ratio of times at equal error.

Errors are relMSE, times are seconds. Everything that is averaged over a range of errors or samples is averaged in the
logarithm: a curve's shape on log-log paper is what these figures describe.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from tools import metrics

from .plan import LEAST_OVERLAP
from .reference import MARGIN, Reference
from .runs import Render

PHASES = ("start", "export", "build", "compile", "render", "total")
BOOTSTRAP_RUNS = 2000
CONFIDENCE = 0.95
STEEPEST_BRIGHT = 2.0  # power of 1 / samples that bright pixels' error falls with at most
HALVINGS = 30  # of the range of that power: to a billionth

Points = tuple[np.ndarray, np.ndarray]  # errors and seconds of levels
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
    # (2, draws, seeds): what `whole` and `trimmed` change by with other draws of the reference's replicates
    shifts: np.ndarray = field(default_factory=lambda: np.zeros((2, 1, 1)))

    def drawn(self, error: str) -> np.ndarray:
        """(1 + draws, seeds): "whole" or "trimmed" errors as they are, and with each draw of the reference."""
        values, shifts = getattr(self, error), self.shifts[("whole", "trimmed").index(error)]
        return np.vstack([values, values + shifts])

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
        shifts=np.stack([reference.shifts(picture, BOOTSTRAP_RUNS) for picture in pictures], axis=-1),
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


def slope(x: Sequence[float] | np.ndarray, errors: Sequence[float] | np.ndarray) -> float:
    """Exponent of the power law that fits best: least squares of log error over log x. -1 is plain Monte Carlo."""
    if len(x) < 2:
        return np.nan
    return float(np.polyfit(np.log(x), np.log(errors), 1)[0])


def timed(cycles: Sequence[Level]) -> list[Level]:
    """Those of Cycles' levels whose sampling is long enough to be known. Lobe's own clock is as fine as it needs."""
    return [lv for lv in cycles if np.median(lv.sampling) >= SHORTEST_SAMPLING]


def slopes(levels: Sequence[Level], error: str = "whole") -> tuple[float, float]:
    """Of the error against samples and against sampling time. error: "whole" or "trimmed"."""
    over = curve(levels, "sampling", error)
    every = np.arange(over.seconds.shape[1])[None]
    errors = over.errors(every)[0]
    return slope(over.samples, errors), slope(over.medians(every)[0], errors)


def suspect(levels: Sequence[Level], error: str = "whole") -> bool:
    """Whether the slopes over samples and over time tell different stories."""
    over_samples, over_time = slopes(levels, error)
    return bool(abs(over_time - over_samples) > SLOPES_APART)


# --- times at equal error -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Curve:
    """One engine's errors and times, of levels with more and more samples.

    The error is in two parts. What most pixels have, `core`, is well known from a few seeds. What is in the brightest
    values, `bright`, may be a matter of chance: in some scenes a few fireflies make most of the error, and a short
    level has none of them in any of its seeds.
    """

    samples: np.ndarray  # (levels,)
    core: np.ndarray  # (draws, levels, seeds) relMSE, trimmed; the first as it is, then with draws of the reference
    bright: np.ndarray  # as large: what the whole error has beyond that; zeros in a curve of trimmed errors
    seconds: np.ndarray  # (levels, seeds)

    def errors(self, seeds: np.ndarray) -> np.ndarray:
        """(draws, levels): the core's mean as it is, and what the bright part has by the power law through all levels.

        seeds: (draws, seeds), those of each draw. Where the reference was drawn less often, its draws are taken again.
        """

        if not len(self.samples):
            return np.empty((len(seeds), 0))

        def mean(part: np.ndarray) -> np.ndarray:
            again = part[np.arange(len(seeds)) % len(part)]
            return np.take_along_axis(again, seeds[:, None, :], axis=2).mean(axis=2)

        return mean(self.core) + power_law(self.samples, np.maximum(mean(self.bright), 0.0))

    def medians(self, seeds: np.ndarray) -> np.ndarray:
        """(draws, levels) seconds."""
        return np.median(self.seconds[:, seeds], axis=2).T if len(self.samples) else np.empty((len(seeds), 0))


def power_law(samples: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Errors, (..., levels), by the power law c * samples^-s that fits best: what rare bright pixels add.

    Through all levels, since the mean at each of them hangs on how many such pixels happened to be met. Their number
    grows like the samples, so a level's relative variance falls like 1 / samples: that is its weight. c and s solve
    sum(samples * (error / law - 1) * (1, log samples)) = 0, the equations of a gamma regression with logarithmic link
    (McCullagh & Nelder 1989, section 8.3). They are right in the mean whatever the errors are distributed like, as they
    take no logarithm of them: the mean of few that are skewed has a logarithm that is too small (Santos Silva &
    Tenreyro 2006). s lies between 1, of independent samples, which nothing falls slower than in the mean, and
    STEEPEST_BRIGHT.
    """
    weights, x = samples / samples.sum(), np.log(samples)
    x = x - weights @ x
    low, high = np.ones(errors.shape[:-1]), np.full(errors.shape[:-1], STEEPEST_BRIGHT)
    for _ in range(HALVINGS):
        s = (low + high) / 2
        steeper = (weights * x * errors * np.exp(s[..., None] * x)).sum(axis=-1) < 0.0
        low, high = np.where(steeper, s, low), np.where(steeper, high, s)
    s = ((low + high) / 2)[..., None]
    return (weights * errors * np.exp(s * x)).sum(axis=-1, keepdims=True) * np.exp(-s * x)


@dataclass(frozen=True)
class TimeRatio:
    """Cycles' time over Lobe's at equal error, with 95 % intervals of the bootstrap; nan where there is none."""

    mean: tuple[float, float, float]  # geometric mean over the errors that both reach: ratio, low, high
    at_lowest: tuple[float, float, float]  # at the lowest error that both reach
    errors: tuple[float, float]  # that range

    @property
    def enough(self) -> bool:
        """Whether the range is wide enough to say something: curves that just touch give any ratio."""
        return bool(self.errors[1] >= LEAST_OVERLAP * self.errors[0])


def log_ratio(lobe: Points, cycles: Points) -> tuple[float, float, float, float]:
    """log of (mean ratio, ratio at the lowest error), and the range of log errors that both curves reach.

    Both curves are straight between their levels on log-log paper. The mean is that of log(Cycles' time / Lobe's) over
    the log error, from the lowest to the highest error that both have reached.
    """
    (error_l, time_l), (error_c, time_c) = falling(*lobe), falling(*cycles)
    if len(error_l) == 0 or len(error_c) == 0:
        return (np.nan,) * 4
    low, high = max(error_l[-1], error_c[-1]), min(error_l[0], error_c[0])
    if low >= high:
        return (np.nan,) * 4
    at = np.linspace(low, high, 65)
    ratio = np.interp(at, error_c[::-1], time_c[::-1]) - np.interp(at, error_l[::-1], time_l[::-1])
    return float(ratio.mean()), float(ratio[0]), low, high


def falling(errors: np.ndarray, seconds: np.ndarray) -> Points:
    """Their logarithms, without levels that are no better than a shorter one: whoever waits would have taken that."""
    best = np.minimum.accumulate(np.concatenate([[np.inf], errors[:-1]]))
    kept = (errors < best) & (errors > 0.0) & (seconds > 0.0)
    return np.log(errors[kept]), np.log(seconds[kept])


def time_ratio(lobe: Curve, cycles: Curve, seed: int = 0) -> TimeRatio:
    """How many times longer Cycles takes to the same error, with a 95 % interval from a bootstrap over the runs.

    A run is a round of one seed, both engines' renders of all levels in turn, and is drawn as a whole: a slow minute
    of the machine hits both engines, and a longer render continues a shorter one's random numbers. Each round has a
    process of its own, so that what differs from process to process and not from render to render is drawn with it.
    Each draw has replicates of the reference drawn too, the same for all levels of both engines. A bootstrap of few
    runs scatters too little; so wider quantiles than 95 % are taken, see `tail`.
    """
    rng = np.random.default_rng(seed)
    runs = lobe.seconds.shape[1]
    drawn = np.vstack([np.arange(runs), rng.integers(0, runs, (BOOTSTRAP_RUNS, runs))])
    points = (zip(curve.errors(drawn), curve.medians(drawn), strict=True) for curve in (lobe, cycles))
    found = np.array([log_ratio(*pair) for pair in zip(*points, strict=True)])
    mean, at_lowest = (interval(found[0, column], found[1:, column], tail(runs)) for column in (0, 1))
    return TimeRatio(mean, at_lowest, (float(np.exp(found[0, 2])), float(np.exp(found[0, 3]))))


def tail(runs: int) -> float:
    """What to leave out at either end of a bootstrap of so few runs, so that what is between covers 95 %.

    The expanded percentile interval of Hesterberg 2015, "What Teachers Should Know About the Bootstrap". Of the mean of
    a normal variable it is Student's: what a bootstrap finds for its variance lacks a factor of n / (n - 1), and the
    quantile is that of t with n - 1 degrees of freedom.
    """
    quantile = stats.t.ppf((1 - CONFIDENCE) / 2, runs - 1)
    return float(stats.norm.cdf(np.sqrt(runs / (runs - 1)) * quantile))


def interval(log: float, drawn: np.ndarray, tail: float) -> tuple[float, float, float]:
    """(ratio, low, high) from its logarithm and those of the bootstrap."""
    drawn = drawn[np.isfinite(drawn)]
    if len(drawn) == 0 or not np.isfinite(log):
        return (np.nan,) * 3
    low, high = np.exp(np.quantile(drawn, [tail, 1 - tail]))
    return float(np.exp(log)), float(low), float(high)


def curve(levels: Sequence[Level], seconds: str, error: str = "whole") -> Curve:
    """seconds: "total" or "sampling"; error: "whole" or "trimmed"."""
    used = [lv for lv in levels if lv.usable]
    runs = len(levels[0].whole) if levels else 0
    if not used:
        return Curve(np.empty(0), np.empty((1, 0, runs)), np.empty((1, 0, runs)), np.empty((0, runs)))
    whole, core = (np.stack([lv.drawn(kind) for lv in used], axis=1) for kind in ("whole", "trimmed"))
    bright = whole - core if error == "whole" else np.zeros_like(core[:1])
    samples, times = np.array([lv.samples for lv in used], float), np.stack([getattr(lv, seconds) for lv in used])
    return Curve(samples, core, bright, times)


def geometric_mean(ratios: Sequence[tuple[float, float, float]]) -> tuple[float, float, float]:
    """Of independent (ratio, low, high), whose intervals are taken for symmetric in the logarithm."""
    logs = np.log(np.array(ratios, float))
    half = np.sqrt((((logs[:, 2] - logs[:, 1]) / 2) ** 2).sum()) / len(logs)
    middle = logs[:, 0].mean()
    return float(np.exp(middle)), float(np.exp(middle - half)), float(np.exp(middle + half))
