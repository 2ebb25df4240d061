"""What a run renders: settings, one render as a job, Cycles' variants, and which level of samples still fits.

Pure data and arithmetic; nothing here renders.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ENGINES = ("LOBE", "CYCLES")
LEVEL_FACTOR = 4
FEWEST_LEVELS = 2  # these run whatever they cost: one point is no curve
REFERENCE_SEEDS = 8
PILOT_SEEDS = 3
# Shares of the budget; the levels get what is left. So the sum of the reference's renders has at least about as many
# samples as half of those of the last level's, which keeps its noise well below that of one of them.
REFERENCE_SHARE, PILOT_SHARE = 0.4, 0.12
# No render uses a seed of another purpose: the reference must not share its noise with what is measured against it.
# The engines' seeds differ for the same reason.
FIRST_SEED = {"level": 1, "reference": 10_001, "pilot": 20_001, "probe": 30_001, "picture": 40_001}
ENGINE_SEED = {"LOBE": 0, "CYCLES": 1_000_000}


@dataclass(frozen=True)
class Variant:
    """Settings of Cycles that change its speed and noise, and not the picture that it converges to."""

    light_tree: bool = True
    guiding: bool = False

    def __str__(self) -> str:
        return f"light tree {'on' if self.light_tree else 'off'}, guiding {'on' if self.guiding else 'off'}"

    @property
    def slug(self) -> str:
        return f"tree{self.light_tree:d}-guiding{self.guiding:d}"


DEFAULT = Variant()
VARIANTS = (DEFAULT, Variant(light_tree=False), Variant(guiding=True), Variant(light_tree=False, guiding=True))


@dataclass(frozen=True)
class Settings:
    """What the user chose. budget: seconds of rendering for a scene, all engines, reference and pilot included."""

    scene: Path
    engines: tuple[str, ...] = ENGINES
    budget: float = 240.0
    resolution: tuple[int, int] = (384, 256)
    seeds: int = 8
    threads: int = 2


@dataclass(frozen=True)
class Job:
    """One render. beside: the engines that it is timed in turn with; a change in one of them makes all run again."""

    purpose: str
    engine: str
    samples: int
    index: int  # which of the purpose's seeds
    variant: Variant | None = None  # of Cycles
    beside: tuple[str, ...] = field(default=())

    @property
    def seed(self) -> int:
        return FIRST_SEED[self.purpose] + ENGINE_SEED[self.engine] + self.index


def job(purpose: str, engine: str, samples: int, index: int, variant: Variant = DEFAULT, beside=()) -> Job:
    """`variant` counts for Cycles alone."""
    return Job(purpose, engine, samples, index, variant if engine == "CYCLES" else None, tuple(beside))


def in_turn(engines: tuple[str, ...], rounds: int) -> Iterator[tuple[int, str]]:
    """(round, engine), every second round in the opposite order: what the first of a pair gains or loses evens out."""
    for index in range(rounds):
        for engine in engines if index % 2 == 0 else engines[::-1]:
            yield index, engine


@dataclass(frozen=True)
class Cost:
    """Seconds of one render: fixed + per_sample * samples."""

    fixed: float
    per_sample: float

    def seconds(self, samples: int) -> float:
        return self.fixed + self.per_sample * samples


def cost(few: tuple[int, float], many: tuple[int, float]) -> Cost:
    """From two renders, each (samples, seconds). Noise in the shorter must not make a sample cost nothing."""
    per_sample = (many[1] - few[1]) / (many[0] - few[0])
    per_sample = max(per_sample, 0.1 * many[1] / many[0])
    return Cost(max(many[1] - per_sample * many[0], 0.0), per_sample)


def next_level_fits(level: int, estimate: float, left: float) -> bool:
    """Whether level `level`, which will take about `estimate` seconds, is to run with `left` seconds of the budget."""
    return level < FEWEST_LEVELS or estimate <= left


def reference_samples(costs: dict[str, Cost], budget: float) -> int:
    """Samples of each of the reference's renders, for a share of the budget.

    The same for both engines: with a mean of equal weights that is near the least noise, since the engine that is
    slower to converge also gets more of the time. A power of 2, so that another guess of the costs, or a faster Lobe,
    mostly finds the renders of before.
    """
    left = REFERENCE_SHARE * budget / REFERENCE_SEEDS - sum(c.fixed for c in costs.values())
    return power_below(left / sum(c.per_sample for c in costs.values()), 2)


def pilot_samples(cycles: Cost, budget: float) -> int:
    """A power of 4, for a share of the budget. Guided samples cost more than others, about twice, hence the 1.5."""
    left = PILOT_SHARE * budget / (PILOT_SEEDS * len(VARIANTS) * 1.5) - cycles.fixed
    return power_below(left / cycles.per_sample, LEVEL_FACTOR)


def power_below(value: float, base: int) -> int:
    """The largest power of `base` that is at most `value`; at least 16, since fewer samples tell nothing."""
    return base ** math.floor(math.log(max(value, 16.0), base) + 1e-9)
