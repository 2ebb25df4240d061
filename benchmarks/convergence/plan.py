"""What a run renders: settings, one render as a job, Cycles' variants, and which level of samples still fits.

Pure data and arithmetic; nothing here renders.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

ENGINES = ("LOBE", "CYCLES")
LEVEL_FACTOR = 4
FEWEST_LEVELS = 2  # these run whatever they cost: one point is no curve
# Levels go on to the file's own samples, far enough that the errors that both engines reach span WANTED_OVERLAP, unless
# the budget ends before. Where they span less than LEAST_OVERLAP in the end, no ratio of times is given.
LEAST_OVERLAP, WANTED_OVERLAP = 10.0, 16.0
STEEPEST = -1.5  # slope of an error over samples that a forecast believes
REFERENCE_SEEDS = 8
PILOT_SEEDS = 3
LONG_PILOT_SEEDS = 1  # of long renders, whose trimmed errors one seed tells
# Shares of the budget; the levels get what is left, or as much of it as they need. The reference
# gets most, as all errors have its noise.
REFERENCE_SHARE, PILOT_SHARE, LONG_PILOT_SHARE = 0.3, 0.1, 0.1
GUIDED_COST = 2.0  # how much longer a sample takes with guiding, about
# No render uses a seed of another purpose: the reference must not share its noise with what is measured against it.
# The engines' seeds differ for the same reason.
FIRST_SEED = {"level": 1, "reference": 10_001, "pilot": 20_001, "probe": 30_001, "picture": 40_001}
ENGINE_SEED = {"LOBE": 0, "CYCLES": 1_000_000}


@dataclass(frozen=True)
class Variant:
    """Settings of Cycles that change its speed and noise, and not the picture that it converges to.

    world_map: width of the map by which it samples a world with a texture; 0: Cycles chooses it (AUTOMATIC)
    tabulated: tabulated Sobol points in place of what Cycles chooses, which is blue noise
    """

    light_tree: bool = True
    guiding: bool = False
    world_map: int = 0
    tabulated: bool = False

    def __str__(self) -> str:
        text = f"light tree {'on' if self.light_tree else 'off'}, guiding {'on' if self.guiding else 'off'}"
        text += f", world map {self.world_map}" if self.world_map else ""
        return text + (", tabulated Sobol" if self.tabulated else "")

    @property
    def slug(self) -> str:
        return f"tree{self.light_tree:d}-guiding{self.guiding:d}-map{self.world_map}-table{self.tabulated:d}"


DEFAULT = Variant()
VARIANTS = (DEFAULT, Variant(light_tree=False), Variant(guiding=True), Variant(light_tree=False, guiding=True))
WORLD_MAPS = (0, 1024, 2048)  # tried with the best of VARIANTS alone, where the world has a texture


# What is tried beside the best so far, which stands first.


def with_maps(best: Variant) -> tuple[Variant, ...]:
    return tuple(replace(best, world_map=width) for width in WORLD_MAPS)


def with_patterns(best: Variant) -> tuple[Variant, ...]:
    return best, replace(best, tabulated=not best.tabulated)


def with_guiding(best: Variant) -> tuple[Variant, ...]:
    return best, replace(best, guiding=not best.guiding)


@dataclass(frozen=True)
class Settings:
    """What the user chose. budget: seconds of rendering for a scene, all engines, reference and pilot included."""

    scene: Path
    engines: tuple[str, ...] = ENGINES
    budget: float = 960.0  # the slowest of the sample scenes needs nearly that
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

    @property
    def round(self) -> int | None:
        """Which round of the levels it belongs to. Each has a process of its own: what differs between processes and
        not between renders, as where memory happens to lie, is then as different between seeds. None: in any."""
        return self.index if self.purpose == "level" else None


def job(purpose: str, engine: str, samples: int, index: int, variant: Variant = DEFAULT, beside=()) -> Job:
    """`variant` counts for Cycles alone."""
    return Job(purpose, engine, samples, index, variant if engine == "CYCLES" else None, tuple(beside))


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


@dataclass(frozen=True)
class Forecast:
    """What is known of an engine before its levels run. few, many: (samples, relMSE); the first is of one render, in
    which a bright pixel may say too much, the second of many."""

    cost: Cost
    few: tuple[int, float]
    many: tuple[int, float]

    def error(self, samples: int) -> float:
        """relMSE: straight on log-log paper up to the second point, about through the first, after it falling like
        1 / samples."""
        (n, first), (m, last) = ((n, max(error, 1e-12)) for n, error in (self.few, self.many))
        slope = min(max(math.log(last / first) / math.log(m / n), STEEPEST), -1.0) if samples < m else -1.0
        return last * (samples / m) ** slope


def ladder(most: int) -> list[int]:
    """The samples of the levels: 1, 4, 16, ... up to `most`, a power of LEVEL_FACTOR."""
    return [LEVEL_FACTOR**k for k in range(most.bit_length()) if LEVEL_FACTOR**k <= most]


def units(most: dict[str, int]) -> list[tuple[str, int]]:
    """(engine, samples) of all levels up to each engine's most, the engines beside each other."""
    return sorted(((engine, n) for engine in most for n in ladder(most[engine])), key=lambda unit: unit[1])


