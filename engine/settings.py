"""How to render: the settings of one render, with the ranges that the add-on's properties share."""

from __future__ import annotations

import os
from dataclasses import dataclass

from .errors import SettingsError
from .fieldtypes import check_fields
from .passes import PASSES

HEMISPHERE_SAMPLING = ("COSINE", "UNIFORM", "REJECTION")
LOBE_SELECTION = ("ALBEDO", "CLASSIC")
PIXEL_FILTERS = ("BLACKMAN_HARRIS", "BOX")
ROADS = ("COMPILED", "REFERENCE")


@dataclass(frozen=True)
class Settings:
    """Defaults are the add-on's defaults. `threads` 0: one for each of the `usable_processors`.

    time_limit          seconds, 0: none
    adaptive_threshold  the error at which a pixel stops, relative to the square root of its brightness
    max_bounces         of a path, on surfaces after the first; diffuse_bounces and glossy_bounces by kind of lobe
    clamp_direct, clamp_indirect  limit of a single contribution (sum of its channels / 3); 0: no limit
    filter_width        pixels, of the Blackman-Harris filter; the box is always one pixel wide
    passes              names of `engine.PASSES`, of what to make beside Combined
    """

    samples: int = 128
    seed: int = 0
    time_limit: float = 0.0
    use_adaptive_sampling: bool = False
    adaptive_threshold: float = 0.01
    max_bounces: int = 8
    diffuse_bounces: int = 8
    glossy_bounces: int = 8
    clamp_direct: float = 0.0
    clamp_indirect: float = 0.0
    hemisphere_sampling: str = "COSINE"
    lobe_selection: str = "ALBEDO"
    pixel_filter: str = "BLACKMAN_HARRIS"
    filter_width: float = 1.5
    passes: tuple[str, ...] = ()
    road: str = "COMPILED"
    threads: int = 0

    @property
    def thread_count(self) -> int:
        """Threads that build and render."""
        return self.threads or usable_processors()

    def validate(self) -> None:
        """Raises SettingsError with the name of the setting."""
        check_fields(self, lambda problem: SettingsError(f"setting {problem}"))
        for key, (low, high) in RANGES.items():
            value = getattr(self, key)
            if not low <= value <= high:
                raise SettingsError(f"setting {key!r} is {value}: it must lie between {low} and {high}")
        for key, choices in CHOICES.items():
            value = getattr(self, key)
            if value not in choices:
                raise SettingsError(f"setting {key!r} is {value!r}: it must be one of {', '.join(choices)}")
        for name in self.passes:
            if name not in PASSES:
                raise SettingsError(f"setting 'passes' has {name!r}: there are {', '.join(PASSES)}")


def usable_processors() -> int:
    """Processors, as the system counts them, that this process may use: a job of a cluster is bound to some of them.
    Not all systems tell."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


RANGES: dict[str, tuple[float, float]] = {
    "samples": (1, 1 << 24),
    "seed": (-(1 << 31), (1 << 31) - 1),
    "time_limit": (0, float("inf")),
    "adaptive_threshold": (0, 1),
    "max_bounces": (0, 1024),
    "diffuse_bounces": (0, 1024),
    "glossy_bounces": (0, 1024),
    "clamp_direct": (0, float("inf")),
    "clamp_indirect": (0, float("inf")),
    "filter_width": (0.01, 10),
    "threads": (0, 1024),
}
CHOICES = {
    "hemisphere_sampling": HEMISPHERE_SAMPLING,
    "lobe_selection": LOBE_SELECTION,
    "pixel_filter": PIXEL_FILTERS,
    "road": ROADS,
}
