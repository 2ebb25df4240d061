"""One scene from first to last: probe, reference, pilot of Cycles' variants, levels, and pictures at equal time.

Which levels there are is settled before the first of them runs, so that each round of seeds can hold all of them: a
machine that grows slower or faster meanwhile does so for all levels alike, and times of different levels compare.

`measure` asks the store for renders in the order in which they are to be made. That the store has some of them
already changes nothing: what is decided on the way depends on the kept seconds, not on when they were taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tools import metrics

from .. import common
from . import analysis, plan
from .analysis import Level
from .plan import DEFAULT, ENGINES, LEVEL_FACTOR, VARIANTS, Cost, Forecast, Job, Settings, Variant
from .reference import Reference, make_reference
from .runs import Render, Store

SHORTEST_PROBE = 0.2  # seconds of rendering that tell what a sample costs
NOISY_ENOUGH = 0.02  # a relMSE that one sees in a picture
WELL_KNOWN = 0.25  # a pilot's error whose relative standard error is at most this


@dataclass(frozen=True)
class Trial:
    """What the pilot found for one variant of Cycles."""

    variant: Variant
    samples: int
    error: float  # relMSE, mean over the seeds
    trimmed: float
    scatter: float  # standard error of `error`, relative; infinite of one seed
    seconds: float  # of the whole render, as its user feels it, median
    sampling: float

    @property
    def cost(self) -> Cost:
        return Cost(self.seconds - self.sampling, self.sampling / self.samples)


@dataclass(frozen=True)
class Probe:
    """Two renders of an engine: of one sample, and of as many as take a time worth measuring."""

    few: Render
    samples: int  # of `many`
    many: Render

    @property
    def cost(self) -> Cost:
        return plan.cost((1, self.few.total), (self.samples, self.many.total))


@dataclass(frozen=True)
class Shot:
    """A picture for the page."""

    engine: str
    samples: int
    render: Render
    error: float


@dataclass(frozen=True)
class Outcome:
    settings: Settings
    reference: Reference
    trials: list[list[Trial]]  # those side by side together; none when Cycles isn't measured
    variant: Variant
    levels: dict[str, list[Level]]  # of each engine, fewest samples first
    shots: list[Shot]  # one of each engine, about equal in time
    exposure: float  # the file's, in stops
    osl: bool  # Cycles shades with Open Shading Language, which is slower: the file has Phong surfaces


class Campaign:
    """The renders of one scene. progress(what runs now, seconds spent) is called before each render."""

    def __init__(self, settings: Settings, store: Store, progress: Callable[[str, float], None]) -> None:
        self.settings, self.store, self.progress = settings, store, progress

    def render(self, job: Job) -> Render:
        what = f"{job.purpose}, {job.samples} samples, {job.engine.capitalize()} {job.index + 1}"
        self.progress(what, self.store.spent)
        return self.store(job)

    def measure(self) -> Outcome:
        probes = {engine: self.probe(engine) for engine in ENGINES}
        costs = {engine: probe.cost for engine, probe in probes.items()}
        samples = plan.reference_samples(costs, self.settings.budget)
        long = {engine: self.reference_renders(engine, samples) for engine in ENGINES}
        reference = make_reference(stack(long["LOBE"]), stack(long["CYCLES"]), samples)
        wanted = probes["LOBE"].few.report["file_samples"]
        trials = self.pilot(probes["CYCLES"], reference, wanted) if "CYCLES" in self.settings.engines else []
        variant = best(trials[-1]) if trials else DEFAULT
        forecasts = {engine: forecast(probes[engine], long[engine], reference) for engine in self.settings.engines}
        if trials:
            forecasts["CYCLES"] = of_best(forecasts["CYCLES"], trials)
        renders = self.levels(forecasts, variant, wanted)
        levels = {
            engine: [analysis.level(n, runs, reference) for n, runs in by_samples.items()]
            for engine, by_samples in renders.items()
        }
        shots = self.shots(renders, levels, reference)
        report = long["CYCLES"][0].report
        return Outcome(self.settings, reference, trials, variant, levels, shots, report["exposure"], report["osl"])

    def probe(self, engine: str) -> Probe:
        few = self.render(plan.job("probe", engine, 1, 0))
        samples, many = 1, few
        while samples < 16 or (many.total - few.total < SHORTEST_PROBE and samples < 4096):
            samples *= LEVEL_FACTOR
            many = self.render(plan.job("probe", engine, samples, 0))
        return Probe(few, samples, many)

    def reference_renders(self, engine: str, samples: int) -> list[Render]:
        """Not timed, so the engines needn't take turns, and a change in Lobe leaves Cycles' renders as they are."""
        return [self.render(plan.job("reference", engine, samples, index)) for index in range(plan.REFERENCE_SEEDS)]

    def pilot(self, probe: Probe, reference: Reference, wanted: int) -> list[list[Trial]]:
        """Which of Cycles' variants has the least time x error on this scene: of VARIANTS, then of the best one's maps
        of a world with a texture, then of sampling patterns; at last whether guiding pays in longer renders, where the
        budget allows them. A list of trials for each, with seeds of their own.

        wanted: the file's own samples
        """
        samples = plan.pilot_samples(probe.cost, self.settings.budget)
        found = [self.trials(samples, VARIANTS, plan.PILOT_SEEDS, 0, reference)]
        beside = ([plan.with_maps] if probe.few.report["textured_world"] else []) + [plan.with_patterns]
        for stage, variants_of in enumerate(beside, 1):
            variants, first = variants_of(best(found[-1])), stage * plan.PILOT_SEEDS
            found.append(self.trials(samples, variants, plan.PILOT_SEEDS, first, reference))
        chosen = best(found[-1])
        unguided = next(t for t in found[0] if (t.variant.light_tree, t.variant.guiding) == (chosen.light_tree, False))
        longer = plan.long_pilot_samples(unguided.cost, self.settings.budget, wanted)
        if longer > samples:
            first = len(found) * plan.PILOT_SEEDS
            found.append(self.trials(longer, plan.with_guiding(chosen), plan.LONG_PILOT_SEEDS, first, reference))
        return found

    def trials(
        self, samples: int, variants: Sequence[Variant], seeds: int, first: int, reference: Reference
    ) -> list[Trial]:
        """Of each of the variants, rendered in turn. first: index of the first seed."""
        found: dict[Variant, list[Render]] = {variant: [] for variant in variants}
        for index, variant in common.in_turn(variants, seeds):
            found[variant].append(self.render(plan.job("pilot", "CYCLES", samples, first + index, variant)))
        return [trial(variant, samples, runs, reference) for variant, runs in found.items()]

    def levels(
        self, forecasts: dict[str, Forecast], variant: Variant, wanted: int
    ) -> dict[str, dict[int, list[Render]]]:
        """Renders of each engine by samples: whole levels, all of them from one seed before any from the next.

        wanted: the file's own samples
        """
        engines, seeds = self.settings.engines, self.settings.seeds
        most = plan.most_samples(forecasts, wanted, seeds, self.settings.budget - self.store.spent)
        found: dict[str, dict[int, list[Render]]] = {
            engine: {n: [] for n in plan.ladder(most[engine])} for engine in engines
        }
        for index, (engine, samples) in common.in_turn(plan.units(most), seeds):
            found[engine][samples].append(self.render(plan.job("level", engine, samples, index, variant, engines)))
        return found

    def shots(self, renders: dict, levels: dict[str, list[Level]], reference: Reference) -> list[Shot]:
        """A picture of each engine, of the time that the last of them takes to a level of visible noise."""
        slow = self.settings.engines[-1]
        level = visible_level(levels)
        picked = [Shot(slow, level.samples, renders[slow][level.samples][0], float(level.whole[0]))]
        if len(self.settings.engines) > 1:
            fast = self.settings.engines[0]
            samples = samples_in_time(levels[fast], picked[0].render.total)
            render = self.render(plan.job("picture", fast, samples, 0))
            picked.insert(0, Shot(fast, samples, render, reference.errors(render.picture)[0]))
        return picked


def stack(renders: Iterable[Render]) -> np.ndarray:
    return np.stack([render.picture for render in renders])


def trial(variant: Variant, samples: int, runs: list[Render], reference: Reference) -> Trial:
    whole, trimmed = np.array([reference.errors(render.picture) for render in runs]).T
    seconds, sampling = (float(np.median([getattr(r, kind) for r in runs])) for kind in ("total", "sampling"))
    scatter = analysis.standard_error(whole) / max(abs(whole.mean()), 1e-12) if len(runs) > 1 else np.inf
    return Trial(variant, samples, float(whole.mean()), float(trimmed.mean()), scatter, seconds, sampling or seconds)


def trial_costs(trials: Sequence[Trial]) -> dict[Variant, float]:
    """Time x error of variants that were tried side by side. For the sampling time that doesn't change with the
    samples, as long as the error falls like 1 / samples; what comes before the first sample counts as much as it does
    at the samples of the pilot.

    Where a few bright pixels make the mean of so few seeds a matter of chance, it is of all of them the trimmed error.
    """
    known = all(trial.scatter <= WELL_KNOWN for trial in trials)
    return {t.variant: t.seconds * max(t.error if known else t.trimmed, 0.0) for t in trials}


def best(trials: Sequence[Trial]) -> Variant:
    costs = trial_costs(trials)
    return min(costs, key=lambda variant: costs[variant])


def forecast(probe: Probe, long: list[Render], reference: Reference) -> Forecast:
    """long: the engine's renders of which the reference is made; they tell each other's noise."""
    return Forecast(
        probe.cost,
        (1, reference.errors(probe.few.picture)[0]),
        (reference.samples, metrics.noise(stack(long), reference.picture)),
    )


def of_best(default: Forecast, trials: Sequence[Sequence[Trial]]) -> Forecast:
    """Cycles' forecast with the settings that the pilot chose: the default's, times what each of its stages found
    between the best and what it came with, which stands first."""
    chosen = [next(t for t in stage if t.variant == best(stage)) for stage in trials]
    change = math.prod(
        c.trimmed / stage[0].trimmed if stage[0].trimmed > 0.0 else 1.0 for c, stage in zip(chosen, trials, strict=True)
    )
    return Forecast(chosen[-1].cost, (1, default.few[1] * change), (default.many[0], default.many[1] * change))


def visible_level(levels: dict[str, list[Level]]) -> Level:
    """Of the last engine: the level of most samples whose noise one sees, and in whose time the first renders too."""
    first, last = (list(levels.values())[i] for i in (0, -1))
    least = float(np.median(first[0].total))
    enough = [lv for lv in last if float(np.median(lv.total)) >= least] or last[-1:]
    return ([lv for lv in enough if lv.error >= NOISY_ENOUGH] or enough[:1])[-1]


def samples_in_time(levels: list[Level], seconds: float) -> int:
    """About how many samples the engine takes in that time, at least 1: straight between levels."""
    totals = np.maximum.accumulate([float(np.median(lv.total)) for lv in levels])
    samples = [lv.samples for lv in levels]
    if seconds > totals[-1]:
        return round(samples[-1] * seconds / totals[-1])
    return max(1, round(float(np.interp(seconds, totals, samples))))