def most_samples(forecasts: dict[str, Forecast], wanted: int, seeds: int, left: float) -> dict[str, int]:
    """Samples of each engine's last level: the largest 4^k that is at most the file's own, `wanted`, or more where the
    errors of both wouldn't span enough by their forecasts; all of it within `left` seconds.

    Where they don't suffice, the engine whose error is the larger has gone on: times are compared at errors that both
    reach, so samples that take one of them further are in vain.
    """
    most = dict.fromkeys(forecasts, LEVEL_FACTOR ** (FEWEST_LEVELS - 1))
    goal = goal_error(forecasts)
    while True:
        errors = {engine: f.error(most[engine]) for engine, f in forecasts.items()}
        behind = [e for e in errors if LEVEL_FACTOR * most[e] <= wanted or errors[e] > goal]
        if not behind:
            return most
        engine = max(behind, key=lambda engine: errors[engine])
        more = most | {engine: LEVEL_FACTOR * most[engine]}
        if seeds * sum(forecasts[e].cost.seconds(n) for e, n in units(more)) > left:
            return most
        most = more


def goal_error(forecasts: dict[str, Forecast]) -> float:
    """What all have to reach so that the curves have enough in common."""
    return min(f.error(1) for f in forecasts.values()) / WANTED_OVERLAP


def reference_samples(costs: dict[str, Cost], budget: float) -> int:
    """Samples of each of the reference's renders, for a share of the budget.

    The same for both engines: with a mean of equal weights that is near the least noise, since the engine that is
    slower to converge also gets more of the time. A power of 2, so that another guess of the costs, or a faster Lobe,
    mostly finds the renders of before.
    """
    left = REFERENCE_SHARE * budget / REFERENCE_SEEDS - sum(c.fixed for c in costs.values())
    return power_below(left / sum(c.per_sample for c in costs.values()), 2)


def pilot_samples(cycles: Cost, budget: float) -> int:
    """A power of 4, for a share of the budget. Half of the variants are guided."""
    left = PILOT_SHARE * budget / (PILOT_SEEDS * len(VARIANTS) * (1 + GUIDED_COST) / 2) - cycles.fixed
    return power_below(left / cycles.per_sample, LEVEL_FACTOR)


def long_pilot_samples(unguided: Cost, budget: float, wanted: int) -> int:
    """The same of renders with guiding and without: Cycles trains it for up to 128 samples, so few tell too little. At
    most the largest power of 4 up to the file's own samples, `wanted`, where the levels end."""
    left = LONG_PILOT_SHARE * budget / (LONG_PILOT_SEEDS * (1 + GUIDED_COST)) - unguided.fixed
    return min(power_below(left / unguided.per_sample, LEVEL_FACTOR), power_below(wanted, LEVEL_FACTOR))


def power_below(value: float, base: int) -> int:
    """The largest power of `base` that is at most `value`; at least 16, since fewer samples tell nothing."""
    return base ** math.floor(math.log(max(value, 16.0), base) + 1e-9)
