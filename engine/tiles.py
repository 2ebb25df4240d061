"""One thread's work of a render: the kernel over tiles of the picture, one after the other."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from .adaptive import AdaptiveSampling
from .features import Features
from .film import Film
from .kernels.batch import BATCH, new_batch
from .kernels.embree import new_ray
from .kernels.first_hit import make_first_hit_kernel
from .kernels.parts import PartSums
from .kernels.records import COUNTERS, Limits, Tables
from .kernels.staged import make_staged_kernel
from .pack import Packed
from .passes import LIGHT
from .settings import Settings

TILE_SAMPLES = 1 << 14  # a tile takes some milliseconds: the threads end a pass together
# At least, also in small pictures, as long as they fill a batch of paths: some for each of 64 threads, so that they end
# a pass together. Not by the number of threads: see `tiles_of`.
TILES = 256
TILES_PER_THREAD = 8  # at least, in a viewport
LARGEST = float(np.finfo(np.float32).max)  # a clamp beyond it limits nothing
NOT_ADAPTIVE = np.zeros((1, 1, 3)), np.ones((1, 1), np.bool_)  # stands for AdaptiveSampling.half and .active
NO_PARTS = PartSums(np.zeros((1, 1, 1)), np.full(len(LIGHT), -1, np.int64))

tile_kernel = cache(make_staged_kernel)
first_hit_kernel = cache(make_first_hit_kernel)


def tiles_of(
    region: tuple[int, int, int, int], samples: int, least: int = TILES
) -> Iterator[tuple[int, int, int, int]]:
    """Squares (x0, y0, x1, y1) that cover the region, smaller the more samples each pixel gets; `least` of them where
    there are pixels enough. How a picture is cut changes nothing but roundings: LLVM may have other ways to calculate
    the same for a vector whose lanes differ in kind. Final renders are cut alike on any number of threads."""
    x0, y0, x1, y1 = region
    size = min(max((x1 - x0) * (y1 - y0) * samples // least, BATCH), TILE_SAMPLES)
    side = max(4, 1 << ((size // samples).bit_length() // 2))
    for y in range(y0, y1, side):
        for x in range(x0, x1, side):
            yield x, y, min(x + side, x1), min(y + side, y1)


class Shared:
    """An iterator that threads take from in turn."""

    def __init__(self, items: Iterator):
        self._items, self._lock = items, threading.Lock()

    def __iter__(self):
        return self

    def __next__(self):
        with self._lock:
            return next(self._items)


def render_tiles(
    packed: Packed, settings: Settings, film: Film, adaptive: AdaptiveSampling | None, tiles: Iterator, first: int,
    count: int, halt: np.ndarray, deadline: float = np.inf,
) -> tuple[int, np.ndarray]:  # fmt: skip
    """Samples first .. first + count of tiles, on this thread, until none is left, `halt[0]` is set or the deadline is
    over. Returns the rays traced and the kernel's counters."""
    render_tile, tables = tile_kernel(packed.features), tables_of(packed)
    limits, seed = limits_of(packed.features, settings), np.uint32(settings.seed & 0xFFFFFFFF)
    origin = np.array(film.region[:2], np.int64)
    half, active = (adaptive.half, adaptive.active) if adaptive else NOT_ADAPTIVE
    memory = new_batch(packed.features, packed.lights.shape_count)
    parts = PartSums(film.passes.parts, film.passes.part_columns) if film.passes else NO_PARTS
    look = first_hits(packed, film, seed, active) if packed.surfaces and film.passes else None
    counters, rays = np.zeros(COUNTERS, np.int64), 0
    for tile in tiles:
        if halt[0] or time.perf_counter() > deadline:
            break
        rays += render_tile(
            tables, limits, memory, tile, first, count, seed, origin, film.sums, film.samples, half, active, parts,
            counters, halt,
        )  # fmt: skip
        if look is not None:
            rays += look(tile, first, count, halt)
    return rays, counters


def first_hits(packed: Packed, film: Film, seed: np.uint32, active: np.ndarray) -> Callable:
    """`look(tile, first, count, halt)` sums up what these samples see first. Returns the rays traced."""
    assert film.passes is not None
    kernel, tables, memory = first_hit_kernel(seen_first(packed.features)), tables_of(packed), new_ray()
    origin, data, columns = np.array(film.region[:2], np.int64), film.passes.data, film.passes.columns

    def look(tile, first: int, count: int, halt: np.ndarray) -> int:
        return kernel(
            tables, packed.surfaces, memory, tile, first, count, seed, origin, data, columns, active, halt
        )  # fmt: skip

    return look


def seen_first(features: Features) -> Features:
    """Those of a scene's features that decide what the camera sees first: scenes with the same share a kernel."""
    names = (
        "smooth",
        "instances",
        "transparency",
        "holdout",
        "mesh_emitters",
        "world",
        "orthographic",
        "lens",
        "transparent_film",
    )
    return Features(**{name: getattr(features, name) for name in names})


def tables_of(packed: Packed) -> Tables:
    return Tables(
        packed.geometry, packed.lights, packed.environment, packed.tree, packed.camera, packed.filter_table,
        packed.sampler,
    )  # fmt: skip


def limits_of(features: Features, settings: Settings) -> Limits:
    # Without Phong every bounce is a diffuse one; the kernel then counts no kinds.
    bounces = settings.max_bounces if features.phong else min(settings.max_bounces, settings.diffuse_bounces)
    return Limits(
        np.int32(bounces),
        np.int32(settings.diffuse_bounces),
        np.int32(settings.glossy_bounces),
        np.float32(min(settings.clamp_direct, LARGEST)),
        np.float32(min(settings.clamp_indirect, LARGEST)),
    )
